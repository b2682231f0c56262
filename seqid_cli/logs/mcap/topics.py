"""Which topics carry what a robot needs, and their samples as streams."""

import re
from collections.abc import Iterable

import numpy as np

from seqid_cli.logs.drives import in_si, in_units
from seqid_cli.logs.mcap.collector import Samples
from seqid_cli.logs.messages.batch import JOINT_QUANTITIES
from seqid_cli.logs.messages.parsers import CONTROLLER
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO, Stream
from seqid_cli.logs.tables.name_words import COMMANDED, COMMANDS
from seqid_cli.robot.toml_schema import Channels
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array

JOINT_STATES = "/joint_states"
DYNAMIC_JOINT_STATES = "/dynamic_joint_states"


def normal(topic: str) -> str:
    """Return a topic with one slash in front and none behind."""
    return "/" + topic.strip("/")


def within(channels: Channels, topic: str) -> str:
    """Name a topic in the namespace that the robot file gives, if any."""
    return normal(f"{(channels.namespace or '').strip('/')}/{topic.strip('/')}")


def usual_joint_topic(channels: Channels) -> str:
    """Name the topic that the robot file says, or else the usual one."""
    declared = channels.topic
    if declared is None:
        return within(channels, JOINT_STATES)
    if declared.startswith("/"):
        return normal(declared)
    return within(channels, declared)


def find_joint_topic(
    topics: Iterable[tuple[str, str]], channels: Channels
) -> str | None:
    """Choose the topic of the joint states where the usual one is not in a file.

    `topics` are names with the type of their messages. None where no topic is sure,
    where two are, or where the robot file names another one.
    """
    if channels.topic is not None:
        return None
    namespace = within(channels, "")
    type_by_topic = {
        topic: type_name
        for topic, type_name in topics
        if topic.startswith(f"{namespace.rstrip('/')}/")
    }
    dynamic_topic = within(channels, DYNAMIC_JOINT_STATES)
    if dynamic_topic in type_by_topic:
        return dynamic_topic

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
    # The state of a controller has positions as well, where nothing better is there.
    controllers = [
        topic
        for topic, type_name in type_by_topic.items()
        if type_name.endswith(CONTROLLER)
    ]
    for sure in (of_foxglove, dynamic, controllers):
        if len(sure) == 1:
            return sure[0]
    return None


def state_topics(topics: Iterable[tuple[str, str]]) -> list[str]:
    """List the topics that may carry the joint states, the likeliest first.

    That is for a proposal, which a person looks at. Topics of commands come last.
    """

    def rank(topic: str) -> tuple[bool, bool, str]:
        words = re.split(r"[^a-z]+", topic.lower())
        is_command = not COMMANDED.isdisjoint(words)
        return is_command, not topic.endswith(JOINT_STATES), topic

    return sorted(
        {
            topic
            for topic, type_name in topics
            if type_name.endswith(("JointState", "JointStates"))
        },
        key=rank,
    )


def data_topic(imu: Imu, channels: Channels) -> str:
    """Name the topic of a whole IMU."""
    return within(channels, f"{imu.name}/data")


def triad_topics(imu: Imu, channels: Channels) -> list[str]:
    """Name the topics of an array of accelerometers, one for each three of them."""
    n_triads = -(-len(imu.positions) // 3)
    return [within(channels, f"{imu.name}/accel_{k + 1}") for k in range(n_triads)]


def joint_stream(topic: str, samples: Samples, robot: Robot) -> Stream:
    """Make a stream of joint states, without the messages of a gripper alone."""
    stamps = samples.stamp_ns
    values = samples.values
    is_of_robot = np.isfinite(values).any(axis=1)
    if not is_of_robot.all():
        stamps = stamps[is_of_robot]
        values = values[is_of_robot]

    by_quantity = _by_quantity(values, robot)
    is_current = robot.channels.effort_is_current
    by_quantity["current" if is_current else "torque"] = by_quantity.pop("effort")
    channels = {
        quantity: block
        for quantity, block in by_quantity.items()
        if quantity == "position" or any_finite(block)
    }
    return Stream(topic, stamps, in_si(channels, stamps, robot))


def _by_quantity(values: Array, robot: Robot) -> dict[str, Array]:
    """Part rows of joint states into quantities (M, n)."""
    quantities = (*JOINT_QUANTITIES, *COMMANDS)
    n_quantities = values.shape[1] // robot.n
    blocks = np.split(values, n_quantities, axis=1)
    return dict(zip(quantities[:n_quantities], blocks, strict=True))


def declared_command_topic(channels: Channels) -> str | None:
    """Name the topic of commands that the robot file says."""
    declared = channels.command_topic
    if declared is None:
        return None
    return normal(declared) if declared.startswith("/") else within(channels, declared)


def is_command_topic(topic: str, type_name: str, channels: Channels) -> bool:
    """Tell whether a topic is the state of a controller of this robot.

    That is in the namespace of its joint states: another arm may have the same names.
    """
    beside = usual_joint_topic(channels).rpartition("/")[0]
    return type_name.endswith(CONTROLLER) and topic.startswith(f"{beside}/")


def command_stream(topic: str, samples: Samples, robot: Robot) -> Stream:
    """Make a stream of commands: a JointState that asks, or a controller's state."""
    by_quantity = _by_quantity(samples.values, robot)
    if COMMANDS[0] not in by_quantity:
        effort = by_quantity["effort"]
        if robot.channels.effort_is_current:
            effort = effort * np.array(
                [joint.torque_per_ampere for joint in robot.joints], np.float64
            )
        by_quantity = {
            "command": by_quantity["position"],
            "command_velocity": by_quantity["velocity"],
            "command_torque": effort,
        }
    channels = {
        quantity: by_quantity[quantity]
        for quantity in COMMANDS
        if any_finite(by_quantity[quantity])
    }
    return Stream(topic, samples.stamp_ns, in_units(channels, robot))


def imu_stream(topic: str, samples: Samples, imu: Imu, channels: Channels) -> Stream:
    """Make a stream of what one topic tells of an IMU."""
    count = len(imu.positions)
    triads = triad_topics(imu, channels)
    readings = {}
    if topic in triads or count == 3:
        first = 3 * triads.index(topic) if topic in triads else 0
        readings[ACCELEROMETERS] = samples.values[:, : min(3, count - first)]
    if topic == data_topic(imu, channels) and imu.gyro:
        readings[GYRO] = samples.values[:, 3:]
    return Stream(topic, samples.stamp_ns, readings)


def any_finite(values: Array) -> bool:
    """Tell whether any value is a number; the first row mostly knows."""
    return bool(np.isfinite(values[:1]).any() or np.isfinite(values).any())
