"""`[channels]` of a log as a whole: topics, names of joints, interfaces, time."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.toml_schema import Channels, Interfaces
from tests import Array
from tests.unit.logs import writers
from tests.unit.logs.samples import GYRO, JOINTS, Motion, grid, make_motion, make_robot
from tests.unit.logs.writers import Message, joint_messages, write_messages

MOTION = make_motion(grid(200))
OTHER = make_motion(grid(200) + 0.4)  # of a second robot


def stamps(t: Array) -> Array:
    return 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)


def states(motion: Motion, topic: str, prefix: str = "") -> list[Message]:
    names = [prefix + joint for joint in JOINTS]
    return joint_messages(
        stamps(MOTION.t), names, motion.q, effort=motion.tau, topic=topic
    )


def two_robots(folder: Path) -> Path:
    messages = states(MOTION, "/left/joint_states")
    messages += states(OTHER, "/right/joint_states")
    for motion, side in ((MOTION, "left"), (OTHER, "right")):
        messages += writers.imu_messages(
            stamps(MOTION.t),
            f"/{side}/hand/data",
            motion.accelerometers["hand"],
            motion.gyros["hand"],
        )
    return write_messages(folder / "log.mcap", messages, encoding="cdr")


@pytest.mark.parametrize(
    ("channels", "motion"),
    [
        (Channels(topic="/left/joint_states"), MOTION),
        (Channels(topic="/right/joint_states"), OTHER),
        (Channels(namespace="/right"), OTHER),
        (Channels(namespace="left", topic="joint_states"), MOTION),
    ],
    ids=["left", "right", "namespace", "topic within the namespace"],
)
def test_one_of_two_robots_in_a_bag(
    tmp_path: Path, channels: Channels, motion: Motion
) -> None:
    imus = (GYRO,) if channels.namespace else ()
    robot = make_robot(imus=imus, channels=channels)
    recording = read_recording(two_robots(tmp_path), robot)
    np.testing.assert_array_equal(recording.q, motion.q)
    np.testing.assert_array_equal(recording.tau, motion.tau)
    for imu in imus:
        np.testing.assert_array_equal(
            recording.accelerometers[imu.name], motion.accelerometers[imu.name]
        )
        np.testing.assert_array_equal(recording.gyros[imu.name], motion.gyros[imu.name])


def test_topics_of_two_robots_are_offered(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_recording(two_robots(tmp_path), make_robot())
    assert "/left/joint_states or /right/joint_states" in caught.value.hint
    assert '[channels] topic = "/left/joint_states"' in caught.value.hint


def test_a_topic_that_is_not_there_is_said(tmp_path: Path) -> None:
    robot = make_robot(channels=Channels(topic="/middle/joint_states"))
    with pytest.raises(InputError, match="no messages on /middle/joint_states"):
        read_recording(two_robots(tmp_path), robot)


@pytest.mark.parametrize("suffix", [".mcap", ".parquet"])
@pytest.mark.parametrize(
    "channels",
    [
        Channels(prefix="left_"),
        Channels(names="left_{name}"),
        Channels(names=tuple(f"left_{joint}" for joint in JOINTS)),
    ],
    ids=["prefix", "pattern", "list"],
)
def test_joints_of_other_names_in_the_log(
    tmp_path: Path, channels: Channels, suffix: str
) -> None:
    path = tmp_path / f"log{suffix}"
    names = [f"left_{joint}" for joint in JOINTS]
    if suffix == ".mcap":
        messages = states(OTHER, "/joint_states")
        messages += states(MOTION, "/joint_states", "left_")
        write_messages(path, messages, encoding="cdr")
    else:
        writers.write_parquet(path, MOTION.t, names, MOTION.q, torque=MOTION.tau)
    recording = read_recording(path, make_robot(channels=channels))
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-9)
    np.testing.assert_allclose(recording.tau, MOTION.tau, atol=1e-9)


def dynamic(path: Path) -> Path:
    """Write a DynamicJointState whose driver has names of its own."""
    kinds = ["motor_position", "position", "winding", "effort"]
    messages = []
    for i, stamp in enumerate(stamps(MOTION.t).tolist()):
        q, tau = MOTION.q[i], MOTION.tau[i]
        rows = [[0.5, q[j], tau[j] / 4.0, tau[j]] for j in range(len(JOINTS))]
        values = [SimpleNamespace(interface_names=kinds, values=row) for row in rows]
        content = {
            "header": writers.header(stamp),
            "joint_names": list(JOINTS),
            "interface_values": values,
        }
        messages.append(("/dynamic_joint_states", stamp, SimpleNamespace(**content)))
    return write_messages(path, messages, encoding="cdr")


def test_interfaces_of_other_names(tmp_path: Path) -> None:
    path = dynamic(tmp_path / "log.mcap")
    usual = read_recording(path, make_robot())
    np.testing.assert_array_equal(usual.tau, MOTION.tau)

    interface = Interfaces(position="motor_position", current="winding")
    robot = make_robot(
        constants=2.0, gear_ratio=2.0, channels=Channels(interface=interface)
    )
    recording = read_recording(path, robot)
    np.testing.assert_allclose(recording.q, 0.5)
    np.testing.assert_allclose(recording.tau, MOTION.tau)


def test_a_declared_topic_is_read_as_its_type_says(tmp_path: Path) -> None:
    path = dynamic(tmp_path / "log.mcap")
    robot = make_robot(channels=Channels(topic="/dynamic_joint_states"))
    np.testing.assert_array_equal(read_recording(path, robot).q, MOTION.q)


@pytest.mark.parametrize(
    ("unit", "factor"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)]
)
@pytest.mark.parametrize("name", ["time", "t", "tick_ms"])
def test_unit_of_time(tmp_path: Path, unit: str, factor: float, name: str) -> None:
    path = tmp_path / "log.csv"
    columns = [MOTION.t * factor, *MOTION.q.T, *MOTION.tau.T]
    quantities = [f"{j}.{q}" for q in ("position", "torque") for j in JOINTS]
    np.savetxt(
        path,
        np.column_stack(columns),
        delimiter=",",
        comments="",
        header=",".join([name, *quantities]),
        fmt="%.10g",
    )
    channels = Channels(time=name, time_unit=unit)  # type: ignore[arg-type]
    recording = read_recording(path, make_robot(channels=channels))
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-7)
