"""Parsers that make an object of one message, for `fields`: by the encodings' own libraries."""

import contextlib
import io
import re

import msgspec
from mcap.records import Schema

from seqid_cli.logs.messages import cdr, fields
from seqid_cli.logs.messages.batch import Decode, Kind, NameMap

_Number = float | str | None
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


class _Stamp(msgspec.Struct, gc=False):
    sec: int | str | None = None
    secs: int | str | None = None
    seconds: int | str | None = None
    nanosec: int | str | None = None
    nsec: int | str | None = None
    nsecs: int | str | None = None
    nanos: int | str | None = None


class _Header(msgspec.Struct, gc=False):
    stamp: _Stamp | float | None = None


class _Joint(msgspec.Struct, gc=False):
    name: str
    position: _Number = None
    velocity: _Number = None
    effort: _Number = None


class _JointState(msgspec.Struct, gc=False):
    header: _Header | None = None
    name: list[str] | None = None
    position: list[_Number] | None = None
    velocity: list[_Number] | None = None
    effort: list[_Number] | None = None
    timestamp: _Stamp | None = None
    joints: list[_Joint] | None = None


class _Interfaces(msgspec.Struct, gc=False):
    interface_names: list[str] = []
    values: list[_Number] = []


class _DynamicJointState(msgspec.Struct, gc=False):
    header: _Header | None = None
    joint_names: list[str] = []
    interface_values: list[_Interfaces] = []


class _Vector(msgspec.Struct, gc=False):
    x: _Number = None
    y: _Number = None
    z: _Number = None


class _Imu(msgspec.Struct, gc=False):
    header: _Header | None = None
    linear_acceleration: _Vector | None = None
    angular_velocity: _Vector | None = None


_TYPES: dict[Kind, type[msgspec.Struct]] = {
    "joint_state": _JointState,
    "dynamic_joint_state": _DynamicJointState,
    "imu": _Imu,
}


def decoder(encoding: str, schema: Schema | None, kind: Kind, names: NameMap) -> Decode | None:
    """Make a decoder for the messages of a channel; None where there is none for them."""
    if schema is not None and len(schema.data) > LONGEST:
        return None
    if encoding == "cdr" and is_usual(schema, kind):
        return cdr.decoder(kind, names)
    parse: fields.Parse | None = None
    if encoding == "json":
        parse = json_parser(kind)
    elif schema is not None and encoding in ("cdr", "protobuf"):
        parse = schema_parser(encoding, schema)
    return None if parse is None else fields.decoder(kind, names, parse)


def json_parser(kind: Kind) -> fields.Parse:
    """Make a parser of JSON, also of what is none: the NaN and Infinity that Python writes."""
    parser = msgspec.json.Decoder(_TYPES[kind])

    def parse(data: bytes) -> object:
        data.decode("utf-8")  # the parser does not look into fields that it leaves out
        try:
            return parser.decode(data)
        except msgspec.DecodeError:
            return parser.decode(_NO_JSON.sub(rb'"\g<0>"', data))

    return parse


def schema_parser(encoding: str, schema: Schema) -> fields.Parse | None:
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
