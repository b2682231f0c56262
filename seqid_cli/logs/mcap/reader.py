"""MCAP logs: a pass over a file, and the messages of some topics block by block."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.collector import Collector
from seqid_cli.logs.mcap.records import Scan
from seqid_cli.logs.mcap.topics import (
    any_finite,
    command_stream,
    data_topic,
    declared_command_topic,
    find_joint_topic,
    imu_stream,
    is_command_topic,
    joint_stream,
    normal,
    state_topics,
    triad_topics,
    usual_joint_topic,
)
from seqid_cli.logs.messages.batch import Kind, NameMap
from seqid_cli.logs.raw import OTHER_NAMES, RawLog, Stream, TimeSource, partly_logged
from seqid_cli.robot.toml_schema import Channels, Interfaces
from seqid_cli.robot.types import Imu, Robot

_SHOWN = 12  # topics or names listed in a message
_FAULTS = 3  # faults of a file listed in a message


class TopicInfo(NamedTuple):
    """One topic of a file."""

    topic: str
    schema: str
    messages: int


def read_blocks(
    path: Path,
    robot: Robot,
    time_source: TimeSource = "header",
    *,
    rows: int | None = 32_768,
    scan: type[Scan] = Scan,
) -> Iterator[RawLog]:
    """Read an MCAP log block by block, in memory that does not grow with its length.

    Parameters
    ----------
    robot : Robot
        Names of joints and IMUs; what an effort is.
    time_source : {"header", "log"}
        The stamps in the messages, or the times of logging.
    rows : int, optional
        Messages in a block, of all topics together, about; None for one block.
    scan : type of Scan
        The pass over a file of this format.

    Yields
    ------
    RawLog
        The next part of every topic, empty where it has none; a quantity that no sample
        of a block has is left out of it. The last block says in `partial` what a
        damaged file lost.

    Raises
    ------
    InputError
        After the last block: no joint states, none of the robot's joints in them,
        nothing readable.
    """
    channels = robot.channels
    names = NameMap(
        robot.log_names,
        "current" if channels.effort_is_current else "torque",
        interfaces=_interfaces(channels.interface),
    )
    imu_topics = [  # all topics on which they may be logged
        topic
        for imu in robot.imus
        for topic in (data_topic(imu, channels), *triad_topics(imu, channels))
    ]
    log = _Log(path, names, channels, imu_topics, scan, time_source)

    has_positions = False
    for is_last in log.blocks(rows):
        samples = {
            topic: collector.drain() for topic, collector in log.collectors.items()
        }
        joint_samples = samples[log.joint_topic]
        if is_last and not log.collectors[log.joint_topic].readable:
            raise _no_joint_states(log.scan, log.collectors[log.joint_topic], channels)
        joints = joint_stream(log.joint_topic, joint_samples, robot)

        imus: dict[str, tuple[Stream, ...]] = {}
        warnings = list(joint_samples.warnings)
        for imu in robot.imus:
            topics = log.imu_topics(imu, whole=is_last)
            if topics:
                imus[imu.name] = tuple(
                    imu_stream(topic, samples[topic], imu, channels) for topic in topics
                )
            for topic in topics:
                warnings += samples[topic].warnings

        commands = [
            command_stream(topic, samples[topic], robot) for topic in log.command_topics
        ]
        for topic in log.command_topics:
            warnings += samples[topic].warnings
        if is_last and channels.command_topic is not None:
            log.check_commands()

        has_positions = has_positions or any_finite(joints.channels["position"])
        if is_last and not has_positions:
            raise _no_positions(names, path)
        yield RawLog(
            joints,
            imus,
            commands=tuple(commands),
            partial=log.partial() if is_last else "",
            warnings=tuple(warnings),
            log_minus_header_s=joint_samples.delay_s,
            names=tuple(names.seen),
        )


def _interfaces(interface: Interfaces | None) -> dict[str, str]:
    """Return the names of interfaces by the fields that they are read as."""
    if interface is None:
        return {}
    name_by_field = {
        "position": interface.position,
        "velocity": interface.velocity,
        "effort": interface.current or interface.torque,
        "command": interface.command,
        "command_velocity": interface.command_velocity,
        "command_torque": interface.command_torque,
    }
    return {field: name for field, name in name_by_field.items() if name is not None}


class FileContents(NamedTuple):
    """What a file holds, damaged or not."""

    topics: tuple[TopicInfo, ...]
    joints: tuple[str, ...]  # that the joint states name
    # which may carry joint states, where none of them does for sure; the first was read
    state_topics: tuple[str, ...]
    complete: bool  # whether all joint states were looked at


def list_topics(
    path: Path, *, scan: type[Scan] = Scan, glance: bool = False
) -> FileContents:
    """List the topics of a file, and the names in its joint states.

    Where no topic is sure to carry them, they are read from the likeliest. At a
    `glance` names are of the first joint states alone, where the file lists its topics:
    whoever reads the others is to see whether they have more (`RawLog.names`).
    """
    contents = _list_topics(path, Channels(), scan, glance=glance)
    if contents.joints:
        return contents
    candidates = state_topics((normal(info.topic), info.schema) for info in contents[0])
    if not candidates:
        return contents
    channels = Channels(topic=candidates[0])
    likeliest = _list_topics(path, channels, scan, glance=glance)
    return likeliest._replace(state_topics=tuple(candidates))


def _list_topics(
    path: Path,
    channels: Channels,
    scan: type[Scan],
    *,
    glance: bool,
    first_messages: int = 2000,
) -> FileContents:
    names = NameMap(())
    log = _Log(path, names, channels, (), scan, "header")
    is_complete = True
    for _ in log.batches():
        collector = log.collectors[log.joint_topic]
        collector.drain()
        are_many = collector.readable and collector.received >= first_messages
        if glance and are_many and log.scan.lists_channels:
            is_complete = False
            break
    log.collectors[log.joint_topic].drain()
    return FileContents(_topics(log.scan), tuple(names.seen), (), is_complete)


class _Log:
    """A pass over a file that gathers the messages of some topics."""

    def __init__(
        self,
        path: Path,
        names: NameMap,
        channels: Channels,
        imu_topics: Sequence[str],
        scan: type[Scan],
        time_source: TimeSource,
    ) -> None:
        self.channels = channels
        self.joint_topic = usual_joint_topic(channels)
        kinds: dict[str, Kind] = dict.fromkeys(imu_topics, "imu")
        kinds[self.joint_topic] = "joint_state"
        declared = declared_command_topic(channels)
        self.command_topics: list[str] = []
        if declared is not None and declared != self.joint_topic:
            self.command_topics.append(declared)
            kinds[declared] = "joint_state"
        # States of controllers are found by their type, where joints are looked for.
        self._finds_commands = bool(names.joints) and declared is None
        self._type_by_topic: dict[str, str] = {}
        self.collectors = {
            topic: Collector(topic, kind, names, time_source)
            for topic, kind in kinds.items()
        }
        self._wanted_topics = frozenset(kinds)
        self.scan = scan(path, self._is_wanted)

    def _is_wanted(self, topic: str) -> bool:
        name = normal(topic)
        return name in self._wanted_topics or self._finds_command_on(name)

    def _finds_command_on(self, topic: str) -> bool:
        """Return whether a topic is the state of a controller, by its type."""
        if not self._finds_commands:
            return False
        if topic not in self._type_by_topic:
            self._type_by_topic |= {
                normal(info.topic): info.schema for info in _types(self.scan)
            }
        type_name = self._type_by_topic.get(topic, "")
        return is_command_topic(topic, type_name, self.channels)

    def check_commands(self) -> None:
        """Raise InputError where the declared topic of commands is of no use."""
        for topic in self.command_topics:
            collector = self.collectors[topic]
            if collector.readable:
                continue
            fault = "no messages on"
            if collector.received:
                fault = f"none of the {collector.received} messages can be read on"
            raise InputError(
                f"{fault} {topic}, the command_topic of the robot file; in the file:"
                f" {_listing(self.scan)}",
                hint="Name the topic of a sensor_msgs/msg/JointState, or leave"
                " command_topic out.",
                where=str(self.scan.path),
            )

    def batches(self) -> Iterator[None]:
        """Pass over the file; again where the joint states are on another topic."""
        yield from self._pass()
        usual = self.collectors[self.joint_topic]
        if usual.readable:
            return
        topics = ((normal(info.topic), info.schema) for info in _topics(self.scan))
        chosen = find_joint_topic(topics, self.channels)
        if chosen is None:
            return

        self.joint_topic = chosen
        self._wanted_topics = frozenset((chosen,))
        self._finds_commands = False  # the first pass has them
        if chosen in self.command_topics:
            self.command_topics.remove(chosen)  # its commands are in the rows
        self.collectors[chosen] = Collector(
            chosen, "joint_state", usual.names, usual.time_source
        )
        first_scan = self.scan
        self.scan = type(first_scan)(first_scan.path, self._is_wanted)
        yield from self._pass()
        self.scan.losses |= first_scan.losses

    def _pass(self) -> Iterator[None]:
        for batch in self.scan.batches():
            topic = normal(batch.channel.topic)
            if topic not in self.collectors:
                usual = self.collectors[self.joint_topic]
                self.command_topics.append(topic)
                self.collectors[topic] = Collector(
                    topic, "controller_state", usual.names, usual.time_source
                )
            self.collectors[topic].add(batch)
            # the next chunk takes its memory, which the processor's cache still holds
            del batch
            yield

    def blocks(self, rows: int | None) -> Iterator[bool]:
        """Stop whenever `rows` messages wait, and at the end; yields True there."""
        for _ in self.batches():
            if rows is None:
                continue
            n_waiting = sum(each.waiting for each in self.collectors.values())
            if n_waiting >= rows:
                yield False
        yield True

    def partial(self) -> str:
        """Describe in one line what the file lost; empty for a whole one."""
        losses = _losses(self.scan)
        for topic, collector in self.collectors.items():
            if collector.damaged:
                losses.append(
                    f"{collector.damaged} of {collector.received} messages of {topic}"
                    " could not be decoded"
                )
        return "; ".join(losses)

    def imu_topics(self, imu: Imu, *, whole: bool) -> list[str]:
        """Name the topics of an IMU, none where the file lacks it.

        Raises InputError where the `whole` file lacks only some of them.
        """
        data = data_topic(imu, self.channels)
        # A triad comes in the IMU's own messages, an array in one topic for each triad.
        if len(imu.positions) == 3 and self.collectors[data].readable:
            needed = [data]
        else:
            needed = triad_topics(imu, self.channels)
            if imu.gyro:
                needed.append(data)
        missing = [topic for topic in needed if not self.collectors[topic].readable]
        if len(missing) == len(needed):
            return []
        if missing and whole:
            content = f"In the file: {_listing(self.scan)}"
            raise partly_logged(imu, missing, str(self.scan.path), content)
        return needed


def _losses(scan: Scan) -> list[str]:
    """Describe what the file lost; empty for a whole one."""
    faults = [
        f"{fault} ({count} times)" if count > 1 else fault
        for fault, count in scan.losses.items()
    ]
    losses = faults[:_FAULTS]
    if len(faults) > _FAULTS:
        losses.append(f"and {len(faults) - _FAULTS} more faults")

    n_read, n_promised = scan.tally()
    if n_promised is not None and n_promised > n_read:
        losses.append(f"{n_promised - n_read} of {n_promised} messages are lost")
    elif faults:
        losses.append(f"{n_read} messages were read")
    return losses


def _types(scan: Scan) -> Iterator[TopicInfo]:
    """List the topics that a pass has met so far; messages are not counted."""
    for channel in scan.channels.values():
        schema = scan.schemas.get(channel.schema_id)
        yield TopicInfo(channel.topic, schema.name if schema else "", 0)


def _topics(scan: Scan) -> tuple[TopicInfo, ...]:
    """List the topics of a file; channels of one topic and type count together."""
    messages: Counter[tuple[str, str]] = Counter()
    for number, channel in scan.channels.items():
        schema = scan.schemas.get(channel.schema_id)
        name = schema.name if schema else "no schema"
        messages[channel.topic, name] += scan.total(number)
    return tuple(
        TopicInfo(topic, schema, count) for (topic, schema), count in messages.items()
    )


def _listing(scan: Scan) -> str:
    """List topics with type and number of messages, for a message."""
    topics = [
        f"{info.topic} ({info.schema}, {info.messages})" for info in _topics(scan)
    ]
    listed = topics[:_SHOWN]
    if len(topics) > _SHOWN:
        listed.append(f"and {len(topics) - _SHOWN} more")
    return ", ".join(listed) or "no topics"


def _no_positions(names: NameMap, path: Path) -> InputError:
    """Make the error for joint states of other joints than the robot's."""
    wanted = ", ".join(names.joints[:_SHOWN])
    logged = ", ".join(list(names.seen)[:_SHOWN]) or "no names at all"
    return InputError(
        "the joint states hold no position of any joint of the robot"
        f" ({wanted}); names in the log: {logged}",
        hint=OTHER_NAMES,
        where=str(path),
    )


