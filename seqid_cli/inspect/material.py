"""One log as the checks see it: samples as they were logged, and on one time base."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.logs.raw import RawLog, Stream
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import Motion, encoder_resolution, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask, noise_step
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class LogData:
    """A log as `assemble` gives it: its joint samples are in the order of time."""

    recording: Recording
    raw: RawLog
    robot: Robot
    # False: a robot guessed from the log; nothing follows from its geometry
    modelled: bool = True
    # the log's first stamp, from which times are told; None: own
    begun_ns: int | None = None

    @property
    def joints(self) -> Stream:
        """The joint samples."""
        return self.raw.joints

    @cached_property
    def step(self) -> Array:
        """Change of each joint's position (n,) rad that counts as more than encoder noise."""
        return noise_step(self.recording.q, encoder_resolution(self.robot))

    @cached_property
    def moving(self) -> Mask:
        """Where each joint moves, on the recording's time base (N, n)."""
        return moving_mask(self.recording.q, self.recording.rate_hz, self.step)

    @cached_property
    def motion(self) -> Motion | None:
        """Filtered motion and torque; None where no stretch is long enough to filter."""
        return _motion(self.recording, self.robot)

    @property
    def t(self) -> Array:
        """Seconds of the joint samples since the log's first, (M,)."""
        stamps = self.joints.stamp_ns
        begun = stamps[0] if self.begun_ns is None else self.begun_ns
        return np.asarray((stamps - begun).astype(np.float64) * 1e-9)

    def effort(self) -> tuple[str, Array] | None:
        """Return which of torque and current was logged, and its values (M, n); None if neither."""
        for quantity in (
            ("current", "torque") if self.raw.prefer_current else ("torque", "current")
        ):
            values = self.joints.channels.get(quantity)
            if values is not None and np.isfinite(values).any():
                return quantity, values
        return None

    def moves(self, joint: int) -> bool:
        """Whether a joint moves at all."""
        return bool(self.moving[:, joint].any())

    def moving_samples(self, joint: int) -> Mask:
        """Where a joint moves, on the joint samples (M,)."""
        base = self.recording
        seconds = (self.joints.stamp_ns * 1e-9 - base.start) * base.rate_hz
        rows = np.clip(np.rint(seconds), 0, len(base.t) - 1).astype(np.intp)
        return np.asarray(self.moving[rows, joint])


def _motion(
    recording: Recording, robot: Robot, *, min_hz: float = 3.0, min_share: float = 0.1
) -> Motion | None:
    """Filter a log; a cut-off fit for accelerations alone may be too low for torques."""
    lowest = min(min_hz, min_share * recording.rate_hz)
    try:
        motion = estimate_motion(recording, robot, MotionOptions())
        if motion.lowpass.active and motion.cutoff.hz < lowest:
            motion = estimate_motion(recording, robot, MotionOptions(cutoff_hz=lowest))
    except SeqidError:
        return None
    return motion
