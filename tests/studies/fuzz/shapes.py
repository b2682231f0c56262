"""Ways to give a file a shape that no recorder gives it: depth, width, and one thing
under many names.
"""

import io
import json
import sqlite3
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from mcap.stream_reader import StreamReader

from tests.studies.fuzz.containers import MCAP_MAGIC, inside, places, written

_SIZES = (2, 30, 150, 1_200, 20_000)


def _size(rng: np.random.Generator) -> int:
    return int(rng.choice(_SIZES))


@inside
def json_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """A value lies deep in lists or objects, or its object has many keys."""
    tree = [json.loads(data)]
    spots = list(places(tree))
    holder, key = spots[int(rng.integers(len(spots)))]
    size = _size(rng)
    marker = '"\ue000"'
    match int(rng.integers(4)):
        case 0:
            shape = "[" * size + "1" + "]" * size
        case 1:
            shape = '{"a":' * size + "1" + "}" * size
        case 2:
            items = ",".join(f'"k{k}":{k}' for k in range(size))
            shape = "{" + items + "}"
        case _:
            shape = "[" + ",".join([json.dumps(holder[key])] * min(size, 500)) + "]"
    holder[key] = json.loads(marker)
    return json.dumps(tree[0]).replace(json.dumps(json.loads(marker)), shape).encode()


