"""Messages of one layout compared and decoded together, in as few passes as their form allows.

Rows are cut into words of 8 bytes, counted from the end of the message: CDR messages that end in
doubles come to lie aligned in this way. Only the pieces of a message that carry structure or wanted
numbers are copied out of the buffer.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.decoding import Decoded
from seqid_cli.logs.layouts import VARINT, Block, Layout, Number, Place
from seqid_cli.logs.payloads import Bytes, Payloads
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Stamps

Words = NDArray[np.uint64]
Integers = NDArray[np.int64]

WORD = 8
_JOIN = 16  # words of no interest that are rather copied than left out
_ALONE = 4  # words of structure that make a piece of their own
_TOGETHER = 512  # words that one step of a reduction takes
_SEC = 1_000_000_000
_NATIVE = "<f8" if sys.byteorder == "little" else ">f8"


class Piece(NamedTuple):
    """Words [first, last) of a message; `reference` and `mask` (last - first,) are its structure.

    `plain` pieces hold structure and padding, but no numbers; of the others `checked` words have
    structural bits.
    """

    first: int
    last: int
    reference: Words
    mask: Words
    checked: tuple[int, ...]
    plain: bool

    def same(self, rows: Bytes) -> bool:
        """Tell whether all rows (M, 8 W) share the structure, given that the first row has it."""
        if not self.checked:
            return True
        words = rows.view(np.uint64)
        if self.plain and self._equal(words):
            return True
        if len(self.checked) > _ALONE:
            return self._masked(words)
        columns = ((words[:, i] ^ self.reference[i]) & self.mask[i] for i in self.checked)
        return not any(column.any() for column in columns)

    @staticmethod
    def _equal(words: Words) -> bool:
        flat, width = words.ravel(), words.shape[1]
        return not (flat[width:] != flat[:-width]).any()

    def _masked(self, words: Words) -> bool:
        """Compare the bits that all rows have with those that any has."""
        count, width = words.shape
        many = max(1, _TOGETHER // width)
        even = count - count % many
        some, every = words[even:], words[even:]
        if even:
            folded = words[:even].reshape(-1, many * width)
            some = np.vstack([some, np.bitwise_or.reduce(folded, axis=0).reshape(many, width)])
            every = np.vstack([every, np.bitwise_and.reduce(folded, axis=0).reshape(many, width)])
        different = np.bitwise_or.reduce(some, axis=0) ^ np.bitwise_and.reduce(every, axis=0)
        return not (different & self.mask).any()


@dataclass(frozen=True)
class Form:
    """A layout made ready for messages of its length.

    `mask` and `reference` (W,) are the words of the whole message, `pad` bytes in front of it
    included; `width` numbers make a row of values.
    """

    layout: Layout
    width: int
    pad: int
    mask: Words
    reference: Words
    pieces: tuple[Piece, ...]
    spans: tuple[tuple[int, int], ...]  # words with structure, for the comparison row by row
    partly: bool  # some columns get no number

    @classmethod
    def of(cls, layout: Layout, width: int) -> Form:
        """Prepare a layout for rows of `width` numbers."""
        pad = -len(layout.mask) % WORD
        front = np.zeros(pad, np.uint8)
        mask = np.concatenate([front, layout.mask]).view(np.uint64)
        reference = np.concatenate([front, layout.reference]).view(np.uint64) & mask
        filled = sum(block.count for block in layout.blocks) + len(layout.constants)
        numbers = _number_words(layout, pad, len(mask))
        pieces = tuple(
            _piece(first, last, reference, mask, numbers)
            for first, last in _cuts(mask != 0, numbers)
        )
        spans = tuple(_runs(mask != 0, _JOIN))
        return cls(layout, width, pad, mask, reference, pieces, spans, filled < width)

    def starts(self, row: Bytes) -> bool:
        """Tell whether one row (8 W,) has the structure."""
        return not ((row.view(np.uint64) ^ self.reference) & self.mask).any()

    def fits(self, rows: Bytes) -> Mask:
        """Tell which rows (M, 8 W) have the structure."""
        words = rows.view(np.uint64)
        alike = np.ones(len(words), np.bool_)
        for first, last in self.spans:
            different = words[:, first:last] ^ self.reference[first:last]
            different &= self.mask[first:last]
            if different.any():
                alike &= ~different.any(axis=1)
        return alike

    def decode_all(self, payloads: Payloads) -> Decoded | None:
        """Decode payloads of one length, the first of which fits; None where not all are alike."""
        parts = []
        for piece in self.pieces:
            low, high = WORD * piece.first - self.pad, WORD * piece.last - self.pad
            rows = payloads.cut(low, high)
            if not piece.same(rows):
                return None
            parts.append(rows)
        return self._decode(parts)

    def decode(self, rows: Bytes) -> Decoded:
        """Decode rows (M, 8 W) that share the structure."""
        return self._decode([rows[:, WORD * p.first : WORD * p.last] for p in self.pieces])

    def _decode(self, parts: Sequence[Bytes]) -> Decoded:
        count = len(parts[0])
        values = np.empty((count, self.width))
        if self.partly:
            values.fill(np.nan)
        for block in self.layout.blocks:
            rows, at = self._part(parts, block.at)
            _fill(values[:, block.column : block.column + block.count], rows, at, block)
        for column, value in self.layout.constants:
            values[:, column] = value
        stamps, good = self._stamps(parts, count)
        return Decoded(stamps, values, good)

    def _part(self, parts: Sequence[Bytes], at: int) -> tuple[Bytes, int]:
        """Find the piece that a byte of the message lies in, and where in it."""
        word = (at + self.pad) // WORD
        i = next(i for i, piece in enumerate(self.pieces) if piece.first <= word < piece.last)
        return parts[i], at + self.pad - WORD * self.pieces[i].first

    def _stamps(self, parts: Sequence[Bytes], count: int) -> tuple[Stamps, Mask]:
        numbers = [self._single(parts, number, count) for number in self.layout.stamp]
        if self.layout.seconds_are_float:
            seconds = numbers[0].astype(np.float64)
            good = np.abs(seconds) <= STAMP_LIMIT_NS / _SEC  # False for NaN
            return np.rint(np.where(good, seconds, 0.0) * _SEC).astype(np.int64), good
        limit = STAMP_LIMIT_NS // _SEC
        sound = _within(numbers[0], -limit, limit) and _within(numbers[1], 0, _SEC)
        whole, rest = (each.astype(np.int64) for each in numbers)
        good = np.ones(count, np.bool_)
        if not sound:
            good = (whole >= -limit) & (whole < limit) & (rest >= 0) & (rest < _SEC)
            whole, rest = np.where(good, whole, 0), np.where(good, rest, 0)
        whole *= _SEC
        whole += rest
        return whole, good

    def _single(self, parts: Sequence[Bytes], number: Number, count: int) -> NDArray[np.generic]:
        if not isinstance(number, Place):
            return np.full(count, number)
        rows, at = self._part(parts, number.at)
        digits = rows[:, at : at + number.size]
        return _varints(digits) if number.form == VARINT else digits.view(number.form)[:, 0]


def _number_words(layout: Layout, pad: int, count: int) -> Mask:
    """Tell which words hold numbers."""
    held = np.zeros(count, np.bool_)
    for block in layout.blocks:
        span = block.stride * (block.count - 1) + block.size  # a block stays in one piece
        at = block.at + pad
        held[at // WORD : -(-(at + span) // WORD)] = True
    for number in layout.stamp:
        if isinstance(number, Place):
            at = number.at + pad
            held[at // WORD : -(-(at + number.size) // WORD)] = True
    return held


def _cuts(structure: Mask, numbers: Mask) -> list[tuple[int, int]]:
    """Choose the pieces: long runs of mere structure alone, the rest together where it is near."""
    alone = [
        (first, last) for first, last in _runs(structure & ~numbers, 0) if last - first >= _ALONE
    ]
    rest = structure | numbers
    for first, last in alone:
        rest[first:last] = False
    joined = []
    bounds = [0, *(edge for run in alone for edge in run), len(rest)]
    for low, high in zip(bounds[::2], bounds[1::2], strict=True):
        joined += [(low + a, low + b) for a, b in _runs(rest[low:high], _JOIN)]
    return sorted(alone + joined)


def _runs(chosen: Mask, join: int) -> list[tuple[int, int]]:
    """Find runs of chosen words; those at most `join` words apart are one."""
    found: list[tuple[int, int]] = []
    for word in np.flatnonzero(chosen).tolist():
        if found and word - found[-1][1] <= join:
            found[-1] = (found[-1][0], word + 1)
        else:
            found.append((word, word + 1))
    return found


def _piece(first: int, last: int, reference: Words, mask: Words, numbers: Mask) -> Piece:
    own = mask[first:last]
    checked = tuple(np.flatnonzero(own).tolist())
    return Piece(first, last, reference[first:last], own, checked, not numbers[first:last].any())


def _fill(target: Array, rows: Bytes, at: int, block: Block) -> None:
    """Put the numbers of a block, which begin at a byte of the rows, into a part of the values."""
    span = block.stride * (block.count - 1) + block.size
    piece = rows[:, at : at + span]
    if block.form == VARINT:
        target[:, 0] = _varints(piece)
    elif block.form == _NATIVE and (block.count == 1 or block.stride == block.size):
        form = f"V{span}"  # one copy per row
        target.view(form)[:, 0] = piece.view(form)[:, 0]
    elif block.count == 1 or block.stride == block.size:
        target[:] = piece.view(block.form)
    else:
        shape, strides = target.shape, (rows.strides[0], block.stride)
        first = piece[:, : block.size].view(block.form)
        target[:] = np.lib.stride_tricks.as_strided(first, shape, strides)


def _varints(digits: Bytes) -> Integers:
    """Decode variable-length integers of the same number of bytes (M, k)."""
    value = np.zeros(len(digits), np.uint64)
    for i in range(digits.shape[1]):
        value |= (digits[:, i] & 0x7F).astype(np.uint64) << np.uint64(7 * i)
    return value.view(np.int64)


def _within(numbers: NDArray[Any], low: int, high: int) -> bool:
    """Tell whether all numbers lie in [low, high); the form alone may tell."""
    form = np.iinfo(numbers.dtype)
    return bool(
        (form.min >= low or numbers.min() >= low) and (form.max < high or numbers.max() < high)
    )
