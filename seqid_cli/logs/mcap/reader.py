"""MCAP logs: which topics carry what a robot needs, and their messages as streams of numbers."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs import raw as raw_log
from seqid_cli.logs.drives import in_si
from seqid_cli.logs.mcap.records import Batch, Scan
from seqid_cli.logs.messages.batch import (
    JOINT_QUANTITIES,
    Decode,
    Kind,
    NameMap,
    Payloads,
)
from seqid_cli.logs.messages.parsers import decoder
from seqid_cli.logs.raw import RawLog, Stamps, Stream, TimeSource, partly_logged
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array

JOINT_STATES = "/joint_states"
DYNAMIC_JOINT_STATES = "/dynamic_joint_states"
_LATEST = 1 << 62  # log times from here on are damaged
_Part = tuple[Stamps, Stamps, Array]  # times of logging, stamps of headers, values


class Samples(NamedTuple):
    """M samples of one topic: stamps [ns], values as `Decoded`, what is to be said of them."""

    stamp_ns: Stamps
    values: Array
    warnings: list[str]
    delay_s: float | None  # median from header stamp to log time


@dataclass
class Collector:
    """Gathers and decodes the messages of one topic; which stamps it has its first ones decide."""

    topic: str
    kind: Kind
    names: NameMap
    time_source: TimeSource = "header"
    few: int = 256  # messages; less of them wait for more
    received: int = 0
    damaged: int = 0
    waiting: int = 0  # samples to drain
    refused: set[str] = field(default_factory=set)
    _decoders: dict[int, Decode | None] = field(default_factory=dict)
    _channel: int = -1
    _log_ns: list[int] = field(default_factory=list)
    _data: list[bytes] = field(default_factory=list)
    _done: list[_Part] = field(default_factory=list)
    # whether the times of logging stand in for the headers' stamps
    _logged: bool | None = None

    @property
    def readable(self) -> bool:
        """Whether messages have come so far that can be decoded."""
        return self.received > self.damaged

    def add(self, batch: Batch) -> None:
        """Take messages of one channel."""
        number, encoding = batch.channel.id, batch.channel.message_encoding
        if number not in self._decoders:
            self._decoders[number] = decoder(
                encoding, batch.schema, self.kind, self.names
            )
            if self._decoders[number] is None:
                self.refused.add(encoding)
        large = len(batch.payloads) >= self.few
        if large or number != self._channel or len(self._data) >= self.few:
            self._flush()
            self._channel = number
        self.received += len(batch.payloads)
        if large:
            self._decode(batch.log_ns, batch.payloads)
        else:  # copied, so as not to hold its chunk
            self._log_ns.extend(batch.log_ns.tolist())
            self._data.extend(batch.payloads)

    def drain(self) -> Samples:
        """Return what has been decoded since the last call, and forget it."""
        self._flush()
        parts, self._done, self.waiting = self._done, [], 0
        if not parts:
            none = np.zeros((0, self.names.width(self.kind)))
            return Samples(np.zeros(0, np.int64), none, [], None)
        log_ns, stamp_ns, values = map(np.concatenate, zip(*parts, strict=True))
        stamped = stamp_ns != 0
        missing = int(np.count_nonzero(~stamped))
        delay_s, warnings = None, []
        if self.kind != "imu" and missing < len(stamped):
            delay_s = float(np.median((log_ns - stamp_ns)[stamped])) * 1e-9
        if self._logged is None and self.time_source == "header":
            self._logged = missing == len(stamped)
            if self._logged:
                text = (
                    f"the header stamps of {self.topic} are all zero: the times of"
                    " logging are "
                )
                warnings.append(
                    text + "used instead; make the driver fill in header.stamp"
                )
        if self.time_source == "log" or self._logged:
            stamp_ns = log_ns
        elif missing:
            text = (
                f"{missing} messages of {self.topic} have no header stamp and were"
                " left out"
            )
            warnings.append(text)
            stamp_ns, values = stamp_ns[stamped], values[stamped]
        return Samples(stamp_ns, values, warnings, delay_s)

    def _flush(self) -> None:
        if self._data:
            log_ns, data = np.array(self._log_ns, np.int64), Payloads.of(self._data)
            self._log_ns, self._data = [], []
            self._decode(log_ns, data)

    def _decode(self, log_ns: Stamps, payloads: Payloads) -> None:
        decode = self._decoders[self._channel]
        if decode is None:
            self.damaged += len(payloads)
            return
        decoded = decode(payloads)
        good = decoded.good & (log_ns >= 0) & (log_ns < _LATEST)
        own = log_ns, decoded.stamp_ns, decoded.values
        if not good.all():
            own = log_ns[good], decoded.stamp_ns[good], decoded.values[good]
        self.damaged += len(good) - len(own[0])
        self.waiting += len(own[0])
        self._done.append(own)


def find_joint_topic(topics: Iterable[tuple[str, str]]) -> tuple[str, Kind] | None:
    """Choose the topic of the joint states, and how it is read; of two candidates none."""
    known = dict(topics)
    if DYNAMIC_JOINT_STATES in known:
        return DYNAMIC_JOINT_STATES, "dynamic_joint_state"
    # Types that only measured states have; a JointState on another topic may as well be
    # a command.
    states = [
        topic for topic, schema in known.items() if schema == "foxglove.JointStates"
    ]
    dynamic = [
        topic for topic, schema in known.items() if schema.endswith("DynamicJointState")
    ]
    if len(states) == 1:
        return states[0], "joint_state"
    return (dynamic[0], "dynamic_joint_state") if len(dynamic) == 1 else None


def data_topic(imu: Imu) -> str:
    """Name the topic of a whole IMU."""
    return f"/{imu.name}/data"


def triad_topics(imu: Imu) -> list[str]:
    """Name the topics of an array of accelerometers, one per three of them."""
    return [f"/{imu.name}/accel_{k + 1}" for k in range(-(-len(imu.positions) // 3))]


def joint_stream(topic: str, samples: Samples, robot: Robot) -> Stream:
    """Make a stream of joint states, without the messages of a gripper alone."""
    stamps, values = samples.stamp_ns, samples.values
    about = np.isfinite(values).any(axis=1)
    if not about.all():
        stamps, values = stamps[about], values[about]
    parts = np.split(values, len(JOINT_QUANTITIES), axis=1)
    channels = dict(zip(JOINT_QUANTITIES, parts, strict=True))
    kind = "current" if robot.channels.effort == "current" else "torque"
    channels[kind] = channels.pop("effort")
    given = {
        k: own for k, own in channels.items() if k == "position" or any_finite(own)
    }
    return Stream(topic, stamps, in_si(given, stamps, robot))


def imu_stream(topic: str, samples: Samples, imu: Imu) -> Stream:
    """Make a stream of what one topic tells of an IMU."""
    count, triads = len(imu.positions), triad_topics(imu)
    channels = {}
    if topic in triads or count == 3:
        first = 3 * triads.index(topic) if topic in triads else 0
        channels[raw_log.ACCELEROMETERS] = samples.values[:, : min(3, count - first)]
    if topic == data_topic(imu) and imu.gyro:
        channels[raw_log.GYRO] = samples.values[:, 3:]
    return Stream(topic, samples.stamp_ns, channels)


def any_finite(values: Array) -> bool:
    """Tell whether any value is a number; the first row mostly knows."""
    return bool(np.isfinite(values[:1]).any() or np.isfinite(values).any())


_SHOWN = 12  # topics or names listed in a message


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

    `rows`: messages in a block, of all topics together, about; None for one block.
    Yields: the next part of every topic, empty where it has none; a quantity that no
    sample of a block has is left out of it. The last block says in `partial` what a
    damaged file lost. Raises InputError, after the last block: no joint states, none of
    the robot's joints in them, nothing readable.
    """
    names = NameMap(robot.joint_names, robot.channels.effort or "torque")
    kinds: dict[str, Kind] = {JOINT_STATES: "joint_state"}
    for imu in robot.imus:  # all topics on which they may be logged
        kinds |= dict.fromkeys((data_topic(imu), *triad_topics(imu)), "imu")
    log = _Log(path, names, kinds, scan, time_source)
    positions = False
    for last in log.blocks(rows):
        samples = {
            topic: collector.drain() for topic, collector in log.collectors.items()
        }
        if last and not log.collectors[log.joint_topic].readable:
            raise _no_joint_states(log.scan, log.collectors[log.joint_topic])
        joints = joint_stream(log.joint_topic, samples[log.joint_topic], robot)
        imus: dict[str, tuple[Stream, ...]] = {}
        used = [log.joint_topic]
        for imu in robot.imus:
            if own := log.imu_topics(imu, whole=last):
                imus[imu.name] = tuple(imu_stream(t, samples[t], imu) for t in own)
                used += own
        warnings = tuple(text for topic in used for text in samples[topic].warnings)
        positions = positions or any_finite(joints.channels["position"])
        if last and not positions:
            seen = ", ".join(list(names.seen)[:_SHOWN]) or "no names at all"
            message = "the joint states hold no position of any joint of the robot "
            message += f"({', '.join(names.joints[:_SHOWN])}); names in the log: {seen}"
            hint = "Give the joints of the robot file the names that the log uses."
            raise InputError(message, hint=hint, where=str(path))
        delay_s = samples[log.joint_topic].delay_s
        yield RawLog(joints, imus, log.partial() if last else "", warnings, delay_s)


