"""Parsers that make an object of one message, for `fields`: by the encodings' own libraries."""

import contextlib
import io
import re

import msgspec
from mcap.records import Schema

from seqid_cli.logs.messages import cdr, fields
from seqid_cli.logs.messages.batch import Decode, Kind, NameMap

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
    parse: fields.Parse | None = None
    if encoding == "json":
        parse = parse_json
    elif schema is not None and encoding in ("cdr", "protobuf"):
        parse = schema_parser(encoding, schema)
    return None if parse is None else fields.decoder(kind, names, parse)


def parse_json(data: bytes) -> object:
    """Parse JSON, also what is none: the NaN and Infinity that Python writes."""
    try:
        return msgspec.json.decode(data)
    except msgspec.DecodeError:
        return msgspec.json.decode(_NO_JSON.sub(rb'"\g<0>"', data))


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
