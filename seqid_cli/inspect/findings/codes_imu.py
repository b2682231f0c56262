"""Codes about IMUs."""

from __future__ import annotations

from collections.abc import Mapping

from seqid_cli.inspect.findings.code import Code

IMU_CODES: Mapping[str, Code] = {
    "imu_layout": Code(
        "warning",
        "An accelerometer array cannot see the angular acceleration.",
        "Rank of the readings in the unknowns of Eq. 29-30 for this layout.",
        "Move accelerometers off the common point or line, or use a gyro.",
    ),
    "imu_no_overlap": Code(
        "error",
        "The IMU's stamps are not from the joints' clock.",
        "No common time, or less than 90 % of the joints' time covered.",
        "Let both use one clock, or use --time log.",
    ),
    "imu_missing_values": Code(
        "error",
        "A channel of the IMU has no values.",
        "All of them NaN or null.",
        "Check the sensor's cable and driver, or take it out of the robot file.",
    ),
    "imu_stuck": Code(
        "error",
        "An accelerometer or gyro channel stands still.",
        "One value for 0.5 s and 50 samples while the same sensor's other channels change.",
        "Check the sensor; take the channel out of the robot file.",
    ),
    "imu_saturated": Code(
        "warning",
        "An IMU channel is clipped.",
        "As for torque.",
        "Use a larger range, or slower moves.",
    ),
    "imu_in_g": Code(
        "error",
        "Accelerations are in g (or mg), m/s^2 are expected.",
        "The median specific force is 0.8 to 1.2 (800 to 1200).",
        "Multiply by 9.80665 (0.00980665).",
    ),
    "imu_gravity": Code(
        "warning",
        "At rest the IMU does not read gravity.",
        "The norm differs by more than 5 % from that of the robot file.",
        "Calibrate the accelerometers (scale and offset); check the axes in the robot file.",
    ),
    "imu_channel_flipped": Code(
        "error",
        "One accelerometer of an array has the opposite sign.",
        "At rest the others agree on gravity; with this one reversed it agrees too (a tenth of "
        "the squared error).",
        "Reverse the channel, or its axis in the robot file.",
    ),
    "imu_channels_swapped": Code(
        "error",
        "Two accelerometers of an array are exchanged.",
        "As for a flipped one, with the two exchanged.",
        "Exchange the two channels, or their entries in the robot file.",
    ),
    "imu_channel_wrong": Code(
        "warning",
        "One accelerometer of an array disagrees with the others at rest.",
        "Without it a tenth of the squared error is left, and it is off by more than 5 % of "
        "gravity.",
        "Check its axis in the robot file, its scale and its offset.",
    ),
    "imu_left_handed": Code(
        "error",
        "The IMU's axes are no right-handed frame: an axis is flipped, or two are exchanged.",
        "No rotation fits its readings to the link's motion, but a reflection does (a quarter of "
        "the error).",
        "Correct the sign or order of the axes in the driver or in the robot file.",
    ),
    "imu_wrong_link": Code(
        "error",
        "The IMU moves like another link than the robot file says.",
        "Its readings follow the motion of the other link with a quarter of the error.",
        "Correct after_joint, or exchange the IMUs' names.",
    ),
    "imu_not_moving": Code(
        "warning",
        "The IMU does not follow the encoders.",
        "Motion of its link explains less than half of its variance.",
        "Check that it is mounted where the robot file says, and its clock.",
    ),
    "imu_delay": Code(
        "warning",
        "The IMU's time is shifted against the encoders'.",
        "The shift that fits best exceeds 5 ms and two samples, beyond 4 standard errors and what "
        "the encoder's step hides.",
        "Synchronise the clocks, or subtract the delay of the IMU's driver and filter.",
    ),
    "gyro_in_degrees": Code(
        "error",
        "The gyro is in deg/s, rad/s are expected.",
        "57.3 times the link's angular velocity (20 %).",
        "Convert to rad/s.",
    ),
    "gyro_scale": Code(
        "warning",
        "The gyro's scale is off.",
        "More than 15 % from the link's angular velocity.",
        "Check its range setting.",
    ),
    "gyro_bias": Code(
        "warning",
        "The gyro turns at rest.",
        "More than 0.1 rad/s in the mean.",
        "Calibrate its offset at rest.",
    ),
}
