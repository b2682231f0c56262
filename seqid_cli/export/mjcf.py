"""MJCF: the arm as MuJoCo simulates it, with rotor inertia as armature.

Bodies are nested like the chain, in the joints' own frames; links behind joints that
were not identified are part of the body that carries them, locked at zero. A spring is
the joint's stiffness (where it is not linear, several numbers, which needs MuJoCo 4),
backlash a joint of its own between two stiff stops. Capsules along the links show the
arm, without mass or contact.
"""

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.export.model import ExportModel
from seqid_cli.export.targets import position_gains
from seqid_cli.export.text import real, rendered
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.robot.types import Joint
from seqid_cli.typing import Array

# entries of an inertia in MuJoCo's order
_FULL = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])


def mjcf(model: ExportModel) -> str:
    """Return the arm as an MJCF document whose actuators take torques."""
    return _document(
        model, ['<motor name="NAME_motor" joint="NAME" />'] * model.robot.n
    )


def mjcf_with_positions(model: ExportModel) -> str:
    """Return the arm with actuators that take positions, as stiff as `position_gains` says."""
    stiffness, damping = position_gains(model)
    lines = [
        f'<position name="NAME_position" joint="NAME" kp="{real(kp)}"'
        f' kv="{real(kv)}" />'
        for kp, kv in zip(stiffness, damping, strict=True)
    ]
    return _document(model, lines)


def mjcf_with_dc_motors(model: ExportModel) -> str:
    """Return the arm with DC motors that take a voltage, by the drive data of the robot file.

    Raises
    ------
    ConfigError
        The robot file does not give torque constant, gear ratio and winding resistance
        of every joint, or the MuJoCo that is installed knows no `dcmotor`.
    """
    lines = [_dc_motor(joint, model) for joint in model.robot.joints]
    text = _document(model, lines)
    try:
        import mujoco
    except ImportError:
        return text
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        message = f"MuJoCo {mujoco.__version__} does not take DC motors: {error}"
        hint = "Install MuJoCo 3.6 or later, or export to --target mujoco."
        raise ConfigError(message.splitlines()[0], hint=hint) from error
    return text


def _dc_motor(joint: Joint, model: ExportModel) -> str:
    constant, resistance = joint.torque_constant, joint.winding_resistance
    ratio = joint.gear_ratio
    if constant is None or resistance is None or ratio is None:
        message = (
            f"joint {joint.name}: a DC motor needs torque_constant, gear_ratio and"
        )
        hint = "Give them in the robot file, or export to --target mujoco."
        where = str(model.robot.source)
        raise ConfigError(f"{message} winding_resistance", where=where, hint=hint)
    supply = joint.supply_voltage
    limits = "" if supply is None else f' ctrlrange="{real(-supply)} {real(supply)}"'
    return (
        f'<dcmotor name="NAME_dcmotor" joint="NAME" gear="{real(ratio)}"'
        f' motorconst="{real(constant)}" resistance="{real(resistance)}"{limits} />'
    )


def _document(
    model: ExportModel,
    actuators: list[str],
    *,
    share: float = 0.01,
    min_length: float = 1e-3,
    thickness: float = 0.1,
) -> str:
    """Return the arm as an MJCF document; NAME in an actuator is that of its joint.

    `share`: of the motor's armature that a link gets which plays; only relative
    acceleration feels it. Links of `min_length` m are drawn, `thickness` of their
    length thick.
    """
    reach = np.vstack([model.robot.chain.position[1 : model.robot.n], np.zeros(3)])
    lengths = np.linalg.norm(reach, axis=1)
    return rendered(
        "arm.xml.jinja",
        model,
        arm=model.robot,
        chain=model.robot.chain,
        bodies=list(map(Body.of, model.bodies)),
        full=_FULL,
        reach=reach,
        thick=np.where(lengths > min_length, thickness * lengths, 0.0),
        springs=list(map(_spring, model.springs)),
        gaps=np.where(model.armature > 0.0, model.gaps, 0.0),
        share=share,
        actuators=actuators,
    )


def _spring(coefficients: Array) -> tuple[Array, float] | None:
    """Stiffness by powers of the way from where a spring is slack, and that position."""
    if not coefficients.any():
        return None
    torque = np.polynomial.Polynomial(coefficients)
    roots = torque.trim().roots()
    slack = float(min(roots, key=lambda root: (abs(root.imag), abs(root))).real)
    moved = torque(np.polynomial.Polynomial([slack, 1.0])).trim()
    return np.asarray(moved.coef[1:], dtype=np.float64), slack
