"""Eq. 12-15: p_xi is recovered; direction-dependent friction is seen, and only where it is."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import HeldJoints
from seqid_cli.identify.friction_surface.gravity_separation import (
    GravityFit,
    fit_gravity,
    gravity_columns,
)
from seqid_cli.identify.friction_surface.trials import Ramps, Trial
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.small import arm_6r

JOINT = 2
SLICES = 64
SPEEDS = np.geomspace(0.1, 2.0, 8)
P_XI = np.array([[1.7, -0.2], [1.1, 0.4]])
CONFIGURATIONS = np.array([[0.3, -0.8, 0.0, 0.5, 0.1, 0.0], [0.3, -2.0, 0.0, 1.5, -0.9, 0.0]])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return arm_6r()


def trial(joint: int, velocity: float, q: Array, tau: Array, configuration: Array) -> Trial:
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


def trials_of(
    robot: Robot,
    rng: np.random.Generator,
    *,
    asymmetry: float = 0.0,
    noise: float = 0.1,
    directions: tuple[int, ...] = (1, -1),
) -> list[Trial]:
    """Trials of the elbow with friction that is larger forward by the share `asymmetry`."""
    trials = []
    for configuration, p in zip(CONFIGURATIONS, P_XI, strict=True):
        for speed in SPEEDS:
            for direction in directions:
                q = np.linspace(-2, 2, SLICES)[::direction] + 0.01 * rng.standard_normal()
                friction = 6.0 + 2.0 * speed + 0.6 * np.sin(q + 0.4) + 0.3 * np.sin(2 * q)
                friction = friction * (1 + asymmetry * direction)
                tau = gravity_columns(robot, JOINT, configuration, q) @ p + direction * friction
                hiss = noise * rng.standard_normal(SLICES)
                hiss[1:] = 0.9 * hiss[1:] + 0.44 * hiss[:-1]  # neighbours share some of it
                trials.append(trial(JOINT, direction * speed, q, tau + hiss, configuration))
    return trials


def fitted(robot: Robot, seed: int, *, asymmetry: float = 0.0, noise: float = 0.1) -> GravityFit:
    rng = np.random.default_rng(seed)
    return fit_gravity(robot, JOINT, trials_of(robot, rng, asymmetry=asymmetry, noise=noise))


def test_p_xi_of_each_configuration_is_recovered_and_symmetric_friction_is_no_alarm(
    robot: Robot,
) -> None:
    z, alarms = [], 0
    for seed in range(20):
        fit = fitted(robot, seed)
        assert len(fit.groups) == 2
        assert fit.unpaired == 0
        alarms += fit.directional
        for group, p in zip(fit.groups, P_XI, strict=True):
            np.testing.assert_allclose(group.p_xi, p, atol=0.02)
            z.append((group.p_xi - p) / group.std_error)
    assert 0.7 < float(np.sqrt(np.mean(np.square(z)))) < 1.4
    assert alarms <= 1


@pytest.mark.parametrize("asymmetry", [0.05, -0.05, 0.15])
def test_friction_that_depends_on_direction_is_seen(robot: Robot, asymmetry: float) -> None:
    for seed in range(10):
        fit = fitted(robot, 200 + seed, asymmetry=asymmetry)
        assert fit.directional
        assert fit.asymmetry == pytest.approx(abs(asymmetry), rel=0.25)
        for group, p in zip(fit.groups, P_XI, strict=True):
            np.testing.assert_allclose(group.p_xi, p, atol=0.1)


@pytest.mark.parametrize("goes_with", [1.0, 0.0])
def test_a_joint_is_no_heavier_for_friction_that_depends_on_direction(
    robot: Robot, goes_with: float
) -> None:
    """What friction has over the position is mostly gravity's shape here."""
    q = np.linspace(-2, 2, SLICES)
    places = 3.0 * np.sin(q + 0.4) + 0.5 * np.sin(2 * q)
    rng, trials = np.random.default_rng(6), []
    for configuration, p in zip(CONFIGURATIONS, P_XI, strict=True):
        for direction, speed in product((1, -1), SPEEDS):
            friction = 6.0 + 2.0 * speed + places
            more = direction * 0.5 * (6.0 + goes_with * places)
            tau = gravity_columns(robot, JOINT, configuration, q) @ p
            tau += direction * (friction + more) + 0.02 * rng.standard_normal(SLICES)
            trials.append(trial(JOINT, direction * speed, q, tau, configuration))
    fit = fit_gravity(robot, JOINT, trials)
    assert fit.directional
    for group, p in zip(fit.groups, P_XI, strict=True):
        np.testing.assert_allclose(group.p_xi, p, atol=0.02)


