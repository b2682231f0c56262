"""MCAP files, read once from the first record to the last, as far as a damaged one allows.

Chunks are taken one at a time, so memory does not grow with the file. A cut-off recording has no
summary: with one, chunks that hold nothing wanted are stepped over; without one, all are read.
What is lost is counted, and the rest is used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from seqid_cli.logs import mcap_resync
from seqid_cli.logs.checksum import crc32
from seqid_cli.logs.mcap_chunks import (
    RECORD,
    Contents,
    DamageError,
    Unpacker,
    find_messages,
    index_offsets,
    walk,
)
from seqid_cli.logs.mcap_summary import (
    MAGIC,
    PARSE_ERRORS,
    Summary,
    parse_channel,
    parse_schema,
    read_summary,
)
from seqid_cli.logs.payloads import Bytes, Payloads
from seqid_cli.logs.raw import Rows, Stamps

_STEP = 1 << 20
_WINDOW = 1 << 22  # bytes of loose messages taken together
_KEPT = frozenset((Opcode.CHUNK, Opcode.MESSAGE_INDEX))
_LOOSE = frozenset((Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL))


class RawMessage(NamedTuple):
    """One message, not yet decoded."""

    channel: Channel
    schema: Schema | None
    log_ns: int
    data: bytes


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


def _every(topic: str) -> bool:
    del topic
    return True


@dataclass
class Scan:
    """One pass over a file: what was met on the way, and what could not be read.

    `wanted` tells which topics are asked for; messages of others are neither handed out nor, where
    the file allows it, read.
    """

    path: Path
    wanted: Callable[[str], bool] = _every
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages per channel
    losses: Counter[str] = field(default_factory=Counter)
    summary: Summary = field(default_factory=Summary)
    dropped: int = 0  # messages that the indexes of lost chunks name
    _unpacker: Unpacker = field(default_factory=Unpacker)

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages one by one; see `batches`."""
        for batch in self.batches():
            for log_ns, data in zip(batch.log_ns.tolist(), batch.payloads, strict=True):
                yield RawMessage(batch.channel, batch.schema, log_ns, data)

    def batches(self) -> Iterator[Batch]:
        """Yield the messages, those of one channel in one chunk together.

        Within a channel they come in the order of the file. Never raises on damaged content: it is
        noted in `losses`, and reading goes on behind it where that is possible.
        """
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            self.summary = read_summary(file, size)
            self.channels.update(self.summary.channels)
            self.schemas.update(self.summary.schemas)
            self.counts.update(dict.fromkeys(self.channels, 0))
            walked = _Walk(file, size, self.losses, self.summary, self.wanted, self.channels)
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
            if chunk is not None:
                yield from self._chunk(chunk, index)
            if not walked.finished and not self.losses:
                self._lost("the recording was not closed properly: the file has no end")

    def expected(self) -> int | None:
        """Count the messages of wanted topics by the file's own statistics."""
        if self.summary.counts is None:
            return self.summary.messages if self.wanted is _every else None
        return sum(
            count
            for number, count in self.summary.counts.items()
            if number not in self.channels or self.wanted(self.channels[number].topic)
        )

    def missing(self) -> int:
        """Count the messages of wanted topics that the file promises and that were not met."""
        expected = self.expected()
        return self.dropped if expected is None else max(0, expected - self.met())

    def met(self) -> int:
        """Count the messages of wanted topics that were read."""
        return sum(self.counts[i] for i, each in self.channels.items() if self.wanted(each.topic))

    def total(self, channel: int) -> int:
        """Count the messages of a channel: those met, or of a topic not wanted those promised."""
        if self.summary.counts is None or self.wanted(self.channels[channel].topic):
            return self.counts[channel]
        return self.summary.counts.get(channel, 0)

    def _lost(self, what: str) -> None:
        self.losses[what] += 1

    def _chunk(self, record: _Record, index: list[bytes]) -> Iterator[Batch]:
        offsets = [found for each in index if (found := index_offsets(each)) is not None]
        try:
            unpacked, whole = self._unpacker.unpack(record.content, record.complete)
        except DamageError as damage:
            self.dropped += sum(len(found) for found in offsets)
            self._lost(f"a chunk of {len(record.content)} bytes was left out: {damage}")
            return
        data = np.frombuffer(unpacked, np.uint8)
        contents = find_messages(data, offsets)
        yield from self._contents(data, contents)
        if contents.end < len(data) and whole:
            self._lost(f"a chunk breaks off {len(data) - contents.end} bytes before its end")

    def _contents(self, data: Bytes, contents: Contents) -> Iterator[Batch]:
        for opcode, start, end in contents.others:
            self._definition(opcode, data[start:end].tobytes())
        left = numbers = contents.channels
        while len(left):  # a file has few channels
            rows = np.flatnonzero(numbers == left[0])
            yield from self._channel(int(left[0]), data, contents, rows)
            left = left[left != left[0]]

    def _channel(self, number: int, data: Bytes, contents: Contents, rows: Rows) -> Iterator[Batch]:
        log_ns = contents.log_ns[rows]
        channel = self.channels.get(number)
        if channel is None:
            what = f"a message belongs to channel {number}, which the file lacks"
            self.losses[what] += len(log_ns)
            return
        self.counts[number] += len(log_ns)
        if self.wanted(channel.topic):
            payloads = Payloads(data, contents.starts[rows], contents.lengths[rows])
            yield Batch(channel, self.schemas.get(channel.schema_id), log_ns, payloads)

    def _definition(self, opcode: int, content: bytes) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                schema = parse_schema(content)
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = parse_channel(content)
                self.channels.setdefault(channel.id, channel)
                self.counts.setdefault(channel.id, 0)
            elif opcode == Opcode.MESSAGE:
                self._lost("a message record is too short")
        except PARSE_ERRORS:
            self._lost(f"a {Opcode(opcode).name.lower()} record is damaged")


