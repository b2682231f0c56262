"""Long logs: joint position and torque on one uniform time base, in blocks.

A first pass decodes the file and lays the base; every further pass yields the same
samples as `read_recording`, from a temporary file where there is room for one (see
`Spool`), without ever holding more than some blocks. That works for logs whose stamps
increase and whose rows hold every joint, but not where samples come in bursts or
`lost_samples` finds some.

M is the number of rows of a block, n the number of joints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import starmap
from pathlib import Path

import numpy as np

from seqid_cli.logs.even_stamps import evened
from seqid_cli.logs.first_pass import FirstPass, UnevenError
from seqid_cli.logs.log_file import LogFile, likely_rows
from seqid_cli.logs.lost_samples import mended
from seqid_cli.logs.pieces import read_pieces
from seqid_cli.logs.publishers import second_publisher
from seqid_cli.logs.raw import RawLog, Stamps, Stream, joined
from seqid_cli.logs.read import ABSURD, with_torque
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Block, Range, Recording, Whole
from seqid_cli.logs.signs import with_signs
from seqid_cli.logs.storage.spool import Spool
from seqid_cli.logs.tables import parquet
from seqid_cli.logs.timebase import Base, resample
from seqid_cli.logs.turns import in_turns
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LONG = 200_000  # samples from which on a log is better passed over than held
MARGIN = 64  # rows on either side of a block, over which a spline forgets its ends
_ALL = "position and torque"  # one channel (M, 2 n) of both, resampled at once


@dataclass(frozen=True)
class Bridge:
    """Damaged samples of a joint's position, and the values around them."""

    joint: int
    start: int  # the first damaged sample
    stop: int  # the first sound one behind it
    before: float  # rad
    after: float  # rad
    valid: bool  # whether a straight line stands in for them

    def laid(self, block: Block) -> None:
        """Write the bridge into a block's own arrays, where it has a part of it."""
        first = max(self.start, block.start)
        stop = min(self.stop, block.start + len(block.q))
        samples = np.arange(first, stop)
        rows = samples - block.start

        share = (samples - self.start + 1) / (self.stop - self.start + 1)
        block.q[rows, self.joint] = self.before + share * (self.after - self.before)
        block.valid[rows] &= self.valid


@dataclass(frozen=True, kw_only=True)
class LongLog:
    """A log that can be passed over again and again; see the module's text."""

    path: Path  # as results name it
    file: LogFile
    robot: Robot
    base: Base
    partial: str = ""
    warnings: tuple[str, ...] = ()
    mended: tuple[str, ...] = ()  # a log that must be mended is read as a whole
    spool: Spool | None = field(default=None, repr=False, compare=False)
    bridges: tuple[Bridge, ...] = ()

    @property
    def format(self) -> str:
        """Kind of the file."""
        return self.file.format

    @property
    def sha256(self) -> str:
        """Digest of the file; raises InputError if it changed since the first pass."""
        return self.file.sha256

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.base.count

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return 1.0 / self.base.step_s

    @property
    def start(self) -> float:
        """The first sample on the log's own clock, s."""
        return self.base.start_ns * 1e-9

    @property
    def length(self) -> float:
        """Seconds from the first sample to the last."""
        return (self.samples - 1) * self.base.step_s

    @property
    def whole(self) -> Whole:
        """The log itself, as pieces of it have to know it."""
        return Whole(self.sha256, self.start, self.length)

    def pieces(self, ranges: Sequence[Range]) -> list[Recording]:
        """Hold pieces of the log, with all channels of the robot; see `cut`."""
        return read_pieces(self.file, self.robot, self.whole, ranges)

    def blocks(self) -> Iterator[Block]:
        """Pass over the samples, in their order.

        Raises InputError if the file has changed since the first pass.
        """
        rows = self._logged_rows()
        blocks = self._as_logged(rows) if self.base.exact else self._resampled(rows)

        for block in blocks:
            # Bridges are written into copies: a block may be a view of read-only rows.
            if self.bridges:
                block = replace(block, q=block.q.copy(), valid=block.valid.copy())
            for bridge in self.bridges:
                bridge.laid(block)
            yield block

    def _logged_rows(self) -> Iterator[Stream]:
        """Yield the rows from the temporary file, or else by decoding them again."""
        if self.spool is not None:
            yield from starmap(_as_stream, self.spool.parts())
            return
        for _, rows in _rows(self.file, self.robot):
            yield rows

    def _as_logged(self, rows: Iterator[Stream]) -> Iterator[Block]:
        """Yield rows that lie on the base as they are."""
        n = self.robot.n
        start = 0
        for part in rows:
            values = part.channels[_ALL][: self.samples - start]
            valid = np.ones(len(values), np.bool_)
            yield Block(start, values[:, :n], values[:, n:], valid)
            start += len(values)

    def _resampled(self, rows: Iterator[Stream]) -> Iterator[Block]:
        """Yield samples of the base as soon as the rows around them have come."""
        pending = _as_stream(np.zeros(0, np.int64), np.zeros((0, 0)))
        start = 0
        for part in rows:
            pending = joined([pending, part])
            if len(pending) > 4 * MARGIN:
                # Behind this stamp the next rows could still change the spline.
                settled_ns = int(pending.stamp_ns[-MARGIN]) - self.base.start_ns
                stop = min(self.samples, int(settled_ns * 1e-9 / self.base.step_s))
                yield from self._between(pending, start, stop)
                start = max(start, stop)
                pending = pending.take(slice(self._first_row(pending, start), None))
        yield from self._between(pending, start, self.samples)

    def _stamp_of(self, sample: int) -> int:
        return self.base.start_ns + int(sample * self.base.step_s * 1e9)

    def _first_row(self, rows: Stream, sample: int) -> int:
        """Return the first row that matters to a sample: a little before it."""
        row = int(np.searchsorted(rows.stamp_ns, self._stamp_of(sample)))
        return max(0, row - MARGIN)

    def _between(self, rows: Stream, start: int, stop: int) -> Iterator[Block]:
        """Resample rows to the samples [start, stop) of the base."""
        n = self.robot.n
        for first in range(start, stop, parquet.BLOCK_ROWS):
            count = min(parquet.BLOCK_ROWS, stop - first)
            window = self.base.window(first, count)
            # Only the rows around the window: a hole may be much longer than a block.
            end_ns = self._stamp_of(first + count)
            stop_row = int(np.searchsorted(rows.stamp_ns, end_ns, side="right"))
            around = slice(self._first_row(rows, first), stop_row + MARGIN)
            resampled = resample(rows.take(around), _ALL, window)
            q = resampled.values[:, :n]
            tau = resampled.values[:, n:]
            yield Block(first, q, tau, resampled.valid)


