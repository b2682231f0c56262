"""Joint states as a list of joints, each with its own values: `foxglove.JointStates`.

Fields by foxglove-sdk's JointStates and JointState: `timestamp`, and `joints` with `name` and
optional `position`, `velocity` and `effort`, as protobuf or JSON. A value that is absent is
missing, not zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from mcap.records import Schema

from seqid_cli.logs.decoding import JOINT_QUANTITIES, Decode, Decoded, NameMap
from seqid_cli.logs.messages import Parse
from seqid_cli.logs.raw import STAMP_LIMIT_NS

SECONDS = ("sec", "seconds")
NANOSECONDS = ("nsec", "nanos", "nanosec")
_WRITTEN = "JointStates"  # how the names of such schemas end


def is_list_of_joints(schema: Schema | None) -> bool:
    """Tell by its name whether a schema is one of these."""
    return schema is not None and schema.name.endswith(_WRITTEN)


def by_content(parse: Parse, names: NameMap, usual: Decode) -> Decode:
    """Decode a list of joints where messages hold one, else as usual: for JSON without a schema.

    Parameters
    ----------
    parse : callable
        From a payload to a message.
    names : NameMap
        The joints wanted.
    usual : callable
        Decoder of messages with the fields of sensor_msgs' JointState.
    """
    listed = decoder(parse, names)

    def decode(batch: Sequence[bytes]) -> Decoded:
        for data in batch:
            try:
                message = parse(data)
            except Exception:  # hostile content; the next one may be sound
                continue
            return listed(batch) if _get(message, "joints") is not None else usual(batch)
        return usual(batch)

    return decode


def decoder(parse: Parse, names: NameMap) -> Decode:
    """Decode messages that list joints with their values."""

    def decode(batch: Sequence[bytes]) -> Decoded:
        out = Decoded.empty(len(batch), names.width)
        for i, data in enumerate(batch):
            try:
                message = parse(data)
                out.values[i] = row(message, names)
                out.stamp_ns[i] = _stamp(message)
            except Exception:  # hostile content, and the parser raises anything
                out.values[i] = np.nan
                continue
            out.good[i] = True
        return out

    return decode


def row(message: object, names: NameMap) -> list[float]:
    """Return position, velocity and effort of the joints in a message."""
    joints = _get(message, "joints")
    if not isinstance(joints, Sequence) or isinstance(joints, str | bytes):
        raise ValueError("no list of joints")
    values = [float("nan")] * names.width
    for entry, joint in names.pairs([str(_get(each, "name")) for each in joints]):
        for quantity, field in enumerate(JOINT_QUANTITIES):
            values[quantity * len(names.joints) + joint] = _number(_get(joints[entry], field))
    return values


def stamp_parts(message: object) -> tuple[object, object]:
    """Return seconds and nanoseconds of a message; zeros where it has no stamp."""
    stamp = _get(message, "timestamp")
    seconds = next((v for key in SECONDS if (v := _get(stamp, key)) is not None), 0)
    rest = next((v for key in NANOSECONDS if (v := _get(stamp, key)) is not None), 0)
    return seconds, rest


def _stamp(message: object) -> int:
    """Return the time of a message in ns, 0 where there is none."""
    seconds, rest = stamp_parts(message)
    if isinstance(seconds, str):  # JSON forms of 64-bit numbers
        seconds = int(seconds)
    if not isinstance(seconds, int) or not isinstance(rest, int) or not 0 <= rest < 10**9:
        raise ValueError("no stamp")
    stamp_ns = seconds * 1_000_000_000 + rest
    if abs(stamp_ns) > STAMP_LIMIT_NS:
        raise ValueError("no stamp")
    return stamp_ns


def _number(value: object) -> float:
    if value is None:
        return float("nan")
    if isinstance(value, float):
        return value
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError("no number")
    return float(value)


def _get(message: object, key: str) -> object:
    if isinstance(message, Mapping):
        return message.get(key)
    return getattr(message, key, None)
