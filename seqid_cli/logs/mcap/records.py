"""MCAP files, read once from the first record to the last, as far as a damaged one allows.

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
_NONE = np.zeros(0, np.int64)
# Batches and definitions that any file may have, and its bytes for each one beyond.
PIECES, PIECE_BYTES = 50_000, 50


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
    losses: Counter[str] = field(default_factory=Counter)
    remedy: str = "Copy it again from the source; `mcap doctor FILE` shows the damage."
    summary: Summary = field(default_factory=Summary)
    _unpacker: chunks.Unpacker = field(default_factory=chunks.Unpacker)
    _size: int = 0
    _pieces: int = 0

    def batches(self) -> Iterator[Batch]:
        """Yield messages in the order of the file; what is damaged is noted in `losses`."""
        with self.path.open("rb") as file:
            self._size = file.seek(0, 2)
            self.summary = read_summary(file, self._size)
            self.channels.update(self.summary.channels)
            self.schemas.update(self.summary.schemas)
            at: int | None = len(MAGIC)
            while at is not None and not self._overdone():
                at = yield from self._record(file, at)

    def _record(self, file: BinaryIO, at: int) -> Generator[Batch, None, int | None]:
        """Read the record at a place, or many loose messages; returns where the next one begins.

        One is damaged unless it ends where another may begin: bytes inside of records
        make no head.
        """
        head = _head(file, at)
        opcode, length = head or (Opcode.FOOTER, 0)
        start = at + chunks.RECORD.size
        after = start + length
        if head is None or (opcode == Opcode.FOOTER and after <= self._size):
            if not self.losses:
                self.losses[
                    "the recording was not closed properly: the file has no end"
                ] += 1
            return None
        if after > self._size or not (
            self._begins(file, at) and self._begins(file, after)
        ):
            return (yield from self._damaged(file, at, opcode, length))
        if opcode == Opcode.DATA_END:
            return None
        if opcode in _LOOSE:
            file.seek(at)
            data = np.frombuffer(file.read(max(_WINDOW, after - at)), np.uint8)
            contents = chunks.walk(data, _LOOSE)
            yield from self._contents(data, contents)
            return at + contents.end if contents.end else None
        chunk = self._indexed.get(at)
        if opcode == Opcode.CHUNK and not (chunk and self._unneeded(chunk)):
            file.seek(start)
            content = file.read(length)
            indexes = (
                file.read(min(chunk.message_index_length, LARGEST)) if chunk else b""
            )
            yield from self._chunk(content, chunks.index_offsets(indexes))
        return after

    def _damaged(
        self, file: BinaryIO, at: int, opcode: int, length: int
    ) -> Generator[Batch, None, int | None]:
        """Read what there is of a damaged chunk; goes on at the next that the summary names."""
        found = min((start for start in self._indexed if start > at), default=None)
        # its own checks tell its worth
        if opcode == Opcode.CHUNK and length <= LARGEST:
            file.seek(at + chunks.RECORD.size)
            content = file.read(min(length, (found or self._size) - at))
            yield from self._chunk(content, _NONE, complete=len(content) == length)
        what = f"the file breaks off in a record at byte {at} of {self._size}"
        if found is not None:
            what = (
                f"{found - at} damaged bytes at byte {at} of {self._size} were left out"
            )
        self.losses[what] += 1
        return found

    def _begins(self, file: BinaryIO, at: int) -> bool:
        """Tell whether a record may begin at a place: garbage is of no kind, or endless."""
        # without one it is cut here
        opcode, length = _head(file, at) or (Opcode.FOOTER, 0)
        return bool(opcode and length <= (LARGEST if opcode in _HELD else self._size))

    @cached_property
    def _indexed(self) -> dict[int, ChunkIndex]:
        """The chunks that the summary names, by their places."""
        return {chunk.chunk_start_offset: chunk for chunk in self.summary.chunk_indexes}

    def _unneeded(self, chunk: ChunkIndex) -> bool:
        """Tell whether a chunk has no messages of wanted topics."""
        numbers = chunk.message_index_offsets
        known = (self.channels.get(number) for number in numbers)
        return bool(numbers) and not any(
            one is None or self.wanted(one.topic) for one in known
        )

    def _promised(self) -> dict[int, int] | None:
        """Messages per channel by the file's own statistics; None where it does not tell."""
        told = self.summary.statistics
        return (told.channel_message_counts or None) if told else None

    def tally(self) -> tuple[int, int | None]:
        """Count the messages of wanted topics: read, and promised by the file's statistics."""
        other = {i for i, each in self.channels.items() if not self.wanted(each.topic)}
        met = sum(count for i, count in self.counts.items() if i not in other)
        promised = self._promised()
        if promised is None:
            return met, None
        return met, sum(count for i, count in promised.items() if i not in other)

    def total(self, channel: int) -> int:
        """Count the messages of a channel: those met, or of a topic not wanted those promised."""
        promised = self._promised()
        if promised is None or self.wanted(self.channels[channel].topic):
            return self.counts[channel]
        return promised.get(channel, 0)

    def _chunk(
        self, content: bytes, offsets: chunks.Integers, *, complete: bool = True
    ) -> Iterator[Batch]:
        try:
            unpacked, whole = self._unpacker.unpack(content, complete)
        except chunks.DamageError as damage:
            self.losses[f"a chunk of {len(content)} bytes was left out: {damage}"] += 1
            return
        data = np.frombuffer(unpacked, np.uint8)
        contents = chunks.by_index(data, offsets) or chunks.walk(data)
        yield from self._contents(data, contents)
        if whole and (left := len(data) - contents.end):
            self.losses[f"a chunk breaks off {left} bytes before its end"] += 1

    def _contents(self, data: Bytes, contents: chunks.Contents) -> Iterator[Batch]:
        order = np.argsort(contents.channels, kind="stable")
        turns = np.flatnonzero(np.diff(contents.channels[order])) + 1
        self._pieces += len(contents.others) + len(turns) + 1
        if self._overdone():
            self.losses["more channels and definitions than any recording has"] += 1
            return
        for opcode, start, end in contents.others:
            self._definition(opcode, data[start:end].tobytes())
        batches = np.split(order, turns) if len(order) else []
        # in the order of the file
        for rows in sorted(batches, key=lambda each: int(each[0])):
            number = int(contents.channels[rows[0]])
            if (channel := self.channels.get(number)) is None:
                what = f"a message belongs to channel {number}, which the file lacks"
                self.losses[what] += len(rows)
                continue
            self.counts[number] += len(rows)
            if self.wanted(channel.topic):
                payloads = Payloads(data, contents.starts[rows], contents.lengths[rows])
                schema = self.schemas.get(channel.schema_id)
                yield Batch(channel, schema, contents.log_ns[rows], payloads)

    def _overdone(self) -> bool:
        """Whether a few bytes of the file cost more work than any recording's."""
        return self._pieces > PIECES + self._size // PIECE_BYTES

    def _definition(self, opcode: int, content: bytes) -> None:
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


def _head(file: BinaryIO, at: int) -> tuple[int, int] | None:
    """Read the kind and the length of the record at a place; None at the end of the file."""
    file.seek(at)
    head = file.read(chunks.RECORD.size)
    return chunks.RECORD.unpack(head) if len(head) == chunks.RECORD.size else None


def read_summary(file: BinaryIO, size: int, *, most: int = 1 << 28) -> Summary:
    """Read what a file says of itself at its end; nothing if it is damaged or over `most` bytes."""
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
