"""Stages on logs that are passed over against the same logs held in memory."""

import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.identify.friction_surface.trials import trials_of
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.least_squares import Accumulator
from seqid_cli.identify.rigid import inertia, inertia_equations
from seqid_cli.identify.rigid.drive_columns import Drives
from seqid_cli.identify.rigid.inertia import LogRows, identify_inertia
from seqid_cli.logs.long import open_long
from seqid_cli.logs.read import read_recording
from seqid_cli.motion import blocks
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.motions.trajectories import join, sweeps
from tests.plants.robots.seven_joint import (
    JOINTS,
    RATE_HZ,
    known_friction,
    write_arm,
    write_log,
)
from tests.plants.sensors import quantise
from tests.unit.logs.writers import write_parquet

OPTIONS = InertiaOptions(
    source="encoder", motion=MotionOptions(cutoff_hz=12.0), neighbours=()
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    write_log(folder / "log.parquet", load_robot(write_arm(folder)), 12_000)
    return folder


@pytest.fixture(scope="module")
def robot(folder: Path) -> Robot:
    return load_robot(folder / "robot.toml")


def inertia_of(
    path: Path, robot: Robot, options: InertiaOptions = OPTIONS
) -> RigidStage:
    opened = [open_long(path, robot)]
    return identify_inertia(opened, robot, known_friction(), options=options).inertia


@pytest.fixture(scope="module")
def held(folder: Path, robot: Robot) -> RigidStage:
    recording = read_recording(folder / "log.parquet", robot)
    return identify_inertia(
        [recording], robot, known_friction(), options=OPTIONS
    ).inertia


@pytest.mark.parametrize("least", [1_000, 32_768])
def test_inertia_is_that_of_the_held_log(
    folder: Path,
    robot: Robot,
    held: RigidStage,
    least: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(blocks, "LEAST_BLOCK", least)
    monkeypatch.setattr(inertia_equations, "LEAST_CHUNKS", 1)
    found = inertia_of(folder / "log.parquet", robot)
    assert [p.name for p in found.parameters] == [p.name for p in held.parameters]
    assert len(held.parameters) == 43
    for a, b in zip(found.parameters, held.parameters, strict=True):
        assert abs(a.value - b.value) < 1e-3 * b.std_error, a.name
        # Leaving out one of few blocks leaves little: the jackknife magnifies rounding.
        assert a.std_error == pytest.approx(b.std_error, rel=1e-3)
    for name, rel in {
        "rank": 0,
        "condition": 1e-5,
        "rmse": 1e-6,
        "cutoff_hz": 1e-6,
    }.items():
        assert getattr(found, name) == pytest.approx(getattr(held, name), rel=rel)
    assert [v.good for v in found.verdicts] == [v.good for v in held.verdicts]
    assert found.not_excited == held.not_excited


def test_bits_do_not_tell_how_the_file_was_cut(
    folder: Path, robot: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(pq.read_table(folder / "log.parquet"), path, row_group_size=997)
    first, second = (inertia_of(p, robot) for p in (folder / "log.parquet", path))
    assert first.parameters == second.parameters
    assert first.covariance == second.covariance


def test_a_log_shorter_than_the_filter_is_told(
    folder: Path, robot: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(pq.read_table(folder / "log.parquet").slice(0, 400), path)
    options = InertiaOptions(source="encoder", motion=MotionOptions(cutoff_hz=2.0))
    with pytest.raises(InputError, match="long enough"):
        inertia_of(path, robot, options)


def test_rows_of_a_log_are_let_go_of_before_the_next_but_one_is_read(
    folder: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = read_recording(folder / "log.parquet", robot)
    logs = [
        replace(recording, path=Path(f"{number}.parquet"), sha256=str(number))
        for number in range(4)
    ]
    rows_of_logs: list[weakref.ref[LogRows]] = []
    n_alive: list[int] = []
    rows_of_log = inertia._rows_of_log

    def counted(*arguments: Any) -> LogRows:
        n_alive.append(sum(rows() is not None for rows in rows_of_logs))
        rows = rows_of_log(*arguments)
        rows_of_logs.append(weakref.ref(rows))
        return rows

    monkeypatch.setattr(inertia, "_rows_of_log", counted)
    found = identify_inertia(logs, robot, known_friction(), options=OPTIONS).inertia
    assert n_alive == [0, 1, 1, 1]
    assert [use.log for use in found.motion_use] == [str(log.path) for log in logs]


def test_a_comparison_of_cutoffs_keeps_no_motion_and_makes_no_friction_anew(
    folder: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = read_recording(folder / "log.parquet", robot)
    kept: dict[Any, Any] = {}
    options = replace(
        OPTIONS, motion=replace(OPTIONS.motion, kept=kept), neighbours=(0.8, 1.25)
    )
    made: list[Drives] = []

    def counted(*arguments: Any) -> Drives:
        made.append(Drives(*arguments))
        return made[-1]

    monkeypatch.setattr(inertia_equations, "Drives", counted)
    identify_inertia([recording], robot, known_friction(), options=options)
    assert len(kept) == 1
    assert len(made) == 1


def test_one_factor_for_all_blocks_says_as_much_of_a_log() -> None:
    rng = np.random.default_rng(0)
    rows = Accumulator(4)
    for _ in range(3):
        rows.add(rng.normal(size=(20, 4)), rng.normal(size=20))
    joined = rows.joined()
    assert len(joined.blocks) == 1
    assert joined.samples == rows.samples
    np.testing.assert_array_equal(joined.total, rows.total)
    np.testing.assert_array_equal(
        joined.with_fixed(3, 0.5).total, rows.with_fixed(3, 0.5).total
    )


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1_000, 20_000])
def test_trials_are_those_of_the_held_log(
    rows: int, robot: Robot, tmp_path: Path
) -> None:
    """To the last bit; one joint moves without a pause for a long time."""
    home, parts = np.zeros(len(JOINTS)), []
    for joint, speeds, dwell in (
        (0, [0.2, 0.7], 0.4),
        (1, [0.2] * 15, 0.0),
        (5, [0.7, 1.0], 0.4),
    ):
        span = (-0.25, 0.25)
        parts.append(
            sweeps(home, joint, span, speeds, 4.0, rate_hz=RATE_HZ, dwell=dwell)
        )
    q = join(parts).q
    tau = np.random.default_rng(3).normal(size=q.shape) + 2.0 * np.sign(
        np.gradient(q, axis=0)
    )
    t, path = np.arange(len(q)) / RATE_HZ, tmp_path / "log.parquet"
    write_parquet(path, t, JOINTS, quantise(q, 1e-6), torque=tau)
    pq.write_table(pq.read_table(path), path, row_group_size=3_000)
    found = trials_of(robot, open_long(path, robot), 0, rows=rows)
    expected = trials_of(robot, read_recording(path, robot), 0)
    assert len(found) == len(expected) > 10
    for own, other in zip(found, expected, strict=True):
        assert (own.joint, own.velocity, own.weight) == (
            other.joint,
            other.velocity,
            other.weight,
        )
        for name in ("t", "q", "dq", "ddq", "tau", "configuration"):
            np.testing.assert_array_equal(getattr(own, name), getattr(other, name))
        for name in ("q", "dq", "ddq", "tau"):
            np.testing.assert_array_equal(
                getattr(own.ramps, name), getattr(other.ramps, name)
            )
            assert getattr(own.ramps, name).base is None  # no trial keeps its log alive
