"""MCAP logs: encodings, file variants, partial content, damage."""

import struct
from dataclasses import replace
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
    imu_messages,
    joint_messages,
    rewrite,
    write_mcap,
    write_messages,
    write_raw,
)

T0 = 1_700_000_000_000_000_000
ROBOT = make_robot(imus=(ARRAY, GYRO))


def stamps(t: np.ndarray) -> np.ndarray:
    return T0 + np.rint(t * 1e9).astype(np.int64)


def assert_holds(recording: Recording, motion: Motion, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(recording.t, motion.t, atol=1e-9)
    np.testing.assert_allclose(recording.q, motion.q, atol=atol)
    assert recording.dq is not None
    assert recording.tau is not None
    np.testing.assert_allclose(recording.dq, motion.dq, atol=atol)
    np.testing.assert_allclose(recording.tau, motion.tau, atol=20 * atol)
    for name, values in motion.accelerometers.items():
        np.testing.assert_allclose(recording.accelerometers[name], values, atol=atol)
    for name, values in motion.gyros.items():
        np.testing.assert_allclose(recording.gyros[name], values, atol=atol)
    assert recording.valid.all()


@pytest.mark.parametrize("delay_s", [0.0, 0.002])
def test_joint_states_split_over_two_messages(tmp_path: Path, delay_s: float) -> None:
    t = grid(200)
    motion, later = make_motion(t), make_motion(t + delay_s)
    first = joint_messages(stamps(t), JOINTS[:1], motion.q[:, :1], effort=motion.tau[:, :1])
    second = joint_messages(
        stamps(t + delay_s), JOINTS[1:], later.q[:, 1:], effort=later.tau[:, 1:]
    )
    messages = [message for pair in zip(first, second, strict=True) for message in pair]
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    recording = read_recording(path, make_robot())
    assert recording.rate_hz == pytest.approx(100.0)
    assert recording.health.duplicates == 0
    expected = make_motion(recording.t + (0.01 if delay_s else 0.0))
    np.testing.assert_allclose(recording.q[2:-2], expected.q[2:-2], atol=1e-7)
    np.testing.assert_allclose(recording.tau[2:-2], expected.tau[2:-2], atol=1e-5)
    assert recording.valid[1:-1].all()


def test_header_stamps_and_log_times(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    path = write_motion(tmp_path / "log.mcap", motion, log_offset_ns=3_000_000)
    recording = read_recording(path, ROBOT)
    assert recording.health.log_minus_header_s == pytest.approx(0.003)
    assert_holds(read_recording(path, ROBOT, time_source="log"), motion)


def test_zero_header_stamps_fall_back_to_log_times(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    path = write_motion(tmp_path / "log.mcap", motion, zero_stamps=True)
    recording = read_recording(path, ROBOT)
    assert_holds(recording, motion)
    assert recording.health.log_minus_header_s is None
    assert any("all zero" in warning for warning in recording.health.warnings)


def test_imu_with_its_own_rate_and_span(tmp_path: Path) -> None:
    t, t_imu = grid(300), 0.5 + grid(600, 333.0)
    motion, imu = make_motion(t), make_motion(t_imu)
    messages = joint_messages(stamps(t), JOINTS, motion.q)
    messages += imu_messages(
        stamps(t_imu), "/hand/data", imu.accelerometers["hand"], imu.gyros["hand"]
    )
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    recording = read_recording(path, ROBOT)
    inside = (t >= t_imu[0]) & (t <= t_imu[-1])
    np.testing.assert_array_equal(recording.valid, inside)
    assert "array" not in recording.accelerometers
    wanted = motion.accelerometers["hand"][inside][3:-3]
    np.testing.assert_allclose(recording.accelerometers["hand"][inside][3:-3], wanted, atol=1e-4)
    assert any("/hand/data covers" in warning for warning in recording.health.warnings)


def test_imu_on_another_clock_is_left_out(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    messages = joint_messages(stamps(motion.t), JOINTS, motion.q)
    messages += imu_messages(
        stamps(motion.t + 1e6), "/hand/data", motion.accelerometers["hand"], motion.gyros["hand"]
    )
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    recording = read_recording(path, ROBOT)
    assert recording.accelerometers == {}
    assert recording.valid.all()
    assert any("do not overlap" in warning for warning in recording.health.warnings)


def test_half_an_accelerometer_array_is_an_error(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    source = write_motion(tmp_path / "source.mcap", motion)
    path = rewrite(source, tmp_path / "log.mcap", keep=lambda topic: topic != "/array/accel_2")
    with pytest.raises(InputError, match="/array/accel_2"):
        read_recording(path, ROBOT)


def test_no_joint_states_lists_the_topics(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    messages = joint_messages(stamps(motion.t), JOINTS, motion.q, topic="/arm/joint_states")
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    with pytest.raises(InputError) as caught:
        read_recording(path, make_robot())
    assert "/arm/joint_states (sensor_msgs/msg/JointState, 100)" in caught.value.message
    assert "/arm/joint_states" in caught.value.hint
    (topic,), _ = list_topics(path)
    assert (topic.topic, topic.encoding, topic.messages) == ("/arm/joint_states", "cdr", 100)


def test_other_joint_names_are_listed(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    path = write_mcap(tmp_path / "log.mcap", motion.t, ["a", "b", "c"], motion.q, encoding="cdr")
    with pytest.raises(InputError, match="names in the log: a, b, c"):
        read_recording(path, make_robot())
    path = write_mcap(tmp_path / "two.mcap", motion.t, JOINTS[:2], motion.q[:, :2], encoding="cdr")
    with pytest.raises(InputError, match="no position of joint wrist"):
        read_recording(path, make_robot())


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_messages_of_another_publisher_are_no_samples(tmp_path: Path, encoding: str) -> None:
    motion = replace(make_motion(grid(200)), accelerometers={}, gyros={})
    own = joint_messages(stamps(motion.t), JOINTS, motion.q, dq=motion.dq, effort=motion.tau)
    still = np.full((20, 1), 0.01)
    gripper = joint_messages(stamps(motion.t[::10] + 0.0033), ["finger"], still)
    messages = sorted([*own, *gripper], key=lambda message: message[1])
    path = write_messages(tmp_path / "log.mcap", messages, encoding=encoding)
    recording = read_recording(path, make_robot())
    assert_holds(recording, motion)
    assert not recording.health.resampled
    assert recording.health.warnings == ()


def test_unknown_encoding_is_named(tmp_path: Path) -> None:
    messages = [("/joint_states", i, b"\0" * 40) for i in range(50)]
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": "cbor"}, messages)
    with pytest.raises(InputError, match="cbor"):
        read_recording(path, make_robot())


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("chunk_size", [8192, 1 << 22])
def test_truncated_file_is_salvaged(tmp_path: Path, compression: str, chunk_size: int) -> None:
    rng = np.random.default_rng(0)
    t = grid(4000)
    q = rng.normal(size=(len(t), 3))  # does not compress: half the file is half the log
    source = write_mcap(
        tmp_path / "source.mcap",
        t,
        JOINTS,
        q,
        encoding="cdr",
        compression=compression,
        chunk_size=chunk_size,
    )
    path = tmp_path / "log.mcap"
    path.write_bytes(source.read_bytes()[: source.stat().st_size // 2])
    recording = read_recording(path, make_robot())
    assert "breaks off" in recording.partial
    assert "messages were read" in recording.partial
    assert 500 < len(recording.t) < len(t)
    np.testing.assert_array_equal(recording.q, q[: len(recording.t)])


def test_recording_that_was_not_closed(tmp_path: Path) -> None:
    motion = make_motion(grid(200))
    path = tmp_path / "log.mcap"
    source = write_mcap(
        tmp_path / "source.mcap", motion.t, JOINTS, motion.q, encoding="cdr", compression="none"
    )
    plain = rewrite(source, tmp_path / "plain.mcap", chunking=False, index=False, summary=False)
    end = plain.read_bytes().rindex(b"\x0f\x04\0\0\0\0\0\0\0")  # the DataEnd record
    path.write_bytes(plain.read_bytes()[:end])
    recording = read_recording(path, make_robot())
    assert len(recording.t) == 200
    assert "not closed" in recording.partial


def test_nothing_to_salvage_is_an_error(tmp_path: Path) -> None:
    motion = make_motion(grid(200))
    source = write_motion(tmp_path / "source.mcap", motion)
    path = tmp_path / "log.mcap"
    path.write_bytes(source.read_bytes()[:60])
    with pytest.raises(InputError, match="nothing can be salvaged"):
        read_recording(path, ROBOT)


def test_checksum_of_unchunked_data(tmp_path: Path) -> None:
    motion = make_motion(grid(200))
    source = write_motion(tmp_path / "source.mcap", motion)
    path = rewrite(source, tmp_path / "log.mcap", chunking=False)
    assert read_recording(path, ROBOT).partial == ""
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<d", motion.q[100, 1]))
    data[at] ^= 1
    path.write_bytes(data)
    assert "checksum" in read_recording(path, ROBOT).partial


def test_malformed_messages_are_counted(tmp_path: Path) -> None:
    motion = make_motion(grid(200))
    messages = joint_messages(stamps(motion.t), JOINTS, motion.q)
    for _, _, content in messages[50:53]:
        content.position = [1.0, 2.0]
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    recording = read_recording(path, make_robot())
    assert "3 of 200 messages of /joint_states could not be decoded" in recording.partial
    np.testing.assert_allclose(recording.q, motion.q, atol=1e-4)


def test_json_with_other_spellings_of_the_stamp(tmp_path: Path) -> None:
    motion = make_motion(grid(100))
    messages = joint_messages(stamps(motion.t), JOINTS, motion.q)
    for i, (_, _, content) in enumerate(messages):
        stamp = content.header.stamp
        spellings = [
            SimpleNamespace(sec=stamp.sec, nsec=stamp.nanosec),
            SimpleNamespace(secs=stamp.sec, nsecs=stamp.nanosec),
            SimpleNamespace(seconds=stamp.sec, nanos=stamp.nanosec),
        ]
        content.header.stamp = spellings[i % 3]
        content.effort = [None, 1.0, float("nan")] if i % 2 else [1.0, 1.0, 1.0]
    path = write_messages(tmp_path / "log.mcap", messages, encoding="json")
    recording = read_recording(path, make_robot())
    np.testing.assert_allclose(recording.t, motion.t, atol=1e-9)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, 1.0)
