"""MCAP files, read once from the first record to the last, as far as a damaged one allows.

Chunks are taken one at a time, so memory does not grow with the file. A cut-off recording has no
summary: with one, chunks that hold nothing wanted are stepped over; without one, all are read.
What is lost is counted, and the rest is used. The records themselves are read by the library mcap,
but for messages and their indexes, of which there are too many.
"""

import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Footer, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from seqid_cli.logs.mcap.chunks import (
    RECORD,
    Contents,
    DamageError,
    Unpacker,
    by_index,
    index_offsets,
    walk,
)
from seqid_cli.logs.messages.batch import Bytes, Payloads
from seqid_cli.logs.raw import Stamps

MAGIC = b"\x89MCAP0\r\n"
LARGEST = 1 << 30  # bytes of a record that is held in memory; recorders write about 1 MB
_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError, StopIteration)
_STEP = 1 << 20
_WINDOW = 1 << 22  # bytes of loose messages taken together
_KEPT = frozenset((Opcode.CHUNK, Opcode.MESSAGE_INDEX))
_LOOSE = frozenset((Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL))
_HELD = _KEPT | _LOOSE
_TAIL = RECORD.size + 20 + len(MAGIC)  # the footer
_DATA_END = RECORD.size + 4
# Batches and definitions that any file may have, and its bytes for each one beyond.
PIECES, PIECE_BYTES = 50_000, 50


class Batch(NamedTuple):
    """Messages of one channel, not yet decoded, in the order of the file."""

    channel: Channel
    schema: Schema | None
    log_ns: Stamps
    payloads: Payloads


class _Record(NamedTuple):
    opcode: int
    content: bytes
    complete: bool = True
    loose: Contents | None = None  # records that stand in no chunk, with their heads


