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

RECORD = struct.Struct("<BQ")  # opcode, length
# first and last time, size, CRC, length of compression's name
CHUNK = struct.Struct("<QQQII")
# with the size of the packed data, without the compression's name
CHUNK_HEAD = CHUNK.size + 8
MESSAGE_SIZE = 22  # channel, sequence, log time, publish time
# of a message's record behind the opcode: length; channel, sequence; rest of log time
_WORDS = 3
_INDEX = struct.Struct("<HI")  # channel, bytes of the entries
_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])
_LIMIT = 1 << 30  # bytes in one unpacked chunk; recorders write about 1 MB
SMALL = 16 << 20  # bytes that any log may have when it is unpacked
MOST_TIMES = 200  # ... and beyond them, of one packed byte
_HEAD = RECORD.size + MESSAGE_SIZE

Integers = NDArray[np.int64]
Words = NDArray[np.uint64]


def allowed(packed: int) -> int:
    """Return the bytes that so many packed ones of a log may become.

    No sensor repeats itself like data that unpack to more.
    """
    return SMALL + MOST_TIMES * packed


class DamageError(Exception):
    """A chunk cannot be used."""


class Record(NamedTuple):
    """A record's kind and where its content lies."""

    opcode: int
    start: int
    end: int


class Contents(NamedTuple):
    """M messages in a piece of a file, and its other records."""

    channels: NDArray[np.uint16]  # (M,)
    log_ns: Integers  # (M,)
    starts: Integers  # (M,) bytes at which payloads begin
    lengths: Integers  # (M,) of payloads
    others: list[Record]
    end: int  # where the last whole record ends


class Unpacker:
    """Unpacks the chunks of one file by one decompressor, which is costly to make."""

    def __init__(self) -> None:
        self._zstd = zstandard.ZstdDecompressor()
        self._n_packed = 0  # bytes so far
        self._n_unpacked = 0

    def unpack(self, content: bytes, complete: bool) -> tuple[bytes, bool]:
        """Return the records in a chunk record's content, and whether they are all.

        Of a record that is not `complete` what is there is unpacked. Raises
        DamageError.
        """
        if len(content) < CHUNK_HEAD:
            raise DamageError("its head is incomplete")
        _, _, size, crc, name_length = CHUNK.unpack_from(content)
        start = CHUNK_HEAD + name_length
        if len(content) < start:
            raise DamageError("its head is incomplete")
        name_bytes = content[CHUNK.size : CHUNK.size + name_length]
        compression = name_bytes.decode("ascii", "replace")
        (n_packed,) = struct.unpack_from("<Q", content, start - 8)
        payload = memoryview(content)[start : start + n_packed]

        self._n_packed += len(payload)
        if self._n_unpacked + size > allowed(self._n_packed):
            times = size // max(len(payload), 1)
            raise DamageError(f"it unpacks to {size} bytes, {times} times")
        self._n_unpacked += size

        data, fault = self._decompress(compression, payload, min(size, _LIMIT))
        is_whole = complete and n_packed <= len(content) - start
        if not is_whole:
            return data, False
        if fault:
            raise DamageError(fault)
        if len(data) != size:
            raise DamageError(f"it unpacks to {len(data)} bytes instead of {size}")
        if crc and crc32(data) != crc:
            raise DamageError("its checksum does not match")
        return data, True

    def _decompress(
        self, compression: str, payload: memoryview, size: int
    ) -> tuple[bytes, str]:
        """Unpack up to a byte more than `size`; returns the data, and what is wrong."""
        if compression == "":
            return bytes(payload), ""
        try:
            if compression == "zstd":
                with self._zstd.stream_reader(payload) as reader:
                    return reader.read(size + 1), ""
            if compression == "lz4":
                lz4_decompressor = lz4.frame.LZ4FrameDecompressor()
                return lz4_decompressor.decompress(payload, size + 1), ""
        except (
            zstandard.ZstdError,
            RuntimeError,
            EOFError,
            MemoryError,
            ValueError,
        ) as error:
            return b"", f"{compression} data are damaged ({error})"
        raise DamageError(f"its compression {compression[:20]!r} is unknown")


