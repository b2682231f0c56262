"""What a joint's drive is made for, as the measure of an injected effect's size."""

import numpy as np
import pinocchio as pin

from tests import Array
from tests.plants.mechanics.rigid import Rigid, build_model
from tests.plants.simulate import Plant

BUSY = 0.6  # share of the limits of speed and acceleration that busy motion uses at once
STATES = 400


def rated_torque(plant: Plant) -> Array:
    """Largest torque of busy motion in 400 random states, friction included, (n,) N m."""
    rng = np.random.default_rng(0)
    rigid, law = Rigid(plant.arm), plant.friction.begin()
    low, high = plant.position_limits.T
    most = np.zeros(plant.arm.n)
    for _ in range(STATES):
        q = rng.uniform(low, high)
        dq, ddq = rng.uniform(-BUSY, BUSY, (2, plant.arm.n))
        dq, ddq = dq * plant.velocity_limits, ddq * plant.acceleration_limits
        dry = law(0.0, q, dq, np.zeros(plant.arm.n))
        rub = np.where(dq > 0, dry.forward, -dry.backward) + dry.smooth
        most = np.maximum(most, np.abs(rigid.inverse(q, dq, ddq) + rub))
    return most


def dry_level(plant: Plant, joint: int) -> float:
    """Smaller dry level of a joint at a third of its top speed, N m."""
    dq = plant.velocity_limits / 3.0
    dry = plant.friction.begin()(0.0, plant.position_limits.mean(axis=1), dq, np.zeros_like(dq))
    return float(min(dry.forward[joint], dry.backward[joint]))


def tool_point(plant: Plant) -> Array:
    """Where the last link is pushed or loaded: twice as far out as its centre of mass, (3,) m."""
    return np.asarray(2.0 * plant.arm.phi[-1, 1:4] / plant.arm.phi[-1, 0])


def strongest(plant: Plant) -> float:
    """Rated torque of the strongest joint, N m."""
    return float(rated_torque(plant).max())


def reach(plant: Plant) -> float:
    """Largest lever arm of the tool point about any joint's axis in 400 random postures, m."""
    rng = np.random.default_rng(1)
    model = build_model(plant.arm)
    data = model.createData()
    last, point = plant.arm.n, tool_point(plant)
    most = 0.0
    for _ in range(STATES):
        pin.computeJointJacobians(model, data, rng.uniform(*plant.position_limits.T))
        jac = pin.getJointJacobian(model, data, last, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMi[last].rotation @ point
        moved = jac[:3] + np.cross(jac[3:].T, lever).T
        most = max(most, float(np.linalg.norm(moved, axis=0).max()))
    return most
