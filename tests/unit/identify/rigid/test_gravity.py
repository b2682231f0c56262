"""What the friction stage does not know widens the standard errors of gravity."""

from itertools import product

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import HeldJoints
from seqid_cli.identify.friction_surface.trials import Ramps, Trial
from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.identify.rigid.gravity import GravityRows
from seqid_cli.identify.rigid.posterior import friction_covariance
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.robot.base_parameters import base_parameters
from tests import Array
from tests.plants.arms.rigs import MOMENT, one_joint
from tests.plants.robots.lab import robot_of

NOISE = 0.0005  # N m, of a slice


def surface_of(positive: Array, negative: Array, covariance: Array) -> FrictionSurface:
    scaling = Scaling((-2.5, 2.5), (0.4, 8.0))
    return FrictionSurface(scaling, 0.04, positive, negative, covariance, directional=True)


POSITIVE = np.array([[0.030, 0.004], [0.001, 0.0], [-0.002, 0.0]])
NEGATIVE = np.array([[0.028, 0.004], [0.0, 0.0], [-0.001, 0.0]])
SPREAD = 0.0004


def trials(rng: np.random.Generator) -> list[Trial]:
    true = surface_of(POSITIVE, NEGATIVE, np.zeros((12, 12)))
    lever = 9.81 * np.sin(np.deg2rad(30.0)) * MOMENT
    result = []
    for speed, direction in product((0.5, 1.0, 2.0, 4.0), (1, -1)):
        q = np.linspace(-2.4, 2.4, 64)[::direction]
        v, still = np.full(64, direction * speed), np.zeros(64)
        # The axis leans by 30 degrees about x: gravity's part across it lies along -y.
        tau = lever * np.cos(q) + true.torque(q, v) + NOISE * rng.standard_normal(64)
        t = 10.0 * len(result) + np.arange(64) * 0.02
        motion = (0, direction * speed, q, v, still, tau)
        result.append(Trial(*motion, Ramps(), 20.0, np.zeros(1), q[:, None], t, 0.02))
    return result


def errors_of(seed: int) -> tuple[Array, Array, Array]:
    """Errors of (mx, my), and variances with and without the friction stage's part."""
    rng = np.random.default_rng(seed)
    off = SPREAD * rng.standard_normal((2, *POSITIVE.shape))
    surface = surface_of(POSITIVE + off[0], NEGATIVE + off[1], SPREAD**2 * np.eye(12))
    robot = robot_of("one", one_joint())
    held = HeldJoints(robot, base_parameters(robot, rotor=()), np.zeros(2))
    rows, joints = GravityRows(held, [surface]), [Accumulator(2)]
    rows.add_joint(trials(rng), joints)
    solution = solve(joints)
    alone = np.diag(solution.covariance)
    by_friction = np.diag(friction_covariance(rows.sensitivity(solution), [surface], 2))
    return solution.theta - [MOMENT, 0.0], alone + by_friction, alone


@pytest.mark.slow
def test_errors_are_as_large_as_said_with_frictions_part_and_larger_than_said_without() -> None:
    found = [errors_of(seed) for seed in range(150)]
    error, total, alone = (np.array(part) for part in zip(*found, strict=True))
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(total)) >= 0.90
    assert np.mean(error**2 / total) > 0.4
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(alone)) < 0.85