def index_offsets(records: bytes) -> Integers:
    """Read the offsets in the MessageIndex records behind a chunk, sorted."""
    parts = [np.zeros(0, np.int64)]
    at = 0
    while at + RECORD.size + _INDEX.size <= len(records):
        opcode, length = RECORD.unpack_from(records, at)
        at += RECORD.size
        _, size = _INDEX.unpack_from(records, at)
        entries = records[at + _INDEX.size : at + length]
        is_whole = size == len(entries) and size % _ENTRY.itemsize == 0
        if opcode == Opcode.MESSAGE_INDEX and is_whole:
            parts.append(np.frombuffer(entries, _ENTRY)["offset"].astype(np.int64))
        at += length
    return np.sort(np.concatenate(parts), kind="stable")


def walk(
    data: Bytes, only: frozenset[int] | None = None, most: int = 100_000
) -> Contents:
    """Find the records in data one after the other.

    Parameters
    ----------
    only : frozenset of int, optional
        Opcodes: the walk ends at a record of another kind.
    most : int
        Records that are no messages, behind which it ends as well.
    """
    # Names of its own: this loop runs for every message of a file without indexes.
    view = data.data
    unpack = RECORD.unpack_from
    size = RECORD.size
    messages: list[int] = []
    others: list[Record] = []
    at = 0
    while at + size <= len(data):
        opcode, length = unpack(view, at)
        after = at + size + length
        is_of_kind = only is None or opcode in only
        if after > len(data) or not is_of_kind or len(others) > most:
            break
        if opcode == Opcode.MESSAGE and length >= MESSAGE_SIZE:
            messages.append(at)
        else:  # also a message without room for its head
            others.append(Record(opcode, at + size, after))
        at = after
    offsets = np.array(messages, np.int64)
    return _contents(offsets, others, at, _heads(data, offsets))


def by_index(data: Bytes, offsets: Integers) -> Contents | None:
    """Find messages at sorted offsets; None unless they fill the chunk seamlessly."""
    if not len(offsets) or offsets[0] != 0 or offsets[-1] > len(data) - _HEAD:
        return None
    heads = _heads(data, offsets)
    lengths = heads[0]
    is_message = (
        (data[offsets] == Opcode.MESSAGE)
        & (lengths >= MESSAGE_SIZE)
        & (lengths <= len(data))
    )
    if not is_message.all():
        return None
    ends = offsets + lengths.astype(np.int64) + RECORD.size
    if ends[-1] != len(data) or (ends[:-1] != offsets[1:]).any():
        return None
    return _contents(offsets, [], len(data), heads)


def _contents(
    offsets: Integers, others: list[Record], end: int, heads: Words
) -> Contents:
    """Read channel, time and length of messages out of the words of their heads."""
    # The log time begins in the last two bytes of the second word.
    log_ns = (heads[1] >> np.uint64(48)) | (heads[2] << np.uint64(16))
    return Contents(
        channels=heads[1].astype(np.uint16),  # its lowest 16 bits
        log_ns=log_ns.view(np.int64),
        starts=offsets + _HEAD,
        lengths=heads[0].astype(np.int64) - MESSAGE_SIZE,
        others=others,
        end=end,
    )


def _heads(data: Bytes, offsets: Integers) -> Words:
    """Copy the heads of message records without their opcodes, (3, M) words."""
    if not len(offsets):
        return np.zeros((_WORDS, 0), np.uint64)
    # A view of the bytes from every place on, of which those at the offsets are taken.
    size = 8 * _WORDS
    n_places = len(data) - size + 1
    windows = np.ndarray((n_places,), f"V{size}", data, strides=(1,))
    words = windows[offsets + 1].view("<u8").reshape(len(offsets), _WORDS)
    return words.T.astype(np.uint64, order="C")
