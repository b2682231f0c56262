"""Whatever the layout of messages and file: the same arrays as by the formats' own readers."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader
from mcap_ros2.decoder import DecoderFactory

from seqid_cli.logs.mcap.reader import list_topics, read_blocks
from seqid_cli.logs.mcap.records import Scan
from seqid_cli.logs.raw import RawLog, Stream, joined
from tests.unit.logs.samples import GYRO, JOINTS, make_robot, read_raw
from tests.unit.logs.writers import (
    Message,
    header,
    imu_messages,
    joint_messages,
    payloads,
    rewrite,
    write_messages,
    write_raw,
)

ROBOT = make_robot(imus=(GYRO,))
QUANTITIES = ("position", "velocity", "effort")
check = settings(
    max_examples=15,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
numbers = st.floats(width=64)


@st.composite
def layouts(draw: st.DrawFn) -> SimpleNamespace:
    """What stays the same from message to message."""
    names = draw(
        st.lists(st.sampled_from([*JOINTS, "x", "long_name_of_a_gripper", ""]), max_size=7)
    )
    given = [draw(st.booleans()) for _ in QUANTITIES]
    return SimpleNamespace(names=names, given=given, frame=draw(st.text("ab", max_size=9)))


@st.composite
def logs(draw: st.DrawFn) -> list[Message]:
    """Runs of messages of few layouts; the first has every joint."""
    known = [SimpleNamespace(names=[*JOINTS], given=[True] * 3, frame="base")]
    known += draw(st.lists(layouts(), max_size=3))
    messages: list[Message] = []
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    for layout in [known[0], *draw(st.lists(st.sampled_from(known), max_size=6))]:
        special = draw(numbers)
        for _ in range(draw(st.sampled_from([1, 3, 40, 300]))):
            stamp = int(rng.integers(1, 1 << 60))
            values = rng.normal(size=(3, len(layout.names)))
            values[values > 2.0] = special
            content = SimpleNamespace(header=header(stamp, layout.frame), name=layout.names)
            for name, row, there in zip(QUANTITIES, values, layout.given, strict=True):
                setattr(content, name, row.tolist() if there else [])
            messages.append(("/joint_states", stamp, content))
    for topic, stamp, content in imu_messages(
        rng.integers(1, 1 << 60, 30), "/hand/data", rng.normal(size=(30, 3)), np.zeros((30, 3))
    ):
        messages.insert(int(rng.integers(0, len(messages) + 1)), (topic, stamp, content))
    return messages


storages = st.fixed_dictionaries(
    {
        "compression": st.sampled_from(["none", "lz4", "zstd"]),
        "chunking": st.booleans(),
        "index": st.booleans(),
        "crc": st.booleans(),
        "summary": st.booleans(),
        "chunk_size": st.sampled_from([200, 5_000, 1 << 20]),
    }
)


def official(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stamps and values of joints and IMU, message by message."""
    joints, imus = [], []
    with path.open("rb") as file:
        reader = NonSeekingReader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            if channel.topic == "/hand/data":
                a, w = message.linear_acceleration, message.angular_velocity
                imus.append((stamp, [a.x, a.y, a.z, w.x, w.y, w.z]))
                continue
            row = np.full((3, 3), np.nan)
            for k, quantity in enumerate(QUANTITIES):
                values = list(getattr(message, quantity))
                for name, value in reversed(list(zip(message.name, values, strict=False))):
                    if name in JOINTS:
                        row[k, JOINTS.index(name)] = value
            if np.isfinite(row).any():  # else it is of other joints, and no sample of the robot's
                joints.append((stamp, row.ravel()))
    return (
        np.array([stamp for stamp, _ in joints], np.int64),
        np.array([row for _, row in joints]),
        np.array([stamp for stamp, _ in imus], np.int64),
        np.array([row for _, row in imus]),
    )


def values_of(stream: Stream) -> np.ndarray:
    empty = np.full((len(stream), 3), np.nan)
    return np.hstack(
        [stream.channels.get(name, empty) for name in ("position", "velocity", "torque")]
    )


def assert_same(raw: RawLog, path: Path) -> None:
    stamps, rows, imu_stamps, imu_rows = official(path)
    np.testing.assert_array_equal(raw.joints.stamp_ns, stamps)
    np.testing.assert_array_equal(values_of(raw.joints), rows)
    (imu,) = raw.imus["hand"]
    np.testing.assert_array_equal(imu.stamp_ns, imu_stamps)
    found = np.hstack([imu.channels["accelerometers"], imu.channels["gyro"]])
    np.testing.assert_array_equal(found, imu_rows)
    assert raw.partial == ""


@check
@given(messages=logs(), storage=storages, rows=st.sampled_from([None, 1, 100]))
def test_cdr(
    messages: list[Message], storage: dict[str, object], rows: int | None, tmp_path: Path
) -> None:
    source = write_messages(tmp_path / "source.mcap", messages, encoding="cdr")
    path = rewrite(source, tmp_path / "log.mcap", **storage)  # type: ignore[arg-type]
    blocks = list(read_blocks(path, ROBOT, rows=rows))
    joints = joined([block.joints for block in blocks])
    imu = joined([block.imus["hand"][0] for block in blocks if block.imus])
    assert_same(RawLog(joints, {"hand": (imu,)}, blocks[-1].partial), path)


