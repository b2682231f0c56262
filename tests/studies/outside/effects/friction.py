"""Friction that a model lacks: as dry friction that can stick, or as a torque."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests.studies.outside.arms import Arm
from tests.studies.outside.effects.effect import Effect, Sized, State, only
from tests.studies.outside.robotfiles import STEP_S

Array = NDArray[np.float64]


def _dry(arm: Arm, j: int, name: str, more: Callable[[float, State], float]) -> Effect:
    """Dry friction at a joint, more by `more(scaled friction, state)`; never below zero."""

    def dry(base: Array, state: State) -> Array:
        return np.maximum(base + only(arm, j, more(float(base[j]), state)), 0.0)

    return Effect(name, j, dry=dry)


def stribeck(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """More dry friction at low speed."""
    slow = float(rng.uniform(0.03, 0.12)) * arm.links[j].speed
    power, size = float(rng.uniform(0.8, 2.0)), 0.8 * arm.drives[j].coulomb

    def make(scale: float) -> Effect:
        def more(base: float, state: State) -> float:
            return float(scale * size * np.exp(-((abs(state.dq[j]) / slow) ** power)))

        return _dry(arm, j, "stribeck", more)

    return Sized("stribeck", j, make, most=4.0)


def asymmetric_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """More dry friction one way than the other."""
    side = float(rng.choice([-0.4, 0.4]))

    def make(scale: float) -> Effect:
        def more(base: float, state: State) -> float:
            return base * float(np.clip(scale * side * np.sign(state.dq[j]), -0.9, 0.9))

        return _dry(arm, j, "asymmetric_friction", more)

    return Sized("asymmetric_friction", j, make, most=2.0)


def load_dependent_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Dry friction that grows with the torque that the gear carries."""

    def make(scale: float) -> Effect:
        def more(base: float, state: State) -> float:
            return 0.08 * scale * abs(float(state.load[j]))

        return _dry(arm, j, "load_dependent_friction", more)

    return Sized("load_dependent_friction", j, make, most=3.0)


def gear_efficiency(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Losses in proportion to the load, of their own while driving and while driven."""
    driving, driven = (0.15, 0.03) if rng.random() < 0.5 else (0.06, 0.15)

    def make(scale: float) -> Effect:
        def more(base: float, state: State) -> float:
            load = float(state.load[j])
            return scale * abs(load) * (driving if load * state.dq[j] >= 0.0 else driven)

        return _dry(arm, j, "gear_efficiency", more)

    return Sized("gear_efficiency", j, make, most=3.0)


def friction_change(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Dry and viscous friction of one joint that have become larger, or smaller."""
    ways = np.array([1.0, 0.8]) if rng.random() < 0.7 else np.array([-0.4, 0.0])

    def make(scale: float) -> Effect:
        def more(base: float, state: State) -> float:
            return base * float(np.clip(0.4 * scale * ways[0], -0.8, 4.0))

        def push(state: State) -> Array:
            change = 0.4 * scale * ways[1] * arm.drives[j].viscous
            return only(arm, j, -change * float(state.dq[j]))

        return Effect("friction_change", j, dry=_dry(arm, j, "", more).dry, push=push)

    return Sized("friction_change", j, make, most=8.0 if ways[0] > 0 else 4.0)


def position_dependent_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Dry friction that is larger at some places than at others."""
    waves, phase = float(rng.choice([1.0, 2.0, 3.0, 5.0])), float(rng.uniform(0.0, 6.3))

    def make(scale: float) -> Effect:
        def more(base: float, state: State) -> float:
            return min(0.4 * scale, 0.95) * base * float(np.sin(waves * state.q[j] + phase))

        return _dry(arm, j, "position_dependent_friction", more)

    return Sized("position_dependent_friction", j, make, most=2.3)


def thermal_friction(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Grease that thins while the gear warms up: an exponential of the temperature."""

    def make(scale: float) -> Effect:
        def less(state: State) -> float:
            return float(np.expm1(-0.02 * scale * state.warmth[j]))

        def more(base: float, state: State) -> float:
            return 0.5 * base * less(state)

        def push(state: State) -> Array:
            return only(arm, j, -arm.drives[j].viscous * less(state) * float(state.dq[j]))

        return Effect("thermal_friction", j, dry=_dry(arm, j, "", more).dry, push=push)

    return Sized("thermal_friction", j, make, most=5.0)


def _drag(arm: Arm, j: int, name: str, power: float) -> Sized:
    top = arm.links[j].speed

    def make(scale: float) -> Effect:
        def push(state: State) -> Array:
            v = float(state.dq[j]) / top
            size = scale * arm.drives[j].coulomb
            return only(arm, j, -size * float(np.sign(v)) * abs(v) ** power)

        return Effect(name, j, push=push)

    return Sized(name, j, make)


def quadratic_drag(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Churning grease."""
    return _drag(arm, j, "quadratic_drag", 2.0)


def nonlinear_viscous(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Shear-thinning grease, or worse than quadratic."""
    return _drag(arm, j, "nonlinear_viscous", float(rng.choice([0.5, 0.6, 3.0])))


def presliding_hysteresis(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Bristles carry a part of the dry friction; they bend before they slide (Dahl)."""
    settle = float(10.0 ** rng.uniform(-2.3, -1.4))  # rad
    waves = arm.drives[j].waviness

    def make(scale: float) -> Effect:
        part = min(scale, 1.0) * (1.0 - waves) * arm.drives[j].coulomb
        distance = settle * max(scale, 1.0)

        def dry(base: Array, state: State) -> Array:
            return base - only(arm, j, part)

        def push(state: State) -> Array:
            x, way = float(state.memory.get("bristle", 0.0)), float(state.dq[j]) * STEP_S
            side = float(np.sign(way))
            state.memory["bristle"] = np.asarray(
                side + (x - side) * np.exp(-abs(way) / distance) if way else x
            )
            return only(arm, j, -part * float(state.memory["bristle"]))

        return Effect("presliding_hysteresis", j, dry=dry, push=push)

    return Sized("presliding_hysteresis", j, make, most=4.0)
