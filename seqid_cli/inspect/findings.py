"""Findings of known codes, and the verdict on a log.

docs/reference/inspect.md says what they mean.
"""

from collections.abc import Iterable, Mapping, Sequence

from msgspec.structs import replace

from seqid_cli.params.results.inspection import InspectionFinding, InspectionVerdict

# Codes with their remedies. Errors: what is identified from the log is wrong; warnings:
# it is worse than it could be, or may be wrong.
ERRORS: Mapping[str, str] = {
    "unreadable": "Copy it again from the source, or leave it out.",
    "channel_missing": (
        "Name it in the robot file as the log does ([channels]), or log it."
    ),
    "joint_left_out": (
        "Add its [[joint]] table to the robot file, or hold it while recording."
    ),
    "drive_data_missing": (
        "Give torque_constant and gear_ratio of the joint in the robot file."
    ),
    "values_absurd": (
        "Look at the driver of the channel; the values were taken as missing."
    ),
    "values_lost": (
        "Log every sample; where the channel is slower, log it at even distances."
    ),
    "time_unit": 'Write time_unit = "ms" (or us, ns) under [channels], or log seconds.',
    "time_scale": (
        "Use the log as it was recorded first; where velocities are in another unit,"
        " convert them, or leave them out."
    ),
    "clock_set_back": "Use --time log, or split the log there.",
    "position_in_degrees": (
        'Write unit = "deg" under [channels] of the robot file, or unit = "percent".'
    ),
    "position_in_mm": 'Write length_unit = "mm" under [channels] of the robot file.',
    "position_in_turns": 'Write unit = "turn" under [channels] of the robot file.',
    "position_in_counts": (
        'Write unit = "count" under [channels], and encoder_resolution at the joints.'
    ),
    "position_in_percent": (
        'Write unit = "percent" under [channels]; position_limits are the range.'
    ),
    "position_scale": (
        "Look up what the driver sends: in percent of the calibrated range, write unit"
        ' = "percent" under [channels] and that range as position_limits.'
    ),
    "position_motor_side": "Log the joint's position, or divide by the gear ratio.",
    "position_spikes": "Look at cable and driver of the encoder; remove these samples.",
    "position_jump": (
        "Look for lost counts or a zero set while recording; split the log there."
    ),
    "position_frozen": "Look for lost packets between drive and logger.",
    "position_stuck": "Look at the encoder and its connection.",
    "velocity_in_degrees": "Convert to rad/s; --motion reads positions anyway.",
    "velocity_sign": "Flip the velocity or the position, whichever is wrong.",
    "joints_swapped": (
        "Correct the order of the joints in the logger or in the robot file."
    ),
    "torque_zero": "Log the measured motor current or torque.",
    "torque_constant_value": "Log the measured motor current or torque.",
    "torque_stuck": "Look at the connection between drive and logger.",
    "torque_echo": (
        "Record the measured current while the controller drives the joints; if it is"
        " measured and the joint hardly rubs, --set echo.max_friction=0 takes it."
    ),
    "effort_unsigned": (
        "Log it with its sign, or log the commands beside it (<joint>.command), which"
        " give the sign."
    ),
    "effort_sign_bit": "Read the channel as a signed integer.",
    "current_in_ma": "Convert to A.",
    "effort_is_current": (
        'Write effort = "current" under [channels], or name it <joint>.current.'
    ),
    "effort_is_torque": (
        'Write effort = "torque" under [channels], or name it <joint>.torque.'
    ),
    "effort_without_gravity": (
        'Write effort = "gravity_compensated": the URDF\'s gravity is added.'
    ),
    "effort_unclear": 'Write effort = "torque" or effort = "current" under [channels].',
    "torque_scale": (
        "Check torque_constant, gear_ratio, unit, and whether gravity is subtracted."
    ),
    "gear_inverse": "Give gear_ratio as motor turns per joint turn.",
    "sign_mismatch": (
        "Flip the sign of the torque (or of gear_ratio), or of the position."
    ),
    "axis_flipped": "Reverse the joint's axis in the URDF, or position and torque.",
    "position_zero": "Add the offset to the positions, or correct the joint's origin.",
    "gravity_direction": (
        "Write it as gravity in the robot file: a wall, a ceiling, or tilted."
    ),
    "imu_no_overlap": "Let both use one clock, or use --time log.",
    "imu_missing_values": "Check cable and driver, or take it out of the robot file.",
    "imu_stuck": "Check the sensor; take the channel out of the robot file.",
    "imu_slow": (
        "Raise its output rate, to that of the joints or 100 Hz, or take it out of the"
        " robot file."
    ),
    "imu_without_gravity": (
        "Record the accelerations as they are measured, gravity in them, not linear"
        " acceleration of the sensor's own fusion."
    ),
    "imu_in_g": "Multiply by 9.80665 (0.00980665).",
    "imu_channel_flipped": "Reverse the channel, or its axis in the robot file.",
    "imu_channels_swapped": (
        "Exchange the two channels, or their entries in the robot file."
    ),
    "imu_left_handed": "Correct the sign or order of the axes.",
    "imu_wrong_link": "Correct after_joint, or exchange the IMUs' names.",
    "gyro_in_degrees": "Convert to rad/s.",
    "sensor_sign": "Flip its sign in the driver or in the log.",
}
WARNINGS: Mapping[str, str] = {
    "salvaged": "Copy it again from the source; `mcap doctor` shows the damage.",
    "joint_stands": (
        "Let it stand there in all logs of the model, or add it to the robot file."
    ),
    "torque_missing": (
        "Record motor current (give the drive data then) or joint torque."
    ),
    "values_missing": "Look for lost packets in the logger; the holes are bridged.",
    "second_publisher": "Let one node publish on the topic, or remap the other.",
    "duplicate_log": "Give one of them only; stages take the first.",
    "reader": "See the message.",
    "rate_low": "Record at 100 Hz or more.",
    "jitter": "Log with the controller's own clock, in the control loop.",
    "channel_hole": "Look for lost packets; the rest of the log is used.",
    "clock_gap": "Look for lost packets or a full disk; the rest of the log is used.",
    "samples_lost": "Log with the controller's clock; the time base is repaired.",
    "stamps_backwards": (
        "Use a monotonic clock; the samples were sorted by their stamps."
    ),
    "stamps_coarse": "Log with a finer clock; the samples are laid evenly.",
    "stamps_repeated": "Look for doubled messages or a clock that is too coarse.",
    "stamps_zero": "Make the driver fill in header.stamp; or use --time log.",
    "stamps_far_off": "Check the clock, or split the log.",
    "time_resolution": "Write time as float64 or as a timestamp column.",
    "header_clock": "Synchronise the clocks (chrony, PTP).",
    "position_wraps": "Log the multi-turn position where the joint can turn that far.",
    "position_limits": (
        "Check the encoder's zero, the unit, the order of joints, and the limits."
    ),
    "channel_held": "Log at the rate of the measurement.",
    "encoder_resolution": (
        "Correct encoder_resolution: rad per count, behind gear and quadrature."
    ),
    "velocity_zero": "Leave it out, or log the measured velocity.",
    "velocity_inconsistent": (
        "Check that both are measured, of one joint and in SI units."
    ),
    "speed_limit": "Check the unit and time of the position, and velocity_limit.",
    "sign_by_command": "Log it with its sign: small ones may be wrong.",
    "torque_spikes": "Look at driver and cable; remove these samples.",
    "torque_quantised": "Log the current with more bits.",
    "torque_saturated": "Use slower moves, or a measuring range that is large enough.",
    "scale_or_mass": (
        "Look up the unit of the torque and torque_constant; if they are right, correct"
        " the URDF's <inertial>."
    ),
    "torque_limit": (
        "Check the unit of the torque, torque_constant and gear_ratio; if they are"
        " right, correct the URDF's effort limit."
    ),
    "effort_limits": (
        "Look up the unit of the torque (A, percent or shares of a rated current),"
        " torque_constant and gear_ratio; if they are right, correct the URDF's effort"
        " limits."
    ),
    "command_echo": "Log what the controller is asked for, not what it reports.",
    "command_not_followed": (
        "Check that both are of one joint, in one unit, and that the drive was on."
    ),
    "zero_or_mass": (
        "Check the encoder's zero; if it is right, correct the URDF's <inertial>."
    ),
    "model_mismatch": (
        "Check that log and robot file are of one robot, its mounting and torque."
    ),
    "imu_layout": "Move accelerometers off the common point or line, or use a gyro.",
    "imu_saturated": "Use a larger range, or slower moves.",
    "imu_alternates": (
        "Let one message hold both, or record a topic for each; both are used."
    ),
    "imu_gravity": "Calibrate the accelerometers; check the axes in the robot file.",
    "imu_channel_wrong": "Check its axis in the robot file, its scale and its offset.",
    "imu_not_moving": (
        "Check that it is mounted where the robot file says, and its clock."
    ),
    "imu_delay": "imu-calib measures up to 0.5 s; beyond, synchronise the clocks.",
    "imu_clock_drift": (
        "imu-calib and --motion fused allow for it; better, stamp both with one clock."
    ),
    "gyro_scale": "Check its range setting.",
    "gyro_bias": "Calibrate its offset at rest.",
    "temperature_in_kelvin": "Subtract 273.15.",
    "temperature_nonsense": (
        "Check the channel; temperature is left out of the model otherwise."
    ),
}

