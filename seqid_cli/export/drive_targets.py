"""Identified drives in the words of ros2_control, Isaac Lab, USD and Newton.

Formats and their sources:

* ros2_control: `joint_trajectory_controller` with gains p, i, d, `ff_velocity_scale`
  and `u_clamp_max`, limits as the `joint_limits` package has them (control.ros.org).
* Isaac Lab: `DelayedPDActuatorCfg`, delays in physics steps, efforts of friction from
  Isaac Sim 5.0 on (isaac-sim.github.io/IsaacLab).
* USD: `PhysicsDriveAPI` and `PhysxJointAxisAPI`, angles in degrees (openusd.org,
  docs.omniverse.nvidia.com); `NewtonJointAPI` in degrees and `NewtonActuator` with
  `NewtonPDControlAPI`, angles in rad (newton-usd-schemas).

The law tau = kp (c - q) - kd q' + kv c' is each format's own with other names: what
damps the error of the speed is kd, and what of c' is left is fed forward.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from seqid_cli import __version__
from seqid_cli.export.code import identifier
from seqid_cli.export.drives import drive_notes, friction_of
from seqid_cli.export.model import ExportModel
from seqid_cli.export.targets import identifier_of_prim
from seqid_cli.export.text import plain, rendered
from seqid_cli.params.results.drive import DriveFile, DriveParameter, JointDrive
from seqid_cli.units import unit_of

# The physics step [s] of Isaac Lab's examples, in which a USD layer counts delays.
USD_STEP_S = 0.005
PER_DEGREE = np.pi / 180.0
# Parts of a law beside gain, damping and limits that a target has a place for.
HELD: Mapping[str, tuple[str, ...]] = {
    "ros2-control": ("integral", "velocity_feedforward"),
    "isaac-lab": ("velocity_feedforward", "stribeck"),
    "usd": ("integral", "stribeck"),
}


@dataclass(frozen=True, kw_only=True)
class WrittenDrive:
    """What templates say of one joint: N m, rad and s (N, m and s where it slides).

    `per_degree`: by which a gain per rad becomes one per degree; 1 where it slides.
    `delay_low`, `delay_high`: between which the delay lies. `velocity_target`: share of
    the commanded velocity that a controller of the error of the speed has to be given.
    """

    name: str
    prim: str
    axis: str
    per_degree: float
    stiffness: float
    damping: float
    integral: float
    velocity_feedforward: float
    velocity_target: float
    offset: float
    torque_limit: float | None
    velocity_limit: float | None
    delay_low: float
    delay_high: float
    delay_steps: int
    armature: float
    coulomb: float
    static_friction: float
    viscous: float


def written_drives(model: ExportModel, drive: DriveFile) -> list[WrittenDrive]:
    """Return what is written of each joint, in the order of the arm."""
    drives = []
    for j, (joint, friction) in enumerate(
        zip(model.robot.joints, friction_of(model, drive), strict=True)
    ):
        of_joint = drive.joints[joint.name]
        coulomb = 0.0 if friction is None else friction.coulomb
        damping = of_joint.value("derivative")
        feedforward = of_joint.value("velocity_feedforward")
        delay = of_joint.value("command_delay")
        low, high = _delay_interval(of_joint)
        drives.append(
            WrittenDrive(
                name=joint.name,
                prim=identifier_of_prim(joint.name),
                axis="linear" if joint.prismatic else "angular",
                per_degree=1.0 if joint.prismatic else PER_DEGREE,
                stiffness=of_joint.value("proportional"),
                damping=damping,
                integral=of_joint.value("integral"),
                velocity_feedforward=feedforward,
                velocity_target=feedforward / damping if damping else 0.0,
                offset=of_joint.offset,
                torque_limit=of_joint.known("torque_limit"),
                velocity_limit=of_joint.known("velocity_limit"),
                delay_low=low,
                delay_high=high,
                delay_steps=max(0, round(delay / USD_STEP_S)),
                armature=float(model.armature[j]) + of_joint.value("armature"),
                coulomb=coulomb,
                static_friction=coulomb + of_joint.value("stribeck"),
                viscous=0.0 if friction is None else friction.viscous,
            )
        )
    return drives


def _delay_interval(joint: JointDrive) -> tuple[float, float]:
    """Return between which values a joint's delay lies [s], none below zero."""
    value = joint.value("command_delay")
    found: DriveParameter | None = None
    for parameter in joint.parameters:
        if parameter.name == "command_delay":
            found = parameter
    low = value if found is None or found.low is None else found.low
    high = value if found is None or found.high is None else found.high
    return max(low, 0.0), max(high, 0.0)


def _remarks(model: ExportModel, drive: DriveFile, target: str) -> list[str]:
    """Return the lines at the head of a file for a target."""
    name = f"Drives of {model.robot.name!r} identified by seqid {__version__}."
    gains = []
    for joint in model.robot.joints:
        unit = unit_of("N m/rad", joint.prismatic)
        gain = drive.joints[joint.name].value("proportional")
        gains.append(f"{joint.name}: proportional gain {gain:.4g} {unit}")
    return [plain(line) for line in [name, *gains, *notes(drive, target)]]


def notes(drive: DriveFile, target: str) -> list[str]:
    """Return what a simulation has to add to a file for a target."""
    return drive_notes(drive, held=HELD[target], form=f"a file for {target}")


def ros2_control(model: ExportModel, drive: DriveFile) -> str:
    """Return a controller configuration that does what the joints' own ones do."""
    return rendered(
        "drive_controllers.yaml.jinja",
        model,
        remarks=_remarks(model, drive, "ros2-control"),
        joints=written_drives(model, drive),
    )


def isaac_lab(model: ExportModel, drive: DriveFile) -> str:
    """Return a Python file with a delayed PD actuator for each joint."""
    return rendered(
        "drive_isaac_lab.py.jinja",
        model,
        remarks=_remarks(model, drive, "isaac-lab"),
        joints=written_drives(model, drive),
    )


def usd(model: ExportModel, drive: DriveFile) -> str:
    """Return a USD layer of overrides with drives and Newton actuators."""
    return rendered(
        "drive_joints.usda.jinja",
        model,
        remarks=_remarks(model, drive, "usd"),
        prim=identifier(model.robot.name),
        step_s=USD_STEP_S,
        joints=written_drives(model, drive),
    )


# The function that writes drives, by the target's name.
WRITERS: Mapping[str, Callable[[ExportModel, DriveFile], str]] = {
    "ros2-control": ros2_control,
    "isaac-lab": isaac_lab,
    "usd": usd,
}
