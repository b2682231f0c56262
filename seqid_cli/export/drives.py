"""An arm with the drives that were identified, as MuJoCo simulates it.

The controller of a joint is a position actuator with its gains and the limit of its
torque. What windows of the logs have told beside the model stands at the joint: rotor
as armature, Coulomb friction as frictionloss. Gravity that a controller compensates is
left out of the bodies that it carries.

MuJoCo's friction is soft by default: it stops a joint over 20 ms, which below some
0.05 rad/s is a viscous friction. It is written as hard as steps of 2 ms allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from seqid_cli.errors import ConfigError
from seqid_cli.params.io import check_robot, read_drive
from seqid_cli.params.results.drive import DriveFile, JointDrive
from seqid_cli.params.results.export import ExportedFriction
from seqid_cli.params.schema import Stages
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel
    from seqid_cli.robot.types import Robot

# Of the model that is the URDF's; see `drive.nominal`.
NOMINAL = "nominal"


def drive_of(paths: Sequence[Path]) -> DriveFile | None:
    """Return the drive that is to be exported, None where a file is of another kind."""
    if len(paths) != 1:
        return None
    try:
        return read_drive(paths[0])
    except ConfigError:
        return None


def drive_model(drive: DriveFile, robot_path: Path, where: Path) -> ExportModel:
    """Return the arm of a drive.

    Raises
    ------
    ConfigError
        A joint has no controller, or the drive is of another robot.
    """
    from seqid_cli.export.model import export_model

    robot = load_robot(robot_path)
    check_robot(drive, robot, where=str(where))
    missing = [name for name in robot.joint_names if name not in drive.joints]
    if missing:
        raise ConfigError(
            f"has no controller of joint {', '.join(missing)}",
            where=str(where),
            hint="Its verdicts say why; record what they ask for.",
        )
    return export_model(robot, _without_nominal(drive.stages), (), None)


def _without_nominal(stages: Stages) -> Stages:
    """Return stages without a model that is the URDF's: the URDF stands for it."""
    if stages.inertia is not None and stages.inertia.method == NOMINAL:
        return structs.replace(stages, inertia=None)
    return stages


def actuator(joint: JointDrive) -> str:
    """Return the element of a joint's controller; NAME is that of the joint."""
    from seqid_cli.export.text import real

    kp = real(joint.value("proportional"))
    kv = real(joint.value("derivative"))
    limits = ""
    limit = joint.known("torque_limit")
    if limit is not None:
        limits = f' forcerange="{real(-limit)} {real(limit)}"'
    return f'<position name="NAME_position" joint="NAME" kp="{kp}" kv="{kv}"{limits} />'


def friction_of(
    model: ExportModel, drive: DriveFile
) -> tuple[ExportedFriction | None, ...]:
    """Return friction of each joint: the model's, and what the drive has beside it."""
    frictions: list[ExportedFriction | None] = []
    for own, joint in zip(model.friction, _joints(model.robot, drive), strict=True):
        coulomb = joint.value("coulomb")
        viscous = joint.value("viscous")
        factor = joint.known("friction_factor")
        if own is None:
            frictions.append(
                ExportedFriction(
                    coulomb=coulomb,
                    viscous=viscous,
                    offset=0.0,
                    rms_misfit=0.0,
                    rms=coulomb,
                    speed_range=[],
                )
            )
            continue
        share = 1.0 if factor is None else factor
        frictions.append(
            structs.replace(
                own,
                coulomb=share * own.coulomb + coulomb,
                viscous=share * own.viscous + viscous,
            )
        )
    return tuple(frictions)


def drive_notes(
    drive: DriveFile,
    held: Sequence[str] = ("gravity_compensation",),
    form: str = "a position actuator",
) -> list[str]:
    """Return what a simulation has to add to a form, joint by joint.

    Parameters
    ----------
    drive : DriveFile
    held : sequence of str
        Parts beside gain, damping and limits that the form has a place for.
    form : str
        In words.
    """
    notes = []
    for name, joint in drive.joints.items():
        delay_ms = 1e3 * joint.value("command_delay")
        notes.append(f"{name}: commands take effect {delay_ms:.4g} ms late")
        left_out = [
            part
            for part in (
                "integral",
                "velocity_feedforward",
                "acceleration_feedforward",
                "gravity_compensation",
                "stribeck",
                "load_friction",
                "dead_band",
            )
            if joint.value(part) and part not in held
        ]
        if left_out:
            notes.append(f"{name}: {form} has no place for {', '.join(left_out)}")
    return notes


def mjcf_with_drives(model: ExportModel, drive: DriveFile) -> str:
    """Return the arm with its controllers as an MJCF document."""
    import numpy as np

    from seqid_cli.export.mjcf import document

    joints = _joints(model.robot, drive)
    return document(
        model,
        [actuator(joint) for joint in joints],
        armature=model.armature + np.array([j.value("armature") for j in joints]),
        friction=friction_of(model, drive),
        lifted=[joint.value("gravity_compensation") for joint in joints],
        remarks=drive_notes(drive),
        hard_friction=True,
    )


def _joints(robot: Robot, drive: DriveFile) -> list[JointDrive]:
    return [drive.joints[name] for name in robot.joint_names]
