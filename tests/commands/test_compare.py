"""Files compared with one another, and over dates."""

import json

import numpy as np
import pytest

from seqid_cli.params.schema import ParameterFile
from tests.commands.conftest import Rig
from tests.unit.params.documents import inertia_file
from tests.unit.trend.test_trend import DATES, history


@pytest.fixture
def pair(rig: Rig) -> Rig:
    """A rig with a file, a copy of it, and one whose gravity is another."""
    rig.params("a.json", inertia_file())
    rig.params("same.json", inertia_file())
    rig.params("moved.json", moved())
    return rig


def moved() -> ParameterFile:
    file = inertia_file()
    file.stages.gravity.parameters[0].value = 1.5
    return file


def test_equal_files_exit_with_0(pair: Rig) -> None:
    done = pair.run("compare", "a.json", "same.json")
    assert done.code == 0
    assert "0 of " in done.out
    assert "by more than 4 standard errors and 1 % of its size" in done.out


def test_a_change_exits_with_1_and_is_shown_first(pair: Rig) -> None:
    done = pair.run("compare", "a.json", "moved.json")
    assert done.code == 1
    row = done.out.splitlines()[1].split()
    assert row[:3] == ["gravity", "mx_1", "shoulder"]
    assert row[-1] == "changed"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--rtol", "0.1"], 1),
        (["--rtol", "0.2"], 0),
        (["--sigma", "10"], 1),
        (["--sigma", "20"], 0),
        (["--sigma", "10", "--rtol", "0.2"], 0),
        (["--rtol", "0"], 1),
    ],
)
def test_limits(pair: Rig, arguments: list[str], code: int) -> None:
    assert pair.run("compare", "a.json", "moved.json", *arguments).code == code


@pytest.mark.parametrize("form", [["--json"], ["--format", "json"]])
def test_json(pair: Rig, form: list[str]) -> None:
    done = pair.run("compare", "a.json", "moved.json", *form)
    assert done.code == 1
    found = json.loads(done.out)
    assert found["schema"] == "seqid/comparison@1"
    assert found["different"] is True
    assert found["changed"] == 1
    change = next(item for item in found["differences"] if item["different"])
    assert (change["a"], change["b"], change["unit"]) == (1.25, 1.5, "kg m")


def test_github_annotations(pair: Rig) -> None:
    done = pair.run("compare", "a.json", "moved.json", "--format", "github")
    assert done.code == 1
    error, notice = done.out.splitlines()
    assert error.startswith(
        "::error file=moved.json,title=seqid%3A gravity mx_1 of shoulder changed::"
    )
    assert "1.25 became 1.5 kg m, 17.7 standard errors, 16.7 %25 of its size" in error
    assert notice.startswith("::notice title=seqid compare::1 of ")


def test_another_robot_is_an_error(pair: Rig) -> None:
    other = inertia_file()
    other.robot.name = "another"
    pair.params("other.json", other)
    done = pair.run("compare", "a.json", "other.json")
    assert done.code == 2
    assert "is about robot 'another'" in done.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a.json"], "B.json"),
        (["a.json", "none.json"], "does not exist"),
        (["a.json", "robot.toml"], "not valid JSON"),
        (["a.json", "same.json", "--rtol", "-1"], "is not a number from 0 on"),
        (["a.json", "same.json", "--sigma", "nan"], "is not a number from 0 on"),
        (["a.json", "same.json", "--format", "xml"], "xml"),
    ],
)
def test_what_cannot_be_done_is_said(pair: Rig, arguments: list[str], words: str) -> None:
    done = pair.run("compare", *arguments)
    assert done.code == 2
    assert words in done.err


@pytest.fixture
def worn(rig: Rig) -> list[str]:
    """Files of a robot whose gravity changes at the eighth date."""
    change = np.where(np.arange(DATES) >= 7, 0.1, 0.0)
    names = [f"{number:02}.json" for number in range(DATES)]
    for name, file in zip(names, history(1, change), strict=True):
        rig.params(name, file)
    return names


def test_a_change_exits_with_1(rig: Rig, worn: list[str]) -> None:
    done = rig.run("trend", *worn, "-o", "trend.json", "--table", "trend.parquet")
    assert done.code == 1
    row = done.out.splitlines()[1].split()
    assert row[2:5] == ["gravity", "mx_1", "step"]
    assert "changed: " in done.out
    assert json.loads((rig.folder / "trend.json").read_text())["alarm"] is True
    assert (rig.folder / "trend.parquet").is_file()


def test_before_the_change_it_exits_with_0(rig: Rig, worn: list[str]) -> None:
    done = rig.run("trend", *worn[:7])
    assert done.code == 0
    assert done.out.startswith("nothing changed")


@pytest.mark.parametrize("wrong", [["--alpha", "2"], ["--rtol", "0"], ["--by", "day"]])
def test_wrong_options_exit_with_2(rig: Rig, worn: list[str], wrong: list[str]) -> None:
    assert rig.run("trend", *worn, *wrong).code == 2
