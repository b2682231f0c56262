"""The summary at the end of an MCAP file: what is where, as far as it can be trusted.

Nothing is read because the summary says that it is there; it only tells what can be left out.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from seqid_cli.logs.checksum import crc32
from seqid_cli.logs.mcap_chunks import RECORD

MAGIC = b"\x89MCAP0\r\n"
PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)
_FOOTER = struct.Struct("<QQI")  # where summary and its offsets begin, CRC
_TAIL = RECORD.size + _FOOTER.size + len(MAGIC)
_DATA_END = RECORD.size + 4
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last time, where, length, bytes of the map
_LIMIT = 1 << 28  # bytes


@dataclass(frozen=True)
class Summary:
    """What a file says of itself.

    `counts` are messages per channel, None where the file does not tell. `checksum` is that of the
    data section, 0 where none was written.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] | None = None
    messages: int | None = None
    checksum: int = 0
    chunks: dict[int, tuple[int, frozenset[int]]] = field(default_factory=dict)

    def unneeded(self, wanted: Callable[[str], bool]) -> frozenset[tuple[int, int]]:
        """Find chunks without messages of wanted topics: (position, length of the record)."""
        known = {number for number, channel in self.channels.items() if not wanted(channel.topic)}
        return frozenset(
            (position, length)
            for position, (length, channels) in self.chunks.items()
            if channels and channels <= known
        )


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Read the summary; an empty one where there is none or where it is damaged."""
    if size < 2 * len(MAGIC) + _TAIL:
        return Summary()
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    opcode, length = RECORD.unpack_from(tail)
    if opcode != Opcode.FOOTER or length != _FOOTER.size or not tail.endswith(MAGIC):
        return Summary()
    start, _, crc = _FOOTER.unpack_from(tail, RECORD.size)
    end = size - _TAIL
    start = start or end
    if not len(MAGIC) + _DATA_END <= start <= end or end - start > _LIMIT:
        return Summary()
    file.seek(start - _DATA_END)
    content = file.read(_DATA_END + end - start)
    opcode, length = RECORD.unpack_from(content)
    section = memoryview(content)[_DATA_END:]
    checked = crc32(tail[: RECORD.size + 16], crc32(section))
    if opcode != Opcode.DATA_END or length != 4 or crc not in (0, checked):
        return Summary()
    checksum = int.from_bytes(content[RECORD.size : _DATA_END], "little")
    try:
        return _parse(section, checksum)
    except PARSE_ERRORS:
        return Summary(checksum=checksum)


def _parse(section: memoryview, checksum: int) -> Summary:
    summary, statistics = Summary(checksum=checksum), None
    for opcode, content in _records(section):
        if opcode == Opcode.SCHEMA:
            schema = parse_schema(content)
            summary.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = parse_channel(content)
            summary.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(content)))
        elif opcode == Opcode.CHUNK_INDEX:
            _, _, position, length, size = _CHUNK_INDEX.unpack_from(content)
            entries = content[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size]
            numbers = np.frombuffer(entries, [("channel", "<u2"), ("at", "<u8")])["channel"]
            summary.chunks[position] = (length - RECORD.size, frozenset(numbers.tolist()))
    if statistics is None:
        return summary
    counts = statistics.channel_message_counts or None
    return Summary(
        summary.schemas,
        summary.channels,
        counts,
        statistics.message_count,
        checksum,
        summary.chunks,
    )


def _records(section: memoryview) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + RECORD.size <= len(section):
        opcode, length = RECORD.unpack_from(section, at)
        at += RECORD.size
        if at + length > len(section):
            raise ValueError("the summary breaks off")
        yield opcode, bytes(section[at : at + length])
        at += length


def parse_schema(content: bytes) -> Schema:
    """Read a schema record; raises one of `PARSE_ERRORS` on damage."""
    schema: Schema = Schema.read(ReadDataStream(BytesIO(content)))
    return schema


def parse_channel(content: bytes) -> Channel:
    """Read a channel record; raises one of `PARSE_ERRORS` on damage."""
    channel: Channel = Channel.read(ReadDataStream(BytesIO(content)))
    return channel
