"""Which topics carry what a robot needs, and their samples as streams."""

from collections.abc import Iterable

import numpy as np

from seqid_cli.logs.drives import in_si
from seqid_cli.logs.mcap.collector import Samples
from seqid_cli.logs.messages.batch import JOINT_QUANTITIES, Kind
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO, Stream
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array

JOINT_STATES = "/joint_states"
DYNAMIC_JOINT_STATES = "/dynamic_joint_states"


def find_joint_topic(topics: Iterable[tuple[str, str]]) -> tuple[str, Kind] | None:
    """Choose the topic of the joint states, and how it is read.

    `topics` are names with the type of their messages. None where no topic is sure, or
    two are.
    """
    type_by_topic = dict(topics)
    if DYNAMIC_JOINT_STATES in type_by_topic:
        return DYNAMIC_JOINT_STATES, "dynamic_joint_state"

    # Types that only measured states have; a JointState on another topic may as well be
    # a command.
    of_foxglove = [
        topic
        for topic, type_name in type_by_topic.items()
        if type_name == "foxglove.JointStates"
    ]
    dynamic = [
        topic
        for topic, type_name in type_by_topic.items()
        if type_name.endswith("DynamicJointState")
    ]
    if len(of_foxglove) == 1:
        return of_foxglove[0], "joint_state"
    if len(dynamic) == 1:
        return dynamic[0], "dynamic_joint_state"
    return None


def data_topic(imu: Imu) -> str:
    """Name the topic of a whole IMU."""
    return f"/{imu.name}/data"


def triad_topics(imu: Imu) -> list[str]:
    """Name the topics of an array of accelerometers, one for each three of them."""
    n_triads = -(-len(imu.positions) // 3)
    return [f"/{imu.name}/accel_{k + 1}" for k in range(n_triads)]


def joint_stream(topic: str, samples: Samples, robot: Robot) -> Stream:
    """Make a stream of joint states, without the messages of a gripper alone."""
    stamps = samples.stamp_ns
    values = samples.values
    is_of_robot = np.isfinite(values).any(axis=1)
    if not is_of_robot.all():
        stamps = stamps[is_of_robot]
        values = values[is_of_robot]

    blocks = np.split(values, len(JOINT_QUANTITIES), axis=1)
    by_quantity = dict(zip(JOINT_QUANTITIES, blocks, strict=True))
    is_current = robot.channels.effort == "current"
    by_quantity["current" if is_current else "torque"] = by_quantity.pop("effort")
    channels = {
        quantity: block
        for quantity, block in by_quantity.items()
        if quantity == "position" or any_finite(block)
    }
    return Stream(topic, stamps, in_si(channels, stamps, robot))


def imu_stream(topic: str, samples: Samples, imu: Imu) -> Stream:
    """Make a stream of what one topic tells of an IMU."""
    count = len(imu.positions)
    triads = triad_topics(imu)
    channels = {}
    if topic in triads or count == 3:
        first = 3 * triads.index(topic) if topic in triads else 0
        channels[ACCELEROMETERS] = samples.values[:, : min(3, count - first)]
    if topic == data_topic(imu) and imu.gyro:
        channels[GYRO] = samples.values[:, 3:]
    return Stream(topic, samples.stamp_ns, channels)


def any_finite(values: Array) -> bool:
    """Tell whether any value is a number; the first row mostly knows."""
    return bool(np.isfinite(values[:1]).any() or np.isfinite(values).any())
