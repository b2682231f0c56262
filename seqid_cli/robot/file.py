"""`robot.toml` to a checked Robot.

Imports numpy and Pinocchio only once the text is in order.
"""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import astuple, replace

from seqid_cli.errors import ConfigError
from seqid_cli.robot.toml import ReadRobotFile, read_robot_file
from seqid_cli.robot.urdf import (
    UrdfJoint,
    UrdfText,
    check_joints,
    followers,
    left_out,
    parse_urdf,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from seqid_cli.robot.toml_schema import ImuEntry, JointEntry, RobotFile
    from seqid_cli.robot.types import (
        Array,
        Chain,
        Imu,
        Joint,
        LockedJoint,
        OwnEffect,
        Robot,
    )


def load_robot(path: Path, positions: "Mapping[str, float] | None" = None) -> "Robot":
    """Read a robot file and the URDF beside it that it names, and check both.

    Parameters
    ----------
    path : Path
        The robot file.
    positions : mapping of str to float, optional
        Where joints of the URDF are locked that the robot file leaves out [rad, m];
        at zero those that are not named.

    Returns
    -------
    Robot
        Its `sha256` is over the bytes of the robot file and then of the URDF.

    Raises
    ------
    ConfigError
        A file is wrong; the message names the file, the key's full path, the value and
        the remedy.
    """
    file = read_robot_file(path)
    content = file.content
    urdf = None
    following: list[UrdfJoint] = []
    if content.urdf is not None and file.urdf_raw is not None:
        urdf = parse_urdf(file.urdf_raw, path.parent / content.urdf)
        following = followers(urdf, [joint.name for joint in content.joint])
        content = _without(content, following, path)
        check_joints(urdf, content.joint, path)
    names = tuple(joint.name for joint in content.joint)

    # The texts are in order: from here on numpy, and Pinocchio where there is a URDF.
    import numpy as np

    from seqid_cli.robot.types import Robot

    if urdf is None:
        chain = _chain_from_dh(content)
        nominal = None
    else:
        from seqid_cli.robot.urdf_model import chain_from_urdf

        chain, nominal = chain_from_urdf(urdf, names, path, positions)
    if content.channels.effort == "gravity_compensated" and nominal is None:
        raise ConfigError(
            "channels.effort is 'gravity_compensated', but the gravity that the driver"
            " subtracts is not known",
            where=str(path),
            hint="Name a urdf with <inertial> that the driver uses, or log the torque"
            " as it is.",
        )
    return Robot(
        name=content.name,
        joints=_joints(content, chain, urdf),
        chain=chain,
        gravity=np.array(content.gravity, dtype=float),
        sha256=hashlib.sha256(file.raw + (file.urdf_raw or b"")).hexdigest(),
        source=path,
        imus=tuple(_imu(entry, names) for entry in content.imu),
        channels=content.channels,
        nominal=nominal,
        urdf=urdf.path if urdf else None,
        effects=_effects(file, names),
        gravity_error=content.gravity_error,
        geometry_error_m=content.geometry_error.position,
        geometry_error_rad=content.geometry_error.angle,
        locked=_locked(urdf, names) if urdf else (),
        followers=tuple(following),
    )


def _without(
    content: "RobotFile", following: list[UrdfJoint], path: Path
) -> "RobotFile":
    """Return a robot file without joints that follow others.

    Raises ConfigError where something else of the file rests on one of them.
    """
    names = {joint.name for joint in following}
    resting = [(imu.name, imu.after_joint) for imu in content.imu]
    resting += [(entry.name, entry.joint) for entry in content.effect if entry.joint]
    for what, joint in resting:
        if joint in names:
            raise ConfigError(
                f"{what!r} is at joint {joint!r}, which follows another joint (mimic)"
                " and is no joint of the arm",
                where=str(path),
                hint="Name the joint that carries it, or remove <mimic> from the URDF.",
            )
    joints = [entry for entry in content.joint if entry.name not in names]
    return replace(content, joint=joints)


def _chain_from_dh(content: "RobotFile") -> "Chain":
    """Build the chain of the joints' DH parameters."""
    from seqid_cli.robot.kinematics import chain_from_dh

    rows = [astuple(joint.dh) for joint in content.joint if joint.dh]
    sliding = [k for k, joint in enumerate(content.joint) if joint.prismatic]
    return chain_from_dh(rows, sliding)


def _joints(
    content: "RobotFile", chain: "Chain", urdf: UrdfText | None
) -> tuple["Joint", ...]:
    """Return the joints of a robot file; which of them slide the chain says."""
    from seqid_cli.robot.types import Joint

    in_urdf = urdf.joints if urdf else {}
    return tuple(
        Joint(
            entry.name,
            prismatic=bool(is_prismatic),
            torque_constant=entry.torque_constant,
            torque_constant_error=entry.torque_constant_error,
            position_zero_error=entry.position_zero_error,
            gear_ratio=entry.gear_ratio,
            rotor_inertia=_rotor_inertia(content, entry),
            winding_resistance=entry.winding_resistance,
            supply_voltage=entry.supply_voltage,
            encoder_resolution=entry.encoder_resolution,
            encoder_side=entry.encoder_side,
            position_limits=entry.position_limits,
            velocity_limit=entry.velocity_limit,
            urdf=in_urdf.get(entry.name),
        )
        for entry, is_prismatic in zip(content.joint, chain.prismatic, strict=True)
    )


def _rotor_inertia(content: "RobotFile", entry: "JointEntry") -> float | None:
    """Return the rotor inertia that the torque of a joint feels; None: not known."""
    # A sensor behind the gear feels what the gear passes on, and that is without rotor.
    if (entry.torque_side or content.torque_side) == "link":
        return 0.0
    return entry.rotor_inertia


def _locked(urdf: UrdfText, names: tuple[str, ...]) -> tuple["LockedJoint", ...]:
    """Return the joints of the URDF that carry the arm and that the file leaves out."""
    from seqid_cli.robot.types import Joint, LockedJoint

    locked = []
    for joint, place in left_out(urdf, names):
        is_prismatic = joint.kind == "prismatic"
        own_joint = Joint(joint.name, prismatic=is_prismatic, urdf=joint)
        locked.append(LockedJoint(own_joint, place))
    return tuple(locked)


def _effects(file: ReadRobotFile, names: tuple[str, ...]) -> tuple["OwnEffect", ...]:
    """Return the effects that the robot file adds, joints by their numbers."""
    from seqid_cli.robot.types import OwnEffect

    return tuple(
        OwnEffect(
            name=entry.name,
            joint=None if entry.joint is None else names.index(entry.joint),
            formula=formula,
            settings=entry.settings,
        )
        for entry, formula in zip(file.content.effect, file.formulas, strict=True)
    )


def _imu(entry: "ImuEntry", joints: tuple[str, ...]) -> "Imu":
    """Return an IMU; without accelerometers of its own it is a triad at its origin."""
    import numpy as np

    from seqid_cli.robot.types import Imu

    positions: Array = np.zeros((3, 3))
    axes: Array = np.eye(3)
    if entry.accelerometers:
        positions = np.array(
            [sensor.position for sensor in entry.accelerometers], dtype=float
        )
        axes = np.array([sensor.axis for sensor in entry.accelerometers], dtype=float)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return Imu(
        name=entry.name,
        after_joint=joints.index(entry.after_joint),
        positions=positions,
        axes=axes,
        gyro=entry.gyro,
    )
