"""Undeclared friction and springs of one joint, sized by the joint's rated torque.

Every function takes (plant, joint, size) and returns the plant that has the effect as well. Size 1
is clear, about 5 % of rated torque (`CLEAR`) where the docstring says nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos

import numpy as np

from tests import Array
from tests.plants.arms.rated import dry_level, rated_torque
from tests.plants.friction.heat import Heat, WarmingFriction
from tests.plants.friction.laws import Bristles, Curve, Extra, MeshLoss, Stribeck
from tests.plants.mechanics.hidden import Run, TorqueSource
from tests.plants.simulate import Plant

CLEAR = 0.05  # share of rated torque at size 1
USUAL_SPEED = 0.3  # share of the top speed at which the gears warm up
WARMING = 20.0  # K, after hours of usual work
WARMING_TIME = 300.0  # s


def clear(plant: Plant, joint: int, size: float) -> float:
    """Return `size` times 5 % of the joint's rated torque, N m."""
    return CLEAR * size * float(rated_torque(plant)[joint])


def top_speed(plant: Plant, joint: int) -> float:
    """Velocity limit, rad/s."""
    return float(plant.velocity_limits[joint])


def _add(plant: Plant, joint: int, curve: Curve) -> Plant:
    return replace(plant, friction=Extra(plant.friction, joint, curve))


def stribeck(plant: Plant, joint: int, size: float) -> Plant:
    """Stribeck hump; its speed is 6 % of the top speed."""
    speed = 0.06 * top_speed(plant, joint)
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


def _power(plant: Plant, joint: int, torque: float, share: float, exponent: float) -> Plant:
    """Viscous friction factor |v|^exponent sign(v), of so much torque at a share of the top speed.

    Below an exponent of 1 it counts as dry, so that it is not stiff at rest.
    """
    factor = torque / (share * top_speed(plant, joint)) ** exponent

    def curve(q: float, v: float, load: float) -> tuple[float, float, float]:
        size = factor * abs(v) ** exponent
        if exponent < 1.0:
            return size, size, 0.0
        return 0.0, 0.0, size if v > 0 else -size

    return _add(plant, joint, curve)


def quadratic_drag(plant: Plant, joint: int, size: float) -> Plant:
    """c v |v|; clear at 80 % of the top speed."""
    return _power(plant, joint, clear(plant, joint, size), 0.8, 2.0)


def cubic_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c v^3; clear at 80 % of the top speed."""
    return _power(plant, joint, clear(plant, joint, size), 0.8, 3.0)


def root_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c |v|^0.5 sign(v); clear at 40 % of the top speed."""
    return _power(plant, joint, clear(plant, joint, size), 0.4, 0.5)


def presliding(plant: Plant, joint: int, size: float) -> Plant:
    """Bristles (LuGre) that slip after 20 mrad times size at the joint."""
    stiffness = dry_level(plant, joint) / (0.020 * size)
    inertia = float(plant.arm.reflected[joint])
    return replace(
        plant,
        friction=Bristles(plant.friction, joint, stiffness, 0.3 * np.sqrt(stiffness * inertia)),
    )


def level_wave(plant: Plant, joint: int, size: float) -> Plant:
    """Coulomb level that varies as cos(3 q), by at most 80 % of it."""
    more = min(clear(plant, joint, size), 0.8 * dry_level(plant, joint))

    def curve(q: float, v: float, load: float) -> tuple[float, float, float]:
        level = more * cos(3.0 * q)
        return level, level, 0.0

    return _add(plant, joint, curve)


def thermal(plant: Plant, joint: int, size: float) -> Plant:
    """Warm gears turn more easily: 20 K take a clear torque off the viscous one at top speed.

    At most 60 % of it; all joints' temperatures are logged.
    """
    dq = USUAL_SPEED * plant.velocity_limits
    dry = plant.friction.begin()(0.0, plant.position_limits.mean(axis=1), dq, np.zeros_like(dq))
    usual = (dry.forward + dry.smooth) * dq
    loss = usual / WARMING
    heat = Heat(capacity=WARMING_TIME * loss, loss=loss, usual=usual)
    zero = np.zeros(plant.arm.n)
    law = plant.friction.begin()
    viscous = law(0.0, plant.position_limits.mean(axis=1), plant.velocity_limits, zero).smooth
    share = min(clear(plant, joint, size) / float(viscous[joint]), 0.6)
    thinning = zero.copy()
    thinning[joint] = -np.log1p(-share) / WARMING
    return replace(plant, friction=WarmingFriction(plant.friction, heat, thinning, zero), heat=heat)


def middle_and_half(plant: Plant, joint: int) -> tuple[float, float]:
    """Middle of a joint's range and half of its width, rad."""
    low, high = plant.position_limits[joint]
    return float(0.5 * (low + high)), float(0.5 * (high - low))


def on_joint(plant: Plant, joint: int, law: Callable[[Array, Array], float]) -> Plant:
    """Add a torque law(q, dq) N m on one joint, both (n,)."""

    def source(t: float, q: Array, dq: Array) -> Array:
        out = np.zeros_like(q)
        out[joint] = law(q, dq)
        return out

    return plant.hiding(torques=lambda run: source)


@dataclass(frozen=True)
class LinearSpring:
    """-stiffness (q - rest) on one joint; N m/rad, rad."""

    joint: int
    stiffness: float
    rest: float

    def __call__(self, run: Run) -> TorqueSource:
        def source(t: float, q: Array, dq: Array) -> Array:
            out = np.zeros_like(q)
            out[self.joint] = -self.stiffness * (q[self.joint] - self.rest)
            return out

        return source


def spring(plant: Plant, joint: int, size: float) -> Plant:
    """Linear spring; clear at 60 % of the way from its rest, near the middle, to the end."""
    middle, half = middle_and_half(plant, joint)
    stiffness = clear(plant, joint, size) / (0.6 * half)
    return plant.hiding(torques=LinearSpring(joint, stiffness, middle + 0.1 * half))


def counterbalance(
    plant: Plant, joint: int, size: float, *, arm: float = 0.3, slack: float = 0.5
) -> Plant:
    """Coil spring between a point of either link, always in tension; at most four times clear.

    Distances are in that of the point on the base from the axis: `arm` that of the other, `slack`
    the spring's length without tension. Its torque is minus the slope of its energy.
    """
    middle, half = middle_and_half(plant, joint)
    zero = middle - 0.5

    def torque(q: float, stiffness: float) -> float:
        angle = q - zero
        length = float(np.sqrt(1.0 + arm**2 - 2.0 * arm * np.cos(angle)))
        pull = stiffness * max(length - slack, 0.0)
        return -pull * arm * float(np.sin(angle)) / length

    most = max(abs(torque(q, 1.0)) for q in np.linspace(middle - half, middle + half, 200))
    stiffness = 4.0 * clear(plant, joint, size) / most
    return on_joint(plant, joint, lambda q, dq: torque(float(q[joint]), stiffness))
