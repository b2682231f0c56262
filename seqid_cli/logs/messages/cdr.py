"""ROS messages, a batch at a time: JointState, DynamicJointState and Imu.

ROS 2 writes them in CDR. ROS 1 packs the same fields without padding, and has a number
of its own where CDR says how it is encoded.

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
from typing import NamedTuple

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
from seqid_cli.logs.raw import Mask, Rows, Stamps

Words = NDArray[np.uint64]

WORD = 8
_SEC = 1_000_000_000
# bytes; between them seconds (int32), nanoseconds (uint32)
_ENCAPSULATION = 4
_STAMP_END = 12
# Representation identifier -> (byte order, largest alignment): plain CDR of XCDR 1, 2.
_ROS1 = ("<", 1)  # nothing is aligned; the header's sequence number stands in front
_REPRESENTATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}


class _Cursor:
    """Reads a message behind the stamp of its header; every read checks the bounds."""

    def __init__(self, data: bytes, *, ros1: bool) -> None:
        if len(data) < _STAMP_END:
            raise ValueError("the message breaks off")
        self.data = data
        self.at = _STAMP_END
        # 0xFF where a message of the same layout must have the same bytes.
        self.mask = bytearray(len(data))
        if ros1:
            self.order, self._largest = _ROS1
            return
        if data[0] or data[1] not in _REPRESENTATIONS:
            raise ValueError("no plain CDR")
        self.order, self._largest = _REPRESENTATIONS[data[1]]
        self.mask[:_ENCAPSULATION] = b"\xff" * _ENCAPSULATION

    def message(self, kind: Kind) -> dict[str, object]:
        """Read a message: places instead of its numbers."""
        self.text(structural=False)  # the frame
        if kind == "imu":
            self.doubles(4 + 9)  # orientation and its covariance
            gyro = self.doubles(3)
            self.doubles(9)
            acceleration = self.doubles(3)
            self.doubles(9)
            return {
                "angular_velocity": dict(zip("xyz", gyro, strict=True)),
                "linear_acceleration": dict(zip("xyz", acceleration, strict=True)),
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
        """Step over bytes, of which the first may be structure; returns their start."""
        start = self.at
        self.at += length
        if self.at > len(self.data):
            raise ValueError("the message breaks off")
        self.mask[start : start + structure] = b"\xff" * structure
        return start


class _Run(NamedTuple):
    """Numbers side by side in a message and in its row."""

    byte: int  # of the first, in a message with its pad
    column: int  # of the first, in the row of numbers
    n_numbers: int


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The places of structure and numbers in messages of one length."""

    order: str  # of the bytes, "<" or ">"
    width: int  # numbers in a row
    pad: int  # bytes in front of the message, for whole words
    mask: Words  # (W,) of the message with its pad: bits of structure
    reference: Words  # (W,) likewise: what they must be
    checked: tuple[int, ...]  # words that hold structure
    runs: tuple[_Run, ...]

    @classmethod
    def of(
        cls, data: bytes, kind: Kind, names: NameMap, *, ros1: bool = False
    ) -> "Layout":
        """Parse a message. Raises ValueError: it is damaged."""
        cursor = _Cursor(data, ros1=ros1)
        row = row_of(kind, cursor.message(kind), names)
        pad = bytes(-len(data) % WORD)
        mask = np.frombuffer(pad + cursor.mask, np.uint64)
        reference = np.frombuffer(pad + data, np.uint64) & mask

        runs = []
        for offset, group in groupby(enumerate(row), _offset):
            if offset is not None:
                columns = [column for column, _ in group]
                byte = offset + WORD * columns[0] + len(pad)
                runs.append(_Run(byte, columns[0], len(columns)))
        return cls(
            order=cursor.order,
            width=len(row),
            pad=len(pad),
            mask=mask,
            reference=reference,
            checked=tuple(np.flatnonzero(mask).tolist()),
            runs=tuple(runs),
        )

    def decode(self, payloads: Payloads) -> tuple[Mask, Decoded]:
        """Decode the payloads, all of the layout's length, that have its structure.

        Returns
        -------
        ndarray of bool, (M,)
            The payloads that have it.
        Decoded
            These, decoded.
        """
        rows = payloads.cut(-self.pad, WORD * len(self.mask) - self.pad)
        words = rows.view(np.uint64)
        fits = np.ones(len(rows), np.bool_)
        for i in self.checked:
            fits &= (words[:, i] ^ self.reference[i]) & self.mask[i] == 0
        if not fits.all():
            rows = rows[fits]

        values = np.empty((len(rows), self.width))
        if sum(run.n_numbers for run in self.runs) < self.width:
            values.fill(np.nan)
        for byte, column, n_numbers in self.runs:
            numbers = rows[:, byte : byte + WORD * n_numbers]
            values[:, column : column + n_numbers] = numbers.view(f"{self.order}f8")

        header = rows[:, self.pad + _ENCAPSULATION :]
        seconds = header[:, :4].view(f"{self.order}i4")[:, 0]
        nanoseconds = header[:, 4:8].view(f"{self.order}u4")[:, 0]
        # Seconds of 32 bits stay within the limit of stamps.
        is_good = nanoseconds < _SEC
        stamp_ns = seconds.astype(np.int64) * _SEC + nanoseconds
        stamps: Stamps = np.where(is_good, stamp_ns, 0)
        return fits, Decoded(stamps, values, is_good)


