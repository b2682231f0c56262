"""`seqid run`: the whole way in one command, resumed where it stopped."""

import json
import os
import shutil
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import SCHEMA
from tests.commands.conftest import ONE_JOINT, run
from tests.unit.params.generate import json_schema

NAMES = ("friction", "gravity", "imu", "inertia", "prediction", "diagnosis")


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


def test_every_file_keeps_to_its_schema_and_says_all_stages(lab: Path) -> None:
    out = lab / "out"
    schemas = {"prediction": PREDICTION_SCHEMA, "diagnosis": DIAGNOSIS_SCHEMA}
    for name in NAMES:
        document = json.loads((out / f"{name}.json").read_text())
        jsonschema.validate(document, json_schema(schemas.get(name, SCHEMA)))
    inputs = read_parameters(out / "inertia.json").inputs
    assert {log.stage for log in inputs} == {"friction", "gravity", "imu", "inertia"}


def test_the_model_predicts_logs_that_it_has_not_seen(lab: Path) -> None:
    prediction = json.loads((lab / "out" / "prediction.json").read_text())
    assert prediction["joints"]["joint_1"]["relative_rmse"] < 0.1
    rows = sum(log["samples"] for log in prediction["logs"])
    assert pq.read_metadata(lab / "out" / "torques.parquet").num_rows == rows


def test_nothing_is_missing_where_nothing_is(lab: Path) -> None:
    diagnosis = json.loads((lab / "out" / "diagnosis.json").read_text())
    joint = diagnosis["joints"]["joint_1"]
    assert 0.0 < joint["noise_floor"] <= 1.2 * joint["rmse"]
    assert diagnosis["verdict"] == "nothing_missing"


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
        assert "it would drive the joint" in shown.out + shown.err
        assert [path.name for path in (folder / "out").iterdir()] == ["friction.json"]


def test_it_needs_friction_trials(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "logs").mkdir()
    shutil.copy(ONE_JOINT / "robot.toml", tmp_path / "logs")
    assert run(tmp_path) == 2
    said = capsys.readouterr().err
    assert "friction/" in said
    assert str(tmp_path / "logs") in said
    assert not (tmp_path / "out").exists()
