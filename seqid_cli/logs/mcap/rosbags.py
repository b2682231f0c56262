"""ROS bags, version 1 and the SQLite files of version 2, by the optional library rosbags."""

import bz2
import importlib
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
import msgspec
import numpy as np
import zstandard
from mcap.records import Channel, Schema, Statistics

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap import reader
from seqid_cli.logs.mcap.chunks import allowed
from seqid_cli.logs.mcap.records import Batch, Scan
from seqid_cli.logs.messages.batch import Payloads

_KEPT = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "control_msgs/msg/DynamicJointState",
)
_ROSBAG1 = b"#ROSBAG V2.0"
_ZSTD, _LZ4 = b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18"
_COMPUTED = re.compile(r"\bAS\s*\(", re.IGNORECASE)  # a generated column
_MESSAGE_LIMIT = 1 << 24  # bytes of one unpacked message
_OVERHEAD = 200  # bytes that a message costs beside its own
# bytes of one unpacked chunk of a ROS 1 bag; recorders write about 1 MB
_CHUNK_LIMIT = 1 << 28
_AGAIN = "or copy it again from the source."
_REMEDY1 = f"Run `rosbag reindex FILE`, {_AGAIN}"
_REMEDY2 = f"Salvage it: `sqlite3 FILE .recover | sqlite3 NEW.db3`, {_AGAIN}"
_Message = tuple[int, int, bytes]  # number of its channel, time [ns], CDR
_Topic = tuple[Channel, Schema, int]  # the last: its messages
_Bag = tuple[list[_Topic], Callable[[], Iterator[_Message]]]  # an opened bag
_Wanted = Callable[[str], bool]


@dataclass
class BagScan(Scan):
    """One pass over a ROS 1 bag, or the SQLite file of a ROS 2 bag; see `Scan`."""

    def batches(self) -> Iterator[Batch]:
        """Yield the messages up to a fault; those of one topic, some at a time, together."""
        with self.path.open("rb") as file:
            first = file.read(len(_ROSBAG1)) == _ROSBAG1
        self.remedy = _REMEDY1 if first else _REMEDY2
        self.losses.update(_unmerged(self.path))
        with ExitStack() as stack:
            try:
                opened = (_rosbag1 if first else _rosbag2)(self.path, self.wanted)
                topics, messages = stack.enter_context(opened)
            except InputError:
                raise
            except Exception as error:  # whatever the library raises on a damaged bag
                message = f"the bag cannot be read ({_reason(error)})"
                raise InputError(
                    message, hint=self.remedy, where=str(self.path)
                ) from error
            counts = {channel.id: count for channel, _, count in topics}
            total = sum(counts.values())
            self.summary.statistics = Statistics(
                0, len(topics), counts, 0, total, 0, 0, 0, 0
            )
            self.channels.update({channel.id: channel for channel, *_ in topics})
            self.schemas.update({schema.id: schema for _, schema, _ in topics})
            for part in _together(self._sound(messages())):
                for number in dict.fromkeys(message[0] for message in part):
                    own = [message for message in part if message[0] == number]
                    self.counts[number] += len(own)
                    log_ns = np.array([max(0, message[1]) for message in own], np.int64)
                    payloads = Payloads.of([message[2] for message in own])
                    yield Batch(
                        self.channels[number], self.schemas[number], log_ns, payloads
                    )

    def _sound(self, messages: Iterator[_Message]) -> Iterator[_Message]:
        """Yield messages up to a fault of the bag, of which `losses` is told."""
        try:
            yield from messages
        except Exception as error:  # on a damaged page or chunk
            self.losses[f"the bag is damaged ({_reason(error)})"] += 1


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


read_blocks = partial(reader.read_blocks, scan=BagScan)
list_topics = partial(reader.list_topics, scan=BagScan)


def _together(
    messages: Iterator[_Message], *, most: int = 1 << 22
) -> Iterator[list[_Message]]:
    """Some messages at a time, of `most` bytes, about."""
    held, size = list[_Message](), 0
    for message in messages:
        held.append(message)
        size += _OVERHEAD + len(message[2])
        if size > most:
            yield held
            held, size = [], 0
    yield held


