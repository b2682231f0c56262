"""Errors of the robot file that no log can show: of geometry, gravity and zeros.

Logs of an arm that is a little different from its robot file fit as well as any: the
parameters take the difference. The robot file says how large it may be, one standard
deviation each:

- `gravity_error`: angle [rad] of gravity's direction, about either axis across it,
- `position_zero_error`: of each joint's zero [rad],
- `geometry_error`: position [m] and angle [rad] of each joint's frame in the one
  before.

With T_k the torque that deviation k adds, the parameters of a stage move by

    M_k = (H' W H)^-1 H' W T_k,    stated cov(theta) = cov(theta) + sum_k M_k M_k',

one deviation for all stages. As a torque constant's error does, it cancels in the
torque that the same arm is predicted to have.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.robot.kinematics import turned_by
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True)
class Deviation:
    """An arm that differs from its robot file by one standard deviation of something.

    `shift` (n,) rad is what has to be added to the joints' positions.
    """

    name: str
    robot: Robot
    shift: Array

    def as_robot(self) -> Robot:
        """Return the arm with the shift in its frames, about which joints then move."""
        chain = self.robot.chain
        rotation = chain.rotation.copy()
        position = chain.position.copy()
        for j in np.flatnonzero(self.shift):
            step = self.shift[j] * chain.axis[j]
            if chain.prismatic[j]:
                position[j] += rotation[j] @ step
            else:
                rotation[j] = rotation[j] @ turned_by(step)
        moved = replace(chain, rotation=rotation, position=position)
        return replace(self.robot, chain=moved)


def deviations(robot: Robot) -> list[Deviation]:
    """Return an arm per tolerance of the robot file that is not zero."""
    return [*_of_gravity(robot), *_of_zeros(robot), *_of_geometry(robot)]


def deviation_torques(
    robot: Robot, standard: Array, q: Array, dq: Array, ddq: Array
) -> dict[str, Array]:
    """Return the torque that each deviation adds.

    Parameters
    ----------
    robot : Robot
    standard : (n, 10) array
        Standard parameters of the links.
    q, dq, ddq : (N, n) arrays
        Motion [rad, rad/s, rad/s^2; m where prismatic].

    Returns
    -------
    dict of str to (N, n) array
        By the deviation's name [N m; N where prismatic].
    """
    nominal = inverse_dynamics(robot.chain, robot.gravity, standard, q, dq, ddq)
    torques = {}
    for deviation in deviations(robot):
        torque = inverse_dynamics(
            deviation.robot.chain,
            deviation.robot.gravity,
            standard,
            q + deviation.shift,
            dq,
            ddq,
        )
        torques[deviation.name] = torque - nominal
    return torques


def _of_gravity(robot: Robot) -> Iterator[Deviation]:
    if robot.gravity_error <= 0.0 or not robot.gravity.any():
        return
    down = robot.gravity / np.linalg.norm(robot.gravity)
    across = np.eye(3)[int(np.argmin(np.abs(down)))]
    first = np.cross(down, across)
    first = first / np.linalg.norm(first)
    axes = (first, np.cross(down, first))
    for number, axis in enumerate(axes, start=1):
        turned = turned_by(robot.gravity_error * axis) @ robot.gravity
        tilted = replace(robot, gravity=turned)
        yield Deviation(f"gravity {number}", tilted, np.zeros(robot.n))


def _of_zeros(robot: Robot) -> Iterator[Deviation]:
    for j, joint in enumerate(robot.joints):
        if joint.position_zero_error > 0.0:
            shift = joint.position_zero_error * np.eye(robot.n)[j]
            yield Deviation(f"zero of {joint.name}", robot, shift)


def _of_geometry(robot: Robot) -> Iterator[Deviation]:
    chain = robot.chain
    none = np.zeros(robot.n)
    for j, joint in enumerate(robot.joints):
        for axis, letter in enumerate("xyz"):
            if robot.geometry_error_m > 0.0:
                position = chain.position.copy()
                position[j, axis] += robot.geometry_error_m
                moved = replace(robot, chain=replace(chain, position=position))
                yield Deviation(f"place of {joint.name} along {letter}", moved, none)
            if robot.geometry_error_rad > 0.0:
                turn = turned_by(robot.geometry_error_rad * np.eye(3)[axis])
                rotation = chain.rotation.copy()
                rotation[j] = rotation[j] @ turn
                turned = replace(robot, chain=replace(chain, rotation=rotation))
                yield Deviation(f"turn of {joint.name} about {letter}", turned, none)


def constants_note(robot: Robot) -> list[str]:
    """Say which joints' torque constants are taken as exact, if any."""
    with_constant = [
        joint for joint in robot.joints if joint.torque_constant is not None
    ]
    exact = ", ".join(
        joint.name for joint in with_constant if joint.torque_constant_error == 0.0
    )
    note = (
        f"torque constants taken as exact: {exact}; torque_constant_error in the robot"
        " file adds their error to the standard errors"
    )
    if exact and robot.nominal is None:
        note += (
            "; without a URDF's inertials a current in percent or shares of a rated one"
            " shows in nothing but the size of every parameter"
        )
    return [note] if exact else []
