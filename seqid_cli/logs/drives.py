"""What a log's joint channels mean: units, torque without gravity, voltage of a servo.

A servo that logs its voltage u, or a duty cycle of its supply, has the current i = (u -
k_e w) / R, with the motor's speed w = gear_ratio dq and k_e = torque_constant in SI
units.
"""

import numpy as np

from seqid_cli.logs.raw import Array, Stamps
from seqid_cli.robot.types import Robot


def in_si(channels: dict[str, Array], stamps: Stamps, robot: Robot) -> dict[str, Array]:
    """Turn joint channels (M, n) into the model's: rad, N m at the joint, A on the motor side."""
    found = dict(channels)
    angle = np.pi / 180.0 if robot.channels.unit == "deg" else 1.0
    length = 1e-3 if robot.channels.length_unit == "mm" else 1.0
    if angle != 1.0 or length != 1.0:
        factor = np.array(
            [length if joint.prismatic else angle for joint in robot.joints]
        )
        positions = ("position", "velocity", "link_position")
        found |= {name: found[name] * factor for name in positions if name in found}
    if robot.channels.effort == "gravity_compensated" and "torque" in found:
        from seqid_cli.robot.regressor import inverse_dynamics

        # The driver has subtracted gravity as the URDF's inertials give it.
        assert robot.nominal is not None
        q, still = found["position"], np.zeros_like(found["position"])
        weight = inverse_dynamics(
            robot.chain, robot.gravity, robot.nominal, q, still, still
        )
        found["torque"] = found["torque"] + weight
    voltage, duty = found.pop("voltage", None), found.pop("pwm", None)
    if voltage is None and duty is not None:
        voltage = duty * _constants(robot, "supply_voltage")
    if voltage is not None and "current" not in found:
        found["current"] = _current(voltage, found, stamps, robot)
    return found


def _constants(robot: Robot, name: str) -> Array:
    # None: NaN
    return np.array([getattr(joint, name) for joint in robot.joints], np.float64)


def _current(
    voltage: Array, channels: dict[str, Array], stamps: Stamps, robot: Robot
) -> Array:
    dq = np.full_like(channels["position"], np.nan)
    if len(stamps) > 1:
        with np.errstate(invalid="ignore", divide="ignore"):
            dq = np.gradient(channels["position"], (stamps - stamps[0]) * 1e-9, axis=0)
    logged = channels.get("velocity", dq)
    dq = np.where(np.isfinite(logged), logged, dq)
    torque_constant = _constants(robot, "torque_constant")
    ratio = np.nan_to_num(_constants(robot, "gear_ratio"), nan=1.0)
    current = (voltage - torque_constant * ratio * dq) / _constants(
        robot, "winding_resistance"
    )
    return np.where(np.isfinite(current), current, np.nan)
