"""Joint accelerations from every calibrated IMU, and the choice of where motion comes from.

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
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.array import calibrated, layout, read_angular
from seqid_cli.motion.imu.link_velocity import (
    Turning,
    axes_in_link,
    joint_velocities,
    turning_of,
)
from seqid_cli.motion.motion import Motion, estimate_motion, filtered_torque
from seqid_cli.motion.options import SOURCES, MotionOptions
from seqid_cli.motion.smoother.fused import absent_imus, fused_motion, needed, promising
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.kinematics import link_angular_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array


class LinkReading(NamedTuple):
    """Angular acceleration (N, 3) rad/s^2 of the link that carries the IMU, in its frame."""

    name: str
    link: int
    dw: Array
    noise: float
    turning: Turning | None  # None where its layout does not see the angular velocity


def log_motion(
    recording: Recording,
    robot: Robot,
    options: MotionOptions,
    *,
    imu: ImuStage | None,
    source: str,
) -> Motion:
    """Motion of a log at its own rate, of the encoders or better (see `best_motion`).

    With `options.kept` the motion of logs that differ in their torque alone is made
    once. Raises InputError: no stretch is long enough to filter, or the log lacks an
    IMU that `source` needs.
    """
    if options.kept is None:
        encoder = estimate_motion(recording, robot, options)
        return best_motion(recording, robot, imu, encoder, source=source)
    sha256 = recording.sha256
    arrays = id(recording.q), id(recording.valid), id(imu)
    key = (sha256, *arrays, source, options.cutoff_hz, sha256 in options.own)
    if key not in options.kept:
        made = log_motion(
            recording, robot, replace(options, kept=None), imu=imu, source=source
        )
        # what is kept keeps its place in memory
        options.kept[key] = recording, imu, made
    known: Recording
    motion: Motion
    known, _, motion = options.kept[key]
    if recording.tau is known.tau:
        return motion
    return replace(motion, tau=filtered_torque(recording, motion.lowpass)[0])


def best_motion(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    motion: Motion,
    *,
    source: str,
) -> Motion:
    """Improve the encoders' motion by the IMUs that are calibrated and healthy.

    `source`: "imu" replaces `dq` and `ddq` (Eq. 30-42), "fused" all motion, and the
    filter with it; both insist: a log without a usable IMU is an error. "auto" is
    "fused" where that can be had, contradicts no encoder and has the smaller left-out
    error (see `smoother.left_out`), and "encoder" elsewhere; "needed" takes the encoder
    as well where it is nearly as good (see `fused.needed`). Raises UsageError: it is
    unknown. Raises InputError: it insists, and no calibrated, healthy IMU is in the
    log.
    """
    if source not in SOURCES:
        raise UsageError(f"motion source {source!r} is not one of {', '.join(SOURCES)}")
    if source == "encoder":
        return motion
    if source == "imu":
        return _from_imus(recording, robot, stage, motion)
    if source == "needed" and not promising(recording, robot, stage, motion):
        return motion
    found = fused_motion(recording, robot, stage, motion, insist=source == "fused")
    if source == "fused" and found.source != "fused":
        raise _impossible(source, recording, robot, stage, found.warnings)
    return motion if source == "needed" and not needed(found, motion) else found


def _from_imus(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    motion: Motion,
    *,
    max_noise_ratio: float = 1.5,
) -> Motion:
    """Motion by the IMUs: `dq` by Eq. 31 and 41, `ddq` by Eq. 30 and 42, `q` the encoders'."""
    readings, warnings = [], [*absent_imus(recording, robot, stage)]
    for imu in robot.imus:
        calibration = stage.imus.get(imu.name) if stage else None
        sees = imu.name in recording.gyros or layout(imu).acceleration
        if calibration is None or imu.name not in recording.accelerometers or not sees:
            continue
        reading = _link_reading(imu, calibration, recording, motion)
        # What the encoders alone say of the link; its mean over a whole log they know
        # well.
        states = motion.q, motion.dq, motion.ddq, reading.link
        expected = link_angular_motion(robot.chain, *states)[1]
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
    apart = np.mean((ddq - motion.ddq)[motion.usable] ** 2, axis=0)
    noise = motion.cutoff.acceleration_noise**2
    shown = np.sqrt(np.maximum(error**2, apart - noise))
    error = np.where(apart > max_noise_ratio * noise, shown, error)
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
    """The error of a log that has no IMU to go by, with what stands in the way."""
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
    imu: Imu,
    known: ImuCalibration,
    log: Recording,
    motion: Motion,
    *,
    axis_error: float = 0.003,
) -> LinkReading:
    """One IMU's angular acceleration in its link's frame, its calibration taken off."""
    raw = log.accelerometers[imu.name], log.gyros.get(imu.name)
    imu, values, gyro = calibrated(imu, known, *raw)
    t, valid = log.t, log.valid

    def on_encoders_clock(values: Array, offset_s: float) -> Array:
        # Readings stamped t were taken at t - `offset_s`.
        if not offset_s:
            return values
        return np.column_stack(
            [np.interp(t + offset_s, t[valid], v[valid]) for v in values.T]
        )

    values = on_encoders_clock(values, known.time_offset_s)
    if gyro is not None:
        gyro = on_encoders_clock(gyro, known.time_offset_s + known.gyro_delay_s)
    rotation = np.array(known.rotation)
    dw = read_angular(imu, values, gyro, motion.lowpass, valid).dw @ rotation.T
    noise = (known.noise_density or 0.0) * np.sqrt(motion.lowpass.cutoff_hz)
    size = np.sqrt(np.mean(np.sum(dw**2, axis=1)))
    turning = turning_of(imu, rotation, values, gyro, motion, axis_error=axis_error)
    return LinkReading(
        name=imu.name,
        link=imu.after_joint,
        dw=dw,
        noise=float(np.hypot(noise, axis_error * size)),
        turning=turning,
    )


