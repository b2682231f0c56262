"""All stages one after the other on a sample robot, as the README shows them."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.params.generate import json_schema
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import SCHEMA
from tests import ROOT

RIG = ROOT / "sample_logs" / "one_joint"
STEPS = (
    ("friction", ["friction"], None, "friction.json"),
    ("gravity", ["gravity", "friction"], "friction.json", "gravity.json"),
    ("imu-calib", ["imu"], "gravity.json", "imu.json"),
    ("inertia", ["inertia"], "imu.json", "inertia.json"),
    ("predict", ["validation"], "inertia.json", "prediction.json"),
)


def test_every_stage_follows_from_the_one_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command, folders, before, after in STEPS:
        logs = [str(RIG / folder) for folder in folders]
        arguments = [command, *logs, "-r", str(RIG / "robot.toml"), "-o", str(tmp_path / after)]
        arguments += ["-p", str(tmp_path / before)] if before else []
        arguments += ["--torques", str(tmp_path / "t.parquet")] if command == "predict" else []
        assert main([*arguments, "--json"]) == 0, capsys.readouterr().err
        text = (tmp_path / after).read_text()
        assert capsys.readouterr().out == text
        name = PREDICTION_SCHEMA if command == "predict" else SCHEMA
        jsonschema.validate(json.loads(text), json_schema(name))

    file = read_parameters(tmp_path / "inertia.json")
    assert {log.stage for log in file.inputs} == {"friction", "gravity", "imu", "inertia"}
    prediction = json.loads((tmp_path / "prediction.json").read_text())
    assert prediction["joints"]["joint_1"]["relative_rmse"] < 0.1
    rows = sum(log["samples"] for log in prediction["logs"])
    assert pq.read_metadata(tmp_path / "t.parquet").num_rows == rows
