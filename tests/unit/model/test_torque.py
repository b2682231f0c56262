"""The torque model is the sum of its terms, filtered like the measured torque."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.torque import TorqueModel, friction_surfaces, sampled_friction, sliding
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import (
    base_parameters,
    base_regressor,
    standard_names,
    standard_regressor,
)
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.arms.rigs import six_joint
from tests.plants.mechanics.rigid import Rigid
from tests.plants.robots.made import made_motion
from tests.plants.robots.small import arm_6r
from tests.plants.robots.stages import friction_stage

RATE = 200.0


@pytest.fixture(scope="module")
def robot() -> Robot:
    return arm_6r(gear_ratio=101.0)


@pytest.fixture(scope="module")
def motion() -> Motion:
    """All joints on sines; the torque is any smooth one."""
    t = np.arange(800) / RATE
    lowpass = Lowpass(8.0, RATE)
    q = lowpass(np.sin(t[:, None] * np.linspace(1.5, 4.0, 6) + np.arange(6)))
    dq, ddq = differentiate(q, RATE)
    usable = np.ones(800, dtype=bool)
    usable[:60] = usable[-60:] = False
    tau = lowpass(lowpass(10 * np.cos(q)))
    return made_motion(q, dq, ddq, lowpass, tau=tau, usable=usable)


def rigid_stage(phi: Array, rotor: Array, coupling: str = "diagonal") -> RigidStage:
    values = np.concatenate([phi.ravel(), rotor]).tolist()
    known = dict(zip(standard_names(len(rotor)), values, strict=True))
    size = {"parameters": [], "condition": 1.0, "rank": 36}
    return RigidStage(**size, representative=known, rotor_coupling=coupling)


def stages(robot: Robot, coupling: str = "diagonal") -> Stages:
    arm = six_joint().arm
    inertia = rigid_stage(arm.phi, arm.rotor_inertia, coupling)
    return Stages(friction=friction_stage(robot), inertia=inertia)


@pytest.mark.parametrize("coupling", ["diagonal", "gyroscopic"])
def test_the_rigid_torque_is_the_plants(robot: Robot, motion: Motion, coupling: str) -> None:
    """Pinocchio's RNEA with rotors, as the simulated arm of the same geometry has it."""
    arm = replace(six_joint().arm, rotor_coupling=coupling == "gyroscopic")
    model = TorqueModel.from_stages(stages(robot, coupling), robot)
    rows = slice(0, 800, 40)
    state = (motion.q[rows], motion.dq[rows], motion.ddq[rows])
    rigid = Rigid(arm)
    expected = [rigid.inverse(*s) for s in zip(*state, strict=True)]
    np.testing.assert_allclose(model.rigid(*state), expected, atol=1e-9)


@pytest.mark.parametrize("coupling", ["diagonal", "gyroscopic"])
def test_prediction_is_the_regressor_times_the_parameters(
    robot: Robot, motion: Motion, coupling: str
) -> None:
    """H pi of Eq. 4, filtered once, plus friction, filtered twice; rotors' coupling is apart."""
    own = stages(robot, coupling)
    model = TorqueModel.from_stages(own, robot)
    basis = base_parameters(robot, rotor=range(6))
    arm = six_joint().arm
    phi = np.concatenate([arm.phi.ravel(), arm.rotor_inertia])
    state = (motion.q, motion.dq, motion.ddq)
    H = base_regressor(robot, basis, *state)
    coupled = standard_regressor(robot, *state, coupling=model.coupling)
    coupled -= standard_regressor(robot, *state, coupling="diagonal")
    rigid = motion.filtered(H) @ (basis.expression @ phi) + motion.filtered(coupled) @ phi
    friction = sampled_friction(friction_surfaces(own, robot), motion)
    expected = rigid + motion.filtered(motion.filtered(friction))
    np.testing.assert_allclose(model.predict(motion), expected, atol=1e-8)


def test_parts_are_models_too(robot: Robot, motion: Motion) -> None:
    arm = six_joint().arm
    gravity = rigid_stage(arm.phi, np.zeros(6))
    alone = TorqueModel.from_stages(Stages(gravity=gravity), robot)
    still = np.zeros_like(motion.q)
    rigid = Rigid(arm)
    expected = [rigid.gravity_torque(q) for q in motion.q[:10]]
    np.testing.assert_allclose(alone.rigid(motion.q, still, still)[:10], expected, atol=1e-9)
    friction = stages(robot).friction
    del friction.joints["joint_3"]
    rubbing = TorqueModel.from_stages(Stages(friction=friction), robot)
    assert not rubbing.friction(motion.q, motion.dq)[:, 2].any()
    assert not rubbing.outside(motion)[:, 2].any()
    assert not rubbing.rigid(motion.q, motion.dq, motion.ddq).any()
    np.testing.assert_allclose(
        rubbing.predict(motion),
        motion.filtered(sampled_friction(rubbing.surfaces, motion), times=2),
        atol=1e-12,
    )


def test_at_rest_the_model_allows_what_friction_can_hold(robot: Robot, motion: Motion) -> None:
    model = TorqueModel.from_stages(stages(robot), robot)
    rigid = motion.filtered(model.rigid(motion.q, motion.dq, motion.ddq))
    held = np.zeros_like(motion.moving)
    bands = [s.at_rest(motion.q[:, j]) for j, s in enumerate(model.surfaces) if s is not None]
    low, high = (np.stack(side, axis=1) for side in zip(*bands, strict=True))
    own = model.predict(motion)
    at_rest = model.predict_set(motion, held)
    np.testing.assert_array_equal(at_rest.value, own)
    np.testing.assert_allclose(at_rest.low, np.minimum(rigid + low, own), atol=1e-9)
    np.testing.assert_allclose(at_rest.high, np.maximum(rigid + high, own), atol=1e-9)
    moving = model.predict_set(motion, ~held)
    for found in (moving.value, moving.low, moving.high):
        np.testing.assert_array_equal(found, own)
    blind = model.predict_set(replace(motion, tau=None), held)
    np.testing.assert_array_equal(blind.low, at_rest.low)


def test_sliding_leaves_out_rest_and_its_neighbourhood(motion: Motion) -> None:
    slow = np.full(6, 0.3)
    slides = sliding(motion, slow)
    assert slides.any()
    assert not slides[~motion.usable].any()
    assert not (slides & (np.abs(motion.dq) < slow)).any()
    reach = int(0.25 * RATE / 8.0)
    crossing = np.flatnonzero(np.diff(np.sign(motion.dq[:, 0])))
    for k in crossing[(crossing > reach) & (crossing < 800 - reach)]:
        assert not slides[k - reach + 1 : k + reach, 0].any()
