from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.model.bodies.pseudo_inertia import standard_of
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import ParameterFile, RigidStage
from seqid_cli.payload import PayloadOptions, payload
from seqid_cli.payload.body import nearest_to
from seqid_cli.payload.controllers import settings_of
from seqid_cli.robot.base_parameters import STANDARD
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import PER_LINK, inverse_dynamics
from seqid_cli.robot.types import Robot
from tests import ROOT, Array
from tests.plants.arms.rigs import standard_parameters
from tests.plants.robots.stages import inertia_stage

RIG = ROOT / "sample_logs" / "six_joint"
NOISE = 0.2  # N m
BODY = standard_parameters(2.5, (0.02, -0.03, 0.08), (0.05, 0.06, 0.04), np.eye(3))
ENCODERS = PayloadOptions(source="encoder")


@cache
def arm() -> tuple[Robot, ParameterFile]:
    """Return the six-joint arm and a model of a last link of 1 kg, no friction."""
    robot = load_robot(RIG / "robot.toml")
    link = standard_parameters(1.0, (0.0, 0.0, 0.02), (0.03, 0.03, 0.03), np.eye(3))
    last = {
        f"{kind}_6": float(value) for kind, value in zip(STANDARD, link, strict=True)
    }
    stage = RigidStage(
        parameters=[], condition=1.0, rank=0, representative=last, cutoff_hz=4.0
    )
    return robot, with_stage(None, robot_id(robot), [], inertia=stage)


def carrying(body: Array, seed: int = 3) -> Recording:
    """A recording of the sample robot's motion with the torque of that model and a
    body.
    """
    robot, file = arm()
    recording = read_recording(RIG / "validation" / "fourier_1.parquet", robot)
    motion = estimate_motion(recording, robot, MotionOptions(cutoff_hz=4.0))
    links = np.zeros((robot.n, PER_LINK))
    links[-1] = [
        file.stages.inertia.representative[f"{kind}_6"] for kind in STANDARD
    ] + body
    state = (motion.q, motion.dq, motion.ddq)
    torque = inverse_dynamics(robot.chain, robot.gravity, links, *state)
    noise = NOISE * np.random.default_rng(seed).normal(size=torque.shape)
    return replace(recording, tau=torque + noise, accelerometers={})


def test_the_body_comes_back_within_its_errors() -> None:
    """The errors are those of repetition; a heavier body shows all ten parameters."""
    robot, file = arm()
    masses = []
    for seed in range(8):
        found = payload(carrying(BODY, seed), robot, file, ENCODERS)
        mass = found.payload.mass
        masses.append((mass.value - 2.5) / mass.std_error)
    assert 0.4 < float(np.sqrt(np.mean(np.square(masses)))) < 1.8
    assert mass.value == pytest.approx(2.5, rel=0.02)
    values, errors = np.array([(p.value, p.std_error) for p in found.parameters]).T
    assert [parameter.name for parameter in found.parameters] == [
        f"payload_{k}" for k in STANDARD
    ]
    assert np.all(np.abs(values - BODY) < 4.0 * errors)
    center = [x.value for x in found.payload.center_of_mass]
    assert center == pytest.approx([0.02, -0.03, 0.08], abs=0.004)
    assert [verdict.good for verdict in found.verdicts] == [True]


def test_the_errors_of_the_model_are_passed_on() -> None:
    robot, file = arm()
    last = [file.stages.inertia.representative[f"{kind}_6"] for kind in STANDARD]
    links, errors = np.vstack([np.zeros((5, PER_LINK)), last]), []
    for error in (1e-9, 1.0):
        stage = inertia_stage(robot, links, error=error)
        stage.cutoff_hz = 4.0
        model = with_stage(None, file.robot, [], inertia=stage)
        errors.append(
            payload(carrying(BODY), robot, model, ENCODERS).payload.mass.std_error
        )
    assert errors[1] > 2.0 * errors[0]


@pytest.mark.parametrize("share", [0.0, -0.3])
def test_nothing_is_zero_within_its_error_and_a_body_taken_off_is_poor(
    share: float,
) -> None:
    robot, file = arm()
    found = payload(carrying(share * BODY), robot, file, ENCODERS)
    mass = found.payload.mass
    assert abs(mass.value - share * 2.5) < 4.0 * mass.std_error
    (verdict,) = [v for v in found.verdicts if not v.joint]
    assert verdict.good is False
    assert ("swap the two" in verdict.reason) == (share < 0.0)
    assert share == 0.0 or found.settings == {}


def test_a_file_without_a_rigid_body_is_refused() -> None:
    robot, file = arm()
    with pytest.raises(ConfigError, match="holds no rigid body"):
        payload(carrying(BODY), robot, with_stage(None, file.robot, []), ENCODERS)


def test_the_nearest_body_is_no_further_than_the_true_one_is() -> None:
    """And no inertia of it is negative or larger than the other two together."""
    # of no extent
    true = standard_of(np.outer([0.06, -0.1, 0.25, 1.0], [0.06, -0.1, 0.25, 1.0]))
    for seed in range(10):
        rng = np.random.default_rng(seed)
        spread = 1e-3 * rng.normal(size=(10, 10)) * np.geomspace(1.0, 0.01, 10)
        off = np.linalg.solve(spread.T @ spread, spread.T @ rng.normal(size=10)) * 1e-6
        covariance = np.linalg.inv(spread.T @ spread) * 1e-12
        body = nearest_to(true + off, covariance)
        principal = np.linalg.eigvalsh(body.inertia)
        assert principal[0] > -1e-9
        assert principal[2] <= principal[0] + principal[1] + 1e-9
        of_true = float(np.sqrt(off @ np.linalg.solve(covariance, off)))
        assert body.distance <= of_true + 1e-3
        assert abs(body.mass - 1.0) < 5.0 * body.mass_std_error


def test_settings_are_in_the_order_of_each_controller() -> None:
    inertia = [[1.0, 0.4, 0.5], [0.4, 2.0, 0.6], [0.5, 0.6, 3.0]]
    by_column = "{1, 0.4, 0.5, 0.4, 2, 0.6, 0.5, 0.6, 3}"
    assert settings_of(1.5, (0.1, 0.2, 0.3), inertia) == {
        "urscript": (
            "set_target_payload(1.5, [0.1, 0.2, 0.3], [1, 2, 3, 0.4, 0.5, 0.6])"
        ),
        "libfranka": f"robot.setLoad(1.5, {{0.1, 0.2, 0.3}}, {by_column});",
        "ros2": (
            "{m: 1.5, com: {x: 0.1, y: 0.2, z: 0.3}, "
            "ixx: 1, ixy: 0.4, ixz: 0.5, iyy: 2, iyz: 0.6, izz: 3}"
        ),
    }
    assert (
        settings_of(1.5, (0.1, 0.2, 0.3), [])["urscript"]
        == "set_payload(1.5, [0.1, 0.2, 0.3])"
    )
