"""One log as the checks see it: samples as they were logged, and on one time base."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.inspect.channels.values import lattice
from seqid_cli.inspect.settings import InspectSettings
from seqid_cli.logs.raw import RawLog, Stream
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.survey import survey_of_positions
from seqid_cli.motion.motion import Motion, cutoff_of, encoder_resolution, motion_below
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask, noise_step, windowed_velocity
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask


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
        q = self.recording.q
        survey = survey_of_positions(q, self.recording.rate_hz)
        resolution = encoder_resolution(self.robot)
        return noise_step(q, resolution, encoder=survey.encoder_step())

    @cached_property
    def moving(self) -> Mask:
        """Where each joint moves, on the recording's time base (N, n)."""
        return moving_mask(self.recording.q, self.recording.rate_hz, self.step)

    @cached_property
    def motion(self) -> Motion | None:
        """Filtered motion and torque; None where no stretch is long enough for it."""
        return _motion(self)

    @cached_property
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

    def lattice(self, quantity: str, joint: int) -> float:
        """Return the step of a joint's channel as it was logged, 0 if not quantised."""
        key = (quantity, joint)
        if key not in self._lattices:
            column = self.joints.channels[quantity][:, joint]
            self._lattices[key] = lattice(column[np.isfinite(column)])
        return self._lattices[key]

    @cached_property
    def _lattices(self) -> dict[tuple[str, int], float]:
        return {}

    def moves(self, joint: int) -> bool:
        """Return whether a joint moves at all."""
        return bool(self.moving[:, joint].any())

    def moving_samples(self, joint: int) -> Mask:
        """Return where a joint moves, on the joint samples (M,)."""
        return np.asarray(self.moving[self._nearest, joint])

    @cached_property
    def _nearest(self) -> Index:
        """Rows (M,) of the time base that are nearest to the joint samples."""
        base = self.recording
        position = (self.joints.stamp_ns * 1e-9 - base.start) * base.rate_hz
        nearest: Index = np.clip(np.rint(position), 0, len(base.t) - 1).astype(np.intp)
        return nearest

    def top_speed(self, joint: int) -> float:
        """Return the top speed of a joint over 0.1 s, rad/s (m/s)."""
        return float(self._top_speeds[joint])

    @cached_property
    def _top_speeds(self) -> Array:
        """Top speeds (n,) over 0.1 s, rad/s (m/s)."""
        q = self.recording.q
        rate_hz = self.recording.rate_hz
        half = max(1, round(0.05 * rate_hz))
        if 2 * half + 1 >= len(q):
            return np.zeros(self.robot.n)
        velocities = (windowed_velocity(position, rate_hz, half) for position in q.T)
        return np.array([np.abs(velocity).max() for velocity in velocities])


def _motion(
    data: LogData, *, min_hz: float = 3.0, min_share: float = 0.1
) -> Motion | None:
    """Filter a log; None where nothing of it is long enough."""
    recording = data.recording
    rate_hz = recording.rate_hz
    try:
        cutoff = cutoff_of(recording, data.robot, MotionOptions())
        # A cut-off that suits accelerations alone may be too low for torques.
        lowest_hz = min(min_hz, min_share * rate_hz)
        if Lowpass(cutoff.hz, rate_hz).active and cutoff.hz < lowest_hz:
            options = MotionOptions(cutoff_hz=lowest_hz)
            cutoff = cutoff_of(recording, data.robot, options)
        return motion_below(recording, cutoff, data.moving)
    except SeqidError:
        return None
