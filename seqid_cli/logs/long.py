"""Long logs: joint position and torque on one uniform time base, in blocks.

A first pass decodes the file and lays the base; every further pass yields the same
samples as `read_recording`, from a temporary file where there is room for one (see
`Spool`), without ever holding more than some blocks. That works for logs whose stamps
increase and whose rows hold every joint, but not where samples come in bursts or
`lost_samples` finds some.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import starmap
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs import raw as raw_log
from seqid_cli.logs.lost_samples import mended
from seqid_cli.logs.mcap import reader
from seqid_cli.logs.mcap.records import read_summary
from seqid_cli.logs.publishers import second_publisher
from seqid_cli.logs.raw import BlockReader, RawLog, Stamps, Stream, TimeSource
from seqid_cli.logs.read import ABSURD, with_torque
from seqid_cli.logs.storage import files
from seqid_cli.logs.storage.remote import Spool
from seqid_cli.logs.tables import parquet
from seqid_cli.logs.tables.columns import ARROW_ERRORS, opened_table
from seqid_cli.logs.timebase import JITTER_LIMIT, UNIFORM, Base, resample
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

MOST = 262_144


class Thinned:
    """Keeps every row until there are more than `most`, then every second one, fourth and so on.

    What is kept, at least half of `most`, depends on the rows alone, not on how they
    came.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._parts: list[Array] = []
        self._every, self._seen, self._kept = 1, 0, 0

    def push(self, rows: Array) -> None:
        """Take the next rows (M, ...)."""
        self._parts.append(
            rows[-self._seen % self._every :: self._every].copy(order="K")
        )
        self._seen += len(rows)
        self._kept += len(self._parts[-1])
        while self._kept > self._most:
            self._parts = [np.concatenate(self._parts)[::2].copy(order="K")]
            self._every *= 2
            self._kept = len(self._parts[0])

    @property
    def rows(self) -> Array:
        """What is kept."""
        return np.concatenate(self._parts) if self._parts else np.zeros(0)


MARGIN = 64  # rows on either side of a block, over which a spline forgets its ends
GROUP = 256  # rows whose distance from the base is remembered by its extremes
_ALL = "position and torque"
READERS: dict[str, BlockReader] = {
    "parquet": parquet.read_blocks,
    "mcap": reader.read_blocks,
}
Watch = Callable[[float, Array], None]


class UnevenError(Exception):
    """The log has to be read as a whole."""


@dataclass(frozen=True)
class Block:
    """Consecutive samples from `start` on: `q` (M, n) rad, `tau` (M, n) N m, `valid` (M,)."""

    start: int
    q: Array
    tau: Array
    valid: Mask

    PER_SAMPLE = ("q", "tau", "valid")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.q)

    def part(self, where: slice) -> "Block":
        """Some samples, counted from the first of these."""
        return Block(
            self.start + where.start, self.q[where], self.tau[where], self.valid[where]
        )


