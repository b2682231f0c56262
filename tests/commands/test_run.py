"""`seqid run`: the whole way in one command, resumed where it stopped."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from tests import ROOT

SAMPLES = ROOT / "sample_logs" / "one_joint"
NAMES = ("friction", "gravity", "imu", "inertia", "prediction", "diagnosis")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of logs, old ones, and the results of a run of them."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copytree(SAMPLES, folder / "logs")
    for path in (folder / "logs").rglob("*"):
        os.utime(path, (1e9, 1e9))
    assert run(folder) == 0
    return folder


def run(folder: Path, *more: str, robot: str = "logs/robot.toml", out: str = "out") -> int:
    logs, file = str(folder / "logs"), str(folder / robot)
    return main(["run", logs, "-r", file, "-o", str(folder / out), *more])


def copied(lab: Path, folder: Path) -> Path:
    return Path(shutil.copytree(lab, folder / "lab"))  # with the times of all files


def written(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "out").iterdir()}


def test_the_files_are_those_of_the_single_commands(lab: Path) -> None:
    out = lab / "out"
    assert {path.name for path in out.iterdir()} == {
        *(f"{name}.json" for name in NAMES),
        "torques.parquet",
        "report.html",
    }
    alone = out.parent / "alone.json"
    command = ["friction", str(lab / "logs" / "friction"), "-r", str(lab / "logs" / "robot.toml")]
    assert main([*command, "-o", str(alone)]) == 0
    one, other = (json.loads(p.read_text())["stages"] for p in (alone, out / "friction.json"))
    assert one == other


def test_what_is_newer_than_its_logs_is_kept(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copied(lab, tmp_path)
    before = written(folder)
    assert run(folder, "--json") == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert all(step["kept"] and step["good"] for step in steps)
    assert written(folder) == before


def test_a_new_log_makes_its_stage_and_what_rests_on_it_again(lab: Path, tmp_path: Path) -> None:
    folder = copied(lab, tmp_path)
    before = written(folder)
    os.utime(next((folder / "logs" / "validation").iterdir()))
    assert run(folder) == 0
    after = written(folder)
    again = {name for name in after if after[name] != before[name]}
    assert again == {"prediction.json", "torques.parquet", "diagnosis.json", "report.html"}


def test_it_stops_at_the_first_poor_stage_also_when_resumed(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (lab / "logs" / "robot.toml").read_text()
    line = next(line for line in text.splitlines() if line.startswith("gear_ratio"))
    turned = text.replace(line, line.replace("= ", "= -"))
    folder = Path(shutil.copytree(lab / "logs", tmp_path / "logs")).parent
    (folder / "turned.toml").write_text(turned)
    for _ in range(2):
        assert run(folder, robot="turned.toml") == 1
        shown = capsys.readouterr()
        assert "stopped at friction" in shown.err
        assert [path.name for path in (folder / "out").iterdir()] == ["friction.json"]


def test_it_needs_friction_trials(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "logs").mkdir()
    shutil.copy(SAMPLES / "robot.toml", tmp_path / "logs")
    assert run(tmp_path) == 2
    said = capsys.readouterr().err
    assert "friction/" in said
    assert str(tmp_path / "logs") in said
    assert not (tmp_path / "out").exists()
