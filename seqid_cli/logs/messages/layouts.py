"""CDR messages of one layout, decoded together by position.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is parsed field
by field into a `Layout`: which bytes carry structure (lengths, names) and where the numbers lie.
All messages of its length with the same structure are decoded as strided views. What fits no layout
is parsed by itself; the result is the same either way.

Rows are cut into words of 8 bytes, counted from the end of the message: messages that end in
doubles come to lie aligned in this way. Only the pieces of a message that carry structure or wanted
numbers are copied out of the buffer.
"""

import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.messages.batch import Bytes, Decoded, Payloads
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Stamps

Words = NDArray[np.uint64]

WORD = 8
JOIN = 16  # words of no interest that are rather copied than left out
ALONE = 4  # words of structure that make a piece of their own
STAMP = 4  # byte at which seconds (int32) and nanoseconds (uint32) stand
_SEC = 1_000_000_000
_NATIVE = "<" if sys.byteorder == "little" else ">"


class Layout(NamedTuple):
    """Where structure and numbers of a message of L bytes lie.

    `mask` (L,) is 0xFF where messages must equal `reference` (L,); `columns` are pairs of column
    and byte at which its float64 begins; `order` is that of the bytes, "<" or ">".
    """

    reference: Bytes
    mask: Bytes
    columns: Sequence[tuple[int, int]]
    order: str


class _Piece(NamedTuple):
    """Words [first, last) of a message; the `checked` ones have structural bits.

    `plain` pieces hold structure and padding, but no numbers.
    """

    first: int
    last: int
    reference: Words
    mask: Words
    checked: tuple[int, ...]
    plain: bool

    def same(self, rows: Bytes) -> bool:
        """Tell whether all rows (M, 8 W) share the structure, given that the first row has it."""
        words = rows.view(np.uint64)
        if self.plain:
            flat, width = words.ravel(), words.shape[1]
            if not (flat[width:] != flat[:-width]).any():
                return True
        columns = ((words[:, i] ^ self.reference[i]) & self.mask[i] for i in self.checked)
        return not any(column.any() for column in columns)


class _Run(NamedTuple):
    """Numbers side by side: `size` of them, from a byte of a piece into columns from one on."""

    piece: int
    at: int
    column: int
    size: int


@dataclass(frozen=True)
class Form:
    """A layout made ready for messages of its length, in rows of `width` numbers.

    `mask` and `reference` (W,) are the words of the whole message, `pad` bytes in front of it
    included.
    """

    order: str
    width: int
    pad: int
    mask: Words
    reference: Words
    pieces: tuple[_Piece, ...]
    runs: tuple[_Run, ...]
    stamp: tuple[int, int]  # piece, byte in it

    @classmethod
    def of(cls, layout: Layout, width: int) -> "Form":
        """Prepare a layout."""
        pad = -len(layout.mask) % WORD
        front = np.zeros(pad, np.uint8)
        mask = np.concatenate([front, layout.mask]).view(np.uint64)
        reference = np.concatenate([front, layout.reference]).view(np.uint64) & mask
        runs = [_Run(-1, STAMP, -1, 1), *_runs_of(sorted(layout.columns))]
        numbers = np.zeros(len(mask), np.bool_)
        for run in runs:
            first = run.at + pad
            numbers[first // WORD : -(-(first + WORD * run.size) // WORD)] = True
        pieces = tuple(
            _piece(first, last, reference, mask, numbers)
            for first, last in _cuts(mask != 0, numbers)
        )
        placed = [_placed(run, pieces, pad) for run in runs]
        stamp = placed[0].piece, placed[0].at
        return cls(layout.order, width, pad, mask, reference, pieces, tuple(placed[1:]), stamp)

    def fits(self, payloads: Payloads) -> Mask:
        """Tell which payloads of the layout's length have its structure, (M,)."""
        words = payloads.cut(-self.pad, WORD * len(self.mask) - self.pad).view(np.uint64)
        return np.asarray(~((words ^ self.reference) & self.mask).any(axis=1))

    def decode(self, payloads: Payloads) -> Decoded | None:
        """Decode payloads of one length, the first of which fits; None where not all do."""
        parts = []
        for piece in self.pieces:
            rows = payloads.cut(WORD * piece.first - self.pad, WORD * piece.last - self.pad)
            if not piece.same(rows):
                return None
            parts.append(rows)
        values = np.empty((len(payloads), self.width))
        if sum(run.size for run in self.runs) < self.width:
            values.fill(np.nan)
        for run in self.runs:
            self._fill(values[:, run.column : run.column + run.size], parts[run.piece], run)
        stamps, good = self._stamps(parts[self.stamp[0]])
        return Decoded(stamps, values, good)

    def _fill(self, target: Array, rows: Bytes, run: _Run) -> None:
        numbers = rows[:, run.at : run.at + WORD * run.size]
        if self.order == _NATIVE:  # one copy per row
            form = f"V{WORD * run.size}"
            target.view(form)[:, 0] = numbers.view(form)[:, 0]
        else:
            target[:] = numbers.view(f"{self.order}f8")

    def _stamps(self, rows: Bytes) -> tuple[Stamps, Mask]:
        at = self.stamp[1]
        seconds = rows[:, at : at + 4].view(f"{self.order}i4")[:, 0]
        rest = rows[:, at + 4 : at + 8].view(f"{self.order}u4")[:, 0]
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


def _runs_of(columns: Sequence[tuple[int, int]]) -> list[_Run]:
    """Join neighbouring columns whose numbers are neighbours as well."""
    found: list[_Run] = []
    for column, at in columns:
        last = found[-1] if found else None
        if last and (column, at) == (last.column + last.size, last.at + WORD * last.size):
            found[-1] = last._replace(size=last.size + 1)
        else:
            found.append(_Run(-1, at, column, 1))
    return found


def _placed(run: _Run, pieces: Sequence[_Piece], pad: int) -> _Run:
    """Say of a run in which piece it lies, and where in it."""
    word = (run.at + pad) // WORD
    i = next(i for i, piece in enumerate(pieces) if piece.first <= word < piece.last)
    return run._replace(piece=i, at=run.at + pad - WORD * pieces[i].first)


def _piece(first: int, last: int, reference: Words, mask: Words, numbers: Mask) -> _Piece:
    own = mask[first:last]
    checked = tuple(np.flatnonzero(own).tolist())
    return _Piece(first, last, reference[first:last], own, checked, not numbers[first:last].any())


def _cuts(structure: Mask, numbers: Mask) -> list[tuple[int, int]]:
    """Choose the pieces: long runs of mere structure alone, the rest together where it is near."""
    alone = [run for run in _spans(structure & ~numbers, 0) if run[1] - run[0] >= ALONE]
    rest = structure | numbers
    joined: list[tuple[int, int]] = []
    low = 0
    for first, last in [*alone, (len(rest), len(rest))]:
        joined += [(low + a, low + b) for a, b in _spans(rest[low:first], JOIN)]
        low = last
    return sorted(alone + joined)


def _spans(chosen: Mask, join: int) -> list[tuple[int, int]]:
    """Find runs of chosen words; those at most `join` words apart are one."""
    found: list[tuple[int, int]] = []
    for word in np.flatnonzero(chosen).tolist():
        if found and word - found[-1][1] <= join:
            found[-1] = (found[-1][0], word + 1)
        else:
            found.append((word, word + 1))
    return found
