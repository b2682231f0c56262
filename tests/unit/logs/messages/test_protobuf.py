"""Protobuf messages, written here byte by byte."""

import struct
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import write_raw

DOUBLE, INT32, MESSAGE, STRING, UINT32 = 1, 5, 11, 9, 13
T0 = 1_700_000_000


def varint(value: int) -> bytes:
    out = b""
    while value >= 0x80:
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + bytes([value])


def item(number: int, content: bytes | int | float) -> bytes:
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    if isinstance(content, float):
        return varint(number << 3 | 1) + struct.pack("<d", content)
    return varint(number << 3 | 2) + varint(len(content)) + content


def field(name: str, number: int, kind: int, *, repeated: bool = False, of: str = "") -> bytes:
    content = item(1, name.encode()) + item(3, number) + item(4, 3 if repeated else 1)
    return item(2, content + item(5, kind) + (item(6, of.encode()) if of else b""))


def descriptors() -> bytes:
    """Describe ros.JointState and ros.Imu; their stamp type is nested in the header's."""
    stamp = item(3, item(1, b"Stamp") + field("sec", 1, INT32) + field("nanosec", 2, UINT32))
    header = item(1, b"Header") + field("stamp", 1, MESSAGE, of=".ros.Header.Stamp") + stamp
    joint_state = item(1, b"JointState") + field("header", 1, MESSAGE, of=".ros.Header")
    joint_state += field("name", 2, STRING, repeated=True)
    for number, name in enumerate(("position", "velocity", "effort"), start=3):
        joint_state += field(name, number, DOUBLE, repeated=True)
    vector = item(1, b"Vector3") + b"".join(field(a, i + 1, DOUBLE) for i, a in enumerate("xyz"))
    imu = item(1, b"Imu") + field("header", 1, MESSAGE, of=".ros.Header")
    imu += field("angular_velocity", 2, MESSAGE, of=".ros.Vector3")
    imu += field("linear_acceleration", 3, MESSAGE, of=".ros.Vector3")
    types = b"".join(item(4, content) for content in (header, joint_state, vector, imu))
    return item(1, item(1, b"ros.proto") + item(2, b"ros") + types + PROTO3)


def header(stamp_s: float) -> bytes:
    whole = int(stamp_s)
    nanosec = round((stamp_s - whole) * 1e9)
    return item(1, item(1, item(1, T0 + whole) + item(2, nanosec)))


def doubles(number: int, values: np.ndarray, packed: bool) -> bytes:
    if packed:
        return item(number, struct.pack(f"<{len(values)}d", *values))
    return b"".join(item(number, float(value)) for value in values)


def vector(values: np.ndarray) -> bytes:
    return b"".join(item(i + 1, float(value)) for i, value in enumerate(values) if value != 0.0)


PROTO3 = item(12, b"proto3")


@pytest.mark.parametrize("packed", [True, False])
def test_joint_states_and_imu(tmp_path: Path, packed: bool) -> None:
    motion = make_motion(grid(100))
    topics = {
        "/joint_states": ("protobuf", "ros.JointState", "protobuf", descriptors()),
        "/hand/data": ("protobuf", "ros.Imu", "protobuf", descriptors()),
    }
    messages = []
    for i, t in enumerate(motion.t):
        names = b"".join(item(2, name.encode()) for name in JOINTS)
        body = header(t) + names + doubles(3, motion.q[i], packed)
        messages.append(("/joint_states", i, body + doubles(5, motion.tau[i], packed)))
        body = header(t) + item(2, vector(motion.gyros["hand"][i]))
        body += item(3, vector(motion.accelerometers["hand"][i]))
        messages.append(("/hand/data", i, body))
    path = write_raw(tmp_path / "log.mcap", topics, messages)
    recording = read_recording(path, make_robot(imus=(GYRO,)))
    np.testing.assert_array_equal(recording.q, motion.q)
    np.testing.assert_array_equal(recording.tau, motion.tau)
    assert recording.dq is None
    np.testing.assert_array_equal(recording.gyros["hand"], motion.gyros["hand"])
    np.testing.assert_array_equal(recording.accelerometers["hand"], motion.accelerometers["hand"])
    np.testing.assert_allclose(recording.t, motion.t, atol=1e-9)


@pytest.mark.parametrize("schema", [b"", b"\xff", b"\x0a\xff\xff\xff\xff\x7f"])
def test_unusable_descriptors_are_an_error(tmp_path: Path, schema: bytes) -> None:
    topics = {"/joint_states": ("protobuf", "ros.JointState", "protobuf", schema)}
    path = write_raw(tmp_path / "log.mcap", topics, [("/joint_states", 0, b"")])
    with pytest.raises(InputError, match="can be decoded"):
        read_recording(path, make_robot())
