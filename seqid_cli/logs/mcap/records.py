"""MCAP files, read once from the first record to the last, as far as damage allows.

Chunks are taken one at a time, so memory does not grow with the file. With a summary,
which a cut-off recording lacks, chunks that hold nothing wanted are stepped over. What
is lost is counted, and the rest is used. Records are read by the library mcap, but for
messages and their indexes, of which there are too many.
"""

import struct
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, ChunkIndex, Footer, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from seqid_cli.logs.mcap import chunks
from seqid_cli.logs.messages.batch import Bytes, Payloads
from seqid_cli.logs.raw import Stamps

MAGIC = b"\x89MCAP0\r\n"
# bytes of a record that is held in memory; recorders write about 1 MB
LARGEST = 1 << 30
_ERRORS = (
    McapError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
    StopIteration,
)
_WINDOW = 1 << 22  # bytes of loose messages taken together
_LOOSE = frozenset((Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL))
_HELD = _LOOSE | {Opcode.CHUNK}
_TAIL = chunks.RECORD.size + 20 + len(MAGIC)  # the footer
_NO_OFFSETS = np.zeros(0, np.int64)
PIECES = 50_000  # batches and definitions that any file may have
PIECE_BYTES = 50  # ... and its bytes for each one beyond


class Batch(NamedTuple):
    """Messages of one channel, not yet decoded, in the order of the file."""

    channel: Channel
    schema: Schema | None
    log_ns: Stamps
    payloads: Payloads


