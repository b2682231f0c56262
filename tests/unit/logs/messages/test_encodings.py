"""Messages in CDR and protobuf of unusual definitions, byte orders and descriptors."""

from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages
from rosbags.typesys import Stores, get_typestore

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import (
    DEFINITIONS,
    JOINT_STATE,
    encoded,
    joint_messages,
    write_messages,
    write_raw,
)

T0 = 1_700_000_000
MOTION = make_motion(grid(100))
MESSAGES = joint_messages(np.rint((MOTION.t + 1.0) * 1e9).astype(np.int64), JOINTS, MOTION.q)


def test_cdr_of_a_definition_with_other_fields(tmp_path: Path) -> None:
    other = DEFINITIONS[JOINT_STATE].replace(
        "string[] name", "uint8 mode\nstring[] name\n# not the usual one"
    )
    for _, _, content in MESSAGES:
        content.mode = 3
    path = tmp_path / "log.mcap"
    write_messages(path, MESSAGES, encoding="cdr", definitions={JOINT_STATE: other})
    np.testing.assert_array_equal(read_recording(path, make_robot()).q, MOTION.q)


def test_cdr_of_both_byte_orders_and_of_another_representation(tmp_path: Path) -> None:
    humble, rows = get_typestore(Stores.ROS2_HUMBLE), []
    for k, (topic, _, data) in enumerate(encoded(MESSAGES, "cdr")[1]):
        content = humble.deserialize_cdr(data, JOINT_STATE)
        turned = humble.serialize_cdr(content, JOINT_STATE, little_endian=bool(k % 2))
        rows.append((topic, k, bytes(turned)))
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": "cdr"}, rows)
    recording = read_recording(path, make_robot())
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.partial == ""
    rows[50] = ("/joint_states", 50, b"\0\3" + rows[50][2][2:])
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": "cdr"}, rows)
    partial = read_recording(path, make_robot()).partial
    assert partial == "1 of 100 messages of /joint_states could not be decoded"


TYPES = {  # their fields: type, or the name of a message; repeated where it ends with []
    "Stamp": {"sec": Field.TYPE_INT32, "nanosec": Field.TYPE_UINT32},
    "Header": {"stamp": "Stamp"},
    "JointState": {
        "header": "Header",
        "name[]": Field.TYPE_STRING,
        **{f"{name}[]": Field.TYPE_DOUBLE for name in ("position", "velocity", "effort")},
    },
    "Vector3": dict.fromkeys("xyz", Field.TYPE_DOUBLE),
    "Imu": {"header": "Header", "angular_velocity": "Vector3", "linear_acceleration": "Vector3"},
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


def test_protobuf_with_the_fields_of_sensor_msgs(tmp_path: Path) -> None:
    definition, messages = described(), []
    types, text = GetMessages(definition.file), definition.SerializeToString()
    state, imu = types["ros.JointState"], types["ros.Imu"]
    for i, t in enumerate(MOTION.t):
        header = {"stamp": {"sec": T0 + int(t), "nanosec": round(t % 1 * 1e9)}}
        joints = state(header=header, name=JOINTS, position=MOTION.q[i], effort=MOTION.tau[i])
        w, a = MOTION.gyros["hand"][i], MOTION.accelerometers["hand"][i]
        vectors = {"angular_velocity": w, "linear_acceleration": a}
        named = {name: dict(zip("xyz", own, strict=True)) for name, own in vectors.items()}
        messages.append(("/joint_states", i, joints.SerializeToString()))
        messages.append(("/hand/data", i, imu(header=header, **named).SerializeToString()))
    topics = {"/joint_states": "ros.JointState", "/hand/data": "ros.Imu"}
    channels = {topic: ("protobuf", kind, "protobuf", text) for topic, kind in topics.items()}
    path = write_raw(tmp_path / "log.mcap", channels, messages)
    recording = read_recording(path, make_robot(imus=(GYRO,)))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    assert recording.dq is None
    for name in ("gyros", "accelerometers"):
        found, expected = getattr(recording, name)["hand"], getattr(MOTION, name)["hand"]
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)


@pytest.mark.parametrize("schema", [b"", b"\xff", b"\x0a\xff\xff\xff\xff\x7f"])
def test_unusable_descriptors_are_an_error(tmp_path: Path, schema: bytes) -> None:
    topics = {"/joint_states": ("protobuf", "ros.JointState", "protobuf", schema)}
    path = write_raw(tmp_path / "log.mcap", topics, [("/joint_states", 0, b"")])
    with pytest.raises(InputError, match="can be decoded"):
        read_recording(path, make_robot())
