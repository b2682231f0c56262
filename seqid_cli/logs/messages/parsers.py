"""Messages that are decoded one by one: JSON, protobuf, and CDR of an unusual definition.

A parser (the encoding's own library) makes an object of each message, and a row function takes the
numbers out of its fields. The faster way for CDR messages that are alike must give the same.

Joint states have the fields of sensor_msgs' JointState, or those of `foxglove.JointStates`:
`timestamp`, and `joints` with `name` and optional `position`, `velocity` and `effort`. A value that
is absent is missing, not zero.
"""

import contextlib
import io
import re
from collections.abc import Callable, Sequence

import msgspec
from mcap.records import Schema

from seqid_cli.logs.messages import cdr
from seqid_cli.logs.messages.batch import (
    IMU_FIELDS,
    JOINT_QUANTITIES,
    Decode,
    Decoded,
    Kind,
    NameMap,
    Payloads,
    check_lengths,
)
from seqid_cli.logs.raw import STAMP_LIMIT_NS

Parse = Callable[[bytes], object]
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
_NAN = float("nan")
_PLAIN = frozenset((float, int, str))
_SEC = 1_000_000_000


def field_decoder(kind: Kind, names: NameMap, parse: Parse) -> Decode:
    """Make a decoder that takes messages one by one."""
    row = {"imu": _imu_row, "dynamic_joint_state": _dynamic_row}.get(kind, _joint_row)

    def decode(batch: Payloads) -> Decoded:
        out = Decoded.empty(len(batch), names.width(kind))
        for i, data in enumerate(batch):
            try:
                message = parse(data)
                numbers, stamp_ns = row(message, names), _stamp_ns(message)
            except Exception:  # the content is hostile, and the parser raises anything
                continue
            out.values[i], out.stamp_ns[i], out.good[i] = numbers, stamp_ns, True
        return out

    return decode


def _joint_row(message: object, names: NameMap) -> list[float]:
    """Return position, velocity and effort of the joints in a JointState."""
    joints = _get(message, "joints")
    if joints is not None:
        return _listed_row(_list(joints), names)
    entries = [str(name) for name in _list(_get(message, "name"))]
    pairs = names.pairs(entries)
    arrays = [_list(_get(message, quantity)) for quantity in JOINT_QUANTITIES]
    check_lengths(len(entries), [len(array) for array in arrays])
    row = [_NAN] * names.width("joint_state")
    for quantity, array in enumerate(arrays):
        first = quantity * len(names.joints)
        for entry, joint in pairs if array else ():
            row[first + joint] = _number(array[entry])
    return row


def _listed_row(joints: Sequence[object], names: NameMap) -> list[float]:
    """Return position, velocity and effort of joints that are listed with their values."""
    row = [_NAN] * names.width("joint_state")
    for entry, joint in names.pairs([str(_get(each, "name")) for each in joints]):
        for quantity, name in enumerate(JOINT_QUANTITIES):
            row[quantity * len(names.joints) + joint] = _number(_get(joints[entry], name))
    return row


def _dynamic_row(message: object, names: NameMap) -> list[float]:
    """Return position, velocity and effort of the joints in a DynamicJointState."""
    entries = [str(name) for name in _list(_get(message, "joint_names"))]
    interfaces = _list(_get(message, "interface_values"))
    if len(interfaces) != len(entries):
        raise ValueError("joints and interfaces differ in number")
    row = [_NAN] * names.width("dynamic_joint_state")
    for entry, joint in names.pairs(entries):
        kinds = _list(_get(interfaces[entry], "interface_names"))
        values = _list(_get(interfaces[entry], "values"))
        given = {str(kind): _number(value) for kind, value in zip(kinds, values, strict=True)}
        given.setdefault("effort", given.get(names.effort, _NAN))
        for quantity, name in enumerate(JOINT_QUANTITIES):
            row[quantity * len(names.joints) + joint] = given.get(name, _NAN)
    return row


def _imu_row(message: object, names: NameMap) -> list[float]:
    """Return acceleration and angular velocity of an Imu."""
    del names
    return [_number(_get(_get(message, name), axis)) for name, axis in IMU_FIELDS]


def _stamp_ns(message: object) -> int:
    """Return the stamp of a message in ns, 0 where there is none."""
    stamp = _get(message, "timestamp") or _get(_get(message, "header"), "stamp")
    if stamp is None:
        return 0
    if isinstance(stamp, int | float):
        stamp_ns = round(stamp * _SEC)
    else:
        seconds, rest = (
            next((int(v) for key in keys if (v := _get(stamp, key)) is not None), 0)  # type: ignore[call-overload]
            for keys in (SECONDS, NANOSECONDS)
        )
        if not 0 <= rest < _SEC:
            raise ValueError("no stamp")
        stamp_ns = seconds * _SEC + rest
    if abs(stamp_ns) > STAMP_LIMIT_NS:
        raise ValueError("no stamp")
    return stamp_ns


