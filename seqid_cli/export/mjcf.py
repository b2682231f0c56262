"""MJCF: the arm as MuJoCo simulates it, with rotor inertia as armature.

Bodies are nested like the chain, in the joints' own frames; links behind joints that
were not identified are part of the body that carries them, locked at zero. A spring is
the joint's stiffness (where it is not linear, several numbers, which needs MuJoCo 4),
backlash a joint of its own between two stiff stops. Capsules along the links show the
arm, without mass or contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.export.model import ExportModel
from seqid_cli.export.targets import position_gains
from seqid_cli.export.text import real, rendered
from seqid_cli.export.text import remarks as text_remarks
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.params.results.export import ExportedFriction
from seqid_cli.robot.types import Joint
from seqid_cli.typing import Array

# Rows and columns of an inertia's entries in the order of MuJoCo's `fullinertia`.
_FULL = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])


def mjcf(model: ExportModel) -> str:
    """Return the arm as an MJCF document whose actuators take torques."""
    motor = '<motor name="NAME_motor" joint="NAME" />'
    return document(model, [motor] * model.robot.n)


def mjcf_with_positions(model: ExportModel) -> str:
    """Return the arm with actuators that take positions.

    They are as stiff as `position_gains` says.
    """
    gains = position_gains(model)
    actuators = [
        f'<position name="NAME_position" joint="NAME" kp="{real(kp)}"'
        f' kv="{real(kv)}" />'
        for kp, kv in zip(gains.stiffness, gains.damping, strict=True)
    ]
    return document(model, actuators)


def mjcf_with_dc_motors(model: ExportModel) -> str:
    """Return the arm with DC motors that take a voltage.

    Their constants are the drive data of the robot file.

    Raises
    ------
    ConfigError
        The robot file does not give torque constant, gear ratio and winding resistance
        of every joint, or the MuJoCo that is installed knows no `dcmotor`.
    """
    motors = [_dc_motor(joint, model) for joint in model.robot.joints]
    text = document(model, motors)
    try:
        import mujoco
    except ImportError:
        return text

    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        message = f"MuJoCo {mujoco.__version__} does not take DC motors: {error}"
        raise ConfigError(
            message.splitlines()[0],
            hint="Install MuJoCo 3.6 or later, or export to --target mujoco.",
        ) from error
    return text


def _dc_motor(joint: Joint, model: ExportModel) -> str:
    """Return the actuator of a joint; raises ConfigError where its data is missing."""
    constant = joint.torque_constant
    resistance = joint.winding_resistance
    ratio = joint.gear_ratio
    if constant is None or resistance is None or ratio is None:
        raise ConfigError(
            f"joint {joint.name}: a DC motor needs torque_constant, gear_ratio and"
            " winding_resistance",
            where=str(model.robot.source),
            hint="Give them in the robot file, or export to --target mujoco.",
        )

    limits = ""
    supply = joint.supply_voltage
    if supply is not None:
        limits = f' ctrlrange="{real(-supply)} {real(supply)}"'
    return (
        f'<dcmotor name="NAME_dcmotor" joint="NAME" gear="{real(ratio)}"'
        f' motorconst="{real(constant)}" resistance="{real(resistance)}"{limits} />'
    )


def document(
    model: ExportModel,
    actuators: Sequence[str],
    *,
    armature: Array | None = None,
    friction: Sequence[ExportedFriction | None] | None = None,
    lifted: Sequence[float] = (),
    remarks: Sequence[str] = (),
    hard_friction: bool = False,
    share: float = 0.01,
    min_length: float = 1e-3,
    thickness: float = 0.1,
) -> str:
    """Return the arm as an MJCF document.

    Parameters
    ----------
    model : ExportModel
        The arm.
    actuators : sequence of str
        An element for each joint; NAME in it is that of the joint.
    armature : (n,) array, optional
        kg m^2, in place of the model's.
    friction : sequence of ExportedFriction or None, optional
        Likewise.
    lifted : sequence of float
        Share of the gravity of each body that its controllers compensate.
    remarks : sequence of str
        Beside those of the model.
    hard_friction : bool
        Whether friction is to be as hard as steps of 2 ms allow.
    share : float
        Share of the motor's armature that a link gets which plays; only relative
        acceleration feels it.
    min_length : float
        Length from which on a link is drawn, m.
    thickness : float
        Of a drawn link, as a share of its length.
    """
    chain = model.robot.chain
    to_next_joint = np.vstack([chain.position[1 : model.robot.n], np.zeros(3)])
    lengths = np.linalg.norm(to_next_joint, axis=1)
    return rendered(
        "arm.xml.jinja",
        model,
        arm=model.robot,
        chain=chain,
        bodies=[Body.of(phi) for phi in model.bodies],
        full=_FULL,
        reach=to_next_joint,
        thick=np.where(lengths > min_length, thickness * lengths, 0.0),
        springs=[_spring(coefficients) for coefficients in model.springs],
        gaps=np.where(model.armature > 0.0, model.gaps, 0.0),
        share=share,
        actuators=actuators,
        lifted=lifted or np.zeros(model.robot.n),
        hard_friction=hard_friction,
        armature=model.armature if armature is None else armature,
        friction=model.friction if friction is None else friction,
        remarks=[*text_remarks(model), *remarks],
    )


@dataclass(frozen=True, kw_only=True)
class _Spring:
    """A spring as MuJoCo takes it.

    Attributes
    ----------
    stiffness : (k,) array
        Torque by powers of the way from where the spring is slack, the first one
        linear: N m/rad, N m/rad^2 ...
    slack : float
        Where the spring is slack, rad.
    """

    stiffness: Array
    slack: float


def _spring(coefficients: Array) -> _Spring | None:
    """Return the spring of a torque by powers (4,) of the position, None for no torque.

    The torque may vanish at several positions: the spring is slack at the real one
    nearest to zero.
    """
    if not coefficients.any():
        return None
    torque = np.polynomial.Polynomial(coefficients)
    roots = torque.trim().roots()
    slack = float(min(roots, key=lambda root: (abs(root.imag), abs(root))).real)

    # The position by how far the spring is stretched.
    position = np.polynomial.Polynomial([slack, 1.0])
    torque_by_stretch = torque(position).trim()
    stiffness = np.asarray(torque_by_stretch.coef[1:], dtype=np.float64)
    return _Spring(stiffness=stiffness, slack=slack)