def _offset(entry: tuple[int, object]) -> int | None:
    """Return what entries (column, place) that lie side by side have in common."""
    column, place = entry
    return place - WORD * column if isinstance(place, int) else None


@dataclass
class LayoutDecoder:
    """Decodes batches of a kind; remembers the layouts that it has met, up to `most`.

    Of one length `rounds` layouts are decoded together; what remains goes one by one.
    """

    kind: Kind
    names: NameMap
    ros1: bool = False  # whether the messages are packed as ROS 1 does it
    rounds: int = 32
    most: int = 512
    _layouts: dict[int, list[Layout]] = field(default_factory=dict)  # by length

    def __call__(self, payloads: Payloads) -> Decoded:
        """Decode one batch."""
        # Mostly all messages have one layout, and nothing need be sorted.
        lengths = payloads.lengths
        if len(lengths) and (lengths == lengths[0]).all():
            layouts = self._layouts.get(int(lengths[0]))
            if layouts:
                fits, part = layouts[0].decode(payloads)
                if fits.all():
                    return part

        decoded = Decoded.empty(len(payloads), self.names.width(self.kind))
        order = np.argsort(lengths, kind="stable")
        changes = np.flatnonzero(np.diff(lengths[order])) + 1
        for rows in np.split(order, changes):
            if len(rows):
                self._of_one_length(payloads, rows, decoded)
        return decoded

    def _of_one_length(self, payloads: Payloads, rows: Rows, out: Decoded) -> None:
        """Decode payloads by known layouts, then by those that are met on the way."""

        def without_fitting(layout: Layout, rows: Rows) -> Rows:
            """Decode the payloads that fit a layout; returns those that do not."""
            fits, part = layout.decode(payloads.take(rows))
            out.put(rows[fits], part)
            return rows[~fits]

        length = int(payloads.lengths[rows[0]])
        layouts = list(self._layouts.get(length, ()))
        for layout in layouts:
            rows = without_fitting(layout, rows)
        while len(rows):
            first = rows[:1]
            rows = rows[1:]
            with suppress(ValueError):  # it is damaged
                data = next(iter(payloads.take(first)))
                layout = Layout.of(data, self.kind, self.names, ros1=self.ros1)
                without_fitting(layout, first)
                if len(layouts) < self.rounds:
                    rows = without_fitting(layout, rows)
                    layouts.append(layout)
                    if sum(map(len, self._layouts.values())) < self.most:
                        self._layouts[length] = layouts
