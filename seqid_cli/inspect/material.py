"""One log as the checks see it: samples as they were logged, and on one time base."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.inspect.settings import InspectSettings
from seqid_cli.logs.raw import RawLog, Stream
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import Motion, encoder_resolution, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask, noise_step
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True, kw_only=True)
class LogData:
    """A log, or a part of one, as `assemble` gives it; joint samples are in time order.

    There are M joint samples as they were logged, and N on the recording's time base.
    """

    recording: Recording
    raw: RawLog
    robot: Robot
    # False for a robot that is guessed from the log: nothing follows from its geometry.
    modelled: bool = True
    # First stamp of the log, from which times count; None: that of these samples.
    first_stamp_ns: int | None = None
    # What the checks decide by; it travels with the samples.
    settings: InspectSettings = InspectSettings()

    @property
    def joints(self) -> Stream:
        """The joint samples as they were logged."""
        return self.raw.joints

    @cached_property
    def step(self) -> Array:
        """Changes of joint positions (n,) rad that count as more than encoder noise."""
        return noise_step(self.recording.q, encoder_resolution(self.robot))

    @cached_property
    def moving(self) -> Mask:
        """Where each joint moves, on the recording's time base (N, n)."""
        return moving_mask(self.recording.q, self.recording.rate_hz, self.step)

    @cached_property
    def motion(self) -> Motion | None:
        """Filtered motion and torque; None where no stretch is long enough for it."""
        return _motion(self.recording, self.robot)

    @property
    def t(self) -> Array:
        """Times of the joint samples (M,), s since the log's first."""
        stamps = self.joints.stamp_ns
        first = stamps[0] if self.first_stamp_ns is None else self.first_stamp_ns
        return np.asarray((stamps - first).astype(np.float64) * 1e-9)

    def effort(self) -> tuple[str, Array] | None:
        """Return "torque" or "current", whichever was logged, and its values (M, n).

        None where neither was. Of both, the one that the log's reader prefers counts.
        """
        quantities = ("torque", "current")
        if self.raw.prefer_current:
            quantities = ("current", "torque")
        for quantity in quantities:
            values = self.joints.channels.get(quantity)
            if values is not None and np.isfinite(values).any():
                return quantity, values
        return None

    def moves(self, joint: int) -> bool:
        """Return whether a joint moves at all."""
        return bool(self.moving[:, joint].any())

    def moving_samples(self, joint: int) -> Mask:
        """Return where a joint moves, on the joint samples (M,)."""
        base = self.recording
        position = (self.joints.stamp_ns * 1e-9 - base.start) * base.rate_hz
        nearest = np.clip(np.rint(position), 0, len(base.t) - 1).astype(np.intp)
        return np.asarray(self.moving[nearest, joint])


def _motion(
    recording: Recording, robot: Robot, *, min_hz: float = 3.0, min_share: float = 0.1
) -> Motion | None:
    """Filter a log; None where nothing of it is long enough."""
    try:
        motion = estimate_motion(recording, robot, MotionOptions())
        # A cut-off that suits accelerations alone may be too low for torques.
        lowest_hz = min(min_hz, min_share * recording.rate_hz)
        if motion.lowpass.active and motion.cutoff.hz < lowest_hz:
            options = MotionOptions(cutoff_hz=lowest_hz)
            motion = estimate_motion(recording, robot, options)
    except SeqidError:
        return None
    return motion
