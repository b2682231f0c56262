"""`seqid plan`: files, exit codes, messages."""

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from seqid_cli.params.results.plan import PLAN_SCHEMA
from tests import ROOT
from tests.commands.conftest import Rig
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


def test_the_dry_run_is_slower(rig: Rig) -> None:
    for name, more in (("full", ()), ("slow", ("--speed-scale", "0.5"))):
        done = rig.run("plan", "inertia", "-r", TWO, "--trajectories", name, *SHORT, *more)
        assert done.code == 0, done.err
    name = next((rig.folder / "full").glob("*.csv")).name
    full, slow = (rows_of(rig.folder / folder / name)[1] for folder in ("full", "slow"))
    assert slow[:, 0] == pytest.approx(2 * full[:, 0])
    assert slow[:, 1:3] == pytest.approx(full[:, 1:3])
    assert slow[:, 3:5] == pytest.approx(full[:, 3:5] / 2, abs=1e-6)  # six decimals
    assert slow[:, 5:] == pytest.approx(full[:, 5:] / 4, abs=1e-6)  # six decimals


def test_a_robot_without_limits_is_told(rig: Rig) -> None:
    done = rig.run("plan", "inertia", "-r", "robot.toml")
    assert (done.code, done.out) == (2, "")
    assert "has no position_limits, neither here nor in a URDF" in done.err
    assert "--lock" in done.err


def test_a_plan_that_cannot_reach_full_rank_is_poor(rig: Rig) -> None:
    arguments = ("plan", "inertia", "-r", TWO, "--lock", "joint_2", *SHORT)
    done = rig.run(*arguments)
    assert done.code == 0
    assert "rank" in done.err
    assert "not excited" in done.err
    assert rig.run(*arguments, "--strict").code == 1


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (("--share", "1.5"), "1.5 is not above 0 and at most 1"),
        (("--ramp", "-1"), "-1.0 is not a positive time"),
        (("--duration", "1"), "--duration 1 s is shorter than one move"),
        (("--lock", "elbow"), "--lock names no joint: 'elbow'"),
        (("--trajectories", TWO), "is a file, not a folder"),
        (("-p", "none.json"), "none.json"),
    ],
)
def test_mistakes_are_told(rig: Rig, more: tuple[str, ...], text: str) -> None:
    done = rig.run("plan", "inertia", "-r", TWO, *more)
    assert done.code == 2
    assert text in done.err


def test_have_is_for_the_inertia_stage(rig: Rig) -> None:
    logs = str(SAMPLES / "two_joint" / "inertia")
    done = rig.run("plan", "friction", "-r", TWO, "--have", logs)
    assert done.code == 2
    assert "--have counts for inertia and discriminate, not for friction" in done.err
    short = ("--duration", "8", "--move-duration", "4")
    assert rig.run("plan", "inertia", "-r", TWO, "--have", logs, *short).code == 0
    assert rig.run("plan", "inertia", "-r", TWO, "--have", "none.parquet").code == 2
