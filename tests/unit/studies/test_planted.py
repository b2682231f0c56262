"""A part of the table of planted faults: each is said by the stage, and sound logs are good."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from seqid_cli import identify
from tests.studies.planted.arms import ARMS
from tests.studies.planted.study import FAULTS, answers, excused

BENCH = ARMS[0]()
STAGES = ("gravity", "imu-calib", "inertia", "simultaneous", "predict")
BY_NAME = {fault.name: fault for fault in FAULTS}


@pytest.fixture
def clean(tmp_path: Path) -> Path:
    """A folder with the sound result under the name of every stage."""
    folder = tmp_path / "clean"
    folder.mkdir()
    for stage in ("friction", "gravity", "inertia"):
        shutil.copy(BENCH.folder / "golden.json", folder / f"{stage}.json")
    return folder


@pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")
@pytest.mark.parametrize(
    "name", ["none", "wrong sign of a current", "amperes as torque", "degrees", "one spike"]
)
def test_the_stage_says_it(name: str, clean: Path, tmp_path: Path) -> None:
    fault, folder = BY_NAME[name], tmp_path / "faulty"
    folder.mkdir()
    found = answers(BENCH, fault, clean, folder, STAGES)
    for stage, cell in found.items():
        if name == "none":
            assert cell.answer == "good", (stage, cell.reasons)
        elif not excused(fault, stage, BENCH):
            assert cell.answer in ("poor", "refused"), stage
            assert cell.answer == "refused" or any("joint_1" in r for r in cell.reasons)


@pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")
def test_a_spike_does_not_spoil_the_prediction(tmp_path: Path) -> None:
    """One damaged sample used to make the error seven times as large."""
    logs = sorted((BENCH.folder / "validation").glob("*.parquet"))
    robot, golden = BENCH.folder / "robot.toml", BENCH.folder / "golden.json"
    sound = identify.predict(logs, robot, golden)
    shutil.copy(robot, tmp_path)
    spiked = answers_of_spike(logs, tmp_path)
    found = identify.predict(spiked, robot, golden)
    assert found.joints["joint_1"].rmse == pytest.approx(sound.joints["joint_1"].rmse, rel=0.03)
    assert not any(verdict.good for verdict in found.verdicts if not verdict.joint)


def answers_of_spike(logs: list[Path], folder: Path) -> list[Path]:
    """The same logs, the one in the middle with one damaged sample."""
    from tests.studies.planted.study import _planted

    return list(_planted(BENCH, BY_NAME["one spike"], logs, folder / "logs"))
