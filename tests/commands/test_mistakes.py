"""Ten mistakes of users: each gets the message and the way out that docs/from_files.md lists."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests import ROOT
from tests.commands.conftest import Rig
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

SIX = SAMPLES / "six_joint"
PAGE = ROOT / "docs" / "from_files.md"
INSPECT = ("inspect", "log.parquet", "-r", "robot.toml")
Columns = dict[str, np.ndarray]
Mistake = Callable[[Path], tuple[str, ...]]


def in_log(change: Callable[[Columns], None], **robot: str) -> Mistake:
    """Make a log that is wrong, and look at it."""

    def make(folder: Path) -> tuple[str, ...]:
        columns = read_columns(folder / "log.parquet")
        change(columns)
        write_columns(folder / "log.parquet", columns)
        return INSPECT

    return make


def in_robot(old: str, new: str) -> Mistake:
    """Write a robot file that is wrong."""

    def make(folder: Path) -> tuple[str, ...]:
        text = (folder / "robot.toml").read_text()
        assert re.search(old, text)
        (folder / "robot.toml").write_text(re.sub(old, new, text))
        return INSPECT

    return make


def degrees(columns: Columns) -> None:
    for name in columns:
        if name.endswith(".position"):
            columns[name] = np.rad2deg(columns[name])


def reversed_torque(columns: Columns) -> None:
    columns["elbow.current"] = -columns["elbow.current"]


def renamed(columns: Columns) -> None:
    for name in [name for name in columns if name.startswith("elbow.")]:
        columns[name.replace("elbow.", "elbow_joint.")] = columns.pop(name)


def without_names(folder: Path) -> tuple[str, ...]:
    columns = read_columns(folder / "log.parquet")
    named = [columns[name] for name in columns if not name.startswith("imu")]
    np.savetxt(folder / "log.csv", np.column_stack(named), delimiter=",")
    return ("init", "log.csv", "--urdf", "six_joint.urdf")


def of_matlab(folder: Path) -> tuple[str, ...]:
    (folder / "logs").mkdir()
    savemat(folder / "logs" / "log.mat", {"t": np.arange(3.0)})
    return ("init", "logs", "--urdf", "six_joint.urdf")


MISTAKES: dict[str, Mistake] = {
    "the URDF in place of the robot file": lambda _: (*INSPECT[:3], "six_joint.urdf"),
    "a misspelt key in the robot file": in_robot("gear_ratio", "gear_ration"),
    "a table without a line of names": without_names,
    "a folder of MATLAB files": of_matlab,
    "current, but no data of the drives": in_robot(r"torque_constant = .*|effort = .*", ""),
    "joints of other names in the log": in_log(renamed),
    "positions in degrees": in_log(degrees),
    "an arm on a wall, gravity as on the floor": in_robot("0.0, 0.0, -9.81", "0.0, -9.81, 0.0"),
    "the torque of one joint reversed": in_log(reversed_torque),
    "friction from moves of all joints": lambda _: ("friction", *INSPECT[1:], "-o", "f.json"),
}


def table() -> dict[str, tuple[int, str, str]]:
    """Rows of the page: exit code, message and remedy of each mistake."""
    text = PAGE.read_text(encoding="utf-8").split("## Ten mistakes")[1]
    rows = re.findall(r"^\| ([^|]+) \| (\d) \| `(.+?)` \| (.+) \|$", text, flags=re.MULTILINE)
    return {name: (int(code), message, remedy) for name, code, message, remedy in rows}


def test_the_page_has_ten_mistakes_and_no_other() -> None:
    assert list(table()) == list(MISTAKES)
    assert len(MISTAKES) == 10


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_gets_its_message_and_the_way_out(rig: Rig, name: str) -> None:
    shutil.copy(SIX / "validation" / "fourier_1.parquet", rig.folder / "log.parquet")
    for file in ("robot.toml", "six_joint.urdf"):
        shutil.copy(SIX / file, rig.folder / file)
    done = rig.run(*MISTAKES[name](rig.folder))
    code, message, remedy = table()[name]
    said = " ".join(f"{done.out} {done.err}".split())
    assert done.code == code, said
    assert message in said, said
    assert remedy.replace("\\|", "|") in said, said
    assert "Traceback" not in said
