"""What is measured, one case a process: `python -m tests.benchmarks.ingestion_cases
CASE FILE`.
"""

import json
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.make_logs import JOINTS
from tests.benchmarks.measure import tell
from tests.unit.logs.samples import GYRO, make_robot

Message = tuple[str, int, list[float]]  # topic, time, numbers
_IMU = "/hand/data"
TABLE_COLUMNS = tuple(
    f"{name}.{kind}" for kind in ("position", "current") for name in JOINTS
)


def decompress(path: Path) -> int:
    """Read the file and unpack its chunks, nothing else."""
    unpacker, size = import_module("zstandard").ZstdDecompressor(), 0
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(9)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            content = memoryview(file.read(length))
            if opcode == 0x06:
                (name,) = struct.unpack_from("<I", content, 28)
                size += len(unpacker.decompress(content[40 + name :]))
            if opcode == 0x0F:
                break
    return size


def seqid_blocks(path: Path, **options: Any) -> int:
    reader = import_module("seqid_cli.logs.mcap.reader")
    blocks = reader.read_blocks(path, make_robot(JOINTS, imus=(GYRO,)), **options)
    return sum(
        len(raw.joints) + sum(map(len, chain(*raw.imus.values()))) for raw in blocks
    )


def seqid(path: Path) -> int:
    return seqid_blocks(path, rows=None)


def mcap_ros2(path: Path) -> int:
    decoded = _decoded(path, "mcap_ros2.decoder")
    return _gathered(_ros(topic, message) for topic, message in decoded)


def rosbags(path: Path) -> int:
    types = import_module("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS2_HUMBLE)
    with import_module("rosbags.highlevel").AnyReader(
        [path], default_typestore=store
    ) as reader:
        return _gathered(
            _ros(connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        )


def json_loads(path: Path) -> int:
    def messages() -> Iterator[Message]:
        with path.open("rb") as file:
            for _, _, message in (
                import_module("mcap.reader").make_reader(file).iter_messages()
            ):
                content = json.loads(message.data)
                stamp = content["header"]["stamp"]
                row = [*content["position"], *content["velocity"], *content["effort"]]
                yield "", stamp["sec"] * 10**9 + stamp["nanosec"], row

    return _gathered(messages())


def mcap_protobuf(path: Path) -> int:
    def messages() -> Iterator[Message]:
        for topic, message in _decoded(path, "mcap_protobuf.decoder"):
            row: list[float] = []
            for joint in message.joints:
                row += (joint.position, joint.velocity, joint.effort)
            yield (
                topic,
                message.timestamp.seconds * 10**9 + message.timestamp.nanos,
                row,
            )

    return _gathered(messages())


def iter_batches(path: Path) -> int:
    with import_module("pyarrow.parquet").ParquetFile(path) as file:
        return _columns(file.iter_batches(65_536, columns=list(TABLE_COLUMNS)))


def parquet_blocks(path: Path) -> int:
    return _columns(
        import_module("seqid_cli.logs.tables.parquet").read_tables(path, TABLE_COLUMNS)
    )


def _decoded(path: Path, decoder: str) -> Iterator[tuple[str, Any]]:
    factory = import_module(decoder).DecoderFactory()
    with path.open("rb") as file:
        reader = import_module("mcap.reader").make_reader(
            file, decoder_factories=[factory]
        )
        for _, channel, _, message in reader.iter_decoded_messages():
            yield channel.topic, message


def _ros(topic: str, message: Any) -> Message:
    stamp = message.header.stamp
    if topic == _IMU:
        a, w = message.linear_acceleration, message.angular_velocity
        row = [a.x, a.y, a.z, w.x, w.y, w.z]
    else:
        row = [*message.position, *message.velocity, *message.effort]
    return topic, stamp.sec * 10**9 + stamp.nanosec, row


def _gathered(messages: Iterable[Message]) -> int:
    stamps, rows = list[int](), dict[str, list[list[float]]]()
    for topic, stamp, row in messages:
        stamps.append(stamp)
        rows.setdefault(topic, []).append(row)
    return len([np.array(stamps), *map(np.array, rows.values())][0])


def _columns(tables: Iterable[Any]) -> int:
    return sum(
        len(np.column_stack([c.to_numpy() for c in table.columns])) for table in tables
    )


CASES: dict[Callable[[Path], int], list[str]] = {  # and what they import
    decompress: ["zstandard"],
    seqid: ["seqid_cli.logs.mcap.reader"],
    seqid_blocks: ["seqid_cli.logs.mcap.reader"],
    mcap_ros2: ["mcap.reader", "mcap_ros2.decoder"],
    rosbags: ["rosbags.highlevel", "rosbags.typesys"],
    json_loads: ["mcap.reader"],
    mcap_protobuf: ["mcap.reader", "mcap_protobuf.decoder"],
    iter_batches: ["pyarrow.parquet"],
    parquet_blocks: ["seqid_cli.logs.tables.parquet"],
}


if __name__ == "__main__":
    (case,) = (case for case in CASES if case.__name__ == sys.argv[1])
    for needed in CASES[case]:
        import_module(needed)
    tell(partial(case, Path(sys.argv[2])))
