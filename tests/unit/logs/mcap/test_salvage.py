"""Damaged MCAP files: what is lost is counted, the rest is used;
and memory stays flat.
"""

import re
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.reader import read_blocks
from tests.benchmarks.make_logs import JOINTS as PANDA
from tests.benchmarks.make_logs import write_cdr
from tests.unit.logs.samples import GYRO, JOINTS, grid, make_robot, read_raw
from tests.unit.logs.writers import rewrite, write_mcap

ROBOT = make_robot()
COUNT = 2_000
Q = np.random.default_rng(0).normal(size=(COUNT, 3))
compressions = pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "source.mcap"
    return write_mcap(path, grid(COUNT), JOINTS, Q, encoding="cdr", chunk_size=20_000)


def records(data: bytes, opcode: int) -> list[int]:
    found, at, kind = [], 8, 0
    while at + 9 <= len(data) and kind != 0x0F:
        kind, length = struct.unpack_from("<BQ", data, at)
        found += [at] if kind == opcode else []
        at += 9 + length
    return found


def read_rows(path: Path, least: int) -> tuple[int, str]:
    raw = read_raw(path, ROBOT)
    known = {row.tobytes(): i for i, row in enumerate(Q)}
    rows = np.ascontiguousarray(raw.joints.channels["position"])
    order = [known[row.tobytes()] for row in rows]
    assert order == sorted(set(order))
    assert len(order) >= least
    return len(order), raw.partial


@compressions
@pytest.mark.parametrize("damage", ["opcode", "length", "zeros"])
def test_reading_goes_on_behind_garbage(
    tmp_path: Path, source: Path, compression: str, damage: str
) -> None:
    path = rewrite(source, tmp_path / "log", compression=compression, chunk_size=20_000)
    data = bytearray(path.read_bytes())
    at = records(data, 0x06)[4]
    if damage == "opcode":
        data[at : at + 9] = b"\x55" + b"\xff" * 8
    elif damage == "length":
        struct.pack_into("<Q", data, at + 1, 1_234)
    else:
        data[at - 50 : at + 200] = bytes(250)
    path.write_bytes(data)
    read, partial = read_rows(path, int(0.8 * COUNT))
    assert "damaged bytes" in partial
    assert read == COUNT or f"{COUNT - read} of {COUNT} messages are lost" in partial


@pytest.mark.parametrize("chunking", [True, False])
def test_garbage_where_chunks_are_not_told(
    tmp_path: Path, source: Path, chunking: bool
) -> None:
    path = rewrite(source, tmp_path / "log", chunking=chunking, chunk_size=20_000)
    data = bytearray(path.read_bytes())
    data = data[: records(data, 0x0F)[0]]
    places = records(data, 0x06 if chunking else 0x05)
    at = places[len(places) // 2]
    data[at : at + 60] = b"\xee" * 60
    path.write_bytes(data)
    assert "breaks off in a record" in read_rows(path, int(0.3 * COUNT))[1]


@compressions
@pytest.mark.parametrize(
    ("chunk_size", "share"),
    [(20_000, 0.3), (20_000, 0.6), (20_000, 0.9), (1 << 22, 0.6)],
)
def test_blocks_of_a_cut_file(
    tmp_path: Path, source: Path, compression: str, chunk_size: int, share: float
) -> None:
    path = rewrite(
        source, tmp_path / "log", compression=compression, chunk_size=chunk_size
    )
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    blocks = list(read_blocks(path, ROBOT, rows=100))
    rows = np.vstack([block.joints.channels["position"] for block in blocks])
    np.testing.assert_array_equal(rows, Q[: len(rows)])
    assert COUNT / 8 < len(rows) < COUNT
    assert chunk_size > 20_000 or abs(len(rows) / COUNT - share) < 0.1
    *before, last = (block.partial for block in blocks)
    assert not any(before)
    assert re.search("breaks off.*messages were read", last)


def test_recording_that_was_not_closed_or_holds_nothing(
    tmp_path: Path, source: Path
) -> None:
    path = rewrite(source, tmp_path / "log", chunking=False, index=False, summary=False)
    data = path.read_bytes()
    path.write_bytes(data[: records(data, 0x0F)[-1]])
    assert "not closed" in read_rows(path, COUNT)[1]
    path.write_bytes(data[:60])
    with pytest.raises(InputError, match="nothing can be salvaged"):
        read_raw(path, ROBOT)


def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    robot = make_robot(PANDA, imus=(GYRO,))

    def peak(count: int) -> int:
        path = write_cdr(tmp_path / str(count), count)
        tracemalloc.start()
        assert all(
            len(block.joints) < 8_000 for block in read_blocks(path, robot, rows=2_000)
        )
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    assert peak(60_000) < 1.2 * peak(10_000)
