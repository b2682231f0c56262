"""Undeclared friction and springs of one joint, sized by the joint's rated torque.

Every function takes (plant, joint, size) and returns the plant that has the effect as well. Size 1
is clear, about 5 % of rated torque (`CLEAR`) where the docstring says nothing else.
"""

from dataclasses import replace

import numpy as np

from tests.plants.arms.rated import dry_level, rated_torque
from tests.plants.friction.heat import Heat, WarmingFriction
from tests.plants.friction.hysteresis import Bristles
from tests.plants.friction.laws import Asymmetry, Curve, Extra, LevelWave, MeshLoss, Power, Stribeck
from tests.plants.mechanics.torques import Counterbalance, LinearSpring
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
    return _add(plant, joint, Asymmetry(more))


def load_dependent(plant: Plant, joint: int, size: float) -> Plant:
    """10 % of the transmitted torque times size: 5 % of rated at half of it."""
    return _add(plant, joint, MeshLoss(0.10 * size, 0.10 * size))


def gear_efficiency(plant: Plant, joint: int, size: float) -> Plant:
    """15 % of the transmitted torque is lost when driving, 3 % when back-driven, times size."""
    return _add(plant, joint, MeshLoss(0.15 * size, 0.03 * size))


def quadratic_drag(plant: Plant, joint: int, size: float) -> Plant:
    """c v |v|; clear at 80 % of the top speed."""
    speed = 0.8 * top_speed(plant, joint)
    return _add(plant, joint, Power(clear(plant, joint, size) / speed**2, 2.0))


def cubic_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c v^3; clear at 80 % of the top speed."""
    speed = 0.8 * top_speed(plant, joint)
    return _add(plant, joint, Power(clear(plant, joint, size) / speed**3, 3.0))


def root_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c |v|^0.5 sign(v); clear at 40 % of the top speed."""
    speed = 0.4 * top_speed(plant, joint)
    return _add(plant, joint, Power(clear(plant, joint, size) / speed**0.5, 0.5))


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
    return _add(plant, joint, LevelWave(more, 3.0, 0.0))


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


def spring(plant: Plant, joint: int, size: float) -> Plant:
    """Linear spring; clear at 60 % of the way from its rest, near the middle, to the end."""
    middle, half = middle_and_half(plant, joint)
    stiffness = clear(plant, joint, size) / (0.6 * half)
    model = LinearSpring(joint, stiffness, middle + 0.1 * half)
    return replace(plant, hidden=plant.hidden.with_torque(model))


def counterbalance(plant: Plant, joint: int, size: float) -> Plant:
    """Coil spring between two points, always in tension; at most four times clear."""
    middle, half = middle_and_half(plant, joint)
    model = Counterbalance(joint, 1.0, 0.3, 0.5, middle - 0.5)
    most = max(abs(model.torque(q)) for q in np.linspace(middle - half, middle + half, 200))
    model = replace(model, stiffness=4.0 * clear(plant, joint, size) / most)
    return replace(plant, hidden=plant.hidden.with_torque(model))
