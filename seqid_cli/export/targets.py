"""Joint parameters in the words of controllers and simulators.

Formats and their sources:

* UR: `ur_msgs/srv/SetFrictionModelParameters` of the ROS 2 driver's friction model
  controller, scales in [0, 1] per joint for direct torque control (docs.ros.org,
  ur_msgs 2.5).
* ros2_control: `joint_trajectory_controller` with gains p, i, d and
  `ff_velocity_scale`, u = k_ff v_d + k_p e + k_i integral of e + k_d (v_d - v)
  (control.ros.org, ros2_controllers).
* USD: `PhysxJointAxisAPI` (docs.omniverse.nvidia.com, Physx Joint Schema) and
  `NewtonJointAPI` (newton-usd-schemas). Angles are in degrees there: a viscous
  coefficient is per degree/s.
* Isaac Lab: `ActuatorBaseCfg` (isaac-sim.github.io/IsaacLab), efforts from Isaac Sim
  5.0 on.
"""

import json

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.export.code import identifier
from seqid_cli.export.fitting import surface_grid
from seqid_cli.export.model import ExportModel
from seqid_cli.export.observer import largest_mass
from seqid_cli.export.text import joint_remarks, rendered
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.export import ExportedFriction
from seqid_cli.typing import Array, Mask

# Hz, of the closed position loop: a tenth of what usual arms resonate at. A start to
# tune from.
BANDWIDTH_HZ = 2.0
DAMPING_RATIO = 1.0  # no overshoot towards a goal
# Share of the identified positions and speeds at which a compensation must not exceed
# friction.
_COVERED = 0.95
# Significant digits: those of an identified number, and as many again for the reader's
# sums.
_DIGITS = 6


def ur_friction(model: ExportModel) -> str:
    """Return a request of the service that sets a UR's friction model.

    A scale is the largest with which the compensation exceeds the identified friction
    nowhere but in a twentieth of the identified positions and speeds, either way. That
    takes the robot's own friction at a scale of 1 for the Coulomb and viscous friction
    identified here, since its numbers are not published.
    """
    if model.robot.n != 6:
        message = f"a UR has six joints, {model.robot.name!r} has {model.robot.n}"
        hint = "Choose another target."
        raise ConfigError(message, where=str(model.robot.source), hint=hint)
    pairs = [
        (0.0, 0.0) if fit is None or surface is None else safe_scales(fit, surface)
        for fit, surface in zip(model.friction, model.surfaces, strict=True)
    ]
    request = {
        "parameters": {
            "viscous_scale": [round(viscous, 3) for _, viscous in pairs],
            "coulomb_scale": [round(coulomb, 3) for coulomb, _ in pairs],
        }
    }
    return json.dumps(request, indent=2) + "\n"


def safe_scales(fit: ExportedFriction, surface: FrictionSurface) -> tuple[float, float]:
    """Return the largest scales of Coulomb and viscous friction that do not overcompensate."""
    q, v = surface_grid(surface)
    speed = np.abs(v)
    against = surface.torque(q, v) * np.sign(v)
    held = fit.coulomb + fit.viscous * speed
    if not held.any():
        return 0.0, 0.0
    share = against / np.maximum(held, np.finfo(float).tiny)
    slow = fit.viscous * speed <= fit.coulomb
    return _covered(share, slow), _covered(share, ~slow)


def _covered(share: Array, where: Mask) -> float:
    """Return the share that is reached at most of the chosen places, between 0 and 1."""
    chosen = share[where] if where.any() else share
    return float(np.clip(np.quantile(chosen, 1.0 - _COVERED), 0.0, 1.0))


def position_gains(model: ExportModel) -> tuple[Array, Array]:
    """Return gains (n,) N m/rad and (n,) N m s/rad of a position loop of `BANDWIDTH_HZ`.

    They are those for the largest inertia that a joint feels over all postures.
    """
    inertia = np.diag(largest_mass(model.robot, model.bodies, model.armature))
    omega = 2.0 * np.pi * BANDWIDTH_HZ
    viscous = np.array([0.0 if fit is None else fit.viscous for fit in model.friction])
    damping = 2.0 * DAMPING_RATIO * omega * inertia - viscous
    return np.asarray(omega**2 * inertia), np.maximum(damping, 0.0)


def ros2_control(model: ExportModel) -> str:
    """Return a controller configuration with effort commands, friction fed forward."""
    stiffness, damping = position_gains(model)
    return rendered(
        "controllers.yaml.jinja",
        model,
        remarks=joint_remarks(model),
        stiffness=[_short(value) for value in stiffness],
        damping=[_short(value) for value in damping],
        bandwidth_hz=BANDWIDTH_HZ,
    )


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def static_friction(model: ExportModel, joint: int) -> float:
    """Return the torque [N m] that a joint at rest can hold, at least its Coulomb friction."""
    fit = model.friction[joint]
    coulomb = 0.0 if fit is None else fit.coulomb
    return max(coulomb, float(model.observer.stiction[joint]))


def usd_joints(model: ExportModel) -> str:
    """Return a USD layer of overrides, with PhysX's and Newton's attributes of each joint."""
    radian = 180.0 / np.pi
    joints = []
    for k, joint in enumerate(model.robot.joints):
        fit = model.friction[k]
        # Angular attributes of USD are per degree.
        viscous = 0.0 if fit is None else fit.viscous
        joints.append(
            {
                "name": identifier_of_prim(joint.name),
                "axis": "linear" if joint.prismatic else "angular",
                "armature": float(model.armature[k]),
                "static": static_friction(model, k),
                "dynamic": 0.0 if fit is None else fit.coulomb,
                "viscous": viscous if joint.prismatic else viscous / radian,
            }
        )
    return rendered(
        "joints.usda.jinja",
        model,
        remarks=joint_remarks(model),
        prim=identifier(model.robot.name),
        parts=joints,
    )


def identifier_of_prim(name: str) -> str:
    """Return a joint's name as USD spells prims: letters, digits and underscores."""
    text = "".join(
        letter if letter.isalnum() and letter.isascii() else "_" for letter in name
    )
    return f"_{text}" if text[:1].isdigit() else text


def isaac_lab(model: ExportModel) -> str:
    """Return a Python file with the friction and armature of an actuator configuration."""
    names = model.robot.joint_names
    values = {
        "armature": [float(value) for value in model.armature],
        "friction": [static_friction(model, k) for k in range(model.robot.n)],
        "dynamic_friction": [
            0.0 if fit is None else fit.coulomb for fit in model.friction
        ],
        "viscous_friction": [
            0.0 if fit is None else fit.viscous for fit in model.friction
        ],
    }
    groups = {key: dict(zip(names, row, strict=True)) for key, row in values.items()}
    return rendered(
        "isaac_lab.py.jinja",
        model,
        remarks=joint_remarks(model),
        names=names,
        groups=groups,
    )
