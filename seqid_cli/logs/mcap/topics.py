"""Topics of a robot: which ones it needs, and their samples as streams of channels."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from seqid_cli.logs.drives import in_si
from seqid_cli.logs.mcap.records import Batch
from seqid_cli.logs.messages.batch import JOINT_QUANTITIES, Decode, Kind, NameMap, Payloads
from seqid_cli.logs.messages.parsers import decoder
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO, Array, Mask, RawLog, Stamps, Stream, TimeSource
from seqid_cli.robot.types import Imu, Robot

_LATEST = 1 << 62  # log times from here on are damaged


class Samples(NamedTuple):
    """M messages of one topic: times of logging and of their headers [ns], values as `Decoded`."""

    log_ns: Stamps
    stamp_ns: Stamps
    values: Array

    def log_minus_header_s(self) -> float | None:
        """Return the median delay from header stamp to log time, None without header stamps."""
        stamped = self.stamp_ns != 0
        if not stamped.any():
            return None
        return float(np.median((self.log_ns - self.stamp_ns)[stamped])) * 1e-9


@dataclass
class Collector:
    """Gathers and decodes the messages of one topic."""

    topic: str
    kind: Kind
    names: NameMap
    few: int = 256  # messages; less of them wait for more ...
    most: int = 4096  # ... up to so many
    received: int = 0
    damaged: int = 0
    waiting: int = 0  # samples to drain
    refused: set[str] = field(default_factory=set)
    _decoders: dict[int, Decode | None] = field(default_factory=dict)
    _channel: int = -1
    _log_ns: list[int] = field(default_factory=list)
    _data: list[bytes] = field(default_factory=list)
    _done: list[Samples] = field(default_factory=list)

    def add(self, batch: Batch) -> None:
        """Take messages of one channel."""
        number, encoding = batch.channel.id, batch.channel.message_encoding
        if number not in self._decoders:
            self._decoders[number] = decoder(encoding, batch.schema, self.kind, self.names)
            if self._decoders[number] is None:
                self.refused.add(encoding)
        large = len(batch.payloads) >= self.few
        if large or number != self._channel or len(self._data) >= self.most:
            self._flush()
            self._channel = number
        self.received += len(batch.payloads)
        if large:
            self._decode(batch.log_ns, batch.payloads)
        else:
            self._log_ns.extend(batch.log_ns.tolist())
            self._data.extend(batch.payloads)

    def drain(self) -> Samples:
        """Return what has been decoded since the last call, and forget it."""
        self._flush()
        done, self._done, self.waiting = self._done, [], 0
        none, width = np.zeros(0, np.int64), self.names.width(self.kind)
        if len(done) > 1:
            return Samples(*map(np.concatenate, zip(*done, strict=True)))
        return done[0] if done else Samples(none, none, np.zeros((0, width)))

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
        own = Samples(log_ns, decoded.stamp_ns, decoded.values)
        if not good.all():
            self.damaged += int(np.count_nonzero(~good))
            own = Samples(log_ns[good], decoded.stamp_ns[good], decoded.values[good])
        self._done.append(own)
        self.waiting += len(own.log_ns)


JOINT_STATES = "/joint_states"
DYNAMIC_JOINT_STATES = "/dynamic_joint_states"
# Types that only measured states have; a JointState on another topic may as well be a command.
_STATES = ("foxglove.JointStates",)
_DYNAMIC = "DynamicJointState"


def find_joint_topic(topics: Iterable[tuple[str, str]]) -> tuple[str, Kind] | None:
    """Choose the topic of the joint states, and how it is read; of two candidates none."""
    known = dict(topics)
    if DYNAMIC_JOINT_STATES in known:
        return DYNAMIC_JOINT_STATES, "dynamic_joint_state"
    states = [topic for topic, schema in known.items() if schema in _STATES]
    dynamic = [topic for topic, schema in known.items() if schema.endswith(_DYNAMIC)]
    if len(states) == 1:
        return states[0], "joint_state"
    return (dynamic[0], "dynamic_joint_state") if len(dynamic) == 1 else None


def data_topic(imu: Imu) -> str:
    """Name the topic of a whole IMU."""
    return f"/{imu.name}/data"


def triad_topics(imu: Imu) -> list[str]:
    """Name the topics of an array of accelerometers, one per three of them."""
    return [f"/{imu.name}/accel_{k + 1}" for k in range(-(-len(imu.positions) // 3))]


@dataclass
class Streams:
    """Turns samples of topics into streams; which stamps a topic has its first ones decide."""

    robot: Robot
    time_source: TimeSource
    warnings: list[str] = field(default_factory=list)
    _logged: dict[str, bool] = field(default_factory=dict)  # topics without header stamps

    def raw_log(
        self,
        joint_topic: str,
        samples: Mapping[str, Samples],
        imus: Mapping[str, list[str]],
        partial: str = "",
    ) -> RawLog:
        """Make a log of samples by topic; `imus` are the topics of the IMUs that are there."""
        joints = samples[joint_topic]
        stream = self._joints(joint_topic, joints)
        found = {
            imu.name: tuple(self._imu(imu, topic, samples[topic]) for topic in imus[imu.name])
            for imu in self.robot.imus
            if imus.get(imu.name)
        }
        warnings, self.warnings = tuple(self.warnings), []
        delay = joints.log_minus_header_s()
        return RawLog(stream, found, partial, warnings, log_minus_header_s=delay)

    def _joints(self, topic: str, samples: Samples) -> Stream:
        parts = np.split(samples.values, len(JOINT_QUANTITIES), axis=1)
        channels = dict(zip(JOINT_QUANTITIES, parts, strict=True))
        effort = channels.pop("effort")
        channels["current" if self.robot.channels.effort == "current" else "torque"] = effort
        recorded = {
            name: values
            for name, values in channels.items()
            if name == "position" or any_finite(values)
        }
        stamps, keep = self._clock(topic, samples)
        stream = _taken(Stream(topic, stamps, in_si(recorded, stamps, self.robot)), keep)
        return _taken(stream, _about_robot(samples.values, keep))

    def _imu(self, imu: Imu, topic: str, samples: Samples) -> Stream:
        count, triads = len(imu.positions), triad_topics(imu)
        stamps, keep = self._clock(topic, samples)
        channels = {}
        if topic in triads:
            first = 3 * triads.index(topic)
            channels[ACCELEROMETERS] = samples.values[:, : min(3, count - first)]
        elif count == 3:
            channels[ACCELEROMETERS] = samples.values[:, :3]
        if topic == data_topic(imu) and imu.gyro:
            channels[GYRO] = samples.values[:, 3:]
        return _taken(Stream(topic, stamps, channels), keep)

    def _clock(self, topic: str, samples: Samples) -> tuple[Stamps, Mask | None]:
        """Choose the stamps of a topic, and the samples that have one (None: all)."""
        count = len(samples.log_ns)
        if self.time_source == "log" or not count:
            return samples.log_ns, None
        missing = count - int(np.count_nonzero(samples.stamp_ns))
        if topic not in self._logged:
            self._logged[topic] = missing == count
            if missing == count:
                self.warnings.append(
                    f"the header stamps of {topic} are all zero: the times of logging are used "
                    "instead; make the driver fill in header.stamp"
                )
        if self._logged[topic]:
            return samples.log_ns, None
        if missing:
            self.warnings.append(
                f"{missing} messages of {topic} have no header stamp and were left out"
            )
        return samples.stamp_ns, samples.stamp_ns != 0 if missing else None


def any_finite(values: Array) -> bool:
    """Tell whether any value is a number; the first row mostly knows."""
    return bool(np.isfinite(values[:1]).any() or np.isfinite(values).any())


def _about_robot(values: Array, keep: Mask | None) -> Mask | None:
    """Which kept messages (M, 3 n) tell of the robot's joints, and not of a gripper; None: all."""
    values = values if keep is None else values[keep]
    about: Mask = np.isfinite(values[:, 0])
    if about.all():
        return None
    about[~about] = np.isfinite(values[~about]).any(axis=1)
    return None if about.all() else about


def _taken(stream: Stream, keep: Mask | None) -> Stream:
    return stream if keep is None else stream.take(keep)
