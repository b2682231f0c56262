"""Messages that are decoded one by one, whatever they are encoded in.

JSON, protobuf, and CDR whose definition is not the usual one: a parser makes an object of each
message, and a row function takes the numbers out of it. The faster ways for messages that are alike
must give the same.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from seqid_cli.logs.decoding import (
    IMU_FIELDS,
    JOINT_QUANTITIES,
    Decode,
    Decoded,
    NameMap,
    check_lengths,
)
from seqid_cli.logs.raw import STAMP_LIMIT_NS

Parse = Callable[[bytes], object]
_Row = Callable[[object], list[float]]
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")


def parse_json(data: bytes) -> object:
    """Parse one JSON message.

    Raises
    ------
    ValueError
        It is no JSON.
    """
    try:
        return json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def schema_parser(schema: Schema) -> Parse | None:
    """Make a decoder from the message definition in the file; None where it is not usable."""
    try:
        return DecoderFactory().decoder_for("cdr", schema)
    except Exception:  # the parser of definitions raises anything on damaged text
        return None


def joint_state_decoder(parse: Parse, names: NameMap) -> Decode:
    """Decode messages with the fields of JointState."""
    return lambda batch: _decode(batch, parse, lambda m: joint_row(m, names), names.width)


def dynamic_joint_state_decoder(parse: Parse, names: NameMap) -> Decode:
    """Decode messages with the fields of ros2_control's DynamicJointState."""
    return lambda batch: _decode(batch, parse, lambda m: dynamic_row(m, names), names.width)


def imu_decoder(parse: Parse) -> Decode:
    """Decode messages with the fields of Imu."""
    return lambda batch: _decode(batch, parse, imu_row, len(IMU_FIELDS))


def _decode(batch: Sequence[bytes], parse: Parse, row: _Row, width: int) -> Decoded:
    out = Decoded.empty(len(batch), width)
    for i, data in enumerate(batch):
        try:
            message = parse(data)
            out.values[i] = row(message)
            out.stamp_ns[i] = _stamp(message)
        except Exception:  # the content is hostile, and the parser raises anything
            continue
        out.good[i] = True
    return out


def joint_row(message: object, names: NameMap) -> list[float]:
    """Return position, velocity and effort of the joints in a JointState."""
    entries = [str(name) for name in _list(_get(message, "name"))]
    pairs = names.pairs(entries)
    arrays = [_list(_get(message, quantity)) for quantity in JOINT_QUANTITIES]
    check_lengths(len(entries), [len(array) for array in arrays])
    row = [float("nan")] * names.width
    for quantity, array in enumerate(arrays):
        for entry, joint in pairs if array else ():
            row[quantity * len(names.joints) + joint] = _number(array[entry])
    return row


def dynamic_row(message: object, names: NameMap) -> list[float]:
    """Return position, velocity and effort of the joints in a DynamicJointState."""
    entries = [str(name) for name in _list(_get(message, "joint_names"))]
    interfaces = _list(_get(message, "interface_values"))
    if len(interfaces) != len(entries):
        raise ValueError("joints and interfaces differ in number")
    row = [float("nan")] * names.width
    for entry, joint in names.pairs(entries):
        kinds = _list(_get(interfaces[entry], "interface_names"))
        values = _list(_get(interfaces[entry], "values"))
        given = {str(kind): _number(value) for kind, value in zip(kinds, values, strict=True)}
        given.setdefault("effort", given.get(names.effort, float("nan")))
        for quantity, name in enumerate(JOINT_QUANTITIES):
            row[quantity * len(names.joints) + joint] = given.get(name, float("nan"))
    return row


def imu_row(message: object) -> list[float]:
    """Return acceleration and angular velocity of an Imu."""
    return [_number(_get(_get(message, name), axis)) for name, axis in IMU_FIELDS]


def stamp_parts(message: object) -> tuple[object, object]:
    """Return seconds and nanoseconds of a message's header; zeros where it has no stamp."""
    stamp = _get(_get(message, "header"), "stamp")
    if stamp is None:
        return 0, 0
    if isinstance(stamp, int | float):
        return stamp, 0
    return _first(stamp, SECONDS), _first(stamp, NANOSECONDS)


def _stamp(message: object) -> int:
    """Return the stamp of a message in ns, 0 where there is none."""
    seconds, rest = stamp_parts(message)
    if isinstance(seconds, float):
        return _checked(round(seconds * 1_000_000_000))
    if not isinstance(seconds, int) or not isinstance(rest, int) or not 0 <= rest < 10**9:
        raise ValueError("no stamp")
    return _checked(seconds * 1_000_000_000 + rest)


def _checked(stamp_ns: int) -> int:
    if abs(stamp_ns) > STAMP_LIMIT_NS:
        raise ValueError("no stamp")
    return stamp_ns


def _first(stamp: object, keys: Sequence[str]) -> object:
    return next((value for key in keys if (value := _get(stamp, key)) is not None), 0)


def _get(message: object, key: str) -> object:
    if isinstance(message, Mapping):
        return message.get(key)
    return getattr(message, key, None)


def _list(value: object) -> Sequence[object]:
    if value is None:
        return ()
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise ValueError("no list")
    return value


def _number(value: object) -> float:
    if value is None:
        return float("nan")
    if isinstance(value, float):
        return value
    if isinstance(value, str):  # protobuf's JSON form writes NaN and Infinity as text
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("no number")
    return float(value)
