"""Protobuf messages with the fields of sensor_msgs, by a definition made here."""

from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import write_raw

T0 = 1_700_000_000
TYPES = {  # their fields: type, or the name of a message; repeated where it ends with []
    "Stamp": {"sec": Field.TYPE_INT32, "nanosec": Field.TYPE_UINT32},
    "Header": {"stamp": "Stamp"},
    "JointState": {
        "header": "Header",
        "name[]": Field.TYPE_STRING,
        **{f"{name}[]": Field.TYPE_DOUBLE for name in ("position", "velocity", "effort")},
    },
    "Vector3": dict.fromkeys("xyz", Field.TYPE_DOUBLE),
    "Imu": {
        "header": "Header",
        "angular_velocity": "Vector3",
        "linear_acceleration": "Vector3",
    },
}


def described() -> FileDescriptorSet:
    """Describe the types; zeros are not written (proto3)."""
    found = FileDescriptorSet()
    file = found.file.add(name="ros.proto", package="ros", syntax="proto3")
    for name, fields in TYPES.items():
        message = file.message_type.add(name=name)
        for number, (key, kind) in enumerate(fields.items(), start=1):
            label = Field.LABEL_REPEATED if key.endswith("[]") else Field.LABEL_OPTIONAL
            one = message.field.add(name=key.removesuffix("[]"), number=number, label=label)
            if isinstance(kind, str):
                one.type, one.type_name = Field.TYPE_MESSAGE, f".ros.{kind}"
            else:
                one.type = kind
    return found


def test_joint_states_and_imu(tmp_path: Path) -> None:
    motion, definition = make_motion(grid(100)), described()
    types, text = GetMessages(definition.file), definition.SerializeToString()
    messages = []
    for i, t in enumerate(motion.t):
        header = {"stamp": {"sec": T0 + int(t), "nanosec": round(t % 1 * 1e9)}}
        state = types["ros.JointState"](
            header=header, name=JOINTS, position=motion.q[i], effort=motion.tau[i]
        )
        vectors = {
            "angular_velocity": motion.gyros["hand"][i],
            "linear_acceleration": motion.accelerometers["hand"][i],
        }
        imu = types["ros.Imu"](
            header=header,
            **{name: dict(zip("xyz", own, strict=True)) for name, own in vectors.items()},
        )
        messages.append(("/joint_states", i, state.SerializeToString()))
        messages.append(("/hand/data", i, imu.SerializeToString()))
    topics = {"/joint_states": "ros.JointState", "/hand/data": "ros.Imu"}
    channels = {topic: ("protobuf", kind, "protobuf", text) for topic, kind in topics.items()}
    path = write_raw(tmp_path / "log.mcap", channels, messages)
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
