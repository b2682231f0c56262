"""The inertia stage on logs that are passed over against the same logs held in memory."""

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid import inertia_equations
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.logs.read import read_recording
from seqid_cli.motion import blocks
from seqid_cli.motion.blocks import SurveyedLog, open_surveyed
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.seven_joint import known_friction, write_arm, write_log

SAMPLES = 12_000
OPTIONS = InertiaOptions(source="encoder", motion=MotionOptions(cutoff_hz=12.0), neighbours=())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A seven-joint arm and a log of it."""
    folder = tmp_path_factory.mktemp("arm")
    robot = load_robot(write_arm(folder))
    write_log(folder / "log.parquet", robot, SAMPLES)
    return folder


@pytest.fixture(scope="module")
def robot(folder: Path) -> Robot:
    """The arm."""
    return load_robot(folder / "robot.toml")


@pytest.fixture(scope="module")
def held(folder: Path, robot: Robot) -> RigidStage:
    """The stage from the log as a whole."""
    recording = read_recording(folder / "log.parquet", robot)
    return identify_inertia([recording], robot, known_friction(), options=OPTIONS)


def surveyed(path: Path, robot: Robot) -> SurveyedLog:
    """A log to be passed over."""
    log = open_surveyed(path, robot)
    assert log is not None
    return log


def same(found: RigidStage, expected: RigidStage) -> None:
    """Parameters within a thousandth of a standard error, and all else that is reported."""
    assert [p.name for p in found.parameters] == [p.name for p in expected.parameters]
    assert len(expected.parameters) == 43
    for a, b in zip(found.parameters, expected.parameters, strict=True):
        assert abs(a.value - b.value) < 1e-3 * b.std_error, a.name
        # Leaving out one of few blocks leaves little: the jackknife magnifies rounding.
        assert a.std_error == pytest.approx(b.std_error, rel=1e-3)
    assert found.rank == expected.rank
    assert found.condition == pytest.approx(expected.condition, rel=1e-5)
    assert found.rmse == pytest.approx(expected.rmse, rel=1e-6)
    assert found.cutoff_hz == pytest.approx(expected.cutoff_hz)
    assert [v.good for v in found.verdicts] == [v.good for v in expected.verdicts]
    assert found.not_excited == expected.not_excited


@pytest.mark.parametrize("least", [1_000, 32_768])
def test_the_parameters_are_those_of_the_held_log(
    folder: Path, robot: Robot, held: RigidStage, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks, "LEAST_BLOCK", least)
    monkeypatch.setattr(inertia_equations, "LEAST_CHUNKS", 1)
    log = surveyed(folder / "log.parquet", robot)
    same(identify_inertia([log], robot, known_friction(), options=OPTIONS), held)


def test_the_bits_do_not_tell_how_the_file_was_cut(
    folder: Path, robot: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(pq.read_table(folder / "log.parquet"), path, row_group_size=997)
    first, second = (
        identify_inertia([surveyed(p, robot)], robot, known_friction(), options=OPTIONS)
        for p in (folder / "log.parquet", path)
    )
    assert first.parameters == second.parameters
    assert first.covariance == second.covariance


def test_a_log_shorter_than_the_filter_is_refused(
    folder: Path, robot: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(pq.read_table(folder / "log.parquet").slice(0, 400), path)
    options = InertiaOptions(source="encoder", motion=MotionOptions(cutoff_hz=2.0))
    with pytest.raises(InputError, match="long enough"):
        identify_inertia([surveyed(path, robot)], robot, known_friction(), options=options)
