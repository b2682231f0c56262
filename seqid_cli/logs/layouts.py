"""Messages of one layout, decoded together by position.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is parsed field
by field into a `Layout`: which bits carry structure (lengths, counts, names, tags) and where the
numbers lie. All messages that have the same length and the same structural bits are then decoded
as strided views. What fits no layout is parsed by itself; the result is the same either way.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.decoding import Decode, Decoded
from seqid_cli.logs.payloads import Bytes, Payloads
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Rows, Stamps

Words = NDArray[np.uint64]
Integers = NDArray[np.int64]

VARINT = "varint"  # form of a number in protobuf's variable length; all others are numpy's
_ROUNDS = 32  # layouts of one length decoded together; what remains goes one by one
_KEPT = 512  # layouts remembered per decoder
_JOIN = 4  # structural words this near to each other are compared in one piece
_SEC = 1_000_000_000


@dataclass(frozen=True)
class Place:
    """Where a number lies: offset in the message, form (numpy's name or varint), bytes."""

    at: int
    form: str
    size: int


@dataclass(frozen=True)
class Block:
    """Numbers of one form that go from equally spaced places to neighbouring columns."""

    at: int
    form: str
    size: int
    stride: int
    column: int
    count: int


Number = Place | int | float


@dataclass(frozen=True)
class Layout:
    """Where structure and numbers of a message lie.

    `mask` (L,) has the bits set that a message must share with `reference` (L,).
    """

    reference: Bytes
    mask: Bytes
    blocks: tuple[Block, ...]
    constants: tuple[tuple[int, float], ...] = ()  # column, value
    stamp: tuple[Number, Number] = (0, 0)  # seconds and nanoseconds, or (ns, 0) in one number
    seconds_are_float: bool = False


Parse = Callable[[bytes], Layout]


class NoLayoutError(Exception):
    """The message is sound, but has no fixed places; decode it by itself."""


def make_layout(
    data: bytes,
    mask: Bytes,
    columns: Sequence[tuple[int, Number]],
    stamp: tuple[Number, Number],
    *,
    seconds_are_float: bool = False,
) -> Layout:
    """Make a layout of (column, place or value) pairs; neighbours are joined into blocks."""
    blocks: list[Block] = []
    constants = []
    for column, number in sorted(columns, key=lambda pair: pair[0]):
        if not isinstance(number, Place):
            constants.append((column, float(number)))
        elif not (blocks and _extended(blocks, column, number)):
            blocks.append(Block(number.at, number.form, number.size, 0, column, 1))
    reference = np.frombuffer(data, np.uint8)
    return Layout(reference, mask, tuple(blocks), tuple(constants), stamp, seconds_are_float)


def _extended(blocks: list[Block], column: int, place: Place) -> bool:
    """Append a place to the last block if it goes on there."""
    last = blocks[-1]
    stride = last.stride if last.count > 1 else place.at - last.at
    fits = (
        place.form == last.form != VARINT
        and column == last.column + last.count
        and place.at == last.at + stride * last.count
        and stride >= place.size
    )
    if fits:
        blocks[-1] = Block(last.at, last.form, last.size, stride, last.column, last.count + 1)
    return fits


@dataclass
class _Prepared:
    """A layout shifted to the end of rows of whole words."""

    layout: Layout
    pad: int
    spans: list[tuple[int, int, Words, Words]]  # from word, to word, reference, mask
    partly: bool  # some columns get no number

    @classmethod
    def of(cls, layout: Layout, width: int) -> _Prepared:
        pad = -len(layout.mask) % 8
        front = np.zeros(pad, np.uint8)
        mask = np.concatenate([front, layout.mask]).view(np.uint64)
        reference = np.concatenate([front, layout.reference]).view(np.uint64) & mask
        spans: list[list[int]] = []
        for word in np.flatnonzero(mask).tolist():
            if spans and word - spans[-1][1] <= _JOIN:
                spans[-1][1] = word + 1
            else:
                spans.append([word, word + 1])
        filled = sum(block.count for block in layout.blocks) + len(layout.constants)
        pieces = [(a, b, reference[a:b], mask[a:b]) for a, b in spans]
        return cls(layout, pad, pieces, filled < width)

    def fits(self, words: Words) -> Mask:
        """Tell which rows (M, W) share the structure."""
        alike = np.ones(len(words), np.bool_)
        for first, last, reference, mask in self.spans:
            different = words[:, first:last] ^ reference
            different &= mask
            if different.any():
                alike &= ~different.any(axis=1)
        return alike

    def decode(self, rows: Bytes, width: int) -> Decoded:
        """Decode rows that share the structure."""
        values = np.empty((len(rows), width))
        if self.partly:
            values.fill(np.nan)
        for block in self.layout.blocks:
            values[:, block.column : block.column + block.count] = _numbers(rows, block, self.pad)
        for column, value in self.layout.constants:
            values[:, column] = value
        stamps, good = self._stamps(rows)
        return Decoded(stamps, values, good)

    def _stamps(self, rows: Bytes) -> tuple[Stamps, Mask]:
        whole, rest = self.layout.stamp
        if self.layout.seconds_are_float:
            seconds = _single(rows, whole, self.pad).astype(np.float64)
            good = np.abs(seconds) <= STAMP_LIMIT_NS / _SEC  # False for NaN
            return np.rint(np.where(good, seconds, 0.0) * _SEC).astype(np.int64), good
        sec = _single(rows, whole, self.pad).astype(np.int64)
        nanosec = _single(rows, rest, self.pad).astype(np.int64)
        limit = STAMP_LIMIT_NS // _SEC
        good = (sec >= -limit) & (sec < limit) & (nanosec >= 0) & (nanosec < _SEC)
        if good.all():
            return sec * _SEC + nanosec, good
        return np.where(good, sec, 0) * _SEC + np.where(good, nanosec, 0), good


def _single(rows: Bytes, number: Number, pad: int) -> NDArray[np.generic]:
    if not isinstance(number, Place):
        return np.full(len(rows), number)
    block = Block(number.at, number.form, number.size, 0, 0, 1)
    return np.asarray(_numbers(rows, block, pad))[:, 0]


def _numbers(rows: Bytes, block: Block, pad: int) -> Array | Integers:
    """View or decode the numbers of a block, (M, count)."""
    at = block.at + pad
    if block.form == VARINT:
        return _varints(rows[:, at : at + block.size])[:, None]
    span = block.stride * (block.count - 1) + block.size
    piece = rows[:, at : at + span]
    if block.count == 1 or block.stride == block.size:
        return piece.view(block.form)
    shape = (len(rows), block.count)
    strides = (rows.strides[0], block.stride)
    return np.lib.stride_tricks.as_strided(piece[:, : block.size].view(block.form), shape, strides)


def _varints(digits: Bytes) -> Integers:
    """Decode variable-length integers of the same number of bytes (M, k)."""
    value = np.zeros(len(digits), np.uint64)
    for i in range(digits.shape[1]):
        value |= (digits[:, i] & 0x7F).astype(np.uint64) << np.uint64(7 * i)
    return value.view(np.int64)


@dataclass
class LayoutDecoder:
    """Decodes batches; remembers the layouts that it has met.

    `single` decodes messages without a fixed layout; without it they are refused.
    """

    parse: Parse
    width: int
    single: Decode | None = None
    _known: dict[int, list[_Prepared]] = field(default_factory=dict)
    _count: int = 0

    def __call__(self, batch: Sequence[bytes]) -> Decoded:
        """Decode one batch."""
        payloads = Payloads.of(batch)
        lengths = payloads.lengths
        if len(lengths) and (lengths == lengths[0]).all():
            return self._equal_length(payloads)
        out = Decoded.empty(len(payloads), self.width)
        order = np.argsort(lengths, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
            if len(rows):
                _put(out, rows, self._equal_length(payloads.take(rows)))
        return out

    def _equal_length(self, payloads: Payloads) -> Decoded:
        length = int(payloads.lengths[0])
        rows, pad = payloads.windows(length)
        whole = self._at_once(rows, pad, length)
        if whole is not None:
            return whole
        out = Decoded.empty(len(rows), self.width)
        left = np.arange(len(rows))
        alone: list[int] = []
        rounds = 0
        while len(left):
            rounds += 1
            known = self._layout(rows[left[0]], pad, length, rounds)
            alike = np.zeros(len(left), np.bool_)
            alike[0] = True
            if known is None:
                alone.append(int(left[0]))
            else:
                if rounds <= _ROUNDS:
                    alike = known.fits(rows[left].view(np.uint64))
                _put(out, left[alike], known.decode(rows[left[alike]], self.width))
            left = left[~alike]
        if alone and self.single is not None:
            each = np.array(alone)
            _put(out, each, self.single(payloads.take(each)))
        return out

    def _at_once(self, rows: Bytes, pad: int, length: int) -> Decoded | None:
        """Decode the rows if all of them have the layout of the first."""
        known = self._layout(rows[0], pad, length, 0)
        if known is None or not known.fits(rows.view(np.uint64)).all():
            return None
        return known.decode(rows, self.width)

    def _layout(self, row: Bytes, pad: int, length: int, rounds: int) -> _Prepared | None:
        """Find or make the layout of a row; None where it has none."""
        words = row[None].view(np.uint64)
        for known in self._known.get(length, ())[:_ROUNDS]:
            if known.fits(words)[0]:
                return known
        try:
            made = _Prepared.of(self.parse(row[pad:].tobytes()), self.width)
        except (ValueError, struct.error, NoLayoutError):
            return None
        if rounds <= _ROUNDS and self._count < _KEPT:
            self._known.setdefault(length, []).append(made)
            self._count += 1
        return made


def _put(out: Decoded, rows: Rows, part: Decoded) -> None:
    out.stamp_ns[rows] = part.stamp_ns
    out.values[rows] = part.values
    out.good[rows] = part.good