def list_topics(
    path: Path, *, scan: type[Scan] = Scan
) -> tuple[tuple[TopicInfo, ...], tuple[str, ...]]:
    """List the topics of a file, damaged or not, and the names in its joint states."""
    names = NameMap(())
    log = _Log(path, names, {JOINT_STATES: "joint_state"}, scan, "header")
    for _ in log.batches():
        log.collectors[JOINT_STATES].drain()
    log.collectors[JOINT_STATES].drain()
    return _topics(log.scan), tuple(names.seen)


class _Log:
    """A pass over a file that gathers the messages of some topics."""

    def __init__(
        self,
        path: Path,
        names: NameMap,
        kinds: dict[str, Kind],
        scan: type[Scan],
        time: TimeSource,
    ) -> None:
        self.joint_topic = JOINT_STATES
        self.collectors = {
            t: Collector(t, kind, names, time) for t, kind in kinds.items()
        }
        self._chosen = frozenset(kinds)
        self.scan = scan(path, self._wanted)

    def _wanted(self, topic: str) -> bool:
        return _normal(topic) in self._chosen

    def batches(self) -> Iterator[None]:
        """Pass over the file; a second time where the joint states are of the other kind."""
        yield from self._pass()
        usual = self.collectors[JOINT_STATES]
        found = find_joint_topic(
            (_normal(t.topic), t.schema) for t in _topics(self.scan)
        )
        if found is not None and not usual.readable:
            self.joint_topic, kind = found
            self._chosen = frozenset((self.joint_topic,))
            own = Collector(self.joint_topic, kind, usual.names, usual.time_source)
            self.collectors[self.joint_topic] = own
            first, self.scan = self.scan, type(self.scan)(self.scan.path, self._wanted)
            yield from self._pass()
            self.scan.losses |= first.losses

    def blocks(self, rows: int | None) -> Iterator[bool]:
        """Stop whenever `rows` messages are there, and at the end, which is told by True."""
        for _ in self.batches():
            if (
                rows is not None
                and sum(c.waiting for c in self.collectors.values()) >= rows
            ):
                yield False
        yield True

    def _pass(self) -> Iterator[None]:
        for batch in self.scan.batches():
            self.collectors[_normal(batch.channel.topic)].add(batch)
            # the next chunk takes its memory, which the processor's cache still holds
            del batch
            yield

    def partial(self) -> str:
        """Say in one line what the file lost; empty for a whole one."""
        losses = _losses(self.scan)
        for topic, each in self.collectors.items():
            text = (
                f"{each.damaged} of {each.received} messages of {topic} could not be"
                " decoded"
            )
            losses += [text] if each.damaged else []
        return "; ".join(losses)

    def imu_topics(self, imu: Imu, *, whole: bool) -> list[str]:
        """Name the topics of an IMU; refuses a whole file that lacks only some of them."""
        data = data_topic(imu)
        use_data = len(imu.positions) == 3 and self.collectors[data].readable
        needed = [] if use_data else triad_topics(imu)
        needed += [data] if use_data or imu.gyro else []
        missing = [topic for topic in needed if not self.collectors[topic].readable]
        if len(missing) == len(needed):
            return []
        if missing and whole:
            there = f"In the file: {_listing(self.scan)}"
            raise partly_logged(imu, missing, str(self.scan.path), there)
        return needed


