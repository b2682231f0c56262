"""Long logs: joint position and torque on one uniform time base, in blocks.

A first pass reads the stamps and lays the base; every further pass yields the same samples as
`read_recording`, without ever holding more than some blocks. That works for logs whose stamps
increase and whose rows hold every joint; `open_long` returns None for others, and for logs in which
samples come in bursts, which have to be read as a whole.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from seqid_cli.errors import InputError
from seqid_cli.logs import mcap, parquet, parquet_blocks
from seqid_cli.logs.clocks import BURSTS, GAP_INTERVALS, GAP_LEAST_S
from seqid_cli.logs.columns import ARROW_ERRORS
from seqid_cli.logs.long_health import LongHealth
from seqid_cli.logs.mcap_summary import read_summary
from seqid_cli.logs.open import check_log, storage_file
from seqid_cli.logs.raw import Array, Mask, RawLog, Stamps, Stream, TimeSource
from seqid_cli.logs.read import _with_torque
from seqid_cli.logs.thinned import Thinned
from seqid_cli.logs.timebase import JITTER_LIMIT, UNIFORM, Base, resample
from seqid_cli.robot.types import Robot

ABSURD = 1e9  # no position or torque in SI units is that large
MOST_GAPS = 100_000
MARGIN = 64  # rows on either side of a block, over which a spline forgets its ends
GROUP = 256  # rows whose distance from the base is remembered by its extremes
BYTES_PER_ROW = 100  # of an MCAP file that does not tell how many messages it holds
STRETCH = 20.0  # a base so many times longer than the rows is a clock that went wrong


class BlockReader(Protocol):
    """Reads one file format block by block."""

    def __call__(self, path: Path, robot: Robot, time_source: TimeSource) -> Iterator[RawLog]:
        """Yield the next rows."""
        ...


READERS: dict[str, BlockReader] = {"parquet": parquet_blocks.read_blocks, "mcap": mcap.read_blocks}


@dataclass(frozen=True)
class Block:
    """Consecutive samples from `start` on: `q` (M, n) rad, `tau` (M, n) N m, `valid` (M,)."""

    start: int
    q: Array
    tau: Array
    valid: Mask


@dataclass(frozen=True)
class LongLog:
    """A log that can be passed over again and again; see the module's text."""

    path: Path  # as given
    file: Path
    format: str
    robot: Robot
    time_source: TimeSource
    start_ns: int
    step_s: float
    samples: int
    jitter: float
    exact: bool  # the stamps lie on the base
    gaps: int
    partial: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return 1.0 / self.step_s

    @property
    def sha256(self) -> str:
        """Digest of the file."""
        with self.file.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def blocks(self) -> Iterator[Block]:
        """Pass over the samples of the base, a few ten thousand at a time."""
        rows = _rows(self.file, self.format, self.robot, self.time_source)
        return self._as_logged(rows) if self.exact else self._resampled(rows)

    def _as_logged(self, rows: Iterator[Rows]) -> Iterator[Block]:
        start, n = 0, self.robot.n
        for part in rows:
            kept = part.values[: self.samples - start]
            yield Block(start, kept[:, :n], kept[:, n:], np.ones(len(kept), np.bool_))
            start += len(kept)

    def _resampled(self, rows: Iterator[Rows]) -> Iterator[Block]:
        pending, start = _NO_ROWS, 0
        for part in rows:
            pending = pending.followed_by(part)
            if len(pending.stamps) > 4 * MARGIN:
                sure = int(pending.stamps[-MARGIN]) - self.start_ns
                stop = min(self.samples, int(sure * 1e-9 / self.step_s))
                yield from self._between(pending, start, stop)
                start = max(start, stop)
                pending = pending.after(self.start_ns + int(start * self.step_s * 1e9))
        yield from self._between(pending, start, self.samples)

    def _between(self, rows: Rows, start: int, stop: int) -> Iterator[Block]:
        for low in range(start, stop, parquet_blocks.BLOCK_ROWS):
            count = min(parquet_blocks.BLOCK_ROWS, stop - low)
            window = _Window(
                self.start_ns, self.step_s, count, self.jitter, False, _NONE, (), first=low
            )
            # Only the rows around the window: a hole may be much longer than a block.
            part = rows.around(
                self.start_ns + int(low * self.step_s * 1e9),
                self.start_ns + int((low + count) * self.step_s * 1e9),
            )
            found = resample(Stream("joints", part.stamps, {"all": part.values}), "all", window)
            n = self.robot.n
            yield Block(low, found.values[:, :n], found.values[:, n:], found.valid)