def _get(message: object, key: str) -> object:
    """Return a field, None where it is absent; protobuf would give a default there."""
    if isinstance(message, dict):
        return message.get(key)
    value = getattr(message, key, None)
    if value.__class__ in _PLAIN and value:
        return value
    if hasattr(message, "HasField") and (not value or hasattr(value, "HasField")):
        try:
            return value if message.HasField(key) else None
        except ValueError:  # fields without presence are never absent
            return value
    return value


def _list(value: object) -> Sequence[object]:
    if value is None:
        return ()
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise ValueError("no list")
    return value


def _number(value: object) -> float:
    if value.__class__ is float:
        return value
    if value is None:
        return _NAN
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError("no number")
    return float(value)  # protobuf's JSON form writes NaN and Infinity as text


_USUAL_FIELDS = {
    "joint_state": (
        "std_msgs/Header header",
        "string[] name",
        "float64[] position",
        "float64[] velocity",
        "float64[] effort",
    ),
    "dynamic_joint_state": (
        "std_msgs/Header header",
        "string[] joint_names",
        "control_msgs/InterfaceValue[] interface_values",
        "MSG: control_msgs/InterfaceValue",
        "string[] interface_names",
        "float64[] values",
    ),
    "imu": (
        "std_msgs/Header header",
        "geometry_msgs/Quaternion orientation",
        "float64[9] orientation_covariance",
        "geometry_msgs/Vector3 angular_velocity",
        "float64[9] angular_velocity_covariance",
        "geometry_msgs/Vector3 linear_acceleration",
        "float64[9] linear_acceleration_covariance",
    ),
}
_QUALIFIED = {
    "Header": "std_msgs/Header",
    "InterfaceValue[]": "control_msgs/InterfaceValue[]",
    "Quaternion": "geometry_msgs/Quaternion",
    "Vector3": "geometry_msgs/Vector3",
}
LONGEST = 1 << 18  # bytes of a message definition; those of joint states have some hundred
_NO_JSON = re.compile(rb"(?<=[\[:,\s])(?:NaN|-?Infinity)(?=\s*[,\]}])")


def decoder(encoding: str, schema: Schema | None, kind: Kind, names: NameMap) -> Decode | None:
    """Make a decoder for the messages of a channel; None where there is none for them."""
    if schema is not None and len(schema.data) > LONGEST:
        return None
    if encoding == "cdr" and is_usual(schema, kind):
        return cdr.decoder(kind, names)
    parse: Parse | None = None
    if encoding == "json":
        parse = parse_json
    elif schema is not None and encoding in ("cdr", "protobuf"):
        parse = schema_parser(encoding, schema)
    return None if parse is None else field_decoder(kind, names, parse)


def parse_json(data: bytes) -> object:
    """Parse JSON, also what is none: the NaN and Infinity that Python writes."""
    try:
        return msgspec.json.decode(data)
    except msgspec.DecodeError:
        return msgspec.json.decode(_NO_JSON.sub(rb'"\g<0>"', data))


def schema_parser(encoding: str, schema: Schema) -> Parse | None:
    """Make a parser from the definition in the file; None where it is not usable."""
    try:
        if encoding == "cdr":
            from mcap_ros2.decoder import DecoderFactory as Ros2

            unheard = io.StringIO()  # it prints what is wrong
            with contextlib.redirect_stdout(unheard), contextlib.redirect_stderr(unheard):
                return Ros2().decoder_for(encoding, schema)
        from mcap_protobuf.decoder import DecoderFactory as Protobuf

        return Protobuf().decoder_for(encoding, schema)
    except Exception:  # the parsers of definitions raise anything on damaged ones
        return None


def is_usual(schema: Schema | None, kind: Kind) -> bool:
    """Tell whether the definition is the one of sensor_msgs, or none is given."""
    if schema is None or schema.encoding != "ros2msg" or not schema.data.strip():
        return True
    text, *parts = schema.data.decode("utf-8", "replace").split("=" * 80)
    if kind == "dynamic_joint_state":
        text += "".join(part for part in parts if "/InterfaceValue\n" in part)
    lines = (re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in text.splitlines())
    found = (line.replace("/msg/", "/") for line in lines if line)
    bare = tuple(
        re.sub(r"^(\w+(?:\[\])?)(?= )", lambda m: _QUALIFIED.get(m[1], m[1]), line)
        for line in found
    )
    return bare == _USUAL_FIELDS[kind]
