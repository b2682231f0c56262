"""One log as the checks see it: samples as they were logged, and on one time base."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import SeqidError
from seqid_cli.logs.pieces import Failed, read_parts
from seqid_cli.logs.raw import RawLog, Stream, TimeSource
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import Motion, encoder_resolution, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask, noise_step
from seqid_cli.robot.types import Array, Robot

Mask = NDArray[np.bool_]
V = TypeVar("V")


def per_robot(function: Callable[[Robot], V]) -> Callable[[Robot], V]:
    """Work something out once for all logs of a robot (the very object that was loaded)."""
    last: list[tuple[Robot, V]] = []

    def remembered(robot: Robot) -> V:
        if not last or last[0][0] is not robot:
            last[:] = [(robot, function(robot))]
        return last[0][1]

    return remembered


@dataclass(frozen=True)
class LogData:
    """A log, read.

    `joints` holds the joint samples in the order of time, `moving` (N, n) says where each joint
    moves on the recording's time base. `modelled` is False where the robot is only guessed from
    the log, so that nothing may be concluded from its geometry. `begun_ns` is the stamp of the
    log's first sample, from which times are told; None where that is the first of these.
    """

    robot: Robot
    modelled: bool
    raw: RawLog
    joints: Stream
    recording: Recording
    step: Array  # (n,) rad, what counts as more than encoder noise
    moving: Mask
    begun_ns: int | None = None

    @cached_property
    def motion(self) -> Motion | None:
        """Filtered motion and torque; None where no stretch is long enough to filter."""
        return _motion(self.recording, self.robot)

    @property
    def t(self) -> Array:
        """Seconds of the joint samples since the log's first, (M,)."""
        stamps = self.joints.stamp_ns
        begun = stamps[0] if self.begun_ns is None else self.begun_ns
        seconds: Array = (stamps - begun).astype(np.float64) * 1e-9
        return seconds

    def effort(self) -> tuple[str, Array] | None:
        """Return which of torque and current was logged, and its values (M, n); None if neither."""
        choices = ("current", "torque") if self.raw.prefer_current else ("torque", "current")
        for quantity in choices:
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
        here: Mask = self.moving[rows, joint]
        return here


def read_log(
    path: Path,
    robot: Robot,
    *,
    modelled: bool,
    time_source: TimeSource,
    failed: Failed | None = None,
) -> Iterator[LogData]:
    """Read a log for inspection, part by part; a short one is one part.

    `failed`: told of parts of no use. Raises InputError: it cannot be read, or lacks what the robot
    file promises.
    """
    begun = None
    for recording, raw in read_parts(path, robot, time_source=time_source, failed=failed):
        data = log_data(recording, raw, robot, modelled=modelled, begun_ns=begun)
        begun = int(data.joints.stamp_ns[0]) if begun is None else begun
        yield data
        del recording, raw, data  # they are large, and the next ones come


def log_data(
    recording: Recording,
    raw: RawLog,
    robot: Robot,
    *,
    modelled: bool,
    begun_ns: int | None = None,
) -> LogData:
    """Prepare a log for the checks that was read; see `assemble`."""
    step = noise_step(recording.q, encoder_resolution(robot))
    return LogData(
        robot=robot,
        modelled=modelled,
        raw=raw,
        joints=raw.joints,
        recording=recording,
        step=step,
        moving=moving_mask(recording.q, recording.rate_hz, step),
        begun_ns=begun_ns,
    )


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
