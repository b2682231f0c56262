"""ROS bags, version 1 and the SQLite files of version 2, by the optional library rosbags.

Their messages are the same as those of an MCAP file, so a bag is read in two steps: the joint
states and IMU messages in it are copied to a temporary MCAP file, and that is read.
"""

import bz2
import importlib
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lz4.frame
import msgspec
import zstandard
from mcap.writer import CompressionType, Writer

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap import reader
from seqid_cli.logs.mcap.chunks import allowed
from seqid_cli.logs.raw import RawLog, TimeSource
from seqid_cli.logs.storage.temporary import room_for_copies, temporary_folder
from seqid_cli.robot.types import Robot

_KEPT = ("sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu", "control_msgs/msg/DynamicJointState")
_ROSBAG1 = b"#ROSBAG V2.0"
_ZSTD, _LZ4 = b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18"
_COMPUTED = re.compile(r"\bAS\s*\(", re.IGNORECASE)  # a generated column
_MESSAGE_LIMIT = 1 << 24  # bytes of one unpacked message
_CHUNK_LIMIT = 1 << 28  # bytes of one unpacked chunk of a ROS 1 bag; recorders write about 1 MB
_SHOWN = 12
_REMEDY = {
    "rosbag1": "Run `rosbag reindex FILE`, or copy it again from the source.",
    "rosbag2": "Salvage it: `sqlite3 FILE .recover | sqlite3 NEW.db3`, or copy it again from the "
    "source.",
}
_LINE = "=" * 80
_DYNAMIC = (
    "std_msgs/Header header\nstring[] joint_names\n"
    "control_msgs/InterfaceValue[] interface_values\n"
    f"{_LINE}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
    f"{_LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


@dataclass(frozen=True)
class Topic:
    """One topic of a bag; `definition` is its message definition, empty where the bag has none."""

    number: int
    name: str
    kind: str
    messages: int
    definition: str = ""


_Columns = tuple[int, str, str, int]
_Message = tuple[int, int, bytes]


@dataclass(frozen=True)
class _Bag:
    """An opened bag: its topics, and its messages as (topic's number, time [ns], CDR)."""

    topics: tuple[Topic, ...]
    messages: Callable[[], Iterator[_Message]]


_Open = Callable[[Path], AbstractContextManager[_Bag]]


def read_blocks(
    path: Path, robot: Robot, time_source: TimeSource = "header", *, rows: int | None = None
) -> Iterator[RawLog]:
    """Read a ROS 1 bag, or the SQLite file of a ROS 2 bag; see `reader.read_blocks`.

    The first block tells as well what of the bag could not be copied.
    """
    with as_mcap(path) as (copy, lost):
        try:
            for raw in reader.read_blocks(copy, robot, time_source, rows=rows):
                yield replace(raw, partial="; ".join(filter(None, (lost, raw.partial))))
                lost = ""
        except InputError as error:
            raise InputError(error.message, hint=error.hint, where=str(path)) from error


@contextmanager
def as_mcap(path: Path) -> Iterator[tuple[Path, str]]:
    """Copy what a bag holds of joint states and IMU messages to a temporary MCAP file.

    Yields: the file, and what was lost. Raises InputError: rosbags is not installed, the bag is
    damaged, or it has no such messages.
    """
    with temporary_folder(str(path)) as folder:
        target = folder / "bag.mcap"
        with path.open("rb") as file:
            first = file.read(len(_ROSBAG1)) == _ROSBAG1
        with room_for_copies(str(path)):
            lost = _copy(path, target, _rosbag1 if first else _rosbag2)
        yield target, lost


def _copy(path: Path, target: Path, open_bag: _Open) -> str:
    """Copy messages up to a fault; returns what was lost."""
    copied, expected, lost = 0, 0, _unmerged(path)
    with target.open("wb") as file, _opened(path, open_bag) as bag:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="")
        channels = {}
        for topic in _wanted(path, bag.topics):
            definition = topic.definition or (_DYNAMIC if "Dynamic" in topic.kind else "")
            schema = writer.register_schema(topic.kind, "ros2msg", definition.encode())
            channels[topic.number] = writer.register_channel(topic.name, "cdr", schema)
            expected += topic.messages
        for number, time_ns, data in _sound(bag.messages(), lost):
            if number in channels:
                writer.add_message(channels[number], max(0, time_ns), data, max(0, time_ns))
                copied += 1
        writer.finish()  # type: ignore[no-untyped-call]
    if copied < expected:
        lost.append(f"{expected - copied} of {expected} messages are lost")
    return "; ".join(lost)