def sprung(trials: list[Trial], stiffness: float, cubic: float) -> list[Trial]:
    """The same with a spring at the joint."""
    pulls = [stiffness * (each.q - 0.3) + cubic * each.q**3 for each in trials]
    return [replace(each, tau=each.tau + own) for each, own in zip(trials, pulls, strict=True)]


@pytest.mark.parametrize("asymmetry", [0.0, 0.1])
def test_a_spring_is_neither_friction_nor_direction_dependent(
    robot: Robot, asymmetry: float
) -> None:
    for seed in range(10):
        trials = trials_of(robot, np.random.default_rng(300 + seed), asymmetry=asymmetry)
        bare, fit = (fit_gravity(robot, JOINT, each) for each in (trials, sprung(trials, 4.0, 0.5)))
        assert bare.groups[0].beyond is None
        assert not fit.directional
        for group in fit.groups:
            for ahead, back in zip(*(_ways(group.trials, way) for way in (1, -1)), strict=True):
                q = np.linspace(-1.9, 1.9, 50)
                left = [
                    np.interp(q, *(x[np.argsort(t.q)] for x in (t.q, t.tau - group.torque(t.q))))
                    for t in (ahead, back)
                ]
                assert np.std(left[0] + left[1]) < 0.3  # of a spring that makes 12 N m


def _ways(trials: list[Trial], way: int) -> list[Trial]:
    return sorted((t for t in trials if t.velocity * way > 0), key=lambda t: t.velocity * way)


def test_trials_without_twins_are_counted(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    both = [t for t in trials_of(robot, rng) if t.configuration[1] > -1]
    alone = [t for t in trials_of(robot, rng, directions=(1,)) if t.configuration[1] < -1]
    fit = fit_gravity(robot, JOINT, both + alone)
    assert len(fit.groups) == 1
    assert fit.unpaired == len(alone)
    none = fit_gravity(robot, JOINT, alone)
    assert none.groups == []
    assert none.unpaired == len(alone)


def test_a_held_joint_that_gives_way_is_no_friction(robot: Robot) -> None:
    basis, q, count = base_parameters(robot, rotor=()), np.linspace(-2, 2, SLICES), 1e-3
    held = HeldJoints(robot, basis, np.ones(int(basis.gravity.sum())))
    both = [trial(JOINT, way, q[::way], np.zeros(SLICES), CONFIGURATIONS[0]) for way in (1, -1)]
    still = [held.columns(JOINT, each.places) @ held.theta for each in both]
    for each in both:  # the wrist turns with the direction
        each.places[:, 3] += 0.002 * each.velocity
    moved = [held.columns(JOINT, each.places) @ held.theta for each in both]
    assert np.abs(np.array(moved) - still).max() > 0.01
    given = [
        replace(each, tau=own, count=np.full(6, count))
        for each, own in zip(both, moved, strict=True)
    ]
    stood = held.standing(given, CONFIGURATIONS[0])
    np.testing.assert_allclose([each.tau for each in stood], still, atol=1e-9)
    error = (moved[0] - still[0]) / 0.002 * count / np.sqrt(12)
    np.testing.assert_allclose(held.unseen(given[0], given[0].places)[:, 3], error, atol=1e-4)
    np.testing.assert_allclose(held.doubt(given)[0], error / np.sqrt(2), atol=1e-4)


def test_a_joint_along_gravity_has_no_p_xi(robot: Robot) -> None:
    rng = np.random.default_rng(1)
    trials = [
        trial(0, 0.5 * d, np.linspace(-1, 1, 16)[::d], 3.0 * d + noise, np.zeros(6))
        for d, noise in zip((1, -1), 0.01 * rng.standard_normal((2, 16)), strict=True)
    ]
    for given in (trials, trials[:1]):  # nothing to take off, so no twin is needed
        fit = fit_gravity(robot, 0, given)
        assert len(fit.groups) == 1
        assert fit.groups[0].p_xi.shape == (0,)
        assert not fit.directional
        assert fit.unpaired == 0


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
        fit = fit_gravity(mounted, joint, given)
        alone, other = sorted(fit.groups, key=lambda group: len(group.p_xi))
        assert np.abs(alone.torque(trials[0].q)).max() < 0.1
        np.testing.assert_allclose(other.p_xi, P_XI[0], atol=0.02)
