"""`robot.toml` to a checked Robot. Imports numpy and Pinocchio only once the text is in order."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError
from .toml_read import ReadRobotFile, read_robot_file
from .urdf_text import UrdfText, check_names, read_urdf_text

if TYPE_CHECKING:
    from .toml_schema import EffectEntry, ImuEntry, JointEntry
    from .types import Array, Chain, Imu, Joint, OwnEffect, Robot


def load_robot(path: Path) -> Robot:
    """Read a robot file, and the URDF that it names, and check both.

    Parameters
    ----------
    path : Path
        The `robot.toml`; a relative `urdf` in it lies beside it.

    Returns
    -------
    Robot
        `sha256` is over the bytes of the robot file followed by those of the URDF.

    Raises
    ------
    ConfigError
        Naming the file, the key's full path, the value and the remedy.
    """
    read = read_robot_file(path)
    urdf = _urdf_of(read)
    return _robot(read, urdf)


def _urdf_of(read: ReadRobotFile) -> UrdfText | None:
    if read.content.urdf is None:
        return None
    urdf = read_urdf_text(read.path.parent / read.content.urdf)
    check_names(urdf, tuple(joint.name for joint in read.content.joint), read.path)
    return urdf


def _robot(read: ReadRobotFile, urdf: UrdfText | None) -> Robot:
    import msgspec
    import numpy as np

    from .types import Channels, Robot

    content = read.content
    chain, nominal = _chain_of(read, urdf)
    names = [joint.name for joint in content.joint]
    return Robot(
        name=content.name,
        joints=tuple(
            _joint(entry, bool(slides))
            for entry, slides in zip(content.joint, chain.prismatic, strict=True)
        ),
        chain=chain,
        gravity=np.array(content.gravity, dtype=float),
        sha256=hashlib.sha256(read.raw + (urdf.raw if urdf else b"")).hexdigest(),
        source=read.path,
        imus=tuple(_imu(entry, names) for entry in content.imu),
        channels=Channels(**msgspec.structs.asdict(content.channels)),
        nominal=nominal,
        effects=tuple(_effect(entry, names) for entry in content.effect),
    )


def _chain_of(read: ReadRobotFile, urdf: UrdfText | None) -> tuple[Chain, Array | None]:
    if urdf is None:
        return _chain_of_dh(read.content.joint), None
    from .urdf import chain_from_urdf

    names = tuple(joint.name for joint in read.content.joint)
    found = chain_from_urdf(urdf, names, read.path)
    for k, joint in enumerate(read.content.joint):
        if joint.prismatic and not found.chain.prismatic[k]:
            raise ConfigError(
                f"joint[{k}].prismatic (joint {joint.name!r}) is true, but {urdf.path.name} has a "
                f"{urdf.types[joint.name]} joint",
                where=str(read.path),
                hint="Leave prismatic out: with a URDF it is the URDF that says so.",
            )
    return found.chain, found.nominal


def _chain_of_dh(joints: tuple[JointEntry, ...]) -> Chain:
    from .dh import DhRow, chain_from_dh

    return chain_from_dh(
        [
            DhRow(joint.dh.alpha, joint.dh.a, joint.dh.d, joint.dh.theta0, joint.prismatic)
            for joint in joints
            if joint.dh is not None
        ]
    )


def _joint(entry: JointEntry, prismatic: bool) -> Joint:
    from .types import Joint

    return Joint(
        name=entry.name,
        prismatic=prismatic,
        torque_constant=entry.torque_constant,
        torque_constant_error=entry.torque_constant_error,
        gear_ratio=entry.gear_ratio,
        rotor_inertia=entry.rotor_inertia,
        encoder_resolution=entry.encoder_resolution,
        position_limits=entry.position_limits,
        velocity_limit=entry.velocity_limit,
    )


def _effect(entry: EffectEntry, joints: list[str]) -> OwnEffect:
    from .formula import parse_formula
    from .types import OwnEffect

    text = entry.torque
    return OwnEffect(
        name=entry.name,
        joint=None if entry.joint is None else joints.index(entry.joint),
        formula=None if text is None else parse_formula(text, len(joints), entry.settings),
        settings=entry.settings,
    )


def _imu(entry: ImuEntry, joints: list[str]) -> Imu:
    import numpy as np

    from .types import Imu

    if entry.accelerometers:
        positions = np.array([sensor.position for sensor in entry.accelerometers], dtype=float)
        axes = np.array([sensor.axis for sensor in entry.accelerometers], dtype=float)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    else:
        positions, axes = np.zeros((3, 3)), np.eye(3)
    return Imu(
        name=entry.name,
        after_joint=joints.index(entry.after_joint),
        positions=positions,
        axes=axes,
        gyro=entry.gyro,
    )