@dataclass
class Scan:
    """One pass over a file: what was met on the way, and what could not be read."""

    path: Path
    # topics; others are not handed out nor, if it can be, read
    wanted: Callable[[str], bool]
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages per channel
    losses: Counter[str] = field(default_factory=Counter)  # how often by their texts
    remedy: str = "Copy it again from the source; `mcap doctor FILE` shows the damage."
    summary: Summary = field(default_factory=Summary)
    _unpacker: chunks.Unpacker = field(default_factory=chunks.Unpacker)
    _size: int = 0
    _pieces: int = 0

    def batches(self) -> Iterator[Batch]:
        """Yield messages in the order of the file; `losses` counts what is damaged."""
        with self.path.open("rb") as file:
            self._size = file.seek(0, 2)
            self.summary = read_summary(file, self._size)
            self.channels.update(self.summary.channels)
            self.schemas.update(self.summary.schemas)
            at: int | None = len(MAGIC)
            while at is not None and not self._costs_too_much():
                at = yield from self._record(file, at)

    def _record(self, file: BinaryIO, at: int) -> Generator[Batch, None, int | None]:
        """Read the record at a place, or many loose messages.

        A record is damaged unless it ends where another may begin: bytes inside of
        records make no head. Returns where the next one begins, None at the end.
        """
        head = _read_head(file, at)
        if head is None:
            self._note_missing_end()
            return None
        start = at + chunks.RECORD.size
        after = start + head.length
        if head.opcode == Opcode.FOOTER and after <= self._size:
            self._note_missing_end()
            return None
        is_sound = (
            after <= self._size
            and self._may_begin(file, at)
            and self._may_begin(file, after)
        )
        if not is_sound:
            return (yield from self._damaged(file, at, head))

        if head.opcode == Opcode.DATA_END:
            return None
        if head.opcode in _LOOSE:
            file.seek(at)
            data = np.frombuffer(file.read(max(_WINDOW, after - at)), np.uint8)
            contents = chunks.walk(data, _LOOSE)
            yield from self._contents(data, contents)
            return at + contents.end if contents.end else None
        index = self._chunk_index_by_start.get(at)
        is_unneeded = index is not None and self._is_unneeded(index)
        if head.opcode == Opcode.CHUNK and not is_unneeded:
            file.seek(start)
            content = file.read(head.length)
            message_indexes = b""
            if index is not None:
                message_indexes = file.read(min(index.message_index_length, LARGEST))
            yield from self._chunk(content, chunks.index_offsets(message_indexes))
        return after

    def _note_missing_end(self) -> None:
        """Note that the data have no end, unless a loss explains it already."""
        if not self.losses:
            self.losses[
                "the recording was not closed properly: the file has no end"
            ] += 1

    def _damaged(
        self, file: BinaryIO, at: int, head: "_Head"
    ) -> Generator[Batch, None, int | None]:
        """Read what there is of a damaged chunk.

        Returns where the next chunk begins that the summary names, None without any.
        """
        later = (start for start in self._chunk_index_by_start if start > at)
        next_chunk = min(later, default=None)
        # its own checks tell its worth
        if head.opcode == Opcode.CHUNK and head.length <= LARGEST:
            file.seek(at + chunks.RECORD.size)
            end = next_chunk or self._size
            content = file.read(min(head.length, end - at))
            is_complete = len(content) == head.length
            yield from self._chunk(content, _NO_OFFSETS, complete=is_complete)

        if next_chunk is None:
            loss = f"the file breaks off in a record at byte {at} of {self._size}"
        else:
            loss = (
                f"{next_chunk - at} damaged bytes at byte {at} of {self._size} were"
                " left out"
            )
        self.losses[loss] += 1
        return next_chunk

    def _may_begin(self, file: BinaryIO, at: int) -> bool:
        """Tell whether a record may begin at a place; garbage is of no kind or endless.

        The end of the file counts as well: there it was cut between two records.
        """
        head = _read_head(file, at)
        if head is None:
            return True
        longest = LARGEST if head.opcode in _HELD else self._size
        return bool(head.opcode and head.length <= longest)

    @cached_property
    def _chunk_index_by_start(self) -> dict[int, ChunkIndex]:
        return {index.chunk_start_offset: index for index in self.summary.chunk_indexes}

    def _is_unneeded(self, index: ChunkIndex) -> bool:
        """Tell whether a chunk has no messages of wanted topics."""
        numbers = index.message_index_offsets
        if not numbers:
            return False
        for number in numbers:
            channel = self.channels.get(number)
            if channel is None or self.wanted(channel.topic):
                return False
        return True

    @property
    def lists_channels(self) -> bool:
        """Whether the end of the file names all of its channels."""
        statistics = self.summary.statistics
        listed = len(self.summary.channels)
        return statistics is not None and statistics.channel_count == listed > 0

    def _promised(self) -> dict[int, int] | None:
        """Return the messages per channel by the file's statistics, None without."""
        statistics = self.summary.statistics
        if not statistics:
            return None
        return statistics.channel_message_counts or None

    def tally(self) -> tuple[int, int | None]:
        """Count the messages of wanted topics.

        Returns
        -------
        int
            Messages that were read.
        int or None
            Messages that the file's statistics promise.
        """
        unwanted = {
            number
            for number, channel in self.channels.items()
            if not self.wanted(channel.topic)
        }
        n_read = sum(n for number, n in self.counts.items() if number not in unwanted)
        promised = self._promised()
        if promised is None:
            return n_read, None
        return n_read, sum(
            n for number, n in promised.items() if number not in unwanted
        )

    def total(self, channel: int) -> int:
        """Count the messages of a channel: read, or if it is unwanted promised."""
        promised = self._promised()
        if promised is None or self.wanted(self.channels[channel].topic):
            return self.counts[channel]
        return promised.get(channel, 0)

    def _chunk(
        self, content: bytes, offsets: chunks.Integers, *, complete: bool = True
    ) -> Iterator[Batch]:
        """Unpack the content of a chunk record and yield its messages.

        `offsets` of messages are a guess by its index; they may be wrong or none.
        """
        try:
            unpacked, is_whole = self._unpacker.unpack(content, complete)
        except chunks.DamageError as damage:
            self.losses[f"a chunk of {len(content)} bytes was left out: {damage}"] += 1
            return
        data = np.frombuffer(unpacked, np.uint8)
        contents = chunks.by_index(data, offsets) or chunks.walk(data)
        yield from self._contents(data, contents)
        n_missing = len(data) - contents.end
        if is_whole and n_missing:
            self.losses[f"a chunk breaks off {n_missing} bytes before its end"] += 1

    def _contents(self, data: Bytes, contents: chunks.Contents) -> Iterator[Batch]:
        """Yield the wanted messages in a piece of a file, channel by channel."""
        order = np.argsort(contents.channels, kind="stable")
        turns = np.flatnonzero(np.diff(contents.channels[order])) + 1
        self._pieces += len(contents.others) + len(turns) + 1
        if self._costs_too_much():
            self.losses["more channels and definitions than any recording has"] += 1
            return
        for opcode, start, end in contents.others:
            self._definition(opcode, data[start:end].tobytes())

        rows_by_channel = np.split(order, turns) if len(order) else []
        # in the order of the file
        for rows in sorted(rows_by_channel, key=lambda rows: int(rows[0])):
            number = int(contents.channels[rows[0]])
            channel = self.channels.get(number)
            if channel is None:
                self.losses[
                    f"a message belongs to channel {number}, which the file lacks"
                ] += len(rows)
                continue
            self.counts[number] += len(rows)
            if self.wanted(channel.topic):
                yield Batch(
                    channel=channel,
                    schema=self.schemas.get(channel.schema_id),
                    log_ns=contents.log_ns[rows],
                    payloads=Payloads(
                        data, contents.starts[rows], contents.lengths[rows]
                    ),
                )

    def _costs_too_much(self) -> bool:
        """Tell whether few bytes of the file cost more work than any recording's."""
        return self._pieces > PIECES + self._size // PIECE_BYTES

    def _definition(self, opcode: int, content: bytes) -> None:
        """Take a schema or a channel; the first of its number counts."""
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                self.channels.setdefault(channel.id, channel)
            elif opcode == Opcode.MESSAGE:
                self.losses["a message record is too short"] += 1
        except _ERRORS:
            self.losses[f"a {Opcode(opcode).name.lower()} record is damaged"] += 1


class _Head(NamedTuple):
    """Kind and length of a record."""

    opcode: int
    length: int


def _read_head(file: BinaryIO, at: int) -> _Head | None:
    """Read the head of the record at a place; None at the end of the file."""
    file.seek(at)
    head = file.read(chunks.RECORD.size)
    if len(head) < chunks.RECORD.size:
        return None
    return _Head(*chunks.RECORD.unpack(head))


def read_summary(file: BinaryIO, size: int, *, most: int = 1 << 28) -> Summary:
    """Read what a file of `size` bytes says of itself at its end.

    Nothing is returned where it is damaged or longer than `most` bytes.
    """
    end = size - _TAIL
    if end < len(MAGIC):
        return Summary()
    try:
        file.seek(end)
        footer = next(StreamReader(file, skip_magic=True).records)
        file.seek(size - len(MAGIC))
        if not isinstance(footer, Footer) or file.read() != MAGIC:
            return Summary()
        start = footer.summary_start or end
        if not len(MAGIC) <= start <= end or end - start > most:
            return Summary()

        file.seek(start)
        to_checksum = chunks.RECORD.size + 16  # in the footer
        content = file.read(end - start + to_checksum)
        if footer.summary_crc not in (0, crc32(content)):
            return Summary()
        file.seek(0)
        return SeekingReader(file, record_size_limit=most).get_summary() or Summary()
    except _ERRORS:
        return Summary()
