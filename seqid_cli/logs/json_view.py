"""JSON messages, read by a parser that is told what they look like.

Only the fields that are wanted are made into objects; the messages that have the same names in the
same order are put into rows together. A message of any other form is decoded by itself, with the
same result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import msgspec
import numpy as np

from seqid_cli.logs import joint_messages
from seqid_cli.logs.decoding import (
    IMU_FIELDS,
    JOINT_QUANTITIES,
    Decode,
    Decoded,
    NameMap,
    put,
)
from seqid_cli.logs.messages import NANOSECONDS, SECONDS, parse_json
from seqid_cli.logs.payloads import Payloads
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Stamps

_SEC = 1_000_000_000
_ERRORS = (msgspec.MsgspecError, UnicodeError, RecursionError, MemoryError)


class _Stamp(msgspec.Struct, gc=False):
    """The fields of `messages` and `joint_messages` that name a time."""

    sec: int | None = None
    secs: int | None = None
    seconds: int | None = None
    nanosec: int | None = None
    nsec: int | None = None
    nsecs: int | None = None
    nanos: int | None = None


class _Header(msgspec.Struct, gc=False):
    stamp: _Stamp | int | float | None = None


class _JointState(msgspec.Struct, gc=False):
    header: _Header | None = None
    name: list[str] = []
    position: list[float] = []
    velocity: list[float] = []
    effort: list[float] = []


class _Vector(msgspec.Struct, gc=False, frozen=True):
    x: float | None = None
    y: float | None = None
    z: float | None = None


class _Imu(msgspec.Struct, gc=False):
    header: _Header | None = None
    linear_acceleration: _Vector = _Vector()
    angular_velocity: _Vector = _Vector()


class _Joint(msgspec.Struct, gc=False):
    name: str
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None


class _Joints(msgspec.Struct, gc=False):
    joints: list[_Joint]
    timestamp: _Stamp | None = None


_Message = _JointState | _Imu | _Joints
_PARSERS: dict[str, msgspec.json.Decoder[_Message]] = {
    "joint_state": msgspec.json.Decoder(_JointState),
    "imu": msgspec.json.Decoder(_Imu),
    "joints": msgspec.json.Decoder(_Joints),
}


def decoder(kind: str, names: NameMap, single: Decode) -> Decode:
    """Decode JSON messages.

    Parameters
    ----------
    kind : {"joint_state", "dynamic_joint_state", "imu"}
        What they hold.
    names : NameMap
        The joints wanted.
    single : callable
        Decodes messages one by one.
    """
    return single if kind not in _PARSERS else _JsonDecoder(kind, names, single)


@dataclass(frozen=True)
class _JsonDecoder:
    kind: str
    names: NameMap
    single: Decode

    def __call__(self, batch: Sequence[bytes]) -> Decoded:
        payloads = Payloads.of(batch)
        parser = _PARSERS[self._kind(payloads)]
        messages = _lines(payloads, parser)
        if messages and _all_alike(messages):
            return self._alike(messages)
        return self._in_turn(payloads, parser)

    def _in_turn(self, payloads: Payloads, parser: msgspec.json.Decoder[_Message]) -> Decoded:
        """Decode messages of several forms."""
        groups: dict[object, list[tuple[int, _Message]]] = {}
        others = []
        for i, data in enumerate(payloads):
            try:
                data.decode("utf-8")  # the parser does not look into fields that it leaves out
                message = parser.decode(data)
            except _ERRORS:
                others.append(i)
            else:
                groups.setdefault(_form(message), []).append((i, message))
        width = len(IMU_FIELDS) if self.kind == "imu" else self.names.width
        out = Decoded.empty(len(payloads), width)
        for members in groups.values():
            rows, messages = zip(*members, strict=True)
            put(out, np.array(rows), self._alike(messages))
        if others:
            at = np.array(others)
            put(out, at, self.single(payloads.take(at)))
        return out

    def _kind(self, batch: Payloads) -> str:
        """Tell by the first sound message what the messages hold."""
        for data in batch if self.kind == "joint_state" else ():
            try:
                message = parse_json(data)
            except ValueError:
                continue
            listed = isinstance(message, dict) and message.get("joints") is not None
            return "joints" if listed else self.kind
        return self.kind

    def _alike(self, messages: Sequence[_Message]) -> Decoded:
        """Decode messages of one form."""
        if isinstance(messages[0], _Imu):
            values: Array | None = np.array([_imu_row(each) for each in messages], np.float64)
        elif isinstance(messages[0], _Joints):
            values = self._listed(messages)
        else:
            values = self._lists(messages)
        if values is None:
            return Decoded.empty(len(messages), self.names.width)
        stamps, good = _stamps(messages)
        return Decoded(stamps, values, good)

    def _lists(self, messages: Sequence[Any]) -> Array | None:
        """Put messages with a list per quantity into rows; None where their lengths differ."""
        names: list[str] = messages[0].name
        pairs = self.names.pairs(names)
        values = np.full((len(messages), self.names.width), np.nan)
        for quantity, name in enumerate(JOINT_QUANTITIES):
            lists = [getattr(message, name) for message in messages]
            count = len(lists[0])
            if count not in (0, len(names)):
                return None
            flat = np.fromiter(chain.from_iterable(lists), np.float64, count * len(lists))
            block = flat.reshape(len(lists), count)
            for entry, joint in pairs if count else ():
                values[:, quantity * len(self.names.joints) + joint] = block[:, entry]
        return values

    def _listed(self, messages: Sequence[Any]) -> Array:
        """Put messages that list joints with their values into rows."""
        values = np.full((len(messages), self.names.width), np.nan)
        for entry, joint in self.names.pairs([each.name for each in messages[0].joints]):
            joints = [message.joints[entry] for message in messages]
            for quantity, name in enumerate(JOINT_QUANTITIES):
                numbers = np.array([getattr(each, name) for each in joints], np.float64)
                values[:, quantity * len(self.names.joints) + joint] = numbers  # None is NaN
        return values


def _lines(payloads: Payloads, parser: msgspec.json.Decoder[_Message]) -> list[_Message] | None:
    """Parse all messages at once; None where one is different."""
    if not len(payloads) or not payloads.lengths.all():
        return None
    if (payloads.buffer[payloads.starts] != ord("{")).any():
        return None  # each line must be an object of its own
    text = payloads.lines()
    try:
        if text.max() >= 0x80:
            text.tobytes().decode("utf-8")  # the parser does not look into what it leaves out
        messages = parser.decode_lines(text.data)
    except _ERRORS:
        return None
    return messages if len(messages) == len(payloads) else None


def _form(message: _Message) -> object:
    """Return what messages must share to be decoded together."""
    if isinstance(message, _JointState):
        lengths = len(message.position), len(message.velocity), len(message.effort)
        return (*message.name, lengths)
    if isinstance(message, _Joints):
        return tuple([each.name for each in message.joints])
    return None


def _all_alike(messages: Sequence[Any]) -> bool:
    """Tell whether all messages have the form of the first."""
    first = messages[0]
    if not isinstance(first, _JointState):
        form = _form(first)
        return all(_form(message) == form for message in messages)
    names, p, v, e = first.name, len(first.position), len(first.velocity), len(first.effort)
    return all(
        m.name == names and len(m.position) == p and len(m.velocity) == v and len(m.effort) == e
        for m in messages
    )


def _imu_row(message: Any) -> tuple[float | None, ...]:
    a, w = message.linear_acceleration, message.angular_velocity
    return a.x, a.y, a.z, w.x, w.y, w.z


def _stamps(messages: Sequence[Any]) -> tuple[Stamps, Mask]:
    """Return the stamps of messages in ns, 0 where there is none, and which are right."""
    listed = isinstance(messages[0], _Joints)
    try:
        if listed:
            given = [message.timestamp for message in messages]
            parts = [each.sec for each in given], [each.nsec for each in given]
        else:
            given = [message.header.stamp for message in messages]
            parts = [each.sec for each in given], [each.nanosec for each in given]
        sec, rest = (np.array(part, np.int64) for part in parts)
    except (AttributeError, TypeError, OverflowError):  # other names, or none
        each = [_stamp(message) for message in messages]
        good = np.array([stamp is not None for stamp in each])
        return np.array([stamp or 0 for stamp in each], np.int64), good
    limit = STAMP_LIMIT_NS // _SEC
    good = (sec >= -limit) & (sec < limit) & (rest >= 0) & (rest < _SEC)
    return np.where(good, sec, 0) * _SEC + np.where(good, rest, 0), good


def _stamp(message: Any) -> int | None:
    """Return the stamp of a message in ns, 0 where there is none, None where it is wrong."""
    names: tuple[Sequence[str], Sequence[str]] = SECONDS, NANOSECONDS
    if isinstance(message, _Joints):
        given: Any = message.timestamp
        names = joint_messages.SECONDS, joint_messages.NANOSECONDS
    else:
        given = message.header and message.header.stamp
    if given is None:
        return 0
    if isinstance(given, int | float):
        return _checked(round(given * _SEC))
    seconds, rest = (
        next((value for key in keys if (value := getattr(given, key)) is not None), 0)
        for keys in names
    )
    return _checked(seconds * _SEC + rest) if 0 <= rest < _SEC else None


def _checked(stamp_ns: int) -> int | None:
    return stamp_ns if abs(stamp_ns) <= STAMP_LIMIT_NS else None
