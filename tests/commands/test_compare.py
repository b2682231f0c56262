"""Files compared with one another, and over dates."""

import json

import numpy as np
import pytest

from seqid_cli.params.results.comparison import COMPARISON_SCHEMA
from tests.commands.conftest import Rig
from tests.commands.transcripts import check_transcript
from tests.unit.params.documents import inertia_file
from tests.unit.trend.test_trend import DATES, history


@pytest.fixture
def pair(rig: Rig) -> Rig:
    """A rig with a file, a copy of it, one whose gravity is another, and one of another robot."""
    moved, other = inertia_file(), inertia_file()
    moved.stages.gravity.parameters[0].value = 1.5
    other.robot.name = "another"
    files = {"a": inertia_file(), "same": inertia_file(), "moved": moved, "other": other}
    for name, file in files.items():
        rig.params(f"{name}.json", file)
    return rig


def test_what_the_user_sees(pair: Rig) -> None:
    check_transcript(pair, "compare")


@pytest.mark.parametrize("form", [["--json"], ["--format", "json"]])
def test_json(pair: Rig, form: list[str]) -> None:
    done = pair.run("compare", "a.json", "moved.json", *form)
    assert done.code == 1
    found = json.loads(done.out)
    assert (found["schema"], found["changed"]) == (COMPARISON_SCHEMA, 1)
    assert found["different"] is True
    change = next(item for item in found["differences"] if item["different"])
    assert (change["a"], change["b"], change["unit"]) == (1.25, 1.5, "kg m")


def test_dates(rig: Rig) -> None:
    """The gravity of a robot changes at the eighth date."""
    change = np.where(np.arange(DATES) >= 7, 0.1, 0.0)
    for number, file in enumerate(history(1, change)):
        rig.params(f"{number:02}.json", file)
    check_transcript(rig, "trend")
    assert json.loads((rig.folder / "trend.json").read_text())["alarm"] is True
    assert (rig.folder / "trend.parquet").is_file()
