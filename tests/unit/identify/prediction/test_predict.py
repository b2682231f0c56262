"""Predictions: long logs as held ones, blind to the measured torque, at rest what
effects allow.
"""

import pickle
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from seqid_cli.effects.apply import scene_of_log
from seqid_cli.effects.fitted import FittedEffect, as_stage, fitted_effects
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import (
    LogPrediction,
    LongPrediction,
    Predictor,
    predict,
)
from seqid_cli.logs.long import open_long
from seqid_cli.logs.read import read_recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion import blocks
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import EffectOfJoint, EffectSession, FrictionStage, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.made import friction_joint, made_recording
from tests.plants.robots.seven_joint import JOINTS, known_model, write_arm, write_log
from tests.plants.robots.two_joint import COULOMB, SIGN_WIDTH, VISCOUS, two_joint_robot
from tests.unit.effects.scenes import CUTOFF_HZ, RATE_HZ, settings_of, wander
from tests.unit.inspect.faults import read_columns, write_columns

ROWS, MOVING = 30_000, 24_000
SAID = ("predicted", "low", "high", "sliding", "used", "q", "dq", "ddq")
OPTIONS = InertiaOptions(source="encoder")
EFFECTS = [
    EffectOfJoint(effect="torque_bias", joint="joint_2", coefficients=[0.4]),
    EffectOfJoint(
        effect="load_dependent_friction", joint="joint_3", coefficients=[0.1]
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of the same motion, a rest at its end, whose torques have nothing in
    common.
    """
    folder = tmp_path_factory.mktemp("arm")
    path = write_log(folder / "log.parquet", load_robot(write_arm(folder)), ROWS)
    columns, rng = read_columns(path), np.random.default_rng(3)
    for name in JOINTS:
        columns[f"{name}.position"][MOVING:] = columns[f"{name}.position"][MOVING]
    write_columns(path, columns)
    for name in JOINTS:
        columns[f"{name}.torque"] = 7.0 + 100.0 * rng.standard_normal(ROWS)
    write_columns(folder / "other.parquet", columns)
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


def long_of(path: Path, robot: Robot, stages: Stages) -> Iterable[LogPrediction]:
    model, effects = (
        TorqueModel.from_stages(stages, robot),
        fitted_effects(stages, robot),
    )
    predictor = Predictor(model=model, stages=stages, options=OPTIONS, effects=effects)
    return predictor(open_long(path, robot), 0)


def held_of(path: Path, robot: Robot, stages: Stages) -> LogPrediction:
    (held,) = predict([read_recording(path, robot)], robot, stages, options=OPTIONS)
    return held


@pytest.fixture(scope="module")
def all_local(folder: Path, robot: Robot, stages: Stages) -> list[FittedEffect]:
    """Every effect of the catalogue that can be told part by part, each of some N m."""
    recording = read_recording(folder / "log.parquet", robot)
    given = (
        TorqueModel.from_stages(stages, robot),
        estimate_motion(recording, robot, MotionOptions()),
    )
    scene = scene_of_log(recording, robot, *given)
    session = EffectSession(
        logs=[recording.sha256], starts=[0.0], origin=recording.start
    )
    found = []
    for effect in CATALOGUE.values():
        if effect.name == "external_contact":
            continue
        joint = None if effect.arm else 1
        for settings in settings_of(effect, [scene], joint)[:1]:
            columns = effect.columns(scene, joint, settings).values()
            size = max(float(np.sqrt(np.mean(X**2))) for X in columns)
            count = len(effect.coefficients(settings))
            # What shifts torque in time takes its derivative, and that of rounding
            # errors.
            values = np.full(count, (0.1 if effect.timing else 2.0) / max(size, 1e-9))
            found.append(
                FittedEffect(
                    effect=effect,
                    joint=joint,
                    settings=settings,
                    coefficients=values,
                    covariance=np.eye(count),
                    session=session,
                )
            )
    return [each for each in found if each.local]


@pytest.mark.parametrize(
    "with_effects", [False, pytest.param(True, marks=pytest.mark.slow)]
)
def test_the_parts_are_the_held_log(
    with_effects: bool,
    folder: Path,
    robot: Robot,
    stages: Stages,
    request: pytest.FixtureRequest,
) -> None:
    """Sent elsewhere, too, which takes no more than the model."""
    path, whole = folder / "log.parquet", stages
    if with_effects:
        all_local = request.getfixturevalue("all_local")
        assert len(all_local) >= 18
        whole = replace(stages, effects=[as_stage(x, robot) for x in all_local])
    sent = pickle.dumps(long_of(path, robot, whole))
    assert len(sent) < 100_000
    parts, held = list(pickle.loads(sent)), held_of(path, robot, whole)
    assert [part.part for part in parts] == list(range(len(parts)))
    assert [part.last for part in parts] == [False] * (len(parts) - 1) + [True]
    assert len(parts) >= 3
    for name in ("t", "tau", *SAID[:-1]):  # ddq is that of differences: rounding shows
        found = np.concatenate([getattr(part, name) for part in parts])
        expected = getattr(held, name)
        limit = 1e-9 * np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=limit, err_msg=name)
    for part in parts:
        assert (part.path, part.sha256, part.samples) == (
            held.path,
            held.sha256,
            held.samples,
        )
        assert part.cutoff_hz == pytest.approx(held.cutoff_hz, rel=1e-9)
        assert part.start == pytest.approx(held.start, abs=1e-9)
    assert parts[-1].notes == held.notes
    assert parts[-1].motion.source == held.motion.source == "encoder"
    assert held.motion.acceleration_error
    assert parts[-1].motion.acceleration_error == pytest.approx(
        held.motion.acceleration_error
    )
    if with_effects:
        bare = held_of(path, robot, stages)
        assert np.sqrt(np.mean((held.predicted - bare.predicted) ** 2)) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("way", ["held", "passed over"])
def test_another_torque_changes_nothing_of_the_prediction(
    way: str, folder: Path, robot: Robot, stages: Stages
) -> None:
    told = replace(stages, effects=EFFECTS)

    def predicted(name: str) -> Iterable[LogPrediction]:
        given = folder / name, robot, told
        return [held_of(*given)] if way == "held" else long_of(*given)

    states = set()
    for one, other in zip(
        predicted("log.parquet"), predicted("other.parquet"), strict=True
    ):
        assert not np.isclose(one.tau, other.tau).all()
        for name in SAID:
            np.testing.assert_array_equal(
                getattr(one, name), getattr(other, name), err_msg=name
            )
        states |= set(one.sliding[one.used].ravel().tolist())
        at_rest = ~one.sliding & one.used[:, None]
        assert np.all((one.high - one.low)[at_rest] > 0.0)
        np.testing.assert_array_equal(one.high[one.sliding], one.predicted[one.sliding])
    assert states == {True, False}


def test_rest_holds_what_the_effects_allow() -> None:
    """Above the friction surface, within it and the hump: no error once the hump is
    known.
    """
    robot, top, hump, speed = two_joint_robot(), 4.0, 1.0, 0.3
    half, own = (
        0.5 * top * np.array(VISCOUS),
        {"speed_range": [0.0, top], "sign_width": SIGN_WIDTH},
    )
    entries = np.column_stack([COULOMB + half, half])
    each = zip(robot.joint_names, entries, strict=True)
    joints = {name: friction_joint([entry], **own) for name, entry in each}
    told = {
        "settings": {"stribeck_speed": speed, "exponent": 2.0},
        "coefficients": [hump],
    }
    stribeck = EffectOfJoint(effect="stribeck", joint="joint_1", **told)
    q = wander(20.0, seed=2)
    dq = np.gradient(q, 1.0 / RATE_HZ, axis=0)
    s = np.tanh(dq / SIGN_WIDTH)
    tau = s * np.array(COULOMB) + np.array(VISCOUS) * dq + [0.0, 0.4]
    tau[:, 0] += hump * np.exp(-((dq[:, 0] / speed) ** 2)) * s[:, 0]
    t = np.arange(len(q)) / RATE_HZ
    # all that the joint can hold
    tau[(t > 5.3) & (t < 6.7), 0] = COULOMB[0] + 0.95 * hump
    options = InertiaOptions(motion=MotionOptions(cutoff_hz=CUTOFF_HZ))
    still = (t > 5.6) & (t < 6.4)
    for effects, beyond, within in ((None, 0.95 * hump, 0.15), ([stribeck], 0.0, 1e-6)):
        stages = Stages(friction=FrictionStage(joints=joints), effects=effects)
        recording = made_recording(q, tau, rate_hz=RATE_HZ)
        (log,) = predict([recording], robot, stages, options=options)
        assert not log.sliding[still, 0].any()
        np.testing.assert_allclose(log.beyond[still, 0], beyond, atol=within)
