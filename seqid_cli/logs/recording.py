"""What a log holds once it is read: uniform in time, in SI units.

A log that is held is a `Recording`. One that is passed over (`logs.long`) answers the
same questions (`UniformLog`), and never has more than some blocks of its samples.

Joints are in the order of the robot file. N is the number of samples, M that of a
block, n the number of joints, K the number of accelerometers of an IMU.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

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
    # Hz by IMU, of the samples that its readings are interpolated from
    imu_rates_hz: dict[str, float] = field(default_factory=dict)


Range = tuple[float, float]  # s since a log's first sample
# How commands were logged; `logs.commands` says what each means.
CommandForm = Literal["", "sent", "held", "sampled"]


@dataclass(frozen=True)
class Block:
    """Consecutive samples of position and torque."""

    start: int  # number of the first
    q: Array  # (M, n) rad
    tau: Array  # (M, n) N m
    valid: Mask  # (M,)

    PER_SAMPLE = ("q", "tau", "valid")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.q)

    def part(self, where: slice) -> "Block":
        """Select samples, counted from the first of these."""
        start = self.start + where.start
        return Block(start, self.q[where], self.tau[where], self.valid[where])


@dataclass(frozen=True)
class Whole:
    """The log that a recording is a piece of."""

    sha256: str
    start: float  # s, its first sample on its own clock
    length: float  # s


class UniformLog(Protocol):
    """A log on one time base, held or passed over: what every stage may ask of it."""

    @property
    def path(self) -> Path:
        """The log, as results name it."""

    @property
    def sha256(self) -> str:
        """Digest of its content."""

    @property
    def format(self) -> str:
        """Kind of the file."""

    @property
    def samples(self) -> int:
        """Number of samples."""

    @property
    def rate_hz(self) -> float:
        """Samples per second."""

    @property
    def start(self) -> float:
        """The first sample on the log's own clock, s."""

    @property
    def length(self) -> float:
        """Seconds from the first sample to the last."""

    @property
    def whole(self) -> Whole:
        """The log that this is, or is a piece of."""

    @property
    def partial(self) -> str:
        """What was lost, where the log was salvaged."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was not as it should be."""

    @property
    def mended(self) -> tuple[str, ...]:
        """What was wrong with the motion and is put right."""

    def blocks(self) -> Iterator[Block]:
        """Pass over position and torque; raises InputError where there is no torque."""

    def pieces(self, ranges: Sequence[Range]) -> list["Recording"]:
        """Hold pieces of the log, with all channels; see `cut`."""


@dataclass(frozen=True, kw_only=True, repr=False)
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
    # What the controller was asked for; NaN where a joint has no command, or not yet.
    command: Array | None = None  # (N, n) rad
    command_velocity: Array | None = None  # (N, n) rad/s
    command_torque: Array | None = None  # (N, n) N m at the joint
    command_form: CommandForm = ""
    # (N,) s since the command was sent; None where commands have the rows' stamps
    command_age: Array | None = None
    # (N, K) m/s^2 by IMU
    accelerometers: dict[str, Array] = field(default_factory=dict)
    gyros: dict[str, Array] = field(default_factory=dict)  # (N, 3) rad/s by IMU
    start: float = 0.0  # s, the first sample on the log's own clock
    partial: str = ""  # what was lost, where the log was salvaged
    source_log: Whole | None = None  # the log, where this is a piece of it
    bridged: Mask | None = None  # (N,) not measured, but known from both sides

    def __repr__(self) -> str:
        """Return one line: arrays of a log fill a screen and say nothing."""
        imus = "".join(f", {name}" for name in self.accelerometers)
        return (
            f"<Recording {self.path.name}: {self.samples} samples of"
            f" {self.q.shape[1]} joints{imus}, {self.length:.4g} s at"
            f" {self.rate_hz:.4g} Hz>"
        )

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.health.rate_hz

    @property
    def offset(self) -> float:
        """Seconds from the log's first sample to this recording's."""
        return 0.0 if self.source_log is None else self.start - self.source_log.start

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def length(self) -> float:
        """Seconds from the first sample to the last."""
        return float(self.t[-1])

    @property
    def whole(self) -> Whole:
        """The log that this is, or is a piece of."""
        return self.source_log or Whole(self.sha256, self.start, self.length)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was not as it should be."""
        return self.health.warnings

    @property
    def mended(self) -> tuple[str, ...]:
        """What was wrong with the motion and is put right."""
        return self.health.mended

    def blocks(self) -> Iterator[Block]:
        """Yield position and torque as one block; raises InputError without torque."""
        yield Block(0, self.q, torque_of(self), self.valid)

    def pieces(self, ranges: Sequence[Range]) -> list["Recording"]:
        """Hold pieces of the log; see `cut`."""
        return cut(self, ranges)


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


def by_log(recordings: Iterable[Recording]) -> list[list[Recording]]:
    """Group the pieces of each log, logs in the order of their first pieces."""
    logs: dict[object, list[Recording]] = {}
    for number, recording in enumerate(recordings):
        # Two whole logs are two logs even where their content is the same.
        key: object = number
        if recording.source_log is not None:
            whole = recording.source_log
            key = (str(recording.path), whole.sha256, whole.start)
        logs.setdefault(key, []).append(recording)
    return list(logs.values())


def cut(recording: Recording, ranges: Sequence[Range]) -> list[Recording]:
    """Cut pieces out of a recording.

    Parameters
    ----------
    ranges : sequence of (float, float)
        First and last moment of each piece [s since the recording's first sample]; they
        may overlap.

    Returns
    -------
    list of Recording
        `t` begins at 0 in each, `start` is where it begins in the log. Warnings stay
        with the log.
    """
    whole = recording.whole
    pieces = []
    for begin_s, end_s in ranges:
        # Moments are rounded where they were computed: give or take a nanosecond.
        first = int(np.searchsorted(recording.t, begin_s - 1e-9))
        stop = int(np.searchsorted(recording.t, end_s + 1e-9))
        fields = _samples_of(recording, slice(first, stop))
        offset_s = float(fields["t"][0])
        fields["t"] = fields["t"] - offset_s
        fields["start"] = recording.start + offset_s
        pieces.append(piece_of(replace(recording, **fields), whole))
    return pieces


def every(recording: Recording, stride: int) -> Recording:
    """Return the recording with every `stride`-th sample, at a rate as much lower."""
    if stride == 1:
        return recording
    fields = _samples_of(recording, slice(None, None, stride))
    health = replace(recording.health, rate_hz=recording.rate_hz / stride)
    return replace(recording, health=health, **fields)


def _samples_of(recording: Recording, rows: slice) -> dict[str, Any]:
    """Copy some rows of all fields of a recording that hold samples, by field."""
    fields: dict[str, Any] = {}
    for name, values in vars(recording).items():
        if isinstance(values, np.ndarray):
            fields[name] = values[rows].copy()
        elif isinstance(values, dict):  # readings by IMU
            fields[name] = {imu: array[rows].copy() for imu, array in values.items()}
    return fields


def piece_of(recording: Recording, whole: Whole) -> Recording:
    """Make a recording a piece of a log, with a digest of its own."""
    place = f"{whole.sha256} {recording.start - whole.start:.9f} {len(recording.t)}"
    return replace(
        recording,
        sha256=hashlib.sha256(place.encode()).hexdigest(),
        health=replace(recording.health, gaps=(), warnings=()),
        source_log=whole,
    )
