"""ROS 2 messages in CDR, a batch at a time: JointState, DynamicJointState and Imu.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is parsed field
by field, with every bound checked, into a `Layout`: which bytes carry structure (lengths, names)
and where the numbers lie. All messages of its length with the same structure are decoded as strided
views. What fits no layout is parsed by itself; the result is the same either way.

Rows are cut into words of 8 bytes, counted from the end of the message: messages that end in
doubles come to lie aligned in this way.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.messages.batch import (
    JOINT_QUANTITIES,
    Bytes,
    Decode,
    Decoded,
    Kind,
    NameMap,
    Payloads,
    check_lengths,
)
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Mask, Stamps

Words = NDArray[np.uint64]

WORD = 8
STAMP = 4  # byte at which seconds (int32) and nanoseconds (uint32) stand
_SEC = 1_000_000_000


class Layout(NamedTuple):
    """Where structure and numbers of a message of L bytes lie."""

    reference: Bytes  # (L,)
    mask: Bytes  # (L,) 0xFF where messages must equal `reference`
    columns: Sequence[tuple[int, int]]  # column, byte at which its float64 begins
    order: str  # of the bytes, "<" or ">"


class _Run(NamedTuple):
    """Numbers side by side: `size` of them, from a byte of a row into columns from one on."""

    at: int
    column: int
    size: int


@dataclass(frozen=True)
class Form:
    """A layout made ready for messages of its length, in rows of `width` numbers."""

    order: str
    width: int
    pad: int  # bytes in front of the message, for whole words
    mask: Words  # (W,) of the message with its pad
    reference: Words  # (W,) likewise
    checked: tuple[int, ...]  # words that hold structure
    runs: tuple[_Run, ...]

    @classmethod
    def of(cls, layout: Layout, width: int) -> "Form":
        """Prepare a layout."""
        pad = -len(layout.mask) % WORD
        front = np.zeros(pad, np.uint8)
        mask = np.concatenate([front, layout.mask]).view(np.uint64)
        reference = np.concatenate([front, layout.reference]).view(np.uint64) & mask
        checked = tuple(np.flatnonzero(mask).tolist())
        runs = tuple(_runs_of(sorted(layout.columns), pad))
        return cls(layout.order, width, pad, mask, reference, checked, runs)

    def decode(self, payloads: Payloads) -> tuple[Mask, Decoded]:
        """Tell which payloads of the layout's length have its structure, and decode these."""
        rows = payloads.cut(-self.pad, WORD * len(self.mask) - self.pad)
        words = rows.view(np.uint64)
        fits = np.ones(len(rows), np.bool_)
        for i in self.checked:
            fits &= (words[:, i] ^ self.reference[i]) & self.mask[i] == 0
        rows = rows if fits.all() else rows[fits]
        values = np.empty((len(rows), self.width))
        if sum(run.size for run in self.runs) < self.width:
            values.fill(np.nan)
        for run in self.runs:
            target = values[:, run.column : run.column + run.size]
            target[:] = rows[:, run.at : run.at + WORD * run.size].view(f"{self.order}f8")
        stamps, good = self._stamps(rows[:, self.pad + STAMP :])
        return fits, Decoded(stamps, values, good)

    def _stamps(self, rows: Bytes) -> tuple[Stamps, Mask]:
        seconds = rows[:, :4].view(f"{self.order}i4")[:, 0]
        rest = rows[:, 4:8].view(f"{self.order}u4")[:, 0]
        stamps: Stamps = seconds.astype(np.int64)
        stamps *= _SEC
        stamps += rest
        limit = STAMP_LIMIT_NS // _SEC
        good = (rest < _SEC) & (seconds >= -limit) & (seconds < limit)
        stamps[~good] = 0
        return stamps, good


@dataclass
class LayoutDecoder:
    """Decodes batches; remembers the layouts that it has met, up to `most`.

    `parse` raises ValueError or struct.error where a payload is damaged. Of one length `rounds`
    layouts are decoded together; what remains goes one by one. Rows have `width` numbers.
    """

    parse: Callable[[bytes], Layout]
    width: int
    rounds: int = 32
    most: int = 512
    _known: dict[int, list[Form]] = field(default_factory=dict)

    def __call__(self, payloads: Payloads) -> Decoded:
        """Decode one batch."""
        lengths = payloads.lengths
        usual = self._known.get(int(lengths[0]), ())[:1] if len(lengths) else ()
        if usual and (lengths == lengths[0]).all():
            fits, part = usual[0].decode(payloads)
            if fits.all():
                return part
        out = Decoded.empty(len(payloads), self.width)
        order = np.argsort(lengths, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
            self._in_turn(payloads, rows, out)
        return out

    def _in_turn(self, payloads: Payloads, left: NDArray[np.intp], out: Decoded) -> None:
        """Decode payloads of one length and several layouts, one layout after the other."""
        known = self._known.get(int(payloads.lengths[left[0]]), []) if len(left) else []
        tried = len(known)
        for number in count():
            if not len(left):
                return
            form = known[number] if number < tried else self._made(payloads.take(left[:1]), known)
            some = left if number < self.rounds else left[:1]
            fits = np.zeros(len(some), np.bool_)
            if form is not None:
                fits, part = form.decode(payloads.take(some))
                out.put(some[fits], part)
            fits[0] |= number >= tried  # it had its turn, even where it is damaged
            left = np.concatenate([some[~fits], left[len(some) :]])

    def _made(self, first: Payloads, known: list[Form]) -> Form | None:
        """Make the layout of one payload and remember it; None where it has none."""
        try:
            made = Form.of(self.parse(next(iter(first))), self.width)
        except (ValueError, struct.error):
            return None
        if len(known) < self.rounds and sum(map(len, self._known.values())) < self.most:
            known.append(made)
            self._known[int(first.lengths[0])] = known
        return made


def _runs_of(columns: Sequence[tuple[int, int]], pad: int) -> list[_Run]:
    """Join neighbouring columns whose numbers are neighbours as well."""
    found: list[_Run] = []
    for column, place in columns:
        last, at = found[-1] if found else None, place + pad
        if last and (column, at) == (last.column + last.size, last.at + WORD * last.size):
            found[-1] = last._replace(size=last.size + 1)
        else:
            found.append(_Run(at, column, 1))
    return found


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
