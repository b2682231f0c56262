"""Undeclared drives, transmissions and instruments, sized by the joint's rated torque.

Every function takes (plant, joint, size) and returns the plant that has the effect as well. Size 1
is clear, about 5 % of rated torque where the docstring says nothing else.
"""

from dataclasses import replace

import numpy as np

from tests import Array
from tests.plants.arms.rated import rated_torque
from tests.plants.effects.friction import clear
from tests.plants.mechanics.drives import (
    EncoderWave,
    Gain,
    Hum,
    Lag,
    Offset,
    Ripple,
    Saturation,
    Skew,
)
from tests.plants.mechanics.hidden import Spring
from tests.plants.mechanics.joints import swung
from tests.plants.mechanics.rigid import Rigid
from tests.plants.simulate import Plant

BEND = 0.020  # rad, of an elastic joint at rated torque and size 1: lowest vibration 5 to 16 Hz
GAP = 0.004  # rad, of a loose joint at size 1
CONTACT_BEND = 0.001  # rad, of a loose joint's teeth at rated torque
DRIFT_TIME = 900.0  # s, after which a drifting sensor is off by a clear torque


def at(plant: Plant, joint: int, value: float) -> Array:
    """Zero everywhere but at one joint, (n,)."""
    out = np.zeros(plant.arm.n)
    out[joint] = value
    return out


def ripple(plant: Plant, joint: int, size: float) -> Plant:
    """Order 2 of the motor (strain wave), independent of torque."""
    gear = float(plant.arm.gear[joint])
    stage = Ripple(joint, 2.0, gear, 0.7, clear(plant, joint, size))
    return replace(plant, hidden=plant.hidden.with_drive(stage))


def elastic(plant: Plant, joint: int, size: float) -> Plant:
    """Joint that bends by 20 mrad times size at rated torque, damping ratio 3 %."""
    return _spring(plant, joint, BEND * size, 0.03)


def backlash(plant: Plant, joint: int, size: float) -> Plant:
    """Gap of 4 mrad times size in all, between teeth that bend by 1 mrad at rated torque."""
    return _spring(plant, joint, CONTACT_BEND, 0.2, GAP * size)


def _spring(plant: Plant, joint: int, bend: float, ratio: float, gap: float = 0.0) -> Plant:
    stiffness = float(rated_torque(plant)[joint]) / bend
    inertia = swung(Rigid(plant.arm), joint, plant.position_limits.mean(axis=1))
    part = Spring(joint, stiffness, float(2.0 * ratio * np.sqrt(stiffness * inertia)), gap)
    return replace(plant, hidden=plant.hidden.with_spring(part))


def coupling(plant: Plant, joint: int, size: float) -> Plant:
    """Drive of this joint also turns with the one before: rate = dq_j + 0.2 size dq_(j-1)."""
    if joint == 0:
        raise ValueError("the first joint has no joint before it to be coupled with")
    a = np.eye(plant.arm.n)
    a[joint, joint - 1] = 0.2 * size
    return replace(plant, hidden=replace(plant.hidden, coupling=a))


def encoder(plant: Plant, joint: int, size: float) -> Plant:
    """Eccentric disc: 5 mrad of the motor's turn times size, once per turn."""
    gear = float(plant.arm.gear[joint])
    wave = EncoderWave(joint, 0.005 * size / gear, gear, 0.4)
    return replace(plant, hidden=plant.hidden.with_encoder(wave))


def gain(plant: Plant, joint: int, size: float) -> Plant:
    """Torque per ampere 8 % times size above the robot file's."""
    return replace(plant, hidden=plant.hidden.with_drive(Gain(at(plant, joint, 0.08 * size))))


def saturation(plant: Plant, joint: int, size: float) -> Plant:
    """8 % times size of the torque is lost at rated current, cubic in the current."""
    stage = Saturation(at(plant, joint, 0.08 * size), rated_torque(plant))
    return replace(plant, hidden=plant.hidden.with_drive(stage))


def lag(plant: Plant, joint: int, size: float) -> Plant:
    """Log holds the command; this motor's torque follows with 4 ms times size."""
    return replace(plant, hidden=plant.hidden.with_drive(Lag(at(plant, joint, 0.004 * size))))


def skew_all(plant: Plant, joint: int, size: float) -> Plant:
    """All currents are logged 4 ms times size late."""
    late = Skew(np.full(plant.arm.n, 0.004 * size))
    return replace(plant, hidden=plant.hidden.with_current(late))


def _amperes(plant: Plant, joint: int, size: float) -> float:
    return clear(plant, joint, size) / float(plant.torque_per_ampere[joint])


def bias(plant: Plant, joint: int, size: float) -> Plant:
    """Offset of the current sensor."""
    error = Offset(at(plant, joint, _amperes(plant, joint, size)), np.zeros(plant.arm.n))
    return replace(plant, hidden=plant.hidden.with_current(error))


def drift(plant: Plant, joint: int, size: float) -> Plant:
    """Offset that grows by a clear torque in 15 minutes since power-on."""
    slope = _amperes(plant, joint, size) / DRIFT_TIME
    error = Offset(np.zeros(plant.arm.n), at(plant, joint, slope))
    return replace(plant, hidden=plant.hidden.with_current(error))


def mains(plant: Plant, joint: int, size: float) -> Plant:
    """Hum of 50 Hz in the current reading, 2 % of rated times size."""
    error = Hum(at(plant, joint, 0.4 * _amperes(plant, joint, size)), 50.0)
    return replace(plant, hidden=plant.hidden.with_current(error))
