"""Prediction around a fake model: files, verdicts, messages; what a refined file changes."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import jsonschema
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import EffectOfJoint, FrictionStage
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.commands.conftest import SAMPLES, Reader, Rig
from tests.commands.transcripts import check_transcript
from tests.plants.robots.made import friction_joint, made_prediction
from tests.unit.params.documents import friction_file, full_file
from tests.unit.params.generate import json_schema

BASE = ["predict", "a.parquet", "b.parquet", "-r", "robot.toml", "-p", "p.json"]
BOTH = [*BASE, "-o", "out.json", "--torques", "t.parquet"]


@dataclass
class Model:
    """Predicts torque with errors of `scale` times a standard normal; the seed is fixed."""

    scale: float = 0.1
    fail_after: int = 99
    slides: bool = True
    made: list[LogPrediction] = field(default_factory=list)

    def predict(
        self,
        recordings: Iterable[Recording],
        robot: Robot,
        stages: object,
        *,
        options: object,
        unexplained: bool = False,
    ) -> Iterator[LogPrediction]:
        """Yield one prediction per recording."""
        rng = np.random.default_rng(0)
        for index, recording in enumerate(recordings):
            if index >= self.fail_after:
                raise ZeroDivisionError
            tau = rng.normal(size=(SAMPLES, robot.n))
            used = np.ones(SAMPLES, dtype=bool)
            used[0] = False
            sliding = np.full(tau.shape, self.slides) & used[:, None]
            sliding[1, 1] = False
            predicted = tau + self.scale * rng.normal(size=tau.shape)
            wide = np.where(sliding, 0.0, 0.5 * self.scale)
            log = made_prediction(
                str(recording.path),
                tau,
                predicted,
                sha256=recording.sha256,
                t=recording.t,
                low=predicted - wide,
                high=predicted + wide,
                used=used,
                sliding=sliding,
                notes=("a remark",),
            )
            self.made.append(log)
            yield log


@pytest.fixture
def model(monkeypatch: pytest.MonkeyPatch) -> Model:
    fake = Model()
    monkeypatch.setattr("seqid_cli.identify.prediction.predict.predict", fake.predict)
    return fake


def stacked(model: Model, joint: int, name: str) -> np.ndarray:
    return np.concatenate([getattr(log, name)[:, joint] for log in model.made])


def root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_errors_over_all_logs_and_per_log(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    assert rig.run(*BOTH).code == 0
    document = json.loads((rig.folder / "out.json").read_text())
    jsonschema.validate(document, json_schema(PREDICTION_SCHEMA))
    for joint, name in enumerate(("shoulder", "elbow")):
        tau, predicted = stacked(model, joint, "tau"), stacked(model, joint, "predicted")
        slides = stacked(model, joint, "sliding")
        used = np.concatenate([log.used for log in model.made])
        error = (tau - predicted)[slides]
        found = document["joints"][name]
        assert found["samples"] == 2 * (SAMPLES - 1 - joint)
        assert found["samples_all"] == 2 * (SAMPLES - 1)
        assert found["share_sliding"] == pytest.approx(1 - joint / (SAMPLES - 1))
        assert found["rmse"] == pytest.approx(root_mean_square(error))
        expected = root_mean_square(error) / root_mean_square(tau[slides])
        assert found["relative_rmse"] == pytest.approx(expected)
        assert found["max_abs"] == pytest.approx(np.max(np.abs(error)))
        beyond = np.maximum(np.abs(tau - predicted) - np.where(slides, 0.0, 0.05), 0.0)
        assert found["rmse_all"] == pytest.approx(root_mean_square(beyond[used]))
    assert [log["path"] for log in document["logs"]] == ["a.parquet", "b.parquet"]
    assert document["logs"][0]["joints"]["elbow"]["samples"] == SAMPLES - 2
    assert document["parameters"][0]["path"] == "p.json"
    assert document["stages"] == ["friction", "gravity", "imu", "inertia", "effects"]


def test_the_torques_themselves(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    assert rig.run(*BOTH).code == 0
    table = pq.read_table(rig.folder / "t.parquet")
    kinds = ("torque", "predicted", "residual", "sliding", "low", "high")
    assert table.column_names == [
        "t",
        "log",
        *(f"{name}.{kind}" for name in ("shoulder", "elbow") for kind in kinds),
        "used",
        *(f"{name}.{kind}" for name in ("shoulder", "elbow") for kind in ("position", "velocity")),
    ]
    assert table["log"].to_pylist() == ["a.parquet"] * SAMPLES + ["b.parquet"] * SAMPLES
    columns = {name: table[name].to_numpy() for name in table.column_names if name != "log"}
    slides = stacked(model, 1, "sliding")
    np.testing.assert_array_equal(columns["elbow.sliding"], slides)
    for kind in ("low", "high"):
        bound = np.where(slides, np.nan, stacked(model, 1, kind))
        np.testing.assert_array_equal(columns[f"elbow.{kind}"], bound)
    measured = np.concatenate([log.tau[:, 1] for log in model.made])
    np.testing.assert_array_equal(columns["elbow.torque"], measured)
    np.testing.assert_allclose(
        columns["elbow.residual"], columns["elbow.torque"] - columns["elbow.predicted"]
    )


def test_a_failure_between_logs_leaves_the_old_files(
    rig: Rig, reader: Reader, model: Model
) -> None:
    rig.params("p.json", full_file())
    (rig.folder / "t.parquet").write_text("old")
    before = sorted(path.name for path in rig.folder.iterdir())
    model.fail_after = 1
    assert rig.run(*BOTH).code == 70
    assert (rig.folder / "t.parquet").read_text() == "old"
    assert sorted(path.name for path in rig.folder.iterdir()) == before


@pytest.mark.parametrize(
    ("name", "scale", "slides"), [("", 0.1, True), ("_poor", 3.0, True), ("_still", 0.1, False)]
)
def test_what_the_user_sees(
    rig: Rig, reader: Reader, model: Model, name: str, scale: float, slides: bool
) -> None:
    rig.params("p.json", full_file())
    rig.params("friction.json", friction_file())
    model.scale, model.slides = scale, slides
    before = Path("a.parquet").read_bytes()
    check_transcript(rig, f"predict{name}")
    assert Path("a.parquet").read_bytes() == before


def test_joints_that_stand_still_are_not_judged(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    model.slides = False
    document = json.loads(rig.run(*BASE, "--json").out)
    jsonschema.validate(document, json_schema(PREDICTION_SCHEMA))
    for key in ("rmse", "relative_rmse", "max_abs"):
        assert document["joints"]["elbow"][key] is None
    assert document["joints"]["elbow"]["samples"] == 0
    assert document["joints"]["elbow"]["samples_all"] == 2 * (SAMPLES - 1)
    assert document["joints"]["elbow"]["share_sliding"] == 0.0
    assert document["joints"]["elbow"]["rmse_all"] > 0.0
    assert document["verdicts"] == []


def test_a_joint_without_friction_is_poor_and_says_why(
    rig: Rig, reader: Reader, model: Model
) -> None:
    file = full_file()
    del file.stages.friction.joints["elbow"]
    rig.params("p.json", file)
    document = json.loads(rig.run(*BASE, "--json").out)
    assert [(v["joint"], v["good"]) for v in document["verdicts"]] == [
        ("shoulder", True),
        ("elbow", False),
        ("", False),  # as a whole
    ]
    assert document["verdicts"][1]["reason"] == "the file holds no friction of this joint"


ROBOT_TOML = (
    'schema = "seqid/robot@1"\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n'
    '[[joint]]\nname = "hip"\ndh = { alpha = 0.0, a = 0.3, d = 0.0, theta0 = 0.0 }\n'
)
RATE_HZ = 200.0
BIAS = EffectOfJoint(effect="torque_bias", joint="hip", coefficients=[0.4])
SMOOTH = EffectOfJoint(effect="unexplained", joint="hip")
SWING = ("predict", "log.parquet", "-r", "robot.toml", "-o", "out.json", "-p")


@pytest.fixture
def swinging(rig: Rig) -> Rig:
    """A robot of one joint that swings, with models without effects, a bias, and a smooth term."""
    (rig.folder / "robot.toml").write_text(ROBOT_TOML)
    t = np.arange(2000) / RATE_HZ
    q, dq = np.sin(2 * t), 2 * np.cos(2 * t)
    columns = {"t": t, "hip.position": q, "hip.torque": 0.4 + 2.0 * np.tanh(dq / 0.01) + dq}
    pq.write_table(pa.table(columns), rig.folder / "log.parquet")
    robot = load_robot(rig.folder / "robot.toml")
    joint = friction_joint([[4.0, 2.0]], speed_range=[0.0, 4.0], sign_width=0.01)
    friction = FrictionStage(joints={"hip": joint})
    for name, effects in (("plain", {}), ("bias", [BIAS]), ("smooth", [BIAS, SMOOTH])):
        more = {"effects": effects} if effects else {}
        file = with_stage(None, robot_id(robot), [], friction=friction, **more)  # type: ignore[arg-type]
        write_json_atomic(rig.folder / f"{name}.json", file)
    return rig


def test_the_prediction_changes_by_the_effects_torque(swinging: Rig) -> None:
    torques = []
    for name in ("plain", "bias"):
        assert swinging.run(*SWING, f"{name}.json", "--torques", "torques.parquet").code == 0
        torques.append(pq.read_table("torques.parquet")["hip.predicted"].to_numpy())
    assert np.median(torques[1] - torques[0]) == pytest.approx(0.4, abs=1e-9)
    document = json.loads(Path("out.json").read_text())
    assert document["joints"]["hip"]["rmse"] < 0.1
    assert "effects in the prediction: torque_bias (hip)" in document["notes"]
    assert document["stages"] == ["friction", "effects"]


def test_smooth_terms_are_left_out_unless_asked_for(swinging: Rig) -> None:
    """The term here is empty: it is only an error where it is to be used."""
    assert swinging.run(*SWING, "smooth.json").code == 0
    notes = json.loads(Path("out.json").read_text())["notes"]
    assert any("left out (--with-unexplained" in note for note in notes)
    refused = swinging.run(*SWING, "smooth.json", "--with-unexplained")
    assert refused.code == 2
    assert "$.stages.effects[1].settings" in refused.err
