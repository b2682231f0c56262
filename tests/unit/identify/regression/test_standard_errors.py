"""A 95 % interval holds the truth in 95 % of seeds, though residuals remember their past."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from seqid_cli.identify.regression.equations import blocks
from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.identify.rigid.parameters import imu_moves
from seqid_cli.robot.base_parameters import free_basis
from tests import Array
from tests.plants.arms.rigs import two_joint
from tests.plants.robots.lab import robot_of

RATE = 60.0
SAMPLES = 2000
SEEDS = 200
THETA = np.array([1.0, -2.0, 0.5, 3.0])
WIDTH_95 = 1.96


def coloured(rng: np.random.Generator, pole: float, shape: tuple[int, ...]) -> Array:
    """First-order process of unit variance."""
    drive = rng.standard_normal(shape)
    drive[1:] *= np.sqrt(1 - pole**2)
    return lfilter([1.0], [1.0, -pole], drive, axis=0)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_intervals_hold_the_truth_as_often_as_they_say(pole: float) -> None:
    errors = []
    for seed in range(SEEDS):
        rng, joints = np.random.default_rng(seed), []
        for noise in (0.3, 1.5):
            H = coloured(rng, 0.97, (SAMPLES, len(THETA)))
            y = H @ THETA + noise * coloured(rng, pole, (SAMPLES,))
            joint = Accumulator(len(THETA))
            for block in blocks(SAMPLES, RATE):
                joint.add(H[block], y[block])
            joints.append(joint)
        got = solve(joints)
        errors.append((got.theta - THETA) / np.sqrt(np.diag(got.covariance)))
    assert 0.90 <= float(np.mean(np.abs(errors) < WIDTH_95)) <= 0.99


def test_an_imu_moves_the_inertias_of_the_links_that_it_follows() -> None:
    robot = robot_of("planar", two_joint())
    basis = free_basis(robot)
    inertia = np.where(basis.gravity, 0.0, np.arange(1.0, basis.size + 1))
    reflected = np.array([0.0, 0.5])
    first, second = (replace(robot.imus[0], name=n, after_joint=j) for n, j in (("a", 0), ("b", 1)))
    arm = replace(robot, imus=(second, first))
    links = np.array([basis.joint_index(k) for k in range(basis.size)])
    whole = inertia + 0.5 * np.array([name == "Izz_2" for name in basis.names])

    both = imu_moves(arm, basis, inertia, reflected, {"a": 0.1, "b": 0.01})
    assert both == pytest.approx(
        np.column_stack([0.1 * whole * (links == 0), 0.01 * whole * (links == 1)])
    )
    alone = imu_moves(arm, basis, inertia, reflected, {"b": 0.01})
    assert alone == pytest.approx(0.01 * whole[:, None])
    assert imu_moves(arm, basis, inertia, reflected, {}).shape == (basis.size, 0)
