"""MCAP records, read from the first to the last, as far as a damaged file allows.

The index is not used: a log whose recording was cut off has none. Chunks are taken one at a time,
so memory does not grow with the file. What is lost is counted, and the rest is read.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

MAGIC_SIZE = 8
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, CRC, length of compression's name
_STEP = 1 << 20
_CHUNK_LIMIT = 1 << 30  # bytes in one unpacked chunk; recorders write about 1 MB
_PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)


class RawMessage(NamedTuple):
    """One message, not yet decoded."""

    channel: Channel
    schema: Schema | None
    log_ns: int
    data: bytes


class _Record(NamedTuple):
    opcode: int
    content: bytes
    complete: bool


@dataclass
class Scan:
    """One pass over a file: what was met on the way, and what could not be read."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages per channel
    losses: Counter[str] = field(default_factory=Counter)
    expected: int | None = None  # messages, by the file's own statistics

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of the file.

        Never raises on damaged content: it is noted in `losses`, and reading goes on behind it
        where that is possible.
        """
        finished = False
        with self.path.open("rb") as file:
            for record in _records(file, self.losses):
                if record.opcode == Opcode.DATA_END:
                    finished = True
                elif record.opcode == Opcode.STATISTICS:
                    self._statistics(record)
                elif finished:
                    continue
                elif record.opcode == Opcode.CHUNK:
                    yield from self._chunk(record)
                elif record.complete:
                    yield from self._record(record)
        if not finished and not self.losses:
            self._lost("the recording was not closed properly: the file has no end")

    def _lost(self, what: str) -> None:
        self.losses[what] += 1

    def missing(self) -> int:
        """Count the messages that the file's statistics promise and that were not met."""
        return max(0, (self.expected or 0) - sum(self.counts.values()))

    def _statistics(self, record: _Record) -> None:
        try:
            read = Statistics.read(ReadDataStream(BytesIO(record.content)))
        except _PARSE_ERRORS:
            return
        self.expected = read.message_count

    def _chunk(self, record: _Record) -> Iterator[RawMessage]:
        try:
            data, whole = _unpack(record)
        except _DamageError as damage:
            self._lost(f"a chunk of {len(record.content)} bytes was left out: {damage}")
            return
        offset = 0
        while offset + _RECORD.size <= len(data):
            opcode, length = _RECORD.unpack_from(data, offset)
            offset += _RECORD.size
            if length > len(data) - offset:
                break
            yield from self._record(_Record(opcode, data[offset : offset + length], True))
            offset += length
        if offset < len(data) and whole:
            self._lost(f"a chunk breaks off {len(data) - offset} bytes before its end")

    def _record(self, record: _Record) -> Iterator[RawMessage]:
        opcode, content, _ = record
        if opcode == Opcode.MESSAGE:
            yield from self._message(content)
            return
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(content)))
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(content)))
                self.channels.setdefault(channel.id, channel)
                self.counts.setdefault(channel.id, 0)
        except _PARSE_ERRORS:
            self._lost(f"a {Opcode(opcode).name.lower()} record is damaged")

    def _message(self, content: bytes) -> Iterator[RawMessage]:
        if len(content) < _MESSAGE.size:
            self._lost("a message record is too short")
            return
        number, _, log_ns, _ = _MESSAGE.unpack_from(content)
        channel = self.channels.get(number)
        if channel is None:
            self._lost(f"a message belongs to channel {number}, which the file lacks")
            return
        self.counts[number] += 1
        schema = self.schemas.get(channel.schema_id)
        yield RawMessage(channel, schema, log_ns, content[_MESSAGE.size :])


class _DamageError(Exception):
    """A chunk cannot be used."""


def _records(file: BinaryIO, losses: Counter[str]) -> Iterator[_Record]:
    size = file.seek(0, 2)
    position = file.seek(MAGIC_SIZE)
    checksum = zlib.crc32(b"\x89MCAP0\r\n")
    finished = False
    while True:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return
        opcode, length = _RECORD.unpack(head)
        left = size - position - _RECORD.size
        if opcode == Opcode.FOOTER:
            return
        if length > left or opcode == 0:
            if not finished:
                losses[f"the file breaks off in a record at byte {position} of {size}"] += 1
            if opcode == Opcode.CHUNK:
                yield _Record(opcode, file.read(left), False)
            return
        content, crc = _content(file, length, opcode, zlib.crc32(head, checksum))
        if opcode == Opcode.DATA_END:
            finished = True
            if int.from_bytes(content[:4], "little") not in (0, checksum):
                losses["the checksum of the data does not match: values may be damaged"] += 1
        checksum = crc
        position += _RECORD.size + length
        yield _Record(opcode, content, True)


def _content(file: BinaryIO, length: int, opcode: int, checksum: int) -> tuple[bytes, int]:
    """Read a record's content; what is not needed (attachments, say) only for the checksum."""
    if opcode in _NEEDED:
        content = file.read(length)
        return content, zlib.crc32(content, checksum)
    while length:
        piece = file.read(min(length, _STEP))
        if not piece:
            break
        checksum = zlib.crc32(piece, checksum)
        length -= len(piece)
    return b"", checksum


_NEEDED = frozenset(
    (
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.MESSAGE,
        Opcode.CHUNK,
        Opcode.DATA_END,
        Opcode.STATISTICS,
    )
)


def _unpack(record: _Record) -> tuple[bytes, bool]:
    """Return the records in a chunk, and whether they are all of them."""
    content = record.content
    if len(content) < _CHUNK.size:
        raise _DamageError("its head is incomplete")
    _, _, size, crc, length = _CHUNK.unpack_from(content)
    start = _CHUNK.size + length
    if len(content) < start + 8:
        raise _DamageError("its head is incomplete")
    name = content[_CHUNK.size : start].decode("ascii", "replace")
    (packed,) = struct.unpack_from("<Q", content, start)
    payload = content[start + 8 : start + 8 + packed]
    whole = record.complete and packed <= len(content) - start - 8
    data, fault = _decompress(name, payload, min(size, _CHUNK_LIMIT))
    if not whole:
        return data, False
    if fault:
        raise _DamageError(fault)
    if len(data) != size:
        raise _DamageError(f"it unpacks to {len(data)} bytes instead of {size}")
    if crc and zlib.crc32(data) != crc:
        raise _DamageError("its checksum does not match")
    return data, True


def _decompress(name: str, payload: bytes, limit: int) -> tuple[bytes, str]:
    """Unpack up to a fault; returns the bytes before it and what it was."""
    if name == "":
        return payload, ""
    if name not in ("zstd", "lz4"):
        raise _DamageError(f"its compression {name[:20]!r} is unknown")
    out: list[bytes] = []
    total = 0
    pieces = _zstd(payload) if name == "zstd" else _lz4(payload)
    try:
        for piece in pieces:
            out.append(piece)
            total += len(piece)
            if total > limit:
                return b"".join(out), "it unpacks to more than it declares"
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError, ValueError) as error:
        return b"".join(out), f"{name} data are damaged ({error})"
    return b"".join(out), ""


def _zstd(payload: bytes) -> Iterator[bytes]:
    with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
        while piece := reader.read(_STEP):
            yield piece


def _lz4(payload: bytes) -> Iterator[bytes]:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    piece = decompressor.decompress(payload, max_length=_STEP)
    while piece:
        yield piece
        if decompressor.eof or decompressor.needs_input:
            return
        piece = decompressor.decompress(b"", max_length=_STEP)
