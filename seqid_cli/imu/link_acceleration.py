"""Joint accelerations from all calibrated IMUs, and the choice of the motion's source.

An IMU on link m, its readings turned into the link's frame, sees

    dw_m = sum_{i <= m} z_i ddq_i + c_m(q, dq),

z_i the joint axes in that frame and c_m what the velocities alone produce (Eq. 39 for
two joints). Each IMU weighted by its noise below the cut-off, this is a small least
squares per sample; Eq. 30 and 42 are its cases of one and two moving joints. Only what
no IMU sees is left to the encoder. The velocities dq are the IMUs' as well (Eq. 31 and
41, `imu.link_velocity`); positions stay the encoders'.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import InputError, UsageError
from seqid_cli.imu.array import calibrated, layout, read_angular
from seqid_cli.imu.clock import Clock, clock_of_log
from seqid_cli.imu.link_velocity import (
    Turning,
    axes_in_link,
    joint_velocities,
    turning_of,
)
from seqid_cli.imu.sensor import link_state
from seqid_cli.imu.smoother.fused import absent_imus, fused_motion, needed, promising
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import Motion, estimate_motion, filtered_torque
from seqid_cli.motion.options import SOURCES, MotionOptions
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.kinematics import link_angular_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array


class LinkReading(NamedTuple):
    """Angular motion of the link that carries an IMU, in the link's frame.

    Attributes
    ----------
    name : str
        Of the IMU.
    link : int
    dw : Array
        (N, 3) rad/s^2.
    noise : float
        Standard deviation of `dw`.
    turning : Turning, optional
        None where the IMU's layout does not see the angular velocity.
    """

    name: str
    link: int
    dw: Array
    noise: float
    turning: Turning | None


def log_motion(
    recording: Recording,
    robot: Robot,
    options: MotionOptions,
    *,
    imu: ImuStage | None,
    source: str,
) -> Motion:
    """Return the motion of a log at its own rate, by the encoders or better.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    options : MotionOptions
        With `kept`, the motion of logs that differ in their torque alone is made once.
    imu : ImuStage, optional
    source : str
        See `best_motion`.

    Raises
    ------
    InputError
        No stretch is long enough to filter, or the log lacks an IMU that `source`
        needs.
    """
    if options.kept is None:
        encoder = estimate_motion(recording, robot, options)
        return best_motion(recording, robot, imu, encoder, source=source)

    key = (
        recording.sha256,
        id(recording.q),
        id(recording.valid),
        id(imu),
        source,
        options.cutoff_hz,
        recording.sha256 in options.logs_with_own_cutoff,
    )
    if key not in options.kept:
        motion = log_motion(
            recording, robot, replace(options, kept=None), imu=imu, source=source
        )
        # Held objects keep their places in memory, by which the key knows them.
        options.kept[key] = _KeptMotion(recording, imu, motion)
    kept: _KeptMotion = options.kept[key]
    if recording.tau is kept.recording.tau:
        return kept.motion
    tau, _ = filtered_torque(recording, kept.motion.lowpass)
    return replace(kept.motion, tau=tau)


class _KeptMotion(NamedTuple):
    """A motion, with the log and the calibration that it was made of."""

    recording: Recording
    imu: ImuStage | None
    motion: Motion


def best_motion(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    motion: Motion,
    *,
    source: str,
) -> Motion:
    """Improve the encoders' motion by the IMUs that are calibrated and healthy.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    stage : ImuStage, optional
    motion : Motion
        By the encoders, at the log's own rate.
    source : str
        "imu" replaces `dq` and `ddq` (Eq. 30-42), "fused" all motion, and the filter
        with it; both insist: a log without a usable IMU is an error. "auto" is "fused"
        where that can be had, contradicts no encoder and has the smaller left-out error
        (see `smoother.left_out`), and "encoder" elsewhere. "needed" takes the encoder
        as well where it is nearly as good (see `fused.needed`).

    Raises
    ------
    UsageError
        The source is unknown.
    InputError
        The source insists, and no calibrated, healthy IMU is in the log.
    """
    if source not in SOURCES:
        raise UsageError(f"motion source {source!r} is not one of {', '.join(SOURCES)}")
    if source == "encoder":
        return motion
    if source == "imu":
        return _from_imus(recording, robot, stage, motion)
    if source == "needed" and not promising(recording, robot, stage, motion):
        return motion

    insists = source == "fused"
    fused = fused_motion(recording, robot, stage, motion, insist=insists)
    if insists and fused.source != "fused":
        raise _impossible(source, recording, robot, stage, fused.warnings)
    if source == "needed" and not needed(fused, motion):
        return motion
    return fused


def _from_imus(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    motion: Motion,
    *,
    max_noise_ratio: float = 1.5,
) -> Motion:
    """Return motion by the IMUs: `dq` by Eq. 31, 41, `ddq` by Eq. 30, 42."""
    readings = []
    warnings = [*absent_imus(recording, robot, stage)]
    for imu in robot.imus:
        calibration = stage.imus.get(imu.name) if stage else None
        sees = imu.name in recording.gyros or layout(imu).acceleration
        if calibration is None or imu.name not in recording.accelerometers or not sees:
            continue
        reading = _link_reading(robot, imu, calibration, recording, motion)
        # Encoders know the mean acceleration of a link over a whole log well: what the
        # IMU has beside it is its bias.
        expected = link_angular_motion(
            robot.chain, motion.q, motion.dq, motion.ddq, reading.link
        )[1]
        bias = (reading.dw - expected)[motion.usable].mean(axis=0)
        reading = reading._replace(dw=reading.dw - bias)
        if _healthy(reading, expected, motion):
            readings.append(reading)
        else:
            warnings.append(f"{imu.name} is left out: it contradicts the encoders")
    if not readings:
        raise _impossible("imu", recording, robot, stage, warnings)
    turning = [reading.turning for reading in readings if reading.turning is not None]
    velocities = joint_velocities(recording, robot, motion, turning)
    ddq, error = _solve(robot, replace(motion, dq=velocities.dq), readings)

    # Jolts between two samples fold into the band of the motion; encoders show them as
    # error.
    difference = np.mean((ddq - motion.ddq)[motion.usable] ** 2, axis=0)
    noise = motion.cutoff.acceleration_noise**2
    by_difference = np.sqrt(np.maximum(error**2, difference - noise))
    error = np.where(difference > max_noise_ratio * noise, by_difference, error)
    return replace(
        motion,
        dq=velocities.dq,
        ddq=ddq,
        source="imu",
        imus=tuple(reading.name for reading in readings),
        error=error,
        velocity_error=velocities.error,
        encoder_error=motion.acceleration_error,
        warnings=tuple(warnings),
    )


def _impossible(
    source: str,
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    reasons: Sequence[str],
) -> InputError:
    """Make the error of a log that has no usable IMU, with the reasons."""
    if not robot.imus:
        why = "the robot file names no IMU"
    elif stage is None or not stage.imus:
        why = f"{', '.join(imu.name for imu in robot.imus)}: no calibration given"
    else:
        why = "; ".join(reasons) or "no IMU sees a joint that moves"
    message = f"no calibrated, healthy IMU for --motion {source} in this log: {why}"
    hint = "run seqid imu-calib and give its file with -p, or use --motion encoder"
    return InputError(message, hint=hint, where=str(recording.path))


def _link_reading(
    robot: Robot,
    imu: Imu,
    calibration: ImuCalibration,
    log: Recording,
    motion: Motion,
    *,
    axis_error: float = 0.003,
) -> LinkReading:
    """Return one IMU's angular motion in its link's frame, calibration taken off."""
    imu, values, gyro = calibrated(
        imu, calibration, log.accelerometers[imu.name], log.gyros.get(imu.name)
    )
    t = log.t
    valid = log.valid

    def on_encoders_clock(readings: Array, late: Array) -> Array:
        # Readings stamped t + `late` were taken at t.
        if not late.any():
            return readings
        moved = [
            np.interp(t + late, t[valid], channel[valid]) for channel in readings.T
        ]
        return np.column_stack(moved)

    channels = values if gyro is None else np.hstack([values, gyro])
    late = _clock(robot, imu, calibration, channels, log, motion).at(t + log.offset)
    values = on_encoders_clock(values, late)
    if gyro is not None:
        gyro = on_encoders_clock(gyro, late + calibration.gyro_delay_s)

    rotation = np.array(calibration.rotation)
    dw = read_angular(imu, values, gyro, motion.lowpass, valid).dw @ rotation.T
    noise = (calibration.noise_density or 0.0) * np.sqrt(motion.lowpass.cutoff_hz)
    size = np.sqrt(np.mean(np.sum(dw**2, axis=1)))
    turning = turning_of(imu, rotation, values, gyro, motion, axis_error=axis_error)
    return LinkReading(
        name=imu.name,
        link=imu.after_joint,
        dw=dw,
        noise=float(np.hypot(noise, axis_error * size)),
        turning=turning,
    )


def _clock(
    robot: Robot,
    imu: Imu,
    calibration: ImuCalibration,
    channels: Array,
    log: Recording,
    motion: Motion,
    *,
    sure_s: float = 0.002,
) -> Clock:
    """Return an IMU's clock in a log; it is searched where the calibration is unsure.

    `channels` (N, L) are its readings. A clock that the calibration knows to `sure_s`
    throughout the log, or not at all, is as the calibration has it.
    """
    expected = Clock(calibration.time_offset_s, calibration.time_rate)
    offset_error_s = calibration.time_offset_std_error_s or 0.0
    rate_error = calibration.time_rate_std_error or 0.0
    t = motion.t + log.offset
    if offset_error_s + rate_error * float(t[-1]) < sure_s:
        return expected
    size = np.maximum(np.nanstd(channels, axis=0), 1e-9)
    readings = motion.lowpass(channels / size, motion.valid)
    states = np.stack([motion.q.T, motion.dq.T, motion.ddq.T])
    x = motion.filtered(link_state(robot, imu.after_joint, states))
    usable = motion.usable
    return clock_of_log(
        t[usable],
        np.column_stack([x, np.ones(len(x))])[usable],
        t,
        readings,
        usable,
        expected,
        (offset_error_s, rate_error),
    )


def _healthy(
    reading: LinkReading, expected: Array, motion: Motion, *, disagreement: float = 0.5
) -> bool:
    """Return whether an IMU agrees with what the encoders say its link does.

    `expected` (N, 3) rad/s^2 is the angular acceleration by the encoders.
    """
    moving = np.flatnonzero(motion.moving[:, : reading.link + 1].any(axis=0))
    encoder_noise = np.sqrt(np.sum(motion.cutoff.acceleration_noise[moving] ** 2))
    noise = encoder_noise + reading.noise

    difference = (reading.dw - expected)[motion.usable]
    error = np.sqrt(np.mean(np.sum(difference**2, axis=1)))
    size = np.sqrt(np.mean(np.sum(expected[motion.usable] ** 2, axis=1)))
    # An error that is no number does not agree.
    return bool(len(moving) and error < disagreement * size + 3 * noise)


def _solve(
    robot: Robot, motion: Motion, readings: list[LinkReading], *, unseen: float = 1e-06
) -> tuple[Array, Array]:
    """Solve a weighted least squares per sample for the joints that move.

    Returns accelerations (N, n) rad/s^2 and their standard deviations (n,). Encoders
    take part with a share `unseen` of their weight: only what no IMU sees is theirs.
    """
    moving = np.flatnonzero(motion.moving.any(axis=0))
    count = len(moving)
    normal = np.zeros((motion.samples, count, count))
    right = np.zeros((motion.samples, count))

    # The IMUs' part: dw_m - c_m = sum of z_i ddq_i.
    still = np.zeros_like(motion.q)
    for reading in readings:
        link = reading.link
        c = link_angular_motion(robot.chain, motion.q, motion.dq, still, link)[1]
        moves_link = moving <= link
        axes = axes_in_link(robot, motion.q, link)[:, moving[moves_link]]
        J = np.zeros((motion.samples, 3, count))
        J[:, :, moves_link] = axes.swapaxes(1, 2)
        weight = 1.0 / max(reading.noise, 1e-9) ** 2
        normal += weight * np.einsum("nik,nil->nkl", J, J)
        right += weight * np.einsum("nik,ni->nk", J, reading.dw - c)

    noise = np.maximum(motion.cutoff.acceleration_noise, 1e-9)
    of_encoders = unseen / noise[moving] ** 2
    normal[:, range(count), range(count)] += of_encoders
    right += of_encoders * motion.ddq[:, moving]

    ddq = np.zeros_like(motion.ddq)
    ddq[:, moving] = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    error = noise.copy()
    variance = np.median(np.linalg.inv(normal), axis=0).diagonal()
    by_encoder_alone = noise / np.sqrt(unseen)
    error[moving] = np.minimum(np.sqrt(variance), by_encoder_alone[moving])
    return ddq, np.where(error > 0.5 * by_encoder_alone, noise, error)
