"""`--from`, `--to` and `--exclude`: on all commands, and in the result's inputs."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.commands.app import load_command
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import InputLog
from tests.commands.conftest import SAMPLE_LOGS, Rig
from tests.unit.params.documents import JOINTS

TWO = SAMPLE_LOGS / "two_joint"
READERS = (
    "init",
    "inspect",
    "run",
    "friction",
    "gravity",
    "imu-calib",
    "inertia",
    "predict",
    "diagnose",
    "refine",
    "simultaneous",
    "payload",
    "drive",
    "replay",
    "plan",
    "export",
)


@pytest.mark.parametrize("name", READERS)
def test_every_command_that_reads_logs_has_them(name: str) -> None:
    options = {text for each in load_command(name).params for text in each.opts}
    assert {"--from", "--to", "--exclude"} <= options


def test_the_part_stands_in_the_inputs_and_is_used_again(rig: Rig) -> None:
    robot = str(TWO / "robot.toml")
    (log, *_) = sorted((TWO / "validation").iterdir())
    part = ["--from", "0.5", "--to", "5", "--exclude", "2,2.5"]
    done = rig.run("simultaneous", str(log), "-r", robot, *part, "-o", "part.json")
    assert done.code == 0, done.err
    (used,) = {tuple(each.part) for each in inputs(rig, "part.json")}
    assert used == ("--from", "0.5", "--to", "5.0", "--exclude", "2.0,2.5")
    predict = ["predict", str(log), "-r", robot, "-p", "part.json", "-o", "p.json"]
    again = rig.run(*predict)
    assert again.code == 0, again.err
    assert "the part of it is used that the parameter file was made of" in again.err

    whole = rig.run(*predict, "--from", "0")
    assert "the part of it is used" not in whole.err
    assert errors(again.out) != errors(whole.out)


def inputs(rig: Rig, name: str) -> list[InputLog]:
    return read_parameters(rig.folder / name).inputs


def errors(table: str) -> list[str]:
    """Return the errors of the joints as the screen shows them."""
    return [line.split()[1] for line in table.splitlines()[1:3]]


def test_a_robot_file_is_proposed_from_a_part(rig: Rig) -> None:
    """A unit is by the positions of the part: outside they are in degrees."""
    t = np.arange(2000) / 100.0
    angle = np.sin(t)
    table = {"t": t}
    for name in JOINTS:
        table[f"{name}.position"] = np.where(t < 10.0, np.degrees(angle), angle)
        table[f"{name}.torque"] = np.cos(t)
    pq.write_table(pa.table(table), rig.folder / "switched.parquet")

    whole = rig.run("init", "switched.parquet")
    assert 'unit = "deg"' in whole.out
    part = rig.run("init", "switched.parquet", "--from", "10.5")
    assert part.code == 0, part.err
    assert 'unit = "deg"' not in part.out

    beyond = rig.run("init", "switched.parquet", "--from", "99")
    assert beyond.code == 2
    assert "nothing of it is used by --from 99.0" in beyond.err


def test_a_plan_counts_a_part_of_what_is_there(rig: Rig) -> None:
    robot = str(TWO / "robot.toml")
    (log, *_) = sorted((TWO / "inertia").iterdir())
    words = ["plan", "inertia", "-r", robot, "--duration", "10"]

    def largest_error(*options: str) -> float:
        done = rig.run(*words, *options, "-o", "plan.json")
        assert done.code == 0, done.err
        plan = json.loads((rig.folder / "plan.json").read_text(encoding="utf-8"))
        parameters = plan["stages"]["inertia"]["parameters"]
        return max(parameter["std_error"] for parameter in parameters)

    nothing = largest_error()
    whole = largest_error("--have", str(log))
    start = largest_error("--have", str(log), "--to", "1.5")
    assert whole < start <= nothing

    refused = rig.run(*words, "--to", "2", "-o", "plan.json")
    assert refused.code == 2
    assert "take a part of the logs of --have" in refused.err


def test_an_export_is_replayed_over_a_part(rig: Rig) -> None:
    robot = str(TWO / "robot.toml")
    (log, *_) = sorted((TWO / "validation").iterdir())
    made = rig.run("simultaneous", str(log), "-r", robot, "-o", "model.json")
    assert made.code == 0, made.err
    export = ["export", "model.json", "-r", robot, "-o", "arm.urdf"]

    whole = rig.run(*export, "--replay", str(log))
    part = rig.run(*export, "--replay", str(log), "--from", "1", "--to", "4")
    assert "replayed over" in whole.out, whole.err
    assert "replayed over" in part.out, part.err
    assert whole.out != part.out


def test_what_is_no_time_is_refused_before_anything_is_read(rig: Rig) -> None:
    missing = str(Path("nowhere"))
    refused = rig.run("run", missing, "-o", "out", "--exclude", "soon")
    assert refused.code == 2
    assert "--exclude 'soon' is no range of time" in refused.err
