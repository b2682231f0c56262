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
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.export.code import identifier
from seqid_cli.export.fitting import coarse_grid
from seqid_cli.export.model import ExportModel
from seqid_cli.export.observer import largest_mass
from seqid_cli.export.text import joint_remarks, rendered
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.export import ExportedFriction
from seqid_cli.robot.types import Joint
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
_UR_JOINTS = 6
_SCALE_DECIMALS = 3  # a thousandth of the friction
_DEGREES = 180.0 / np.pi  # per radian


def ur_friction(model: ExportModel) -> str:
    """Return a request of the service that sets a UR's friction model.

    A scale is the largest with which the compensation exceeds the identified friction
    nowhere but in a twentieth of the identified positions and speeds, either way. That
    takes the robot's own friction at a scale of 1 for the Coulomb and viscous friction
    identified here, since its numbers are not published.

    Raises
    ------
    ConfigError
        The robot has not six joints, so it is no UR.
    """
    robot = model.robot
    if robot.n != _UR_JOINTS:
        raise ConfigError(
            f"a UR has six joints, {robot.name!r} has {robot.n}",
            where=str(robot.source),
            hint="Choose another target.",
        )

    coulomb_scales = []
    viscous_scales = []
    for fit, surface in zip(model.friction, model.surfaces, strict=True):
        scales = SafeScales(coulomb=0.0, viscous=0.0)
        if fit is not None and surface is not None:
            scales = safe_scales(fit, surface)
        coulomb_scales.append(round(scales.coulomb, _SCALE_DECIMALS))
        viscous_scales.append(round(scales.viscous, _SCALE_DECIMALS))
    request = {
        "parameters": {
            "viscous_scale": viscous_scales,
            "coulomb_scale": coulomb_scales,
        }
    }
    return json.dumps(request, indent=2) + "\n"


class SafeScales(NamedTuple):
    """Shares of Coulomb and viscous friction, from 0 to 1, that do not push a joint."""

    coulomb: float
    viscous: float


def safe_scales(fit: ExportedFriction, surface: FrictionSurface) -> SafeScales:
    """Return the largest scales of friction that do not overcompensate.

    Parameters
    ----------
    fit : ExportedFriction
        Coulomb and viscous friction that are scaled.
    surface : FrictionSurface
        The joint's friction as it was identified.

    Returns
    -------
    SafeScales
        The first from the speeds at which Coulomb friction is the larger part, the
        second from the others.
    """
    grid = coarse_grid(surface)
    speed = np.abs(grid.v)
    resisting = surface.torque(grid.q, grid.v) * np.sign(grid.v)
    compensation = fit.coulomb + fit.viscous * speed
    if not compensation.any():
        return SafeScales(coulomb=0.0, viscous=0.0)

    share = resisting / np.maximum(compensation, np.finfo(float).tiny)
    is_slow = fit.viscous * speed <= fit.coulomb
    return SafeScales(
        coulomb=_covered(share, is_slow), viscous=_covered(share, ~is_slow)
    )


def _covered(share: Array, where: Mask) -> float:
    """Return the share (M,) that nearly all chosen places exceed, from 0 to 1.

    Where no place is chosen, all of them count.
    """
    chosen = share[where] if where.any() else share
    return float(np.clip(np.quantile(chosen, 1.0 - _COVERED), 0.0, 1.0))


class PositionGains(NamedTuple):
    """Gains (n,) of a position loop: N m/rad and N m s/rad (N/m, N s/m)."""

    stiffness: Array
    damping: Array


def position_gains(model: ExportModel) -> PositionGains:
    """Return the gains of a position loop of `BANDWIDTH_HZ`.

    They are those for the largest inertia that a joint feels over all postures: with a
    smaller one the loop is faster, and damped better.
    """
    mass = largest_mass(model.robot, model.bodies, model.armature)
    inertia = np.diag(mass)
    omega = 2.0 * np.pi * BANDWIDTH_HZ

    # Viscous friction damps already.
    viscous = np.array([_viscous(fit) for fit in model.friction])
    damping = 2.0 * DAMPING_RATIO * omega * inertia - viscous
    return PositionGains(
        stiffness=np.asarray(omega**2 * inertia), damping=np.maximum(damping, 0.0)
    )


def ros2_control(model: ExportModel) -> str:
    """Return a controller configuration with effort commands, friction fed forward."""
    gains = position_gains(model)
    return rendered(
        "controllers.yaml.jinja",
        model,
        remarks=joint_remarks(model),
        stiffness=[_rounded(value) for value in gains.stiffness],
        damping=[_rounded(value) for value in gains.damping],
        bandwidth_hz=BANDWIDTH_HZ,
    )


def _rounded(value: float) -> float:
    """Return a number with as many digits as a reader has use for."""
    return float(f"{value:.{_DIGITS}g}")


def _coulomb(fit: ExportedFriction | None) -> float:
    """Return Coulomb friction [N m], none where it was not identified."""
    return 0.0 if fit is None else fit.coulomb


def _viscous(fit: ExportedFriction | None) -> float:
    """Return viscous friction [N m s/rad], none where it was not identified."""
    return 0.0 if fit is None else fit.viscous


def static_friction(model: ExportModel, joint: int) -> float:
    """Return the torque [N m] that a joint at rest can hold.

    It is at least the Coulomb friction, against which the joint slides.
    """
    stiction = float(model.observer.stiction[joint])
    return max(_coulomb(model.friction[joint]), stiction)


def usd_joints(model: ExportModel) -> str:
    """Return a USD layer of overrides, with attributes of PhysX and Newton."""
    return rendered(
        "joints.usda.jinja",
        model,
        remarks=joint_remarks(model),
        prim=identifier(model.robot.name),
        parts=[
            _usd_joint(model, j, joint) for j, joint in enumerate(model.robot.joints)
        ],
    )


def _usd_joint(model: ExportModel, j: int, joint: Joint) -> dict[str, object]:
    """Return what the template says of one joint."""
    fit = model.friction[j]
    viscous = _viscous(fit)
    if not joint.prismatic:
        viscous /= _DEGREES  # angular attributes of USD are per degree
    return {
        "name": identifier_of_prim(joint.name),
        "axis": "linear" if joint.prismatic else "angular",
        "armature": float(model.armature[j]),
        "static": static_friction(model, j),
        "dynamic": _coulomb(fit),
        "viscous": viscous,
    }


def identifier_of_prim(name: str) -> str:
    """Return a joint's name as USD spells prims: letters, digits and underscores."""
    letters = [
        letter if letter.isalnum() and letter.isascii() else "_" for letter in name
    ]
    text = "".join(letters)
    return f"_{text}" if text[:1].isdigit() else text


def isaac_lab(model: ExportModel) -> str:
    """Return a Python file with friction and armature of an actuator configuration."""
    names = model.robot.joint_names
    values = {
        "armature": [float(value) for value in model.armature],
        "friction": [static_friction(model, j) for j in range(model.robot.n)],
        "dynamic_friction": [_coulomb(fit) for fit in model.friction],
        "viscous_friction": [_viscous(fit) for fit in model.friction],
    }
    groups = {key: dict(zip(names, row, strict=True)) for key, row in values.items()}
    return rendered(
        "isaac_lab.py.jinja",
        model,
        remarks=joint_remarks(model),
        names=names,
        groups=groups,
    )
