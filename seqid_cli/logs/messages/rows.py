"""Which numbers of a message stand where in its row: one rule for all encodings.

A message is what its parser makes of it: dictionaries of JSON, objects of protobuf, and of CDR the
places of its numbers. Joint states have the fields of sensor_msgs' JointState, of control_msgs'
DynamicJointState or of `foxglove.JointStates`: `timestamp`, and `joints` with `name` and optional
`position`, `velocity` and `effort`.
"""

from collections.abc import Sequence

from seqid_cli.logs.messages.batch import IMU_FIELDS, JOINT_QUANTITIES, Kind, NameMap

_PLAIN = frozenset((float, int, str))


def row_of(kind: Kind, message: object, names: NameMap) -> list[object]:
    """Return what stands in the row of a message, None where it is absent, which is not zero.

    Raises ValueError: the fields do not belong together.
    """
    if kind == "imu":
        return [field(field(message, name), axis) for name, axis in IMU_FIELDS]
    row: list[object] = [None] * names.width(kind)
    n = len(names.joints)
    if kind == "dynamic_joint_state":
        entries = _texts(field(message, "joint_names"))
        interfaces = _list(field(message, "interface_values"))
        if len(interfaces) != len(entries):
            raise ValueError("joints and interfaces differ in number")
        for entry, joint in names.pairs(entries):
            kinds = _texts(field(interfaces[entry], "interface_names"))
            values = _list(field(interfaces[entry], "values"))
            given = dict(zip(kinds, values, strict=True))
            given.setdefault("effort", given.get(names.effort))
            row[joint::n] = [given.get(name) for name in JOINT_QUANTITIES]
    elif (joints := field(message, "joints")) is not None:
        joints = _list(joints)
        for entry, joint in names.pairs([str(field(each, "name")) for each in joints]):
            for k, name in enumerate(JOINT_QUANTITIES):
                row[k * n + joint] = field(joints[entry], name)
    else:
        entries = _texts(field(message, "name"))
        arrays = [_list(field(message, quantity)) for quantity in JOINT_QUANTITIES]
        for quantity, array in zip(JOINT_QUANTITIES, arrays, strict=True):
            if len(array) not in (0, len(entries)):
                raise ValueError(f"{len(array)} values of {quantity} for {len(entries)} names")
        pairs = names.pairs(entries)
        for k, array in enumerate(arrays):
            first = k * n
            for entry, joint in pairs if array else ():
                row[first + joint] = array[entry]
    return row


def field(message: object, key: str) -> object:
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


def _texts(value: object) -> list[str]:
    return [str(each) for each in _list(value)]
