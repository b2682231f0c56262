"""Friction of one joint beyond the plant's own: curves, bristles that bend, gears that
warm up.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

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
class MeshLoss:
    """|load| sign(v), times `driving` where the drive moves the load, else
    `back_driving`.
    """

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

    z' = v - |v| z / z_ss with z_ss = level(v)/stiffness, torque = stiffness z + damping
    z' + the smooth part; level is the dry level of `base` in the direction of motion,
    so that the torque at constant speed is that of `base`. `stiffness` N m/rad,
    `damping` N m s/rad, at the joint.
    """

    base: FrictionModel
    joint: int
    stiffness: float
    damping: float

    def begin(self) -> Law:
        base, i, bend, before = self.base.begin(), self.joint, 0.0, np.nan

        def law(t: float, q: Array, dq: Array, load: Array) -> Friction:
            nonlocal bend, before
            forward, backward, smooth = (x.copy() for x in base(t, q, dq, load))
            here, rate = float(q[i]), float(dq[i])
            way = 0.0 if np.isnan(before) else here - before
            before = here
            limit = (
                max(float(forward[i] if way >= 0 else backward[i]), 1e-12)
                / self.stiffness
            )
            goal = limit if way >= 0 else -limit
            # exact for any way
            bend = float(goal + (bend - goal) * np.exp(-abs(way) / limit))
            bending = rate - abs(rate) * bend / limit
            smooth[i] += self.stiffness * bend + self.damping * bending
            forward[i] = backward[i] = 0.0
            return Friction(forward, backward, smooth)

        return law


@dataclass(frozen=True)
class Heat:
    """C dT/dt = P - G (T - ambient) per joint, all (n,); degC, J/K, W/K, W.

    Between the logs the arm works on, at the mean friction power `usual`, from power-on
    at ambient temperature; so a log that starts later starts warmer.
    """

    capacity: Array
    loss: Array
    usual: Array
    ambient: float = 22.0

    @property
    def time_constant(self) -> Array:
        return self.capacity / self.loss

    def at(self, t: float) -> Array:
        """Temperature after `t` s of usual work, (n,) degC."""
        rise = self.usual / self.loss
        return np.asarray(self.ambient + rise * -np.expm1(-t / self.time_constant))

    def advance(self, degrees: Array, power: Array, dt: float) -> Array:
        """Temperature after `dt` s at constant friction power (n,) W."""
        goal = self.ambient + power / self.loss
        return np.asarray(goal + (degrees - goal) * np.exp(-dt / self.time_constant))

    def trace(self, start: float, power: Array, dt: float) -> Array:
        """Temperatures (N, n) degC at the rows of power (N, n) W, the first at `start`
        s.
        """
        first, out = self.at(start), np.empty_like(power)
        for i, pole in enumerate(np.exp(-dt / self.time_constant)):
            goal = power[:, i] / self.loss[i]
            drive = np.concatenate(
                [[first[i] - self.ambient], (1.0 - pole) * goal[:-1]]
            )
            out[:, i] = self.ambient + lfilter([1.0], [1.0, -pole], drive)
        return out


@dataclass(frozen=True)
class Warming:
    """Friction whose smooth part falls as exp(-thinning (T - ambient)), thinning (n,)
    1/K.
    """

    base: FrictionModel
    heat: Heat
    thinning: Array

    def begin(self) -> Law:
        base, heat, then = self.base.begin(), self.heat, 0.0
        degrees: Array | None = None

        def law(t: float, q: Array, dq: Array, load: Array) -> Friction:
            nonlocal degrees, then
            if degrees is None:
                degrees, then = heat.at(t), t
            cold, thinner = (
                base(t, q, dq, load),
                np.exp(-self.thinning * (degrees - heat.ambient)),
            )
            felt = cold._replace(smooth=cold.smooth * thinner)
            if t > then:
                degrees = heat.advance(degrees, np.abs(felt.sliding(dq) * dq), t - then)
                then = t
            return felt

        return law
