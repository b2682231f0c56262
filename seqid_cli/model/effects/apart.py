"""Whether the part of a joint's inertia that turns with its motor is known."""

from __future__ import annotations

from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot


def rotor_lacking(robot: Robot, joint: int) -> str:
    """Say what is missing where motor and link move apart, but nobody knows their shares.

    What comes late, or flies free, is the link's inertia; the base parameters of the first joints
    hold it and the rotor's in one.

    Returns
    -------
    str
        Empty where the robot file has the rotor's inertia, or the motions tell it from the link's.
    """
    known = robot.joints[joint].rotor_inertia is not None
    if known or f"Ia_{joint + 1}" in free_basis(robot).names:
        return ""
    return (
        "no motion tells the rotor's inertia from the link's here, and the parameters take the "
        f"link's alone: give rotor_inertia of {robot.joint_names[joint]} in the robot file"
    )
