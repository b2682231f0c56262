"""Whatever the layout of messages and file: the same arrays as by the formats' own
readers.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.decoder import DecoderFactory

from seqid_cli.logs.mcap.reader import read_blocks
from seqid_cli.logs.raw import Stream, joined
from tests.unit.logs import writers
from tests.unit.logs.samples import GYRO, JOINTS, make_robot, read_raw
from tests.unit.logs.writers import Message, joint_messages, write_messages

ROBOT = make_robot(imus=(GYRO,))
QUANTITIES = ("position", "velocity", "effort")

layouts = st.builds(  # what stays the same from message to message
    SimpleNamespace,
    names=st.lists(
        st.sampled_from([*JOINTS, "x", "long_name_of_a_gripper", ""]), max_size=7
    ),
    given=st.lists(st.booleans(), min_size=3, max_size=3),
    frame=st.text("ab", max_size=9),
)


@st.composite
def logs(draw: st.DrawFn) -> list[Message]:
    """Runs of messages of few layouts; the first has every joint."""
    known = [SimpleNamespace(names=[*JOINTS], given=[True] * 3, frame="base")]
    known += draw(st.lists(layouts, max_size=3))
    messages: list[Message] = []
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    for layout in [known[0], *draw(st.lists(st.sampled_from(known), max_size=6))]:
        special = draw(st.floats(width=64))
        for _ in range(draw(st.sampled_from([1, 3, 40, 300]))):
            stamp = int(rng.integers(1, 1 << 60))
            values = rng.normal(size=(3, len(layout.names)))
            values[values > 2.0] = special
            content = SimpleNamespace(
                header=writers.header(stamp, layout.frame), name=layout.names
            )
            for name, row, there in zip(QUANTITIES, values, layout.given, strict=True):
                setattr(content, name, row.tolist() if there else [])
            messages.append(("/joint_states", stamp, content))
    for imu in writers.imu_messages(
        rng.integers(1, 1 << 60, 30),
        "/hand/data",
        rng.normal(size=(30, 3)),
        np.zeros((30, 3)),
    ):
        messages.insert(int(rng.integers(0, len(messages) + 1)), imu)
    return messages


storages = st.fixed_dictionaries(
    {
        "compression": st.sampled_from(["none", "lz4", "zstd"]),
        **dict.fromkeys(("chunking", "index", "crc", "summary"), st.booleans()),
        "chunk_size": st.sampled_from([200, 5_000, 1 << 20]),
    }
)

Rows = tuple[list[int], list[np.ndarray]]  # stamps and values


def official(path: Path) -> tuple[Rows, Rows]:
    joints: Rows = ([], [])
    imus: Rows = ([], [])
    with path.open("rb") as file:
        reader = NonSeekingReader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(
            log_time_order=False
        ):
            found, row = joints, np.full((3, 3), np.nan)
            if channel.topic == "/hand/data":
                a, w = message.linear_acceleration, message.angular_velocity
                found, row = imus, np.array([a.x, a.y, a.z, w.x, w.y, w.z])
            else:
                for k, quantity in enumerate(QUANTITIES):
                    values = list(getattr(message, quantity))
                    for name, value in reversed(
                        list(zip(message.name, values, strict=False))
                    ):
                        if name in JOINTS:
                            row[k, JOINTS.index(name)] = value
            # else it is of other joints, and no sample of the robot's
            if np.isfinite(row).any():
                found[0].append(
                    message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                )
                found[1].append(row.ravel())
    return joints, imus


def assert_joints(
    stream: Stream, stamps: Sequence[int], rows: Sequence[np.ndarray]
) -> None:
    empty = np.full((len(stream), 3), np.nan)
    found = [
        stream.channels.get(name, empty) for name in ("position", "velocity", "torque")
    ]
    np.testing.assert_array_equal(stream.stamp_ns, stamps)
    np.testing.assert_array_equal(np.hstack(found), rows)


FIXTURE = HealthCheck.function_scoped_fixture


@pytest.mark.slow
@settings(
    max_examples=15, deadline=None, derandomize=True, suppress_health_check=[FIXTURE]
)
@given(messages=logs(), storage=storages, rows=st.sampled_from([None, 1, 100]))
def test_cdr_and_json(
    messages: list[Message],
    storage: dict[str, object],
    rows: int | None,
    tmp_path: Path,
) -> None:
    source = write_messages(tmp_path / "source.mcap", messages, encoding="cdr")
    path = writers.rewrite(source, tmp_path / "log.mcap", **storage)  # type: ignore[arg-type]
    as_json = write_messages(tmp_path / "json.mcap", messages, encoding="json")
    joints, imus = official(source)
    for blocks in (
        list(read_blocks(path, ROBOT, rows=rows)),
        [read_raw(as_json, ROBOT)],
    ):
        assert_joints(joined([block.joints for block in blocks]), *joints)
        imu = joined([block.imus["hand"][0] for block in blocks if block.imus])
        np.testing.assert_array_equal(imu.stamp_ns, imus[0])
        found = np.hstack([imu.channels["accelerometers"], imu.channels["gyro"]])
        np.testing.assert_array_equal(found, imus[1])
        assert blocks[-1].partial == ""


def test_protobuf(tmp_path: Path) -> None:
    """Absent values are missing, and not zero."""
    rng = np.random.default_rng(1)
    path = tmp_path / "log.mcap"
    wanted, stamps = np.full((500, 9), np.nan), rng.integers(1, 1 << 60, 500)
    # nanoseconds that are left out, because they are zero
    stamps[::7] -= stamps[::7] % 10**9
    with path.open("wb") as out, ProtobufWriter(out, chunk_size=20_000) as writer:
        for i, stamp in enumerate(stamps.tolist()):
            content = JointStates()
            content.timestamp.FromNanoseconds(stamp)
            for k in (rng.permutation(3) if i > 250 else np.arange(3)).tolist():
                row = rng.normal(size=3) * (rng.random(3) > 0.1)
                given = rng.random(3) > 0.1
                fields = {
                    q: float(v)
                    for q, v, g in zip(QUANTITIES, row, given, strict=True)
                    if g
                }
                content.joints.append(JointState(name=JOINTS[k], **fields))
                wanted[i, k::3] = np.where(given, row, np.nan)
            writer.write_message("/joint_states", content, i, i)
    assert_joints(read_raw(path, make_robot()).joints, stamps, wanted)


def positions(rows: int, frame: str = "base") -> tuple[list[Message], np.ndarray]:
    q = np.random.default_rng(5).normal(size=(rows, 3))
    messages = joint_messages(np.arange(1, rows + 1), JOINTS, q)
    for _, _, content in messages:
        content.header.frame_id = frame
    return messages, q


def test_padding_is_not_structure(tmp_path: Path) -> None:
    """Some middleware leaves what was in memory between the fields."""
    messages, q = positions(400, frame="abcd")
    rng, padded = np.random.default_rng(5), []
    for topic, log_ns, content in writers.encoded(messages, "cdr")[1]:
        data = bytearray(content)
        assert data[21:24] == b"\0\0\0"  # behind the frame's five bytes
        data[21:24] = rng.bytes(3)
        padded.append((topic, log_ns, bytes(data)))
    path = writers.write_raw(tmp_path / "log.mcap", {"/joint_states": "cdr"}, padded)
    np.testing.assert_array_equal(
        read_raw(path, make_robot()).joints.channels["position"], q
    )


@pytest.mark.parametrize("lie", [0, 1 << 62, 7])
def test_index_that_lies_is_not_believed(lie: int, tmp_path: Path) -> None:
    messages, q = positions(200)
    path = write_messages(
        tmp_path / "log.mcap", messages, encoding="cdr", chunk_size=8_000
    )
    data = path.read_bytes()
    wrong, at = bytearray(data), 0
    while (at := wrong.find(b"\x07", at + 1)) >= 0:
        length, channel, size = struct.unpack_from("<QHI", wrong, at + 1)
        if length == size + 6 and 0 < size < 10_000 and size % 16 == 0 and channel == 1:
            struct.pack_into("<Q", wrong, at + 1 + 8 + 6 + 16 * 3 + 8, lie)
    assert wrong != data
    path.write_bytes(wrong)
    raw = read_raw(path, make_robot())
    np.testing.assert_array_equal(raw.joints.channels["position"], q)
    assert raw.partial == ""
