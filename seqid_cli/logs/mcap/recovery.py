"""Whether a record of an MCAP file is sound, as far as its beginning tells."""

import struct
from typing import BinaryIO

from mcap.opcode import Opcode

from seqid_cli.logs.mcap.chunks import CHUNK, CHUNK_HEAD, MESSAGE_SIZE, RECORD

MAGIC = b"\x89MCAP0\r\n"
_HEAD = 96  # bytes that tell whether a record is sound
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
LARGEST = 1 << 30  # bytes of a record that is held in memory; recorders write about 1 MB
_HELD = frozenset(
    (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
)
_PRIVATE = 0x80  # opcodes from here on belong to applications


def plausible(file: BinaryIO, at: int, size: int) -> bool:
    """Tell whether a sound, whole record begins at a place.

    A kind that is not known counts if another record follows it.
    """
    file.seek(at)
    head = file.read(_HEAD)
    if len(head) < RECORD.size:
        return False
    opcode, length = RECORD.unpack_from(head)
    after = at + RECORD.size + length
    if after > size or not opcode or (opcode in _HELD and length > LARGEST):
        return False
    if opcode in _KNOWN:
        return _sound(opcode, length, head[RECORD.size :])
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
        and (len(content) < CHUNK_HEAD or _sound(opcode, length, content))
    )


def _sound(opcode: int, length: int, content: bytes) -> bool:
    """Tell whether the beginning of a record's content agrees with its length."""
    if opcode in _LENGTHS:
        return length == _LENGTHS[Opcode(opcode)]
    if opcode in _LEAST:
        return length >= _LEAST[Opcode(opcode)]
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
