"""ROS 2 messages in CDR, a batch at a time: JointState, DynamicJointState and Imu.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is
parsed field by field, with every bound checked, into a `Layout`: which bytes carry
structure (lengths, names) and where the numbers lie. All messages of its length with
the same structure are decoded as strided views, with the same result. Rows are cut into
words of 8 bytes from the end of the message: those that end in doubles come to lie
aligned in this way.
"""

import struct
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.messages.batch import (
    JOINT_QUANTITIES,
    Decoded,
    Kind,
    NameMap,
    Payloads,
    row_of,
)
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Mask, Rows, Stamps

Words = NDArray[np.uint64]

WORD = 8
_SEC = 1_000_000_000
# bytes; between them seconds (int32), nanoseconds (uint32)
_ENCAPSULATION, _STAMP_END = 4, 12
# Representation identifier -> (byte order, largest alignment): plain CDR of XCDR 1 and
# 2.
_REPRESENTATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}


class _Cursor:
    """Reads CDR behind the stamp of a header; every read checks the bounds."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _STAMP_END or data[0] or data[1] not in _REPRESENTATIONS:
            raise ValueError("no plain CDR")
        self.data = data
        self.order, self._largest = _REPRESENTATIONS[data[1]]
        self.at = _STAMP_END
        # 0xFF where a message of the same layout must have the same bytes.
        self.mask = bytearray(
            b"\xff" * _ENCAPSULATION + bytes(len(data) - _ENCAPSULATION)
        )

    def message(self, kind: Kind) -> dict[str, object]:
        """Read a message: places instead of its numbers."""
        self.text(structural=False)  # the frame
        if kind == "imu":
            self.doubles(4 + 9)  # orientation and its covariance
            gyro = self.doubles(3)
            self.doubles(9)
            acceleration = self.doubles(3)
            self.doubles(9)
            vectors = {"angular_velocity": gyro, "linear_acceleration": acceleration}
            return {
                name: dict(zip("xyz", own, strict=True))
                for name, own in vectors.items()
            }
        names = self.texts()
        if kind == "joint_state":
            arrays = {name: self.doubles(self.count()) for name in JOINT_QUANTITIES}
            return {"name": names, **arrays}
        interfaces = [
            {"interface_names": self.texts(), "values": self.doubles(self.count())}
            for _ in range(self.count())
        ]
        return {"joint_names": names, "interface_values": interfaces}

    def count(self) -> int:
        """Read a length (uint32); it is structure."""
        self._align(4)
        start = self._advance(4, structure=4)
        return int(struct.unpack_from(f"{self.order}I", self.data, start)[0])

    def text(self, *, structural: bool = True) -> str:
        """Read a string."""
        length = self.count()
        start = self._advance(length, structure=length if structural else 0)
        return self.data[start : self.at].rstrip(b"\0").decode("utf-8")

    def texts(self) -> list[str]:
        """Read a list of strings."""
        return [self.text() for _ in range(self.count())]

    def doubles(self, count: int) -> range:
        """Step over float64 values; returns where they begin."""
        if count:
            self._align(8)
        first = self._advance(8 * count)
        return range(first, first + 8 * count, 8)

    def _align(self, size: int) -> None:
        size = min(size, self._largest)
        self.at += -(self.at - _ENCAPSULATION) % size

    def _advance(self, length: int, structure: int = 0) -> int:
        """Step over bytes, the first of which may be structure; returns where they begin."""
        start, self.at = self.at, self.at + length
        if self.at > len(self.data):
            raise ValueError("the message breaks off")
        self.mask[start : start + structure] = b"\xff" * structure
        return start


@dataclass(frozen=True)
class Layout:
    """Where structure and numbers of messages of one length lie, in rows of `width` numbers."""

    order: str  # of the bytes, "<" or ">"
    width: int
    pad: int  # bytes in front of the message, for whole words
    mask: Words  # (W,) of the message with its pad: bits of structure
    reference: Words  # (W,) likewise: what they must be
    checked: tuple[int, ...]  # words that hold structure
    # numbers side by side: byte of a row, column, how many
    runs: tuple[tuple[int, int, int], ...]

    @classmethod
    def of(cls, data: bytes, kind: Kind, names: NameMap) -> "Layout":
        """Parse a message. Raises ValueError: it is damaged."""
        cursor = _Cursor(data)
        row = row_of(kind, cursor.message(kind), names)
        front = bytes(-len(data) % WORD)
        mask = np.frombuffer(front + cursor.mask, np.uint64)
        reference = np.frombuffer(front + data, np.uint64) & mask
        runs = []
        for offset, group in groupby(enumerate(row), _offset):
            if offset is not None:
                first, *others = [column for column, _ in group]
                runs.append(
                    (offset + WORD * first + len(front), first, 1 + len(others))
                )
        checked = tuple(np.flatnonzero(mask).tolist())
        return cls(
            cursor.order, len(row), len(front), mask, reference, checked, tuple(runs)
        )

    def decode(self, payloads: Payloads) -> tuple[Mask, Decoded]:
        """Tell which payloads of the layout's length have its structure, and decode these."""
        rows = payloads.cut(-self.pad, WORD * len(self.mask) - self.pad)
        words = rows.view(np.uint64)
        fits = np.ones(len(rows), np.bool_)
        for i in self.checked:
            fits &= (words[:, i] ^ self.reference[i]) & self.mask[i] == 0
        rows = rows if fits.all() else rows[fits]
        values = np.empty((len(rows), self.width))
        if sum(size for *_, size in self.runs) < self.width:
            values.fill(np.nan)
        for at, column, size in self.runs:
            numbers = rows[:, at : at + WORD * size].view(f"{self.order}f8")
            values[:, column : column + size] = numbers
        stamped = rows[:, self.pad + _ENCAPSULATION :]
        seconds = stamped[:, :4].view(f"{self.order}i4")[:, 0]
        rest = stamped[:, 4:8].view(f"{self.order}u4")[:, 0]
        limit = STAMP_LIMIT_NS // _SEC
        good = (rest < _SEC) & (seconds >= -limit) & (seconds < limit)
        stamps: Stamps = np.where(good, seconds.astype(np.int64) * _SEC + rest, 0)
        return fits, Decoded(stamps, values, good)


