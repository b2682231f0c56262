"""ROS bags: those of version 1 by the optional library rosbags, SQLite files of 2."""

import bz2
import importlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
from mcap.records import Statistics

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap import reader, sqlite_bag
from seqid_cli.logs.mcap.bags import KEPT_TYPES, Bag, Message, Topic, Wanted, made_topic
from seqid_cli.logs.mcap.chunks import allowed
from seqid_cli.logs.mcap.records import Batch, Scan
from seqid_cli.logs.messages.batch import Payloads

_ROSBAG1 = b"#ROSBAG V2.0"
_LZ4 = b"\x04\x22\x4d\x18"
_BZIP2 = b"BZh"
_OVERHEAD = 200  # bytes that a message costs beside its own
# bytes of one unpacked chunk of a ROS 1 bag; recorders write about 1 MB
_CHUNK_LIMIT = 1 << 28
_REMEDY1 = "Run `rosbag reindex FILE`, or copy it again from the source."
_REMEDY2 = (
    "Salvage it: `sqlite3 FILE .recover | sqlite3 NEW.db3`, or copy it again from the"
    " source."
)


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
            open_bag = _rosbag1 if is_first else sqlite_bag.open_bag
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

    def _describe(self, topics: list[Topic]) -> None:
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

    def _batch(self, number: int, messages: list[Message]) -> Batch:
        self.counts[number] += len(messages)
        times_ns = [max(0, message.time_ns) for message in messages]
        return Batch(
            channel=self.channels[number],
            schema=self.schemas[number],
            log_ns=np.array(times_ns, np.int64),
            payloads=Payloads.of([message.data for message in messages]),
        )

    def _up_to_fault(self, messages: Iterator[Message]) -> Iterator[Message]:
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
    messages: Iterator[Message], *, most: int = 1 << 22
) -> Iterator[list[Message]]:
    """Put messages together to parts of about `most` bytes; the last may be empty."""
    part: list[Message] = []
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
def _rosbag1(path: Path, wanted: Wanted) -> Iterator[Bag]:
    """Open a ROS 1 bag; raises anything where it is damaged."""
    typesys = _module("rosbags.typesys", path)
    with _module("rosbags.rosbag1", path).Reader(path.absolute()) as bag:
        for place, chunk in bag.chunks.items():
            bounded = _bounded(chunk.decompressor)
            bag.chunks[place] = chunk._replace(decompressor=bounded)
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        topics = [
            made_topic(link.id, link.topic, link.msgtype, "", link.msgcount)
            for link in bag.connections
        ]
        # ROS 1 has no DynamicJointState.
        links = [
            link
            for link in bag.connections
            if link.msgtype in KEPT_TYPES[:3] and wanted(link.topic)
        ]

        def messages() -> Iterator[Message]:
            for link, time_ns, data in bag.messages(links):
                cdr = store.ros1_to_cdr(data, link.msgtype)
                yield Message(link.id, time_ns, bytes(cdr))

        yield Bag(topics, messages)


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
