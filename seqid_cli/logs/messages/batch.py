"""Batches of messages: payloads that lie in one buffer, and the rows of numbers made of them.

A message is what its parser makes of it: dictionaries of JSON, objects of protobuf, and
of CDR the places of its numbers. Joint states have the fields of sensor_msgs'
JointState, of control_msgs' DynamicJointState or of `foxglove.JointStates`:
`timestamp`, and `joints` with `name` and optional `position`, `velocity` and `effort`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.raw import Array, Mask, Rows, Stamps

Bytes = NDArray[np.uint8]
Kind = Literal["joint_state", "dynamic_joint_state", "imu"]
Decode = Callable[["Payloads"], "Decoded"]

JOINT_QUANTITIES = ("position", "velocity", "effort")
IMU_FIELDS = tuple(
    (k, axis) for k in ("linear_acceleration", "angular_velocity") for axis in "xyz"
)
_PLAIN = frozenset((float, int, str))
FRONT = 8  # bytes that any buffer has before its first payload; see `Payloads.cut`


@dataclass(frozen=True)
class Payloads:
    """M payloads that lie in one buffer."""

    buffer: Bytes
    starts: NDArray[np.int64]  # (M,)
    lengths: NDArray[np.int64]  # (M,)

    @classmethod
    def of(cls, batch: Sequence[bytes]) -> "Payloads":
        """Lay payloads one behind the other."""
        lengths = np.fromiter(map(len, batch), np.int64, len(batch))
        buffer = np.frombuffer(b"".join([bytes(FRONT), *batch]), np.uint8)
        return cls(buffer, FRONT + np.cumsum(lengths) - lengths, lengths)

    def __len__(self) -> int:
        return len(self.starts)

    def __iter__(self) -> Iterator[bytes]:
        view, ends = self.buffer.data, self.starts + self.lengths
        spans = zip(self.starts.tolist(), ends.tolist(), strict=True)
        return (bytes(view[start:end]) for start, end in spans)

    def take(self, rows: Rows | Mask | slice) -> "Payloads":
        """Select payloads (indices, mask or slice) without a copy."""
        return Payloads(self.buffer, self.starts[rows], self.lengths[rows])

    def cut(self, low: int, high: int) -> Bytes:
        """Copy bytes [low, high) of every payload, (M, high - low); `low` is -7 at least."""
        width = high - low
        buffer, starts = self.buffer, self.starts + low
        if not width or not len(starts):
            return np.zeros((len(starts), width), np.uint8)
        every = np.ndarray(
            (len(buffer) - width + 1,), f"V{width}", buffer, strides=(1,)
        )
        return every[starts].view(np.uint8).reshape(len(starts), width)


@dataclass(frozen=True)
class Decoded:
    """M messages: header stamps [ns], values (NaN where missing), and which could be decoded."""

    stamp_ns: Stamps
    values: Array  # (M, 3 n) positions, velocities, efforts; (M, 6) as IMU_FIELDS
    good: Mask

    @classmethod
    def empty(cls, count: int, width: int) -> "Decoded":
        """Make a batch in which nothing is decoded yet."""
        none = np.full((count, width), np.nan)
        return cls(np.zeros(count, np.int64), none, np.zeros(count, np.bool_))

    def put(self, rows: Rows, part: "Decoded") -> None:
        """Put messages decoded by themselves into their rows of the batch."""
        self.stamp_ns[rows], self.values[rows] = part.stamp_ns, part.values
        self.good[rows] = part.good


class NameMap:
    """Which entry of a JointState belongs to which joint of the robot.

    `effort` {"torque", "current"}: an interface of that name stands in for effort.
    `most`: names of messages that are remembered, for the message that none of them
    fits.
    """

    def __init__(
        self, joints: Iterable[str], effort: str = "torque", *, most: int = 200
    ) -> None:
        self.joints, self.effort, self._most = tuple(joints), effort, most
        self._index = {name: i for i, name in enumerate(self.joints)}
        self._pairs: dict[tuple[str, ...], list[tuple[int, int]]] = {}
        self.seen: dict[str, None] = {}

    def width(self, kind: Kind) -> int:
        """Values per row."""
        return (
            len(IMU_FIELDS)
            if kind == "imu"
            else len(JOINT_QUANTITIES) * len(self.joints)
        )

    def pairs(self, names: Sequence[str]) -> list[tuple[int, int]]:
        """Pair (entry in the message, joint of the robot); of equal names the first counts."""
        key = tuple(names)
        if key not in self._pairs:
            found: dict[int, int] = {}
            for entry, name in enumerate(names):
                if len(self.seen) < self._most:
                    self.seen.setdefault(name)
                if name in self._index:
                    found.setdefault(self._index[name], entry)
            if len(self._pairs) >= self._most:
                self._pairs.clear()
            self._pairs[key] = [(entry, joint) for joint, entry in found.items()]
        return self._pairs[key]


def row_of(kind: Kind, message: object, names: NameMap) -> list[object]:
    """Return the row of a message, None where absent; raises ValueError where fields do not fit."""
    if kind == "imu":
        return [field(field(message, name), axis) for name, axis in IMU_FIELDS]
    row: list[object] = [None] * names.width(kind)
    n = len(names.joints)
    if kind == "dynamic_joint_state":
        entries = _texts(field(message, "joint_names"))
        interfaces = _list(field(message, "interface_values"))
        if len(interfaces) != len(entries):
            raise ValueError("joints and interfaces differ in number")
        for entry, joint in names.pairs(entries):
            kinds = _texts(field(interfaces[entry], "interface_names"))
            values = _list(field(interfaces[entry], "values"))
            given = dict(zip(kinds, values, strict=True))
            given.setdefault("effort", given.get(names.effort))
            row[joint::n] = map(given.get, JOINT_QUANTITIES)
    elif (joints := field(message, "joints")) is not None:
        joints = _list(joints)
        for entry, joint in names.pairs([str(field(each, "name")) for each in joints]):
            row[joint::n] = [field(joints[entry], name) for name in JOINT_QUANTITIES]
    else:
        entries = _texts(field(message, "name"))
        arrays = [_list(field(message, quantity)) for quantity in JOINT_QUANTITIES]
        for quantity, array in zip(JOINT_QUANTITIES, arrays, strict=True):
            if len(array) not in (0, len(entries)):
                raise ValueError(
                    f"{len(array)} values of {quantity} for {len(entries)} names"
                )
        for entry, joint in names.pairs(entries):
            row[joint::n] = [array[entry] if array else None for array in arrays]
    return row


def field(message: object, key: str) -> object:
    """Return a field, None where it is absent; protobuf would give a default there."""
    if isinstance(message, dict):
        return message.get(key)
    value = getattr(message, key, None)
    if value.__class__ in _PLAIN and value:
        return value
    if hasattr(message, "HasField") and (not value or hasattr(value, "HasField")):
        try:
            return value if message.HasField(key) else None
        except ValueError:  # fields without presence are never absent
            return value
    return value


def _list(value: object) -> Sequence[object]:
    if value is None:
        return ()
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise ValueError("no list")
    return value


def _texts(value: object) -> list[str]:
    return [str(each) for each in _list(value)]
