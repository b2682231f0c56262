"""The messages of one topic: gathered, decoded in batches, kept as arrays."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from mcap.records import Channel, Schema

from seqid_cli.logs import joint_messages, json_view, messages, protobuf, protobuf_view, ros2
from seqid_cli.logs.decoding import IMU_FIELDS, Decode, Decoded, NameMap
from seqid_cli.logs.mcap_records import Batch, RawMessage
from seqid_cli.logs.raw import Stamps

Kind = Literal["joint_state", "dynamic_joint_state", "imu"]
_BATCH = 4096  # messages decoded together
_LATEST = 1 << 62  # log times from here on are damaged
_FEW = 256  # a batch of less waits for more
_USUAL_FIELDS = {
    "joint_state": (
        "std_msgs/Header header",
        "string[] name",
        "float64[] position",
        "float64[] velocity",
        "float64[] effort",
    ),
    "dynamic_joint_state": (
        "std_msgs/Header header",
        "string[] joint_names",
        "control_msgs/InterfaceValue[] interface_values",
        "MSG: control_msgs/InterfaceValue",
        "string[] interface_names",
        "float64[] values",
    ),
    "imu": (
        "std_msgs/Header header",
        "geometry_msgs/Quaternion orientation",
        "float64[9] orientation_covariance",
        "geometry_msgs/Vector3 angular_velocity",
        "float64[9] angular_velocity_covariance",
        "geometry_msgs/Vector3 linear_acceleration",
        "float64[9] linear_acceleration_covariance",
    ),
}


@dataclass(frozen=True)
class Samples:
    """The decoded messages of one topic."""

    log_ns: Stamps
    decoded: Decoded

    def log_minus_header_s(self) -> float | None:
        """Return the median delay from header stamp to log time, None without header stamps."""
        stamped = self.decoded.stamp_ns != 0
        if not stamped.any():
            return None
        return float(np.median((self.log_ns - self.decoded.stamp_ns)[stamped])) * 1e-9


@dataclass
class Collector:
    """Gathers and decodes the messages of one topic."""

    topic: str
    kind: Kind
    names: NameMap
    received: int = 0
    damaged: int = 0
    refused: set[str] = field(default_factory=set)
    _decoders: dict[int, Decode | None] = field(default_factory=dict)
    _channel: int = -1
    _log_ns: list[int] = field(default_factory=list)
    _data: list[bytes] = field(default_factory=list)
    _done: list[Samples] = field(default_factory=list)
    _waiting: int = 0

    def add(self, message: RawMessage) -> None:
        """Take one message."""
        self._open(message.channel, message.schema)
        self.received += 1
        self._log_ns.append(min(message.log_ns, _LATEST))
        self._data.append(message.data)

    def add_batch(self, batch: Batch) -> None:
        """Take messages of one channel."""
        self._open(batch.channel, batch.schema)
        self.received += len(batch.payloads)
        if len(batch.payloads) < _FEW:
            self._log_ns.extend(batch.log_ns.tolist())
            self._data.extend(batch.payloads)
        else:
            self._flush()
            self._decode(batch.log_ns, batch.payloads)

    def drain(self) -> Samples:
        """Return what has been decoded since the last call, and forget it."""
        samples = self.samples()
        self._done, self._waiting = [], 0
        return samples

    @property
    def waiting(self) -> int:
        """Count the samples that `drain` would return, without those not decoded yet."""
        return self._waiting

    def samples(self) -> Samples:
        """Return everything that could be decoded."""
        self._flush()
        if len(self._done) != 1:
            width = self.names.width if self.kind != "imu" else len(IMU_FIELDS)
            parts = self._done or [Samples(np.zeros(0, np.int64), Decoded.empty(0, width))]
            batches = [part.decoded for part in parts]
            decoded = Decoded(
                np.concatenate([batch.stamp_ns for batch in batches]),
                np.concatenate([batch.values for batch in batches]),
                np.concatenate([batch.good for batch in batches]),
            )
            self._done = [Samples(np.concatenate([part.log_ns for part in parts]), decoded)]
        return self._done[0]

    def note(self) -> str:
        """Say what could not be decoded, empty if nothing."""
        if not self.damaged:
            return ""
        return f"{self.damaged} of {self.received} messages of {self.topic} could not be decoded"

    def _open(self, channel: Channel, schema: Schema | None) -> None:
        """Make ready for messages of a channel."""
        if channel.id not in self._decoders:
            encoding = channel.message_encoding
            self._decoders[channel.id] = _decoder(encoding, schema, self.kind, self.names)
            if self._decoders[channel.id] is None:
                self.refused.add(encoding)
        if channel.id != self._channel or len(self._data) >= _BATCH:
            self._flush()
            self._channel = channel.id

    def _flush(self) -> None:
        log_ns, data = self._log_ns, self._data
        self._log_ns, self._data = [], []
        if data:
            self._decode(np.array(log_ns, np.int64), data)

    def _decode(self, log_ns: Stamps, data: Sequence[bytes]) -> None:
        decode = self._decoders[self._channel]
        if decode is None:
            self.damaged += len(data)
            return
        batch = decode(data)
        good = batch.good
        if len(log_ns) and (log_ns.min() < 0 or log_ns.max() >= _LATEST):
            good = good & (log_ns >= 0) & (log_ns < _LATEST)
        if not good.all():
            self.damaged += int(np.count_nonzero(~good))
            batch = Decoded(batch.stamp_ns[good], batch.values[good], good[good])
            log_ns = log_ns[good]
        self._done.append(Samples(log_ns, batch))
        self._waiting += len(log_ns)


def _decoder(encoding: str, schema: Schema | None, kind: Kind, names: NameMap) -> Decode | None:
    if encoding == "cdr" and _is_usual(schema, kind):
        if kind == "imu":
            return ros2.imu_decoder()
        if kind == "joint_state":
            return ros2.joint_state_decoder(names)
        return ros2.dynamic_joint_state_decoder(names)
    if encoding == "json":
        return json_view.decoder(kind, names, _single(messages.parse_json, schema, kind, names))
    if schema is None or encoding not in ("protobuf", "cdr"):
        return None
    parser = protobuf.schema_parser if encoding == "protobuf" else messages.schema_parser
    parse = parser(schema)
    if parse is None:
        return None
    single = _single(parse, schema, kind, names)
    if encoding == "cdr":
        return single
    listed = joint_messages.is_list_of_joints(schema)
    stamp = joint_messages.stamp_parts if listed else messages.stamp_parts
    width = len(IMU_FIELDS) if kind == "imu" else names.width
    return protobuf_view.decoder(schema, _row(kind, names, listed=listed), stamp, width, single)


def _single(parse: messages.Parse, schema: Schema | None, kind: Kind, names: NameMap) -> Decode:
    """Make a decoder that takes messages one by one."""
    if kind == "imu":
        return messages.imu_decoder(parse)
    if joint_messages.is_list_of_joints(schema):
        return joint_messages.decoder(parse, names)
    if kind == "dynamic_joint_state":
        return messages.dynamic_joint_state_decoder(parse, names)
    usual = messages.joint_state_decoder(parse, names)
    if parse is messages.parse_json:
        return joint_messages.by_content(parse, names, usual)
    return usual


def _row(kind: Kind, names: NameMap, *, listed: bool) -> protobuf_view.Row:
    if kind == "imu":
        return messages.imu_row
    if listed:
        return lambda message: joint_messages.row(message, names)
    if kind == "dynamic_joint_state":
        return lambda message: messages.dynamic_row(message, names)
    return lambda message: messages.joint_row(message, names)


def _is_usual(schema: Schema | None, kind: Kind) -> bool:
    """Tell whether the definition is the one of sensor_msgs, or none is given."""
    if schema is None or schema.encoding != "ros2msg" or not schema.data.strip():
        return True
    text, *parts = schema.data.decode("utf-8", "replace").split("=" * 80)
    if kind == "dynamic_joint_state":
        text += "".join(part for part in parts if "/InterfaceValue\n" in part)
    lines = (re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in text.splitlines())
    fields = tuple(line.replace("/msg/", "/") for line in lines if line)
    bare = tuple(re.sub(r"^(\w+(?:\[\])?)(?= )", _qualified, line) for line in fields)
    return bare == _USUAL_FIELDS[kind]


def _qualified(match: re.Match[str]) -> str:
    known = {
        "Header": "std_msgs/Header",
        "InterfaceValue[]": "control_msgs/InterfaceValue[]",
        "Quaternion": "geometry_msgs/Quaternion",
        "Vector3": "geometry_msgs/Vector3",
    }
    return known.get(match[1], match[1])