def _sound(messages: Iterator[_Message], lost: list[str]) -> Iterator[_Message]:
    """Yield messages up to a fault of the bag, of which `lost` is told."""
    try:
        yield from messages
    except Exception as error:  # whatever the library raises on a damaged page or chunk
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        lost.append(f"the bag is damaged ({reason})")


def _wanted(path: Path, topics: tuple[Topic, ...]) -> list[Topic]:
    wanted = [topic for topic in topics if topic.kind in _KEPT]
    if wanted:
        return wanted
    listed = [f"{topic.name} ({topic.kind}, {topic.messages})" for topic in topics[:_SHOWN]]
    more = [f"and {len(topics) - _SHOWN} more"] if len(topics) > _SHOWN else []
    message = f"the bag holds no joint states; in it: {', '.join(listed + more) or 'no topics'}"
    hint = "Record /joint_states (sensor_msgs/msg/JointState) as well."
    raise InputError(message, hint=hint, where=str(path))


@contextmanager
def _opened(path: Path, open_bag: _Open) -> Iterator[_Bag]:
    """Open a bag; what the library says of a damaged one becomes an InputError."""
    try:
        bag = open_bag(path)
        opened = bag.__enter__()
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        message = f"the bag cannot be read ({reason})"
        hint = _REMEDY["rosbag1" if open_bag is _rosbag1 else "rosbag2"]
        raise InputError(message, hint=hint, where=str(path)) from error
    try:
        yield opened
    finally:
        bag.__exit__(None, None, None)


@contextmanager
def _rosbag2(path: Path) -> Iterator[_Bag]:
    storage = _module("rosbags.rosbag2.storage_sqlite3", path)
    _check_tables(path)
    reader = storage.Sqlite3Reader(path.absolute())
    reader.open()
    try:
        topics = tuple(
            Topic(c.id, c.topic, c.msgtype, c.msgcount, _definition(c)) for c in reader.connections
        )
        _as_declared([(t.number, t.name, t.kind, t.messages) for t in topics], list[_Columns])
        others = {c.ext.serialization_format for c in reader.connections} - {"cdr"}
        if others:
            raise ValueError(f"its serialization is {', '.join(sorted(others))}, not cdr")
        kept = [c for c in reader.connections if c.msgtype in _KEPT]
        yield _Bag(topics, lambda: _unpacked(reader.messages(kept)))
    finally:
        reader.close()


@contextmanager
def _rosbag1(path: Path) -> Iterator[_Bag]:
    typesys = _module("rosbags.typesys", path)
    with _module("rosbags.rosbag1", path).Reader(path.absolute()) as reader:
        for place, one in reader.chunks.items():
            reader.chunks[place] = one._replace(decompressor=_bounded(one.decompressor))
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        topics = tuple(Topic(c.id, c.topic, c.msgtype, c.msgcount) for c in reader.connections)
        kept = [c for c in reader.connections if c.msgtype in _KEPT[:2]]

        def messages() -> Iterator[_Message]:
            for connection, time_ns, data in reader.messages(kept):
                kind = connection.msgtype
                yield connection.id, time_ns, bytes(store.ros1_to_cdr(data, kind))

        yield _Bag(topics, messages)


def _check_tables(path: Path) -> None:
    """Raise where a database computes what it seems to hold, at any cost: recorders do not."""
    address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as database:
        for kind, text in database.execute("SELECT type, sql FROM sqlite_master"):
            if kind in ("view", "trigger") or _COMPUTED.search(str(text)):
                raise ValueError(f"it holds a {kind} that computes values")


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
            raise ValueError(f"a chunk of {len(data)} bytes is cut or unpacks to over {limit}")
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


def _definition(connection: Any) -> str:
    """Return a message definition in the form of MCAP, empty where it is not in that form."""
    text = str(connection.msgdef.data)
    return text if connection.msgdef.format.name == "MSG" else ""


def _unmerged(path: Path) -> list[str]:
    """Tell of a journal beside an SQLite file: the recorder was killed before it was merged."""
    journal = path.with_name(path.name + "-wal")
    try:
        size = journal.stat().st_size
    except OSError:
        return []
    if not size:
        return []
    return [
        f"the bag was not closed: {size} bytes in {journal.name} are not read (merge them: "
        f"`sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)'`)"
    ]


def _module(name: str, path: Path) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(
            f"is a ROS bag; reading it needs the package rosbags, which is not installed ({error})",
            hint='Install it: pip install "seqid[bags]"; or convert the bag to MCAP with '
            "`ros2 bag convert`.",
            where=str(path),
        ) from error