def _normal(topic: str) -> str:
    return "/" + topic.strip("/")


def _losses(scan: Scan) -> list[str]:
    """Say what the file lost; nothing for a whole one."""
    losses = [
        f"{what} ({n} times)" if n > 1 else what for what, n in scan.losses.items()
    ]
    more = [f"and {len(losses) - 3} more faults"] if len(losses) > 3 else []
    met, expected = scan.tally()
    counted = [f"{met} messages were read"] if losses else []
    if expected is not None and expected > met:
        counted = [f"{expected - met} of {expected} messages are lost"]
    return [*losses[:3], *more, *counted]


def _topics(scan: Scan) -> tuple[TopicInfo, ...]:
    found: Counter[tuple[str, str]] = Counter()
    for number, channel in scan.channels.items():
        schema = scan.schemas.get(channel.schema_id)
        name = schema.name if schema else "no schema"
        found[channel.topic, name] += scan.total(number)
    return tuple(TopicInfo(*key, count) for key, count in found.items())


def _listing(scan: Scan) -> str:
    shown = [f"{info.topic} ({info.schema}, {info.messages})" for info in _topics(scan)]
    more = [f"and {len(shown) - _SHOWN} more"] if len(shown) > _SHOWN else []
    return ", ".join(shown[:_SHOWN] + more) or "no topics"


def _no_joint_states(scan: Scan, collector: Collector) -> InputError:
    if collector.received:
        kinds = ", ".join(sorted(collector.refused))
        message = (
            f"none of the {collector.received} messages on {collector.topic} can be"
            " decoded: "
        )
        message += (
            f"its encoding {kinds!r} is not known" if kinds else "they are damaged"
        )
        hint = "Record sensor_msgs/msg/JointState as CDR, JSON or protobuf."
    elif faults := "; ".join(_losses(scan)):
        message = f"the file is damaged and nothing can be salvaged ({faults})"
        hint = scan.remedy
    else:
        message = f"no messages on {JOINT_STATES}; in the file: {_listing(scan)}"
        near = next(
            (t.topic for t in _topics(scan) if t.schema.endswith("JointState")), ""
        )
        hint = f"Is it {near}? Record or remap it as {JOINT_STATES}."
        if not near:
            hint = f"Record {JOINT_STATES} (sensor_msgs/msg/JointState) as well."
    return InputError(message, hint=hint, where=str(scan.path))
