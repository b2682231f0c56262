"""ROS 1 messages in MCAP files: packed without padding, damaged, of other fields."""

import struct
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests.unit.logs.format_writers import (
    T0_NS,
    Data,
    joint_states,
    ros1_rows,
    write_ros1,
)
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import arm_messages, write_raw

MOTION = make_motion(grid(100))
DATA = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)


@pytest.mark.parametrize("defined", [True, False])
def test_joints_and_imus(tmp_path: Path, defined: bool) -> None:
    channels = {"accelerometers": MOTION.accelerometers, "gyros": MOTION.gyros}
    messages = arm_messages(MOTION.t, JOINTS, MOTION.q, effort=MOTION.tau, **channels)
    path = write_ros1(tmp_path / "log.mcap", messages, defined=defined)
    recording = read_recording(path, make_robot(imus=(ARRAY, GYRO)))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    for name in ("array", "hand"):
        np.testing.assert_array_equal(
            recording.accelerometers[name], MOTION.accelerometers[name]
        )
    np.testing.assert_array_equal(recording.gyros["hand"], MOTION.gyros["hand"])
    assert recording.start == pytest.approx(T0_NS * 1e-9, abs=1e-6)
    assert recording.partial == ""


def packed() -> list[bytes]:
    """Messages with the sequence numbers that ROS 1 has in front."""
    rows = []
    for number, (_, _, data) in enumerate(ros1_rows(joint_states(DATA))):
        rows.append(struct.pack("<I", number) + data[4:])
    return rows


CHANNEL = {"/joint_states": ("ros1", "sensor_msgs/JointState", "ros1msg", b"")}


def test_sequence_numbers_are_no_structure(tmp_path: Path) -> None:
    rows = [("/joint_states", i, data) for i, data in enumerate(packed())]
    path = write_raw(tmp_path / "log.mcap", CHANNEL, rows)
    recording = read_recording(path, make_robot())
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)


def test_damaged_messages_are_counted(tmp_path: Path) -> None:
    rows = packed()
    rows[10] = rows[10][:-1]  # it breaks off
    rows[20] = rows[20][:13] + b"\xff\xff\xff\xff" + rows[20][17:]  # names without end
    rows[30] = b""
    path = write_raw(
        tmp_path / "log.mcap",
        CHANNEL,
        [("/joint_states", i, data) for i, data in enumerate(rows)],
    )
    partial = read_recording(path, make_robot()).partial
    assert partial == "3 of 100 messages of /joint_states could not be decoded"


def test_other_fields_are_refused(tmp_path: Path) -> None:
    definition = b"Header header\nstring[] name\nuint8 mode\nfloat64[] position\n"
    channel = ("ros1", "own/JointState", "ros1msg", definition)
    rows = [("/joint_states", i, data) for i, data in enumerate(packed())]
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": channel}, rows)
    with pytest.raises(InputError, match="its encoding 'ros1' is not known"):
        read_recording(path, make_robot())
