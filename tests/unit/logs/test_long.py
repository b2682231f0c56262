"""Long logs passed over against the same logs read as a whole."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs import long as module
from seqid_cli.logs.long import Block, LongLog, likely_rows, open_long
from seqid_cli.logs.raw import RawLog, TimeSource
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.storage import temporary
from seqid_cli.logs.tables import parquet
from seqid_cli.motion.blocks import joined, open_surveyed
from seqid_cli.robot.types import Robot
from tests import Array
from tests.unit.logs.samples import JOINTS, curve, make_robot
from tests.unit.logs.writers import write_mcap, write_parquet

SAMPLES = 3_000


def all_of(log: LongLog) -> Block:
    """All samples of a log."""
    parts = list(log.blocks())
    starts = np.cumsum([0, *(part.samples for part in parts)])
    assert [part.start for part in parts] == starts[:-1].tolist()
    return joined(parts)


def check(path: Path, robot: Robot, *, tolerance: float = 0.0) -> LongLog:
    """The samples, their base and the warnings are those of the whole log."""
    whole, log = read_recording(path, robot), open_long(path, robot)
    assert log is not None
    assert whole.tau is not None
    found = all_of(log)
    np.testing.assert_allclose(found.q, whole.q, rtol=0, atol=tolerance)
    np.testing.assert_allclose(found.tau, whole.tau, rtol=0, atol=20 * tolerance)
    np.testing.assert_array_equal(found.valid, whole.valid)
    assert log.rate_hz == pytest.approx(whole.rate_hz, rel=1e-12)
    assert log.samples == len(whole.t)
    assert log.gaps == len(whole.health.gaps)
    assert log.sha256 == whole.sha256
    assert log.warnings == whole.health.warnings
    return log


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "BLOCK_ROWS", 700)
    monkeypatch.setattr(parquet.read_tables, "__kwdefaults__", {"rows": 700})
    monkeypatch.setattr(parquet.read_blocks, "__kwdefaults__", {"rows": 700})


def write(path: Path, t: Array, *, torque: Array | None = None) -> Path:
    """A Parquet log with torque."""
    tau = 20 * curve(t, 3, 1.0) if torque is None else torque
    return write_parquet(path, t, JOINTS, curve(t, 3), torque=tau)


def test_even_stamps(tmp_path: Path) -> None:
    log = check(write(tmp_path / "log.parquet", np.arange(SAMPLES) / 250.0), make_robot())
    assert log.exact


def test_uneven_stamps_and_a_gap(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(SAMPLES) / 250.0 + rng.uniform(-4e-4, 4e-4, SAMPLES)
    t[1_700:] += 1.5
    log = check(write(tmp_path / "log.parquet", t), make_robot(), tolerance=1e-9)
    assert not log.exact
    assert log.gaps == 1


def test_mcap(tmp_path: Path) -> None:
    t = np.arange(SAMPLES) / 250.0
    path = write_mcap(
        tmp_path / "log.mcap", t, JOINTS, curve(t, 3), encoding="cdr", effort=20 * curve(t, 3, 1.0)
    )
    check(path, make_robot(), tolerance=1e-12)


@pytest.mark.parametrize("fault", ["nan", "backwards", "huge"])
def test_what_has_to_be_read_as_a_whole(fault: str, tmp_path: Path) -> None:
    t = np.arange(SAMPLES) / 250.0
    tau = 20 * curve(t, 3, 1.0)
    if fault == "nan":
        tau[1_234, 1] = np.nan
    elif fault == "huge":
        tau[1_234, 1] = 1e12
    else:
        t[1_234] = t[1_230]
    assert open_long(write(tmp_path / "log.parquet", t, torque=tau), make_robot()) is None


def test_how_long_a_log_is_without_reading_it(tmp_path: Path) -> None:
    t = np.arange(SAMPLES) / 250.0
    table = write(tmp_path / "log.parquet", t)
    bag = write_mcap(
        tmp_path / "log.mcap", t, JOINTS, curve(t, 3), encoding="cdr", effort=curve(t, 3)
    )
    for path in (table, bag):
        assert likely_rows(path) >= SAMPLES
        assert likely_rows(path) < SAMPLES + 1
    table.write_bytes(table.read_bytes()[:-5] + b"xxxxx")
    with pytest.raises(InputError, match=r"log\.parquet"):
        likely_rows(table)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("room", [True, False])
def test_an_even_log_is_surveyed_while_its_base_is_laid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, even: bool, room: bool
) -> None:
    if not room:
        monkeypatch.setattr(temporary.Spool.__init__, "__defaults__", (0, 0.25))
    samples = 6_000  # longer than the longest segment of a spectrum
    jitter = 0.0 if even else np.random.default_rng(4).uniform(-4e-4, 4e-4, samples)
    path = write(tmp_path / "log.parquet", np.arange(samples) / 250.0 + jitter)
    passes, reader = [], module.READERS["parquet"]

    def counted(path: Path, robot: Robot, time_source: TimeSource) -> Iterator[RawLog]:
        passes.append(path)
        return reader(path, robot, time_source)

    monkeypatch.setitem(module.READERS, "parquet", counted)
    log = open_surveyed(path, make_robot())
    assert log is not None
    assert log.survey is not None
    assert len(passes) == (1 if even or room else 2)
    assert log.survey.cutoff(np.zeros(3)).hz > 0
    assert pq.read_metadata(path).num_rows == log.samples


@pytest.mark.parametrize("spooled", [False, True])
def test_a_log_that_changes_between_two_passes_is_refused(
    spooled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither mixed with what was read before nor told as what the result is made of."""
    if not spooled:
        monkeypatch.setattr(temporary.Spool, "complete", False)
    path = write(tmp_path / "log.parquet", np.arange(SAMPLES) / 100.0)
    log = open_long(path, make_robot())
    assert log is not None
    log.sha256  # noqa: B018  # as it was
    other = write(tmp_path / "other.parquet", np.arange(SAMPLES) / 100.0)
    other.replace(path)
    if not spooled:
        with pytest.raises(InputError, match="changed while"):
            all_of(log)
    with pytest.raises(InputError, match="changed while"):
        log.sha256  # noqa: B018
    path.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        log.sha256  # noqa: B018
