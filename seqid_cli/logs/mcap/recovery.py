"""Where a damaged MCAP file goes on: the next place at which several sound records follow."""

import re
import struct
from collections.abc import Collection
from typing import BinaryIO

from mcap.opcode import Opcode

from seqid_cli.logs.mcap.chunks import CHUNK, CHUNK_HEAD, MESSAGE_SIZE, RECORD

MAGIC = b"\x89MCAP0\r\n"
_HEAD = 96  # bytes that tell whether a record is sound
_WINDOW = 1 << 20
_HOPS = 3  # sound records in a row that make a place to go on
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)  # a known kind, below 1 TB
_LENGTHS = {Opcode.DATA_END: 4, Opcode.FOOTER: 20, Opcode.SUMMARY_OFFSET: 17}
_LEAST = {
    Opcode.HEADER: 8,
    Opcode.MESSAGE: MESSAGE_SIZE,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 44,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
}
_KNOWN = frozenset(Opcode)
_PRIVATE = 0x80  # opcodes from here on belong to applications


def plausible(file: BinaryIO, at: int, size: int, channels: Collection[int] = ()) -> bool:
    """Tell whether a sound, whole record begins at a place; `channels` limits its messages.

    A kind that is not known counts if another record follows it.
    """
    file.seek(at)
    head = file.read(_HEAD)
    if len(head) < RECORD.size:
        return False
    opcode, length = RECORD.unpack_from(head)
    after = at + RECORD.size + length
    if after > size or not opcode:
        return False
    if opcode in _KNOWN:
        return _sound(opcode, length, head[RECORD.size :], channels)
    if opcode >= _PRIVATE:
        return True
    file.seek(after)
    following = file.read(RECORD.size)
    return len(following) == RECORD.size and following[0] in _KNOWN


def cut_chunk(file: BinaryIO, at: int, size: int) -> bool:
    """Tell whether a chunk begins at a place that the end of the file cuts off."""
    file.seek(at)
    head = file.read(_HEAD)
    opcode, length = RECORD.unpack_from(head)
    content = head[RECORD.size :]
    whole = at + RECORD.size + length <= size
    return (
        opcode == Opcode.CHUNK
        and not whole
        and (len(content) < CHUNK_HEAD or _sound(opcode, length, content, ()))
    )


def next_record(file: BinaryIO, at: int, size: int, channels: Collection[int]) -> int | None:
    """Find the first place from `at` on where several sound records follow each other."""
    while at < size:
        file.seek(at)
        window = file.read(_WINDOW + RECORD.size)
        for found in _CANDIDATE.finditer(window):
            if found.start() < _WINDOW and _goes_on(file, at + found.start(), size, channels):
                return at + found.start()
        at += _WINDOW
    return None


def _goes_on(file: BinaryIO, at: int, size: int, channels: Collection[int]) -> bool:
    for _ in range(_HOPS):
        if at in (size, size - len(MAGIC)):
            return True
        if not plausible(file, at, size, channels):
            return False
        file.seek(at)
        opcode, length = RECORD.unpack(file.read(RECORD.size))
        at += RECORD.size + length
        if opcode in (Opcode.FOOTER, Opcode.DATA_END):
            return True
    return True


def _sound(opcode: int, length: int, content: bytes, channels: Collection[int]) -> bool:
    """Tell whether the beginning of a record's content agrees with its length."""
    if opcode in _LENGTHS:
        return length == _LENGTHS[Opcode(opcode)]
    if opcode in _LEAST:
        known = not channels or opcode != Opcode.MESSAGE or _channel(content) in channels
        return length >= _LEAST[Opcode(opcode)] and known
    try:
        if opcode == Opcode.CHUNK:
            name = CHUNK.unpack_from(content)[-1]
            (packed,) = struct.unpack_from("<Q", content, CHUNK.size + name)
            return bool(length == CHUNK_HEAD + name + packed)
        if opcode == Opcode.MESSAGE_INDEX:
            (entries,) = struct.unpack_from("<I", content, 2)
            return bool(length == 6 + entries)
        if opcode == Opcode.SCHEMA:
            return bool(14 + struct.unpack_from("<I", content, 2)[0] <= length)
        return bool(16 + struct.unpack_from("<I", content, 4)[0] <= length)  # a channel
    except struct.error:
        return False


def _channel(content: bytes) -> int:
    return int.from_bytes(content[:2], "little")
