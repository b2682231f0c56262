"""Damaged MCAP files: what is lost is counted, the rest is used; and memory stays flat."""

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


@pytest.fixture(scope="module")
def q() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(COUNT, 3))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory, q: np.ndarray) -> Path:
    path = tmp_path_factory.mktemp("logs") / "source.mcap"
    return write_mcap(path, grid(COUNT), JOINTS, q, encoding="cdr", chunk_size=20_000)


def records(data: bytes, opcode: int) -> list[int]:
    """Where the records of a kind begin."""
    found, at = [], 8
    while at + 9 <= len(data):
        kind, length = struct.unpack_from("<BQ", data, at)
        if kind == opcode:
            found.append(at)
        at += 9 + length
        if kind == 0x0F:
            break
    return found


def assert_rows_of(path: Path, q: np.ndarray, least: int) -> str:
    """The rows that are read are rows of the log, in order; returns what was said."""
    raw = read_raw(path, ROBOT)
    rows = raw.joints.channels["position"]
    known = {row.tobytes(): i for i, row in enumerate(q)}
    order = [known[row.tobytes()] for row in np.ascontiguousarray(rows)]
    assert order == sorted(set(order))
    assert len(order) >= least
    return raw.partial


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
@pytest.mark.parametrize("damage", ["opcode", "length", "zeros"])
def test_reading_goes_on_behind_garbage(
    tmp_path: Path, source: Path, q: np.ndarray, compression: str, damage: str
) -> None:
    path = rewrite(source, tmp_path / "log", compression=compression, chunk_size=20_000)
    data = bytearray(path.read_bytes())
    chunks = records(data, 0x06)
    assert len(chunks) > 10
    at = chunks[4]
    if damage == "opcode":
        data[at] = 0x55
        data[at + 1 : at + 9] = b"\xff" * 8
    elif damage == "length":
        struct.pack_into("<Q", data, at + 1, 1_234)
    else:
        data[at - 50 : at + 200] = bytes(250)
    path.write_bytes(data)
    partial = assert_rows_of(path, q, int(0.8 * COUNT))
    assert "damaged bytes" in partial
    lost = COUNT - len(read_raw(path, ROBOT).joints)
    assert not lost or f"{lost} of {COUNT} messages are lost" in partial


@pytest.mark.parametrize("chunking", [True, False])
def test_garbage_where_nothing_tells_the_chunks(
    tmp_path: Path, source: Path, q: np.ndarray, chunking: bool
) -> None:
    path = rewrite(source, tmp_path / "log", chunking=chunking, chunk_size=20_000)
    data = bytearray(path.read_bytes())
    data = data[: records(data, 0x0F)[0]]
    places = records(data, 0x06 if chunking else 0x05)
    at = places[len(places) // 2]
    data[at : at + 60] = b"\xee" * 60
    path.write_bytes(data)
    assert "breaks off in a record" in assert_rows_of(path, q, int(0.3 * COUNT))


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
@pytest.mark.parametrize(
    ("chunk_size", "share"), [(20_000, 0.3), (20_000, 0.6), (20_000, 0.9), (1 << 22, 0.6)]
)
def test_blocks_of_a_cut_file(
    tmp_path: Path, source: Path, q: np.ndarray, compression: str, chunk_size: int, share: float
) -> None:
    path = rewrite(source, tmp_path / "log", compression=compression, chunk_size=chunk_size)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    blocks = list(read_blocks(path, ROBOT, rows=100))
    rows = np.vstack([block.joints.channels["position"] for block in blocks])
    np.testing.assert_array_equal(rows, q[: len(rows)])
    assert COUNT / 8 < len(rows) < COUNT
    assert chunk_size > 20_000 or abs(len(rows) / COUNT - share) < 0.1
    assert [bool(block.partial) for block in blocks] == [False] * (len(blocks) - 1) + [True]
    assert "breaks off" in blocks[-1].partial
    assert "messages were read" in blocks[-1].partial


def test_recording_that_was_not_closed(tmp_path: Path, source: Path, q: np.ndarray) -> None:
    path = rewrite(source, tmp_path / "log", chunking=False, index=False, summary=False)
    data = path.read_bytes()
    path.write_bytes(data[: records(data, 0x0F)[-1]])
    assert "not closed" in assert_rows_of(path, q, COUNT)


def test_nothing_to_salvage_is_an_error(tmp_path: Path, source: Path) -> None:
    (tmp_path / "log").write_bytes(source.read_bytes()[:60])
    with pytest.raises(InputError, match="nothing can be salvaged"):
        read_raw(tmp_path / "log", ROBOT)


def test_blocks_of_a_file_without_joints(tmp_path: Path, source: Path) -> None:
    path = rewrite(source, tmp_path / "log", keep=lambda topic: False)
    with pytest.raises(InputError, match="no messages on /joint_states"):
        list(read_blocks(path, ROBOT))
    with pytest.raises(InputError, match="names in the log"):
        list(read_blocks(source, make_robot(["other"])))


def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    robot = make_robot(PANDA, imus=(GYRO,))

    def peak(count: int) -> int:
        path = write_cdr(tmp_path / str(count), count)
        tracemalloc.start()
        for block in read_blocks(path, robot, rows=2_000):
            assert len(block.joints) < 8_000
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    short = peak(10_000)
    assert peak(60_000) < 1.2 * short
