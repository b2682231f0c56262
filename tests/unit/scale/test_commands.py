"""Commands with several processes: the same files to the last bit, and what happens on failure."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from seqid_cli.commands.app import run
from tests import ROOT

SAMPLES = ROOT / "sample_logs"
FRICTION = SAMPLES / "one_joint" / "friction"
ROBOT = SAMPLES / "one_joint" / "robot.toml"


def without_time(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    del document["created"]
    return document


VELOCITY = ("--velocity-order", "3")
CASES = {
    "friction": ("one_joint", ("friction", "gravity"), ("--position-order", "2", *VELOCITY)),
    "gravity": ("one_joint", ("gravity", "friction"), ()),
    "imu-calib": ("one_joint", ("imu",), ()),
    "inertia": ("two_joint", ("inertia",), ("--motion", "encoder")),
    "predict": ("two_joint", ("validation", "changed"), ("--motion", "encoder")),
}


@pytest.mark.parametrize(
    "name",
    ["friction", *(pytest.param(n, marks=pytest.mark.slow) for n in CASES if n != "friction")],
)
def test_processes_change_no_bit(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, folders, more = CASES[name]
    logs = [str(SAMPLES / rig / folder) for folder in folders]
    if name == "imu-calib":  # which has one log only
        logs.append(str(shutil.copy(next((SAMPLES / rig / "imu").iterdir()), tmp_path)))
    given = [] if name == "friction" else ["-p", str(SAMPLES / rig / "golden.json")]
    robot = ["-r", str(SAMPLES / rig / "robot.toml")]
    found, shown = [], []
    for jobs in ("1", "2"):
        output, torques = tmp_path / f"{jobs}.json", tmp_path / f"{jobs}.parquet"
        own = ["-o", str(output), "--jobs", jobs, "--json"]
        own += ["--torques", str(torques)] if name == "predict" else []
        assert run([name, *logs, *robot, *given, *more, *own]) == 0
        found.append((without_time(output), torques.read_bytes() if torques.exists() else b""))
        shown.append(capsys.readouterr().err.replace(f"/{jobs}.", "/N."))
    assert len(found[0][0]["inputs"]) > 1
    assert found[0] == found[1]
    assert shown[0] == shown[1]


@pytest.fixture
def logs(tmp_path: Path) -> list[str]:
    """Return three logs: a good one, one without torque and one that is cut short."""
    import pyarrow.parquet as pq

    good = next(iter(sorted(FRICTION.glob("*.parquet"))))
    shutil.copy(good, tmp_path / "a.parquet")
    table = pq.read_table(good)
    kept = [name for name in table.column_names if not name.endswith((".current", ".torque"))]
    pq.write_table(table.select(kept), tmp_path / "b.parquet")
    (tmp_path / "c.parquet").write_bytes(b"PAR1" + b"\0" * 100 + b"PAR1")
    return [str(tmp_path / name) for name in ("a.parquet", "b.parquet", "c.parquet")]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_the_first_log_that_fails_stops_the_command_by_name(
    jobs: str, logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out.json"
    code = run(["friction", *VELOCITY, *logs, "-r", str(ROBOT), "-o", str(output), "--jobs", jobs])
    shown = capsys.readouterr()
    assert code == 2
    assert f"error: {logs[1]}: " in shown.err
    assert not output.exists()


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_copy_of_a_log_does_not_count_twice(
    jobs: str, logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, stages = str(shutil.copy(logs[0], tmp_path / "copy.parquet")), []
    for given in ([logs[0]], [logs[0], copy]):
        output = tmp_path / "out.json"
        words = ["friction", *VELOCITY, "--position-order", "2", *given, "-r", str(ROBOT)]
        assert run([*words, "-o", str(output), "--jobs", jobs]) == 0
        stages.append(json.loads(output.read_text())["stages"]["friction"]["joints"])
    assert stages[0] == stages[1]
    text = f"left out: {copy}: has the same content as {logs[0]} and would count twice"
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_on_request_a_command_goes_on_without_failed_logs(
    jobs: str, logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, missing = tmp_path / "out.json", str(tmp_path / "none.parquet")
    words = [
        "friction",
        *VELOCITY,
        "--position-order",
        "2",
        *logs,
        missing,
        "-r",
        str(ROBOT),
        "-o",
        str(output),
        "--jobs",
        jobs,
    ]
    assert run([*words, "--skip-failed"]) == 3
    shown = capsys.readouterr()
    for path in (*logs[1:], missing):
        assert f"warning: left out: {path}: " in shown.err
    document = without_time(output)
    assert [log["path"] for log in document["inputs"]] == logs[:1]
    notes = "\n".join(document["stages"]["friction"]["notes"])
    assert all(f"left out: {path}" in notes for path in (*logs[1:], missing))


def test_no_log_at_all_is_an_error_all_the_same(
    logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["friction", *logs[1:], "-r", str(ROBOT), "--skip-failed", "--jobs", "1"]
    assert run(words) == 2
    assert "none of the 2 logs can be used" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--jobs", "0"), "--jobs"),
        (("--scheduler", "tcp://127.0.0.1:1"), "add --engine dask"),
        (("--engine", "spark"), "--engine"),
    ],
)
def test_options_that_make_no_sense_are_usage_errors(
    options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["friction", str(FRICTION), "-r", str(ROBOT), *options]) == 2
    assert words in capsys.readouterr().err.lower()


def test_dask_that_is_not_installed_is_named_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    found: Callable[..., object] = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *more: None if name == "distributed" else found(name, *more),
    )
    words = ["friction", str(FRICTION), "-r", str(ROBOT), "--engine", "dask"]
    assert run(words) == 2
    assert "pip install 'seqid[dask]'" in capsys.readouterr().err
