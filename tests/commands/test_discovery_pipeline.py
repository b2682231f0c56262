"""Diagnosis and refinement on a sample robot, with everything real."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.params.diagnosis_schema import DIAGNOSIS_SCHEMA
from seqid_cli.params.generate import json_schema
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import SCHEMA

RIG = Path(__file__).parents[2] / "sample_logs" / "one_joint"
ROBOT = ["-r", str(RIG / "robot.toml")]
FITTED = RIG / "validation" / "fourier_1.parquet"
HELD_OUT = RIG / "validation" / "point_to_point.parquet"
needs = {
    name: pytest.mark.skipif(
        importlib.util.find_spec(f"seqid_cli.discover.{name}") is None,
        reason=f"seqid_cli.discover.{name} is not there",
    )
    for name in ("diagnose", "refine")
}


@pytest.fixture(scope="module")
def parameters(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stages")
    friction, inertia = folder / "friction.json", folder / "inertia.json"
    logs = str(RIG / "friction")
    gravity = folder / "gravity.json"
    assert main(["friction", logs, *ROBOT, "-o", str(friction), "-q"]) == 0
    assert main(["gravity", logs, *ROBOT, "-p", str(friction), "-o", str(gravity), "-q"]) == 0
    stage = ["inertia", str(RIG / "inertia"), *ROBOT, "-p", str(gravity), "-o", str(inertia)]
    assert main([*stage, "--motion", "encoder", "-q"]) == 0
    return inertia


@needs["diagnose"]
def test_a_diagnosis_of_real_logs(
    tmp_path: Path, parameters: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "diagnosis.json"
    command = ["diagnose", str(RIG / "validation"), *ROBOT, "-p", str(parameters)]
    assert main([*command, "-o", str(output), "--json"]) == 0, capsys.readouterr().err
    assert capsys.readouterr().out == output.read_text()
    document = json.loads(output.read_text())
    jsonschema.validate(document, json_schema(DIAGNOSIS_SCHEMA))
    joint = document["joints"]["joint_1"]
    assert 0.0 < joint["noise_floor"] <= 1.2 * joint["rmse"]
    strict = main([*command, "--strict", "-q"])
    assert strict == (document["verdict"] != "nothing_missing")


@needs["diagnose"]
def test_a_log_without_torque_is_refused(
    tmp_path: Path, parameters: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pq.read_table(FITTED)
    kept = [name for name in table.column_names if not name.endswith(("current", "torque"))]
    pq.write_table(table.select(kept), tmp_path / "bare.parquet")
    command = ["diagnose", str(tmp_path / "bare.parquet"), *ROBOT, "-p", str(parameters)]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "bare.parquet: the log has neither joint torque nor motor current" in error
    assert "Traceback" not in error


@needs["refine"]
def test_a_refinement_of_real_logs(
    tmp_path: Path, parameters: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "refined.json"
    command = ["refine", str(FITTED), "--holdout", str(HELD_OUT), *ROBOT, "-p", str(parameters)]
    assert main([*command, "-o", str(output), "--json"]) == 0, capsys.readouterr().err
    jsonschema.validate(json.loads(output.read_text()), json_schema(SCHEMA))
    file = read_parameters(output)
    loop = file.closed_loop
    assert loop is not None
    assert loop.evaluated_on == [str(HELD_OUT)]
    assert loop.after["joint_1"].rmse <= 1.05 * loop.before["joint_1"].rmse
    assert len(file.stages.effects or []) == len(loop.rounds)
    assert str(HELD_OUT) not in {log.path for log in file.inputs}
    prediction = ["predict", str(HELD_OUT), *ROBOT, "-p", str(output), "-q"]
    assert main(prediction) == 0
