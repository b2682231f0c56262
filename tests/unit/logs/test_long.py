"""Long logs passed over, and pieces of logs, against the same logs read as a whole."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.log_file import LogFile, likely_rows
from seqid_cli.logs.long import open_long
from seqid_cli.logs.mcap import reader
from seqid_cli.logs.pieces import read_pieces
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording, cut
from seqid_cli.logs.storage.spool import Spool
from seqid_cli.logs.tables import parquet
from seqid_cli.motion.blocks import joined
from tests import Array
from tests.unit.logs import samples
from tests.unit.logs.samples import (
    ARRAY,
    GYRO,
    JOINTS,
    curve,
    grid,
    make_motion,
    make_robot,
)
from tests.unit.logs.writers import write_parquet

ROBOT = make_robot(imus=(ARRAY, GYRO))
RANGES = [(3.0, 7.5), (12.0, 14.0), (6.0, 9.0)]  # two of them overlap
SAMPLES, START = 2000, 40.0
NOISE = np.random.default_rng(3).uniform(-1.0, 1.0, SAMPLES)


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "BLOCK_ROWS", 300)
    for read in (parquet.read_tables, parquet.read_blocks, reader.read_blocks):
        monkeypatch.setitem(read.__kwdefaults__, "rows", 300)


def written(folder: Path, form: str = "parquet") -> Path:
    motion = make_motion(grid(SAMPLES))
    if form == "mcap":
        return samples.write_motion(folder / "log.mcap", motion)
    warm = 20.0 + 0.1 * motion.t[:, None] + np.arange(3.0)
    later = replace(motion, t=START + motion.t)
    return samples.write_motion(folder / "log.parquet", later, temperature=warm)


def without_imus(folder: Path) -> Path:
    motion = replace(make_motion(grid(SAMPLES)), accelerometers={}, gyros={})
    return samples.write_motion(folder / "log.mcap", motion)


def with_torque(folder: Path, t: Array, tau: Array | None = None) -> Path:
    torque = 20 * curve(t, 3, 1.0) if tau is None else tau
    return write_parquet(folder / "log.parquet", t, JOINTS, curve(t, 3), torque=torque)


def uneven(folder: Path) -> Path:
    t = grid(SAMPLES, 250.0) + 4e-4 * NOISE
    t[1_100:] += 1.5
    return with_torque(folder, t)


@pytest.mark.parametrize(
    ("write", "gaps", "tolerance"),
    [(written, 0, 0.0), (without_imus, 0, 1e-12), (uneven, 1, 1e-9)],
    ids=["even", "mcap", "uneven"],
)
def test_samples_base_and_warnings_are_those_of_the_whole_log(
    tmp_path: Path, write: Callable[[Path], Path], gaps: int, tolerance: float
) -> None:
    path = write(tmp_path)
    whole, log = read_recording(path, make_robot()), open_long(path, make_robot())
    assert SAMPLES <= likely_rows(path) < SAMPLES + 1
    parts = list(log.blocks())
    starts = np.cumsum([0, *(part.samples for part in parts)])
    assert [part.start for part in parts] == starts[:-1].tolist()
    found = joined(parts)
    np.testing.assert_allclose(found.q, whole.q, rtol=0, atol=tolerance)
    np.testing.assert_allclose(found.tau, whole.tau, rtol=0, atol=20 * tolerance)
    np.testing.assert_array_equal(found.valid, whole.valid)
    assert log.base.exact == (write is not uneven)
    assert log.rate_hz == pytest.approx(whole.rate_hz, rel=1e-12)
    assert len(log.base.gaps) == gaps
    np.testing.assert_allclose(log.base.gaps, whole.health.gaps, rtol=0, atol=1e-8)
    assert (log.samples, log.sha256) == (len(whole.t), whole.sha256)
    assert log.warnings == whole.health.warnings


@pytest.mark.parametrize("fault", ["nan", "backwards", "huge"])
def test_what_has_to_be_read_as_a_whole(fault: str, tmp_path: Path) -> None:
    t = grid(SAMPLES)
    tau = 20 * curve(t, 3, 1.0)
    if fault == "backwards":
        t[1_234] = t[1_230]
    else:
        tau[1_234, 1] = {"nan": np.nan, "huge": 1e12}[fault]
    assert open_long(with_torque(tmp_path, t, tau), make_robot()) is None


@pytest.mark.parametrize("spooled", [False, True])
def test_a_log_that_changes_between_two_passes_is_refused(
    spooled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither mixed with what was read before nor told as what the result is
    made of.
    """
    if not spooled:
        monkeypatch.setattr(Spool, "complete", False)
    path = with_torque(tmp_path, grid(SAMPLES))
    log = open_long(path, make_robot())
    log.sha256  # noqa: B018  # as it was
    with_torque(tmp_path, grid(SAMPLES)).rename(tmp_path / "other.parquet").replace(
        path
    )
    if not spooled:
        with pytest.raises(InputError, match="changed while"):
            list(log.blocks())
    with pytest.raises(InputError, match="changed while"):
        log.sha256  # noqa: B018
    path.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        log.sha256  # noqa: B018


