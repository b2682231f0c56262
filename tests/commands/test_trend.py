import json

import numpy as np
import pytest

from tests.commands.conftest import Rig
from tests.unit.trend.test_trend import DATES, history


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
