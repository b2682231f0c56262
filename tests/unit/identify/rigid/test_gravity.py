"""What the friction stage does not know widens the standard errors of gravity."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import HeldJoints
from seqid_cli.identify.friction_surface.trials import Ramps, Trial
from seqid_cli.identify.nuisances import PRIORS, friction_rms
from seqid_cli.identify.regression import slow_noise
from seqid_cli.identify.regression.least_squares import Accumulator, Prior, solve
from seqid_cli.identify.rigid.gravity_rows import GravityRows
from seqid_cli.identify.rigid.posterior import friction_covariance
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import FrictionStage
from seqid_cli.robot.base_parameters import base_parameters
from tests import Array
from tests.plants.arms.rigs import MOMENT, one_joint
from tests.plants.robots.lab import robot_of

NOISE = 0.0005  # N m, of a slice


def surface_of(positive: Array, negative: Array, covariance: Array) -> FrictionSurface:
    scaling = Scaling((-2.5, 2.5), (0.4, 8.0))
    return FrictionSurface(
        scaling=scaling,
        sign_width=0.04,
        positive=positive,
        negative=negative,
        entry_covariance=covariance,
        directional=True,
    )


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
        trial = Trial(
            joint=0,
            velocity=direction * speed,
            q=q,
            dq=v,
            ddq=still,
            tau=tau,
            ramps=Ramps(),
            weight=20.0,
            configuration=np.zeros(1),
            places=q[:, None],
            t=t,
            seconds=0.02,
        )
        result.append(trial)
    return result


def drive_prior(surface: FrictionSurface) -> Prior:
    """What is known of the drive's terms, behind the two parameters,
    before any trial.
    """
    # No temperature is logged: what friction has per kelvin is any number, and is zero.
    weights = np.append(1.0 / PRIORS.even_std(friction_rms(surface)), 1.0)
    return Prior(A=np.pad(np.diag(weights), ((0, 0), (2, 0))), b=np.zeros(len(weights)))


@cache
def held_joints() -> HeldJoints:
    robot = robot_of("one", one_joint())
    return HeldJoints(robot, base_parameters(robot, rotor=()), np.zeros(2))


def errors_of(seed: int) -> tuple[Array, Array, Array, Array]:
    """Errors of (mx, my) and their variances, with offset and asymmetries free and held
    at zero.
    """
    rng = np.random.default_rng(seed)
    off = SPREAD * rng.standard_normal((2, *POSITIVE.shape))
    surface = surface_of(POSITIVE + off[0], NEGATIVE + off[1], SPREAD**2 * np.eye(12))
    rows = GravityRows(held_joints(), [surface], FrictionStage(joints={}))
    joints = [Accumulator(rows.columns)]
    rows.add_joint(trials(rng), joints)
    free = solve(joints, prior=drive_prior(surface), nuisances=slice(2, None))
    by_friction = friction_covariance(rows.sensitivity(free), [surface], rows.columns)
    total = np.diag(free.covariance + by_friction)[:2]

    fixed = joints[0]
    for column in range(rows.columns - 1, 1, -1):
        fixed = fixed.with_fixed(column, 0.0)
    held_at_zero = solve([fixed])
    true = np.array([MOMENT, 0.0])
    return (
        free.theta[:2] - true,
        total,
        held_at_zero.theta - true,
        np.diag(held_at_zero.covariance),
    )


@pytest.mark.slow
def test_errors_hold_with_what_friction_has_alike_both_ways_and_not_without() -> None:
    """Errors of either direction's surface by itself look like an offset, and so like
    gravity.
    """
    found = [errors_of(seed) for seed in range(60)]
    error, total, error_held, held = (
        np.array(part) for part in zip(*found, strict=True)
    )
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(total)) >= 0.90
    assert np.mean(error**2 / total) > 0.4
    assert np.mean(np.abs(error_held) < 1.96 * np.sqrt(held)) < 0.85


def test_a_long_log_counts_as_several(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rows say the same to within their errors, which stay what they are."""
    surface = surface_of(POSITIVE, NEGATIVE, np.zeros((12, 12)))

    def solved() -> tuple[Array, Array]:
        rows = GravityRows(held_joints(), [surface], FrictionStage(joints={}))
        joints = [Accumulator(rows.columns)]
        rows.add_joint(trials(np.random.default_rng(0)), joints)
        solution = solve(joints, prior=drive_prior(surface), nuisances=slice(2, None))
        return solution.theta[:2], np.sqrt(np.diag(solution.covariance)[:2])

    expected, std_error = solved()
    monkeypatch.setattr(slow_noise, "MOST_ROWS", 20)
    theta, std_error_of_parts = solved()
    assert np.all(np.abs(theta - expected) < std_error)
    assert std_error_of_parts == pytest.approx(std_error, rel=0.5)