# Warnings that a stage says too: what it identifies may be used, but is not good.
USABLE_AT_MOST = frozenset({"scale_or_mass", "zero_or_mass", "effort_limits"})


def finding_of(
    code: str, message: str, joint: str = "", channel: str = ""
) -> InspectionFinding:
    """Make a finding of a known code, with the severity and remedy that belong to it.

    Parameters
    ----------
    code : str
        A key of `ERRORS` or `WARNINGS`.
    message : str
        What is wrong, with the value and the limit.
    joint : str
        Joint or IMU that it is about, or two joints "a, b"; empty for the whole log.
    channel : str
        Channel that it is about; empty for all.
    """
    severity = "error" if code in ERRORS else "warning"
    remedies = ERRORS if code in ERRORS else WARNINGS
    return InspectionFinding(
        code=code,
        severity=severity,
        log="",
        joint=joint,
        channel=channel,
        message=message,
        remedy=remedies[code],
    )


def located(
    findings: Iterable[InspectionFinding], log: object
) -> tuple[InspectionFinding, ...]:
    """Return findings with the log that they are about."""
    return tuple(replace(finding, log=str(log)) for finding in findings)


def grouped(findings: Iterable[InspectionFinding]) -> list[list[InspectionFinding]]:
    """Group findings by code, joint and channel, in the order of the first of each."""
    groups: dict[tuple[str, str, str], list[InspectionFinding]] = {}
    for finding in findings:
        place = (finding.code, finding.joint, finding.channel)
        groups.setdefault(place, []).append(finding)
    return list(groups.values())


def verdict_of(findings: Sequence[InspectionFinding]) -> InspectionVerdict:
    """Return the verdict on a log: that of its worst finding."""
    if any(finding.code == "unreadable" for finding in findings):
        return "unreadable"
    if any(finding.severity == "error" for finding in findings):
        return "faulty"
    return "usable" if findings else "good"
