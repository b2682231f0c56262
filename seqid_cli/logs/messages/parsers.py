"""Messages that are decoded one by one: JSON, protobuf, CDR of unusual definitions.

The encoding's own library makes an object of each message, and `row_of` takes the
values out of its fields. The faster way for CDR messages that are alike must give the
same.
"""

import contextlib
import io
import math
import re
from collections.abc import Callable, Sequence

import msgspec
from mcap.records import Schema

from seqid_cli.logs.messages.batch import (
    Decode,
    Decoded,
    Kind,
    NameMap,
    Payloads,
    field,
    row_of,
)
from seqid_cli.logs.messages.cdr import LayoutDecoder
from seqid_cli.logs.raw import STAMP_LIMIT_NS

DYNAMIC = "DynamicJointState"  # how the name of the type ends
CONTROLLER = "JointTrajectoryControllerState"  # likewise
Parse = Callable[[bytes], object]
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
# Fields by their definitions, without the packages of their types.
_USUAL_FIELDS = {
    "joint_state": (
        "Header header; string[] name; float64[] position; float64[] velocity; "
        "float64[] effort"
    ),
    "dynamic_joint_state": (
        "Header header; string[] joint_names; "
        "InterfaceValue[] interface_values; MSG: control_msgs/InterfaceValue; "
        "string[] interface_names; float64[] values"
    ),
    "imu": (
        "Header header; Quaternion orientation; float64[9] orientation_covariance; "
        "Vector3 angular_velocity; float64[9] angular_velocity_covariance; "
        "Vector3 linear_acceleration; float64[9] linear_acceleration_covariance"
    ),
}
_PACKAGE = re.compile("^(?:std|geometry|control)_msgs/")
# bytes of a message definition; those of joint states have some hundred
LONGEST = 1 << 18
_NO_JSON = re.compile(rb"(?<=[\[:,\s])(?:NaN|-?Infinity)(?=\s*[,\]}])")
_SEC = 1_000_000_000


def field_decoder(kind: Kind, names: NameMap, parse: Parse) -> Decode:
    """Make a decoder that takes messages one by one."""

    def decode(batch: Payloads) -> Decoded:
        decoded = Decoded.empty(len(batch), names.width(kind))
        for i, data in enumerate(batch):
            try:
                message = parse(data)
                row = row_of(kind, message, names)
                # Most values are floats already, and a call for each is dear.
                numbers = [v if v.__class__ is float else _number(v) for v in row]
                stamp_ns = _stamp_ns(message)
            except Exception:  # the content is hostile, and the parser raises anything
                continue
            decoded.values[i] = numbers
            decoded.stamp_ns[i] = stamp_ns
            decoded.good[i] = True
        return decoded

    return decode


def _stamp_ns(message: object) -> int:
    """Return the stamp of a message in ns, 0 where there is none."""
    stamp = field(message, "timestamp") or field(field(message, "header"), "stamp")
    if stamp is None:
        return 0
    nanoseconds = 0
    if isinstance(stamp, int | float):
        stamp_ns = round(stamp * _SEC)
    else:
        nanoseconds = _first_integer(stamp, NANOSECONDS)
        stamp_ns = _first_integer(stamp, SECONDS) * _SEC + nanoseconds
    if not 0 <= nanoseconds < _SEC or abs(stamp_ns) > STAMP_LIMIT_NS:
        raise ValueError("no stamp")
    return stamp_ns


def _first_integer(message: object, keys: Sequence[str]) -> int:
    """Return the first field of some names that a message has, 0 without any."""
    for key in keys:
        value = field(message, key)
        if value is not None:
            return int(value)  # type: ignore[call-overload, no-any-return]
    return 0


def _number(value: object) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError("no number")
    return float(value)  # protobuf's JSON form writes NaN and Infinity as text


def kind_of(schema: Schema | None, kind: Kind) -> Kind:
    """Return how messages are read: joint states as their type says."""
    if kind == "imu" or schema is None:
        return kind
    if schema.name.endswith(DYNAMIC):
        return "dynamic_joint_state"
    if schema.name.endswith(CONTROLLER):
        return "controller_state"
    return kind


def decoder(
    encoding: str, schema: Schema | None, kind: Kind, names: NameMap
) -> Decode | None:
    """Make a decoder for the messages of a channel; None where there is none.

    Parameters
    ----------
    encoding : str
        The channel's encoding: cdr, ros1, json or protobuf.
    schema : Schema or None
        The definition of its messages in the file.
    kind : {"joint_state", "dynamic_joint_state", "controller_state", "imu"}
        How the messages are read.
    names : NameMap
        The joints whose values make a row.
    """
    if schema is not None and len(schema.data) > LONGEST:
        return None
    if encoding in ("cdr", "ros1") and is_usual(schema, kind):
        return LayoutDecoder(kind, names, ros1=encoding == "ros1")
    if encoding == "json":
        return field_decoder(kind, names, parse_json)
    if schema is not None and encoding in ("cdr", "protobuf"):
        parse = schema_parser(encoding, schema)
        if parse is not None:
            return field_decoder(kind, names, parse)
    return None


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

            ignored = io.StringIO()  # it prints what is wrong
            with (
                contextlib.redirect_stdout(ignored),
                contextlib.redirect_stderr(ignored),
            ):
                return Ros2().decoder_for(encoding, schema)
        from mcap_protobuf.decoder import DecoderFactory as Protobuf

        return Protobuf().decoder_for(encoding, schema)
    except Exception:  # the parsers of definitions raise anything on damaged ones
        return None


def is_usual(schema: Schema | None, kind: Kind) -> bool:
    """Tell whether the definition is the one of sensor_msgs, or none is given."""
    if kind == "controller_state":
        return False  # its fields differ from version to version
    is_defined = schema is not None and schema.encoding in ("ros1msg", "ros2msg")
    if schema is None or not is_defined or not schema.data.strip():
        return True
    text, *types = schema.data.decode("utf-8", "replace").split("=" * 80)
    if kind == "dynamic_joint_state":
        text += "".join(part for part in types if "/InterfaceValue\n" in part)

    # Fields without comments, spaces to spare and the packages of their types.
    fields = []
    for line in text.splitlines():
        code = re.sub(r"\s+", " ", line.split("#")[0]).strip()
        if code:
            fields.append(_PACKAGE.sub("", code.replace("/msg/", "/")))
    return "; ".join(fields) == _USUAL_FIELDS[kind]
