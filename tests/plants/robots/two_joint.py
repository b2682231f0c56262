"""The two-joint arm made by hand: its robot file,
and a model with friction and rotors.
"""

from dataclasses import replace

import numpy as np

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import TorqueModel
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.types import Robot
from tests.plants.robots.made import friction_joint
from tests.plants.robots.small import random_inertia, robot_from_chain

SIGN_WIDTH = 0.006  # rad/s
GEAR = (50.0, 30.0)
ROTOR = (1e-4, 5e-5)  # kg m^2, motor side
COULOMB, VISCOUS = (4.0, 1.5), (2.0, 0.8)  # N m, N m s/rad


def two_joint_robot(*, prismatic: bool = False, drives: bool = True) -> Robot:
    """Return a vertical arm, its second joint skew; a slide instead of the second on
    request.
    """
    chain = chain_from_dh([(0.0, 0.0, 0.0, 0.0), (0.4, 0.3, 0.1, 0.0)])
    chain = replace(chain, prismatic=np.array([False, prismatic]))
    robot = robot_from_chain(chain, gravity=np.array([0.0, -9.81, 0.0]))
    if not drives:
        return robot
    alike = {"torque_constant": 0.1, "encoder_resolution": 1e-5}
    limits = {"position_limits": (-3.0, 3.0), "velocity_limit": 3.0}
    joints = tuple(
        replace(joint, gear_ratio=gear, rotor_inertia=rotor, **alike, **limits)
        for joint, gear, rotor in zip(robot.joints, GEAR, ROTOR, strict=True)
    )
    return replace(robot, joints=joints)


def friction_surface(
    coulomb: float,
    viscous: float,
    top: float = 4.0,
    *,
    order: int = 1,
    variance: float = 1.0,
) -> FrictionSurface:
    """Coulomb [N m] and viscous [N m s/rad] friction up to `top` rad/s, of some order
    in speed.
    """
    half = 0.5 * viscous * top
    entries = [coulomb + half, half, *np.zeros(order - 1)]
    own = {"speed_range": [0.0, top], "sign_width": SIGN_WIDTH}
    own |= {"covariance": (variance * np.eye(len(entries))).tolist()}
    return FrictionSurface.from_stage(friction_joint([entries], **own))


def torque_model(robot: Robot, seed: int = 5) -> TorqueModel:
    """Return rigid body with physical links, rotors, Coulomb and viscous friction."""
    rng = np.random.default_rng(seed)
    phi = np.array([random_inertia(rng).toDynamicParameters() for _ in range(robot.n)])
    surfaces = [friction_surface(c, v) for c, v in zip(COULOMB, VISCOUS, strict=True)]
    return TorqueModel(
        robot=robot,
        surfaces=surfaces,
        phi=phi,
        rotor=np.array(ROTOR),
        coupling="diagonal",
    )