@dataclass
class Scan:
    """One pass over a file: what was met on the way, and what could not be read."""

    path: Path
    wanted: Callable[[str], bool]  # topics; others are not handed out nor, if it can be, read
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages per channel
    losses: Counter[str] = field(default_factory=Counter)
    remedy: str = "Copy it again from the source; `mcap doctor FILE` shows the damage."
    summary: Summary = field(default_factory=Summary)
    dropped: int = 0  # messages that the indexes of lost chunks name
    _unpacker: Unpacker = field(default_factory=Unpacker)
    _size: int = 0
    _pieces: int = 0

    def batches(self) -> Iterator[Batch]:
        """Yield messages in the order of the file, those of one channel in one chunk together.

        Never raises on damaged content: it is noted in `losses`, and reading goes on behind it.
        """
        with self.path.open("rb") as file:
            size = self._size = file.seek(0, 2)
            self.summary, checksum = read_summary(file, size)
            self.channels.update(self.summary.channels)
            self.schemas.update(self.summary.schemas)
            chunks = [each.chunk_start_offset for each in self.summary.chunk_indexes]
            # A checksum over everything is only worth its time where everything is read.
            unneeded = self._unneeded()
            checksum = 0 if unneeded else checksum
            walked = _Walk(file, size, self.losses, chunks, unneeded, checksum)
            chunk: _Record | None = None
            index: list[bytes] = []
            for record in walked.records():
                if record.opcode == Opcode.MESSAGE_INDEX:
                    index.append(record.content)
                    continue
                if chunk is not None:
                    yield from self._chunk(chunk, index)
                chunk, index = None, []
                if record.loose is not None:
                    data = np.frombuffer(record.content, np.uint8)
                    yield from self._contents(data, record.loose)
                elif record.opcode == Opcode.CHUNK:
                    chunk = record
                if self._overdone():
                    return
            if chunk is not None:
                yield from self._chunk(chunk, index)
            if not walked.finished and not self.losses:
                self.losses["the recording was not closed properly: the file has no end"] += 1

    def _unneeded(self) -> frozenset[tuple[int, int]]:
        """Find chunks without messages of wanted topics: (position, length of the record)."""
        known = {number for number, each in self.channels.items() if not self.wanted(each.topic)}
        return frozenset(
            (chunk.chunk_start_offset, chunk.chunk_length - RECORD.size)
            for chunk in self.summary.chunk_indexes
            if chunk.message_index_offsets and chunk.message_index_offsets.keys() <= known
        )

    def _promised(self) -> dict[int, int] | None:
        """Messages per channel by the file's own statistics; None where it does not tell."""
        told = self.summary.statistics
        return (told.channel_message_counts or None) if told else None

    def tally(self) -> tuple[int, int | None, int]:
        """Count the messages of wanted topics: read, promised by the file's statistics, lost."""
        known = self.channels
        met = sum(self.counts[i] for i, each in known.items() if self.wanted(each.topic))
        promised = self._promised()
        if promised is None:
            return met, None, self.dropped
        expected = sum(
            count for i, count in promised.items() if i not in known or self.wanted(known[i].topic)
        )
        return met, expected, max(0, expected - met)

    def total(self, channel: int) -> int:
        """Count the messages of a channel: those met, or of a topic not wanted those promised."""
        promised = self._promised()
        if promised is None or self.wanted(self.channels[channel].topic):
            return self.counts[channel]
        return promised.get(channel, 0)

    def _chunk(self, record: _Record, index: list[bytes]) -> Iterator[Batch]:
        offsets = [found for each in index if (found := index_offsets(each)) is not None]
        try:
            unpacked, whole = self._unpacker.unpack(record.content, record.complete)
        except DamageError as damage:
            self.dropped += sum(len(found) for found in offsets)
            self.losses[f"a chunk of {len(record.content)} bytes was left out: {damage}"] += 1
            return
        data = np.frombuffer(unpacked, np.uint8)
        every = np.sort(np.concatenate([np.zeros(0, np.int64), *offsets]), kind="stable")
        contents = by_index(data, every) or walk(data, 0, len(data))
        yield from self._contents(data, contents)
        if contents.end < len(data) and whole:
            left = len(data) - contents.end
            self.losses[f"a chunk breaks off {left} bytes before its end"] += 1

    def _contents(self, data: Bytes, contents: Contents) -> Iterator[Batch]:
        order = np.argsort(contents.channels, kind="stable")
        turns = np.flatnonzero(np.diff(contents.channels[order])) + 1
        self._pieces += len(contents.others) + len(turns) + 1
        if self._overdone():
            self.losses["more channels and definitions than any recording has"] += 1
            return
        for opcode, start, end in contents.others:
            self._definition(opcode, data[start:end].tobytes())
        batches = np.split(order, turns) if len(order) else []
        for rows in sorted(batches, key=lambda each: int(each[0])):  # in the order of the file
            number = int(contents.channels[rows[0]])
            channel = self.channels.get(number)
            if channel is None:
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


def read_summary(file: BinaryIO, size: int, *, most: int = 1 << 28) -> tuple[Summary, int]:
    """Read what a file says of itself at its end, and the checksum of its data section.

    It only tells what can be left out. A summary of more than `most` bytes, or that is damaged, is
    empty; the checksum is 0 where none was written.
    """
    end = size - _TAIL
    if end < len(MAGIC):
        return Summary(), 0
    try:
        file.seek(end)
        footer = next(StreamReader(file, skip_magic=True).records)
        file.seek(size - len(MAGIC))
        if not isinstance(footer, Footer) or file.read() != MAGIC:
            return Summary(), 0
        start = footer.summary_start or end
        if not len(MAGIC) + _DATA_END <= start <= end or end - start > most:
            return Summary(), 0
        file.seek(start - _DATA_END)
        content = file.read(_DATA_END + end - start + RECORD.size + 16)
        if footer.summary_crc not in (0, crc32(memoryview(content)[_DATA_END:])):
            return Summary(), 0
        opcode, length, checksum = struct.unpack_from("<BQI", content)
        if opcode != Opcode.DATA_END or length != 4:
            return Summary(), 0
        file.seek(0)
        return SeekingReader(file, record_size_limit=most).get_summary() or Summary(), checksum
    except _ERRORS:
        return Summary(), 0


