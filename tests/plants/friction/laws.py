"""Friction of one joint beyond the plant's own: what a curve adds to the dry and smooth parts."""

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp

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
class Asymmetry:
    """dry |sign(v)| + viscous |v|: more friction forward than backward."""

    dry: float
    viscous: float = 0.0

    def __call__(self, q: float, v: float, load: float) -> tuple[float, float, float]:
        return self.dry, -self.dry, self.viscous * abs(v)


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
class Power:
    """factor |v|^exponent sign(v); below 1 it counts as dry, so that it is not stiff at rest."""

    factor: float
    exponent: float

    def __call__(self, q: float, v: float, load: float) -> tuple[float, float, float]:
        size = self.factor * abs(v) ** self.exponent
        if self.exponent < 1.0:
            return size, size, 0.0
        return 0.0, 0.0, size if v > 0 else -size


@dataclass(frozen=True)
class LevelWave:
    """amplitude cos(order q + phase) sign(v): dry friction that varies with position."""

    amplitude: float
    order: float
    phase: float

    def __call__(self, q: float, v: float, load: float) -> tuple[float, float, float]:
        more = self.amplitude * cos(self.order * q + self.phase)
        return more, more, 0.0