@dataclass(frozen=True)
class Bridge:
    """Damaged samples [start, stop) of a joint's position, and the values around them."""

    joint: int
    start: int
    stop: int
    before: float
    after: float
    valid: bool  # whether a straight line stands in for them

    def laid(self, block: Block) -> None:
        """Write the bridge into a block's own arrays, where it has a part of it."""
        rows = np.arange(
            max(self.start, block.start), min(self.stop, block.start + len(block.q))
        )
        share = (rows - self.start + 1) / (self.stop - self.start + 1)
        block.q[rows - block.start, self.joint] = self.before + share * (
            self.after - self.before
        )
        block.valid[rows - block.start] &= self.valid


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
    spool: Spool | None = field(default=None, repr=False, compare=False)
    bridges: tuple[Bridge, ...] = ()
    state: files.State | None = None  # of the file at the first pass

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return 1.0 / self.step_s

    @property
    def sha256(self) -> str:
        """Digest of the file.

        Raises InputError: it has changed since the first pass.
        """
        with files.unchanged(self.file, self.state):
            return files.sha256_of(self.file)

    def blocks(self) -> Iterator[Block]:
        """Pass over the samples; raises InputError if the file has changed since the first pass."""
        rows = (
            self._decoded()
            if self.spool is None
            else starmap(_as_stream, self.spool.parts())
        )
        for block in self._as_logged(rows) if self.exact else self._resampled(rows):
            if self.bridges:
                block = replace(block, q=block.q.copy(), valid=block.valid.copy())
            for bridge in self.bridges:
                bridge.laid(block)
            yield block

    def _decoded(self) -> Iterator[Stream]:
        with files.unchanged(self.file, self.state):
            for _, rows in _rows(self.file, self.format, self.robot, self.time_source):
                yield rows

    def _as_logged(self, rows: Iterator[Stream]) -> Iterator[Block]:
        start, n = 0, self.robot.n
        for part in rows:
            kept = part.channels[_ALL][: self.samples - start]
            yield Block(start, kept[:, :n], kept[:, n:], np.ones(len(kept), np.bool_))
            start += len(kept)

    def _resampled(self, rows: Iterator[Stream]) -> Iterator[Block]:
        pending, start = _as_stream(np.zeros(0, np.int64), np.zeros((0, 0))), 0
        for part in rows:
            pending = raw_log.joined([pending, part])
            if len(pending) > 4 * MARGIN:
                sure = int(pending.stamp_ns[-MARGIN]) - self.start_ns
                stop = min(self.samples, int(sure * 1e-9 / self.step_s))
                yield from self._between(pending, start, stop)
                start = max(start, stop)
                pending = self._around(pending, start)
        yield from self._between(pending, start, self.samples)

    def _around(self, rows: Stream, first: int, last: int | None = None) -> Stream:
        """Rows from a little before a sample on, to a little after another."""
        ends = [
            self.start_ns + int(k * self.step_s * 1e9) for k in (first, last or first)
        ]
        low = max(0, int(np.searchsorted(rows.stamp_ns, ends[0])) - MARGIN)
        high = int(np.searchsorted(rows.stamp_ns, ends[1], side="right")) + MARGIN
        return rows.take(slice(low, None if last is None else high))

    def _between(self, rows: Stream, start: int, stop: int) -> Iterator[Block]:
        for low in range(start, stop, parquet.BLOCK_ROWS):
            count = min(parquet.BLOCK_ROWS, stop - low)
            window = Base(
                self.start_ns, self.step_s, count, self.jitter, False, (), first=low
            )
            # Only the rows around the window: a hole may be much longer than a block.
            both, valid, _ = resample(
                self._around(rows, low, low + count), _ALL, window
            )
            yield Block(low, both[:, : self.robot.n], both[:, self.robot.n :], valid)


def _as_stream(stamps: Stamps, values: Array) -> Stream:
    """Rows of a log: `values` (M, 2 n), position and torque."""
    return Stream("joints", stamps, {_ALL: values})


@dataclass
class Scan:
    """What the first pass remembers of the stamps."""

    count: int = 0
    first: int = 0
    last: int = 0
    usual: float = 0.0  # ns, the median step of the first block
    # of steps below the least gap
    sums: Array = field(default_factory=lambda: np.zeros(2))
    beyond: list[Array] = field(default_factory=list)  # steps above it
    surplus: float = 0.0  # samples missing in longer steps
    steps: Thinned = field(default_factory=Thinned)
    # (groups, 3): row, least and most distance
    off: list[Array] = field(default_factory=list)
    partial: str = ""
    warnings: list[str] = field(default_factory=list)

    def push(self, stamps: Stamps, raw: RawLog, *, most_gaps: int = 100000) -> None:
        """Take the stamps of the next rows, and what was said of them."""
        self.partial = raw.partial or self.partial
        self.warnings += [note for note in raw.warnings if note not in self.warnings]
        steps = np.diff(stamps, prepend=np.full(int(self.count > 0), self.last)).astype(
            np.float64
        )
        if not self.count:
            if not len(steps):
                raise UnevenError
            self.first, self.usual = int(stamps[0]), float(np.median(steps))
        self.steps.push(steps)
        far = steps > raw_log.GAP_LEAST_S * 1e9
        near = steps[~far] if far.any() else steps
        self.beyond.append(steps[far])
        if sum(map(len, self.beyond)) > most_gaps:
            raise UnevenError
        self.sums += (near.sum(), np.square(near - self.usual).sum())
        longer = near[near > 1.5 * self.usual]
        self.surplus += float((np.rint(longer / self.usual) - 1).sum())
        index = self.count + np.arange(len(stamps))
        off = (stamps - self.first) - index * self.usual
        starts = np.arange(0, len(off), GROUP)
        least, most = (
            extreme.reduceat(off, starts) for extreme in (np.minimum, np.maximum)
        )
        self.off.append(np.stack([index[starts], least, most], axis=1))
        self.count += len(stamps)
        self.last = int(stamps[-1])

    def base(
        self, *, stretch: float = 20.0
    ) -> tuple[int, float, int, float, bool, int]:
        """Lay the base as `timebase.make_base` does: start, step, samples, jitter, exact, gaps."""
        if self.count < 2:
            raise UnevenError
        beyond = np.concatenate(self.beyond)
        median = float(np.median(self.steps.rows))
        gap = beyond > max(raw_log.GAP_INTERVALS * median, raw_log.GAP_LEAST_S * 1e9)
        if abs(median / self.usual - 1) > 0.02 or gap.sum() > raw_log.BURSTS * (
            self.count - 1
        ):
            raise UnevenError
        regular = beyond[~gap]
        number = self.count - 1 - int(gap.sum())
        total = self.sums[0] + regular.sum()
        mean = total / number - self.usual
        spread = (
            self.sums[1] + np.square(regular - self.usual).sum()
        ) / number - mean**2
        jitter = float(np.sqrt(max(spread, 0.0)) / median)
        if jitter > JITTER_LIMIT:
            raise UnevenError
        intervals = (
            number + self.surplus + float((np.rint(regular / median) - 1).clip(0).sum())
        )
        step = total / round(intervals) * 1e-9
        span = (self.last - self.first) * 1e-9
        if span / step > stretch * self.count:
            raise UnevenError
        samples = int(np.floor(span / step + 1e-6)) + 1
        row, least, most = np.concatenate(self.off).T
        drift = step * 1e9 - self.usual
        reach = np.maximum(np.abs(least - row * drift), np.abs(most - row * drift))
        on_base = bool(reach.max() + GROUP * abs(drift) <= UNIFORM * step * 1e9)
        exact = samples == self.count and on_base
        return self.first, step, samples, jitter, exact, int(gap.sum())