@dataclass
class _Walk:
    """Goes over the records of a file; `channels` are the ones known so far."""

    file: BinaryIO
    size: int
    losses: Counter[str]
    summary: Summary
    wanted: Callable[[str], bool]
    channels: Collection[int]
    finished: bool = False

    def __post_init__(self) -> None:
        self._skip = self.summary.unneeded(self.wanted)
        # A checksum over everything is only worth its time where everything is read.
        self._checked = bool(self.summary.checksum) and not self._skip
        self._checksum = crc32(MAGIC)

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
            if not mcap_resync.plausible(self.file, at, self.size):
                if opcode == Opcode.CHUNK and mcap_resync.cut_chunk(self.file, at, self.size):
                    self._note(f"the file breaks off in a record at byte {at} of {self.size}")
                    self.file.seek(at + RECORD.size)
                    yield _Record(opcode, self.file.read(), False)
                    return
                found = mcap_resync.next_record(self.file, at + 1, self.size, self.channels)
                if found is None:
                    self._note(f"the file breaks off in a record at byte {at} of {self.size}")
                    return
                self._note(f"{found - at} damaged bytes at byte {at} of {self.size} were left out")
                self._checked = False
                at = found
            elif opcode in _LOOSE:
                record = self._window(at, after - at)
                yield record
                at += len(record.content)
            elif (at, length) in self._skip:
                at = after
            elif opcode == Opcode.DATA_END:
                self.file.seek(at + RECORD.size)
                self._end(self.file.read(length))
            else:
                self.file.seek(at + RECORD.size)
                yield from self._one(opcode, head, length)
                at = after

    def _note(self, what: str) -> None:
        self.losses[what] += 1

    def _one(self, opcode: int, head: bytes, length: int) -> Iterator[_Record]:
        """Take a record that is no message; what is not needed only for the checksum."""
        if self._checked:
            self._checksum = crc32(head, self._checksum)
        if opcode in _KEPT:
            content = self.file.read(length)
            if self._checked:
                self._checksum = crc32(content, self._checksum)
            yield _Record(opcode, content)
            return
        while self._checked and length:
            piece = self.file.read(min(length, _STEP))
            if not piece:
                return
            self._checksum = crc32(piece, self._checksum)
            length -= len(piece)

    def _window(self, at: int, length: int) -> _Record:
        """Read the messages and definitions from `at` on, as many whole ones as fit."""
        self.file.seek(at)
        content = self.file.read(max(_WINDOW, length))
        data = np.frombuffer(content, np.uint8)
        loose = walk(data, 0, len(data), _LOOSE)
        content = content[: loose.end]
        if self._checked:
            self._checksum = crc32(content, self._checksum)
        return _Record(Opcode.MESSAGE, content, loose=loose)

    def _end(self, content: bytes) -> None:
        self.finished = True
        if self._checked and int.from_bytes(content, "little") != self._checksum:
            self._note("the checksum of the data does not match: values may be damaged")
