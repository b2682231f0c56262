"""MCAP logs: clocks, topics, publishers, messages that cannot be decoded."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.reader import list_topics
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from tests.unit.logs.samples import (
    ARRAY,
    GYRO,
    JOINTS,
    Motion,
    grid,
    make_motion,
    make_robot,
    write_motion,
)
from tests.unit.logs.writers import (
    Message,
    imu_messages,
    joint_messages,
    write_messages,
    write_raw,
)

ROBOT = make_robot(imus=(ARRAY, GYRO))
MOTION = make_motion(grid(200))


def stamps(t: np.ndarray) -> np.ndarray:
    return 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)


def read(folder: Path, messages: list[Message], encoding: str = "cdr") -> Recording:
    return read_recording(write_messages(folder / "log.mcap", messages, encoding=encoding), ROBOT)


def joints(motion: Motion = MOTION, names: Sequence[str] = JOINTS, **options: str) -> list[Message]:
    return joint_messages(stamps(motion.t), names, motion.q[:, : len(names)], **options)


def hand(motion: Motion, late_s: float = 0.0) -> list[Message]:
    readings = motion.accelerometers["hand"], motion.gyros["hand"]
    return imu_messages(stamps(motion.t + late_s), "/hand/data", *readings)


@pytest.mark.parametrize("delay_s", [0.0, 0.002])
def test_joint_states_split_over_two_messages(tmp_path: Path, delay_s: float) -> None:
    later = make_motion(MOTION.t + delay_s)
    parts = [
        joint_messages(stamps(m.t), JOINTS[own], m.q[:, own], effort=m.tau[:, own])
        for m, own in ((MOTION, slice(1)), (later, slice(1, None)))
    ]
    recording = read(tmp_path, [message for pair in zip(*parts, strict=True) for message in pair])
    assert recording.rate_hz == pytest.approx(100.0)
    assert recording.health.duplicates == 0
    expected = make_motion(recording.t + (0.01 if delay_s else 0.0))
    np.testing.assert_allclose(recording.q[2:-2], expected.q[2:-2], atol=1e-7)
    np.testing.assert_allclose(recording.tau[2:-2], expected.tau[2:-2], atol=1e-5)
    assert recording.valid[1:-1].all()


def test_header_stamps_log_times_and_zeros(tmp_path: Path) -> None:
    path = write_motion(tmp_path / "log.mcap", MOTION, log_offset_ns=3_000_000)
    assert read_recording(path, ROBOT).health.log_minus_header_s == pytest.approx(0.003)
    by_log = read_recording(path, ROBOT, time_source="log")
    path = write_motion(tmp_path / "zero.mcap", MOTION, zero_stamps=True)
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
    np.testing.assert_allclose(recording.accelerometers["hand"][inside][3:-3], wanted, atol=1e-4)
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
def test_what_is_missing_is_said_with_what_is_there(
    tmp_path: Path, messages: list[Message], said: str
) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, messages)
    assert said in caught.value.message
    if said == ELSEWHERE:
        assert "/arm/joint_states" in caught.value.hint
        (topic,), _ = list_topics(tmp_path / "log.mcap")
        assert (topic.topic, topic.encoding, topic.messages) == ("/arm/joint_states", "cdr", 200)


def test_messages_that_cannot_be_decoded_are_counted_and_their_encoding_named(
    tmp_path: Path,
) -> None:
    messages = joints()
    for _, _, content in messages[50:53]:
        content.position = [1.0, 2.0]
    recording = read(tmp_path, messages)
    assert "3 of 200 messages of /joint_states could not be decoded" in recording.partial
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-4)
    rows = [("/joint_states", i, b"\0" * 40) for i in range(50)]
    with pytest.raises(InputError, match="cbor"):
        read_recording(write_raw(tmp_path / "log.mcap", {"/joint_states": "cbor"}, rows), ROBOT)


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
