"""Protobuf messages, decoded by the descriptors that an MCAP file carries.

Only what the wire format needs is implemented: the descriptor set says which field number is
called what, nothing is generated and no protobuf library is needed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mcap.records import Schema

WIRE_VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # on the wire
_DOUBLE, _FLOAT, STRING, MESSAGE, BYTES_FIELD = 1, 2, 9, 11, 12  # of fields
ZIGZAG = (17, 18)
_REPEATED = 3
FORMATS = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
DEPTH = 16

# Field numbers in google/protobuf/descriptor.proto.
_SET_FILE, _FILE_PACKAGE, _FILE_MESSAGE = 1, 2, 4
_TYPE_NAME, _TYPE_FIELD, _TYPE_NESTED = 1, 2, 3
_FIELD_NAME, _FIELD_NUMBER, _FIELD_LABEL, _FIELD_TYPE, _FIELD_TYPE_NAME = 1, 3, 4, 5, 6
_FIELD_OPTIONAL = 17


@dataclass(frozen=True)
class Field:
    """A field of a message type."""

    name: str
    kind: int
    repeated: bool
    type_name: str
    optional: bool = False  # absent means missing, not zero


Types = dict[str, dict[int, Field]]


def schema_parser(schema: Schema) -> Callable[[bytes], object] | None:
    """Make a decoder from a FileDescriptorSet; None where it is not usable.

    Returns
    -------
    callable
        From a payload to a dict by field name; it raises ValueError or struct.error on damage.
    """
    types = read_types(schema)
    if types is None:
        return None
    return lambda data: _read(data, "." + schema.name, types, 0)


def read_types(schema: Schema) -> Types | None:
    """Read the message types of a FileDescriptorSet; None where the schema's own is not there."""
    types: Types = {}
    try:
        for number, content in _fields(schema.data):
            if number == _SET_FILE:
                _read_file(_as_bytes(content), types)
    except (ValueError, struct.error):
        return None
    return types if "." + schema.name in types else None


def _read_file(data: bytes, types: Types) -> None:
    fields = list(_fields(data))
    package = "".join(_text(content) for number, content in fields if number == _FILE_PACKAGE)
    prefix = f".{package}" if package else ""
    for number, content in fields:
        if number == _FILE_MESSAGE:
            _read_type(_as_bytes(content), prefix, types, 0)


def _read_type(data: bytes, prefix: str, types: Types, depth: int) -> None:
    if depth > DEPTH:
        raise ValueError("nested too deeply")
    fields = list(_fields(data))
    name = prefix + "." + "".join(_text(value) for number, value in fields if number == _TYPE_NAME)
    types[name] = dict(_read_field(_as_bytes(v)) for number, v in fields if number == _TYPE_FIELD)
    for number, content in fields:
        if number == _TYPE_NESTED:
            _read_type(_as_bytes(content), name, types, depth + 1)


def _read_field(data: bytes) -> tuple[int, Field]:
    values = dict(_fields(data))
    number, kind = values.get(_FIELD_NUMBER), values.get(_FIELD_TYPE)
    if not isinstance(number, int) or not isinstance(kind, int):
        raise ValueError("a field without number or type")
    repeated = values.get(_FIELD_LABEL) == _REPEATED
    name = _text(values.get(_FIELD_NAME, b""))
    type_name = _text(values.get(_FIELD_TYPE_NAME, b""))
    return number, Field(name, kind, repeated, type_name, bool(values.get(_FIELD_OPTIONAL)))


def _read(data: bytes, type_name: str, types: Types, depth: int) -> dict[str, object]:
    if depth > DEPTH:
        raise ValueError("nested too deeply")
    fields = types.get(type_name, {})
    message: dict[str, object] = {field.name: default(field) for field in fields.values()}
    for number, content in _fields(data):
        field = fields.get(number)
        if field is None:
            continue
        values = _decode(field, content, types, depth)
        held = message[field.name]
        if isinstance(held, list):
            held.extend(values)
        else:
            message[field.name] = values[-1] if values else held
    return message


def default(field: Field) -> object:
    """Return what an absent field means (proto3)."""
    if field.repeated:
        return []
    if field.kind == MESSAGE or field.optional:
        return None
    if field.kind == STRING:
        return ""
    return 0.0 if field.kind in (_DOUBLE, _FLOAT) else 0


def _decode(field: Field, content: int | bytes, types: Types, depth: int) -> list[object]:
    if field.kind == MESSAGE:
        return [_read(_as_bytes(content), field.type_name, types, depth + 1)]
    if field.kind == STRING:
        return [_text(content)]
    if field.kind == BYTES_FIELD:
        return [_as_bytes(content)]
    form = FORMATS.get(field.kind)
    if isinstance(content, int):
        return [_signed(content, field.kind)]
    if form is not None:  # one fixed-size value, or a packed list of them
        return [value for (value,) in struct.iter_unpack(form, content)]
    return [_signed(value, field.kind) for value in _varints(content)]


def _signed(value: int, kind: int) -> int:
    """Read an unsigned number of 64 bits as the field means it."""
    if kind in ZIGZAG:
        return value >> 1 ^ -(value & 1)
    return value - (1 << 64) if value >> 63 else value


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield (field number, value): varints as int, all else as bytes."""
    at = 0
    while at < len(data):
        tag, at = varint(data, at)
        kind = tag & 7
        if kind == WIRE_VARINT:
            value, at = varint(data, at)
            yield tag >> 3, value
            continue
        length = {FIXED64: 8, FIXED32: 4}.get(kind, -1)
        if kind == BYTES:
            length, at = varint(data, at)
        if length < 0 or at + length > len(data):
            raise ValueError("the message breaks off")
        yield tag >> 3, data[at : at + length]
        at += length


def varint(data: bytes, at: int) -> tuple[int, int]:
    """Read a number of variable length; returns it and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & ((1 << 64) - 1), at
    raise ValueError("the number breaks off")


def _varints(data: bytes) -> Iterator[int]:
    at = 0
    while at < len(data):
        value, at = varint(data, at)
        yield value


def _as_bytes(content: int | bytes) -> bytes:
    if isinstance(content, int):
        raise ValueError("a number where a message is declared")
    return content


def _text(content: int | bytes) -> str:
    return _as_bytes(content).decode("utf-8")
