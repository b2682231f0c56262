"""What a log holds once it is read: uniform in time, in SI units.

Joints are in the order of the robot file. N is the number of samples, n the number of
joints, K the number of accelerometers of an IMU.
"""

from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path

from seqid_cli.errors import InputError
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class Health:
    """Clock and channel checks of one log, for `inspect` and for warnings."""

    rate_hz: float
    jitter: float  # standard deviation of the sample interval over its median
    _: KW_ONLY
    gaps: tuple[tuple[float, float], ...] = ()  # (start, end) s since the first sample
    non_monotonic: int = 0  # steps back in time
    duplicates: int = 0  # samples that repeat a stamp
    resampled: bool = False
    log_minus_header_s: float | None = None
    warnings: tuple[str, ...] = ()
    mended: tuple[str, ...] = ()  # what was wrong with the motion and is put right


@dataclass(frozen=True)
class Whole:
    """The log that a recording is a piece of."""

    sha256: str
    start: float  # s, its first sample on its own clock
    length: float  # s


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One log, or a piece of one, on one time base; None for channels that it lacks."""

    path: Path
    sha256: str
    format: str
    t: Array  # (N,) s from 0
    q: Array  # (N, n) rad, as the encoder reports it
    valid: Mask  # (N,) false where values were bridged over a gap
    health: Health
    dq: Array | None = None  # (N, n) rad/s
    tau: Array | None = None  # (N, n) N m at the joint
    temperature: Array | None = None  # (N, n) degC
    load: Array | None = None  # (N, n) N m, a torque sensor behind the gear
    link_position: Array | None = None  # (N, n) rad, an encoder on the link side
    # (N, K) m/s^2 by IMU
    accelerometers: dict[str, Array] = field(default_factory=dict)
    gyros: dict[str, Array] = field(default_factory=dict)  # (N, 3) rad/s by IMU
    start: float = 0.0  # s, the first sample on the log's own clock
    partial: str = ""  # what was lost, where the log was salvaged
    source_log: Whole | None = None  # the log, where this is a piece of it
    bridged: Mask | None = None  # (N,) not measured, but known from both sides

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.health.rate_hz

    @property
    def offset(self) -> float:
        """Seconds from the log's first sample to this recording's."""
        return 0.0 if self.source_log is None else self.start - self.source_log.start


def torque_of(recording: Recording) -> Array:
    """Return the measured torque of a log.

    Returns
    -------
    ndarray, (N, n)
        Torque at the joints [N m].

    Raises
    ------
    InputError
        The log carries neither torque nor a current that gives it.
    """
    if recording.tau is None:
        raise InputError(
            "the log has neither joint torque nor motor current that can be turned into"
            " torque",
            hint="record either; current needs torque_constant and gear_ratio in the"
            " robot file",
            where=str(recording.path),
        )
    return recording.tau
