"""ROS bags by the optional library rosbags: version 1, SQLite files of version 2."""

import bz2
import importlib
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

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

_KEPT_TYPES = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "std_msgs/msg/String",  # the robot's description
    "control_msgs/msg/DynamicJointState",
    "control_msgs/msg/JointTrajectoryControllerState",
)
_ROSBAG1 = b"#ROSBAG V2.0"
_ZSTD = b"\x28\xb5\x2f\xfd"
_LZ4 = b"\x04\x22\x4d\x18"
_BZIP2 = b"BZh"
_COMPUTED = re.compile(r"\bAS\s*\(", re.IGNORECASE)  # a generated column
_MESSAGE_LIMIT = 1 << 24  # bytes of one unpacked message
_OVERHEAD = 200  # bytes that a message costs beside its own
# bytes of one unpacked chunk of a ROS 1 bag; recorders write about 1 MB
_CHUNK_LIMIT = 1 << 28
_REMEDY1 = "Run `rosbag reindex FILE`, or copy it again from the source."
_REMEDY2 = (
    "Salvage it: `sqlite3 FILE .recover | sqlite3 NEW.db3`, or copy it again from the"
    " source."
)
_Wanted = Callable[[str], bool]


class _Message(NamedTuple):
    """One message."""

    channel: int
    time_ns: int
    data: bytes  # CDR


class _Topic(NamedTuple):
    """One topic of a bag, as an MCAP file describes it."""

    channel: Channel
    schema: Schema
    messages: int


@dataclass(frozen=True)
class _Bag:
    """An opened bag; `messages` are those of wanted topics and kept types."""

    topics: list[_Topic]
    messages: Callable[[], Iterator[_Message]]


@dataclass
class BagScan(Scan):
    """One pass over a ROS 1 bag, or the SQLite file of a ROS 2 bag; see `Scan`."""

    def batches(self) -> Iterator[Batch]:
        """Yield the messages up to a fault, some at a time, topic by topic."""
        with self.path.open("rb") as file:
            is_first = file.read(len(_ROSBAG1)) == _ROSBAG1
        self.remedy = _REMEDY1 if is_first else _REMEDY2
        self.losses.update(_unmerged(self.path))
        with ExitStack() as stack:
            open_bag = _rosbag1 if is_first else _rosbag2
            try:
                bag = stack.enter_context(open_bag(self.path, self.wanted))
            except InputError:
                raise
            except Exception as error:  # whatever the library raises on a damaged bag
                raise InputError(
                    f"the bag cannot be read ({_reason(error)})",
                    hint=self.remedy,
                    where=str(self.path),
                ) from error
            self._describe(bag.topics)
            for part in _parts(self._up_to_fault(bag.messages())):
                for number in dict.fromkeys(message.channel for message in part):
                    yield self._batch(
                        number, [each for each in part if each.channel == number]
                    )

    def _describe(self, topics: list[_Topic]) -> None:
        """Take the topics of the bag as those of an MCAP file's summary."""
        counts = {topic.channel.id: topic.messages for topic in topics}
        self.summary.statistics = Statistics(
            attachment_count=0,
            channel_count=len(topics),
            channel_message_counts=counts,
            chunk_count=0,
            message_count=sum(counts.values()),
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )
        for topic in topics:
            self.channels[topic.channel.id] = topic.channel
            self.schemas[topic.schema.id] = topic.schema

    def _batch(self, number: int, messages: list[_Message]) -> Batch:
        self.counts[number] += len(messages)
        times_ns = [max(0, message.time_ns) for message in messages]
        return Batch(
            channel=self.channels[number],
            schema=self.schemas[number],
            log_ns=np.array(times_ns, np.int64),
            payloads=Payloads.of([message.data for message in messages]),
        )

    def _up_to_fault(self, messages: Iterator[_Message]) -> Iterator[_Message]:
        """Yield messages up to a fault of the bag, which `losses` counts."""
        try:
            yield from messages
        except Exception as error:  # on a damaged page or chunk
            self.losses[f"the bag is damaged ({_reason(error)})"] += 1


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


read_blocks = partial(reader.read_blocks, scan=BagScan)
list_topics = partial(reader.list_topics, scan=BagScan)


def _parts(
    messages: Iterator[_Message], *, most: int = 1 << 22
) -> Iterator[list[_Message]]:
    """Put messages together to parts of about `most` bytes; the last may be empty."""
    part: list[_Message] = []
    size = 0
    for message in messages:
        part.append(message)
        size += _OVERHEAD + len(message.data)
        if size > most:
            yield part
            part = []
            size = 0
    yield part


