"""Where structure and numbers of a message lie.

Consecutive messages of a topic differ in their stamp and numbers only. One of them is parsed field
by field into a `Layout`: which bits carry structure (lengths, counts, names, tags) and where the
numbers lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.logs.payloads import Bytes

VARINT = "varint"  # form of a number in protobuf's variable length; all others are numpy's


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
