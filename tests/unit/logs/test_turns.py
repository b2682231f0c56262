"""Encoders of one turn: positions run on, within the joints' limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.long import open_long
from seqid_cli.logs.mcap import reader
from seqid_cli.logs.pieces import read_parts
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.turns import in_turns
from seqid_cli.robot.types import Robot
from tests import Array
from tests.unit.logs.format_writers import (
    Data,
    Write,
    csv_own,
    mcap_cdr,
    parquet,
    rosbag2_sqlite,
)
from tests.unit.logs.test_formats import ONE, robot

TURN = 2.0 * np.pi
T = np.arange(0.0, 20.0, 0.01)
Limits = tuple[float, float] | None
LIMITS: list[Limits] = [(-3.0, 3.0), (-0.5, 6.0), None]


def written(path: Path, q: Array, write: Write = parquet) -> Path:
    column = q[:, None]
    dq = np.gradient(column, 0.01, axis=0)
    return write(path, Data(T, robot(ONE).joint_names, column, dq, column, column))


def limited(limits: Limits, prismatic: bool = False) -> Robot:
    joint = replace(robot(ONE).joints[0], position_limits=limits, prismatic=prismatic)
    return replace(robot(ONE), joints=(joint,))


@pytest.mark.slow
@pytest.mark.parametrize("write", [parquet, csv_own, mcap_cdr, rosbag2_sqlite])
@pytest.mark.parametrize("limits", LIMITS)
def test_wraps_run_on_within_the_limits(
    tmp_path: Path, write: Write, limits: Limits
) -> None:
    middle = sum(limits) / 2 if limits else 0.0
    q = middle - 2.0 * np.cos(T)
    log = written(tmp_path / "log", q % TURN, write)
    read = read_recording(log, limited(limits))
    np.testing.assert_allclose(read.q[:, 0], q, atol=1e-12)
    wraps = np.count_nonzero(np.diff(q // TURN))
    assert wraps == 0 or any(
        f"wraps by whole turns {wraps}" in w for w in read.health.warnings
    )
    if write in (parquet, mcap_cdr):
        assert (open_long(log, limited(limits)) is None) == (
            not np.array_equal(q % TURN, q)
        )
    for lost in (-TURN, TURN):  # before the log: no wrap in it
        log = written(tmp_path / "log", middle - 1.5 + np.sin(T) + lost)
        found = read_recording(log, limited(limits)).q[:, 0]
        np.testing.assert_allclose(found, middle - 1.5 + np.sin(T), atol=1e-12)


def test_wraps_run_on_in_every_part_of_a_long_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(reader.read_blocks.__kwdefaults__, "rows", 300)
    q = 2.0 * np.cos(T)
    log = written(tmp_path / "log", q % TURN, mcap_cdr)
    limits = limited((-3.0, 3.0))
    parts = list(read_parts(LogFile.at(log), limits, most_values=3000))
    assert len(parts) > 1
    for recording, _ in parts:
        first = round(recording.start * 100 - parts[0][0].start * 100)
        whole = q[first : first + recording.samples]
        np.testing.assert_allclose(recording.q[:, 0], whole, atol=1e-12)


WITHIN = 2.9 * np.sin(T)
OTHERS = {
    "within the limits": WITHIN,
    "degrees": np.rad2deg(WITHIN),
    "slide": np.sin(T) % TURN,
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_positions_stay_as_they_are(tmp_path: Path, name: str) -> None:
    log, arm = (
        written(tmp_path / "log", OTHERS[name]),
        limited((-3.0, 3.0), name == "slide"),
    )
    np.testing.assert_array_equal(read_recording(log, arm).q[:, 0], OTHERS[name])


@pytest.mark.parametrize("chance", [False, True])
def test_missing_values_and_other_jumps_stay(chance: bool) -> None:
    q = 2.0 * np.sin(T)[:, None]
    logged = q % TURN
    logged[100:103] = np.nan
    if chance:  # a single turn among other jumps
        logged = q.copy()
        logged[500:], logged[900, 0] = q[500:] + TURN, 1e200
    stream = Stream("joints", np.rint(T * 1e9).astype(np.int64), {"position": logged})
    moved, found = in_turns(stream, limited(None))
    wraps = int(np.count_nonzero(np.diff(np.sin(T) < 0)))
    assert found == ({} if chance else {robot(ONE).joint_names[0]: wraps})
    truth = np.where(np.isfinite(logged), logged if chance else q, np.nan)
    np.testing.assert_allclose(moved.channels["position"], truth)