def _offset(entry: tuple[int, object]) -> int | None:
    """Tell what places have in common that lie side by side, as their columns do."""
    column, place = entry
    return place - WORD * column if isinstance(place, int) else None


@dataclass
class LayoutDecoder:
    """Decodes batches of a kind; remembers the layouts that it has met, up to `most`.

    Of one length `rounds` layouts are decoded together; what remains goes one by one.
    """

    kind: Kind
    names: NameMap
    rounds: int = 32
    most: int = 512
    _known: dict[int, list[Layout]] = field(default_factory=dict)

    def __call__(self, payloads: Payloads) -> Decoded:
        """Decode one batch."""
        lengths = payloads.lengths
        usual = self._known.get(int(lengths[0]), ())[:1] if len(lengths) else ()
        if usual and (lengths == lengths[0]).all():
            fits, part = usual[0].decode(payloads)
            if fits.all():
                return part
        out = Decoded.empty(len(payloads), self.names.width(self.kind))
        order = np.argsort(lengths, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
            self._of_one_length(payloads, rows, out)
        return out

    def _of_one_length(self, payloads: Payloads, left: Rows, out: Decoded) -> None:
        """Decode payloads by the known layouts, then by those that are met on the way."""

        def fitting(layout: Layout, rows: Rows) -> Rows:
            fits, part = layout.decode(payloads.take(rows))
            out.put(rows[fits], part)
            return rows[~fits]

        length = int(payloads.lengths[left[0]]) if len(left) else 0
        known = list(self._known.get(length, ()))
        for layout in known:
            left = fitting(layout, left)
        while len(left):
            first, rest = left[:1], left[1:]
            with suppress(ValueError):  # it is damaged
                layout = Layout.of(
                    next(iter(payloads.take(first))), self.kind, self.names
                )
                fitting(layout, first)
                if len(known) < self.rounds:
                    rest = fitting(layout, rest)
                    known.append(layout)
                    if sum(map(len, self._known.values())) < self.most:
                        self._known[length] = known
            left = rest