def _healthy(
    reading: LinkReading, expected: Array, motion: Motion, *, disagreement: float = 0.5
) -> bool:
    """Whether an IMU agrees with what the encoders say its link does."""
    own = np.flatnonzero(motion.moving[:, : reading.link + 1].any(axis=0))
    noise = np.sqrt(np.sum(motion.cutoff.acceleration_noise[own] ** 2)) + reading.noise
    both = (x[motion.usable] for x in (reading.dw - expected, expected))
    error, size = (np.sqrt(np.mean(np.sum(x**2, axis=1))) for x in both)
    # not if it is no number
    return bool(len(own) and error < disagreement * size + 3 * noise)


def _solve(
    robot: Robot, motion: Motion, readings: list[LinkReading], *, unseen: float = 1e-06
) -> tuple[Array, Array]:
    """Weighted least squares per sample for the moving joints: accelerations, their error (n,)."""
    moving = np.flatnonzero(motion.moving.any(axis=0))
    count, N = len(moving), motion.samples
    normal, right = np.zeros((N, count, count)), np.zeros((N, count))
    still = np.zeros_like(motion.q)
    for _, link, dw, sigma, _ in readings:
        c = link_angular_motion(robot.chain, motion.q, motion.dq, still, link)[1]
        J, own = np.zeros((N, 3, count)), moving <= link
        J[:, :, own] = axes_in_link(robot, motion.q, link)[:, moving[own]].swapaxes(
            1, 2
        )
        weight = 1.0 / max(sigma, 1e-9) ** 2
        normal += weight * np.einsum("nik,nil->nkl", J, J)
        right += weight * np.einsum("nik,ni->nk", J, dw - c)
    noise = np.maximum(motion.cutoff.acceleration_noise, 1e-9)
    encoder = unseen / noise[moving] ** 2
    normal[:, range(count), range(count)] += encoder
    right += encoder * motion.ddq[:, moving]
    ddq, error = np.zeros_like(motion.ddq), noise.copy()
    ddq[:, moving] = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    variance = np.median(np.linalg.inv(normal), axis=0).diagonal()
    error[moving] = np.minimum(np.sqrt(variance), noise[moving] / np.sqrt(unseen))
    return ddq, np.where(error > 0.5 * noise / np.sqrt(unseen), noise, error)