@dataclass(frozen=True)
class _Window(Base):
    """Samples `first`, `first` + 1, ... of a base."""

    first: int = 0

    @property
    def t(self) -> Array:
        """Seconds since the first sample of the base."""
        return (self.first + np.arange(self.count, dtype=np.float64)) * self.step_s


@dataclass(frozen=True)
class Rows:
    """Rows as logged: `stamps` (M,) ns, `values` (M, 2 n) position and torque."""

    stamps: Stamps
    values: Array
    partial: str = ""
    warnings: tuple[str, ...] = ()

    def followed_by(self, other: Rows) -> Rows:
        """These rows and the next."""
        if not len(self.stamps):
            return other
        return Rows(
            np.concatenate([self.stamps, other.stamps]), np.concatenate([self.values, other.values])
        )

    def after(self, stamp: int) -> Rows:
        """Rows from a little before a stamp on."""
        low = max(0, int(np.searchsorted(self.stamps, stamp)) - MARGIN)
        return Rows(self.stamps[low:], self.values[low:])

    def around(self, first: int, last: int) -> Rows:
        """Rows from a little before a stamp to a little after another."""
        low = max(0, int(np.searchsorted(self.stamps, first)) - MARGIN)
        high = int(np.searchsorted(self.stamps, last, side="right")) + MARGIN
        return Rows(self.stamps[low:high], self.values[low:high])


_NONE: NDArray[np.intp] = np.zeros(0, np.intp)
_NO_ROWS = Rows(np.zeros(0, np.int64), np.zeros((0, 0)))


class _UnevenError(Exception):
    """The log has to be read as a whole."""


