"""Every code that an inspection can report: its severity, meaning, test and remedy."""

from __future__ import annotations

from collections.abc import Mapping

from seqid_cli.inspect.findings.code import Code
from seqid_cli.inspect.findings.codes_imu import IMU_CODES

CODES: Mapping[str, Code] = {
    # the file and its channels
    "unreadable": Code(
        "error",
        "The file cannot be read as a log.",
        "The reader's own message.",
        "Copy it again from the source, or leave it out.",
    ),
    "salvaged": Code(
        "warning",
        "The file is damaged and only partly read.",
        "The reader counts what it lost.",
        "Copy it again from the source; `mcap doctor` shows the damage.",
    ),
    "channel_missing": Code(
        "error",
        "A channel that the robot file promises is not in the log.",
        "Names of the robot file's joints, IMUs and [channels] against those of the log.",
        "Name it in the robot file as the log does ([channels], joint and IMU names), or log it.",
    ),
    "torque_missing": Code(
        "warning",
        "The log has neither joint torque nor motor current.",
        "None of the joints has a value of either.",
        "Record motor current (and give torque_constant and gear_ratio), or joint torque.",
    ),
    "drive_data_missing": Code(
        "error",
        "The log carries current that cannot be turned into torque.",
        "Current without torque_constant in the robot file.",
        "Give torque_constant and gear_ratio of the joint in the robot file.",
    ),
    "values_missing": Code(
        "warning",
        "Single values of a channel are missing (null or NaN).",
        "More than 1 % of the samples, not at even distances as of a slower channel.",
        "Look for lost packets in the logger; missing samples are bridged by a curve.",
    ),
    "channel_hole": Code(
        "error",
        "A channel has no values for a while, the others go on.",
        "Null or NaN for more than 5 median intervals and 20 ms in which the log has rows.",
        "Look for lost packets between drive and logger; these samples are left out.",
    ),
    "values_absurd": Code(
        "error",
        "A channel holds infinite or absurdly large values.",
        "Beyond 1e9 in SI units.",
        "Look at the driver that writes the channel; the values were taken as missing.",
    ),
    "duplicate_log": Code(
        "warning",
        "Two of the logs have the same content.",
        "Equal SHA-256.",
        "Give one of them only: it would count twice.",
    ),
    "reader": Code(
        "warning",
        "Something else that the reader has to say.",
        "The reader's own message.",
        "See the message.",
    ),
    # time
    "time_unit": Code(
        "error",
        "Time is not in seconds.",
        "Fewer than 5 or more than 50000 samples per second; or the logged velocity differs from "
        "the slope of the position by a power of 1000 at every joint.",
        "Write time in seconds, or as a timestamp column.",
    ),
    "rate_low": Code(
        "warning",
        "The sample rate is too low to see accelerations.",
        "Below 20 Hz.",
        "Record at 100 Hz or more.",
    ),
    "jitter": Code(
        "warning",
        "The sample interval scatters.",
        "Standard deviation of the intervals (gaps apart) above half the median interval.",
        "Log with the controller's own clock, in the control loop.",
    ),
    "clock_gap": Code(
        "warning",
        "Samples are missing for a while.",
        "An interval of more than 5 median ones and more than 20 ms.",
        "Look for lost packets or a full disk; the rest of the log is used.",
    ),
    "samples_lost": Code(
        "warning",
        "Samples are lost that the stamps do not show.",
        "All joints that move step by the motion of one and the same time, longer than 1.5 sample "
        "intervals and 8 standard errors, while their velocities do not change.",
        "Log with the controller's own clock, or give every row the stamp of its measurement. The "
        "time base is repaired and the holes are bridged; every command says so.",
    ),
    "stamps_backwards": Code(
        "warning",
        "Time steps back.",
        "A stamp smaller than the one before.",
        "Use a monotonic clock; the samples were sorted by their stamps.",
    ),
    "stamps_repeated": Code(
        "warning",
        "Samples share a stamp.",
        "Equal stamps that hold values of the same joints.",
        "Look for doubled messages or a clock that is too coarse.",
    ),
    "stamps_zero": Code(
        "warning",
        "Samples carry no time.",
        "Header stamps of zero, or rows without a usable time.",
        "Make the driver fill in header.stamp; or use --time log.",
    ),
    "stamps_far_off": Code(
        "warning",
        "Some stamps are far away from the others.",
        "The stamps span many times what the samples can fill.",
        "Check the clock, or split the log.",
    ),
    "clock_set_back": Code(
        "error",
        "The clock was set back and runs twice over the same time.",
        "A step back, and more samples behind it than fit into the time.",
        "Use --time log, or split the log there.",
    ),
    "time_resolution": Code(
        "warning",
        "The time column cannot resolve the sample interval.",
        "A float32 step above a thousandth of the interval.",
        "Write time as float64 or as a timestamp column.",
    ),
    "header_clock": Code(
        "warning",
        "Header stamps and times of logging are from different clocks.",
        "Header stamps later than the time of logging by more than 5 ms, or earlier by more "
        "than 5 s.",
        "Synchronise the clocks (chrony, PTP); stamps of all topics must be from one clock.",
    ),
    # positions
    "position_in_degrees": Code(
        "error",
        "Positions are in degrees, rad are expected.",
        "Beyond the limits, but within them after conversion; or 57.3 times the integral of the "
        "logged velocity (15 %); or, without either, speeds of moving joints above 20 rad/s.",
        'Write unit = "deg" under [channels] of the robot file, or convert to rad.',
    ),
    "position_in_mm": Code(
        "error",
        "Positions of a sliding joint are in mm, m are expected.",
        "As for degrees, by a factor of 1000.",
        "Convert to m.",
    ),
    "position_motor_side": Code(
        "error",
        "Positions are those of the motor, not of the joint.",
        "Beyond the limits, but within them once divided by the gear ratio (above 3), with a "
        "range that fills at least 2 % of them.",
        "Log the joint's position, or divide by the gear ratio.",
    ),
    "position_limits": Code(
        "warning",
        "Positions exceed the limits of the robot file.",
        "By more than 2 % of their span and 3 encoder steps.",
        "Check the encoder's zero, the unit, the order of the joints, and position_limits.",
    ),
    "position_wraps": Code(
        "error",
        "The position wraps around by whole turns.",
        "It changes by 2 pi (5 %) between two samples.",
        "Unwrap it, or log the multi-turn position.",
    ),
    "position_spikes": Code(
        "error",
        "Single positions are far off.",
        "Two opposite jumps within three samples, each an acceleration above 1000 rad/s^2 and "
        "more than 8 encoder steps.",
        "Look at cable and driver of the encoder; remove these samples.",
    ),
    "position_jump": Code(
        "error",
        "The position jumps for good.",
        "As for spikes, without a way back.",
        "Look for lost counts or a zero that was set while recording; split the log there.",
    ),
    "position_frozen": Code(
        "error",
        "The position stands still and then catches up while the joint moves.",
        "Equal values for at least 5 samples and 10 ms, moving before and after, with a jump at "
        "the end that makes up 0.5 to 2 times the missed travel and at least 8 encoder steps.",
        "Look for lost packets between drive and logger.",
    ),
    "channel_held": Code(
        "warning",
        "A channel is logged faster than it is measured.",
        "Its values repeat in groups of equal size, changing by more than one step.",
        "Log at the rate of the measurement: each value is delayed by up to a group.",
    ),
    "encoder_resolution": Code(
        "warning",
        "The encoder's step is not the one of the robot file.",
        "Positions lie on a lattice of another step (10 %), or on none although they scatter by "
        "much less than the declared step.",
        "Correct encoder_resolution: rad per count at the joint, behind gear and quadrature.",
    ),
    "position_stuck": Code(
        "error",
        "The position stands still although the logged velocity moves the joint.",
        "No change of the position in at least 10 windows of 0.1 to 1 s in which the velocity's "
        "integral is above 10 encoder steps.",
        "Look at the encoder and its connection.",
    ),
    # velocities
    "velocity_in_degrees": Code(
        "error",
        "Velocities are in deg/s, rad/s are expected.",
        "57.3 times the slope of the position (15 %).",
        "Convert to rad/s; --motion reads positions anyway.",
    ),
    "velocity_sign": Code(
        "error",
        "The velocity has the opposite sign of the position's slope.",
        "Gain between -1.2 and -0.8 over windows of 0.1 to 1 s.",
        "Flip the velocity or the position, whichever disagrees with the robot.",
    ),
    "velocity_zero": Code(
        "warning",
        "The velocity column is empty of information.",
        "Its integral is below 5 % of the position's travel.",
        "Leave it out, or log the measured velocity.",
    ),
    "velocity_inconsistent": Code(
        "warning",
        "The velocity does not belong to the position.",
        "Gain outside 0.8 to 1.25 or correlation below 0.9 over windows of 0.1 to 1 s.",
        "Check that both are measured (not commanded), of one joint and in SI units.",
    ),
    "speed_limit": Code(
        "warning",
        "The joint is faster than the robot file allows.",
        "Its speed is more than twice velocity_limit for 0.1 s.",
        "Check the unit and time of the position, and velocity_limit.",
    ),
    "joints_swapped": Code(
        "error",
        "Channels of two joints are exchanged.",
        "Velocities fit each other's positions (correlation above 0.95); or friction torque "
        "follows the other joint's direction of motion; or the rigid-body equations leave less "
        "than half of the error once exchanged; or positions fit each other's limits only.",
        "Correct the order of the joints in the logger or in the robot file.",
    ),
    # torque and current
    "torque_zero": Code(
        "error",
        "The torque is zero although the joint moves.",
        "Zero throughout.",
        "Log the measured motor current or torque.",
    ),
    "torque_constant_value": Code(
        "error",
        "The torque is one constant value although the joint moves.",
        "One single value.",
        "Log the measured motor current or torque.",
    ),
    "torque_spikes": Code(
        "warning",
        "Single values of torque or current are far off.",
        "At most 16 samples that differ from the median of their neighbours by more than the span "
        "of all others, and by 10 times what others do.",
        "Look at driver and cable; remove these samples: they weigh in every least squares.",
    ),
    "torque_stuck": Code(
        "error",
        "The torque stands still for a while although the joint moves.",
        "One value for at least 0.2 s and 50 samples of motion, of a channel that otherwise "
        "changes with nearly every sample.",
        "Look at the connection between drive and logger.",
    ),
    "torque_echo": Code(
        "error",
        "The torque follows the position alone: an echo of a command.",
        "Position explains 90 % of it, friction and acceleration have no part "
        "(logs/checks/echo.py).",
        "Record the measured current while the controller drives the joints on a trajectory.",
    ),
    "torque_quantised": Code(
        "warning",
        "The torque is coarsely quantised.",
        "Its lattice step is more than a quarter of its standard deviation while moving, and most "
        "samples equal the one before.",
        "Log the current with more bits.",
    ),
    "torque_saturated": Code(
        "warning",
        "The torque is clipped at a limit.",
        "Runs of three and more samples at exactly the extreme value, at least 10 samples and "
        "0.2 % of the log.",
        "Use slower moves, or a measuring range that is large enough.",
    ),
    "torque_beyond_limit": Code(
        "error",
        "The torque is far beyond what the joint can give.",
        "Its RMS is above 3 times the effort limit of the URDF.",
        "Check the unit (mA, motor side, gear ratio counted twice).",
    ),
    "current_in_ma": Code(
        "error",
        "Currents are in mA, A are expected.",
        "RMS above 200 A; or whole numbers beyond 30; or about 1000 times the torque that gravity "
        "or the rotor's inertia can ask for.",
        "Convert to A.",
    ),
    "effort_is_current": Code(
        "error",
        "The effort is current although the robot file takes it for torque.",
        "It stands to the gravity torque of the URDF's inertials (or is less than the rotors' "
        "inertia torque) as current does.",
        'Write effort = "current" under [channels], or name the column <joint>.current.',
    ),
    "effort_is_torque": Code(
        "error",
        "The effort is torque already although the robot file takes it for current.",
        "It stands to the gravity torque of the URDF's inertials as torque does.",
        'Write effort = "torque" under [channels], or name the column <joint>.torque.',
    ),
    "effort_unclear": Code(
        "error",
        "The log carries torque, the robot file gives torque constants, and nothing tells whether "
        "the values are torque or current.",
        'torque_constant of a joint, neither effort = "torque" nor torque under [channels], and no '
        "weight by a URDF's inertials to compare with.",
        'Write effort = "torque" under [channels] where it is joint torque, effort = "current" '
        "(or name the column <joint>.current) where it is motor current.",
    ),
    "torque_scale": Code(
        "error",
        "The torque has another scale than the robot's weight.",
        "Measured over expected gravity torque (URDF inertials) below 1/4 or above 4, beyond "
        "3 standard errors, at the joints that carry most of the weight.",
        "Check torque_constant, gear_ratio, the unit, and whether torque is motor side.",
    ),
    "sign_mismatch": Code(
        "error",
        "Torque and position have opposite signs.",
        "The friction found at its RMS speed is negative by 4 standard errors and above 3 % of "
        "the torque: the joint would gain energy; or with one of the two reversed, the rigid-body "
        "equations leave less than half of the error.",
        "Flip the sign of the torque (or of gear_ratio), or of the position.",
    ),
    "axis_flipped": Code(
        "error",
        "A joint turns the other way round than in the URDF.",
        "With position and torque reversed, the rigid-body equations leave less than half of the "
        "error, of that with free functions of each joint's position too; or gravity is the "
        "opposite of that of the URDF's inertials.",
        "Reverse the joint's axis in the URDF, or position and torque of the log.",
    ),
    "position_zero": Code(
        "error",
        "A joint's zero is not that of the URDF.",
        "With a quarter or half turn added, the rigid-body equations leave less than half of the "
        "error, of that with free functions of each joint's position too.",
        "Add the offset to the positions, or correct the joint's origin in the URDF.",
    ),
    "gravity_direction": Code(
        "error",
        "Gravity acts along another axis of the base than the robot file says.",
        "With gravity along that axis, the rigid-body equations leave less than half of the error "
        "and less than 35 % of the torque's RMS. Gravity turned round fits as well without a URDF "
        "that has inertials: both are named then.",
        "Write it as gravity in the robot file: the arm is mounted on a wall, a ceiling or tilted.",
    ),
    "model_mismatch": Code(
        "warning",
        "The robot's equations do not fit the torque.",
        "They leave more than 60 % of its RMS, no exchange or flip mends it, and every joint that "
        "moves makes 10 encoder steps a second.",
        "Check that robot file and log are of one robot, its mounting (gravity), and the torque.",
    ),
    **IMU_CODES,
    # a second sensor of a joint
    "sensor_sign": Code(
        "error",
        "A torque sensor or link encoder has the opposite sign of the motor's side.",
        "The correlation of `load` with torque or current, or of `link_position` with position, is "
        "below -0.5 while the joint moves.",
        "Flip its sign in the driver or in the log.",
    ),
    # temperature
    "temperature_in_kelvin": Code(
        "warning",
        "Temperatures are in K, degC are expected.",
        "Median between 240 and 420.",
        "Subtract 273.15.",
    ),
    "temperature_nonsense": Code(
        "warning",
        "The temperature is none.",
        "Outside -40 to 200 degC, exactly 0 throughout, or steps of more than 20 K.",
        "Check the channel; temperature is left out of the model otherwise.",
    ),
}
