"""Protobuf messages of one wire layout, decoded by position.

One message is parsed as `protobuf` does, but with numbers that remember where they stand. What the
per-message decoder makes of them then says which column comes from where; `layouts` does the rest.
Lengths and field numbers are structure, as is text; of a variable-length integer only how many
bytes it takes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from mcap.records import Schema

from seqid_cli.logs.decoding import Decode
from seqid_cli.logs.layout_decoder import LayoutDecoder
from seqid_cli.logs.layouts import (
    VARINT,
    Layout,
    NoLayoutError,
    Number,
    Place,
    make_layout,
)
from seqid_cli.logs.payloads import Bytes
from seqid_cli.logs.protobuf import (
    BYTES,
    BYTES_FIELD,
    DEPTH,
    FIXED32,
    FIXED64,
    FORMATS,
    MESSAGE,
    STRING,
    WIRE_VARINT,
    ZIGZAG,
    Field,
    Types,
    default,
    read_types,
    varint,
)

Row = Callable[[object], Sequence[float]]
Stamp = Callable[[object], tuple[object, object]]
_FREE, _SIZE_ONLY = 0x00, 0x80  # masks of what may differ; the top bit says that bytes follow
_SIZES = {FIXED64: 8, FIXED32: 4}


class _Float(float):
    """A number of the message, with its place."""

    place: Place


class _Int(int):
    """An integer of the message, with its place; good for stamps only."""

    place: Place

    def __float__(self) -> float:
        raise NoLayoutError("a channel is logged as integers")


def decoder(schema: Schema, row: Row, stamp: Stamp, width: int, single: Decode) -> Decode:
    """Decode messages alike together.

    Parameters
    ----------
    schema : Schema
        With the descriptors.
    row : callable
        From a message to its row of numbers; it passes floats on as they are.
    stamp : callable
        From a message to seconds and nanoseconds.
    width : int
        Numbers per row.
    single : callable
        Decodes what has no fixed layout.
    """
    types = read_types(schema)
    if types is None:
        return single
    root = "." + schema.name

    def parse(data: bytes) -> Layout:
        return _parse(data, root, types, row, stamp)

    return LayoutDecoder(parse, width, single)


def _parse(data: bytes, root: str, types: Types, row: Row, stamp: Stamp) -> Layout:
    mask = np.full(len(data), 0xFF, np.uint8)
    message = _Reader(data, types, mask).message(0, len(data), root, 0)
    columns: list[tuple[int, Number]] = []
    try:
        numbers, (whole, rest) = row(message), stamp(message)
    except Exception as error:  # whatever is wrong with it, the other decoder says so
        raise NoLayoutError from error
    for column, value in enumerate(numbers):
        if isinstance(value, _Float):
            columns.append((column, value.place))
        elif value == value:  # NaN is what a column without a number has anyway
            columns.append((column, value))
    if isinstance(whole, _Float):
        return make_layout(data, mask, columns, (whole.place, 0), seconds_are_float=True)
    return make_layout(data, mask, columns, (_integer(whole), _integer(rest)))


def _integer(value: object) -> Number:
    if isinstance(value, _Int):
        return value.place
    if value == 0 and isinstance(value, int):
        return 0
    raise NoLayoutError("no stamp")


class _Reader:
    """Reads one message; notes in `mask` which bits may differ between messages alike."""

    def __init__(self, data: bytes, types: Types, mask: Bytes) -> None:
        self.data, self.types, self.mask = data, types, mask

    def message(self, start: int, end: int, type_name: str, depth: int) -> dict[str, object]:
        """Read a message like `protobuf.read_message`."""
        if depth > DEPTH:
            raise NoLayoutError("nested too deeply")
        fields = self.types.get(type_name, {})
        message: dict[str, object] = {field.name: default(field) for field in fields.values()}
        for number, wire, first, last in self._spans(start, end):
            field = fields.get(number)
            if field is None:
                self.mask[first:last] = _SIZE_ONLY if wire == WIRE_VARINT else _FREE
                continue
            values = self._values(field, wire, first, last, depth)
            held = message[field.name]
            if isinstance(held, list):
                held.extend(values)
            elif values:
                message[field.name] = values[-1]
        return message

    def _spans(self, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
        """Yield number and wire type of each field, and where its value lies."""
        data, at = self.data[:end], start
        while at < end:
            tag, at = varint(data, at)
            wire = tag & 7
            if wire == WIRE_VARINT:
                last = varint(data, at)[1]
            elif wire == BYTES:
                length, at = varint(data, at)
                last = at + length
            elif wire in _SIZES:
                last = at + _SIZES[wire]
            else:
                raise NoLayoutError("an unknown wire type")
            if last > end:
                raise NoLayoutError("the message breaks off")
            yield tag >> 3, wire, at, last
            at = last

    def _values(
        self, field: Field, wire: int, first: int, last: int, depth: int
    ) -> Sequence[object]:
        if field.kind in (MESSAGE, STRING, BYTES_FIELD):
            if wire != BYTES:
                raise NoLayoutError("a number where none is declared")
            if field.kind == MESSAGE:
                return [self.message(first, last, field.type_name, depth + 1)]
            if field.kind == STRING:
                return [self.data[first:last].decode("utf-8")]
            self.mask[first:last] = _FREE
            return [b""]
        form = FORMATS.get(field.kind)
        if form is not None:
            return self._fixed(form, wire, first, last)
        if wire != WIRE_VARINT or field.kind in ZIGZAG:
            raise NoLayoutError("a list of integers")
        self.mask[first:last] = _SIZE_ONLY
        value = varint(self.data, first)[0]
        return [_placed_int(value, Place(first, VARINT, last - first))]

    def _fixed(self, form: str, wire: int, first: int, last: int) -> Sequence[object]:
        size = struct.calcsize(form)
        if wire == WIRE_VARINT or (last - first) % size or (wire != BYTES and last - first != size):
            raise NoLayoutError("not the declared size")
        self.mask[first:last] = _FREE
        dtype = np.dtype(form)
        make = _placed_float if dtype.kind == "f" else _placed_int
        return [
            make(struct.unpack_from(form, self.data, at)[0], Place(at, dtype.str, size))
            for at in range(first, last, size)
        ]


def _placed_float(value: float, place: Place) -> _Float:
    number = _Float(value)
    number.place = place
    return number


def _placed_int(value: float, place: Place) -> _Int:
    number = _Int(value)
    number.place = place
    return number
