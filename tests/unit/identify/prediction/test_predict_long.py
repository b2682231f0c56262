"""Logs that are passed over are predicted as held ones are."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import (
    LogPrediction,
    LongPrediction,
    predict,
)
from seqid_cli.logs.read import read_recording
from seqid_cli.model.effects.apply import scene_of_log
from seqid_cli.model.effects.fitted import FittedEffect, as_stage
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion import blocks
from seqid_cli.motion.blocks import open_surveyed
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import EffectSession, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.seven_joint import known_model, write_arm, write_log
from tests.unit.model.effects.scenes import settings_of

ROWS = 40_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    write_log(folder / "log.parquet", load_robot(write_arm(folder)), ROWS)
    return folder


@pytest.fixture(scope="module")
def robot(folder: Path) -> Robot:
    return load_robot(folder / "robot.toml")


@pytest.fixture(scope="module")
def stages(robot: Robot) -> Stages:
    return known_model(robot, 1.02)


@pytest.fixture(autouse=True)
def _many_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LongPrediction, "rows", 7_000)
    monkeypatch.setattr(blocks, "LEAST_BLOCK", 9_000)


def long_of(path: Path, robot: Robot, stages: Stages, options: InertiaOptions) -> LongPrediction:
    log = open_surveyed(path, robot)
    assert log is not None
    return LongPrediction.of(log, TorqueModel.from_stages(stages, robot), stages, options)


def held_of(path: Path, robot: Robot, stages: Stages, options: InertiaOptions) -> LogPrediction:
    (held,) = predict([read_recording(path, robot)], robot, stages, options=options)
    return held


def assert_same(parts: list[LogPrediction], held: LogPrediction) -> None:
    assert [part.part for part in parts] == list(range(len(parts)))
    assert [part.last for part in parts] == [False] * (len(parts) - 1) + [True]
    for name in ("t", "tau", "predicted", "low", "high", "q", "dq"):
        found = np.concatenate([getattr(part, name) for part in parts])
        expected = getattr(held, name)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * scale, err_msg=name)
    for name in ("used", "sliding"):
        found = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(found, getattr(held, name))
    for part in parts:
        assert (part.path, part.sha256, part.samples) == (held.path, held.sha256, held.samples)
        assert part.cutoff_hz == pytest.approx(held.cutoff_hz, rel=1e-9)
        assert part.start == pytest.approx(held.start, abs=1e-9)
    assert parts[-1].notes == held.notes
    assert parts[-1].motion.source == held.motion.source == "encoder"
    assert parts[-1].motion.acceleration_error == pytest.approx(held.motion.acceleration_error)


@pytest.mark.parametrize("cutoff", [None, 20.0])
def test_the_parts_are_the_held_log(
    cutoff: float | None, folder: Path, robot: Robot, stages: Stages
) -> None:
    options = InertiaOptions(source="encoder", motion=MotionOptions(cutoff_hz=cutoff))
    path = folder / "log.parquet"
    parts = list(long_of(path, robot, stages, options))
    assert len(parts) >= 3
    assert_same(parts, held_of(path, robot, stages, options))


@pytest.fixture(scope="module")
def all_local(folder: Path, robot: Robot, stages: Stages) -> list[FittedEffect]:
    """Every effect of the catalogue that can be told part by part, each of some N m."""
    recording = read_recording(folder / "log.parquet", robot)
    model = TorqueModel.from_stages(stages, robot)
    motion = estimate_motion(recording, robot, MotionOptions())
    scene = scene_of_log(recording, robot, model, motion)
    found = []
    for effect in CATALOGUE.values():
        joint = None if effect.arm else 1
        grid = settings_of(effect, [scene], joint)
        for settings in grid[:1] if effect.name != "external_contact" else []:
            columns = effect.columns(scene, joint, settings)
            size = max(float(np.sqrt(np.mean(X**2))) for X in columns.values())
            count = len(effect.coefficients(settings))
            # What shifts torque in time takes its derivative, and that of rounding errors.
            wanted = 0.1 if effect.timing else 2.0
            values = np.full(count, wanted / max(size, 1e-9))
            session = EffectSession(logs=[recording.sha256], starts=[0.0], origin=recording.start)
            fitted = FittedEffect(effect, joint, settings, values, np.eye(count), session)
            if fitted.local:
                found.append(fitted)
    return found


@pytest.mark.slow
def test_effects_are_told_part_by_part(
    folder: Path, robot: Robot, stages: Stages, all_local: list[FittedEffect]
) -> None:
    path, options = folder / "log.parquet", InertiaOptions(source="encoder")
    assert len(all_local) >= 18
    whole = Stages(
        friction=stages.friction,
        inertia=stages.inertia,
        effects=[as_stage(x, robot) for x in all_local],
    )
    log = open_surveyed(path, robot)
    assert log is not None
    (*_, last) = parts = list(predict([log], robot, whole, options=options))  # type: ignore[list-item]
    assert last.part > 1
    held = held_of(path, robot, whole, options)
    assert_same(parts, held)
    bare = held_of(path, robot, stages, options)
    assert np.sqrt(np.mean((held.predicted - bare.predicted) ** 2)) > 1.0


def test_it_can_be_sent_elsewhere(folder: Path, robot: Robot, stages: Stages) -> None:
    options = InertiaOptions(source="encoder")
    path = folder / "log.parquet"
    long = long_of(path, robot, stages, options)
    sent = pickle.dumps(long)
    assert len(sent) < 100_000
    parts = list(pickle.loads(sent))
    for part, other in zip(parts, long, strict=True):
        np.testing.assert_array_equal(part.predicted, other.predicted)
