"""Derivatives of the links' torque by one joint's position, velocity, acceleration."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from seqid_cli.effects.effect import Columns
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array

Torque = Callable[[Array, Array, Array], Array]  # (q, dq, ddq), each (N, n) -> (N, n)

# Half steps of central differences in q, dq, ddq, SI units. Torque is linear in the
# acceleration, so that the last one is exact.
STEPS = (1e-4, 1e-3, 1.0)
BLOCK = 4096  # samples at a time, so that they stay in cache


def link_torque(scene: Scene, q: Array, dq: Array, ddq: Array) -> Array:
    """Compute the torque (N, n) N m that moves the links alone, without rotors.

    It is zero without rigid-body parameters.
    """
    phi = scene.model.phi
    if phi is None:
        return np.zeros_like(q)
    robot = scene.robot
    blocks = [
        inverse_dynamics(robot.chain, robot.gravity, phi, q[part], dq[part], ddq[part])
        for part in tiles(len(q), size=BLOCK)
    ]
    return np.concatenate(blocks)


def link_inertia(scene: Scene, joint: int) -> Array:
    """Return a column (N, n) of the links' mass matrix, kg m^2.

    It is the torque of all joints per acceleration of the `joint`.
    """
    key = ("link_inertia", joint)
    if key not in scene.memo:
        q = scene.motion.q
        phi = scene.model.phi
        still = np.zeros_like(q)
        inertia = still
        if phi is not None:
            unit_acceleration = still + np.eye(scene.robot.n)[joint]
            no_gravity = np.zeros(3)
            inertia = inverse_dynamics(
                scene.robot.chain, no_gravity, phi, q, still, unit_acceleration
            )
        scene.memo[key] = (inertia,)
    return scene.memo[key][0]


def slopes(
    scene: Scene,
    joint: int,
    name: str,
    torque: Torque,
    which: Sequence[int] = (0, 1, 2),
) -> tuple[Array, ...]:
    """Differentiate a torque by one joint's position, velocity and acceleration.

    Parameters
    ----------
    scene : Scene
        Keeps the result: it is computed once per scene, joint and name.
    joint : int
    name : str
        Of the torque.
    torque : callable
        Torque (N, n) of q, dq, ddq, each (N, n).
    which : sequence of int
        0, 1, 2 for the derivatives by position, velocity and acceleration.

    Returns
    -------
    tuple of Array
        Each (N, n), in N m per rad, rad/s and rad/s^2.
    """
    key = (name, joint)
    if key not in scene.memo:
        states = np.stack([scene.motion.q, scene.motion.dq, scene.motion.ddq])
        derivatives = []
        for k in which:
            step = np.zeros((3, 1, scene.robot.n))
            step[k, :, joint] = STEPS[k]
            change = torque(*(states + step)) - torque(*(states - step))
            derivatives.append(change / (2 * STEPS[k]))
        scene.memo[key] = tuple(derivatives)
    return scene.memo[key]


def link_slopes(scene: Scene, joint: int) -> tuple[Array, ...]:
    """Return the slopes of the torque that moves the links alone."""
    torque = partial(link_torque, scene)
    by_position, by_velocity = slopes(scene, joint, "links", torque, (0, 1))
    return by_position, by_velocity, link_inertia(scene, joint)


def modelled_slopes(scene: Scene, joint: int) -> tuple[Array, ...]:
    """Return the slopes of all modelled torque: links, rotors, the joint's friction."""

    def beside_links(q: Array, dq: Array, ddq: Array) -> Array:
        torque = scene.model.rotors(q, dq, ddq)
        torque[:, joint] += scene.model.friction_of(joint, q[:, joint], dq[:, joint])
        return torque

    of_links = link_slopes(scene, joint)
    of_others = slopes(scene, joint, "beside links", beside_links)
    return tuple(a + b for a, b in zip(of_links, of_others, strict=True))


def link_deviation(scene: Scene, joint: int, deviation: Array) -> Columns:
    """Compute the torque of every joint for a deviation of one joint's link.

    Parameters
    ----------
    scene : Scene
    joint : int
    deviation : Array
        (N,) rad, by which the link is ahead of where its encoder says. Rotors do not
        feel it.

    Returns
    -------
    mapping of joint index to (N, 1) array
        N m.
    """
    speed, acceleration = differentiate(
        deviation, scene.motion.rate_hz, scene.motion.valid
    )
    by_position, by_velocity, by_acceleration = link_slopes(scene, joint)
    torque = by_position * deviation[:, None] + by_velocity * speed[:, None]
    torque += by_acceleration * acceleration[:, None]
    return {j: torque[:, j : j + 1] for j in range(scene.robot.n)}
