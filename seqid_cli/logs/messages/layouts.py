"""CDR messages of one layout, decoded together by position.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is parsed field
by field into a `Layout`: which bytes carry structure (lengths, names) and where the numbers lie.
All messages of its length with the same structure are decoded as strided views. What fits no layout
is parsed by itself; the result is the same either way.

Rows are cut into words of 8 bytes, counted from the end of the message: messages that end in
doubles come to lie aligned in this way.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.messages.batch import Bytes, Decoded, Payloads
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Mask, Stamps

Words = NDArray[np.uint64]

WORD = 8
STAMP = 4  # byte at which seconds (int32) and nanoseconds (uint32) stand
_SEC = 1_000_000_000


class Layout(NamedTuple):
    """Where structure and numbers of a message of L bytes lie.

    `mask` (L,) is 0xFF where messages must equal `reference` (L,); `columns` are pairs of column
    and byte at which its float64 begins; `order` is that of the bytes, "<" or ">".
    """

    reference: Bytes
    mask: Bytes
    columns: Sequence[tuple[int, int]]
    order: str


class _Run(NamedTuple):
    """Numbers side by side: `size` of them, from a byte of a row into columns from one on."""

    at: int
    column: int
    size: int


@dataclass(frozen=True)
class Form:
    """A layout made ready for messages of its length, in rows of `width` numbers.

    `mask` and `reference` (W,) are the words of the whole message, `pad` bytes in front of it
    included; the `checked` ones hold structure.
    """

    order: str
    width: int
    pad: int
    mask: Words
    reference: Words
    checked: tuple[int, ...]
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

    def fits(self, payloads: Payloads) -> Mask:
        """Tell which payloads of the layout's length have its structure, (M,)."""
        words = self._rows(payloads).view(np.uint64)
        return np.asarray(~((words ^ self.reference) & self.mask).any(axis=1))

    def decode(self, payloads: Payloads) -> Decoded | None:
        """Decode payloads of one length; None where one of them does not fit."""
        rows = self._rows(payloads)
        words = rows.view(np.uint64)
        for i in self.checked:
            if ((words[:, i] ^ self.reference[i]) & self.mask[i]).any():
                return None
        values = np.empty((len(payloads), self.width))
        if sum(run.size for run in self.runs) < self.width:
            values.fill(np.nan)
        for run in self.runs:
            target = values[:, run.column : run.column + run.size]
            target[:] = rows[:, run.at : run.at + WORD * run.size].view(f"{self.order}f8")
        stamps, good = self._stamps(rows[:, self.pad + STAMP :])
        return Decoded(stamps, values, good)

    def _rows(self, payloads: Payloads) -> Bytes:
        """Copy the messages side by side, (M, 8 W)."""
        return payloads.cut(-self.pad, WORD * len(self.mask) - self.pad)

    def _stamps(self, rows: Bytes) -> tuple[Stamps, Mask]:
        seconds = rows[:, :4].view(f"{self.order}i4")[:, 0]
        rest = rows[:, 4:8].view(f"{self.order}u4")[:, 0]
        stamps: Stamps = seconds.astype(np.int64)
        stamps *= _SEC
        stamps += rest
        good = np.ones(len(rows), np.bool_)
        limit = STAMP_LIMIT_NS // _SEC
        if not (rest.max() < _SEC and -limit <= seconds.min() and seconds.max() < limit):
            good = (rest < _SEC) & (seconds >= -limit) & (seconds < limit)
            stamps[~good] = 0
        return stamps, good


@dataclass
class LayoutDecoder:
    """Decodes batches; remembers the layouts that it has met.

    `parse`: from a payload to its layout; raises ValueError or struct.error where it is damaged.
    `width`: numbers per row. `rounds`: layouts of one length that are decoded together; what
    remains goes one by one. `most`: layouts remembered.
    """

    parse: Callable[[bytes], Layout]
    width: int
    rounds: int = 32
    most: int = 512
    _known: dict[int, list[Form]] = field(default_factory=dict)
    _count: int = 0

    def __call__(self, payloads: Payloads) -> Decoded:
        """Decode one batch."""
        lengths = payloads.lengths
        if len(lengths) and (lengths == lengths[0]).all():
            form = self._form(payloads.take(slice(1)), 0)
            whole = None if form is None else form.decode(payloads)
            if whole is not None:
                return whole
        out = Decoded.empty(len(payloads), self.width)
        order = np.argsort(lengths, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
            self._in_turn(payloads, rows, out)
        return out

    def _in_turn(self, payloads: Payloads, left: NDArray[np.intp], out: Decoded) -> None:
        """Decode payloads of one length and several layouts, one layout after the other."""
        rounds = 0
        while len(left):
            rounds += 1
            form = self._form(payloads.take(left[:1]), rounds)
            alike = np.arange(len(left)) == 0
            if form is not None:
                if rounds <= self.rounds:
                    alike = form.fits(payloads.take(left))
                part = form.decode(payloads.take(left[alike]))
                if part is not None:
                    out.put(left[alike], part)
            left = left[~alike]

    def _form(self, first: Payloads, rounds: int) -> Form | None:
        """Find or make the layout of one payload; None where it has none."""
        length = int(first.lengths[0])
        for known in self._known.get(length, ())[: self.rounds]:
            if known.fits(first)[0]:
                return known
        try:
            made = Form.of(self.parse(next(iter(first))), self.width)
        except (ValueError, struct.error):
            return None
        if rounds <= self.rounds and self._count < self.most:
            self._known.setdefault(length, []).append(made)
            self._count += 1
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
