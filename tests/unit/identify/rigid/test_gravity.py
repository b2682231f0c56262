"""What the friction stage does not know widens the standard errors of gravity."""

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import HeldJoints
from seqid_cli.identify.friction_surface.trials import Ramps, Trial
from seqid_cli.identify.regression.least_squares import Accumulator, Prior, solve
from seqid_cli.identify.rigid.gravity import GravityRows, _stage
from seqid_cli.identify.rigid.posterior import Posterior, friction_covariance, gravity_prior
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.arms.rigs import MOMENT, one_joint, six_joint
from tests.plants.robots.lab import robot_of

SEEDS = 150
NOISE = 0.0005  # N m, of a slice


def surface_of(positive: Array, negative: Array, covariance: Array) -> FrictionSurface:
    scaling = Scaling((-2.5, 2.5), (0.4, 8.0))
    return FrictionSurface(scaling, 0.04, positive, negative, covariance, directional=True)


POSITIVE = np.array([[0.030, 0.004], [0.001, 0.0], [-0.002, 0.0]])
NEGATIVE = np.array([[0.028, 0.004], [0.0, 0.0], [-0.001, 0.0]])
SPREAD = np.full(12, 0.0004)


def trials(rng: np.random.Generator) -> list[Trial]:
    """Both ways at four speeds, with the true friction."""
    true = surface_of(POSITIVE, NEGATIVE, np.zeros((12, 12)))
    lever = 9.81 * np.sin(np.deg2rad(30.0)) * MOMENT
    result = []
    for speed in (0.5, 1.0, 2.0, 4.0):
        for direction in (1, -1):
            q = np.linspace(-2.4, 2.4, 64)[::direction]
            v = np.full(64, direction * speed)
            # The axis leans by 30 degrees about x: gravity's part across it lies along -y.
            tau = lever * np.cos(q) + true.torque(q, v) + NOISE * rng.standard_normal(64)
            still = np.zeros(64)
            t = 10.0 * len(result) + np.arange(64) * 0.02
            motion = (0, direction * speed, q, v, still, tau)
            result.append(Trial(*motion, Ramps(), 20.0, np.zeros(1), q[:, None], t, 0.02))
    return result


def errors_of(robot: Robot, seed: int) -> tuple[Array, Array, Array]:
    """Errors of (mx, my), and variances with and without the friction stage's part."""
    rng = np.random.default_rng(seed)
    off = SPREAD * rng.standard_normal(12)
    shape = POSITIVE.shape
    surface = surface_of(
        POSITIVE + off[:6].reshape(shape), NEGATIVE + off[6:].reshape(shape), np.diag(SPREAD**2)
    )
    basis = base_parameters(robot, rotor=())
    held = HeldJoints(robot, basis, np.zeros(2))
    rows, joints = GravityRows(held, [surface]), [Accumulator(2)]
    rows.add_joint(trials(rng), joints)
    solution = solve(joints)
    error = solution.theta - np.array([MOMENT, 0.0])
    alone = np.diag(solution.covariance)
    sensitivity = rows.sensitivity(solution)
    return error, alone + np.diag(friction_covariance(sensitivity, [surface], 2)), alone


@pytest.mark.slow
def test_errors_are_as_large_as_said_with_frictions_part_and_larger_than_said_without() -> None:
    robot = robot_of("one", one_joint())
    found = [errors_of(robot, seed) for seed in range(SEEDS)]
    error, total, alone = (np.array(part) for part in zip(*found, strict=True))
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(total)) >= 0.90
    assert np.mean(error**2 / total) > 0.4
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(alone)) < 0.85


def test_the_covariance_is_that_of_the_parameters_that_were_determined() -> None:
    robot = robot_of("six", six_joint())
    basis = base_parameters(robot, rotor=())
    size = int(basis.gravity.sum())
    rng = np.random.default_rng(0)
    joints = [Accumulator(size) for _ in range(robot.n)]
    q = rng.uniform(-1.0, 1.0, (400, robot.n))  # but only the last joint's torque is known
    H = base_regressor(robot, basis, q, np.zeros_like(q), np.zeros_like(q))[:, -1, :size]
    for j, joint in enumerate(joints):
        own = slice(None) if j == robot.n - 1 else slice(0, 0)
        joint.add(H[own], (H @ np.ones(size) + 0.01 * rng.normal(size=400))[own])
    solution = solve(joints)
    rows = GravityRows(HeldJoints(robot, basis, np.zeros(size)), [None] * robot.n)
    stage = _stage(robot, basis, solution, rows)
    assert 0 < len(stage.parameters) < size
    assert np.shape(stage.covariance) == (len(stage.parameters),) * 2
    errors = np.sqrt(np.diag(stage.covariance))
    assert errors.tolist() == pytest.approx([p.std_error for p in stage.parameters])
    prior = gravity_prior(stage, basis, robot.joint_names)
    own = [basis.names.index(p.name) for p in stage.parameters]
    assert not np.delete(prior.A, own, axis=1).any()
    expected = np.linalg.inv(np.array(stage.covariance))
    np.testing.assert_allclose((prior.A.T @ prior.A)[np.ix_(own, own)], expected, rtol=1e-6)


def test_friction_that_comes_by_the_prior_alone_counts_once() -> None:
    rng = np.random.default_rng(5)
    joint = Accumulator(3)
    for H in rng.standard_normal((20, 30, 3)):
        joint.add(H, H @ np.arange(1.0, 4.0) + 0.1 * rng.standard_normal(30))
    surface = surface_of(POSITIVE, NEGATIVE, 0.1 * np.eye(12))
    A, push = rng.standard_normal((2, 3)), np.ones(2)
    friction = rng.standard_normal((2, len(surface.covariance)))
    prior = Prior(A, A @ np.arange(1.0, 4.0), {0: friction}, {0: push})
    solution = solve([joint], prior=prior)
    known = np.array([0.1, 0.2, 0.3])
    found = Posterior.of(solution, [surface], np.array([0.02]), {}, {0: known}, prior)
    np.testing.assert_allclose(found.covariance, solution.covariance, rtol=1e-6)
    gain = solution.bread @ A.T
    np.testing.assert_allclose(found.friction[0], gain @ friction)
    moved = 0.02 * (solution.shares[0] - known) + gain @ push
    np.testing.assert_allclose(found.constants[0], moved)
