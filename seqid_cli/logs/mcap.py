"""MCAP logs: which topics carry what, and their messages as streams of numbers."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.decoding import JOINT_QUANTITIES, NameMap
from seqid_cli.logs.mcap_records import Scan
from seqid_cli.logs.raw import (
    ACCELEROMETERS,
    GYRO,
    Mask,
    RawLog,
    Stamps,
    Stream,
    TimeSource,
)
from seqid_cli.logs.topics import Collector, Kind, Samples
from seqid_cli.robot.types import Imu, Robot

JOINT_STATES = "/joint_states"
DYNAMIC_JOINT_STATES = "/dynamic_joint_states"

_SHOWN = 12  # topics or names listed in a message


class TopicInfo(NamedTuple):
    """One topic of a file."""

    topic: str
    schema: str
    encoding: str
    messages: int


def read(path: Path, robot: Robot, time_source: TimeSource = "header") -> RawLog:
    """Read an MCAP log.

    Parameters
    ----------
    path : Path
        The file; it may be damaged or cut off.
    robot : Robot
        Joints are matched by name; its IMUs say which topics are read.
    time_source : {"header", "log"}
        Stamps of the message headers, or the times at which the messages were logged.

    Returns
    -------
    RawLog
        `partial` says what a damaged file lost.

    Raises
    ------
    InputError
        No joint states, none of the robot's joints in them, or nothing readable.
    """
    scan, names = Scan(path), NameMap(robot.joint_names)
    topics: dict[str, Kind] = {JOINT_STATES: "joint_state", **_imu_topics(robot)}
    collectors = _collect(scan, topics, names)
    joint_topic = JOINT_STATES
    if not collectors[JOINT_STATES].received and _has_topic(scan, DYNAMIC_JOINT_STATES):
        joint_topic = DYNAMIC_JOINT_STATES
        other = _collect(Scan(path), {joint_topic: "dynamic_joint_state"}, names)
        collectors[joint_topic] = other[joint_topic]
    joints = collectors[joint_topic].samples()
    if not joints.log_ns.size:
        raise _no_joint_states(scan, collectors[joint_topic])
    warnings: list[str] = []
    stream = _joint_stream(joint_topic, joints, robot, time_source, warnings)
    if not np.isfinite(stream.channels["position"]).any():
        raise _no_joints(path, names)
    imus = {
        imu.name: streams
        for imu in robot.imus
        if (streams := _imu_streams(scan, imu, collectors, time_source, warnings))
    }
    unread = [note for collector in collectors.values() if (note := collector.note())]
    return RawLog(
        stream,
        imus,
        partial=_partial(scan, unread),
        warnings=tuple(warnings),
        log_minus_header_s=joints.log_minus_header_s(),
    )


def list_topics(path: Path) -> tuple[tuple[TopicInfo, ...], tuple[str, ...]]:
    """List the topics of an MCAP file, damaged or not, and the names in its joint states."""
    scan, names = Scan(path), NameMap(())
    _collect(scan, {JOINT_STATES: "joint_state"}, names)
    return _topics(scan), tuple(names.seen)


def _collect(scan: Scan, topics: dict[str, Kind], names: NameMap) -> dict[str, Collector]:
    collectors = {topic: Collector(topic, kind, names) for topic, kind in topics.items()}
    for message in scan.messages():
        collector = collectors.get(_normal(message.channel.topic))
        if collector is not None:
            collector.add(message)
    for collector in collectors.values():
        collector.samples()
    return collectors


def _normal(topic: str) -> str:
    return "/" + topic.strip("/")


def _has_topic(scan: Scan, topic: str) -> bool:
    return any(_normal(channel.topic) == topic for channel in scan.channels.values())


def _imu_topics(robot: Robot) -> dict[str, Kind]:
    topics: dict[str, Kind] = {}
    for imu in robot.imus:
        for topic in (f"/{imu.name}/data", *_triad_topics(imu)):
            topics[topic] = "imu"
    return topics


def _triad_topics(imu: Imu) -> list[str]:
    return [f"/{imu.name}/accel_{k + 1}" for k in range(-(-len(imu.positions) // 3))]


def _joint_stream(
    topic: str, samples: Samples, robot: Robot, time_source: TimeSource, warnings: list[str]
) -> Stream:
    parts = np.split(samples.decoded.values, len(JOINT_QUANTITIES), axis=1)
    channels = dict(zip(JOINT_QUANTITIES, parts, strict=True))
    effort = channels.pop("effort")
    channels["current" if robot.channels.effort == "current" else "torque"] = effort
    recorded = {
        name: values
        for name, values in channels.items()
        if name == "position" or np.isfinite(values).any()
    }
    stamps, keep = _clock(topic, samples, time_source, warnings)
    return Stream(topic, stamps, recorded).take(keep)


def _clock(
    topic: str, samples: Samples, time_source: TimeSource, warnings: list[str]
) -> tuple[Stamps, Mask | slice]:
    """Choose the stamps of a topic, and the samples that have one."""
    if time_source == "log":
        return samples.log_ns, slice(None)
    stamped = samples.decoded.stamp_ns != 0
    missing = int(np.count_nonzero(~stamped))
    if missing == len(stamped):
        warnings.append(
            f"the header stamps of {topic} are all zero: the times of logging are used instead; "
            "make the driver fill in header.stamp"
        )
        return samples.log_ns, slice(None)
    if missing:
        warnings.append(f"{missing} messages of {topic} have no header stamp and were left out")
    return samples.decoded.stamp_ns, stamped


def _imu_streams(
    scan: Scan,
    imu: Imu,
    collectors: dict[str, Collector],
    time_source: TimeSource,
    warnings: list[str],
) -> tuple[Stream, ...]:
    """Return the streams that carry an IMU, none where the file does not have it."""
    count, data = len(imu.positions), f"/{imu.name}/data"
    triads = _triad_topics(imu)
    has_data = bool(collectors[data].samples().log_ns.size)
    use_data = count == 3 and has_data
    needed = ([] if use_data else triads) + ([data] if use_data or imu.gyro else [])
    present = [topic for topic in needed if collectors[topic].samples().log_ns.size]
    if not present:
        return ()
    if len(present) < len(needed):
        missing = ", ".join(topic for topic in needed if topic not in present)
        raise InputError(
            f"IMU {imu.name!r} is only partly in the log; no readable messages on {missing}",
            hint=f"The robot file gives it {count} accelerometers"
            f"{' and a gyro' if imu.gyro else ''}: log all its topics, or correct the robot file. "
            f"In the file: {_listing(scan)}",
            where=str(scan.path),
        )
    streams = []
    for topic in needed:
        samples = collectors[topic].samples()
        stamps, keep = _clock(topic, samples, time_source, warnings)
        channels = {}
        if topic in triads or use_data:
            first = 3 * triads.index(topic) if topic in triads else 0
            channels[ACCELEROMETERS] = samples.decoded.values[:, : min(3, count - first)]
        if topic == data and imu.gyro:
            channels[GYRO] = samples.decoded.values[:, 3:]
        streams.append(Stream(topic, stamps, channels).take(keep))
    return tuple(streams)


def _partial(scan: Scan, unread: list[str]) -> str:
    """Say in one line what the file lost; empty for a whole one."""
    losses = [f"{what} ({n} times)" if n > 1 else what for what, n in scan.losses.items()]
    parts = losses[:3]
    if len(losses) > 3:
        parts = [*parts, f"and {len(losses) - 3} more faults"]
    missing = scan.missing()
    if missing:
        parts = [*parts, f"{missing} of {scan.expected} messages are lost"]
    elif losses:
        parts = [*parts, f"{sum(scan.counts.values())} messages were read"]
    return "; ".join([*parts, *unread])


def _topics(scan: Scan) -> tuple[TopicInfo, ...]:
    found: dict[tuple[str, str, str], int] = {}
    for number, channel in scan.channels.items():
        schema = scan.schemas.get(channel.schema_id)
        key = (channel.topic, schema.name if schema else "no schema", channel.message_encoding)
        found[key] = found.get(key, 0) + scan.counts.get(number, 0)
    return tuple(TopicInfo(*key, count) for key, count in found.items())


def _listing(scan: Scan) -> str:
    topics = _topics(scan)
    shown = [f"{info.topic} ({info.schema}, {info.messages})" for info in topics[:_SHOWN]]
    more = [f"and {len(topics) - _SHOWN} more"] if len(topics) > _SHOWN else []
    return ", ".join(shown + more) or "no topics"


def _no_joint_states(scan: Scan, collector: Collector) -> InputError:
    where, faults = str(scan.path), _partial(scan, [])
    if collector.received:
        kinds = ", ".join(sorted(collector.refused))
        reason = f"its encoding {kinds!r} is not known" if kinds else "they are damaged"
        return InputError(
            f"none of the {collector.received} messages on {collector.topic} can be decoded: "
            f"{reason}",
            hint="Record sensor_msgs/msg/JointState as CDR, JSON or protobuf.",
            where=where,
        )
    if faults:
        return InputError(
            f"the file is damaged and nothing can be salvaged ({faults})",
            hint="Copy it again from the source; `mcap doctor FILE` shows the damage.",
            where=where,
        )
    topics = [info.topic for info in _topics(scan)]
    typed = [info.topic for info in _topics(scan) if info.schema.endswith("JointState")]
    near = typed or difflib.get_close_matches(JOINT_STATES, topics, n=1)
    hint = f"Is it {near[0]}? Record or remap it as {JOINT_STATES}." if near else ""
    return InputError(
        f"no messages on {JOINT_STATES}; in the file: {_listing(scan)}",
        hint=hint or f"Record {JOINT_STATES} (sensor_msgs/msg/JointState) as well.",
        where=where,
    )


def _no_joints(path: Path, names: NameMap) -> InputError:
    seen = ", ".join(list(names.seen)[:_SHOWN]) or "no names at all"
    return InputError(
        f"the joint states hold no position of any joint of the robot "
        f"({', '.join(names.joints[:_SHOWN])}); names in the log: {seen}",
        hint="Give the joints of the robot file the names that the log uses.",
        where=str(path),
    )
