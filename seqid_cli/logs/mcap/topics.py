"""Topics of a robot: which ones it needs, and their samples as streams of channels."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from seqid_cli.logs.drives import in_si
from seqid_cli.logs.mcap.records import Batch
from seqid_cli.logs.messages.batch import JOINT_QUANTITIES, Decode, Kind, NameMap, Payloads
from seqid_cli.logs.messages.parsers import decoder
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO, Array, Stamps, Stream, TimeSource
from seqid_cli.robot.types import Imu, Robot

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
    _logged: bool | None = None  # whether the times of logging stand in for the headers' stamps

    @property
    def readable(self) -> bool:
        """Whether messages have come so far that can be decoded."""
        return self.received > self.damaged

    def add(self, batch: Batch) -> None:
        """Take messages of one channel."""
        number, encoding = batch.channel.id, batch.channel.message_encoding
        if number not in self._decoders:
            self._decoders[number] = decoder(encoding, batch.schema, self.kind, self.names)
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
                text = f"the header stamps of {self.topic} are all zero: the times of logging are "
                warnings.append(text + "used instead; make the driver fill in header.stamp")
        if self.time_source == "log" or self._logged:
            stamp_ns = log_ns
        elif missing:
            text = f"{missing} messages of {self.topic} have no header stamp and were left out"
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
    # Types that only measured states have; a JointState on another topic may as well be a command.
    states = [topic for topic, schema in known.items() if schema == "foxglove.JointStates"]
    dynamic = [topic for topic, schema in known.items() if schema.endswith("DynamicJointState")]
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
    effort = channels.pop("effort")
    channels["current" if robot.channels.effort == "current" else "torque"] = effort
    given = {k: own for k, own in channels.items() if k == "position" or any_finite(own)}
    return Stream(topic, stamps, in_si(given, stamps, robot))


def imu_stream(topic: str, samples: Samples, imu: Imu) -> Stream:
    """Make a stream of what one topic tells of an IMU."""
    count, triads = len(imu.positions), triad_topics(imu)
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
