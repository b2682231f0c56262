"""What drives and sensors do to the log: torques, their time, and angles."""

from collections.abc import Callable

import numpy as np

from tests import Array
from tests.studies.outside.arms import Arm
from tests.studies.outside.effects.effect import Effect, Sized, State
from tests.studies.outside.robotfiles import STEP_S

Change = Callable[[float, Array, Array], Array]  # scale, torque (N,), t (N,) -> what is logged


def _told(j: int, name: str, change: Change, most: float = 20.0) -> Sized:
    """Another torque of a joint in the log than the motor's."""

    def make(scale: float) -> Effect:
        def told(tau: Array, t: Array) -> Array:
            changed = tau.copy()
            changed[:, j] = change(scale, tau[:, j], t)
            return changed

        return Effect(name, j, told=told)

    return Sized(name, j, make, most=most)


def torque_constant(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """More amperes per newton metre than before."""
    side = float(rng.choice([-1.0, 1.0]))
    return _told(j, "torque_constant", lambda c, tau, t: (1.0 + 0.05 * side * c) * tau, most=6.0)


def torque_saturation(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Iron that saturates: more and more amperes for the last newton metres."""
    rated = 10.0 * arm.drives[j].coulomb

    def change(scale: float, tau: Array, t: Array) -> Array:
        return tau * (1.0 + 0.05 * scale * (tau / rated) ** 2)

    return _told(j, "torque_saturation", change, most=6.0)


def torque_bias(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A current sensor with an offset."""
    side, level = float(rng.choice([-1.0, 1.0])), arm.drives[j].coulomb
    return _told(j, "torque_bias", lambda scale, tau, t: tau + 0.4 * side * scale * level)


def drift(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """An offset that creeps while the drive warms up."""
    side, level = float(rng.choice([-1.0, 1.0])), arm.drives[j].coulomb
    return _told(j, "drift", lambda scale, tau, t: tau + side * scale * level * t / 60.0)


def periodic_disturbance(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A pump, a fan or the mains in the current sensor."""
    hertz, phase = float(rng.choice([3.7, 8.3, 14.6, 29.5, 50.0])), float(rng.uniform(0.0, 6.3))

    def change(scale: float, tau: Array, t: Array) -> Array:
        wave = np.sin(2.0 * np.pi * hertz * t + phase)
        return tau + 0.3 * scale * arm.drives[j].coulomb * wave

    return _told(j, "periodic_disturbance", change)


def _joint_or_all(j: int, rng: np.random.Generator) -> int | None:
    return j if rng.random() < 0.5 else None


def time_skew(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Torques that are logged late, or early, against the positions."""
    joint, side = _joint_or_all(j, rng), float(rng.choice([-1.0, 1.0]))

    def make(scale: float) -> Effect:
        def told(tau: Array, t: Array) -> Array:
            late, moved = t - side * 0.003 * scale, tau.copy()
            for k in range(arm.n) if joint is None else (joint,):
                moved[:, k] = np.interp(late, t, tau[:, k])
            return moved

        return Effect("time_skew", joint, told=told)

    return Sized("time_skew", joint, make, most=8.0)


def actuator_lag(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """The log holds what was commanded; the drive follows it with a lag."""
    joint = _joint_or_all(j, rng)

    def make(scale: float) -> Effect:
        share = np.zeros(arm.n)
        share[slice(None) if joint is None else joint] = 1.0

        def drive(torque: Array, state: State) -> Array:
            acting = state.memory.get("acting", torque)
            step = 1.0 - np.exp(-STEP_S / (0.003 * scale))
            state.memory["acting"] = acting + step * (torque - acting)
            return share * state.memory["acting"] + (1.0 - share) * torque

        return Effect("actuator_lag", joint, drive=drive)

    return Sized("actuator_lag", joint, make, most=4.0)


def encoder_eccentricity(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A disc off centre, on the joint's own shaft or the motor's: the controller believes it."""
    slow = rng.random() < 0.6
    order = float(rng.choice([1.0, 2.0])) if slow else arm.drives[j].ratio
    size, phase = (0.01 if slow else 0.02 / order), float(rng.uniform(0.0, 6.3))

    def make(scale: float) -> Effect:
        def angle(q: Array) -> Array:
            said = q.copy()
            said[..., j] += scale * size * np.sin(order * q[..., j] + phase)
            return said

        return Effect("encoder_eccentricity", j, angle=angle)

    return Sized("encoder_eccentricity", j, make, most=5.0)
