"""Undeclared friction and springs of one joint, sized by the joint's rated torque.

Every function takes (plant, joint, size) and returns the plant that has the effect as well. Size 1
is clear, about 5 % of rated torque (`CLEAR`) where the docstring says nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos

import numpy as np

from tests import Array
from tests.plants.friction.laws import Bristles, Curve, Extra, Heat, MeshLoss, Stribeck, Warming
from tests.plants.mechanics.hidden import Run, TorqueSource
from tests.plants.mechanics.rigid import Rigid
from tests.plants.simulate import Plant

CLEAR = 0.05  # share of rated torque at size 1
BUSY = 0.6  # share of the limits of speed and acceleration that busy motion uses at once
STATES = 400
USUAL_SPEED = 0.3  # share of the top speed at which the gears warm up
WARMING = 20.0  # K, after hours of usual work
WARMING_TIME = 300.0  # s


def rated_torque(plant: Plant) -> Array:
    """Largest torque of busy motion in 400 random states, friction included, (n,) N m."""
    rng = np.random.default_rng(0)
    rigid, law = Rigid(plant.arm), plant.friction.begin()
    most = np.zeros(plant.arm.n)
    for _ in range(STATES):
        q = rng.uniform(*plant.position_limits.T)
        dq, ddq = rng.uniform(-BUSY, BUSY, (2, plant.arm.n))
        dq, ddq = dq * plant.velocity_limits, ddq * plant.acceleration_limits
        rub = law(0.0, q, dq, np.zeros(plant.arm.n)).sliding(dq)
        most = np.maximum(most, np.abs(rigid.inverse(q, dq, ddq) + rub))
    return most


def dry_level(plant: Plant, joint: int) -> float:
    """Smaller dry level of a joint at a third of its top speed, N m."""
    dq = plant.velocity_limits / 3.0
    dry = plant.friction.begin()(0.0, plant.position_limits.mean(axis=1), dq, np.zeros_like(dq))
    return float(min(dry.forward[joint], dry.backward[joint]))


def clear(plant: Plant, joint: int, size: float) -> float:
    """`size` times 5 % of the joint's rated torque, N m."""
    return CLEAR * size * float(rated_torque(plant)[joint])


def _add(plant: Plant, joint: int, curve: Curve) -> Plant:
    return replace(plant, friction=Extra(plant.friction, joint, curve))


def stribeck(plant: Plant, joint: int, size: float) -> Plant:
    """Stribeck hump; its speed is 6 % of the top speed."""
    speed = 0.06 * float(plant.velocity_limits[joint])
    return _add(plant, joint, Stribeck(clear(plant, joint, size), speed))


def asymmetric(plant: Plant, joint: int, size: float) -> Plant:
    """More dry friction forward, less backward, by at most 80 % of the level."""
    more = min(clear(plant, joint, size), 0.8 * dry_level(plant, joint))
    return _add(plant, joint, lambda q, v, load: (more, -more, 0.0))


def load_dependent(plant: Plant, joint: int, size: float) -> Plant:
    """10 % of the transmitted torque times size: 5 % of rated at half of it."""
    return _add(plant, joint, MeshLoss(0.10 * size, 0.10 * size))


def gear_efficiency(plant: Plant, joint: int, size: float) -> Plant:
    """15 % of the transmitted torque is lost when driving, 3 % when back-driven, times size."""
    return _add(plant, joint, MeshLoss(0.15 * size, 0.03 * size))


def _power(plant: Plant, joint: int, size: float, share: float, exponent: float) -> Plant:
    """Viscous friction factor |v|^exponent sign(v), clear at a share of the top speed.

    Below an exponent of 1 it counts as dry, so that it is not stiff at rest.
    """
    reference = (share * float(plant.velocity_limits[joint])) ** exponent
    factor = clear(plant, joint, size) / reference

    def curve(q: float, v: float, load: float) -> tuple[float, float, float]:
        size = factor * abs(v) ** exponent
        if exponent < 1.0:
            return size, size, 0.0
        return 0.0, 0.0, size if v > 0 else -size

    return _add(plant, joint, curve)


def quadratic_drag(plant: Plant, joint: int, size: float) -> Plant:
    """c v |v|; clear at 80 % of the top speed."""
    return _power(plant, joint, size, 0.8, 2.0)


def cubic_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c v^3; clear at 80 % of the top speed."""
    return _power(plant, joint, size, 0.8, 3.0)


def root_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c |v|^0.5 sign(v); clear at 40 % of the top speed."""
    return _power(plant, joint, size, 0.4, 0.5)


