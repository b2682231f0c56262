"""`seqid plan`: files, exit codes, messages."""

import json
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from seqid_cli.params.results.plan import PLAN_SCHEMA
from tests import ROOT
from tests.commands.conftest import Rig
from tests.commands.transcripts import check_transcript
from tests.unit.params.generate import schema_path

SAMPLES = ROOT / "sample_logs"
TWO = str(SAMPLES / "two_joint" / "robot.toml")
SHORT = ("--duration", "12", "--move-duration", "4")


def rows_of(path: Path) -> tuple[list[str], np.ndarray]:
    head = path.read_text().splitlines()[0].split(",")
    return head, np.loadtxt(path, delimiter=",", skiprows=1)


def test_a_plan_is_written_with_its_trajectories(rig: Rig) -> None:
    done = rig.run(
        "plan", "inertia", "-r", TWO, "-o", "plan.json", "--trajectories", "moves", *SHORT
    )
    assert done.code == 0, done.err
    plan = json.loads((rig.folder / "plan.json").read_text())
    jsonschema.validate(plan, json.loads(schema_path(PLAN_SCHEMA).read_text()))
    assert "3 moves, 12 s of motion" in done.out
    for move in plan["moves"]:
        head, rows = rows_of(rig.folder / "moves" / move["file"])
        assert head[:3] == ["time", "position_joint_1", "position_joint_2"]
        assert rows[-1, 0] == pytest.approx(4.0)
        assert rows[0, 1:3] == pytest.approx(list(move["start"].values()), abs=5e-7)
        speed = np.gradient(rows[:, 1], rows[:, 0])
        assert np.abs(speed - rows[:, 3]).max() < 0.02 * np.abs(rows[:, 3]).max() + 1e-6


def test_mistakes_are_told(rig: Rig) -> None:
    shutil.copy(TWO, rig.folder / "two.toml")
    check_transcript(rig, "plan")


def test_a_plan_that_cannot_reach_full_rank_is_poor(rig: Rig) -> None:
    arguments = ("plan", "inertia", "-r", TWO, "--lock", "joint_2", *SHORT)
    done = rig.run(*arguments)
    assert done.code == 0
    assert "warning: inertia: rank 3 of 4" in done.err
    assert "note: not excited: " in done.err
    assert rig.run(*arguments, "--strict").code == 1


def test_logs_that_are_there_count_as_well(rig: Rig) -> None:
    short, logs = ("--duration", "8", "--move-duration", "4"), str(SAMPLES / "two_joint/inertia")
    errors = []
    for more in ((), ("--have", logs)):
        done = rig.run("plan", "inertia", "-r", TWO, *short, *more, "--json")
        assert done.code == 0
        stage = json.loads(done.out)["stages"]["inertia"]
        errors.append(np.array([p["std_error"] for p in stage["parameters"]]))
    assert (errors[1] < errors[0]).all()
