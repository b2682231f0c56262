"""How the links' torque answers when one joint's link is not where its measured angle says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filtering import differentiate
from seqid_cli.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]
Torque = Callable[[Array, Array, Array], Array]  # (q, dq, ddq), each (N, n) -> (N, n)

STEP = 1e-4  # rad, of the central difference: rounding and curvature both stay below 1e-8
BLOCK = 4096  # samples at a time, so that they stay in cache


def link_torque(scene: Scene, q: Array, dq: Array, ddq: Array) -> Array:
    """Torque (N, n) that moves the links alone: no rotors; zero without rigid-body parameters."""
    phi = scene.model.phi
    if phi is None:
        return np.zeros_like(q)
    parts = [
        inverse_dynamics(scene.robot.chain, scene.robot.gravity, phi, q[at], dq[at], ddq[at])
        for at in (slice(k, k + BLOCK) for k in range(0, len(q), BLOCK))
    ]
    return np.concatenate(parts)


def link_inertia(scene: Scene, joint: int) -> Array:
    """Column `joint` (N, n) of the links' mass matrix, kg m^2: torque per its acceleration."""
    q, phi = scene.motion.q, scene.model.phi
    if phi is None:
        return np.zeros_like(q)
    still, unit = np.zeros_like(q), np.zeros_like(q)
    unit[:, joint] = 1.0
    return inverse_dynamics(scene.robot.chain, np.zeros(3), phi, q, still, unit)


def along(scene: Scene, joint: int, torque: Torque, change: tuple[Array, Array, Array]) -> Array:
    """Compute the derivative of a torque along a change of one joint's motion.

    Parameters
    ----------
    scene : Scene
    joint : int
    torque : callable
        Of positions, velocities and accelerations (N, n).
    change : tuple of (N,) arrays
        Of position, velocity and acceleration, in any one unit: the result is per that unit.

    Returns
    -------
    (N, n) array
        N m per unit.
    """
    motion = scene.motion
    largest = float(np.max(np.abs(change[0]), initial=0.0))
    if largest <= 0.0 or not np.isfinite(largest):
        return np.zeros_like(motion.q)
    step = STEP / largest
    ahead, behind = [], []
    for own, values in zip((motion.q, motion.dq, motion.ddq), change, strict=True):
        plus, minus = own.copy(), own.copy()
        plus[:, joint] += step * values
        minus[:, joint] -= step * values
        ahead.append(plus)
        behind.append(minus)
    slope: Array = (torque(*ahead) - torque(*behind)) / (2 * step)
    return slope


def link_deviation(scene: Scene, joint: int, deviation: Array) -> Array:
    """Torque (N, n) per unit of a small deviation (N,) of a joint's link from its encoder.

    The motors stay where they are: rotors do not feel it.
    """
    speed, acceleration = differentiate(deviation, scene.motion.rate_hz, scene.motion.valid)

    def links(q: Array, dq: Array, ddq: Array) -> Array:
        return link_torque(scene, q, dq, ddq)

    return along(scene, joint, links, (deviation, speed, acceleration))
