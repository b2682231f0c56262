"""What a log's joint channels mean: units, torque without gravity, voltage of a servo.

A servo that logs its voltage u [V], or a duty cycle of its supply, has the current

    i = (u - k_e w) / R,

with the motor's speed w = gear_ratio dq [rad/s], k_e = torque_constant in SI units
[V s/rad = N m/A] and the winding resistance R [ohm].
"""

import numpy as np

from seqid_cli.logs.raw import Array, Stamps
from seqid_cli.robot.types import Robot

DEGREE = np.pi / 180.0  # rad
TURN = 2.0 * np.pi  # rad
_POSITIONS = ("position", "link_position", "command")


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
    converted = in_units(channels, robot)
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


def unit_of_positions(robot: Robot) -> Array:
    """Return what one unit of the log's positions is (n,) rad or m, by the robot file.

    The file is checked to have what a unit rests on.
    """
    unit = robot.channels.unit
    if unit == "percent":
        return percent_of_range(robot)
    if unit == "count":
        return _drive_constants(robot, "encoder_resolution")
    length = 1e-3 if robot.channels.length_unit == "mm" else 1.0
    angle = {"deg": DEGREE, "turn": TURN}.get(unit, 1.0)
    return np.array([length if joint.prismatic else angle for joint in robot.joints])


def percent_of_range(robot: Robot) -> Array:
    """Return a percent of half the range of each joint (n,) rad, m; NaN without limits.

    Such a unit counts from -100 to 100 over the range that was calibrated.
    """
    limits = [joint.position_limits or (np.nan, np.nan) for joint in robot.joints]
    return np.array([0.005 * (high - low) for low, high in limits])


def _middle_of_range(robot: Robot) -> Array:
    """Return the middle of each joint's range (n,) rad, m; NaN without limits."""
    limits = [joint.position_limits or (np.nan, np.nan) for joint in robot.joints]
    return np.array([0.5 * (low + high) for low, high in limits])


def in_units(channels: dict[str, Array], robot: Robot) -> dict[str, Array]:
    """Turn positions and velocities, measured or commanded, into rad (m) and rad/s."""
    converted = dict(channels)
    factor = unit_of_positions(robot)
    if (factor != 1.0).any():
        for quantity in (*_POSITIONS, "velocity", "command_velocity"):
            if quantity in converted:
                converted[quantity] = converted[quantity] * factor
    if robot.channels.unit == "percent":
        middle = _middle_of_range(robot)
        for quantity in _POSITIONS:
            if quantity in converted:
                converted[quantity] = converted[quantity] + middle
    return converted


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
