"""Undeclared bodies and torques of the arm, and laws that no catalogue names."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from tests import Array
from tests.plants.arms.rigs import GRAVITY, standard_parameters
from tests.plants.effects.friction import (
    at,
    clear,
    on_joint,
    place_of,
    rated_torque,
    source_on,
)
from tests.plants.mechanics.hidden import Run, TorqueSource
from tests.plants.mechanics.rigid import build_model, rot_x, rot_z
from tests.plants.simulate import Plant


def tool_point(plant: Plant) -> Array:
    """Where the last link is pushed or loaded: twice as far out as its centre of mass,
    (3,) m.
    """
    return np.asarray(2.0 * plant.arm.phi[-1, 1:4] / plant.arm.phi[-1, 0])


def reach(plant: Plant) -> float:
    """Largest lever arm of the tool point about any joint's axis in 400 random
    postures, m.
    """
    rng, model = np.random.default_rng(1), build_model(plant.arm)
    data, last, most = model.createData(), plant.arm.n, 0.0
    for _ in range(400):
        pin.computeJointJacobians(model, data, rng.uniform(*plant.position_limits.T))
        jac = pin.getJointJacobian(model, data, last, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMi[last].rotation @ tool_point(plant)
        moved = jac[:3] + np.cross(jac[3:].T, lever).T
        most = max(most, float(np.linalg.norm(moved, axis=0).max()))
    return most


def payload(plant: Plant, joint: int, size: float) -> Plant:
    """Body at the tool point whose weight is a clear torque for the strongest joint."""
    mass = 0.05 * size * float(rated_torque(plant).max()) / (GRAVITY * reach(plant))
    body = standard_parameters(
        mass, tuple(tool_point(plant)), (0.05, 0.05, 0.05), np.eye(3)
    )
    phi = plant.arm.phi.copy()
    phi[-1] += body
    return replace(plant, arm=replace(plant.arm, phi=phi))


def base_tilt(plant: Plant, joint: int, size: float) -> Plant:
    """The base leans by 5 degrees times size about a level axis 60 degrees from
    its x.
    """
    turn = (
        rot_z(np.array(np.pi / 3))
        @ rot_x(np.deg2rad(5.0) * size)
        @ rot_z(np.array(-np.pi / 3))
    )
    return replace(plant, arm=replace(plant.arm, gravity=turn @ plant.arm.gravity))


def joint_zero(plant: Plant, joint: int, size: float) -> Plant:
    """The link was put back 2 degrees times size ahead of where the encoder has it."""
    dh = plant.arm.dh.copy()
    dh[joint, 3] += np.deg2rad(2.0) * size
    return replace(plant, arm=replace(plant.arm, dh=dh))


def rotor_inertia(plant: Plant, joint: int, size: float) -> Plant:
    """The rotor is heavier than the robot file says, by 25 % times size."""
    rotors = plant.arm.rotor_inertia * (1.0 + at(plant, joint, 0.25 * size))
    return replace(plant, arm=replace(plant.arm, rotor_inertia=rotors))


def contact(plant: Plant, joint: int, size: float) -> Plant:
    """Half-sine pushes of the last link, 10 % of rated times size for the strongest
    joint.
    """
    mean = 0.10 * size * float(rated_torque(plant).max()) / reach(plant)
    arm, point = plant.arm, tool_point(plant)

    def begin(run: Run) -> TorqueSource:
        rng = np.random.default_rng([run.seed, round(1000.0 * run.start), 11])
        count, pushes = int(rng.integers(1, 3)), []
        for part in range(count):
            share = (part + rng.uniform(0.15, 0.75)) / count
            way = rng.standard_normal(3)
            force = mean * rng.uniform(0.8, 1.2) / np.linalg.norm(way)
            first = run.start + share * run.duration
            pushes.append((first, float(rng.uniform(0.2, 0.6)), force * way))
        data = (model := build_model(arm)).createData()

        def source(t: float, q: Array, dq: Array) -> Array:
            for first, length, most in pushes:
                if first < t < first + length:
                    force = most * np.sin(np.pi * ((t - first) / length))
                    pin.computeJointJacobians(model, data, q)
                    jac = pin.getJointJacobian(
                        model, data, arm.n, pin.LOCAL_WORLD_ALIGNED
                    )
                    lever = data.oMi[arm.n].rotation @ point
                    return np.asarray(
                        jac[:3].T @ force + jac[3:].T @ np.cross(lever, force)
                    )
            return np.zeros_like(q)

        return source

    return plant.hiding(torques=begin)


def other(joint: int) -> int:
    """The joint before, or after the first one."""
    return joint - 1 if joint > 0 else 1


def bump(plant: Plant, joint: int, size: float) -> Plant:
    """Torque bump over position, a tenth of the range wide, near the middle of it."""
    (place, half), torque = place_of(plant, joint, 0.15), clear(plant, joint, size)
    return on_joint(
        plant,
        joint,
        lambda q, dq: -torque * np.exp(-0.5 * ((q[joint] - place) / (0.1 * half)) ** 2),
    )


def other_speed(plant: Plant, joint: int, size: float) -> Plant:
    torque, k = clear(plant, joint, size), other(joint)
    return on_joint(plant, joint, lambda q, dq: -torque * np.sin(4.0 * dq[k] + 0.6))


def two_positions(plant: Plant, joint: int, size: float) -> Plant:
    """Torque sin(3 q_j) cos(2 q_k + 0.5) of this joint and the one before."""
    most, j, k = clear(plant, joint, size), joint, other(joint)
    return on_joint(
        plant, j, lambda q, dq: -most * (np.sin(3 * q[j]) * np.cos(2 * q[k] + 0.5))
    )


def acceleration_cube(plant: Plant, joint: int, size: float) -> Plant:
    """Torque over the cube of the acceleration, up to where it is clear: 70 % of its
    limit.
    """
    top, torque = (
        0.7 * float(plant.acceleration_limits[joint]),
        clear(plant, joint, size),
    )

    def begin(run: Run) -> TorqueSource:
        before = np.nan

        def law(q: Array, dq: Array) -> float:
            nonlocal before
            rate = float(dq[joint])
            ddq = 0.0 if np.isnan(before) else (rate - before) / run.dt
            before = rate
            return -torque * min(max(ddq / top, -1.0), 1.0) ** 3

        return source_on(joint, law)

    return plant.hiding(torques=begin)
