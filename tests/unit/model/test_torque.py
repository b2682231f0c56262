"""The torque model is the sum of its terms, filtered like the measured torque."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.friction import friction_torque
from seqid_cli.model.torque import (
    TorqueModel,
    sampled_friction,
    sliding,
    slowest_near,
)
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion, decimated
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import (
    base_parameters,
    base_regressor,
    standard_names,
)
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.arms.rigs import six_joint
from tests.plants.mechanics.rigid import Rigid
from tests.plants.robots.made import made_motion
from tests.plants.robots.small import arm_6r
from tests.plants.robots.stages import friction_stage
from tests.plants.robots.two_joint import friction_surface

RATE = 200.0
ARM = six_joint().arm


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


def test_speeds_near_by_are_looked_at_joint_by_joint() -> None:
    """A joint has many points between two samples, and all of them would take room."""
    rng = np.random.default_rng(0)
    still = np.zeros((20_000, 6))
    velocity = rng.normal(size=still.shape)
    moving = made_motion(still, velocity, still, Lowpass(20.0, 200.0))
    tracemalloc.start()
    nearest = slowest_near(moving, velocity)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10 * velocity.nbytes
    for joint in range(6):
        alone = slowest_near(moving, velocity[:, [joint]])
        np.testing.assert_array_equal(nearest[:, [joint]], alone)


def rigid_stage(rotor: Array, coupling: str = "diagonal") -> RigidStage:
    values = np.concatenate([ARM.phi.ravel(), rotor])
    representative = dict(zip(standard_names(6), values.tolist(), strict=True))
    size = {"parameters": [], "condition": 1.0, "rank": 36}
    return RigidStage(**size, representative=representative, rotor_coupling=coupling)


def stages(robot: Robot, coupling: str = "diagonal") -> Stages:
    inertia = rigid_stage(ARM.rotor_inertia, coupling)
    return Stages(friction=friction_stage(robot), inertia=inertia)


@pytest.mark.parametrize("coupling", ["diagonal", "gyroscopic"])
def test_the_rigid_torque_is_the_plants(
    robot: Robot, motion: Motion, coupling: str
) -> None:
    """Pinocchio's RNEA with rotors, as the simulated arm has it; a prediction adds
    friction.
    """
    rigid = Rigid(replace(ARM, rotor_coupling=coupling == "gyroscopic"))
    model = TorqueModel.from_stages(stages(robot, coupling), robot)
    state = (motion.q[::40], motion.dq[::40], motion.ddq[::40])
    expected = [rigid.inverse(*s) for s in zip(*state, strict=True)]
    np.testing.assert_allclose(model.rigid(*state), expected, atol=1e-9)
    total = motion.filtered(model.rigid(motion.q, motion.dq, motion.ddq))
    total += motion.filtered(sampled_friction(model.surfaces, motion), times=2)
    np.testing.assert_allclose(model.predict(motion), total, atol=1e-8)


def test_the_rigid_torque_is_the_regressor_times_the_parameters(
    robot: Robot, motion: Motion
) -> None:
    """H pi of Eq. 4."""
    basis = base_parameters(robot, rotor=range(6))
    phi = np.r_[ARM.phi.ravel(), ARM.rotor_inertia]
    state = motion.q, motion.dq, motion.ddq
    H = base_regressor(robot, basis, *state)
    model = TorqueModel.from_stages(stages(robot), robot)
    np.testing.assert_allclose(
        model.rigid(*state), H @ (basis.expression @ phi), atol=1e-8
    )


def test_parts_are_models_too(robot: Robot, motion: Motion) -> None:
    alone = TorqueModel.from_stages(Stages(gravity=rigid_stage(np.zeros(6))), robot)
    q = motion.q[:10]
    still = np.zeros((10, 6))
    expected = [Rigid(ARM).gravity_torque(at) for at in q]
    np.testing.assert_allclose(alone.rigid(q, still, still), expected, atol=1e-9)
    friction = stages(robot).friction
    del friction.joints["joint_3"]
    rubbing = TorqueModel.from_stages(Stages(friction=friction), robot)
    assert not rubbing.friction(motion.q, motion.dq)[:, 2].any()
    assert not rubbing.outside(motion)[:, 2].any()
    assert not rubbing.rigid(motion.q, motion.dq, motion.ddq).any()


def test_at_rest_the_model_allows_what_friction_can_hold(
    robot: Robot, motion: Motion
) -> None:
    model = TorqueModel.from_stages(stages(robot), robot)
    rigid = motion.filtered(model.rigid(motion.q, motion.dq, motion.ddq))
    held = np.zeros_like(motion.moving)
    bands = [
        s.at_rest(motion.q[:, j]) for j, s in enumerate(model.surfaces) if s is not None
    ]
    low, high = (np.stack(side, axis=1) for side in zip(*bands, strict=True))
    predicted = model.predict(motion)
    at_rest = model.predict_set(motion, held)
    np.testing.assert_array_equal(at_rest.value, predicted)
    np.testing.assert_allclose(
        at_rest.low, np.minimum(rigid + low, predicted), atol=1e-9
    )
    np.testing.assert_allclose(
        at_rest.high, np.maximum(rigid + high, predicted), atol=1e-9
    )
    moving = model.predict_set(motion, ~held)
    for values in (moving.value, moving.low, moving.high):
        np.testing.assert_array_equal(values, predicted)
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


SURFACE = replace(friction_surface(1.5, 0.5 / 3.0, top=6.0), sign_width=0.05)
FULL_HZ = 1000.0


def reversing() -> Motion:
    """Two joints that reverse again and again, at any time between two samples."""
    t = np.arange(30_000)[:, None] / FULL_HZ
    w = np.array([2.9, 4.1])
    phase = np.array([0.3, 1.1])
    slow = 1 + 0.2 * np.sin(0.37 * t)
    q = slow * np.sin(w * t + phase)
    dq = slow * w * np.cos(w * t + phase)
    return made_motion(q, dq, -(w**2) * q, Lowpass(5.0, FULL_HZ))


def test_friction_of_thinned_motion_is_the_full_one_after_the_low_pass() -> None:
    full = reversing()
    thinned = decimated(full)
    assert thinned.lowpass.every == 20
    surfaces = [SURFACE, None]
    expected = full.filtered(friction_torque(surfaces, full.q, full.dq), times=2)[::20]

    def error(torque: Array) -> float:
        return float(
            np.abs(thinned.filtered(torque, times=2) - expected)[100:-100].max()
        )

    assert error(sampled_friction(surfaces, thinned)) < 2e-3
    # Samples of the step alone are known to half a sample.
    assert error(friction_torque(surfaces, thinned.q, thinned.dq)) > 0.05
    assert not sampled_friction(surfaces, thinned)[:, 1].any()


def test_beside_gaps_friction_is_that_of_the_samples() -> None:
    thinned = decimated(reversing())
    valid = thinned.valid.copy()
    broken = thinned.q.copy()
    valid[700:720] = False
    broken[700:720] = 1e6
    gap = replace(thinned, valid=valid, q=broken)
    without_gap, beside_gap = (
        sampled_friction([SURFACE, SURFACE], m) for m in (thinned, gap)
    )
    away = np.r_[0:690, 730 : len(valid)]
    near = np.r_[693:700, 720:727]
    np.testing.assert_allclose(beside_gap[away], without_gap[away], rtol=1e-14)
    plain = friction_torque([SURFACE, SURFACE], thinned.q, thinned.dq)
    np.testing.assert_array_equal(beside_gap[near], plain[near])
