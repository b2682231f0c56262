"""JSON messages, a batch at a time by Arrow's parser.

Arrow is told which fields there are and of what type; a batch that it refuses is halved until the
messages that are different stand alone, and those are decoded one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json
from numpy.typing import NDArray

from seqid_cli.logs import joint_messages
from seqid_cli.logs.decoding import IMU_FIELDS, JOINT_QUANTITIES, Decode, Decoded, NameMap
from seqid_cli.logs.messages import NANOSECONDS, SECONDS, parse_json
from seqid_cli.logs.payloads import Payloads
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Stamps

Integers = NDArray[np.int64]

_SMALLEST = 32  # messages that are not halved further
_PATIENCE = 8  # batches refused in a row after which Arrow is not asked again
_LARGEST = 1 << 27  # bytes parsed together
_SEC = 1_000_000_000
_ZERO = pa.scalar(0)  # made once: Arrow looks for other packages each time
_ERRORS = (pa.ArrowException, UnicodeError, ValueError, KeyError, OverflowError, MemoryError)

_DOUBLES = pa.list_(pa.float64())
_VECTOR = pa.struct([(axis, pa.float64()) for axis in "xyz"])
_TIME = pa.struct([(name, pa.int64()) for name in (*SECONDS, *NANOSECONDS)])
_JOINT = pa.struct([("name", pa.string()), *((name, pa.float64()) for name in JOINT_QUANTITIES)])
_FIELDS = {
    "joint_state": [("name", pa.list_(pa.string())), *((q, _DOUBLES) for q in JOINT_QUANTITIES)],
    "joints": [("joints", pa.list_(_JOINT))],
    "imu": [("linear_acceleration", _VECTOR), ("angular_velocity", _VECTOR)],
}


class _UnusualError(Exception):
    """These messages are decoded one by one."""


def decoder(kind: str, names: NameMap, single: Decode) -> Decode:
    """Decode JSON messages.

    Parameters
    ----------
    kind : {"joint_state", "dynamic_joint_state", "imu"}
        What they hold.
    names : NameMap
        The joints wanted.
    single : callable
        Decodes messages one by one.
    """
    return single if kind not in _FIELDS else _JsonDecoder(kind, names, single)


@dataclass
class _JsonDecoder:
    kind: str
    names: NameMap
    single: Decode
    refused: int = 0  # in a row

    def __call__(self, batch: Sequence[bytes]) -> Decoded:
        payloads = Payloads.of(batch)
        if self.refused >= _PATIENCE or not len(payloads):
            return self.single(payloads)
        try:
            if int(payloads.lengths.sum()) > _LARGEST:
                raise _UnusualError
            decoded = self._decode(payloads)
        except (*_ERRORS, _UnusualError):
            return self._halved(payloads)
        self.refused = 0
        return decoded

    def _halved(self, payloads: Payloads) -> Decoded:
        count = len(payloads)
        if count <= _SMALLEST:
            self.refused += 1
            return self.single(payloads)
        one, other = self(payloads[: count // 2]), self(payloads[count // 2 :])
        return Decoded(
            np.concatenate([one.stamp_ns, other.stamp_ns]),
            np.concatenate([one.values, other.values]),
            np.concatenate([one.good, other.good]),
        )

    def _decode(self, payloads: Payloads) -> Decoded:
        kind, number = self._form(payloads[0])
        table = _parse(payloads, kind, number)
        if kind == "imu":
            values, good = _imu_values(table), np.ones(len(payloads), np.bool_)
        elif kind == "joints":
            values, good = _listed_values(table, self.names)
        else:
            values, good = _joint_values(table, self.names)
        path = ["timestamp"] if kind == "joints" else ["header", "stamp"]
        stamps, sane = _stamps(table, path, number)
        return Decoded(stamps, values, good & sane)

    def _form(self, data: bytes) -> tuple[str, bool]:
        """Tell what the first message of a batch holds, and whether its stamp is one number."""
        message = parse_json(data)
        if not isinstance(message, dict):
            raise _UnusualError
        header = message.get("header")
        number = isinstance(header, dict) and isinstance(header.get("stamp"), float)
        listed = self.kind == "joint_state" and message.get("joints") is not None
        return ("joints", False) if listed else (self.kind, number)


def _parse(payloads: Payloads, kind: str, number: bool) -> pa.Table:
    if (payloads.lengths == 0).any() or (payloads.buffer[payloads.starts] != ord("{")).any():
        raise _UnusualError  # each line must be an object of its own
    text = payloads.lines()
    if text.max() >= 0x80:
        text.tobytes().decode("utf-8")
    time = pa.float64() if number else _TIME
    stamp = ("timestamp", _TIME) if kind == "joints" else ("header", pa.struct([("stamp", time)]))
    table = pyarrow.json.read_json(
        pa.BufferReader(pa.py_buffer(text)),
        read_options=pyarrow.json.ReadOptions(use_threads=False, block_size=len(text) + 1),
        parse_options=pyarrow.json.ParseOptions(
            explicit_schema=pa.schema([stamp, *_FIELDS[kind]]), unexpected_field_behavior="ignore"
        ),
    )
    if len(table) != len(payloads):
        raise _UnusualError
    return table


def _stamps(table: pa.Table, path: list[str], number: bool) -> tuple[Stamps, Mask]:
    column = _only(table, path[0])
    if number:
        seconds = _floats(pc.struct_field(column, path[1:]))
        seconds = np.where(np.isnan(seconds), 0.0, seconds)  # no stamp
        good = np.abs(seconds) <= STAMP_LIMIT_NS / _SEC
        return np.rint(np.where(good, seconds, 0.0) * _SEC).astype(np.int64), good
    keys: tuple[Sequence[str], Sequence[str]] = (SECONDS, NANOSECONDS)
    if path == ["timestamp"]:
        keys = joint_messages.SECONDS, joint_messages.NANOSECONDS
    whole, rest = (
        pc.coalesce(*(pc.struct_field(column, [*path[1:], name]) for name in each), _ZERO)
        for each in keys
    )
    sec, nanosec = np.asarray(whole), np.asarray(rest)
    limit = STAMP_LIMIT_NS // _SEC
    good = (sec >= -limit) & (sec < limit) & (nanosec >= 0) & (nanosec < _SEC)
    return np.where(good, sec, 0) * _SEC + np.where(good, nanosec, 0), good


def _imu_values(table: pa.Table) -> Array:
    columns = [_floats(pc.struct_field(_only(table, name), [axis])) for name, axis in IMU_FIELDS]
    return np.column_stack(columns)


def _joint_values(table: pa.Table, names: NameMap) -> tuple[Array, Mask]:
    """Return the values (M, 3 n) of messages with one list per quantity."""
    lists = _only(table, "name")
    counts = _lengths(lists)
    coded = _coded(pc.list_flatten(lists))
    columns = [_only(table, name) for name in JOINT_QUANTITIES]
    lengths = [_lengths(column) for column in columns]
    numbers = [_floats(pc.list_flatten(column)) for column in columns]
    values = np.full((len(table), names.width), np.nan)
    good = np.ones(len(table), np.bool_)
    order = _common_order(coded, counts, lengths)
    if order is not None:
        pairs = names.pairs(order)
        for quantity, flat in enumerate(numbers):
            block = flat.reshape(len(table), -1)
            for entry, joint in pairs if block.shape[1] else ():
                values[:, quantity * len(names.joints) + joint] = block[:, entry]
        return values, good
    rows, entries, joints = _matched(coded, counts, names)
    for quantity, (length, flat) in enumerate(zip(lengths, numbers, strict=True)):
        good &= (length == 0) | (length == counts)
        there = (length == counts)[rows]
        chosen = flat[((np.cumsum(length) - length)[rows] + entries)[there]]
        values[rows[there], quantity * len(names.joints) + joints[there]] = chosen
    return values, good


def _common_order(
    coded: pa.Array, counts: Integers, lengths: Sequence[Integers]
) -> list[str] | None:
    """Return the names of the messages if all have the same, and lists of the same lengths."""
    first = int(counts[0])
    alike = first > 0 and (counts == first).all()
    if not alike or any((each != each[0]).any() or each[0] not in (0, first) for each in lengths):
        return None
    codes = np.asarray(coded.indices).reshape(-1, first)
    if (codes != codes[0]).any():
        return None
    known = coded.dictionary.to_pylist()
    return [known[code] for code in codes[0].tolist()]


def _listed_values(table: pa.Table, names: NameMap) -> tuple[Array, Mask]:
    """Return the values (M, 3 n) of messages that list joints with their values."""
    lists = _only(table, "joints")
    counts = _lengths(lists)
    flat = pc.list_flatten(lists)
    if flat.null_count:
        raise _UnusualError
    rows, entries, joints = _matched(_coded(pc.struct_field(flat, ["name"])), counts, names)
    places = (np.cumsum(counts) - counts)[rows] + entries
    values = np.full((len(table), names.width), np.nan)
    for quantity, name in enumerate(JOINT_QUANTITIES):
        numbers = _floats(pc.struct_field(flat, [name]))
        values[rows, quantity * len(names.joints) + joints] = numbers[places]
    return values, np.asarray(pc.is_valid(lists))


def _coded(flat: pa.Array) -> pa.Array:
    """Number the different names of all messages."""
    if flat.null_count:
        raise _UnusualError
    return flat.dictionary_encode()


def _matched(
    coded: pa.Array, counts: Integers, names: NameMap
) -> tuple[Integers, Integers, Integers]:
    """Find wanted joints among the names of all messages.

    Returns
    -------
    rows, entries, joints : (K,) arrays
        The message, the place in it and the joint of the robot; of equal names in a message the
        first comes last, so that it is the one that is kept.
    """
    joint_of = np.full(len(coded.dictionary) + 1, -1)
    for entry, joint in names.pairs(coded.dictionary.to_pylist()):
        joint_of[entry] = joint
    joints = joint_of[np.asarray(coded.indices)]
    rows = np.repeat(np.arange(len(counts)), counts)
    entries = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    wanted = np.flatnonzero(joints >= 0)[::-1]
    return rows[wanted], entries[wanted], joints[wanted]


def _lengths(lists: pa.Array) -> Integers:
    return np.asarray(pc.fill_null(pc.list_value_length(lists), 0)).astype(np.int64)


def _floats(column: pa.Array) -> Array:
    values: Array = column.to_numpy(zero_copy_only=False)
    return values


def _only(table: pa.Table, name: str) -> pa.Array:
    column = table.column(name)
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