def _no_joint_states(
    scan: Scan, collector: Collector, channels: Channels
) -> InputError:
    """Make the error for a file without joint states that can be read."""
    where = str(scan.path)
    unequal = collector.names.unequal
    if collector.received and unequal:
        return InputError(
            f"{unequal} in the messages on {collector.topic}: which joint lacks one"
            " cannot be told",
            hint="Let the driver send a value for each joint, NaN where there is none.",
            where=where,
        )
    if collector.received:
        encodings = ", ".join(sorted(collector.refused))
        fault = "they are damaged"
        if encodings:
            fault = f"its encoding {encodings!r} is not known"
        return InputError(
            f"none of the {collector.received} messages on {collector.topic} can be"
            f" decoded: {fault}",
            hint="Record sensor_msgs/msg/JointState as CDR, JSON or protobuf.",
            where=where,
        )

    losses = "; ".join(_losses(scan))
    if losses:
        return InputError(
            f"the file is damaged and nothing can be salvaged ({losses})",
            hint=scan.remedy,
            where=where,
        )

    similar = state_topics((info.topic, info.schema) for info in _topics(scan))
    topic = usual_joint_topic(channels)
    if similar:
        which = "Is it" if len(similar) == 1 else "Which is it of this robot,"
        hint = (
            f"{which} {' or '.join(similar[:3])}? Say so in the robot file: [channels]"
            f' topic = "{similar[0]}"'
        )
    else:
        hint = f"Record {topic} (sensor_msgs/msg/JointState) as well."
    return InputError(
        f"no messages on {topic}; in the file: {_listing(scan)}",
        hint=hint,
        where=where,
    )
