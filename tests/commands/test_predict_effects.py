"""`seqid predict` with a refined file: the effects count, and the notes say so."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.schema import EffectOfJoint, FrictionStage
from seqid_cli.robot.file import load_robot
from tests.plants.robots.made import friction_joint

ROBOT_TOML = (
    'schema = "seqid/robot@1"\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n'
    '[[joint]]\nname = "hip"\ndh = { alpha = 0.0, a = 0.3, d = 0.0, theta0 = 0.0 }\n'
)
RATE_HZ = 200.0
BIAS = EffectOfJoint(effect="torque_bias", joint="hip", coefficients=[0.4])
SMOOTH = EffectOfJoint(effect="unexplained", joint="hip")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A robot of one joint that swings."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT_TOML)
    t = np.arange(2000) / RATE_HZ
    q, dq = np.sin(2 * t), 2 * np.cos(2 * t)
    columns = {"t": t, "hip.position": q, "hip.torque": 0.4 + 2.0 * np.tanh(dq / 0.01) + dq}
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    return tmp_path


def write(folder: Path, name: str, effects: list[EffectOfJoint] | None) -> str:
    robot = load_robot(folder / "robot.toml")
    joint = friction_joint([[4.0, 2.0]], speed_range=[0.0, 4.0], sign_width=0.01)
    stages = {"friction": FrictionStage(joints={"hip": joint}), "effects": effects}
    given = {name: stage for name, stage in stages.items() if stage is not None}
    file = with_stage(None, robot_id(robot), [], **given)  # type: ignore[arg-type]
    write_json_atomic(folder / name, file)
    return name


def run(parameters: str, *more: str) -> int:
    outputs = ["-o", "out.json", "--torques", "torques.parquet"]
    return main(["predict", "log.parquet", "-r", "robot.toml", "-p", parameters, *outputs, *more])


def torques(folder: Path) -> np.ndarray:
    table = pq.read_table(folder / "torques.parquet")
    return np.asarray(table["hip.predicted"].to_numpy())


def test_the_prediction_changes_by_the_effects_torque(folder: Path) -> None:
    plain = write(folder, "plain.json", None)
    refined = write(folder, "refined.json", [BIAS])
    assert run(plain) == 0
    before = torques(folder)
    assert run(refined) == 0
    change = torques(folder) - before
    assert np.median(change) == pytest.approx(0.4, abs=1e-9)
    document = json.loads((folder / "out.json").read_text())
    assert document["joints"]["hip"]["rmse"] < 0.1
    assert "effects in the prediction: torque_bias (hip)" in document["notes"]
    assert document["stages"] == ["friction", "effects"]


def test_smooth_terms_are_left_out_unless_asked_for(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The term here is empty: it is only an error where it is to be used."""
    parameters = write(folder, "p.json", [BIAS, SMOOTH])
    assert run(parameters) == 0
    document = json.loads((folder / "out.json").read_text())
    assert any("left out (--with-unexplained" in note for note in document["notes"])
    capsys.readouterr()
    assert run(parameters, "--with-unexplained") == 2
    assert "unexplained" in capsys.readouterr().err


def test_an_effect_of_a_newer_version_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parameters = write(folder, "p.json", [EffectOfJoint(effect="phlogiston", joint="hip")])
    assert run(parameters) == 2
    text = capsys.readouterr().err
    assert "$.stages.effects[0].effect" in text
    assert "phlogiston" in text
