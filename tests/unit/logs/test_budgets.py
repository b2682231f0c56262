"""A few bytes that stand for gigabytes end in a message, before the gigabytes are
there.
"""

import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from mcap.records import Schema

from seqid_cli.__main__ import main
from seqid_cli.errors import ConfigError, InputError
from seqid_cli.logs.mcap.chunks import CHUNK, RECORD, SMALL, DamageError, Unpacker
from seqid_cli.logs.mcap.records import MAGIC, PIECES, Scan
from seqid_cli.logs.messages import parsers
from seqid_cli.logs.messages.batch import NameMap
from seqid_cli.logs.tables.columns import ROOM, opened_table
from seqid_cli.logs.tables.parquet import damaged, read_tables
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.studies.fuzz.answers import answer

SAMPLES = ROOT / "sample_logs"

EMPTY = struct.pack("<BQ", 0x80, 0)  # a record of a kind of somebody's own


def chunk(raw: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(raw)
    head = CHUNK.pack(0, 1, len(raw), 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    return head + packed


@pytest.mark.parametrize("count", [1, 5])
def test_chunks_that_unpack_to_too_much_together_are_refused(count: int) -> None:
    unpacker, one = Unpacker(), chunk(EMPTY * (11 * SMALL // 10 // count // len(EMPTY)))
    for _ in range(count - 1):
        unpacker.unpack(one, True)
    with pytest.raises(DamageError, match="times"):
        unpacker.unpack(one, True)


def test_chunks_of_a_recording_have_no_end() -> None:
    noise = np.random.default_rng(0).normal(size=SMALL // 32).tobytes()
    unpacker, one = Unpacker(), chunk(noise)
    assert all(unpacker.unpack(one, True) == (noise, True) for _ in range(12))


def record(opcode: int, content: bytes) -> bytes:
    return RECORD.pack(opcode, len(content)) + content


def channel(number: int) -> bytes:
    topic = f"/topic_{number:05}".encode()
    return record(
        4, struct.pack("<HHI12sI3sI", number, 0, len(topic), topic, 3, b"cdr", 0)
    )


CHANNELS = b"".join(map(channel, range(1 << 16)))
TURNS = b"".join(record(5, struct.pack("<HIQQ", n, 0, 0, 0)) for n in range(1 << 16))


@pytest.mark.slow
@pytest.mark.parametrize(
    "raws",
    [
        (CHANNELS, *[TURNS] * 8),
        [TURNS] * 8,
        [EMPTY * 100_000] * 20,
        [record(4, b"") * 90_000] * 20,
    ],
    ids=["channels", "unknown channels", "foreign records", "definitions"],
)
def test_records_that_are_work_for_nothing_are_told(
    raws: Sequence[bytes], tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(
        MAGIC + record(1, bytes(8)) + b"".join(record(6, chunk(raw)) for raw in raws)
    )
    scan = Scan(path, lambda topic: True)
    assert sum(len(batch.payloads) for batch in scan.batches()) < 3 * PIECES
    assert any("more channels and definitions" in loss for loss in scan.losses)
    robot = str(SAMPLES / "one_joint" / "robot.toml")
    assert answer(["inspect", str(path), "-r", robot])[::2] == (2, "")


@pytest.mark.parametrize("opcode", [0, 5, 6])
def test_a_hole_of_terabytes_is_not_read(opcode: int, tmp_path: Path) -> None:
    """A file of a few bytes on disk: nothing, a message or a chunk that reaches to its
    end.
    """
    path, size = tmp_path / "log.mcap", 1 << 42
    head = MAGIC + record(1, bytes(8))
    length = size - len(head) - RECORD.size
    begin = (
        RECORD.pack(opcode, length)
        + CHUNK.pack(0, 1, 9, 0, 0)
        + struct.pack("<Q", length - 40)
    )
    with path.open("wb") as file:
        file.write(head + begin)
        file.truncate(size)
    scan = Scan(path, lambda topic: True)
    assert not list(scan.batches())
    assert any("breaks off" in loss for loss in scan.losses)


def test_a_definition_of_megabytes_is_not_parsed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(parsers, "is_usual", None)
    monkeypatch.setattr(parsers, "schema_parser", None)
    text = b"float64 x\n" * parsers.LONGEST
    schema = Schema(1, text, "ros2msg", "sensor_msgs/msg/JointState")
    assert parsers.decoder("cdr", schema, "joint_state", NameMap(())) is None


def test_too_little_memory_is_not_told_as_damage(tmp_path: Path) -> None:
    error = damaged(
        tmp_path / "log.parquet", pa.ArrowMemoryError("malloc of size 64 failed")
    )
    assert re.search("too little memory.*malloc of size 64", error.message)


def zeros(count: int) -> pa.Array:
    return pa.array(np.zeros(count, np.int8))


def one_value() -> pa.Table:
    one = pa.DictionaryArray.from_arrays(zeros(ROOM // 8), pa.array([0.0]))
    return pa.table({"time": one, "j.position": one})


def lists() -> pa.Table:
    offsets = pa.array(np.linspace(0, ROOM // 4, 101).astype(np.int32))
    values = pa.ListArray.from_arrays(offsets, zeros(ROOM // 4))
    return pa.table({"time": np.arange(100.0), "position": values})


@pytest.mark.parametrize(
    "table", [one_value, pytest.param(lists, marks=pytest.mark.slow)]
)
def test_a_table_of_one_value_is_refused(
    table: Callable[[], pa.Table], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(table(), path)
    with pytest.raises(InputError, match="times as many") as caught:
        opened_table(path)
    assert caught.value.where == str(path)
    assert main(["inspect", str(path)]) == 2
    said = capsys.readouterr().err
    assert str(path) in said
    assert "bug" not in said


@pytest.mark.parametrize("plain", [True, False])
def test_texts_are_not_read(
    plain: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = pa.DictionaryArray.from_arrays(zeros(1000), pa.array(["x" * 9]))
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"time": texts}), path, store_schema=not plain)
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    with pytest.raises(InputError, match="'time' holds string"):
        next(read_tables(path, ["time"], rows=None))


@pytest.mark.parametrize(
    "text", [".".join("a" * 1000) + " = 1", f"[{' . '.join('a' * 1000)}]"]
)
def test_a_key_of_many_parts_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(f'schema = "seqid/robot@1"\n{text}\n')
    with pytest.raises(ConfigError, match="32 parts") as caught:
        load_robot(path)
    assert caught.value.where == str(path)
