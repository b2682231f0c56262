"""Gravity columns against inverse dynamics; pairing and grouping of trials."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.identify.friction_surface.gravity_separation import (
    gravity_columns,
    plane_across,
)
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.friction_surface.trials import (
    _trial,
    collect_trials,
)
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.logs.long import Block
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.segmentation import Stretch
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.motions.trajectories import sweeps
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import planar_2r, random_model, robot_from_chain
from tests.plants.sensors import quantise

GRAVITY = np.array([3.0, -2.0, -8.0])
PRISMATIC = [False, True, False, False, True, False]


@pytest.fixture(params=range(3))
def random_robot(request: pytest.FixtureRequest) -> tuple[Robot, Array]:
    """Six joints with arbitrary axes, two of them prismatic, and their links' parameters."""
    rng = np.random.default_rng(request.param)
    model, chain = random_model(rng, PRISMATIC)
    phi = np.array([body.toDynamicParameters() for body in list(model.inertias)[1:]])
    return robot_from_chain(chain, gravity=GRAVITY), phi


def first_moment(robot: Robot, phi: Array, joint: int, q: Array) -> tuple[float, Array]:
    """Mass and first moment of everything after `joint`, in its frame."""
    frames = forward(robot.chain, q[None])
    R, p = frames.R[0], frames.p[0]
    moment = np.zeros(3)
    for k in range(joint, robot.n):
        arm = p[k] - p[joint]
        moment += phi[k, 0] * arm + R[k] @ phi[k, 1:4]
    return float(phi[joint:, 0].sum()), R[joint].T @ moment


@pytest.mark.parametrize("joint", range(6))
def test_columns_times_p_xi_are_the_gravity_torque(
    random_robot: tuple[Robot, Array], joint: int
) -> None:
    """p_xi of Eq. 14 is the composite body's first moment across the axis, or its mass."""
    robot, phi = random_robot
    rng = np.random.default_rng(joint)
    where = rng.uniform(-2, 2, robot.n)
    own = rng.uniform(-3, 3, 40)
    q = np.tile(where, (40, 1))
    q[:, joint] = own
    still = np.zeros_like(q)
    tau = inverse_dynamics(robot.chain, robot.gravity, phi, q, still, still)[:, joint]
    mass, moment = first_moment(robot, phi, joint, where)
    if robot.chain.prismatic[joint]:
        p_xi = np.array([mass])
    else:
        e_x, e_y = plane_across(robot.chain.axis[joint])
        p_xi = np.array([moment @ e_x, moment @ e_y])
    np.testing.assert_allclose(
        gravity_columns(robot, joint, where, own) @ p_xi, tau, rtol=1e-9, atol=1e-9
    )


def recording(q: Array, tau: Array | None) -> Recording:
    return made_recording(q, tau, rate_hz=250.0, path="moves.parquet")


def test_slices_average_position_and_torque() -> None:
    """Torque that is linear in the position comes out as that line, without noise of counts."""
    reference = sweeps(np.array([0.4, 0.0]), 1, (-1.5, 1.5), [0.3, 1.0], 8.0, rate_hz=250.0)
    log = recording(quantise(reference.q, 2 * np.pi / 600), 2.0 * reference.q + 1.0)
    trials = collect_trials([log], planar_2r())
    assert sorted(round(t.velocity, 2) for t in trials) == [-1.0, -0.3, 0.3, 1.0]
    for own in trials:
        assert own.joint == 1
        assert own.configuration[0] == pytest.approx(0.4, abs=0.006)
        np.testing.assert_allclose(own.tau, 2.0 * own.q + 1.0, atol=0.01)
        assert np.abs(own.ddq).max() < 0.1 * own.speed
        np.testing.assert_allclose(own.dq, own.velocity, rtol=0.1)
        # Means over a window of the ramps are those of torque and position alike.
        np.testing.assert_allclose(own.ramps.tau, 2.0 * own.ramps.q + 1.0, atol=0.02)
        assert np.abs(own.ramps.dq).min() < 0.5 * own.speed
        assert own.ramps.ddq.max() > 2.0
        assert own.ramps.ddq.min() < -2.0
        assert len(own.q) * own.weight <= len(reference.q)


def test_windows_of_ramps_give_the_acceleration_exactly() -> None:
    """Of fast moves at a low rate as well: a steady speed is no acceleration."""
    reference = sweeps(np.array([0.4, 0.0]), 1, (-1.5, 1.5), [4.0], 40.0, rate_hz=250.0)
    ddq = np.gradient(np.gradient(reference.q[:, 1])) * 250.0**2
    tau = np.zeros_like(reference.q)
    tau[:, 1] = 0.02 * ddq
    windows = 0
    for own in collect_trials([recording(reference.q, tau)], planar_2r()):
        np.testing.assert_allclose(own.ramps.tau, 0.02 * own.ramps.ddq, atol=1e-6)
        windows += len(own.ramps.ddq)
    assert windows >= 4


def test_trials_know_how_warm_the_joint_was() -> None:
    reference = sweeps(np.array([0.4, 0.0]), 1, (-1.0, 1.0), [0.5, 1.0], 10.0, rate_hz=250.0)
    cold = recording(reference.q, np.zeros_like(reference.q))
    celsius = np.column_stack([np.full(len(reference.q), 50.0), 20.0 + cold.t])
    celsius[::7] = np.nan
    warm = replace(cold, temperature=celsius)
    trials = collect_trials([warm], planar_2r())
    for own in trials:
        assert own.celsius == pytest.approx(20.0 + own.t.mean(), abs=0.05)
    assert all(np.isnan(own.celsius) for own in collect_trials([cold], planar_2r()))
    friction = np.tanh(20.0 * np.gradient(reference.q, axis=0) * 250.0)
    for log, known in ((warm, True), (cold, False)):
        logs = [replace(log, tau=friction)]
        stage = identify_friction(logs, planar_2r(), options=FrictionOptions())
        (joint,) = stage.joints.values()
        assert (joint.temperature is not None) == known
        assert not known or trials[0].celsius < (joint.temperature or 0.0) < trials[-1].celsius


def test_a_log_without_torque_is_refused() -> None:
    with pytest.raises(InputError, match="neither joint torque nor motor current") as caught:
        collect_trials([recording(np.zeros((500, 2)), None)], planar_2r())
    assert "moves.parquet" in str(caught.value)


@pytest.mark.parametrize("slices", [4, 7, 8, 12])
def test_a_short_trial_shows_its_acceleration(slices: int) -> None:
    """However few its slices are, a speed that changes is not taken for a steady one."""
    rate, samples, push = 250.0, 4 * slices, 0.6
    time = (np.arange(samples) - samples / 2) / rate
    q = np.column_stack([np.zeros(samples), 4.0 * time + 0.5 * push * time**2])
    stretch = Stretch(1, 0, samples, 0, samples, 4.0, (0.0, 0.0))
    block = Block(0, q, np.zeros_like(q), np.ones(samples, dtype=bool))
    found = _trial(block, stretch, rate, 0, None)
    assert len(found.q) == slices
    np.testing.assert_allclose(found.ddq, push, rtol=1e-6)
