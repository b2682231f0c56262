"""The messages of one topic: gathered, decoded in batches, kept as arrays."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from mcap.records import Schema

from seqid_cli.logs import messages, protobuf, ros2
from seqid_cli.logs.decoding import IMU_FIELDS, Decode, Decoded, NameMap
from seqid_cli.logs.mcap_records import RawMessage
from seqid_cli.logs.raw import Stamps

Kind = Literal["joint_state", "dynamic_joint_state", "imu"]
_BATCH = 4096  # messages decoded together
_USUAL_FIELDS = {
    "joint_state": (
        "std_msgs/Header header",
        "string[] name",
        "float64[] position",
        "float64[] velocity",
        "float64[] effort",
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

    def add(self, message: RawMessage) -> None:
        """Take one message."""
        self.received += 1
        number = message.channel.id
        if number not in self._decoders:
            encoding = message.channel.message_encoding
            self._decoders[number] = _decoder(encoding, message.schema, self.kind, self.names)
            if self._decoders[number] is None:
                self.refused.add(encoding)
        if number != self._channel or len(self._data) >= _BATCH:
            self._flush()
            self._channel = number
        if self._decoders[number] is None or message.log_ns >= 1 << 62:
            self.damaged += 1
            return
        self._log_ns.append(message.log_ns)
        self._data.append(message.data)

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

    def _flush(self) -> None:
        decode = self._decoders.get(self._channel)
        if not self._data or decode is None:
            return
        batch = decode(self._data)
        good = batch.good
        self.damaged += int(np.count_nonzero(~good))
        kept = Decoded(batch.stamp_ns[good], batch.values[good], good[good])
        self._done.append(Samples(np.array(self._log_ns, np.int64)[good], kept))
        self._log_ns, self._data = [], []


def _decoder(encoding: str, schema: Schema | None, kind: Kind, names: NameMap) -> Decode | None:
    if encoding == "cdr" and kind != "dynamic_joint_state" and _is_usual(schema, kind):
        return ros2.joint_state_decoder(names) if kind == "joint_state" else ros2.imu_decoder()
    parse: messages.Parse | None = None
    if encoding == "json":
        parse = messages.parse_json
    elif encoding == "protobuf" and schema is not None:
        parse = protobuf.schema_parser(schema)
    elif encoding == "cdr" and schema is not None:
        parse = messages.schema_parser(schema)
    if parse is None:
        return None
    if kind == "imu":
        return messages.imu_decoder(parse)
    make: Callable[[messages.Parse, NameMap], Decode] = messages.joint_state_decoder
    if kind == "dynamic_joint_state":
        make = messages.dynamic_joint_state_decoder
    return make(parse, names)


def _is_usual(schema: Schema | None, kind: Kind) -> bool:
    """Tell whether the definition is the one of sensor_msgs, or none is given."""
    if schema is None or schema.encoding != "ros2msg" or not schema.data.strip():
        return True
    text = schema.data.decode("utf-8", "replace").split("=" * 80)[0]
    lines = (re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in text.splitlines())
    fields = tuple(line.replace("/msg/", "/") for line in lines if line)
    bare = tuple(re.sub(r"^(\w+)(?= )", _qualified, line) for line in fields)
    return bare == _USUAL_FIELDS[kind]


def _qualified(match: re.Match[str]) -> str:
    known = {
        "Header": "std_msgs/Header",
        "Quaternion": "geometry_msgs/Quaternion",
        "Vector3": "geometry_msgs/Vector3",
    }
    return known.get(match[1], match[1])
