"""Ten mistakes of docs/how-to/from_files.md, each with its message and way out;
damaged files.
"""

import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests import ROOT
from tests.commands.conftest import SAMPLE_LOGS, Rig
from tests.studies.fuzz import run
from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.target import Target
from tests.studies.fuzz.targets import targets
from tests.unit.inspect.faults import read_columns, write_columns

SIX = SAMPLE_LOGS / "six_joint"
INSPECT = ("inspect", "log.parquet", "-r", "robot.toml")
Mistake = Callable[[Path], tuple[str, ...]]


def in_log(change: Callable[[dict[str, np.ndarray]], None]) -> Mistake:

    def make(folder: Path) -> tuple[str, ...]:
        columns = read_columns(folder / "log.parquet")
        change(columns)
        write_columns(folder / "log.parquet", columns)
        return INSPECT

    return make


def in_robot(old: str, new: str) -> Mistake:

    def make(folder: Path) -> tuple[str, ...]:
        text = (folder / "robot.toml").read_text()
        assert re.search(old, text)
        (folder / "robot.toml").write_text(re.sub(old, new, text))
        return INSPECT

    return make


def degrees(columns: dict[str, np.ndarray]) -> None:
    for name in columns:
        if name.endswith(".position"):
            columns[name] = np.rad2deg(columns[name])


def reversed_torque(columns: dict[str, np.ndarray]) -> None:
    columns["elbow.current"] = -columns["elbow.current"]


def renamed(columns: dict[str, np.ndarray]) -> None:
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
    "current, but no data of the drives": in_robot(
        r"torque_constant = .*|effort = .*", ""
    ),
    "joints of other names in the log": in_log(renamed),
    "positions in degrees": in_log(degrees),
    "an arm on a wall, gravity as on the floor": in_robot(
        "0.0, 0.0, -9.81", "0.0, -9.81, 0.0"
    ),
    "the torque of one joint reversed": in_log(reversed_torque),
    "friction from moves of all joints": lambda _: (
        "friction",
        *INSPECT[1:],
        "-o",
        "f.json",
    ),
}


def table() -> dict[str, tuple[int, str, str]]:
    """Rows of the page: exit code, message and remedy of each mistake."""
    page = ROOT / "docs" / "how-to" / "from_files.md"
    text = page.read_text(encoding="utf-8").split("## Ten mistakes")[1]
    rows = re.findall(
        r"^\| ([^|]+) \| (\d) \| `(.+?)` \| (.+) \|$", text, flags=re.MULTILINE
    )
    return {name: (int(code), message, remedy) for name, code, message, remedy in rows}


def test_the_page_has_ten_mistakes_and_no_other() -> None:
    assert list(table()) == list(MISTAKES)
    assert len(MISTAKES) == 10


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_gets_its_message_and_the_way_out(rig: Rig, name: str) -> None:
    shutil.copy(SIX / "validation" / "fourier_1.parquet", rig.folder / "log.parquet")
    for file in ("robot.toml", "six_joint.urdf"):
        shutil.copy(SIX / file, rig.folder)
    done = rig.run(*MISTAKES[name](rig.folder))
    code, message, remedy = table()[name]
    said = " ".join(f"{done.out} {done.err}".split())
    assert done.code == code, said
    assert message in said, said
    assert remedy.replace("\\|", "|") in said, said
    assert "Traceback" not in said


FOUND = sorted((Path(run.__file__).parent / "found").iterdir())
# Commands that take long; the study runs them.
LONG = frozenset({"run", "refine", "diagnose", "plan"})
# Targets whose name is not the first word of the names in the folder.
TARGETS = {
    "mcap": "MCAP, CDR",
    "parquet": "Parquet",
    "sqlite": "ROS 2 bag: SQLite",
    "urdf": "URDF",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Target]:
    return {target.name: target for target in targets(tmp_path_factory.mktemp("sound"))}


@pytest.mark.slow
@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_what_was_found_is_answered(
    path: Path, made: Mapping[str, Target], tmp_path: Path
) -> None:
    word = path.name.partition("_")[0]
    target = made[TARGETS.get(word, word)]
    run.lay_out(target, tmp_path)
    (tmp_path / target.file).write_bytes(path.read_bytes())
    for line in target.lines:
        if line[0] in LONG:
            continue
        _, said, why = answer(run.filled(line, target, tmp_path))
        assert not why, f"{' '.join(line)}: {said}"


@pytest.mark.slow
def test_fresh_inputs_are_answered(made: Mapping[str, Target], tmp_path: Path) -> None:
    for number, target in enumerate(made.values()):
        folder, tally = tmp_path / str(number), run.Tally()
        folder.mkdir()
        run.fuzz(target, folder, 10, 7, tally)
        assert not tally.finds, (
            f"{target.name}: {tally.finds[0].line}: {tally.finds[0].said}"
        )
        assert sum(tally.codes.values()) == 10
