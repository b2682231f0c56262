"""ROS 2 messages in CDR: JointState and Imu, a batch at a time.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is parsed field
by field; the others that have the same length and the same bytes at every place that carries
structure (encapsulation, counts, names) are decoded together by position.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.decoding import Decode, Decoded, NameMap, check_lengths
from seqid_cli.logs.raw import Array

_ENCAPSULATION = 4
_STAMP_AT = 4
_STAMP_END = 12
# Representation identifier -> (byte order, largest alignment): plain CDR of XCDR 1 and 2.
_REPRESENTATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}
_ROUNDS = 32  # layouts of one length decoded together; what remains goes one by one


@dataclass(frozen=True)
class _Layout:
    """Where the values of one message lie."""

    order: str
    structure: list[slice]  # bytes that a message must share
    blocks: list[tuple[int, int, list[tuple[int, int]]]]  # offset, count, (entry, column)


_Parse = Callable[[bytes], _Layout]


class _Cursor:
    """Reads CDR; every read checks the bounds."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _STAMP_END or data[0] or data[1] not in _REPRESENTATIONS:
            raise ValueError("no plain CDR")
        self.data = data
        self.order, self._largest = _REPRESENTATIONS[data[1]]
        self.at = _STAMP_END
        self.structure = [slice(0, _ENCAPSULATION)]

    def count(self) -> int:
        """Read a length (uint32), which is structure."""
        self._align(4)
        (value,) = struct.unpack_from(f"{self.order}I", self.data, self.at)
        self.structure.append(slice(self.at, self.at + 4))
        self.at += 4
        return int(value)

    def text(self, *, structural: bool) -> str:
        """Read a string."""
        start, end = self._advance(self.count())
        if structural:
            self.structure.append(slice(start, end))
        return self.data[start:end].rstrip(b"\0").decode("utf-8")

    def doubles(self, count: int) -> int:
        """Step over float64 values; returns the offset of the first."""
        if count:
            self._align(8)
        return self._advance(8 * count)[0]

    def _align(self, size: int) -> None:
        size = min(size, self._largest)
        self.at += -(self.at - _ENCAPSULATION) % size

    def _advance(self, length: int) -> tuple[int, int]:
        start, self.at = self.at, self.at + length
        if self.at > len(self.data):
            raise ValueError("the message breaks off")
        return start, self.at


def joint_state_decoder(names: NameMap) -> Decode:
    """Decode `sensor_msgs/msg/JointState`."""

    def parse(data: bytes) -> _Layout:
        cursor = _Cursor(data)
        cursor.text(structural=False)
        entries = [cursor.text(structural=True) for _ in range(_bounded(cursor))]
        pairs = names.pairs(entries)
        blocks, counts = [], []
        for quantity in range(3):
            counts.append(cursor.count())
            shift = quantity * len(names.joints)
            targets = [(entry, shift + joint) for entry, joint in pairs]
            blocks.append((cursor.doubles(counts[-1]), counts[-1], targets))
        check_lengths(len(entries), counts)
        return _Layout(cursor.order, cursor.structure, [b for b in blocks if b[1]])

    return lambda batch: _decode(batch, parse, names.width)


def imu_decoder() -> Decode:
    """Decode `sensor_msgs/msg/Imu`."""
    return lambda batch: _decode(batch, _parse_imu, 6)


def _parse_imu(data: bytes) -> _Layout:
    cursor = _Cursor(data)
    cursor.text(structural=False)
    cursor.doubles(4 + 9)  # orientation and its covariance
    gyro = cursor.doubles(3)
    cursor.doubles(9)
    acceleration = cursor.doubles(3)
    cursor.doubles(9)
    blocks = [
        (acceleration, 3, [(axis, axis) for axis in range(3)]),
        (gyro, 3, [(axis, 3 + axis) for axis in range(3)]),
    ]
    return _Layout(cursor.order, cursor.structure, blocks)


def _bounded(cursor: _Cursor) -> int:
    """Read the number of names; each takes at least its length."""
    count = cursor.count()
    if 4 * count > len(cursor.data):
        raise ValueError("more names than bytes")
    return count


def _decode(batch: Sequence[bytes], parse: _Parse, width: int) -> Decoded:
    out = Decoded.empty(len(batch), width)
    by_length: dict[int, list[int]] = {}
    for i, data in enumerate(batch):
        by_length.setdefault(len(data), []).append(i)
    for length, rows in by_length.items():
        if length >= _STAMP_END:
            joined = b"".join(batch[i] for i in rows)
            raw = np.frombuffer(joined, np.uint8).reshape(len(rows), length)
            _decode_equal_length(raw, np.array(rows), parse, out)
    return out


def _decode_equal_length(
    raw: NDArray[np.uint8], rows: NDArray[np.intp], parse: _Parse, out: Decoded
) -> None:
    rounds = 0
    while len(rows):
        rounds += 1
        alike = np.zeros(len(rows), np.bool_)
        alike[0] = True
        try:
            layout = parse(raw[0].tobytes())
        except (ValueError, struct.error):
            layout = None
        if layout is not None:
            if rounds <= _ROUNDS:
                alike = _same_structure(raw, layout)
            out.stamp_ns[rows[alike]], sane = _stamps(raw[alike], layout.order)
            out.values[rows[alike]] = _values(raw[alike], layout, out.values.shape[1])
            out.good[rows[alike]] = sane
        raw, rows = raw[~alike], rows[~alike]


def _same_structure(raw: NDArray[np.uint8], layout: _Layout) -> NDArray[np.bool_]:
    alike = np.ones(len(raw), np.bool_)
    for part in layout.structure:
        alike &= (raw[:, part] == raw[0, part]).all(axis=1)
    return alike


def _stamps(raw: NDArray[np.uint8], order: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    fields = np.ascontiguousarray(raw[:, _STAMP_AT:_STAMP_END])
    sec = fields[:, :4].copy().view(f"{order}i4")[:, 0].astype(np.int64)
    nanosec = fields[:, 4:].copy().view(f"{order}u4")[:, 0].astype(np.int64)
    return sec * 1_000_000_000 + nanosec, nanosec < 1_000_000_000


def _values(raw: NDArray[np.uint8], layout: _Layout, width: int) -> Array:
    values = np.full((len(raw), width), np.nan)
    for offset, count, targets in layout.blocks:
        block = np.ascontiguousarray(raw[:, offset : offset + 8 * count]).view(f"{layout.order}f8")
        for entry, column in targets:
            values[:, column] = block[:, entry]
    return values
