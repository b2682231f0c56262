"""Friction of one joint beyond the plant's own: what a curve adds, and bristles that bend."""

from collections.abc import Callable
from dataclasses import dataclass
from math import exp

import numpy as np

from tests import Array
from tests.plants.friction.surface import Friction, FrictionModel, Law

# (position rad, speed rad/s, load N m) -> what to add to forward, backward, smooth, N m
Curve = Callable[[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Extra:
    """Adds a curve to the friction of one joint; dry levels stay at least 0."""

    base: FrictionModel
    joint: int
    curve: Curve

    def begin(self) -> Law:
        """Return the law of one run."""
        base, i, curve = self.base.begin(), self.joint, self.curve

        def law(t: float, q: Array, dq: Array, load: Array) -> Friction:
            forward, backward, smooth = (x.copy() for x in base(t, q, dq, load))
            ahead, back, viscous = curve(float(q[i]), float(dq[i]), float(load[i]))
            forward[i] = max(forward[i] + ahead, 0.0)
            backward[i] = max(backward[i] + back, 0.0)
            smooth[i] += viscous
            return Friction(forward, backward, smooth)

        return law


@dataclass(frozen=True)
class Stribeck:
    """level exp(-(v/speed)^2) sign(v)."""

    level: float
    speed: float

    def __call__(self, q: float, v: float, load: float) -> tuple[float, float, float]:
        more = self.level * exp(-((v / self.speed) ** 2))
        return more, more, 0.0


@dataclass(frozen=True)
class MeshLoss:
    """|load| sign(v), times `driving` where the drive moves the load, else `back_driving`."""

    driving: float
    back_driving: float

    def __call__(self, q: float, v: float, load: float) -> tuple[float, float, float]:
        ahead, back = self.driving, self.back_driving
        if load < 0.0:
            ahead, back = back, ahead
        return ahead * abs(load), back * abs(load), 0.0


@dataclass(frozen=True)
class Bristles:
    """Replaces the dry friction of one joint by bristles that bend before they slip.

    z' = v - |v| z / z_ss with z_ss = level(v)/stiffness, torque = stiffness z + damping z' + the
    smooth part; level is the dry level of `base` in the direction of motion, so that the torque
    at constant speed is that of `base`. `stiffness` N m/rad, `damping` N m s/rad, at the joint.
    """

    base: FrictionModel
    joint: int
    stiffness: float
    damping: float = 0.0

    def begin(self) -> Law:
        """Return the law of one run, from unbent bristles."""
        base, i = self.base.begin(), self.joint
        bend, before = 0.0, np.nan

        def law(t: float, q: Array, dq: Array, load: Array) -> Friction:
            nonlocal bend, before
            forward, backward, smooth = (x.copy() for x in base(t, q, dq, load))
            here, rate = float(q[i]), float(dq[i])
            way = 0.0 if np.isnan(before) else here - before
            before = here
            limit = max(float(forward[i] if way >= 0 else backward[i]), 1e-12) / self.stiffness
            bend = slip(bend, way, limit)
            bending = rate - abs(rate) * bend / limit
            smooth[i] += self.stiffness * bend + self.damping * bending
            forward[i] = backward[i] = 0.0
            return Friction(forward, backward, smooth)

        return law


def slip(bend: float, way: float, limit: float) -> float:
    """Bend of the bristles after a move of `way` rad, exact for any length of it, rad."""
    goal = limit if way >= 0 else -limit
    return float(goal + (bend - goal) * np.exp(-abs(way) / limit))
