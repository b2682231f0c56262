"""IMU calibration (Sec. 3, Eq. 29-38): how each IMU is mounted on its link, and what it is like.

Directions of joint axes give a first mounting in closed form (`axis_pairs`, Eq. 38). A
joint least squares on the raw readings then finds, with the joints' motion, everything
at once: mounting and lever, biases, gains and axes of the sensors, and the offset of
their clock (`solve`). Gravity, centripetal and tangential accelerations show more than
the axes alone: two parallel axes a known distance apart, or a single one that is not
vertical, settle the angle about them. What the logs leave open is named and never
written as a number.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.imu_calibration import initial_guess, sensor_model
from seqid_cli.identify.imu_calibration.deflection import SIGNIFICANT
from seqid_cli.identify.imu_calibration.segments import (
    Segment,
    calibration_cutoff,
    segments_of,
    thinned,
)
from seqid_cli.identify.imu_calibration.solve import Fit, fit_constants
from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.settings import ImuCalibSettings, MountingSettings
from seqid_cli.identify.tolerances import deviations
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.array import layout
from seqid_cli.motion.imu.link_velocity import axes_in_link
from seqid_cli.motion.imu.sensor import MOTION
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params import schema
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Mask

# What a log holds of every IMU that it records: [rad/s^2/sqrt(Hz)] last; and its
# cut-off [Hz].
Held = tuple[dict[str, tuple[list[Segment], list[initial_guess.Pair], float]], float]


def calibrate_imus(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    options: MotionOptions,
    settings: ImuCalibSettings = ImuCalibSettings(),
) -> schema.ImuStage:
    """Calibrate every IMU of the robot file; name what these logs do not determine."""
    # Best joints before the IMUs move one at a time and fast, others locked in several
    # postures.
    if not robot.imus:
        where, hint = str(robot.source), "describe the IMU in it"
        raise UsageError("the robot file has no [[imu]]", hint=hint, where=where)
    part = partial(_held, robot, options, settings.mounting.max_cutoff)
    logs = list(mapped(recordings, part))
    imus, verdicts, notes = {}, [], []
    for imu in robot.imus:
        own = [held[imu.name] for held, _ in logs if imu.name in held]
        if not any(segment.moving for segments, *_ in own for segment in segments):
            reason = "no log moves a joint before this IMU with its readings recorded"
            verdicts.append(schema.Verdict(joint=imu.name, good=False, reason=reason))
            continue
        imus[imu.name], converged = _calibrated(robot, imu, own)
        notes += [f"{imu.name}: {text}" for text in imus[imu.name].not_determined]
        verdict = verdict_of(
            robot, imu, imus[imu.name], converged=converged, settings=settings.mounting
        )
        verdicts.append(verdict)
    if not imus:
        message = "no log moves a joint before an IMU with its readings recorded"
        hint = (
            "rotate the first joint back and forth with the others locked in several"
            " postures"
        )
        raise QualityError(message, hint=hint)
    cutoff = float(np.median([hz for _, hz in logs]))
    return schema.ImuStage(imus=imus, cutoff_hz=cutoff, verdicts=verdicts, notes=notes)


def _held(
    robot: Robot,
    options: MotionOptions,
    highest_hz: float,
    recording: Recording,
    number: int,
) -> Held:
    motion, found = estimate_motion(recording, robot, options), {}
    cutoff_hz = calibration_cutoff(motion, options.cutoff_hz, highest_hz)
    for imu in robot.imus:
        if imu.name in recording.accelerometers:
            seen = replace(imu, gyro=imu.gyro and imu.name in recording.gyros)
            own = segments_of(
                recording, robot, seen, motion, log=number, cutoff_hz=cutoff_hz
            )
            turns = layout(seen).acceleration or seen.gyro
            given = recording, robot, seen, motion
            found[imu.name] = (
                own,
                *(initial_guess.axis_pairs(*given) if turns else ([], 0.0)),
            )
    return found, cutoff_hz


def _calibrated(
    robot: Robot,
    imu: Imu,
    own: list[tuple[list[Segment], list[initial_guess.Pair], float]],
) -> tuple[schema.ImuCalibration, bool]:
    """The calibration of an IMU by what logs hold of it, and whether its fit has converged."""
    every = [segment for segments, *_ in own for segment in segments]
    pairs = [pair for _, found, _ in own for pair in found]
    densities = [density for _, found, density in own if found]
    channels = [len(segment.readings.noise) for segment in every]
    most = max(channels)
    segments = thinned(
        [s for s, count in zip(every, channels, strict=True) if count == most]
    )
    seen = replace(imu, gyro=most > len(imu.axes))
    guess = initial_guess.fit_rotation(pairs) if pairs else np.eye(3)
    start = initial_guess.starting_constants(segments, robot, seen, guess)
    others = [deviation.as_robot() for deviation in deviations(robot)]
    fit = fit_constants(segments, robot, seen, start, others)
    density = float(np.median(densities)) if densities else None
    return calibration_of(robot, seen, fit, segments, pairs, density), fit.converged


def calibration_of(
    robot: Robot,
    imu: Imu,
    fit: Fit,
    segments: list[Segment],
    pairs: list[initial_guess.Pair],
    density: float | None,
    *,
    max_delay_error_s: float = 0.005,
    sampling: float = 0.01,
) -> schema.ImuCalibration:
    """Calibration of one IMU as the parameter file has it."""
    # A clock offset with a larger standard error than `max_delay_error_s` is not
    # determined. A coarse encoder crosses its edges somewhere between two samples, at
    # the same places in every swing that repeats itself: its clock is known to
    # `sampling` of their period at best. Codes of a fine encoder hold no such error,
    # and jolts between two samples are noise of the fit already.
    constants, sigma = fit.constants, np.sqrt(np.diag(fit.covariance))
    worst, lever, missing = _of_mounting(fit.covariance)
    edges = sampling * segments[0].readings.period * any(s.by_edges for s in segments)
    delay_error = float(np.hypot(sigma[6], edges))
    delay_known = delay_error < max_delay_error_s
    by_tolerances = np.linalg.norm(fit.moves, axis=1)
    turn_errors = np.hypot(sigma[:3], by_tolerances[:3])
    lever_errors = np.hypot(sigma[3:6], by_tolerances[3:6])
    fields, open_channels = _of_sensors(imu, fit)
    # One-sided noise densities from the raw readings' white noise per sample.
    found = [s.readings.noise * np.sqrt(2 * s.readings.period) for s in segments]
    noise, k = np.median(found, axis=0).tolist(), len(imu.axes)
    missing += open_channels
    if not delay_known:
        missing.append("the clock offset to the encoders is not determined")
    off = np.array([np.linalg.norm(constants.R @ p.imu - p.link) for p in pairs])
    return schema.ImuCalibration(
        rotation=constants.R.tolist(),
        std_error_deg=worst,
        std_errors_deg=np.degrees(np.minimum(turn_errors, np.pi)).tolist(),
        configurations=len(pairs) or len({s.log for s in segments if s.moving}),
        condition=_condition(pairs) if pairs else 0.0,
        references=_references(pairs, robot.joint_names),
        not_determined=missing,
        axis_rmse_deg=float(np.degrees(np.sqrt(np.mean(off**2)))) if pairs else None,
        noise_density=density,
        time_offset_s=constants.delay if delay_known else 0.0,
        time_offset_std_error_s=delay_error if delay_known else None,
        gyro_delay_s=constants.gyro_delay if imu.gyro else 0.0,
        gyro_delay_std_error_s=float(sigma[-1]) if imu.gyro else None,
        acceleration_std_error=_acceleration_error(robot, imu, fit),
        lever=_listed(constants.lever, lever),
        lever_std_errors=_listed(lever_errors, lever),
        accelerometer_noise=noise[:k],
        gyro_noise=noise[k:],
        samples=fit.kept,
        outliers=fit.outliers,
        holdout=fit.holdout,
        deflections=fit.deflections,
        **fields,
    )


def _of_sensors(
    imu: Imu,
    fit: Fit,
    *,
    max_bias: float = 0.2,
    max_rate: float = 0.02,
    max_gain: float = 0.005,
    max_tilt_deg: float = 0.25,
    max_share: float = 0.5,
) -> tuple[dict[str, Any], list[str]]:
    """Entries of a calibration about its channels, and in words what is left open."""
    # Known is what has a standard error of up to so many m/s^2, rad/s, 1 and degrees,
    # and of gains and axes less than a prior of fixed width; widths of many sensors are
    # found.
    constants, k, c = fit.constants, len(imu.axes), len(fit.constants.bias)
    bias, gain, tilt = np.split(np.sqrt(np.diag(fit.covariance))[7:-1], [c, 2 * c])
    tilt = np.degrees(np.sqrt(np.mean(tilt.reshape(c, 2) ** 2, axis=1)))
    _, gain_prior, tilt_prior = np.split(fit.prior[7:-1], [c, 2 * c])
    accelerometers = np.arange(c) < k
    free = accelerometers & (k >= sensor_model.FEW)
    bias_known = bias < np.where(accelerometers, max_bias, max_rate)
    gain_known = (gain < max_gain) & (free | (gain < max_share * gain_prior))
    tilt_known = (tilt < max_tilt_deg) & (
        free | (tilt < max_share * np.degrees(tilt_prior[::2]))
    )
    nominal = sensor_model.nominal_axes(imu)
    axes = sensor_model.tilted(nominal, constants.tilt)
    axes = np.where(tilt_known[:, None], axes, nominal)
    fields: dict[str, Any] = {}
    missing = []
    for sensor, own in (("accelerometer", slice(k)), ("gyro", slice(k, None))):
        fields[f"{sensor}_axes"] = axes[own].tolist()
        for kind, values, name, error, known in (
            ("bias", constants.bias, "bias_std_errors", bias, bias_known),
            ("scale", np.exp(constants.log_gain), "scale_std_errors", gain, gain_known),
            ("axis", None, "tilt_std_errors_deg", tilt, tilt_known),
        ):
            fields[f"{sensor}_{name}"] = _listed(error[own], known[own])
            if values is not None:
                fields[f"{sensor}_{kind}"] = _listed(values[own], known[own])
            count = int((~known[own]).sum())
            if count:
                missing.append(
                    f"the {kind} of {count} {sensor} channel(s) is not determined"
                )
    return fields, missing


def _condition(pairs: list[initial_guess.Pair]) -> float:
    """Condition of the directions B of Eq. 37; 0 where they do not span space."""
    s = np.linalg.svd(np.array([p.imu for p in pairs]), compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == 3 and s[-1] > 1e-3 * s[0] else 0.0


def _references(
    pairs: list[initial_guess.Pair], names: tuple[str, ...]
) -> dict[str, schema.AxisReference]:
    """The most certain reference of Eq. 30 and 31 for each joint."""
    found = {
        name: [pair.reference for pair in pairs if pair.joint == name] for name in names
    }
    return {
        name: min(own, key=lambda r: r.gain_std_error)
        for name, own in found.items()
        if own
    }


def _acceleration_error(robot: Robot, imu: Imu, fit: Fit) -> float:
    """Relative standard error of the accelerations that the readings give of the last joint."""
    # That joint's unit acceleration reads a (C,) at accelerometers; with da = D dc of
    # the constants, all channels together take it by a'da / a'a too large.
    axis = robot.chain.axis[imu.after_joint]
    x = np.zeros((1, MOTION))
    if robot.chain.prismatic[imu.after_joint]:
        x[0, :3] = axis
    else:
        x[0, 3:12] = np.cross(np.eye(3), axis).ravel()  # rows of the matrix dw x
    constants, k, c = fit.constants, len(imu.axes), len(fit.constants.bias)
    a = (sensor_model.mounted(imu, constants).matrix @ x[0])[:k]
    slope = a @ sensor_model.design(imu, constants, x, np.zeros((1, c)))[0, :k]
    slope[7 : 7 + c] = 0.0  # a bias is no acceleration
    slope /= max(float(a @ a), 1e-300)
    return float(np.sqrt(slope @ fit.covariance @ slope))


def _of_mounting(
    covariance: Array, *, max_deg: float = 5.0, max_error_m: float = 0.02
) -> tuple[float, Mask, list[str]]:
    """Standard error in degrees, known components of the lever, and in words what is left open."""
    value, vector = np.linalg.eigh(covariance[:3, :3])
    worst = np.degrees(np.sqrt(value))
    known: Mask = np.sqrt(np.diag(covariance)[3:6]) < max_error_m
    missing, is_open = [], bool(worst[2] > max_deg)
    # where the angle about an axis is open, so is where the IMU sits around it
    if is_open:
        about = vector[:, 2] * np.sign(vector[np.argmax(np.abs(vector[:, 2])), 2])
        known &= np.linalg.norm(np.cross(np.eye(3), about), axis=1) < 0.1
        axis = ", ".join(f"{abs(x) if abs(x) < 5e-3 else x:.2f}" for x in about)
        missing.append(f"the angle about the link's axis ({axis}) is not determined")
    if not known.all():
        names = " and ".join(
            n for n, there in zip("xyz", known, strict=True) if not there
        )
        missing.append(f"the lever along the link's {names} is not determined")
    return float(worst[1 if is_open else 2]), known, missing


def _listed(values: Array, known: Mask) -> list[float | None]:
    return [float(v) if k else None for v, k in zip(values, known, strict=True)]


def verdict_of(
    robot: Robot,
    imu: Imu,
    calibration: schema.ImuCalibration,
    *,
    converged: bool,
    settings: MountingSettings = MountingSettings(),
) -> schema.Verdict:
    """Whether a mounting is known to `max_error` degrees and predicts a log left out; why not."""
    worst, left, bends = (
        calibration.std_error_deg,
        calibration.holdout,
        deflecting(calibration),
    )
    angle = [
        text for text in calibration.not_determined if text.startswith("the angle")
    ]
    matters = bool(angle) and not _turns_about_one_axis(robot, imu)
    reason = (
        f"mounting known to {worst:.3g} degrees from {calibration.configurations}"
        " trials"
    )
    reason += "".join(f"; {text}" for text in angle)
    if angle and not matters:
        reason += (
            ", and does not matter: every joint before the IMU turns about that axis"
        )
    if not converged:
        reason += "; the fit has not settled"
    unlike = left is not None and left > settings.max_left_out
    if unlike:
        reason += f"; a log left out is predicted to {left:.2g} times the noise"
    if bends is not None:
        unit = robot.joints[robot.joint_names.index(bends.joint)].unit("rad/s^2")
        reason += (
            f"; the link after {bends.joint} accelerates {bends.acceleration:.2g}"
            f" {unit} (RMS) beyond what its encoder tells: the joint is elastic or has"
            " backlash, or the clocks of IMU and encoders drift apart; errors are"
            " widened: record slower, smoother swings, and run seqid diagnose"
        )
    if not layout(imu).acceleration and not calibration.gyro_axes:
        reason += "; without a gyro this layout does not see angular acceleration"
    good = worst < settings.max_error and converged and not (matters or unlike or bends)
    return schema.Verdict(joint=imu.name, good=good, reason=reason)


def _turns_about_one_axis(robot: Robot, imu: Imu) -> bool:
    """Whether all joints up to the IMU turn about parallel axes, whatever their angles."""
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (8, robot.n))
    axes = axes_in_link(robot, q, imu.after_joint)[
        :, ~robot.chain.prismatic[: imu.after_joint + 1]
    ]
    return bool((np.abs(axes @ robot.chain.axis[imu.after_joint]) > 1 - 1e-9).all())


def deflecting(calibration: schema.ImuCalibration) -> schema.JointDeflection | None:
    """Return the joint that deflects by most, where one does significantly."""
    sure = [d for d in calibration.deflections if d.significance > SIGNIFICANT]
    return max(sure, key=lambda d: d.significance, default=None)
