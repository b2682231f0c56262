"""Friction that a model lacks: as dry friction that can stick, or as a torque."""

from collections.abc import Callable

import numpy as np

from tests import Array
from tests.studies.outside.arms import Arm
from tests.studies.outside.effects.effect import Effect, Sized, State, only
from tests.studies.outside.robotfiles import STEP_S

More = Callable[[float, float, State], float]  # scale, dry friction as it would be, state
Push = Callable[[float, State], float]  # scale, state -> torque


def _sized(
    arm: Arm, j: int, name: str, more: More | None, push: Push | None = None, most: float = 20.0
) -> Sized:
    """More dry friction at a joint, never below zero in all, and a torque beside it."""

    def make(scale: float) -> Effect:
        def dry(base: Array, state: State) -> Array:
            assert more is not None
            return np.maximum(base + only(arm, j, more(scale, float(base[j]), state)), 0.0)

        def torque(state: State) -> Array:
            assert push is not None
            return only(arm, j, push(scale, state))

        return Effect(name, j, dry=dry if more else None, push=torque if push else None)

    return Sized(name, j, make, most=most)


def stribeck(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """More dry friction at low speed."""
    slow = float(rng.uniform(0.03, 0.12)) * arm.links[j].speed
    power, size = float(rng.uniform(0.8, 2.0)), 0.8 * arm.drives[j].coulomb

    def more(scale: float, base: float, state: State) -> float:
        return float(scale * size * np.exp(-((abs(state.dq[j]) / slow) ** power)))

    return _sized(arm, j, "stribeck", more, most=4.0)


def asymmetric_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """More dry friction one way than the other."""
    side = float(rng.choice([-0.4, 0.4]))

    def more(scale: float, base: float, state: State) -> float:
        return base * float(np.clip(scale * side * np.sign(state.dq[j]), -0.9, 0.9))

    return _sized(arm, j, "asymmetric_friction", more, most=2.0)


def load_dependent_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Dry friction that grows with the torque that the gear carries."""

    def more(scale: float, base: float, state: State) -> float:
        return 0.08 * scale * abs(float(state.load[j]))

    return _sized(arm, j, "load_dependent_friction", more, most=3.0)


def gear_efficiency(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Losses in proportion to the load, of their own while driving and while driven."""
    driving, driven = (0.15, 0.03) if rng.random() < 0.5 else (0.06, 0.15)

    def more(scale: float, base: float, state: State) -> float:
        load = float(state.load[j])
        return scale * abs(load) * (driving if load * state.dq[j] >= 0.0 else driven)

    return _sized(arm, j, "gear_efficiency", more, most=3.0)


def friction_change(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Dry and viscous friction of one joint that have become larger, or smaller."""
    ways = np.array([1.0, 0.8]) if rng.random() < 0.7 else np.array([-0.4, 0.0])

    def more(scale: float, base: float, state: State) -> float:
        return base * float(np.clip(0.4 * scale * ways[0], -0.8, 4.0))

    def push(scale: float, state: State) -> float:
        return -(0.4 * scale * ways[1] * arm.drives[j].viscous) * float(state.dq[j])

    return _sized(arm, j, "friction_change", more, push, most=8.0 if ways[0] > 0 else 4.0)


def position_dependent_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Dry friction that is larger at some places than at others."""
    waves, phase = float(rng.choice([1.0, 2.0, 3.0, 5.0])), float(rng.uniform(0.0, 6.3))

    def more(scale: float, base: float, state: State) -> float:
        return min(0.4 * scale, 0.95) * base * float(np.sin(waves * state.q[j] + phase))

    return _sized(arm, j, "position_dependent_friction", more, most=2.3)


def thermal_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Grease that thins while the gear warms up: an exponential of the temperature."""

    def less(scale: float, state: State) -> float:
        return float(np.expm1(-0.02 * scale * state.warmth[j]))

    def more(scale: float, base: float, state: State) -> float:
        return 0.5 * base * less(scale, state)

    def push(scale: float, state: State) -> float:
        return -arm.drives[j].viscous * less(scale, state) * float(state.dq[j])

    return _sized(arm, j, "thermal_friction", more, push, most=5.0)


def _drag(arm: Arm, j: int, name: str, power: float) -> Sized:
    def push(scale: float, state: State) -> float:
        v = float(state.dq[j]) / arm.links[j].speed
        return -(scale * arm.drives[j].coulomb) * float(np.sign(v)) * abs(v) ** power

    return _sized(arm, j, name, None, push)


def quadratic_drag(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Churning grease."""
    return _drag(arm, j, "quadratic_drag", 2.0)


def nonlinear_viscous(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Shear-thinning grease, or worse than quadratic."""
    return _drag(arm, j, "nonlinear_viscous", float(rng.choice([0.5, 0.6, 3.0])))


def presliding_hysteresis(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Bristles carry a part of the dry friction; they bend before they slide (Dahl)."""
    settle = float(10.0 ** rng.uniform(-2.3, -1.4))  # rad

    def part(scale: float) -> float:
        return min(scale, 1.0) * (1.0 - arm.drives[j].waviness) * arm.drives[j].coulomb

    def more(scale: float, base: float, state: State) -> float:
        return -part(scale)

    def push(scale: float, state: State) -> float:
        x, way = float(state.memory.get("bristle", 0.0)), float(state.dq[j]) * STEP_S
        side, distance = float(np.sign(way)), settle * max(scale, 1.0)
        bent = side + (x - side) * np.exp(-abs(way) / distance) if way else x
        state.memory["bristle"] = np.asarray(bent)
        return -part(scale) * float(bent)

    return _sized(arm, j, "presliding_hysteresis", more, push, most=4.0)