@contextmanager
def _rosbag2(path: Path, wanted: _Wanted) -> Iterator[_Bag]:
    """Open the SQLite file of a ROS 2 bag; raises anything where it is damaged."""
    storage = _module("rosbags.rosbag2.storage_sqlite3", path)
    _refuse_computed(path)
    bag = storage.Sqlite3Reader(path.absolute())
    bag.open()
    try:
        topics = [_topic(link, str(link.msgdef.data)) for link in bag.connections]
        described = [
            (link.id, link.topic, link.msgtype, link.msgcount)
            for link in bag.connections
        ]
        _as_declared(described, list[tuple[int, str, str, int]])
        formats = {link.ext.serialization_format for link in bag.connections}
        other_formats = sorted(formats - {"cdr"})
        if other_formats:
            raise ValueError(
                f"its serialization is {', '.join(other_formats)}, not cdr"
            )

        def messages() -> Iterator[_Message]:
            # Some topics are wanted for their type, which is known by now.
            links = [
                link
                for link in bag.connections
                if link.msgtype in _KEPT_TYPES and wanted(link.topic)
            ]
            yield from _unpacked(bag.messages(links))

        yield _Bag(topics, messages)
    finally:
        bag.close()


def _refuse_computed(path: Path) -> None:
    """Raise ValueError for a database that computes what it seems to hold.

    That may cost anything, and recorders do not write it.
    """
    address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as database:
        for kind, text in database.execute("SELECT type, sql FROM sqlite_master"):
            if kind in ("view", "trigger") or _COMPUTED.search(str(text)):
                raise ValueError(f"it holds a {kind} that computes values")


@contextmanager
def _rosbag1(path: Path, wanted: _Wanted) -> Iterator[_Bag]:
    """Open a ROS 1 bag; raises anything where it is damaged."""
    typesys = _module("rosbags.typesys", path)
    with _module("rosbags.rosbag1", path).Reader(path.absolute()) as bag:
        for place, chunk in bag.chunks.items():
            bounded = _bounded(chunk.decompressor)
            bag.chunks[place] = chunk._replace(decompressor=bounded)
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        topics = [_topic(link, "") for link in bag.connections]
        # ROS 1 has no DynamicJointState.
        links = [
            link
            for link in bag.connections
            if link.msgtype in _KEPT_TYPES[:3] and wanted(link.topic)
        ]

        def messages() -> Iterator[_Message]:
            for link, time_ns, data in bag.messages(links):
                cdr = store.ros1_to_cdr(data, link.msgtype)
                yield _Message(link.id, time_ns, bytes(cdr))

        yield _Bag(topics, messages)


def _topic(link: Any, definition: str) -> _Topic:
    """Describe a topic as an MCAP file does; `definition` counts in that form only."""
    text = definition if link.msgdef.format.name == "MSG" else ""
    schema = Schema(
        id=link.id, data=text.encode(), encoding="ros2msg", name=link.msgtype
    )
    channel = Channel(
        id=link.id,
        topic=link.topic,
        message_encoding="cdr",
        metadata={},
        schema_id=link.id,
    )
    return _Topic(channel, schema, link.msgcount)


def _bounded(usual: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """Make a decompressor of chunks that stops where no recording has so much in one.

    `usual` decompresses what is neither bzip2 nor lz4.
    """

    def unpack(data: bytes) -> bytes:
        limit = min(allowed(len(data)), _CHUNK_LIMIT)
        decompressor: Any
        if data.startswith(_BZIP2):
            decompressor = bz2.BZ2Decompressor()
        elif data.startswith(_LZ4):
            decompressor = lz4.frame.LZ4FrameDecompressor()
        else:
            return usual(data)
        unpacked = bytes(decompressor.decompress(data, limit))
        if not decompressor.eof:
            raise ValueError(
                f"a chunk of {len(data)} bytes is cut or unpacks to over {limit}"
            )
        return unpacked

    return unpack


def _unpacked(messages: Iterator[tuple[Any, int, bytes]]) -> Iterator[_Message]:
    """Unpack messages that were compressed one by one."""
    zstd = zstandard.ZstdDecompressor()
    for link, time_ns, data in messages:
        _as_declared((link.id, time_ns, data), tuple[int, int, bytes])
        if data[:4] == _ZSTD:
            data = zstd.decompress(data, max_output_size=_MESSAGE_LIMIT)
        yield _Message(link.id, time_ns, data)


def _as_declared(values: object, kind: Any) -> None:
    """Raise where SQLite, whose columns hold any type, holds another than declared."""
    msgspec.convert(values, kind, builtin_types=(bytes,))


def _unmerged(path: Path) -> list[str]:
    """Describe a journal beside an SQLite file: the recorder was killed."""
    journal = path.with_name(path.name + "-wal")
    size = journal.stat().st_size if journal.is_file() else 0
    if not size:
        return []
    return [
        f"the bag was not closed: {size} bytes in {journal.name} are not read (merge"
        f" them: `sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)'`)"
    ]


def _module(name: str, path: Path) -> Any:
    """Import a module of rosbags; raises InputError where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(
            "is a ROS bag; reading it needs the package rosbags, which is not installed"
            f" ({error})",
            hint='Install it: pip install "seqid[bags]"; or convert the bag to MCAP'
            " with `ros2 bag convert`.",
            where=str(path),
        ) from error