@check
@given(messages=logs())
def test_json(messages: list[Message], tmp_path: Path) -> None:
    path = write_messages(tmp_path / "log.mcap", messages, encoding="json")
    as_cdr = write_messages(tmp_path / "cdr.mcap", messages, encoding="cdr")
    assert_same(read_raw(path, ROBOT), as_cdr)


def test_protobuf(tmp_path: Path) -> None:
    """Absent values are missing, and not zero."""
    from foxglove_schemas_protobuf.JointState_pb2 import JointState
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
    from mcap_protobuf.writer import Writer as ProtobufWriter

    rng = np.random.default_rng(1)
    path = tmp_path / "log.mcap"
    wanted, stamps = np.full((500, 9), np.nan), rng.integers(1, 1 << 60, 500)
    stamps[::7] -= stamps[::7] % 10**9  # nanoseconds that are left out, because they are zero
    with path.open("wb") as out:
        writer = ProtobufWriter(out, chunk_size=20_000)
        for i, stamp in enumerate(stamps.tolist()):
            order = rng.permutation(3) if i > 250 else np.arange(3)
            joints = []
            for k in order.tolist():
                row = rng.normal(size=3) * (rng.random(3) > 0.1)
                given = rng.random(3) > 0.1
                fields = {q: float(v) for q, v, g in zip(QUANTITIES, row, given, strict=True) if g}
                joints.append(JointState(name=JOINTS[k], **fields))
                wanted[i, k::3] = np.where(given, row, np.nan)
            content = JointStates(joints=joints)
            content.timestamp.FromNanoseconds(stamp)
            writer.write_message("/joint_states", content, i, i)
        writer.finish()
    raw = read_raw(path, make_robot())
    np.testing.assert_array_equal(raw.joints.stamp_ns, stamps)
    np.testing.assert_array_equal(values_of(raw.joints), wanted)


def positions(q: np.ndarray) -> list[Message]:
    """A message of positions alone for each row (N, 3)."""
    return joint_messages(np.arange(1, len(q) + 1), JOINTS, q)


def test_padding_is_not_structure(tmp_path: Path) -> None:
    """Some middleware leaves what was in memory between the fields."""
    rng = np.random.default_rng(5)
    messages = positions(rng.normal(size=(400, 3)))
    for _, _, content in messages:
        content.header.frame_id = "abcd"
    source = write_messages(tmp_path / "source.mcap", messages, encoding="cdr")
    padded = []
    for log_ns, content in enumerate(payloads(source), start=1):
        data = bytearray(content)
        assert data[21:24] == b"\0\0\0"  # behind the frame's five bytes
        data[21:24] = rng.bytes(3)
        padded.append(("/joint_states", log_ns, bytes(data)))
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": "cdr"}, padded)
    np.testing.assert_array_equal(
        read_raw(path, make_robot()).joints.channels["position"],
        [content.position for _, _, content in messages],
    )


def test_chunks_without_needed_topics_are_not_unpacked(tmp_path: Path) -> None:
    messages = [("/camera", i, bytes([i]) * 1_000) for i in range(40)]
    for i in range(40, 100):
        messages.append(("/joint_states", i, b'{"name":["shoulder"],"position":[%d]}' % i))
    topics = {"/camera": "cdr", "/joint_states": "json"}
    path = write_raw(tmp_path / "log.mcap", topics, messages, chunk_size=4_000)
    with path.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    data = bytearray(path.read_bytes())
    first = summary.chunk_indexes[0]
    for at in range(first.chunk_start_offset + 60, first.chunk_start_offset + 70):
        data[at] ^= 0xFF
    path.write_bytes(data)
    raw = read_raw(path, make_robot())
    assert raw.partial == ""
    np.testing.assert_array_equal(raw.joints.channels["position"][:, 0], np.arange(40, 100))
    topics, _ = list_topics(path)
    assert {info.topic: info.messages for info in topics} == {"/camera": 40, "/joint_states": 60}
    scan = Scan(path, lambda topic: True)
    assert sum(len(batch.payloads) for batch in scan.batches()) < 100
    assert scan.losses


def test_index_that_lies_is_not_believed(tmp_path: Path) -> None:
    messages = positions(np.random.default_rng(6).normal(size=(200, 3)))
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr", chunk_size=8_000)
    data = path.read_bytes()
    for lie in (0, 1 << 62, 7):
        wrong = bytearray(data)
        at = 0
        while (at := wrong.find(b"\x07", at + 1)) >= 0:
            length, channel, size = struct.unpack_from("<QHI", wrong, at + 1)
            if length == size + 6 and 0 < size < 10_000 and size % 16 == 0 and channel == 1:
                struct.pack_into("<Q", wrong, at + 1 + 8 + 6 + 16 * 3 + 8, lie)
        assert wrong != data
        path.write_bytes(wrong)
        raw = read_raw(path, make_robot())
        np.testing.assert_array_equal(
            raw.joints.channels["position"], [content.position for _, _, content in messages]
        )
        assert raw.partial == ""
