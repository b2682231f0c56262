"""The one way into a log: its file, of whatever format, as what was logged.

Everything that reads a log asks a `LogFile`: for all of it as one block, or for one
block after the other, in memory that does not grow with the log. The file must be the
same all along, however often it is passed over.

    LogFile -- RawLog --+-- all of it ---> read.assemble --> Recording: held
                        +-- windows -----> pieces, parts --> Recordings of windows
                        +-- one by one --> long.LongLog ---> Blocks: passed over

A stage is given a log by `inspect.screening.open_screened`, held or passed over, and
asks either the same things (`recording.UniformLog`). They are not one class for these
reasons:

- IMUs take part in the motion through one system over all samples (`imu.smoother`),
  and some effects remember more than a filter does. So such logs are held.
- Bursts, lost samples, two publishers and stamps that go back are put right by looking
  at all stamps. Logs that have any are read as a whole, whatever their length.
- A window has every channel at the log's own rate, on a time base of its own: the high
  band and events need what a cut-off takes away, and `inspect` checks what was logged.

Blocks are cut in three ways. `motion.blocks` has a fixed grid, with the memory of its
filters on either side, and thins samples to what the cut-off needs. Friction cuts
between moves, as a trial lies within one. Windows end where memory or a choice says.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from seqid_cli.being_read import being_read
from seqid_cli.errors import InputError, UsageError
from seqid_cli.logs.raw import STAMP_LIMIT_NS, BlockReader, RawLog, Stream
from seqid_cli.logs.reading import HEADER_STAMPS, LogPart, Reading
from seqid_cli.logs.storage import files
from seqid_cli.logs.tables.columns import ARROW_ERRORS, opened_table
from seqid_cli.logs.tables.siblings import siblings
from seqid_cli.logs.turns import commands_in_turns, in_turns
from seqid_cli.robot.types import Robot

# Formats of which a block is read without the rest of the log.
_BLOCKWISE = ("parquet", "mcap")
_BYTES_PER_MESSAGE = 100  # of an MCAP file that does not tell how many it holds


@dataclass(frozen=True, kw_only=True)
class LogFile:
    """A file that holds a log.

    Attributes
    ----------
    path : Path
        The log, as messages name it.
    file : Path
        What is read: the same, or the one file in the folder of a bag.
    format : str
        As of `check_log`.
    reading : Reading
        By which stamps it is read, and which part of it.
    state : State
        What differs once the file is another one.
    """

    path: Path
    file: Path
    format: str
    reading: Reading
    state: files.State

    @classmethod
    def at(cls, path: Path, *, reading: Reading = HEADER_STAMPS) -> "LogFile":
        """Look at a local log; its content tells its format.

        Raises
        ------
        InputError
            There is no log, or none that can be read.
        UsageError
            The source of its stamps is not known.
        """
        if reading.time_source not in ("header", "log"):
            raise UsageError(
                f"time source {reading.time_source!r} is not known",
                hint="Use header or log.",
            )
        kind = files.check_log(path)
        file = files.storage_file(path)
        try:
            state = files.state_of(file)
        except OSError as error:
            raise InputError(f"cannot be read ({error})", where=str(path)) from error
        return cls(path=path, file=file, format=kind, reading=reading, state=state)

    @property
    def blockwise(self) -> bool:
        """True where memory does not grow with the log, for the sake of its format."""
        return self.format in _BLOCKWISE

    @property
    def sha256(self) -> str:
        """Digest of the file; raises InputError if it is another one by now."""
        with files.unchanged(self.file, self.state):
            return self._digest

    @cached_property
    def _digest(self) -> str:
        digests = [files.sha256_of(self.file)]
        if self.format in ("csv", "parquet"):
            beside = siblings(self.file).values()
            digests += [files.sha256_of(path) for path in beside]
        if len(digests) == 1:
            return digests[0]
        # Of a log in several files.
        return hashlib.sha256("".join(digests).encode()).hexdigest()

    def blocks(self, robot: Robot) -> Iterator[RawLog]:
        """Pass over the part of the log that is used, block by block.

        Raises InputError where it cannot be read, lacks a channel or changes, or where
        nothing of it is used.
        """
        with files.unchanged(self.file, self.state):
            read_blocks = _reader_of(self.format)
            blocks = read_blocks(self.file, robot, self.reading.time_source)
            yield from self._used(blocks)

    def whole(self, robot: Robot) -> RawLog:
        """Read the part that is used as one block, positions made to run on."""
        with files.unchanged(self.file, self.state):
            read_blocks = _reader_of(self.format)
            blocks = read_blocks(self.file, robot, self.reading.time_source, rows=None)
            (raw,) = self._used(blocks)
        return running_on(raw, robot)

    def _used(self, blocks: Iterator[RawLog]) -> Iterator[RawLog]:
        """Take what is not used out of the blocks of a log."""
        reading = self.reading
        part = reading.part or (
            reading.part_of(self.sha256) if reading.part_by_sha256 else reading.part
        )
        if not part:
            yield from blocks
            return

        cut: _Cut | None = None
        n_used = 0
        first_ns = last_ns = 0
        for raw in blocks:
            if cut is None and len(raw.joints):
                first_ns = int(raw.joints.stamp_ns[0])
                cut = _Cut.of(part, first_ns)
            if cut is not None:
                last_ns = max(last_ns, int(raw.joints.stamp_ns.max(initial=0)))
                raw = cut.without(raw)
                n_used += len(raw.joints)
            yield raw
        if not n_used:
            raise InputError(
                f"nothing of it is used by {' '.join(part.words)}: it runs from"
                f" @{first_ns * 1e-9:.6f} to @{last_ns * 1e-9:.6f} s, which is"
                f" {(last_ns - first_ns) * 1e-9:.3f} s",
                hint="Give moments within it, or leave this log out.",
                where=str(self.path),
            )

    def likely_rows(self) -> int:
        """Estimate the rows without reading them; 0 where nothing tells it."""
        if self.format == "parquet":
            try:
                with being_read(self.file), opened_table(self.file) as table:
                    return int(table.metadata.num_rows)
            except ARROW_ERRORS as error:
                from seqid_cli.logs.tables.parquet import damaged

                raise damaged(self.file, error) from error
        if self.format == "mcap":
            from seqid_cli.logs.mcap.records import read_summary

            with files.unchanged(self.file, self.state), self.file.open("rb") as file:
                size = self.file.stat().st_size
                statistics = read_summary(file, size).statistics
            if statistics:
                return int(statistics.message_count)
            return size // _BYTES_PER_MESSAGE
        return 0


def _reader_of(kind: str) -> BlockReader:
    """Return the reader of a format (`check_log`) and import that of no other."""
    read_blocks: BlockReader
    if kind == "parquet":
        from seqid_cli.logs.tables.parquet import read_blocks
    elif kind == "csv":
        from seqid_cli.logs.tables.csv_file import read_blocks
    elif kind == "mcap":
        from seqid_cli.logs.mcap.reader import read_blocks
    else:
        from seqid_cli.logs.mcap.rosbags import read_blocks
    return read_blocks


@dataclass(frozen=True)
class _Cut:
    """Stamps [ns] of a log between which nothing is used, in any order."""

    ranges_ns: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, part: LogPart, first_ns: int) -> "_Cut":
        """Find what is left out of a log whose first sample has a stamp [ns]."""
        ranges = [
            (start.ns(first_ns), stop.ns(first_ns)) for start, stop in part.excluded
        ]
        if part.start is not None:
            ranges.append((-STAMP_LIMIT_NS, part.start.ns(first_ns) - 1))
        if part.stop is not None:
            ranges.append((part.stop.ns(first_ns) + 1, STAMP_LIMIT_NS))
        return cls(tuple(ranges))

    def without(self, raw: RawLog) -> RawLog:
        """Return a block without the samples between these stamps."""
        imus = {
            name: tuple(map(self._rest, streams)) for name, streams in raw.imus.items()
        }
        return replace(
            raw, joints=self._rest(raw.joints), imus=imus, cuts_ns=self.ranges_ns
        )

    def _rest(self, stream: Stream) -> Stream:
        is_used = np.ones(len(stream), np.bool_)
        for start_ns, stop_ns in self.ranges_ns:
            is_used &= (stream.stamp_ns < start_ns) | (stream.stamp_ns > stop_ns)
        return stream if is_used.all() else stream.take(is_used)


def running_on(raw: RawLog, robot: Robot) -> RawLog:
    """Make positions run on that wrap by whole turns, and say so."""
    joints, wraps_by_joint = in_turns(raw.joints, robot)
    notes = [
        f"{name}: position wraps by whole turns {count} times; it is made to run on"
        for name, count in wraps_by_joint.items()
    ]
    commands = tuple(
        commands_in_turns(stream, joints, robot) for stream in raw.commands
    )
    return replace(
        raw, joints=joints, commands=commands, warnings=(*raw.warnings, *notes)
    )


def likely_rows(path: Path) -> int:
    """Estimate the rows of a local log without reading it; 0 where nothing tells it."""
    return LogFile.at(path).likely_rows()
