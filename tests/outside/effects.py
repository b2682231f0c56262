"""Effects, each made by means of the simulator: stiffness, bodies, friction, sensors, forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.outside.arms import Arm
from tests.outside.simulate import Effect

Array = NDArray[np.float64]
Draw = Callable[[Arm, np.random.Generator], Effect]


def _joint(arm: Arm, rng: np.random.Generator) -> int:
    return int(rng.integers(len(arm.links)))


def spring(arm: Arm, rng: np.random.Generator) -> Effect:
    """A hose: the joint's own stiffness."""
    j = _joint(arm, rng)
    size = float(rng.uniform(0.8, 1.6)) * arm.links[j].coulomb

    def change(model: mujoco.MjModel) -> None:
        model.jnt_stiffness[j] = size

    return Effect("spring", j, size, model=change)


def payload(arm: Arm, rng: np.random.Generator) -> Effect:
    """A load that the last link carries: its body, changed."""
    last, size = arm.links[-1], float(rng.uniform(0.3, 0.7)) * arm.links[-1].mass

    def change(model: mujoco.MjModel) -> None:
        body = model.nbody - 1
        place = np.array([0.0, 0.0, 2.0 * last.centre[2]])
        mass = last.mass + size
        middle = (last.mass * last.centre + size * place) / mass
        off, own = place - middle, last.centre - middle
        model.body_inertia[body] = last.inertia + sum(
            m * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
            for m, (x, y, z) in ((size, off), (last.mass, own))
        )  # products of inertia beside an axis of some mm are left out
        model.body_mass[body], model.body_ipos[body] = mass, middle

    return Effect("payload", None, size, model=change)


def load_dependent_friction(arm: Arm, rng: np.random.Generator) -> Effect:
    """Dry friction that grows with the torque that the gear carries."""
    j, size = 0, float(rng.uniform(0.06, 0.12))

    def dry(base: Array, dq: Array, load: Array) -> Array:
        found = base.copy()
        found[j] += size * abs(load[j])
        return found

    return Effect("load_dependent_friction", j, size, dry=dry)


def friction_change(arm: Arm, rng: np.random.Generator) -> Effect:
    """Dry friction of one joint that has become larger."""
    j, size = _joint(arm, rng), float(rng.uniform(0.3, 0.6))

    def dry(base: Array, dq: Array, load: Array) -> Array:
        found = base.copy()
        found[j] *= 1.0 + size
        return found

    return Effect("friction_change", j, size, dry=dry)


def stribeck(arm: Arm, rng: np.random.Generator) -> Effect:
    """More dry friction at low speed."""
    j = _joint(arm, rng)
    size = float(rng.uniform(0.6, 1.0)) * arm.links[j].coulomb
    slow = float(rng.uniform(0.1, 0.2))

    def dry(base: Array, dq: Array, load: Array) -> Array:
        found = base.copy()
        found[j] += size * np.exp(-((dq[j] / slow) ** 2))
        return found

    return Effect("stribeck", j, size, dry=dry)


def torque_bias(arm: Arm, rng: np.random.Generator) -> Effect:
    """A current sensor with an offset."""
    j = _joint(arm, rng)
    size = float(rng.uniform(0.3, 0.6)) * arm.links[j].coulomb

    def told(tau: Array) -> Array:
        found = tau.copy()
        found[:, j] += size
        return found

    return Effect("torque_bias", j, size, torque=told)


def external_contact(arm: Arm, rng: np.random.Generator) -> Effect:
    """Somebody pushes for half a second."""
    j, start = _joint(arm, rng), float(rng.uniform(3.0, 6.0))
    size = 4.0 * arm.links[j].coulomb

    def push(t: float) -> Array:
        found = np.zeros(len(arm.links))
        found[j] = size * np.sin(np.pi * np.clip((t - start) / 0.5, 0.0, 1.0))
        return found

    return Effect("external_contact", j, size, push=push)


KINDS: Mapping[str, Draw] = {
    draw.__name__: draw
    for draw in (
        spring,
        payload,
        load_dependent_friction,
        friction_change,
        stribeck,
        torque_bias,
        external_contact,
    )
}
