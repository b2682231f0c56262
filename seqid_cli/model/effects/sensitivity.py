"""How the links' torque answers when one joint's link is not where its measured angle says."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from seqid_cli.model.effects.effect import Columns
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array

Torque = Callable[[Array, Array, Array], Array]  # (q, dq, ddq), each (N, n) -> (N, n)

# rad, rad/s, rad/s^2, of central differences; the last is exact
STEPS = (1e-4, 1e-3, 1.0)
BLOCK = 4096  # samples at a time, so that they stay in cache


def link_torque(scene: Scene, q: Array, dq: Array, ddq: Array) -> Array:
    """Torque (N, n) that moves the links alone: no rotors; zero without rigid-body parameters."""
    phi = scene.model.phi
    if phi is None:
        return np.zeros_like(q)
    parts = [
        inverse_dynamics(
            scene.robot.chain, scene.robot.gravity, phi, q[at], dq[at], ddq[at]
        )
        for at in tiles(len(q), size=BLOCK)
    ]
    return np.concatenate(parts)


def link_inertia(scene: Scene, joint: int) -> Array:
    """Column `joint` (N, n) of the links' mass matrix, kg m^2: torque per its acceleration."""
    key = ("link_inertia", joint)
    if key not in scene.memo:
        q, phi, still = scene.motion.q, scene.model.phi, np.zeros_like(scene.motion.q)
        unit = still + np.eye(scene.robot.n)[joint]
        chain, no_gravity = scene.robot.chain, np.zeros(3)
        made = (
            still
            if phi is None
            else inverse_dynamics(chain, no_gravity, phi, q, still, unit)
        )
        scene.memo[key] = (made,)
    return scene.memo[key][0]


def slopes(
    scene: Scene,
    joint: int,
    name: str,
    torque: Torque,
    which: Sequence[int] = (0, 1, 2),
) -> tuple[Array, ...]:
    """Derivatives (N, n) of a torque by `which` of one joint's position, velocity, acceleration.

    N m per rad, rad/s and rad/s^2; computed once per scene, joint and `name` of the
    torque.
    """
    key = (name, joint)
    if key not in scene.memo:
        motion, found = (scene.motion.q, scene.motion.dq, scene.motion.ddq), []
        for k in which:
            step = np.zeros((3, 1, scene.robot.n))
            step[k, :, joint] = STEPS[k]
            change = torque(*(motion + step)) - torque(*(motion - step))
            found.append(change / (2 * STEPS[k]))
        scene.memo[key] = tuple(found)
    return scene.memo[key]


def link_slopes(scene: Scene, joint: int) -> tuple[Array, ...]:
    """Slopes of the torque that moves the links alone."""
    torque = partial(link_torque, scene)
    return *slopes(scene, joint, "links", torque, (0, 1)), link_inertia(scene, joint)


def modelled_slopes(scene: Scene, joint: int) -> tuple[Array, ...]:
    """Slopes of all modelled torque: links, rotors and the joint's own friction."""

    def beside_links(q: Array, dq: Array, ddq: Array) -> Array:
        torque = scene.model.rotors(q, dq, ddq)
        torque[:, joint] += scene.model.friction_of(joint, q[:, joint], dq[:, joint])
        return torque

    both = link_slopes(scene, joint), slopes(scene, joint, "beside links", beside_links)
    return tuple(one + other for one, other in zip(*both, strict=True))


def link_deviation(scene: Scene, joint: int, deviation: Array) -> Columns:
    """Torque (N, 1) of every joint for a deviation (N,) of one's link; rotors do not feel it."""
    speed, acceleration = differentiate(
        deviation, scene.motion.rate_hz, scene.motion.valid
    )
    by_place, by_speed, by_acceleration = link_slopes(scene, joint)
    torque = by_place * deviation[:, None] + by_speed * speed[:, None]
    torque += by_acceleration * acceleration[:, None]
    return {j: torque[:, j : j + 1] for j in range(scene.robot.n)}
