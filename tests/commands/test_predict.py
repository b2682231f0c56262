"""`seqid predict`: files, verdicts, messages; refined files; `--motion`, also of other
commands.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import jsonschema
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.inspect.screening import Opened
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import SCHEMA, EffectOfJoint, FrictionStage
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.commands.conftest import SAMPLE_LOGS, SAMPLES, Reader, Rig
from tests.plants.robotfile import robot_toml
from tests.plants.robots.made import friction_joint, made_prediction
from tests.unit.imu.smoother.rigs import scene
from tests.unit.params.documents import friction_file, full_file
from tests.unit.params.generate import json_schema

BASE = ["predict", "a.parquet", "b.parquet", "-r", "robot.toml", "-p", "p.json"]
BOTH = [*BASE, "-o", "out.json", "--torques", "t.parquet"]


@dataclass
class Model:
    """Predicts torque with errors of `scale` times a standard normal; the seed is
    fixed.
    """

    scale: float = 0.1
    fail_after: int = 99
    slides: bool = True
    made: list[LogPrediction] = field(default_factory=list)

    def predict(
        self, recordings: Iterable[Recording], robot: Robot, *_: object, **__: object
    ) -> Iterator[LogPrediction]:
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
            bounds = {"low": predicted - wide, "high": predicted + wide}
            bounds["std"] = np.full(tau.shape, self.scale)
            more = {
                "sha256": recording.sha256,
                "t": recording.t,
                "notes": ("a remark",),
            }
            log = made_prediction(
                str(recording.path),
                tau,
                predicted,
                used=used,
                sliding=sliding,
                **bounds,
                **more,
            )
            self.made.append(log)
            yield log


@pytest.fixture
def model(monkeypatch: pytest.MonkeyPatch) -> Model:
    fake = Model()
    monkeypatch.setattr("seqid_cli.identify.prediction.predict.predict", fake.predict)
    return fake


def root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


KINDS = ("torque", "predicted", "residual", "sliding", "std", "low", "high")


def test_errors_are_those_of_the_torques(
    rig: Rig, reader: Reader, model: Model
) -> None:
    rig.params("p.json", full_file())
    assert rig.run(*BOTH).code == 0
    document = json.loads((rig.folder / "out.json").read_text())
    jsonschema.validate(document, json_schema(PREDICTION_SCHEMA))
    table, joints = pq.read_table(rig.folder / "t.parquet"), ("shoulder", "elbow")
    own = [f"{name}.{kind}" for name in joints for kind in KINDS]
    motion = [f"{name}.{kind}" for name in joints for kind in ("position", "velocity")]
    assert table.column_names == ["t", "log", *own, "used", *motion]
    assert table["log"].to_pylist() == ["a.parquet"] * SAMPLES + ["b.parquet"] * SAMPLES
    used = table["used"].to_numpy()
    for joint, name in enumerate(joints):
        columns = {kind: table[f"{name}.{kind}"].to_numpy() for kind in KINDS}
        for kind, of in (
            ("torque", "tau"),
            ("predicted", "predicted"),
            ("sliding", "sliding"),
        ):
            truth = np.concatenate([getattr(log, of)[:, joint] for log in model.made])
            np.testing.assert_array_equal(columns[kind], truth)
        tau, predicted, residual, slides = (columns[kind] for kind in KINDS[:4])
        np.testing.assert_allclose(residual, tau - predicted)
        for kind, wide in (("low", -0.05), ("high", 0.05)):
            np.testing.assert_allclose(
                columns[kind], np.where(slides, np.nan, predicted + wide)
            )
        found, error = document["joints"][name], residual[slides]
        assert found["samples"] == 2 * (SAMPLES - 1 - joint)
        assert found["samples_all"] == 2 * (SAMPLES - 1)
        assert found["share_sliding"] == pytest.approx(1 - joint / (SAMPLES - 1))
        assert found["rmse"] == pytest.approx(root_mean_square(error))
        expected = root_mean_square(error) / root_mean_square(tau[slides])
        assert found["relative_rmse"] == pytest.approx(expected)
        assert found["max_abs"] == pytest.approx(np.max(np.abs(error)))
        beyond = np.maximum(np.abs(residual) - np.where(slides, 0.0, 0.05), 0.0)
        assert found["rmse_all"] == pytest.approx(root_mean_square(beyond[used]))
        rests = used & ~slides
        squares = found["samples"] * found["rmse_inside"] ** 2
        assert found["rmse_outside"] is None
        if rests.any():
            assert found["rmse_rest"] == pytest.approx(root_mean_square(beyond[rests]))
            squares += rests.sum() * found["rmse_rest"] ** 2
        assert np.sqrt(squares / used.sum()) == pytest.approx(found["rmse_all"])
        assert found["std"] == pytest.approx(model.scale)
        overall = found["coverage"]["overall"]
        assert overall["band_90"] == np.mean(np.abs(error) <= 1.645 * model.scale)
        assert overall["band_95"] == np.mean(np.abs(error) <= 1.96 * model.scale)
        assert (overall["samples"], overall["blocks"]) == (len(error), 2)
    assert [log["path"] for log in document["logs"]] == ["a.parquet", "b.parquet"]
    assert document["logs"][0]["joints"]["elbow"]["samples"] == SAMPLES - 2
    assert document["parameters"][0]["path"] == "p.json"
    assert document["stages"] == ["friction", "gravity", "imu", "inertia", "effects"]


def test_a_failure_leaves_the_old_files(rig: Rig, reader: Reader, model: Model) -> None:
    rig.params("p.json", full_file())
    (rig.folder / "t.parquet").write_text("old")
    before = sorted(path.name for path in rig.folder.iterdir())
    model.fail_after = 1
    assert rig.run(*BOTH).code == 70
    assert (rig.folder / "t.parquet").read_text() == "old"
    assert sorted(path.name for path in rig.folder.iterdir()) == before


@pytest.mark.parametrize(
    ("name", "scale", "slides"),
    [("", 0.1, True), ("_poor", 3.0, True), ("_still", 0.1, False)],
)
def test_what_the_user_sees(
    rig: Rig, reader: Reader, model: Model, name: str, scale: float, slides: bool
) -> None:
    rig.params("p.json", full_file())
    rig.params("friction.json", friction_file())
    bare = full_file()
    bare.stages.imu = None
    rig.params("bare.json", bare)
    model.scale, model.slides = scale, slides
    before = Path("a.parquet").read_bytes()
    rig.check_transcript(f"predict{name}")
    assert Path("a.parquet").read_bytes() == before


def test_joints_that_stand_still_are_not_judged(
    rig: Rig, reader: Reader, model: Model
) -> None:
    rig.params("p.json", full_file())
    model.slides = False
    document = json.loads(rig.run(*BASE, "--json").out)
    jsonschema.validate(document, json_schema(PREDICTION_SCHEMA))
    elbow = document["joints"]["elbow"]
    assert elbow.pop("rmse_all") == elbow.pop("rmse_rest") > 0.0
    parts = (
        "rmse_inside",
        "rmse_outside",
        "share_outside",
        "std",
        "parameter_std",
        "coverage",
    )
    none = dict.fromkeys(("rmse", "relative_rmse", "max_abs", *parts))
    assert elbow == {
        **none,
        "samples": 0,
        "samples_all": 2 * (SAMPLES - 1),
        "share_sliding": 0.0,
    }
    assert document["verdicts"] == []


def test_a_joint_without_friction_is_poor(
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
    assert (
        document["verdicts"][1]["reason"] == "the file holds no friction of this joint"
    )


ROBOT_TOML = (
    'schema = "seqid/robot@1"\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n'
    '[[joint]]\nname = "hip"\ndh = { alpha = 0.0, a = 0.3, d = 0.0, theta0 = 0.0 }\n'
)
BIAS = EffectOfJoint(effect="torque_bias", joint="hip", coefficients=[0.4])
SMOOTH = EffectOfJoint(effect="unexplained", joint="hip")
SWING = ("predict", "log.parquet", "-r", "robot.toml", "-o", "out.json", "-p")


@pytest.fixture
def swinging(rig: Rig) -> Rig:
    """A robot of one joint that swings, with models without effects, a bias, and a
    smooth term.
    """
    (rig.folder / "robot.toml").write_text(ROBOT_TOML)
    t = np.arange(2000) / 200.0
    q, dq = np.sin(2 * t), 2 * np.cos(2 * t)
    columns = {
        "t": t,
        "hip.position": q,
        "hip.torque": 0.4 + 2.0 * np.tanh(dq / 0.01) + dq,
    }
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
        assert (
            swinging.run(*SWING, f"{name}.json", "--torques", "torques.parquet").code
            == 0
        )
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


@pytest.fixture
def recordings(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """Two simulated logs of the planar rig, which may be changed; its calibrations lie
    beside.
    """
    s = scene("two")
    (rig.folder / "robot.toml").write_text(robot_toml("two", s.plant), encoding="ascii")
    robot = load_robot(rig.folder / "robot.toml")
    write_json_atomic(
        rig.folder / "p.json", with_stage(None, robot_id(robot), [], imu=s.stage)
    )
    logs = [
        replace(s.recording, path=Path(f"{name}.parquet"), sha256=name * 64)
        for name in "ab"
    ]

    def read(path: Path, robot: Robot, **options: object) -> Opened:
        return Opened(next(log for log in logs if log.path.name == Path(path).name), ())

    monkeypatch.setattr("seqid_cli.identify.log_set.open_screened", read)
    return logs


def without(recording: Recording, *names: str) -> Recording:
    kept = {k: v for k, v in recording.accelerometers.items() if k not in names}
    return replace(recording, accelerometers=kept)


def test_a_prediction_says_what_motion_it_rests_on(
    rig: Rig, recordings: list[Recording]
) -> None:
    done = rig.run(*BASE, "--json")
    assert done.code == 0
    file = json.loads(done.out)
    jsonschema.validate(file, json_schema(PREDICTION_SCHEMA))
    for log in file["logs"]:
        used = log["motion"]
        assert (used["source"], used["imus"]) == ("fused", ["imu_a", "imu_b"])
        assert used["cutoff_hz"] == log["cutoff_hz"]
        for joint in ("joint_1", "joint_2"):
            assert (
                used["acceleration_error"][joint] < 0.2 * used["encoder_error"][joint]
            )
    assert (
        "motion: fused (imu_a, imu_b) in 2 of 2 logs; acceleration known to 0.0"
        in done.err
    )


def test_a_log_without_imus_falls_back_unless_told(
    rig: Rig, recordings: list[Recording]
) -> None:
    recordings[1] = without(recordings[1], "imu_a", "imu_b")
    done = rig.run(*BASE, "--json")
    assert done.code == 0
    assert [log["motion"]["source"] for log in json.loads(done.out)["logs"]] == [
        "fused",
        "encoder",
    ]
    for imu in ("imu_a", "imu_b"):
        assert f"warning: b.parquet: {imu} is not recorded" in done.err
    assert "fused (imu_a, imu_b) in 1 of 2 logs, encoder in 1 of 2 logs" in done.err
    for source in ("imu", "fused"):
        done = rig.run(*BASE, "--motion", source)
        assert done.code == 2
        assert (
            f"b.parquet: no calibrated, healthy IMU for --motion {source}" in done.err
        )
        assert "imu_a is not recorded" in done.err
        assert "use --motion encoder" in done.err


def test_the_same_warning_of_many_logs_is_one_line(
    rig: Rig, recordings: list[Recording]
) -> None:
    recordings[:] = [without(log, "imu_b") for log in recordings]
    done = rig.run(*BASE)
    assert done.err.count("imu_b is not recorded") == 1
    assert "imu_b is not recorded (2 of 2 logs)" in done.err


def test_a_simultaneous_fit_says_its_motion(
    rig: Rig, recordings: list[Recording]
) -> None:
    done = rig.run("simultaneous", *BASE[1:], "--json", "-o", "out.json")
    assert done.code == 0
    file = json.loads(done.out)
    jsonschema.validate(file, json_schema(SCHEMA))
    assert file["stages"]["imu"]
    assert file["stages"].get("gravity") is None
    inertia = file["stages"]["inertia"]
    used = [(use["source"], use["cutoff_hz"]) for use in inertia["motion_use"]]
    assert used == [("fused", inertia["cutoff_hz"])] * 2
    assert inertia["motion"]["a.parquet"] == "fused: imu_a, imu_b"
    assert "motion: fused" in done.err


@pytest.mark.parametrize(("cutoff", "noisy"), [([], True), (["--cutoff", "6"], False)])
def test_encoder_noise_in_the_error_is_told(
    rig: Rig, cutoff: list[str], *, noisy: bool
) -> None:
    two = SAMPLE_LOGS / "two_joint"
    model = (
        "-r",
        str(two / "robot.toml"),
        "-p",
        str(two / "golden.json"),
        "--motion",
        "encoder",
    )
    done = rig.run(
        "predict", str(two / "changed" / "held_out.parquet"), *model, *cutoff, "--json"
    )
    document = json.loads(done.out)
    told = [
        note for note in document["logs"][0]["notes"] if "noise of the encoders" in note
    ]
    assert bool(told) == noisy
    assert (document["joints"]["joint_1"]["relative_rmse"] > 0.3) == noisy
