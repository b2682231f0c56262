"""What is inside a chunk: unpacking, and where its messages lie.

The index behind a chunk is a guess of where its messages begin: they must follow each
other there without a hole and fill the chunk, else it is walked record by record, with
the same result.
"""

import struct
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from numpy.typing import NDArray

from seqid_cli.logs.messages.batch import Bytes

RECORD = struct.Struct("<BQ")
# first and last time, size, CRC, length of compression's name
CHUNK = struct.Struct("<QQQII")
# with the size of the packed data, without the compression's name
CHUNK_HEAD = CHUNK.size + 8
MESSAGE_SIZE = 22  # channel, sequence, log time, publish time
# of a message's record behind the opcode: length; channel, sequence; rest of log time
_WORDS = 3
_INDEX = struct.Struct("<HI")
_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])
_LIMIT = 1 << 30  # bytes in one unpacked chunk; recorders write about 1 MB
# bytes that any log may have; of one packed byte beyond them
SMALL, MOST_TIMES = 16 << 20, 200
_HEAD = RECORD.size + MESSAGE_SIZE

Integers = NDArray[np.int64]
Words = NDArray[np.uint64]


def allowed(packed: int) -> int:
    """Bytes that so many packed ones of a log may become: no sensor repeats itself like that."""
    return SMALL + MOST_TIMES * packed


class DamageError(Exception):
    """A chunk cannot be used."""


class Record(NamedTuple):
    """A record's kind and where its content lies."""

    opcode: int
    start: int
    end: int


class Contents(NamedTuple):
    """Messages in a piece of a file, its other records, and where the last whole one ends."""

    channels: NDArray[np.uint16]
    log_ns: Integers
    starts: Integers
    lengths: Integers
    others: list[Record]
    end: int


class Unpacker:
    """Unpacks the chunks of one file; keeps the decompressor, which is costly to make."""

    def __init__(self) -> None:
        self._zstd = zstandard.ZstdDecompressor()
        self._packed = self._unpacked = 0

    def unpack(self, content: bytes, complete: bool) -> tuple[bytes, bool]:
        """Return the records in the content of a chunk record, and whether they are all.

        Of a record that is not `complete` what is there is unpacked. Raises
        DamageError.
        """
        if len(content) < CHUNK_HEAD:
            raise DamageError("its head is incomplete")
        _, _, size, crc, length = CHUNK.unpack_from(content)
        start = CHUNK_HEAD + length
        if len(content) < start:
            raise DamageError("its head is incomplete")
        name = content[CHUNK.size : CHUNK.size + length].decode("ascii", "replace")
        (packed,) = struct.unpack_from("<Q", content, start - 8)
        payload = memoryview(content)[start : start + packed]
        self._packed += len(payload)
        if self._unpacked + size > allowed(self._packed):
            raise DamageError(
                f"it unpacks to {size} bytes, {size // max(len(payload), 1)} times"
            )
        self._unpacked += size
        whole = complete and packed <= len(content) - start
        data, fault = self._decompress(name, payload, min(size, _LIMIT))
        if not whole:
            return data, False
        if fault:
            raise DamageError(fault)
        if len(data) != size:
            raise DamageError(f"it unpacks to {len(data)} bytes instead of {size}")
        if crc and crc32(data) != crc:
            raise DamageError("its checksum does not match")
        return data, True

    def _decompress(
        self, name: str, payload: memoryview, size: int
    ) -> tuple[bytes, str]:
        """Unpack up to a byte more than `size`; returns what there is, and what is wrong."""
        if name == "":
            return bytes(payload), ""
        try:
            if name == "zstd":
                with self._zstd.stream_reader(payload) as reader:
                    return reader.read(size + 1), ""
            if name == "lz4":
                return (
                    lz4.frame.LZ4FrameDecompressor().decompress(payload, size + 1),
                    "",
                )
        except (
            zstandard.ZstdError,
            RuntimeError,
            EOFError,
            MemoryError,
            ValueError,
        ) as error:
            return b"", f"{name} data are damaged ({error})"
        raise DamageError(f"its compression {name[:20]!r} is unknown")


def index_offsets(records: bytes) -> Integers:
    """Read the offsets in the MessageIndex records behind a chunk, sorted."""
    found, at = [np.zeros(0, np.int64)], 0
    while at + RECORD.size + _INDEX.size <= len(records):
        opcode, length = RECORD.unpack_from(records, at)
        at += RECORD.size
        _, size = _INDEX.unpack_from(records, at)
        entries = records[at + _INDEX.size : at + length]
        if (
            opcode == Opcode.MESSAGE_INDEX
            and size == len(entries)
            and not size % _ENTRY.itemsize
        ):
            found.append(np.frombuffer(entries, _ENTRY)["offset"].astype(np.int64))
        at += length
    return np.sort(np.concatenate(found), kind="stable")


def walk(
    data: Bytes, only: frozenset[int] | None = None, most: int = 100_000
) -> Contents:
    """Find records while they are of a kind, up to `most` that are no messages."""
    view, unpack, size = data.data, RECORD.unpack_from, RECORD.size
    messages: list[int] = []
    others: list[Record] = []
    at = 0
    while at + size <= len(data):
        opcode, length = unpack(view, at)
        after = at + size + length
        if (
            after > len(data)
            or (only is not None and opcode not in only)
            or len(others) > most
        ):
            break
        if opcode == Opcode.MESSAGE and length >= MESSAGE_SIZE:
            messages.append(at)
        else:  # also a message without room for its head
            others.append(Record(opcode, at + size, after))
        at = after
    offsets = np.array(messages, np.int64)
    return _contents(offsets, others, at, _heads(data, offsets))


def by_index(data: Bytes, offsets: Integers) -> Contents | None:
    """Find messages at sorted offsets; None unless they follow each other and fill the chunk."""
    if not len(offsets) or offsets[0] != 0 or offsets[-1] > len(data) - _HEAD:
        return None
    heads = _heads(data, offsets)
    lengths = heads[0]
    sound = (
        (data[offsets] == Opcode.MESSAGE)
        & (lengths >= MESSAGE_SIZE)
        & (lengths <= len(data))
    )
    ends = offsets + lengths.astype(np.int64) + RECORD.size
    if not sound.all() or ends[-1] != len(data) or (ends[:-1] != offsets[1:]).any():
        return None
    return _contents(offsets, [], len(data), heads)


def _contents(
    offsets: Integers, others: list[Record], end: int, heads: Words
) -> Contents:
    lengths = heads[0].astype(np.int64) - MESSAGE_SIZE
    log_ns = (heads[1] >> np.uint64(48)) | (heads[2] << np.uint64(16))
    channels = heads[1].astype(np.uint16)  # its lowest 16 bits
    return Contents(
        channels, log_ns.view(np.int64), offsets + _HEAD, lengths, others, end
    )


def _heads(data: Bytes, offsets: Integers) -> Words:
    """Copy the heads of message records without their opcodes, (3, M) words."""
    size = 8 * _WORDS
    if not len(offsets):
        return np.zeros((_WORDS, 0), np.uint64)
    every = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    words = every[offsets + 1].view("<u8").reshape(len(offsets), _WORDS)
    return words.T.astype(np.uint64, order="C")
