"""What a ROS bag is to its readers: topics as an MCAP file has them, and messages."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from mcap.records import Channel, Schema

KEPT_TYPES = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "std_msgs/msg/String",  # the robot's description
    "control_msgs/msg/DynamicJointState",
    "control_msgs/msg/JointTrajectoryControllerState",
)
MESSAGE_LIMIT = 1 << 24  # bytes of one unpacked message

Wanted = Callable[[str], bool]


class Message(NamedTuple):
    """One message."""

    channel: int
    time_ns: int
    data: bytes  # CDR


class Topic(NamedTuple):
    """One topic of a bag, as an MCAP file describes it."""

    channel: Channel
    schema: Schema
    messages: int


@dataclass(frozen=True)
class Bag:
    """An opened bag; `messages` are those of wanted topics and kept types."""

    topics: list[Topic]
    messages: Callable[[], Iterator[Message]]


def made_topic(
    number: int, name: str, kind: str, definition: str, messages: int
) -> Topic:
    """Describe a topic of CDR messages as an MCAP file does.

    Parameters
    ----------
    number : int
        Its number in the bag.
    kind : str
        Type of its messages.
    definition : str
        Definition of that type as a `.msg` file has it; empty where the bag has none.
    messages : int
        How many messages the bag has of it.
    """
    schema = Schema(id=number, data=definition.encode(), encoding="ros2msg", name=kind)
    channel = Channel(
        id=number,
        topic=name,
        message_encoding="cdr",
        metadata={},
        schema_id=number,
    )
    return Topic(channel, schema, messages)