def assert_same(one: Recording, other: Recording) -> None:
    assert (one.sha256, one.source_log) == (
        other.sha256,
        other.source_log,
    )
    assert one.start == pytest.approx(other.start, abs=1e-6)
    assert one.rate_hz == pytest.approx(other.rate_hz, rel=1e-9)
    for name in (
        "t",
        "q",
        "tau",
        "dq",
        "temperature",
        "valid",
        "accelerometers",
        "gyros",
    ):
        mine, theirs = getattr(one, name), getattr(other, name)
        if not isinstance(mine, dict):
            mine, theirs = {name: mine}, {name: theirs}
        assert mine.keys() == theirs.keys()
        for key, values in mine.items():
            assert (values is None) == (theirs[key] is None), key
            if values is not None:
                np.testing.assert_allclose(
                    values, theirs[key], rtol=0, atol=1e-12, err_msg=key
                )


@pytest.mark.parametrize("form", ["parquet", "mcap"])
def test_pieces_of_a_log_that_is_passed_over_are_cut_out_of_it(
    form: str, tmp_path: Path
) -> None:
    path = written(tmp_path, form)
    held, long = read_recording(path, ROBOT), open_long(path, ROBOT)
    assert long.whole == held.whole
    expected = cut(held, RANGES)
    found = long.pieces(RANGES)
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other)
    assert (found[0].temperature is None) == (form == "mcap")
    assert set(found[0].accelerometers) == {"array", "hand"}
    rows = [slice(round(100 * begin), round(100 * end) + 1) for begin, end in RANGES]
    for one, own in zip(found, rows, strict=True):
        np.testing.assert_array_equal(one.q, held.q[own])
        np.testing.assert_allclose(one.t + one.offset, held.t[own], atol=1e-9)


def test_pieces_of_uneven_stamps(tmp_path: Path) -> None:
    path = with_torque(tmp_path, START + grid(SAMPLES) + 0.001 * NOISE)
    held, long = read_recording(path, make_robot()), open_long(path, make_robot())
    for piece in long.pieces(RANGES):
        at = piece.start - held.start + piece.t
        expected = np.column_stack([np.interp(at, held.t, q) for q in held.q.T])
        np.testing.assert_allclose(piece.q, expected, atol=2e-5)


@pytest.mark.parametrize(
    ("moved", "first", "said"),
    [(0.0, 100.0, "no longer holds the rows 100 s on"), (15.0, 4.95, "only 5 samples")],
)
def test_rows_that_are_gone(
    tmp_path: Path, moved: float, first: float, said: str
) -> None:
    path = written(tmp_path)
    whole = read_recording(path, ROBOT).whole
    whole = replace(whole, start=whole.start + moved)
    with pytest.raises(InputError, match=said):
        read_pieces(LogFile.at(path), ROBOT, whole, [(first, first + 5.0)])
