"""Ways to damage the headers of a Parquet file: its footer, and those of its pages.

A header is a tree of Thrift's compact protocol. It is decoded, one of its fields
becomes another, and it is written again with its right length: bytes at random seldom
get past the first check.

Sources: the formats' specifications,
https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift and
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

import copy
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

_BYTES, _LIST, _STRUCT = 8, 9, 12
_INTEGERS = (4, 5, 6)
_ODD_NUMBERS = (0, 1, -1, 2, 3, 7, 127, 2**15, 2**31 - 1, -(2**31), 2**40, 2**63 - 1)
_LONGEST_PAGE_HEADER = 4096  # bytes; statistics are the longest part
_TAIL = struct.Struct("<I4s")


@dataclass
class Value:
    """A value with its kind: a number, bytes, a list, or fields by number."""

    kind: int
    content: Any
    of: int = 0  # kind of a list's items


def decoded(data: bytes, at: int = 0) -> tuple[Value, int]:  # value, where it ends
    """Decode a structure."""
    fields: dict[int, Value] = {}
    number = 0
    while data[at]:
        head = data[at]
        at += 1
        if head >> 4:
            number += head >> 4
        else:
            number, at = _integer(data, at)
        fields[number], at = _decoded_value(data, at, head & 15)
    return Value(_STRUCT, fields), at + 1


def _decoded_value(data: bytes, at: int, kind: int) -> tuple[Value, int]:
    if kind in (1, 2):
        return Value(kind, None), at
    if kind in _INTEGERS:
        number, at = _integer(data, at)
        return Value(kind, number), at
    if kind == _STRUCT:
        return decoded(data, at)
    if kind == _LIST:
        return _decoded_list(data, at)
    size = {3: 1, 7: 8}.get(kind)
    if size is None:
        size, at = _unsigned(data, at)
    return Value(kind, data[at : at + size]), at + size


def _decoded_list(data: bytes, at: int) -> tuple[Value, int]:
    head = data[at]
    length, at = (head >> 4, at + 1) if head >> 4 < 15 else _unsigned(data, at + 1)
    items = []
    for _ in range(length):
        if head & 15 in (1, 2):  # in a list a truth value has a byte of its own
            item, at = Value(3, data[at : at + 1]), at + 1
        else:
            item, at = _decoded_value(data, at, head & 15)
        items.append(item)
    return Value(_LIST, items, head & 15), at


def encoded(value: Value) -> bytes:
    """Encode a value; the reverse of `decoded`."""
    if value.kind in (1, 2):
        return b""
    if value.kind in _INTEGERS:
        return _written((value.content << 1) ^ (value.content >> 63))
    if value.kind == _LIST:
        items = b"".join(map(encoded, value.content))
        length = len(value.content)
        if length < 15:
            return bytes([length << 4 | value.of]) + items
        return bytes([0xF0 | value.of]) + _written(length) + items
    if value.kind == _STRUCT:
        return _encoded_fields(value.content)
    size = b"" if value.kind in (3, 7) else _written(len(value.content))
    return size + bytes(value.content)


def _encoded_fields(fields: dict[int, Value]) -> bytes:
    parts, before = [], 0
    for number in sorted(fields):
        kind, step = fields[number].kind, number - before
        if 0 < step < 16:
            parts.append(bytes([step << 4 | kind]))
        else:
            parts.append(bytes([kind]) + _written(number << 1))
        parts.append(encoded(fields[number]))
        before = number
    return b"".join(parts) + b"\0"


def _unsigned(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at


def _integer(data: bytes, at: int) -> tuple[int, int]:
    value, at = _unsigned(data, at)
    return (value >> 1) ^ -(value & 1), at


def _written(value: int) -> bytes:
    digits = bytearray()
    value &= 2**64 - 1
    while value > 127:
        digits.append(value & 127 | 128)
        value >>= 7
    return bytes([*digits, value])


def _spots(value: Value) -> Iterator[tuple[Any, Any]]:  # holder, key
    """Yield every value with the list or the fields that hold it."""
    if value.kind not in (_LIST, _STRUCT):
        return
    holder = value.content
    for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
        yield holder, key
        yield from _spots(holder[key])


def _change(tree: Value, rng: np.random.Generator) -> None:
    """Make one value of a tree another."""
    spots = list(_spots(tree))
    holder, key = spots[int(rng.integers(len(spots)))]
    value = holder[key]
    other_holder, other_key = spots[int(rng.integers(len(spots)))]
    match int(rng.integers(8)):
        case 0:
            del holder[key]
        case 1:
            holder[key] = copy.deepcopy(other_holder[other_key])
        case 2 if value.kind == _LIST and value.content:
            value.content *= int(rng.choice([2, 50]))
        case 2 | 3 if value.kind == _LIST:
            del value.content[int(rng.integers(len(value.content) + 1)) :]
        case 4 if value.kind == _STRUCT:
            value.content[int(rng.integers(1, 18))] = copy.deepcopy(
                other_holder[other_key]
            )
        case _ if value.kind in _INTEGERS:
            odd = int(rng.choice(_ODD_NUMBERS))
            value.content = odd if rng.random() < 0.6 else value.content + odd
        case _ if value.kind == _BYTES:
            value.content = rng.bytes(int(rng.choice([0, 1, 4, 8, 300])))
        case _:
            holder[key] = copy.deepcopy(other_holder[other_key])


def footer(data: bytearray, rng: np.random.Generator) -> None:
    """Change one to three fields of a footer: schema, levels, sizes, statistics."""
    try:
        length, _ = _TAIL.unpack(data[-_TAIL.size :])
        start = len(data) - _TAIL.size - length
        tree, _ = decoded(bytes(data[start : -_TAIL.size]))
        for _ in range(int(rng.integers(1, 4))):
            _change(tree, rng)
        content = encoded(tree)
    except (AttributeError, LookupError, ValueError, TypeError, struct.error):
        return  # other damages have made it unreadable
    data[start:] = content + _TAIL.pack(len(content), b"PAR1")


def page(data: bytearray, rng: np.random.Generator) -> None:
    """Change the header of a page: its kind, sizes, counts, encodings, statistics.

    It is written in the same number of bytes, so that what follows stays in its place;
    where it does not fit, the bytes of the page's levels or values are changed.
    """
    try:
        length, _ = _TAIL.unpack(data[-_TAIL.size :])
        tree, _ = decoded(bytes(data[len(data) - _TAIL.size - length : -_TAIL.size]))
        groups = tree.content[4].content
        chunks = groups[int(rng.integers(len(groups)))].content[1].content
        meta = chunks[int(rng.integers(len(chunks)))].content[3].content
        at = meta[11 if 11 in meta and rng.random() < 0.4 else 9].content
        header, end = decoded(bytes(data[at : at + _LONGEST_PAGE_HEADER]))
        _change(header, rng)
        content = encoded(header)
    except (AttributeError, LookupError, ValueError, TypeError, struct.error):
        return
    if len(content) == end and rng.random() < 0.7:
        data[at : at + end] = content
    elif rng.random() < 0.5:
        # The header may take another length; offsets behind it are then wrong.
        data[at : at + end] = content
    else:
        for spot in rng.integers(at + end, at + end + 24, int(rng.integers(1, 5))):
            data[spot : spot + 1] = rng.bytes(1)
