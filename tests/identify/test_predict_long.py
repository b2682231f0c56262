"""Logs that are passed over are predicted as held ones are."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify import predict_long
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.predict import LogPrediction, predict
from seqid_cli.identify.predict_long import LongPrediction
from seqid_cli.logs.read import read_recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion import blocks
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.survey import open_surveyed
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base import standard_names
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.bench.arm import known_friction, write_arm, write_log

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
    assert robot.nominal is not None
    values = np.concatenate([1.02 * robot.nominal.ravel(), np.zeros(robot.n)])
    names = standard_names(robot.n)
    representative = dict(zip(names, values.tolist(), strict=True))
    inertia = RigidStage(parameters=[], condition=1.0, rank=1, representative=representative)
    return Stages(friction=known_friction().friction, inertia=inertia)


@pytest.fixture(autouse=True)
def _many_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predict_long, "ROWS", 7_000)
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
    for name in ("t", "tau", "predicted", "q", "dq"):
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
    assert held.motion is not None
    assert parts[-1].motion is not None
    assert parts[-1].motion.source == held.motion.source == "encoder"
    assert parts[-1].motion.acceleration_error == pytest.approx(held.motion.acceleration_error)


@pytest.mark.parametrize("cutoff", [None, 20.0])
def test_the_parts_are_the_held_log(
    cutoff: float | None, folder: Path, robot: Robot, stages: Stages
) -> None:
    options = InertiaOptions(source="encoder", motion=MotionOptions(cutoff_hz=cutoff))
    path = folder / "log.parquet"
    parts = list(long_of(path, robot, stages, options).parts())
    assert len(parts) >= 3
    assert_same(parts, held_of(path, robot, stages, options))


def test_it_can_be_sent_elsewhere(folder: Path, robot: Robot, stages: Stages) -> None:
    options = InertiaOptions(source="encoder")
    path = folder / "log.parquet"
    long = long_of(path, robot, stages, options)
    sent = pickle.dumps(long)
    assert len(sent) < 100_000
    parts = list(pickle.loads(sent).parts())
    for part, other in zip(parts, long.parts(), strict=True):
        np.testing.assert_array_equal(part.predicted, other.predicted)
