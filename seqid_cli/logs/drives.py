"""What a log's joint channels mean: units, torque without gravity, voltage of a servo.

A servo that logs its voltage u [V], or a duty cycle of its supply, has the current

    i = (u - k_e w) / R,

with the motor's speed w = gear_ratio dq [rad/s], k_e = torque_constant in SI units
[V s/rad = N m/A] and the winding resistance R [ohm].
"""

from typing import NamedTuple

import numpy as np

from seqid_cli.logs.raw import Array, Stamps
from seqid_cli.robot.types import Robot


def in_si(channels: dict[str, Array], stamps: Stamps, robot: Robot) -> dict[str, Array]:
    """Turn joint channels into the model's units and quantities.

    Parameters
    ----------
    channels : dict of str to ndarray, (M, n)
        Joint channels by quantity, as the log has them.
    stamps : ndarray of int, (M,)
        Their stamps [ns].
    robot : Robot
        What its `[channels]` say of units and effort; drive data of its joints.

    Returns
    -------
    dict of str to ndarray, (M, n)
        Positions [rad, m], velocities, torque [N m at the joint], current [A on the
        motor side]; `voltage` and `pwm` have become `current`.
    """
    converted = dict(channels)
    scale = _position_scale(robot)
    if (scale.factor != 1.0).any():
        for quantity in ("position", "velocity", "link_position"):
            if quantity in converted:
                converted[quantity] = converted[quantity] * scale.factor
        for quantity in ("position", "link_position"):
            if quantity in converted:
                converted[quantity] = converted[quantity] + scale.middle

    if robot.channels.effort == "gravity_compensated" and "torque" in converted:
        gravity_torque = _gravity_of_driver(converted["position"], robot)
        converted["torque"] = converted["torque"] + gravity_torque

    voltage = converted.pop("voltage", None)
    duty_cycle = converted.pop("pwm", None)
    if voltage is None and duty_cycle is not None:
        voltage = duty_cycle * _drive_constants(robot, "supply_voltage")
    if voltage is not None and "current" not in converted:
        converted["current"] = _current(voltage, converted, stamps, robot)
    return converted


class _Scale(NamedTuple):
    """What positions in a log are times, and where they are counted from."""

    factor: Array  # (n,) rad, m
    middle: Array  # (n,) rad, m


def _position_scale(robot: Robot) -> _Scale:
    """Return the scale of positions as the units of the robot file say."""
    middle = np.zeros(robot.n)
    if robot.channels.unit == "percent":
        # The file is checked to have limits.
        limits = np.array([joint.position_limits for joint in robot.joints], np.float64)
        half_range = 0.5 * (limits[:, 1] - limits[:, 0])
        return _Scale(factor=half_range / 100.0, middle=limits.mean(axis=1))
    angle = np.pi / 180.0 if robot.channels.unit == "deg" else 1.0
    length = 1e-3 if robot.channels.length_unit == "mm" else 1.0
    factor = np.array([length if joint.prismatic else angle for joint in robot.joints])
    return _Scale(factor=factor, middle=middle)


def _gravity_of_driver(q: Array, robot: Robot) -> Array:
    """Return the gravity torque (M, n) that a driver has subtracted.

    It has taken it from the URDF's inertials, right or wrong.
    """
    # Imported late: most logs need no dynamics to be read.
    from seqid_cli.robot.regressor import inverse_dynamics

    assert robot.nominal is not None
    at_rest = np.zeros_like(q)
    return inverse_dynamics(
        robot.chain, robot.gravity, robot.nominal, q, at_rest, at_rest
    )


def _drive_constants(robot: Robot, name: str) -> Array:
    """Return a constant (n,) of the drives, NaN where the robot file has none."""
    return np.array([getattr(joint, name) for joint in robot.joints], np.float64)


def _current(
    voltage: Array, channels: dict[str, Array], stamps: Stamps, robot: Robot
) -> Array:
    """Return the motor current (M, n) [A] by voltage (M, n) [V] and speed."""
    # The logged velocity, where there is one, else the slope of the position.
    dq = np.full_like(channels["position"], np.nan)
    if len(stamps) > 1:
        seconds = (stamps - stamps[0]) * 1e-9
        with np.errstate(invalid="ignore", divide="ignore"):
            dq = np.gradient(channels["position"], seconds, axis=0)
    logged_dq = channels.get("velocity", dq)
    dq = np.where(np.isfinite(logged_dq), logged_dq, dq)

    torque_constant = _drive_constants(robot, "torque_constant")
    gear_ratio = np.nan_to_num(_drive_constants(robot, "gear_ratio"), nan=1.0)
    resistance = _drive_constants(robot, "winding_resistance")
    current = (voltage - torque_constant * gear_ratio * dq) / resistance
    return np.where(np.isfinite(current), current, np.nan)