@inside
def toml_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """Keys of many parts, arrays in arrays, many tables, or a table many times."""
    size = _size(rng)
    joints = data.split(b"[[joint]]")
    match int(rng.integers(5)):
        case 0:
            return data + b"\n" + b".".join([b"a"] * size) + b" = 1\n"
        case 1:
            return data + b"\nx = " + b"[" * size + b"]" * size + b"\n"
        case 2:
            tables = b"".join(b"\n[t%d]\nx = 1" % k for k in range(size))
            return data + tables
        case 3:
            tables = b"".join(b"[[joint]]" + joint for joint in joints[1:])
            times = min(size, 1 + 10**6 // max(len(tables), 1))
            return joints[0] + (tables * times)[: 10**6]
        case _:
            return data + b"\nx = " + b"{ a = " * size + b"1" + b" }" * size + b"\n"


@inside
def xml_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """Elements in each other, many attributes, a long chain, a mesh of names."""
    size = _size(rng)
    end = data.rindex(b"</")
    match int(rng.integers(4)):
        case 0:
            more = b"<a>" * size + b"</a>" * size
        case 1:
            more = b"<a " + b" ".join(b'k%d="1"' % k for k in range(size)) + b"/>"
        case 2:
            more = b"".join(
                b'<link name="l%d"/><joint name="j%d" type="revolute">'
                b'<parent link="%s"/><child link="l%d"/></joint>'
                % (k, k, b"l%d" % (k - 1) if k else b"lower", k)
                for k in range(size)
            )
        case _:
            more = b"".join(b'<link name="w%d"/>' % k for k in range(size))
    return data[:end] + more + data[end:]


@inside
def csv_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """Many columns, a cell of great length, one line in all, or empty cells alone."""
    size = _size(rng)
    rows = data.split(b"\n")
    match int(rng.integers(4)):
        case 0:
            names = b",".join(b"c%d" % k for k in range(size))
            fill = b",".join([b"1"] * size)
            return b"\n".join(
                [rows[0] + b"," + names, *(r + b"," + fill for r in rows[1:20])]
            )
        case 1:
            at = int(rng.integers(len(rows)))
            rows[at] = rows[at] + b"9" * size * 10
        case 2:
            return b",".join(rows)
        case _:
            rows[1:] = [b"," * rows[0].count(b",")] * min(size, 2_000)
    return b"\n".join(rows)


@inside
def parquet_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """Columns in many structures or lists, many columns, many groups of rows."""
    table = pq.read_table(io.BytesIO(data))[:50]
    size = min(_size(rng), 1_200)
    name = table.column_names[int(rng.integers(table.num_columns))]
    values: Any = table.column(name).combine_chunks()
    options: dict[str, Any] = {}
    match int(rng.integers(4)):
        case 0:
            for _ in range(min(size, 60)):
                values = pa.StructArray.from_arrays([values], ["a"])
            table = table.append_column("deep", values)
        case 1:
            for _ in range(min(size, 60)):
                offsets = np.arange(len(values) + 1, dtype=np.int32)
                values = pa.ListArray.from_arrays(offsets, values)
            table = table.append_column("deep", values)
        case 2:
            for k in range(size):
                table = table.append_column(f"c{k}", values)
        case _:
            options = {"row_group_size": 1, "data_page_size": 1}
    out = io.BytesIO()
    pq.write_table(table, out, **options)
    return out.getvalue()


@inside
def mcap_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """Many channels of one schema, many schemas, many empty messages, or chunks."""
    records = StreamReader(io.BytesIO(data), emit_chunks=False).records
    kept = [r for r in records if isinstance(r, Schema | Channel | Message)]
    schemas = [r for r in kept if isinstance(r, Schema)]
    channels = [r for r in kept if isinstance(r, Channel)]
    messages = [r for r in kept if isinstance(r, Message)]
    size = min(_size(rng), 1_200)
    more: list[Any] = []
    match int(rng.integers(4)):
        case 0:
            for k in range(size):
                own = Channel(
                    id=1000 + k,
                    schema_id=channels[0].schema_id,
                    topic=f"{channels[0].topic}{k}",
                    message_encoding=channels[0].message_encoding,
                    metadata={},
                )
                first = messages[0]
                of_own = Message(
                    channel_id=1000 + k,
                    log_time=first.log_time,
                    publish_time=first.publish_time,
                    sequence=0,
                    data=first.data,
                )
                more += [own, of_own]
        case 1:
            more = [
                Schema(id=1000 + k, name=s.name, encoding=s.encoding, data=s.data)
                for k, s in enumerate(schemas * (size // len(schemas) + 1))
            ]
        case 2:
            definition = "\n".join(f"float64[] f{k}" for k in range(size)).encode()
            schemas[0].data = definition
        case _:
            more = messages * (size // len(messages) + 1)
    content = written(*kept, *more)
    chunk = Chunk(
        compression="",
        data=content,
        message_start_time=0,
        message_end_time=2**63,
        uncompressed_crc=0,
        uncompressed_size=len(content),
    )
    ends = written(DataEnd(0), Footer(0, 0, 0))
    return MCAP_MAGIC + written(Header("", "fuzz"), chunk) + ends + MCAP_MAGIC


_COUNTED = "WITH RECURSIVE n(x) AS (VALUES(1) UNION ALL SELECT x+1 FROM n WHERE x<{})"
# Messages that are computed while they are read; {} is a number.
_VIEW = (
    "CREATE VIEW messages AS " + _COUNTED + " SELECT x AS id, 1 AS topic_id, x AS"
    " timestamp, zeroblob(1000000) AS data FROM n"
)
_COMPUTED = (
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp"
    " INTEGER, data BLOB AS/**/(zeroblob({})))"
)


@inside
def sqlite_shape(data: bytes, rng: np.random.Generator) -> bytes:
    """Messages that are computed, a default of megabytes, many topics, many tables."""
    base = sqlite3.connect(":memory:")
    base.deserialize(data)
    size = _size(rng)
    match int(rng.integers(5)):
        case 0:
            base.execute("ALTER TABLE messages RENAME TO old")
            base.execute(_VIEW.format(size * 1000))
        case 1:
            base.execute("ALTER TABLE messages RENAME TO old")
            base.execute(_COMPUTED.format(size * 1000))
            rows = [(k, k) for k in range(1, 60)]
            insert = "INSERT INTO messages(id, topic_id, timestamp) VALUES (?, 1, ?)"
            base.executemany(insert, rows)
        case 2:
            base.execute("ALTER TABLE messages DROP COLUMN data")
            literal = "00" * size * 50
            base.execute(f"ALTER TABLE messages ADD data BLOB DEFAULT x'{literal}'")
        case 3:
            columns = [each[1] for each in base.execute("PRAGMA table_info('topics')")]
            others = ", ".join(columns[1:])
            base.execute(
                _COUNTED.format(size)
                + f" INSERT INTO topics(id, {others}) SELECT x + 100, {others} FROM n,"
                " (SELECT * FROM topics LIMIT 1)"
            )
        case _:
            for k in range(min(size, 1_200)):
                base.execute(f"CREATE TABLE t{k}(x)")
    base.commit()
    return base.serialize()