def likely_rows(path: Path, *, bytes_per_row: int = 100) -> int:
    """Rows that a log is likely to hold, without reading it; 0 where the format does not tell."""
    kind, path = files.check_log(path), files.storage_file(path)
    try:
        if kind == "parquet":
            with opened_table(path) as file:
                return int(file.metadata.num_rows)
        if kind == "mcap":
            size = path.stat().st_size
            with path.open("rb") as file:
                told = read_summary(file, size).statistics
            return int(told.message_count) if told else size // bytes_per_row
    except ARROW_ERRORS as error:
        raise parquet.damaged(path, error) from error
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    return 0


def open_long(
    path: Path,
    robot: Robot,
    *,
    time_source: TimeSource = "header",
    watch: Watch | None = None,
) -> LongLog | None:
    """Pass over a log once and lay its time base; None where it can only be read as a whole.

    `watch`: shown the rate [Hz] that the first rows have, and positions (M, n) as
    logged: the samples of the base if the log is `exact`.
    """
    kind, file = files.check_log(path), files.storage_file(path)
    if kind not in READERS:
        return None
    scan, spool = Scan(), Spool()
    try:
        state = files.state_of(file)
        with files.unchanged(file, state):
            for raw, rows in _rows(file, kind, robot, time_source):
                scan.push(rows.stamp_ns, raw)
                spool.push(rows.stamp_ns, rows.channels[_ALL])
                if watch is not None:
                    watch(1e9 / scan.usual, rows.channels[_ALL][:, : robot.n])
        base = scan.base()
    except UnevenError:
        return None
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    told = scan.partial, tuple(scan.warnings), spool if spool.complete else None
    return LongLog(path, file, kind, robot, time_source, *base, *told, state=state)


def _rows(
    path: Path, kind: str, robot: Robot, time_source: TimeSource
) -> Iterator[tuple[RawLog, Stream]]:
    """Decode a log block by block; raises UnevenError where one is to be put right as a whole."""
    latest, first_sources = np.zeros(0, np.int64), None
    for raw in READERS[kind](path, replace(robot, imus=()), time_source):
        joints = raw.joints
        if not len(joints):
            continue
        # Which joints have what torque can be taken from must be the same all along.
        there = [name for name in ("current", "torque") if name in joints.channels]
        sources = [
            (k, np.isfinite(joints.channels[k]).any(axis=0).tolist()) for k in there
        ]
        first_sources = first_sources or sources
        if sources and sources == first_sources:
            joints = with_torque(joints, robot, raw.prefer_current, str(path), [])
        if "tau" not in joints.channels:
            raise UnevenError
        if second_publisher(raw.joints, str(path)) is not None:
            raise UnevenError
        values = np.concatenate(
            [joints.channels["position"].T, joints.channels["tau"].T]
        )
        stamps = np.concatenate([latest, joints.stamp_ns])
        sound = values.min() >= -ABSURD and values.max() <= ABSURD  # not with NaN
        if not sound or (np.diff(stamps) <= 0).any() or len(mended(joints).losses.rows):
            raise UnevenError
        if raw_log.in_turns(joints, robot)[0] is not joints:
            raise UnevenError
        latest = joints.stamp_ns[-1:]
        yield raw, _as_stream(joints.stamp_ns, values.T)
