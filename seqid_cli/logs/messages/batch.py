"""Batches of messages: payloads in one buffer, and the rows of numbers made of them.

A message is what its parser makes of it: dictionaries of JSON, objects of protobuf, and
of CDR the places of its numbers. Joint states have the fields of sensor_msgs'
JointState, of control_msgs' DynamicJointState or of `foxglove.JointStates`:
`timestamp`, and `joints` with `name` and optional `position`, `velocity` and `effort`.
The state of a joint trajectory controller has points of a trajectory, `feedback` and
`reference`, in older versions `actual` and `desired`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.raw import Array, Mask, Rows, Stamps
from seqid_cli.logs.tables.name_words import COMMAND_NAMES, COMMANDS

Bytes = NDArray[np.uint8]
Kind = Literal["joint_state", "dynamic_joint_state", "controller_state", "imu"]
Decode = Callable[["Payloads"], "Decoded"]

JOINT_QUANTITIES = ("position", "velocity", "effort")
IMU_FIELDS = tuple(
    (name, axis)
    for name in ("linear_acceleration", "angular_velocity")
    for axis in "xyz"
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
        view = self.buffer.data
        ends = self.starts + self.lengths
        spans = zip(self.starts.tolist(), ends.tolist(), strict=True)
        return (bytes(view[start:end]) for start, end in spans)

    def take(self, rows: Rows | Mask | slice) -> "Payloads":
        """Select payloads (indices, mask or slice) without a copy."""
        return Payloads(self.buffer, self.starts[rows], self.lengths[rows])

    def cut(self, low: int, high: int) -> Bytes:
        """Copy bytes [low, high) of every payload, (M, high - low).

        `low` is -7 at least: a buffer has some bytes before its first payload.
        """
        width = high - low
        starts = self.starts + low
        if not width or not len(starts):
            return np.zeros((len(starts), width), np.uint8)
        # A view of the bytes from every place on, of which those at the starts are
        # taken.
        n_places = len(self.buffer) - width + 1
        windows = np.ndarray((n_places,), f"V{width}", self.buffer, strides=(1,))
        return windows[starts].view(np.uint8).reshape(len(starts), width)


@dataclass(frozen=True)
class Decoded:
    """M decoded messages."""

    stamp_ns: Stamps  # (M,) of the headers
    # (M, 3 n) positions, velocities, efforts, or (M, 6 n) with COMMANDS behind them;
    # (M, 6) as IMU_FIELDS; NaN where missing
    values: Array
    good: Mask  # (M,) which could be decoded

    @classmethod
    def empty(cls, count: int, width: int) -> "Decoded":
        """Make a batch in which nothing is decoded yet."""
        return cls(
            stamp_ns=np.zeros(count, np.int64),
            values=np.full((count, width), np.nan),
            good=np.zeros(count, np.bool_),
        )

    def take(self, rows: Rows | Mask) -> "Decoded":
        """Select messages."""
        return Decoded(self.stamp_ns[rows], self.values[rows], self.good[rows])

    def put(self, rows: Rows, part: "Decoded") -> None:
        """Put messages decoded by themselves into their rows of the batch."""
        self.stamp_ns[rows] = part.stamp_ns
        self.values[rows] = part.values
        self.good[rows] = part.good


class NameMap:
    """Finds the entry of a JointState for each joint of the robot.

    Parameters
    ----------
    joints : iterable of str
        Names of the robot's joints in the log.
    effort : {"torque", "current"}
        An interface of that name stands in for effort.
    interfaces : mapping of str to str
        Names of the interfaces that are read as position, velocity and effort, where
        they have others.
    most : int
        Names of messages that are remembered in `seen`, for the message that none of
        them fits; also lists of names whose entries are remembered.
    """

    def __init__(
        self,
        joints: Iterable[str],
        effort: str = "torque",
        *,
        interfaces: Mapping[str, str] = {},
        most: int = 200,
    ) -> None:
        self.joints = tuple(joints)
        # What the first message says whose arrays and names differ in number.
        self.unequal = ""
        self.effort = effort
        self.interfaces = dict(interfaces)
        self.seen: dict[str, None] = {}
        self._most = most
        self._joint_by_name = {name: j for j, name in enumerate(self.joints)}
        self._pairs: dict[tuple[str, ...], list[tuple[int, int]]] = {}

    def width(self, kind: Kind) -> int:
        """Return the values per row."""
        if kind == "imu":
            return len(IMU_FIELDS)
        n_quantities = len(JOINT_QUANTITIES)
        if kind != "joint_state":
            n_quantities += len(COMMANDS)
        return n_quantities * len(self.joints)

    def pairs(self, names: Sequence[str]) -> list[tuple[int, int]]:
        """Pair entries in a message with joints of the robot.

        Of equal names the first counts.
        """
        key = tuple(names)
        if key not in self._pairs:
            entry_by_joint: dict[int, int] = {}
            for entry, name in enumerate(names):
                if len(self.seen) < self._most:
                    self.seen.setdefault(name)
                if name in self._joint_by_name:
                    entry_by_joint.setdefault(self._joint_by_name[name], entry)
            # A hostile file has ever new lists of names.
            if len(self._pairs) >= self._most:
                self._pairs.clear()
            self._pairs[key] = [(entry, j) for j, entry in entry_by_joint.items()]
        return self._pairs[key]


def row_of(kind: Kind, message: object, names: NameMap) -> list[object]:
    """Return the row of a message.

    Its values are those of the message's fields: numbers, places of numbers, texts;
    None where absent. Raises ValueError where the fields do not fit each other.
    """
    if kind == "imu":
        return [field(field(message, name), axis) for name, axis in IMU_FIELDS]
    row: list[object] = [None] * names.width(kind)
    if kind == "dynamic_joint_state":
        _fill_from_interfaces(row, message, names)
    elif kind == "controller_state":
        _fill_from_controller(row, message, names)
    elif field(message, "joints") is not None:
        _fill_from_joints(row, message, names)
    else:
        _fill_from_arrays(row, message, names)
    return row


def _fill_from_interfaces(row: list[object], message: object, names: NameMap) -> None:
    """Fill a row by a DynamicJointState: named values of each joint."""
    entries = _texts(field(message, "joint_names"))
    interfaces = _list(field(message, "interface_values"))
    if len(interfaces) != len(entries):
        raise ValueError("joints and interfaces differ in number")
    n = len(names.joints)
    for entry, joint in names.pairs(entries):
        quantities = _texts(field(interfaces[entry], "interface_names"))
        values = _list(field(interfaces[entry], "values"))
        by_quantity = dict(zip(quantities, values, strict=True))
        by_quantity.setdefault("effort", by_quantity.get(names.effort))
        row[joint::n] = [
            by_quantity.get(names.interfaces.get(quantity, quantity))
            for quantity in JOINT_QUANTITIES
        ] + [_commanded(by_quantity, quantity, names) for quantity in COMMANDS]


def _commanded(
    by_interface: Mapping[str, object], quantity: str, names: NameMap
) -> object:
    """Return a command among the values of a joint; None where there is none."""
    declared = names.interfaces.get(quantity)
    for name in (declared,) if declared else COMMAND_NAMES[quantity]:
        if name in by_interface:
            return by_interface[name]
    return None


def _fill_from_controller(row: list[object], message: object, names: NameMap) -> None:
    """Fill a row by the state of a joint trajectory controller.

    The torque that it asks for is in its output where it commands effort.
    """
    entries = _texts(field(message, "joint_names"))
    measured = _first_field(message, ("feedback", "actual"))
    reference = _first_field(message, ("reference", "desired"))
    output = field(message, "output")
    fields = [(measured, "positions"), (measured, "velocities"), (measured, "effort")]
    fields += [(reference, "positions"), (reference, "velocities")]
    fields.append((output if _list(field(output, "effort")) else reference, "effort"))
    arrays = [_list(field(point, name)) for point, name in fields]
    for (_, name), array in zip(fields, arrays, strict=True):
        if len(array) not in (0, len(entries)):
            raise ValueError(f"{len(array)} {name} for {len(entries)} names")
    n = len(names.joints)
    for entry, joint in names.pairs(entries):
        row[joint::n] = [array[entry] if array else None for array in arrays]


def _first_field(message: object, keys: Sequence[str]) -> object:
    """Return the first field of some names that a message has."""
    for key in keys:
        value = field(message, key)
        if value is not None:
            return value
    return None


def _fill_from_joints(row: list[object], message: object, names: NameMap) -> None:
    """Fill a row by a `foxglove.JointStates`: a message for each joint."""
    joints = _list(field(message, "joints"))
    n = len(names.joints)
    for entry, joint in names.pairs([str(field(each, "name")) for each in joints]):
        row[joint::n] = [field(joints[entry], name) for name in JOINT_QUANTITIES]


def _fill_from_arrays(row: list[object], message: object, names: NameMap) -> None:
    """Fill a row by a JointState: an array of each quantity, which may be empty."""
    entries = _texts(field(message, "name"))
    arrays = [_list(field(message, quantity)) for quantity in JOINT_QUANTITIES]
    for quantity, array in zip(JOINT_QUANTITIES, arrays, strict=True):
        if len(array) not in (0, len(entries)):
            text = f"{quantity} has {len(array)} values for {len(entries)} names"
            names.unequal = names.unequal or text
            raise ValueError(text)
    n = len(names.joints)
    for entry, joint in names.pairs(entries):
        row[joint::n] = [array[entry] if array else None for array in arrays]


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
