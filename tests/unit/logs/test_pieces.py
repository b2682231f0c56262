"""Pieces of logs against the same samples of the log as a whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.long import open_long
from seqid_cli.logs.mcap import reader
from seqid_cli.logs.pieces import cut, read_pieces, whole_of
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.tables import parquet
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot, write_motion
from tests.unit.logs.writers import write_parquet

ROBOT = make_robot(imus=(ARRAY, GYRO))
RANGES = [(3.0, 7.5), (12.0, 14.0), (6.0, 9.0)]  # two of them overlap
SAMPLES, START = 2000, 40.0


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    defaults = parquet.read_blocks.__kwdefaults__
    assert defaults is not None
    monkeypatch.setitem(defaults, "rows", 300)
    other = reader.read_blocks.__kwdefaults__
    assert other is not None
    monkeypatch.setitem(other, "rows", 700)


def written(folder: Path, form: str) -> Path:
    motion = make_motion(grid(SAMPLES))
    if form == "mcap":
        return write_motion(folder / "log.mcap", motion)
    warm = 20.0 + 0.1 * motion.t[:, None] + np.arange(3.0)
    later = replace(motion, t=START + motion.t)
    return write_motion(folder / "log.parquet", later, temperature=warm)


def assert_same(one: Recording, other: Recording) -> None:
    assert one.sha256 == other.sha256
    assert one.whole == other.whole
    assert one.start == pytest.approx(other.start, abs=1e-6)
    assert one.rate_hz == pytest.approx(other.rate_hz, rel=1e-9)
    for name in ("t", "q", "tau", "dq", "temperature", "valid"):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-12, err_msg=name)
    for found, expected in ((one.accelerometers, other.accelerometers), (one.gyros, other.gyros)):
        assert found.keys() == expected.keys()
        for imu, values in expected.items():
            np.testing.assert_allclose(found[imu], values, rtol=0, atol=1e-12, err_msg=imu)


@pytest.mark.parametrize("form", ["parquet", "mcap"])
def test_pieces_of_a_log_that_is_passed_over(form: str, tmp_path: Path) -> None:
    path = written(tmp_path, form)
    held, long = read_recording(path, ROBOT), open_long(path, ROBOT)
    assert long is not None
    assert whole_of(long) == whole_of(held)
    expected = cut(held, RANGES)
    found = read_pieces(path, ROBOT, whole_of(long), RANGES, kind=form)
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other)
    assert (found[0].temperature is None) == (form == "mcap")
    assert set(found[0].accelerometers) == {"array", "hand"}


def test_a_piece_keeps_its_place(tmp_path: Path) -> None:
    held = read_recording(written(tmp_path, "parquet"), ROBOT)
    pieces = cut(held, RANGES)
    assert [piece.offset for piece in pieces] == pytest.approx([3.0, 12.0, 6.0])
    assert [piece.start for piece in pieces] == pytest.approx([43.0, 52.0, 46.0])
    assert [piece.t[0] for piece in pieces] == [0.0] * 3
    assert [float(piece.t[-1]) for piece in pieces] == pytest.approx([4.5, 2.0, 3.0])
    assert len({piece.sha256 for piece in [held, *pieces]}) == 4
    assert {whole_of(piece) for piece in pieces} == {whole_of(held)}
    held.tau[310] = 77.0  # a piece does not keep the log in memory
    assert pieces[0].tau[10, 0] != 77.0


def test_uneven_stamps(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    motion = make_motion(grid(SAMPLES) + rng.uniform(-0.001, 0.001, SAMPLES))
    path = tmp_path / "log.parquet"
    write_parquet(path, motion.t + START, JOINTS, motion.q, torque=motion.tau)
    robot = make_robot()
    held, long = read_recording(path, robot), open_long(path, robot)
    assert long is not None
    for piece in read_pieces(path, robot, whole_of(long), RANGES, kind="parquet"):
        at = piece.start - held.start + piece.t
        for j in range(3):
            expected = np.interp(at, held.t, held.q[:, j])
            np.testing.assert_allclose(piece.q[:, j], expected, atol=2e-5)


def test_rows_that_are_gone(tmp_path: Path) -> None:
    path = written(tmp_path, "parquet")
    whole = whole_of(read_recording(path, ROBOT))
    with pytest.raises(InputError, match="no longer holds the rows 100 s on"):
        read_pieces(path, ROBOT, whole, [(100.0, 110.0)], kind="parquet")
    moved = replace(whole, start=whole.start + 15.0)
    with pytest.raises(InputError):
        read_pieces(path, ROBOT, moved, [(4.95, 9.0)], kind="parquet")


def test_pieces_of_other_formats_are_cut(tmp_path: Path) -> None:
    path = written(tmp_path, "parquet")
    held = read_recording(path, ROBOT)
    found = read_pieces(path, ROBOT, whole_of(held), RANGES)
    for one, other in zip(found, cut(held, RANGES), strict=True):
        assert_same(one, other)