@contextmanager
def _rosbag2(path: Path, wanted: _Wanted) -> Iterator[_Bag]:
    storage = _module("rosbags.rosbag2.storage_sqlite3", path)
    address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as database:
        for kind, text in database.execute("SELECT type, sql FROM sqlite_master"):
            # A database that computes what it seems to hold, at any cost: recorders do
            # not.
            if kind in ("view", "trigger") or _COMPUTED.search(str(text)):
                raise ValueError(f"it holds a {kind} that computes values")
    reader = storage.Sqlite3Reader(path.absolute())
    reader.open()
    try:
        topics = [_topic(c, str(c.msgdef.data)) for c in reader.connections]
        names = [(c.id, c.topic, c.msgtype, c.msgcount) for c in reader.connections]
        _as_declared(names, list[tuple[int, str, str, int]])
        others = {c.ext.serialization_format for c in reader.connections} - {"cdr"}
        if others:
            raise ValueError(
                f"its serialization is {', '.join(sorted(others))}, not cdr"
            )
        kept = [c for c in reader.connections if c.msgtype in _KEPT and wanted(c.topic)]
        yield topics, lambda: _unpacked(reader.messages(kept))
    finally:
        reader.close()


@contextmanager
def _rosbag1(path: Path, wanted: _Wanted) -> Iterator[_Bag]:
    typesys = _module("rosbags.typesys", path)
    with _module("rosbags.rosbag1", path).Reader(path.absolute()) as reader:
        for place, one in reader.chunks.items():
            reader.chunks[place] = one._replace(decompressor=_bounded(one.decompressor))
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        topics = [_topic(c, "") for c in reader.connections]
        kept = [
            c for c in reader.connections if c.msgtype in _KEPT[:2] and wanted(c.topic)
        ]

        def messages() -> Iterator[_Message]:
            for connection, time_ns, data in reader.messages(kept):
                kind = connection.msgtype
                yield connection.id, time_ns, bytes(store.ros1_to_cdr(data, kind))

        yield topics, messages


def _topic(link: Any, definition: str) -> _Topic:
    """Describe a topic as an MCAP file does, also its definition where it is in that form."""
    text = definition if link.msgdef.format.name == "MSG" else ""
    schema = Schema(link.id, text.encode(), "ros2msg", link.msgtype)
    return Channel(link.id, link.topic, "cdr", {}, link.id), schema, link.msgcount


def _bounded(usual: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """A decompressor of a chunk that stops where no recording would have so much in it."""

    def unpack(data: bytes) -> bytes:
        limit = min(allowed(len(data)), _CHUNK_LIMIT)
        if data[:3] == b"BZh":
            made: Any = bz2.BZ2Decompressor()
        elif data[:4] == _LZ4:
            made = lz4.frame.LZ4FrameDecompressor()
        else:
            return usual(data)
        unpacked = bytes(made.decompress(data, limit))
        if not made.eof:
            raise ValueError(
                f"a chunk of {len(data)} bytes is cut or unpacks to over {limit}"
            )
        return unpacked

    return unpack


def _unpacked(messages: Iterator[tuple[Any, int, bytes]]) -> Iterator[_Message]:
    """Unpack messages that were compressed one by one."""
    unpacker = zstandard.ZstdDecompressor()
    for connection, time_ns, data in messages:
        _as_declared((connection.id, time_ns, data), _Message)
        if data[:4] == _ZSTD:
            data = unpacker.decompress(data, max_output_size=_MESSAGE_LIMIT)
        yield connection.id, time_ns, data


def _as_declared(values: object, kind: Any) -> None:
    """Raise where SQLite, whose columns hold values of any type, holds one of another type."""
    msgspec.convert(values, kind, builtin_types=(bytes,))


def _unmerged(path: Path) -> list[str]:
    """Tell of a journal beside an SQLite file: the recorder was killed before it was merged."""
    journal = path.with_name(path.name + "-wal")
    size = journal.stat().st_size if journal.is_file() else 0
    text = (
        f"the bag was not closed: {size} bytes in {journal.name} are not read (merge"
        " them: "
    )
    return (
        [f"{text}`sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)'`)"]
        if size
        else []
    )


def _module(name: str, path: Path) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        text = (
            "is a ROS bag; reading it needs the package rosbags, which is not installed"
        )
        hint = 'Install it: pip install "seqid[bags]"; or convert the bag to MCAP with '
        hint += "`ros2 bag convert`."
        raise InputError(f"{text} ({error})", hint=hint, where=str(path)) from error