def rows_at_least(path: Path, least: int) -> bool:
    """Whether a log is likely to hold so many rows, without reading it.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    kind, path = check_log(Path(path)), storage_file(Path(path))
    try:
        if kind == "parquet":
            with pq.ParquetFile(path) as file:
                return int(file.metadata.num_rows) >= least
        if kind == "mcap":
            size = path.stat().st_size
            with path.open("rb") as opened:
                messages = read_summary(opened, size).messages
            return (size // BYTES_PER_ROW if messages is None else messages) >= least
    except ARROW_ERRORS as error:
        raise parquet.damaged(path, error) from error
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    return False


def open_long(
    path: Path,
    robot: Robot,
    *,
    time_source: TimeSource = "header",
    watch: Callable[[float, Array], None] | None = None,
) -> LongLog | None:
    """Pass over a log once and lay its time base.

    Parameters
    ----------
    path, robot, time_source
        As for `read_recording`.
    watch : callable, optional
        Shown what is passed over: the rate [Hz] that the first rows have, and positions (M, n) as
        logged. They are the samples of the base if the log is `exact`.

    Returns
    -------
    LongLog or None
        None where the log can only be read as a whole.

    Raises
    ------
    InputError
        The file cannot be read or lacks a channel.
    """
    path = Path(path)
    kind, file = check_log(path), storage_file(path)
    if kind not in READERS:
        return None
    scan, health = _Scan(), LongHealth(robot)
    try:
        for rows in _rows(file, kind, robot, time_source, health):
            scan.push(rows)
            if watch is not None:
                watch(1e9 / scan.usual, rows.values[:, : robot.n])
        base = scan.base()
    except _UnevenError:
        return None
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    warnings = scan.warnings + health.warnings(1.0 / base[1], base[3])
    return LongLog(
        path,
        file,
        kind,
        robot,
        time_source,
        *base,
        partial=scan.partial,
        warnings=tuple(dict.fromkeys(warnings)),
    )


def _rows(
    path: Path,
    kind: str,
    robot: Robot,
    time_source: TimeSource,
    health: LongHealth | None = None,
) -> Iterator[Rows]:
    last, first_sources = None, None
    for raw in READERS[kind](path, replace(robot, imus=()), time_source):
        joints = raw.joints
        if not len(joints):
            continue
        noticed: list[str] = []
        sources = _torque_sources(joints)
        if first_sources not in (None, sources):
            raise _UnevenError
        first_sources = sources
        if sources:
            joints = _with_torque(joints, robot, raw.prefer_current, str(path), noticed)
        if "tau" not in joints.channels:
            raise _UnevenError
        if health is not None:
            health.push(joints, joints.channels["tau"], noticed)
        values = np.hstack([joints.channels["position"], joints.channels["tau"]])
        if not (np.abs(values) <= ABSURD).all():  # NaN as well
            raise _UnevenError
        steps = np.diff(joints.stamp_ns, prepend=joints.stamp_ns[:1] if last is None else last)
        if (steps[last is None :] <= 0).any():
            raise _UnevenError
        last = joints.stamp_ns[-1:]
        yield Rows(joints.stamp_ns, values, raw.partial, raw.warnings)


def _torque_sources(joints: Stream) -> dict[str, list[bool]]:
    """Which joints have what torque can be taken from; it must be the same all along."""
    found: dict[str, list[bool]] = {}
    for name in ("current", "torque"):
        if name in joints.channels:
            there: Mask = np.asarray(np.isfinite(joints.channels[name]).any(axis=0))
            found[name] = [bool(x) for x in there]
    return found


@dataclass
class _Scan:
    """What the first pass remembers of the stamps."""

    count: int = 0
    first: int = 0
    last: int = 0
    usual: float = 0.0  # ns, the median step of the first block
    sums: Array = field(default_factory=lambda: np.zeros(2))  # of steps below the least gap
    beyond: list[Array] = field(default_factory=list)  # steps above it
    surplus: float = 0.0  # samples missing in longer steps
    steps: Thinned = field(default_factory=Thinned)
    off: list[Array] = field(default_factory=list)  # (groups, 3): row, least and most distance
    partial: str = ""
    warnings: list[str] = field(default_factory=list)

    def push(self, rows: Rows) -> None:
        stamps = rows.stamps
        self.partial = rows.partial or self.partial
        self.warnings += [note for note in rows.warnings if note not in self.warnings]
        if self.count:
            steps = np.diff(stamps, prepend=np.int64(self.last)).astype(np.float64)
        else:
            self.first = int(stamps[0])
            steps = np.diff(stamps).astype(np.float64)
            if not len(steps):
                raise _UnevenError
            self.usual = float(np.median(steps))
        self._note_steps(steps)
        self._note_distance(stamps)
        self.count += len(stamps)
        self.last = int(stamps[-1])

    def _note_steps(self, steps: Array) -> None:
        self.steps.push(steps)
        far = steps > GAP_LEAST_S * 1e9
        near = steps[~far] if far.any() else steps
        if far.any():
            self.beyond.append(steps[far])
            if sum(map(len, self.beyond)) > MOST_GAPS:
                raise _UnevenError
        self.sums += (near.sum(), np.square(near - self.usual).sum())
        longer = near[near > 1.5 * self.usual]
        self.surplus += float((np.rint(longer / self.usual) - 1).sum())

    def _note_distance(self, stamps: Stamps) -> None:
        index = self.count + np.arange(len(stamps))
        off = (stamps - self.first) - index * self.usual
        starts = np.arange(0, len(off), GROUP)
        least, most = (extreme.reduceat(off, starts) for extreme in (np.minimum, np.maximum))
        self.off.append(np.stack([index[starts], least, most], axis=1))

    def base(self) -> tuple[int, float, int, float, bool, int]:
        """Lay the base as `timebase.make_base` does: start, step, samples, jitter, exact, gaps."""
        if self.count < 2:
            raise _UnevenError
        beyond = np.concatenate(self.beyond) if self.beyond else np.zeros(0)
        median = float(np.median(self.steps.rows))
        limit = max(GAP_INTERVALS * median, GAP_LEAST_S * 1e9)
        gap = beyond > limit
        if abs(median / self.usual - 1) > 0.02 or gap.sum() > BURSTS * (self.count - 1):
            raise _UnevenError
        regular = beyond[~gap]
        number = self.count - 1 - int(gap.sum())
        total = self.sums[0] + regular.sum()
        mean = total / number - self.usual
        spread = (self.sums[1] + np.square(regular - self.usual).sum()) / number - mean**2
        jitter = float(np.sqrt(max(spread, 0.0)) / median)
        if jitter > JITTER_LIMIT:
            raise _UnevenError
        intervals = number + self.surplus + float((np.rint(regular / median) - 1).clip(0).sum())
        step = total / round(intervals) * 1e-9
        span = (self.last - self.first) * 1e-9
        if span / step > STRETCH * self.count:
            raise _UnevenError
        samples = int(np.floor(span / step + 1e-6)) + 1
        exact = samples == self.count and self._on_base(step * 1e9)
        return self.first, step, samples, jitter, exact, int(gap.sum())

    def _on_base(self, step: float) -> bool:
        row, least, most = np.concatenate(self.off).T
        drift = step - self.usual
        reach = np.maximum(np.abs(least - row * drift), np.abs(most - row * drift))
        return bool(reach.max() + GROUP * abs(drift) <= UNIFORM * step)
