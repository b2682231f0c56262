"""MCAP logs: clocks, topics, publishers, encodings, messages that cannot be decoded."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages
from rosbags.typesys import Stores, get_typestore

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.reader import list_topics
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.reading import Reading
from seqid_cli.logs.recording import Recording
from tests.unit.logs import samples, writers
from tests.unit.logs.samples import (
    ARRAY,
    GYRO,
    JOINTS,
    Motion,
    grid,
    make_motion,
    make_robot,
)
from tests.unit.logs.writers import (
    JOINT_STATE,
    Message,
    imu_messages,
    write_messages,
    write_raw,
)

ROBOT = make_robot(imus=(ARRAY, GYRO))
MOTION = make_motion(grid(200))


def stamps(t: np.ndarray) -> np.ndarray:
    return 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)


def read(folder: Path, messages: list[Message], encoding: str = "cdr") -> Recording:
    return read_recording(
        write_messages(folder / "log.mcap", messages, encoding=encoding), ROBOT
    )


def joints(
    motion: Motion = MOTION, names: Sequence[str] = JOINTS, **options: str
) -> list[Message]:
    return writers.joint_messages(
        stamps(motion.t), names, motion.q[:, : len(names)], **options
    )


def hand(motion: Motion, late_s: float = 0.0) -> list[Message]:
    readings = motion.accelerometers["hand"], motion.gyros["hand"]
    return imu_messages(stamps(motion.t + late_s), "/hand/data", *readings)


@pytest.mark.parametrize("delay_s", [0.0, 0.002])
def test_joint_states_split_over_two_messages(tmp_path: Path, delay_s: float) -> None:
    later = make_motion(MOTION.t + delay_s)
    parts = [
        writers.joint_messages(
            stamps(m.t), JOINTS[own], m.q[:, own], effort=m.tau[:, own]
        )
        for m, own in ((MOTION, slice(1)), (later, slice(1, None)))
    ]
    recording = read(
        tmp_path, [message for pair in zip(*parts, strict=True) for message in pair]
    )
    assert recording.rate_hz == pytest.approx(100.0)
    assert recording.health.duplicates == 0
    expected = make_motion(recording.t + (0.01 if delay_s else 0.0))
    np.testing.assert_allclose(recording.q[2:-2], expected.q[2:-2], atol=1e-7)
    np.testing.assert_allclose(recording.tau[2:-2], expected.tau[2:-2], atol=1e-5)
    assert recording.valid[1:-1].all()


def test_header_stamps_log_times_and_zeros(tmp_path: Path) -> None:
    path = samples.write_motion(tmp_path / "log.mcap", MOTION, log_offset_ns=3_000_000)
    assert read_recording(path, ROBOT).health.log_minus_header_s == pytest.approx(0.003)
    by_log = read_recording(path, ROBOT, reading=Reading(time_source="log"))
    path = samples.write_motion(tmp_path / "zero.mcap", MOTION, zero_stamps=True)
    without = read_recording(path, ROBOT)
    assert without.health.log_minus_header_s is None
    assert any("all zero" in warning for warning in without.health.warnings)
    for recording in (by_log, without):
        np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)
        np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-9)
        array = recording.accelerometers["array"]
        np.testing.assert_allclose(array, MOTION.accelerometers["array"], atol=1e-9)
        assert recording.valid.all()


def test_messages_without_a_stamp_among_others_are_left_out(tmp_path: Path) -> None:
    messages = joints()
    messages[50][2].header.stamp = SimpleNamespace(sec=0, nanosec=0)
    recording = read(tmp_path, messages)
    told = "1 messages of /joint_states have no header stamp and were left out"
    assert recording.health.warnings == (told,)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-6)


def test_imu_with_its_own_rate_span_and_clock(tmp_path: Path) -> None:
    motion, imu = make_motion(grid(300)), make_motion(0.5 + grid(600, 333.0))
    recording = read(tmp_path, joints(motion) + hand(imu))
    inside = (motion.t >= imu.t[0]) & (motion.t <= imu.t[-1])
    np.testing.assert_array_equal(recording.valid, inside)
    assert "array" not in recording.accelerometers
    wanted = motion.accelerometers["hand"][inside][3:-3]
    np.testing.assert_allclose(
        recording.accelerometers["hand"][inside][3:-3], wanted, atol=1e-4
    )
    assert any("/hand/data covers" in warning for warning in recording.health.warnings)
    recording = read(tmp_path, joints() + hand(MOTION, late_s=1e6))  # of another clock
    assert recording.accelerometers == {}
    assert recording.valid.all()
    assert any("do not overlap" in warning for warning in recording.health.warnings)


ELSEWHERE = "/arm/joint_states (sensor_msgs/msg/JointState, 200)"
HALF = imu_messages(stamps(MOTION.t), "/array/accel_1", MOTION.q)


@pytest.mark.parametrize(
    ("messages", "said"),
    [
        (joints(topic="/arm/joint_states"), ELSEWHERE),
        (joints(names="abc"), "names in the log: a, b, c"),
        (joints(names=JOINTS[:2]), "no position of joint wrist"),
        (joints() + HALF, "/array/accel_2"),
    ],
    ids=["topic", "names", "a joint less", "half an array"],
)
def test_what_is_missing_is_said(
    tmp_path: Path, messages: list[Message], said: str
) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, messages)
    assert said in caught.value.message
    if said == ELSEWHERE:
        assert "/arm/joint_states" in caught.value.hint
        contents = list_topics(tmp_path / "log.mcap")
        (topic,) = contents.topics
        assert contents.state_topics == ("/arm/joint_states",)
        assert contents.joints == JOINTS
        assert (topic.topic, topic.messages) == ("/arm/joint_states", 200)


def test_what_cannot_be_decoded_is_counted_and_its_encoding_named(
    tmp_path: Path,
) -> None:
    messages = joints()
    for _, _, content in messages[50:53]:
        content.position = [1.0, 2.0]
    recording = read(tmp_path, messages)
    assert (
        "3 of 200 messages of /joint_states could not be decoded" in recording.partial
    )
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-4)
    rows = [("/joint_states", i, b"\0" * 40) for i in range(50)]
    with pytest.raises(InputError, match="cbor"):
        read_recording(
            write_raw(tmp_path / "log.mcap", {"/joint_states": "cbor"}, rows), ROBOT
        )


def test_json_with_other_spellings_of_the_stamp(tmp_path: Path) -> None:
    messages = joints()
    for i, (_, _, content) in enumerate(messages):
        sec, nanosec = content.header.stamp.sec, content.header.stamp.nanosec
        content.header.stamp = [
            SimpleNamespace(sec=sec, nsec=nanosec),
            SimpleNamespace(secs=sec, nsecs=nanosec),
            SimpleNamespace(seconds=sec, nanos=nanosec),
            sec + nanosec * 1e-9,
        ][i % 4]
        content.effort = [None, 1.0, float("nan")] if i % 2 else [1.0, 1.0, 1.0]
    recording = read(tmp_path, messages, "json")
    np.testing.assert_allclose(recording.t, MOTION.t, atol=3e-7)
    np.testing.assert_allclose(recording.tau, 1.0)


T0 = 1_700_000_000


def test_cdr_of_other_fields(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = writers.DEFINITIONS[JOINT_STATE].replace(
        "string[] name", "uint8 mode\nstring[] name\n# not the usual one"
    )
    messages = joints()
    for _, _, content in messages:
        content.mode = 3
    monkeypatch.setitem(writers.DEFINITIONS, JOINT_STATE, other)
    np.testing.assert_array_equal(read(tmp_path, messages).q, MOTION.q)


def test_cdr_of_both_byte_orders_and_of_another_representation(tmp_path: Path) -> None:
    humble, rows = get_typestore(Stores.ROS2_HUMBLE), []
    for k, (topic, _, data) in enumerate(writers.encoded(joints(), "cdr")[1]):
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
    assert partial == "1 of 200 messages of /joint_states could not be decoded"


# their fields: type, or the name of a message; repeated where it ends with []
TYPES = {
    "Stamp": {"sec": Field.TYPE_INT32, "nanosec": Field.TYPE_UINT32},
    "Header": {"stamp": "Stamp"},
    "JointState": {
        "header": "Header",
        "name[]": Field.TYPE_STRING,
        **{
            f"{name}[]": Field.TYPE_DOUBLE
            for name in ("position", "velocity", "effort")
        },
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
            one = message.field.add(
                name=key.removesuffix("[]"), number=number, label=label
            )
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
        joints = state(
            header=header, name=JOINTS, position=MOTION.q[i], effort=MOTION.tau[i]
        )
        w, a = MOTION.gyros["hand"][i], MOTION.accelerometers["hand"][i]
        vectors = {"angular_velocity": w, "linear_acceleration": a}
        named = {
            name: dict(zip("xyz", own, strict=True)) for name, own in vectors.items()
        }
        messages.append(("/joint_states", i, joints.SerializeToString()))
        messages.append(
            ("/hand/data", i, imu(header=header, **named).SerializeToString())
        )
    topics = {"/joint_states": "ros.JointState", "/hand/data": "ros.Imu"}
    channels = {
        topic: ("protobuf", kind, "protobuf", text) for topic, kind in topics.items()
    }
    path = write_raw(tmp_path / "log.mcap", channels, messages)
    recording = read_recording(path, make_robot(imus=(GYRO,)))
    assert recording.dq is None
    for read in (lambda x: x.q, lambda x: x.tau, lambda x: x.gyros["hand"]):
        np.testing.assert_array_equal(read(recording), read(MOTION))
    found = recording.accelerometers["hand"]
    np.testing.assert_array_equal(found, MOTION.accelerometers["hand"])
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)


@pytest.mark.parametrize("schema", [b"", b"\xff", b"\x0a\xff\xff\xff\xff\x7f"])
def test_unusable_descriptors_are_an_error(tmp_path: Path, schema: bytes) -> None:
    topics = {"/joint_states": ("protobuf", "ros.JointState", "protobuf", schema)}
    path = write_raw(tmp_path / "log.mcap", topics, [("/joint_states", 0, b"")])
    with pytest.raises(InputError, match="can be decoded"):
        read_recording(path, make_robot())


def test_efforts_of_fewer_joints_than_names_are_said_so(tmp_path: Path) -> None:
    """They are not damaged, but nobody can tell whose they are."""
    motion = make_motion(grid(100))
    messages = writers.arm_messages(motion.t, JOINTS, motion.q, effort=motion.tau)
    for _, _, content in messages:
        content.effort = content.effort[:-1]
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    with pytest.raises(InputError, match="effort has 2 values for 3 names"):
        read_recording(path, make_robot())
