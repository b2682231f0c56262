"""Ways to damage what a sound container holds: its trees, records, tables and rows of
values.
"""

import copy
import io
import json
import sqlite3
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from mcap.stream_reader import StreamReader

from tests.studies.fuzz.containers import MCAP_MAGIC, inside, places, written
from tests.studies.fuzz.mutations import BINARY, TEXT, mutated

_NUMBERS = (0, -1, 1e300, -1e300, 5e-324, 1e-9, 0.5, 1, 2**31, 2**63 - 1)
_STRINGS = ("", " ", "1", "x" * 300, "\x1b[31m", "../x", "\u202e\ufeff", "nan")
_OTHER: tuple[object, ...] = (None, True, [], {}, [[]], [0.0] * 1000, {"a": 1})
_KEPT = (Schema, Channel, Message)
_PACKERS = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
_TYPES = (
    *(
        pa.string(),
        pa.large_string(),
        pa.float16(),
        pa.float32(),
        pa.int8(),
        pa.int64(),
    ),
    *(
        pa.uint64(),
        pa.bool_(),
        pa.decimal128(38, 10),
        pa.timestamp("ns", "UTC"),
        pa.timestamp("s"),
    ),
    *(
        pa.date32(),
        pa.time64("ns"),
        pa.duration("us"),
        pa.dictionary(pa.int8(), pa.float64()),
    ),
)
_WRAPPERS: tuple[Callable[[Any], Any], ...] = (
    *(lambda value: None, lambda value: [value], lambda value: [[value], []]),
    *(
        lambda value: {"a": value},
        lambda value: repr(value).encode(),
        lambda value: "x",
    ),
)


def _of(options: Any, rng: np.random.Generator) -> Any:
    return options[int(rng.integers(len(options)))]


def _odd(value: object, rng: np.random.Generator) -> Any:
    """Another value, most often of the same kind."""
    if isinstance(value, bytes):
        return mutated(value, (*BINARY, *TEXT), rng)[0]
    alike = _STRINGS if isinstance(value, str) else _NUMBERS
    return _of(alike if rng.random() < 0.8 else (*_NUMBERS, *_STRINGS, *_OTHER), rng)


@inside
def value(data: bytes, rng: np.random.Generator) -> bytes:
    """A value of a JSON document is another, is lost, moves, or comes many times."""
    tree = [json.loads(data)]
    spots = list(places(tree))
    (holder, key), (other, from_key) = _of(spots, rng), _of(spots, rng)
    one = holder[key]
    match int(rng.integers(6)):
        case 0:
            del holder[key]
        case 1:
            holder[key] = json.loads(json.dumps(other[from_key]))
        case 2 if isinstance(one, list):
            holder[key] = (
                one * int(rng.choice([2, 300])) if rng.random() < 0.5 else one[:-1]
            )
        case 2 if isinstance(one, dict) and one:
            one[_of(_STRINGS, rng)] = one.pop(_of(list(one), rng))
        case _:
            holder[key] = _odd(one, rng)
    return json.dumps(tree[0], ensure_ascii=False).encode(errors="surrogatepass")


@inside
def record(data: bytes, rng: np.random.Generator) -> bytes:
    """A schema, channel or message of an MCAP file is another; chunk and checksum are
    right.
    """
    kept = [r for r in StreamReader(io.BytesIO(data)).records if isinstance(r, _KEPT)]
    kind = _of(_KEPT, rng)
    one = _of([r for r in kept if isinstance(r, kind)], rng)
    name = _of(list(vars(one)), rng)
    setattr(one, name, _odd(getattr(one, name), rng))
    if rng.random() < 0.2:
        kept = kept * 2 if rng.random() < 0.5 else [r for r in kept if r is not one]
    compression, content = _of(list(_PACKERS), rng), written(*kept)
    chunk = Chunk(
        compression=compression,
        data=_PACKERS[compression](content),
        message_start_time=0,
        message_end_time=2**63,
        uncompressed_crc=0,
        uncompressed_size=len(content),
    )
    return (
        MCAP_MAGIC
        + written(Header("", "fuzz"), chunk, DataEnd(0), Footer(0, 0, 0))
        + MCAP_MAGIC
    )


@inside
def column(data: bytes, rng: np.random.Generator) -> bytes:
    """A column of a Parquet file has another type, other values or another name."""
    table = pq.read_table(io.BytesIO(data))
    at = int(rng.integers(table.num_columns))
    field, values = table.schema.field(at), table.column(at)
    match int(rng.integers(6)):
        case 0:
            table = (
                table.remove_column(at)
                if rng.random() < 0.5
                else table[: rng.integers(3)]
            )
        case 1:
            names = table.column_names
            names[at] = _of((*_STRINGS, *names), rng)
            table = table.rename_columns(names)
        case 2:
            table = table.set_column(
                at, field.name, values.cast(_of(_TYPES, rng), safe=False)
            )
        case 3:
            some = list(map(_of(_WRAPPERS, rng), values.to_pylist()))
            table = table.set_column(at, field.name, pa.array(some))
        case _:
            table = table.set_column(
                at, field.name, pa.array(_spoilt(values.to_pylist(), rng))
            )
    out = io.BytesIO()
    pq.write_table(
        table, out, compression=_of(("none", "snappy"), rng), row_group_size=16
    )
    return out.getvalue()


def _spoilt(values: list[Any], rng: np.random.Generator) -> list[Any]:
    """Some values, or all, are holes or numbers that nobody measured; or the order is
    another.
    """
    if rng.random() < 0.2:
        return values[::-1]
    odd = _of((*_NUMBERS, None, float("nan"), float("-inf")), rng)
    odd = [odd] if values and isinstance(values[0], list) else odd
    share = float(rng.choice([0.02, 0.3, 1.0]))
    return [odd if rng.random() < share else each for each in values]


@inside
def row(data: bytes, rng: np.random.Generator) -> bytes:
    """A value in an SQLite file is another."""
    base = sqlite3.connect(":memory:")
    base.deserialize(data)
    table = _of(
        [name for (name,) in base.execute("SELECT name FROM sqlite_schema")], rng
    )
    name = _of([each[1] for each in base.execute(f"PRAGMA table_info('{table}')")], rng)
    ids = [number for (number,) in base.execute(f"SELECT rowid FROM '{table}'")]
    where = (_of(ids, rng),)
    (old,) = base.execute(
        f"SELECT {name} FROM '{table}' WHERE rowid = ?", where
    ).fetchone()
    base.execute(
        f"UPDATE '{table}' SET {name} = ? WHERE rowid = ?", (_odd(old, rng), *where)
    )
    base.commit()
    return base.serialize()


@inside
def element(data: bytes, rng: np.random.Generator) -> bytes:
    """An element of an XML document is lost, comes again elsewhere, or says something
    else.
    """
    root = ET.fromstring(data)
    every = list(root.iter())
    one, other = _of(every, rng), _of(every, rng)
    if one.attrib and rng.random() < 0.8:
        name, texts = (
            _of(list(one.attrib), rng),
            one.attrib[_of(list(one.attrib), rng)].split(),
        )
        texts[int(rng.integers(len(texts)))] = str(_odd(0.0, rng))
        one.attrib[name] = " ".join(texts)
    elif rng.random() < 0.5:
        other.append(copy.deepcopy(one))
    else:
        other[:] = other[1:]
    return ET.tostring(root)
