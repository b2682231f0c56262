"""Logs whose torque is an echo of the command are told; those with a drive's torque are
not.
"""

import numpy as np
import pytest

from seqid_cli.inspect.dynamics.echo import echoes
from seqid_cli.inspect.settings import EchoSettings
from tests import Array
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.discover.drawn_logs import wander

RATE_HZ = 500.0
STEP = 0.01  # N m, of the torque


def motion(seed: int = 0, speed: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """Time, position, velocity, acceleration of two joints; slower where `speed` is
    below 1.
    """
    q = wander(30.0, seed)
    t = np.arange(len(q)) / RATE_HZ / speed
    dq = np.gradient(q, t, axis=0)
    return t, q, dq, np.gradient(dq, t, axis=0)


def gravity(q: Array) -> Array:
    both = 4.0 * np.cos(q.sum(axis=1))
    return np.stack([9.0 * np.cos(q[:, 0]) + both, both], axis=1)


def friction(dq: Array) -> Array:
    return np.asarray(0.5 * np.tanh(dq / 0.01) + 0.3 * dq)


def found(t: Array, q: Array, tau: Array, seed: int) -> list[int]:
    """Return joints whose torque is an echo, with a drive's noise and steps in it."""
    noise = np.random.default_rng(seed).normal(scale=0.02, size=tau.shape)
    logged = np.round((tau + noise) / STEP) * STEP
    return echoes(two_joint_robot(), t, q, logged, np.ones(len(t), dtype=bool))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_torque_that_follows_the_position_is_told_by_joint(seed: int) -> None:
    t, q, dq, _ = motion(seed)
    by_hand = gravity(q)
    controlled = 8.0 * (0.4 - q) - 1.5 * dq  # stiffness and damping about a set point
    driven = by_hand + friction(dq) * [1.0, 0.0]
    assert found(t, q, by_hand, seed) == found(t, q, controlled, seed) == [0, 1]
    assert found(t, q, driven, seed) == [1]


CASES = [
    (1.0, 1.0, 0.2),
    (1.0, 0.3, 0.2),
    (0.2, 1.0, 0.2),
    (0.2, 0.3, 0.2),
    (1.0, 0.0, 0.5),
]


@pytest.mark.parametrize(("speed", "share", "inertia"), CASES)
def test_torque_of_friction_or_inertia_is_none(
    speed: float, share: float, inertia: float
) -> None:
    t, q, dq, ddq = motion(speed=speed)
    assert found(t, q, gravity(q) + share * friction(dq) + inertia * ddq, 6) == []


@pytest.mark.parametrize("seed", range(6))
def test_little_friction_that_waves_hide_is_still_friction(seed: int) -> None:
    """Friction of 3 % of the torque beside waves over the position of 6 %, in 10 s."""
    t, q, dq, _ = motion(seed, speed=0.3)
    started = t < 10.0
    torque = gravity(q)
    size = np.sqrt(np.mean(torque[started] ** 2, axis=0))
    torque += 0.06 * np.sqrt(2.0) * size * np.sin(40.0 * q + 1.0)
    rubbing = torque + 0.03 * size * np.tanh(dq / 0.01)
    log = (t[started], q[started], rubbing[started], started[started])
    assert echoes(two_joint_robot(), *log) == []


def test_who_knows_the_torque_for_measured_may_say_so() -> None:
    t, q, _, _ = motion(0)
    tau = gravity(q)
    is_valid = np.ones(len(t), dtype=bool)
    none = EchoSettings(max_friction=0.0)
    assert echoes(two_joint_robot(), t, q, tau, is_valid)
    assert not echoes(two_joint_robot(), t, q, tau, is_valid, settings=none)


def test_joint_that_is_held_says_nothing() -> None:
    t, q, _, _ = motion()
    q[:, 1] = 0.3 + 1e-4 * np.sin(7.0 * t)
    assert found(t, q, gravity(q), 10) == [0]
