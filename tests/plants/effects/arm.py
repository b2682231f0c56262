"""Undeclared bodies and torques of the arm, and laws that no catalogue names."""

from dataclasses import replace

import numpy as np

from tests import Array
from tests.plants.arms.rated import reach, strongest, tool_point
from tests.plants.arms.rigs import GRAVITY, standard_parameters
from tests.plants.effects.drive import at
from tests.plants.effects.friction import clear, middle_and_half
from tests.plants.mechanics.rigid import rot_x, rot_z
from tests.plants.mechanics.torques import AccelerationCube, Contact, State
from tests.plants.simulate import Plant


def payload(plant: Plant, joint: int, size: float) -> Plant:
    """Body at the tool point whose weight is a clear torque for the strongest joint."""
    mass = 0.05 * size * strongest(plant) / (GRAVITY * reach(plant))
    body = standard_parameters(mass, tuple(tool_point(plant)), (0.05, 0.05, 0.05), np.eye(3))
    phi = plant.arm.phi.copy()
    phi[-1] += body
    return replace(plant, arm=replace(plant.arm, phi=phi))


def base_tilt(plant: Plant, joint: int, size: float) -> Plant:
    """The base leans by 5 degrees times size about a level axis 60 degrees from its x."""
    turn = rot_z(np.array(np.pi / 3)) @ rot_x(np.deg2rad(5.0) * size) @ rot_z(np.array(-np.pi / 3))
    return replace(plant, arm=replace(plant.arm, gravity=turn @ plant.arm.gravity))


def rotor_inertia(plant: Plant, joint: int, size: float) -> Plant:
    """The rotor is heavier than the robot file says, by 25 % times size."""
    rotors = plant.arm.rotor_inertia * (1.0 + at(plant, joint, 0.25 * size))
    return replace(plant, arm=replace(plant.arm, rotor_inertia=rotors))


def contact(plant: Plant, joint: int, size: float) -> Plant:
    """Pushes of the last link that are 10 % of rated times size for the strongest joint."""
    force = 0.10 * size * strongest(plant) / reach(plant)
    model = Contact(plant.arm, tool_point(plant), force)
    return replace(plant, hidden=plant.hidden.with_torque(model))


def other(plant: Plant, joint: int) -> int:
    """The joint before, or after the first one."""
    return joint - 1 if joint > 0 else 1


def bump(plant: Plant, joint: int, size: float) -> Plant:
    """Torque bump over position, a tenth of the range wide, near the middle of it."""
    middle, half = middle_and_half(plant, joint)
    place, width, torque = middle + 0.15 * half, 0.10 * half, clear(plant, joint, size)

    def law(q: Array, dq: Array) -> float:
        return -torque * float(np.exp(-0.5 * ((q[joint] - place) / width) ** 2))

    return replace(plant, hidden=plant.hidden.with_torque(State(joint, law)))


def other_speed(plant: Plant, joint: int, size: float) -> Plant:
    """Torque sin(4 v_other + 0.6)."""
    torque, source = clear(plant, joint, size), other(plant, joint)

    def law(q: Array, dq: Array) -> float:
        return -torque * float(np.sin(4.0 * dq[source] + 0.6))

    return replace(plant, hidden=plant.hidden.with_torque(State(joint, law)))


def acceleration_cube(plant: Plant, joint: int, size: float) -> Plant:
    """Torque that grows with the cube of the acceleration; clear at 70 % of its limit."""
    top = 0.7 * float(plant.acceleration_limits[joint])
    model = AccelerationCube(joint, clear(plant, joint, size), top)
    return replace(plant, hidden=plant.hidden.with_torque(model))


def two_positions(plant: Plant, joint: int, size: float) -> Plant:
    """Torque sin(3 q_j) cos(2 q_k + 0.5) of this joint and the one before."""
    torque, source = clear(plant, joint, size), other(plant, joint)

    def law(q: Array, dq: Array) -> float:
        return -torque * float(np.sin(3.0 * q[joint]) * np.cos(2.0 * q[source] + 0.5))

    return replace(plant, hidden=plant.hidden.with_torque(State(joint, law)))
