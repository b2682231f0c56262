import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.logs.recording import Recording
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.robot.types import Robot
from tests.commands.conftest import SAMPLES, Reader, Rig
from tests.plants.robots.made import made_prediction
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
    done = rig.run(*BOTH)
    assert done.code == 0
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
    assert "a.parquet: a remark" in done.err


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


def test_a_large_error_is_poor(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    model.scale = 3.0
    done = rig.run(*BASE, "--strict")
    assert done.code == 1
    assert "of the torque's RMS, above 30.0 %" in done.out
    assert rig.run(*BASE).code == 0


def test_joints_that_stand_still_are_not_judged(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    model.slides = False
    done = rig.run(*BASE, "--json")
    document = json.loads(done.out)
    jsonschema.validate(document, json_schema(PREDICTION_SCHEMA))
    for key in ("rmse", "relative_rmse", "max_abs"):
        assert document["joints"]["elbow"][key] is None
    assert document["joints"]["elbow"]["samples"] == 0
    assert document["joints"]["elbow"]["samples_all"] == 2 * (SAMPLES - 1)
    assert document["joints"]["elbow"]["share_sliding"] == 0.0
    assert document["joints"]["elbow"]["rmse_all"] > 0.0
    assert document["verdicts"] == []
    assert "never slides in these logs and is not judged: shoulder, elbow" in done.err


def test_a_file_without_inertia_is_poor_and_says_why(
    rig: Rig, reader: Reader, model: Model
) -> None:
    rig.params("p.json", friction_file())
    done = rig.run(*BASE, "--strict")
    assert done.code == 1
    assert "poor: the file holds no inertia stage" in done.out


def test_a_joint_without_friction_is_poor_and_says_why(
    rig: Rig, reader: Reader, model: Model
) -> None:
    file = full_file()
    assert file.stages.friction is not None
    del file.stages.friction.joints["elbow"]
    rig.params("p.json", file)
    document = json.loads(rig.run(*BASE, "--json").out)
    assert [(v["joint"], v["good"]) for v in document["verdicts"]] == [
        ("shoulder", True),
        ("elbow", False),
        ("", False),  # as a whole
    ]
    assert document["verdicts"][1]["reason"] == "the file holds no friction of this joint"


def test_outputs_must_not_be_inputs(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    before = Path("a.parquet").read_bytes()
    assert rig.run(*BASE, "--torques", "a.parquet").code == 2
    assert Path("a.parquet").read_bytes() == before


def test_the_two_outputs_must_differ(rig: Rig) -> None:
    rig.params("p.json", full_file())
    done = rig.run(*BASE, "-o", "x", "--torques", "./x")
    assert done.code == 2
    assert "x: -o and --torques name the same file" in done.err