@dataclass
class _Walk:
    """Goes over the records of a file; behind damage it goes on at the next of the `chunks`.

    A record is taken for damaged unless it ends where another may begin: a wrong length leads into
    the middle of others, whose bytes make no head. Whole chunks in front of damage have checks of
    their own. Those of `skip` are not needed; `checksum` is that of the data section, 0 where it is
    not to be compared.
    """

    file: BinaryIO
    size: int
    losses: Counter[str]
    chunks: Collection[int]
    skip: frozenset[tuple[int, int]]
    checksum: int
    finished: bool = False
    _sum: int = crc32(MAGIC)

    def records(self) -> Iterator[_Record]:
        """Yield what is needed of the data section; loose messages come many in one record."""
        at = len(MAGIC)
        while not self.finished and at + RECORD.size <= self.size:
            self.file.seek(at)
            head = self.file.read(RECORD.size)
            if len(head) < RECORD.size:
                return
            opcode, length = RECORD.unpack(head)
            after = at + RECORD.size + length
            if opcode == Opcode.FOOTER and after <= self.size:
                return
            if after > self.size or not (self._begins(at) and self._begins(after)):
                found = min((chunk for chunk in self.chunks if chunk > at), default=None)
                if opcode == Opcode.CHUNK and length <= LARGEST:  # its own checks tell its worth
                    self.file.seek(at + RECORD.size)
                    content = self.file.read(min(length, (found or self.size) - at))
                    yield _Record(opcode, content, len(content) == length)
                if found is None:
                    self.losses[f"the file breaks off in a record at byte {at} of {self.size}"] += 1
                    return
                what = f"{found - at} damaged bytes at byte {at} of {self.size} were left out"
                self.losses[what] += 1
                self.checksum = 0
                at = found
            elif opcode in _LOOSE:
                record = self._window(at, after - at)
                yield record
                at += len(record.content)
            elif (at, length) in self.skip:
                at = after
            elif opcode == Opcode.DATA_END:
                self.finished = True
                if self.checksum and self.checksum != self._sum:
                    what = "the checksum of the data does not match: values may be damaged"
                    self.losses[what] += 1
            else:
                self.file.seek(at + RECORD.size)
                yield from self._one(opcode, head, length)
                at = after

    def _begins(self, at: int) -> bool:
        """Tell whether a record may begin at a place: garbage is of no kind, or endless."""
        self.file.seek(at)
        head = self.file.read(RECORD.size)
        if len(head) < RECORD.size:
            return True  # the file is cut here
        opcode, length = RECORD.unpack(head)
        return bool(opcode and length <= (LARGEST if opcode in _HELD else self.size))

    def _one(self, opcode: int, head: bytes, length: int) -> Iterator[_Record]:
        """Take a record that is no message; what is not needed only for the checksum."""
        if opcode in _KEPT:
            content = self.file.read(length)
            self._add(head)
            self._add(content)
            yield _Record(opcode, content)
            return
        self._add(head)
        while self.checksum and length:
            piece = self.file.read(min(length, _STEP))
            if not piece:
                return
            self._add(piece)
            length -= len(piece)

    def _add(self, content: bytes) -> None:
        if self.checksum:
            self._sum = crc32(content, self._sum)

    def _window(self, at: int, length: int) -> _Record:
        """Read the messages and definitions from `at` on, as many whole ones as fit."""
        self.file.seek(at)
        content = self.file.read(max(_WINDOW, length))
        data = np.frombuffer(content, np.uint8)
        loose = walk(data, 0, len(data), _LOOSE)
        content = content[: loose.end]
        self._add(content)
        return _Record(Opcode.MESSAGE, content, loose=loose)
