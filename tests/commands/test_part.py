"""`--from`, `--to` and `--exclude`: on all commands, and in the result's inputs."""

from pathlib import Path

import pytest

from seqid_cli.commands.app import load_command
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import InputLog
from tests.commands.conftest import SAMPLE_LOGS, Rig

TWO = SAMPLE_LOGS / "two_joint"
READERS = (
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


def test_what_is_no_time_is_refused_before_anything_is_read(rig: Rig) -> None:
    missing = str(Path("nowhere"))
    refused = rig.run("run", missing, "-o", "out", "--exclude", "soon")
    assert refused.code == 2
    assert "--exclude 'soon' is no range of time" in refused.err