def _as_stream(stamps: Stamps, values: Array) -> Stream:
    """Make a stream of rows: `values` (M, 2 n) are position and torque."""
    return Stream("joints", stamps, {_ALL: values})


def open_long(
    path: Path,
    robot: Robot,
    *,
    reading: Reading = HEADER_STAMPS,
) -> LongLog | None:
    """Pass over a log once and lay its time base.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    robot : Robot
        Names of joints and channels; drive data that turn current into torque.
    reading : Reading
        By which stamps logs are read, and which part of them.

    Returns
    -------
    LongLog or None
        None where the log can only be read as a whole.

    Raises
    ------
    InputError
        The file cannot be read, lacks a channel or changes.
    """
    file = LogFile.at(path, reading=reading)
    if not file.blockwise:
        return None
    first_pass = FirstPass()
    spool = Spool()
    try:
        for raw, rows in _rows(file, robot):
            first_pass.push(rows.stamp_ns, raw)
            spool.push(rows.stamp_ns, rows.channels[_ALL])
        base = first_pass.base()
    except UnevenError:
        return None
    return LongLog(
        path=path,
        file=file,
        robot=robot,
        base=base,
        partial=first_pass.partial,
        warnings=tuple(first_pass.warnings),
        spool=spool if spool.complete else None,
    )


def open_if_long(
    path: Path, robot: Robot, *, reading: Reading = HEADER_STAMPS, least: int
) -> LongLog | None:
    """Open a log of `least` samples or more to be passed over.

    None where it is shorter, or has to be read as a whole.
    """
    if likely_rows(path) < least:
        return None
    log = open_long(path, robot, reading=reading)
    return log if log is not None and log.samples >= least else None


def _rows(log: LogFile, robot: Robot) -> Iterator[tuple[RawLog, Stream]]:
    """Decode a log block by block; yields each block and its position and torque.

    Raises UnevenError where the log is to be put right as a whole: each check stands
    for a step of `read.assemble` that looks beyond a block.
    """
    where = str(log.file)
    latest = np.zeros(0, np.int64)
    first_sources: dict[str, object] = {}
    for raw in log.blocks(replace(robot, imus=())):
        joints = raw.joints
        if not len(joints):
            continue

        # Which joints have what torque can be taken from must be the same all along.
        sources: dict[str, object] = {
            name: np.isfinite(joints.channels[name]).any(axis=0).tolist()
            for name in ("current", "torque")
            if name in joints.channels
        }
        first_sources = first_sources or sources
        if sources and sources == first_sources:
            joints = with_torque(joints, robot, raw.prefer_current, where, [])
        if "tau" not in joints.channels:
            raise UnevenError
        if second_publisher(raw.joints, where) is not None:
            raise UnevenError

        values = np.concatenate(
            [joints.channels["position"].T, joints.channels["tau"].T]
        )
        # A comparison with NaN is false: a missing value fails as well.
        is_sound = values.min() >= -ABSURD and values.max() <= ABSURD
        steps = np.diff(np.concatenate([latest, joints.stamp_ns]))
        if not is_sound or (steps <= 0).any():
            raise UnevenError
        if evened(joints) is not None:
            raise UnevenError
        unsigned: list[str] = []
        with_signs(raw.joints, robot, unsigned)
        if unsigned:
            raise UnevenError
        if len(mended(joints).losses.rows):
            raise UnevenError
        unwrapped, _ = in_turns(joints, robot)
        if unwrapped is not joints:
            raise UnevenError

        latest = joints.stamp_ns[-1:]
        yield raw, _as_stream(joints.stamp_ns, values.T)
