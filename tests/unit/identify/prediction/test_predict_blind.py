"""The prediction is the model's own: another measured torque changes nothing of it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, LongPrediction, predict
from seqid_cli.logs.read import read_recording
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion import blocks
from seqid_cli.motion.blocks import open_surveyed
from seqid_cli.params.schema import EffectOfJoint, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.seven_joint import known_model, write_arm, write_log

ROWS, MOVING = 24_000, 18_000
SAID = ("predicted", "low", "high", "sliding", "used", "q", "dq", "ddq")
OPTIONS = InertiaOptions(source="encoder")
EFFECTS = [
    EffectOfJoint(effect="torque_bias", joint="joint_2", coefficients=[0.4]),
    EffectOfJoint(effect="load_dependent_friction", joint="joint_3", coefficients=[0.1]),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of the same motion, a rest at its end, whose torques have nothing in common."""
    folder = tmp_path_factory.mktemp("arm")
    path = write_log(folder / "log.parquet", load_robot(write_arm(folder)), ROWS)
    columns = {k: np.array(v) for k, v in pq.read_table(path).to_pydict().items()}
    for name in columns:
        if name.endswith(".position"):
            columns[name][MOVING:] = columns[name][MOVING]
    pq.write_table(pa.table(columns), path)
    rng = np.random.default_rng(3)
    for name in columns:
        if name.endswith(".torque"):
            columns[name] = 7.0 + 100.0 * rng.standard_normal(ROWS)
    pq.write_table(pa.table(columns), folder / "other.parquet")
    return folder


@pytest.fixture(scope="module")
def robot(folder: Path) -> Robot:
    return load_robot(folder / "robot.toml")


@pytest.fixture(scope="module")
def stages(robot: Robot) -> Stages:
    return replace(known_model(robot), effects=EFFECTS)


def held(path: Path, robot: Robot, stages: Stages) -> Iterator[LogPrediction]:
    return predict([read_recording(path, robot)], robot, stages, options=OPTIONS)


def passed_over(path: Path, robot: Robot, stages: Stages) -> Iterator[LogPrediction]:
    log = open_surveyed(path, robot)
    assert log is not None
    model, effects = TorqueModel.from_stages(stages, robot), fitted_effects(stages, robot)
    return iter(LongPrediction.of(log, model, stages, OPTIONS, effects))


@pytest.mark.slow
@pytest.mark.parametrize("way", [held, passed_over])
def test_another_torque_changes_nothing_of_the_prediction(
    way: object, folder: Path, robot: Robot, stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LongPrediction, "rows", 7_000)
    monkeypatch.setattr(blocks, "LEAST_BLOCK", 9_000)
    assert callable(way)
    pairs = zip(
        way(folder / "log.parquet", robot, stages),
        way(folder / "other.parquet", robot, stages),
        strict=True,
    )
    states = set()
    for one, other in pairs:
        assert not np.isclose(one.tau, other.tau).all()
        for name in SAID:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
        states |= set(one.sliding[one.used].ravel().tolist())
        at_rest = ~one.sliding & one.used[:, None]
        assert np.all((one.high - one.low)[at_rest] > 0.0)
        np.testing.assert_array_equal(one.high[one.sliding], one.predicted[one.sliding])
    assert states == {True, False}
