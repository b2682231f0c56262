"""Logs whose torque is an echo of the command are told; those with a drive's torque are
not.
"""

import numpy as np
import pytest

from seqid_cli.inspect.dynamics.echo import echoes
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


def test_joint_that_is_held_says_nothing() -> None:
    t, q, _, _ = motion()
    q[:, 1] = 0.3 + 1e-4 * np.sin(7.0 * t)
    assert found(t, q, gravity(q), 10) == [0]
