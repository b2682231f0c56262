"""Messages that are decoded one by one, whatever they are encoded in.

JSON, protobuf, and CDR whose definition is not the usual one: a parser (see `parsers`) makes an
object of each message, and a row function takes the numbers out of its fields. The faster way for
CDR messages that are alike must give the same.

Joint states have the fields of sensor_msgs' JointState, or those of `foxglove.JointStates`:
`timestamp`, and `joints` with `name` and optional `position`, `velocity` and `effort`. A value that
is absent is missing, not zero.
"""

from collections.abc import Callable, Sequence

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


def decoder(kind: Kind, names: NameMap, parse: Parse) -> Decode:
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
