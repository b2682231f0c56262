"""Diagnosis and refinement on a sample robot, with everything real."""

import json
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import SCHEMA
from tests import ROOT
from tests.unit.params.generate import json_schema

RIG = ROOT / "sample_logs" / "one_joint"
ROBOT = ["-r", str(RIG / "robot.toml")]
FITTED = [RIG / "changed" / "fourier.parquet", RIG / "changed" / "trapezoids.parquet"]
HELD_OUT = RIG / "changed" / "held_out.parquet"
TRUTH = json.loads((RIG / "truth.json").read_text())["changed"]


@pytest.fixture(scope="session")
def parameters(lab: Path) -> Path:
    return lab / "out" / "inertia.json"


def test_a_diagnosis_of_logs_after_a_change(tmp_path: Path, parameters: Path) -> None:
    output = tmp_path / "diagnosis.json"
    command = ["diagnose", str(RIG / "changed"), *ROBOT, "-p", str(parameters), "--strict"]
    assert main([*command, "-o", str(output), "-q"]) == 1
    document = json.loads(output.read_text())
    assert document["verdict"] == "effect_found"
    first = document["findings"][0]
    assert (first["effect"], first["joint"]) == (TRUTH["effect"], TRUTH["joint"])
    values = {p["name"]: p["value"] for p in first["parameters"]}
    assert values["stiffness"] == pytest.approx(TRUTH["stiffness"], rel=0.25)
    joint = document["joints"]["joint_1"]
    assert joint["rmse_explained"] < 0.6 * joint["rmse"]


@pytest.mark.slow
def test_encoders_too_coarse_for_the_models_cutoff_find_the_same(tmp_path: Path) -> None:
    rig, output = ROOT / "sample_logs" / "two_joint", tmp_path / "diagnosis.json"
    model = ["-r", str(rig / "robot.toml"), "-p", str(rig / "golden.json")]
    command = ["diagnose", str(rig / "changed"), *model, "--motion", "encoder"]
    assert main([*command, "-o", str(output), "-q"]) == 0
    findings = json.loads(output.read_text())["findings"]
    truth = json.loads((rig / "truth.json").read_text())["changed"]
    assert [(f["effect"], f["joint"]) for f in findings] == [(truth["effect"], truth["joint"])]
    (value,) = findings[0]["parameters"]
    assert value["value"] == pytest.approx(truth["driving"], abs=4 * value["std_error"])


@pytest.mark.parametrize(("cutoff", "noisy"), [([], True), (["--cutoff", "6"], False)])
def test_a_prediction_says_what_encoders_make_of_its_error(
    tmp_path: Path, cutoff: list[str], *, noisy: bool
) -> None:
    rig, output = ROOT / "sample_logs" / "two_joint", tmp_path / "prediction.json"
    model = ["-r", str(rig / "robot.toml"), "-p", str(rig / "golden.json"), "--motion", "encoder"]
    log = str(rig / "changed" / "held_out.parquet")
    assert main(["predict", log, *model, *cutoff, "-o", str(output), "-q"]) == 0
    document = json.loads(output.read_text())
    told = [note for note in document["logs"][0]["notes"] if "noise of the encoders" in note]
    assert bool(told) == noisy
    assert (document["joints"]["joint_1"]["relative_rmse"] > 0.3) == noisy


def test_a_log_without_torque_is_refused(
    tmp_path: Path, parameters: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pq.read_table(HELD_OUT)
    kept = [name for name in table.column_names if not name.endswith(("current", "torque"))]
    pq.write_table(table.select(kept), tmp_path / "bare.parquet")
    command = ["diagnose", str(tmp_path / "bare.parquet"), *ROBOT, "-p", str(parameters)]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "bare.parquet: the log has neither joint torque nor motor current" in error
    assert "Traceback" not in error


def test_a_refinement_of_real_logs(
    tmp_path: Path, parameters: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "refined.json"
    command = ["refine", *map(str, FITTED), "--holdout", str(HELD_OUT), *ROBOT]
    command += ["-p", str(parameters), "-o", str(output), "--json"]
    assert main(command) == 0, capsys.readouterr().err
    jsonschema.validate(json.loads(output.read_text()), json_schema(SCHEMA))
    file = read_parameters(output)
    loop = file.closed_loop
    assert loop.evaluated_on == [str(HELD_OUT)]
    assert loop.after["joint_1"].rmse < 0.6 * loop.before["joint_1"].rmse
    assert [(tried.effect, tried.joint) for tried in loop.rounds[:1]] == [("spring", "joint_1")]
    assert len(file.stages.effects or []) == len(loop.rounds)
    assert str(HELD_OUT) not in {log.path for log in file.inputs}
    prediction = ["predict", str(HELD_OUT), *ROBOT, "-p", str(output), "-q"]
    assert main(prediction) == 0