def presliding(plant: Plant, joint: int, size: float) -> Plant:
    """Bristles (LuGre) that slip after 20 mrad times size at the joint."""
    stiffness = dry_level(plant, joint) / (0.020 * size)
    damping = 0.3 * np.sqrt(stiffness * float(plant.arm.reflected[joint]))
    return replace(plant, friction=Bristles(plant.friction, joint, stiffness, damping))


def level_wave(plant: Plant, joint: int, size: float) -> Plant:
    """Coulomb level that varies as cos(3 q), by at most 80 % of it."""
    more = min(clear(plant, joint, size), 0.8 * dry_level(plant, joint))
    return _add(plant, joint, lambda q, v, load: (more * cos(3.0 * q), more * cos(3.0 * q), 0.0))


def thermal(plant: Plant, joint: int, size: float) -> Plant:
    """Warm gears turn more easily: 20 K take a clear torque off the viscous one at top speed."""
    middle, zero = plant.position_limits.mean(axis=1), np.zeros(plant.arm.n)
    dq = USUAL_SPEED * plant.velocity_limits
    dry = plant.friction.begin()(0.0, middle, dq, zero)
    usual = (dry.forward + dry.smooth) * dq
    loss = usual / WARMING
    heat = Heat(capacity=WARMING_TIME * loss, loss=loss, usual=usual)
    viscous = plant.friction.begin()(0.0, middle, plant.velocity_limits, zero).smooth
    share = min(clear(plant, joint, size) / float(viscous[joint]), 0.6)
    thinning = at(plant, joint, -np.log1p(-share) / WARMING)
    return replace(plant, friction=Warming(plant.friction, heat, thinning), heat=heat)


def at(plant: Plant, joint: int, value: float) -> Array:
    """Zero everywhere but at one joint, (n,)."""
    out = np.zeros(plant.arm.n)
    out[joint] = value
    return out


def middle_and_half(plant: Plant, joint: int) -> tuple[float, float]:
    """Middle of a joint's range and half of its width, rad."""
    low, high = plant.position_limits[joint]
    return float(0.5 * (low + high)), float(0.5 * (high - low))


def source_on(joint: int, law: Callable[[Array, Array], float]) -> TorqueSource:
    """A torque law(q, dq) N m on one joint, both (n,)."""

    def source(t: float, q: Array, dq: Array) -> Array:
        out = np.zeros_like(q)
        out[joint] = law(q, dq)
        return out

    return source


def on_joint(plant: Plant, joint: int, law: Callable[[Array, Array], float]) -> Plant:
    return plant.hiding(torques=lambda run: source_on(joint, law))


@dataclass(frozen=True)
class LinearSpring:
    """-stiffness (q - rest) on one joint; N m/rad, rad."""

    joint: int
    stiffness: float
    rest: float

    def __call__(self, run: Run) -> TorqueSource:
        i = self.joint
        return source_on(i, lambda q, dq: -self.stiffness * (q[i] - self.rest))


def spring(plant: Plant, joint: int, size: float) -> Plant:
    """Linear spring; clear at 60 % of the way from its rest, near the middle, to the end."""
    middle, half = middle_and_half(plant, joint)
    stiffness = clear(plant, joint, size) / (0.6 * half)
    return plant.hiding(torques=LinearSpring(joint, stiffness, middle + 0.1 * half))


def counterbalance(plant: Plant, joint: int, size: float) -> Plant:
    """Coil spring between a point of either link, always in tension; at most four times clear.

    Distances are in that of the point on the base from the axis: `arm` that of the other, `slack`
    the spring's length without tension. Its torque is minus the slope of its energy.
    """
    arm, slack = 0.3, 0.5
    middle, half = middle_and_half(plant, joint)

    def torque(q: float, stiffness: float) -> float:
        angle = q - (middle - 0.5)
        length = float(np.sqrt(1.0 + arm**2 - 2.0 * arm * np.cos(angle)))
        pull = stiffness * max(length - slack, 0.0)
        return -pull * arm * float(np.sin(angle)) / length

    most = max(abs(torque(q, 1.0)) for q in np.linspace(middle - half, middle + half, 200))
    stiffness = 4.0 * clear(plant, joint, size) / most
    return on_joint(plant, joint, lambda q, dq: torque(float(q[joint]), stiffness))
