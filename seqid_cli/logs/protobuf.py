"""Protobuf messages, decoded by the descriptors that an MCAP file carries.

Only what the wire format needs is implemented: the descriptor set says which field number is
called what, nothing is generated and no protobuf library is needed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mcap.records import Schema

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_DOUBLE, _FLOAT, _STRING, _MESSAGE = 1, 2, 9, 11
_REPEATED = 3
_FORMATS = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
_DEPTH = 16

# Field numbers in google/protobuf/descriptor.proto.
_SET_FILE, _FILE_PACKAGE, _FILE_MESSAGE = 1, 2, 4
_TYPE_NAME, _TYPE_FIELD, _TYPE_NESTED = 1, 2, 3
_FIELD_NAME, _FIELD_NUMBER, _FIELD_LABEL, _FIELD_TYPE, _FIELD_TYPE_NAME = 1, 3, 4, 5, 6


@dataclass(frozen=True)
class _Field:
    name: str
    kind: int
    repeated: bool
    type_name: str


_Types = dict[str, dict[int, _Field]]


def schema_parser(schema: Schema) -> Callable[[bytes], object] | None:
    """Make a decoder from a FileDescriptorSet; None where it is not usable.

    Returns
    -------
    callable
        From a payload to a dict by field name; it raises ValueError or struct.error on damage.
    """
    types: _Types = {}
    try:
        for number, content in _fields(schema.data):
            if number == _SET_FILE:
                _read_file(_as_bytes(content), types)
    except (ValueError, struct.error):
        return None
    root = "." + schema.name
    if root not in types:
        return None
    return lambda data: _read(data, root, types, 0)


def _read_file(data: bytes, types: _Types) -> None:
    fields = list(_fields(data))
    package = "".join(_text(content) for number, content in fields if number == _FILE_PACKAGE)
    prefix = f".{package}" if package else ""
    for number, content in fields:
        if number == _FILE_MESSAGE:
            _read_type(_as_bytes(content), prefix, types, 0)


def _read_type(data: bytes, prefix: str, types: _Types, depth: int) -> None:
    if depth > _DEPTH:
        raise ValueError("nested too deeply")
    fields = list(_fields(data))
    name = prefix + "." + "".join(_text(value) for number, value in fields if number == _TYPE_NAME)
    types[name] = dict(_read_field(_as_bytes(v)) for number, v in fields if number == _TYPE_FIELD)
    for number, content in fields:
        if number == _TYPE_NESTED:
            _read_type(_as_bytes(content), name, types, depth + 1)


def _read_field(data: bytes) -> tuple[int, _Field]:
    values = dict(_fields(data))
    number, kind = values.get(_FIELD_NUMBER), values.get(_FIELD_TYPE)
    if not isinstance(number, int) or not isinstance(kind, int):
        raise ValueError("a field without number or type")
    repeated = values.get(_FIELD_LABEL) == _REPEATED
    name = _text(values.get(_FIELD_NAME, b""))
    return number, _Field(name, kind, repeated, _text(values.get(_FIELD_TYPE_NAME, b"")))


def _read(data: bytes, type_name: str, types: _Types, depth: int) -> dict[str, object]:
    if depth > _DEPTH:
        raise ValueError("nested too deeply")
    fields = types.get(type_name, {})
    message: dict[str, object] = {field.name: _default(field) for field in fields.values()}
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


def _default(field: _Field) -> object:
    """Return what an absent field means (proto3)."""
    if field.repeated:
        return []
    if field.kind == _MESSAGE:
        return None
    if field.kind == _STRING:
        return ""
    return 0.0 if field.kind in (_DOUBLE, _FLOAT) else 0


def _decode(field: _Field, content: int | bytes, types: _Types, depth: int) -> list[object]:
    if field.kind == _MESSAGE:
        return [_read(_as_bytes(content), field.type_name, types, depth + 1)]
    if field.kind == _STRING:
        return [_text(content)]
    form = _FORMATS.get(field.kind)
    if isinstance(content, int):
        return [content - (1 << 64) if content >> 63 else content]
    if form is not None:  # one fixed-size value, or a packed list of them
        return [value for (value,) in struct.iter_unpack(form, content)]
    return list(_varints(content))


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield (field number, value): varints as int, all else as bytes."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == _VARINT:
            value, at = _varint(data, at)
            yield tag >> 3, value
            continue
        length = {_FIXED64: 8, _FIXED32: 4}.get(kind, -1)
        if kind == _BYTES:
            length, at = _varint(data, at)
        if length < 0 or at + length > len(data):
            raise ValueError("the message breaks off")
        yield tag >> 3, data[at : at + length]
        at += length


def _varint(data: bytes, at: int) -> tuple[int, int]:
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
        value, at = _varint(data, at)
        yield value - (1 << 64) if value >> 63 else value


def _as_bytes(content: int | bytes) -> bytes:
    if isinstance(content, int):
        raise ValueError("a number where a message is declared")
    return content


def _text(content: int | bytes) -> str:
    return _as_bytes(content).decode("utf-8")
