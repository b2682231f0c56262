"""`robot.toml` to a checked Robot.

Imports numpy and Pinocchio only once the text is in order.
"""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import astuple

from seqid_cli.errors import ConfigError
from seqid_cli.robot.toml import read_robot_file
from seqid_cli.robot.urdf import check_joints, left_out, parse_urdf

if TYPE_CHECKING:
    from collections.abc import Mapping

    from seqid_cli.robot.toml_schema import ImuEntry
    from seqid_cli.robot.types import Imu, Robot


def load_robot(path: Path, positions: "Mapping[str, float] | None" = None) -> "Robot":
    """Read the robot file `path`, and the URDF beside it that it names, and check both.

    Joints of the URDF that it leaves out are locked at `positions` [rad, m], else at
    zero. The robot's `sha256` is over the bytes of the one and then the other. Raises
    ConfigError naming the file, the key's full path, the value and the remedy.
    """
    content, formulas, raw, urdf_raw = read_robot_file(path)
    names = tuple(joint.name for joint in content.joint)
    urdf = None
    if content.urdf is not None and urdf_raw is not None:
        urdf = parse_urdf(urdf_raw, path.parent / content.urdf)
        check_joints(urdf, content.joint, path)
    import numpy as np

    from seqid_cli.robot.types import Joint, LockedJoint, OwnEffect, Robot

    if urdf is None:
        from seqid_cli.robot.kinematics import chain_from_dh

        rows = [astuple(joint.dh) for joint in content.joint if joint.dh]
        sliding = [k for k, joint in enumerate(content.joint) if joint.prismatic]
        chain, nominal = chain_from_dh(rows, sliding), None
    else:
        from seqid_cli.robot.urdf_model import chain_from_urdf

        chain, nominal = chain_from_urdf(urdf, names, path, positions)
    if content.channels.effort == "gravity_compensated" and nominal is None:
        unknown = "the gravity that the driver subtracts is not known"
        message = f"channels.effort is 'gravity_compensated', but {unknown}"
        hint = (
            "Name a urdf with <inertial> that the driver uses, or log the torque as"
            " it is."
        )
        raise ConfigError(message, where=str(path), hint=hint)
    known = urdf.joints if urdf else {}
    joints = []
    for entry, slides in zip(content.joint, chain.prismatic, strict=True):
        given = {
            key: getattr(entry, key) for key in entry.__struct_fields__ if key != "dh"
        }
        joints.append(
            Joint(**{**given, "prismatic": bool(slides)}, urdf=known.get(entry.name))
        )
    locked = [
        LockedJoint(Joint(x.name, prismatic=x.kind == "prismatic", urdf=x), place)
        for x, place in (left_out(urdf, names) if urdf else ())
    ]
    effects = [
        OwnEffect(
            x.name,
            None if x.joint is None else names.index(x.joint),
            formula,
            x.settings,
        )
        for x, formula in zip(content.effect, formulas, strict=True)
    ]
    return Robot(
        name=content.name,
        joints=tuple(joints),
        chain=chain,
        gravity=np.array(content.gravity, dtype=float),
        sha256=hashlib.sha256(raw + (urdf_raw or b"")).hexdigest(),
        source=path,
        imus=tuple(_imu(entry, names) for entry in content.imu),
        channels=content.channels,
        nominal=nominal,
        urdf=urdf.path if urdf else None,
        effects=tuple(effects),
        gravity_error=content.gravity_error,
        geometry_error_m=content.geometry_error.position,
        geometry_error_rad=content.geometry_error.angle,
        locked=tuple(locked),
    )


def _imu(entry: "ImuEntry", joints: tuple[str, ...]) -> "Imu":
    import numpy as np

    from seqid_cli.robot.types import Imu

    positions, axes = np.zeros((3, 3)), np.eye(3)
    if entry.accelerometers:
        positions = np.array(
            [sensor.position for sensor in entry.accelerometers], dtype=float
        )
        axes = np.array([sensor.axis for sensor in entry.accelerometers], dtype=float)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return Imu(entry.name, joints.index(entry.after_joint), positions, axes, entry.gyro)
