"""What is measured, one case per process: `python -m tests.benchmarks.ingestion_cases CASE FILE`.

Every case turns the same numbers of a file into arrays. Imports are not counted.
"""

import json
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from tests.benchmarks.figaroh_case import usage
from tests.benchmarks.make_logs import JOINTS
from tests.unit.logs.samples import GYRO, make_robot

Case = Callable[[], Callable[[Path], int]]  # imports, and returns what is measured
_IMU = "/hand/data"
TABLE_COLUMNS = tuple(f"{name}.{kind}" for kind in ("position", "current") for name in JOINTS)


def decompress() -> Callable[[Path], int]:
    """Read the file and unpack its chunks, nothing else."""
    import zstandard

    def run(path: Path) -> int:
        unpacker, size = zstandard.ZstdDecompressor(), 0
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

    return run


def seqid() -> Callable[[Path], int]:
    """Read everything into arrays."""
    from seqid_cli.logs.mcap import reader

    def run(path: Path) -> int:
        (raw,) = reader.read_blocks(path, make_robot(JOINTS, imus=(GYRO,)), rows=None)
        return len(raw.joints) + sum(len(s) for streams in raw.imus.values() for s in streams)

    return run


def seqid_blocks() -> Callable[[Path], int]:
    """Read everything into arrays, a block at a time."""
    from seqid_cli.logs.mcap import reader

    def run(path: Path) -> int:
        count = 0
        for raw in reader.read_blocks(path, make_robot(JOINTS, imus=(GYRO,))):
            count += len(raw.joints)
            count += sum(len(s) for streams in raw.imus.values() for s in streams)
        return count

    return run


def mcap_ros2() -> Callable[[Path], int]:
    """mcap with mcap-ros2-support."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    def messages(path: Path) -> Iterator[tuple[str, object]]:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, decoded in reader.iter_decoded_messages():
                yield channel.topic, decoded

    return lambda path: _ros_arrays(messages(path))


def rosbags() -> Callable[[Path], int]:
    """rosbags' AnyReader."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)

    def messages(path: Path) -> Iterator[tuple[str, object]]:
        with AnyReader([path], default_typestore=store) as reader:
            for connection, _, data in reader.messages():
                yield connection.topic, reader.deserialize(data, connection.msgtype)

    return lambda path: _ros_arrays(messages(path))


def _ros_arrays(messages: Iterator[tuple[str, object]]) -> int:
    stamps: list[int] = []
    joints: list[list[float]] = []
    imus: list[tuple[float, ...]] = []
    for topic, message in messages:
        stamp = message.header.stamp  # type: ignore[attr-defined]
        stamps.append(stamp.sec * 10**9 + stamp.nanosec)
        if topic == _IMU:
            a = message.linear_acceleration  # type: ignore[attr-defined]
            w = message.angular_velocity  # type: ignore[attr-defined]
            imus.append((a.x, a.y, a.z, w.x, w.y, w.z))
        else:
            m = message
            joints.append([*m.position, *m.velocity, *m.effort])  # type: ignore[attr-defined]
    arrays = np.array(stamps), np.array(joints), np.array(imus)
    return len(arrays[0])


def json_loads() -> Callable[[Path], int]:
    """mcap with json.loads."""
    from mcap.reader import make_reader

    def run(path: Path) -> int:
        stamps: list[int] = []
        rows: list[list[float]] = []
        with path.open("rb") as file:
            for _, _, message in make_reader(file).iter_messages():
                content = json.loads(message.data)
                stamp = content["header"]["stamp"]
                stamps.append(stamp["sec"] * 10**9 + stamp["nanosec"])
                rows.append([*content["position"], *content["velocity"], *content["effort"]])
        return len(np.array(rows)) + 0 * len(np.array(stamps))

    return run


def mcap_protobuf() -> Callable[[Path], int]:
    """mcap with mcap-protobuf-support."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    def run(path: Path) -> int:
        stamps: list[int] = []
        rows: list[list[float]] = []
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, _, _, message in reader.iter_decoded_messages():
                stamps.append(message.timestamp.seconds * 10**9 + message.timestamp.nanos)
                row: list[float] = []
                for joint in message.joints:
                    row += (joint.position, joint.velocity, joint.effort)
                rows.append(row)
        return len(np.array(rows)) + 0 * len(np.array(stamps))

    return run


def iter_batches() -> Callable[[Path], int]:
    """pyarrow's own batches, 14 of 29 columns."""
    import pyarrow.parquet as pq

    def run(path: Path) -> int:
        with pq.ParquetFile(path) as file:
            return _arrays(file.iter_batches(65_536, columns=list(TABLE_COLUMNS)))

    return run


def parquet_blocks() -> Callable[[Path], int]:
    """Blocks of 14 of 29 columns."""
    from seqid_cli.logs.tables.parquet import read_tables

    return lambda path: _arrays(read_tables(path, TABLE_COLUMNS))


def _arrays(tables: Iterator[Sequence[object]]) -> int:
    count = 0
    for table in tables:
        columns = [column.to_numpy() for column in table.columns]  # type: ignore[attr-defined]
        count += len(np.column_stack(columns))
    return count


CASES: dict[str, Case] = {
    case.__name__: case
    for case in (
        decompress,
        seqid,
        seqid_blocks,
        mcap_ros2,
        rosbags,
        json_loads,
        mcap_protobuf,
        iter_batches,
        parquet_blocks,
    )
}


def main(name: str, path: Path) -> None:
    """Measure one case once; print CPU seconds, peak MiB and what the case counted."""
    run = CASES[name]()
    start = usage()[0]
    count = run(path)
    after, peak = usage()
    sys.stdout.write(json.dumps({"cpu_s": after - start, "peak": peak, "count": count}) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
