"""ROS 2 messages in CDR, a batch at a time: JointState, DynamicJointState and Imu.

The parsers here read one message field by field, with every bound checked, and say where its
structure and its numbers lie; `layouts` decodes the messages that are alike.
"""

import struct
from collections.abc import Callable, Sequence

import numpy as np

from seqid_cli.logs.messages.batch import JOINT_QUANTITIES, Decode, Kind, NameMap, check_lengths
from seqid_cli.logs.messages.layouts import Layout, LayoutDecoder

_ENCAPSULATION = 4
_STAMP_END = 12
# Representation identifier -> (byte order, largest alignment): plain CDR of XCDR 1 and 2.
_REPRESENTATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}


class _Cursor:
    """Reads CDR behind the stamp of a header; every read checks the bounds."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _STAMP_END or data[0] or data[1] not in _REPRESENTATIONS:
            raise ValueError("no plain CDR")
        self.data = data
        self.order, self._largest = _REPRESENTATIONS[data[1]]
        self.at = _STAMP_END
        self.mask = np.zeros(len(data), np.uint8)
        self.mask[:_ENCAPSULATION] = 0xFF

    def count(self, least: int = 0) -> int:
        """Read a length (uint32) of items of at least that many bytes; it is structure."""
        self._align(4)
        (value,) = struct.unpack_from(f"{self.order}I", self.data, self.at)
        self.mask[self.at : self.at + 4] = 0xFF
        self.at += 4
        if value * least > len(self.data):
            raise ValueError("more items than bytes")
        return int(value)

    def text(self, *, structural: bool = True) -> str:
        """Read a string."""
        start, end = self._advance(self.count())
        if structural:
            self.mask[start:end] = 0xFF
        return self.data[start:end].rstrip(b"\0").decode("utf-8")

    def texts(self) -> list[str]:
        """Read a list of strings."""
        return [self.text() for _ in range(self.count(4))]

    def doubles(self, count: int) -> range:
        """Step over float64 values; returns where they begin."""
        if count:
            self._align(8)
        first = self._advance(8 * count)[0]
        return range(first, first + 8 * count, 8)

    def layout(self, columns: Sequence[tuple[int, int]]) -> Layout:
        """Make the layout of the message."""
        return Layout(np.frombuffer(self.data, np.uint8), self.mask, columns, self.order)

    def _align(self, size: int) -> None:
        size = min(size, self._largest)
        self.at += -(self.at - _ENCAPSULATION) % size

    def _advance(self, length: int) -> tuple[int, int]:
        start, self.at = self.at, self.at + length
        if self.at > len(self.data):
            raise ValueError("the message breaks off")
        return start, self.at


def decoder(kind: Kind, names: NameMap) -> Decode:
    """Decode `sensor_msgs/msg/JointState`, `control_msgs/msg/DynamicJointState` or `Imu`."""
    parse = _PARSERS[kind]
    return LayoutDecoder(lambda data: parse(data, names), names.width(kind))


def _joint_state(data: bytes, names: NameMap) -> Layout:
    cursor = _Cursor(data)
    cursor.text(structural=False)
    entries = cursor.texts()
    arrays = [cursor.doubles(cursor.count(8)) for _ in JOINT_QUANTITIES]
    check_lengths(len(entries), [len(places) for places in arrays])
    pairs = names.pairs(entries)
    columns = [
        (quantity * len(names.joints) + joint, places[entry])
        for quantity, places in enumerate(arrays)
        for entry, joint in (pairs if places else ())
    ]
    return cursor.layout(columns)


def _dynamic_joint_state(data: bytes, names: NameMap) -> Layout:
    cursor = _Cursor(data)
    cursor.text(structural=False)
    entries = cursor.texts()
    if cursor.count(8) != len(entries):
        raise ValueError("joints and interfaces differ in number")
    interfaces = []
    for _ in entries:
        kinds = cursor.texts()
        values = cursor.doubles(cursor.count(8))
        interfaces.append((kinds, values))
    columns: dict[int, int] = {}
    for entry, joint in names.pairs(entries):
        given = dict(zip(*interfaces[entry], strict=True))
        if names.effort in given:
            given.setdefault("effort", given[names.effort])
        for quantity, name in enumerate(JOINT_QUANTITIES):
            if name in given:
                columns[quantity * len(names.joints) + joint] = given[name]
    return cursor.layout(list(columns.items()))


def _imu(data: bytes, names: NameMap) -> Layout:
    del names
    cursor = _Cursor(data)
    cursor.text(structural=False)
    cursor.doubles(4 + 9)  # orientation and its covariance
    gyro = cursor.doubles(3)
    cursor.doubles(9)
    acceleration = cursor.doubles(3)
    cursor.doubles(9)
    return cursor.layout(list(enumerate([*acceleration, *gyro])))


_PARSERS: dict[Kind, Callable[[bytes, NameMap], Layout]] = {
    "joint_state": _joint_state,
    "dynamic_joint_state": _dynamic_joint_state,
    "imu": _imu,
}
