"""Eq. 12-15: p_xi is recovered; direction-dependent friction is seen, and only where it
is.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.gravity_separation import (
    GravityFit,
    configurations,
    fit_gravity,
)
from seqid_cli.identify.friction_surface.trials import Ramps, Trial
from seqid_cli.identify.nuisances import PRIORS, EvenPart
from seqid_cli.robot.kinematics import forward, gravity_columns
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.small import arm_6r

JOINT = 2
SLICES = 64
SPEEDS = np.geomspace(0.1, 2.0, 8)
P_XI = np.array([[1.7, -0.2], [1.1, 0.4]])
CONFIGURATIONS = np.array(
    [[0.3, -0.8, 0.0, 0.5, 0.1, 0.0], [0.3, -2.0, 0.0, 1.5, -0.9, 0.0]]
)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return arm_6r()


def trial(
    joint: int, velocity: float, q: Array, tau: Array, configuration: Array
) -> Trial:
    places = np.tile(configuration, (len(q), 1))
    places[:, joint] = q
    return Trial(
        joint=joint,
        velocity=velocity,
        q=q,
        dq=np.full(len(q), velocity),
        ddq=np.zeros(len(q)),
        tau=tau,
        ramps=Ramps(),
        weight=20.0,
        configuration=configuration,
        places=places,
        t=np.arange(len(q)) * 0.01,
        seconds=0.01,
    )


def trials_of(robot: Robot, seed: int, *, asymmetry: float = 0.0) -> list[Trial]:
    """Trials of the elbow with friction that is larger forward by the share
    `asymmetry`.
    """
    rng, trials = np.random.default_rng(seed), []
    groups = zip(CONFIGURATIONS, P_XI, strict=True)
    for (configuration, p), speed, direction in product(groups, SPEEDS, (1, -1)):
        q = np.linspace(-2, 2, SLICES)[::direction] + 0.01 * rng.standard_normal()
        friction = 6.0 + 2.0 * speed + 0.6 * np.sin(q + 0.4) + 0.3 * np.sin(2 * q)
        friction = friction * (1 + asymmetry * direction)
        tau = gravity_columns(robot, JOINT, configuration, q) @ p + direction * friction
        hiss = 0.1 * rng.standard_normal(SLICES)
        hiss[1:] = 0.9 * hiss[1:] + 0.44 * hiss[:-1]  # neighbours share some of it
        trials.append(trial(JOINT, direction * speed, q, tau + hiss, configuration))
    return trials


def assert_p_xi(fit: GravityFit, atol: float) -> None:
    for group, p in zip(fit.groups, P_XI, strict=True):
        np.testing.assert_allclose(group.p_xi, p, atol=atol)


def sigmas(even: EvenPart) -> Array:
    """Offset and asymmetries in their standard errors."""
    return np.abs(even.values) / np.sqrt(np.diag(even.covariance))


def test_p_xi_is_recovered_and_symmetric_friction_is_no_alarm(robot: Robot) -> None:
    z, alarms = [], 0
    for seed in range(20):
        fit = fit_gravity(robot, configurations(trials_of(robot, seed)))
        assert fit.unpaired == 0
        assert_p_xi(fit, 0.02)
        alarms += int(sigmas(fit.even).max() > 4.0)
        z += [(g.p_xi - p) / g.std_error for g, p in zip(fit.groups, P_XI, strict=True)]
    assert 0.7 < float(np.sqrt(np.mean(np.square(z)))) < 1.4
    assert alarms <= 1


@pytest.mark.parametrize("asymmetry", [0.05, -0.05, 0.15])
def test_friction_that_depends_on_direction_is_seen(
    robot: Robot, asymmetry: float
) -> None:
    for seed in range(200, 210):
        trials = trials_of(robot, seed, asymmetry=asymmetry)
        fit = fit_gravity(robot, configurations(trials))
        assert sigmas(fit.even).max() > 6.0
        assert fit.asymmetry == pytest.approx(abs(asymmetry), rel=0.25)
        assert_p_xi(fit, 0.1)


@pytest.mark.parametrize("offset", [0.6, -1.2])
def test_an_offset_is_told_from_gravity_and_friction(
    robot: Robot, offset: float
) -> None:
    for seed in range(250, 260):
        trials = [replace(x, tau=x.tau + offset) for x in trials_of(robot, seed)]
        fit = fit_gravity(robot, configurations(trials))
        assert_p_xi(fit, 0.1)
        q = np.linspace(-1.5, 1.5, 20)
        even = fit.even_torque(q, SPEEDS[0])
        assert even == pytest.approx(np.full(20, offset), abs=0.1)


def test_what_a_short_sweep_does_not_show_is_in_the_errors(robot: Robot) -> None:
    """Over half a radian an offset looks like gravity: p_xi is uncertain by as much."""
    whole = fit_gravity(robot, configurations(trials_of(robot, 1)))
    short = [x.part(np.abs(x.q) < 0.25) for x in trials_of(robot, 1)]
    fit = fit_gravity(robot, configurations(short))
    friction_rms = 7.0
    assert fit.groups[0].std_error.max() > 5.0 * whole.groups[0].std_error.max()
    assert (
        np.sqrt(fit.even.covariance[0, 0])
        < 1.01 * PRIORS.even_std(friction_rms)[0] * 1.3
    )
    for group, p in zip(fit.groups, P_XI, strict=True):
        assert np.all(np.abs(group.p_xi - p) < 4.0 * group.std_error)


@pytest.mark.parametrize("asymmetry", [0.0, 0.1])
def test_a_spring_is_no_friction_that_depends_on_direction(
    robot: Robot, asymmetry: float
) -> None:
    q = np.linspace(-1.9, 1.9, 50)
    for seed in range(300, 310):
        trials = trials_of(robot, seed, asymmetry=asymmetry)
        assert fit_gravity(robot, configurations(trials)).groups[0].beyond is None
        sprung = [
            replace(x, tau=x.tau + 4.0 * (x.q - 0.3) + 0.5 * x.q**3) for x in trials
        ]
        fit = fit_gravity(robot, configurations(sprung))
        assert fit.asymmetry < asymmetry + 0.1  # no more than the prior lets it be
        for group in fit.groups:
            left = dict.fromkeys(SPEEDS, 0.0)  # by speed: what both directions have
            for each in group.trials:
                order = np.argsort(each.q)
                own = (each.tau - group.torque(each.q))[order]
                left[abs(each.velocity)] += np.interp(q, each.q[order], own)
            # of 12 N m of the spring
            assert all(np.std(both) < 0.3 for both in left.values())


def test_trials_without_twins_are_counted(robot: Robot) -> None:
    both = [t for t in trials_of(robot, 0) if t.configuration[1] > -1]
    alone = [
        t for t in trials_of(robot, 1) if t.configuration[1] < -1 and t.velocity > 0
    ]
    for trials, groups in ((both + alone, 1), (alone, 0)):
        fit = fit_gravity(robot, configurations(trials))
        assert (len(fit.groups), fit.unpaired) == (groups, len(alone))


def test_a_wrist_that_stands_along_gravity_in_some_postures_only(robot: Robot) -> None:
    joint, rng, trials = 4, np.random.default_rng(2), []
    upright, tilted = CONFIGURATIONS
    turned = forward(robot.chain, upright[None]).R[0, joint] @ robot.chain.axis[joint]
    mounted = replace(robot, gravity=9.81 * turned)
    for configuration, speed, way in product((upright, tilted), SPEEDS, (1, -1)):
        q = np.linspace(-2, 2, SLICES)[::way]
        columns = gravity_columns(mounted, joint, configuration, q)
        tau = columns @ P_XI[0][: len(columns.T)] + way * (3.0 + 0.5 * speed)
        tau += 0.05 * rng.standard_normal(SLICES)
        trials.append(trial(joint, way * speed, q, tau, configuration))
    for given in (trials, trials[::-1]):
        fit = fit_gravity(mounted, configurations(given))
        alone, other = sorted(fit.groups, key=lambda group: len(group.p_xi))
        assert np.abs(alone.torque(trials[0].q)).max() < 0.1
        np.testing.assert_allclose(other.p_xi, P_XI[0], atol=0.02)
