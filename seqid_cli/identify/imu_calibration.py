"""IMU calibration (Sec. 3, Eq. 29-38): mounting and sensor constants of each IMU.

Directions of joint axes give a first mounting in closed form (`axis_pairs`, Eq. 38). A
joint least squares on the raw readings then estimates everything at once, with the
joints' motion: mounting and lever, biases, gains and axes of the sensors, and offset
and rate of their clock in each log (`solve`). Gravity, centripetal and tangential
accelerations show more than the axes alone. Two parallel axes a known distance apart,
or a single axis that is not vertical, determine the angle about them. A constant that
the logs do not determine is named and never written as a number.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from seqid_cli.errors import InputError, QualityError, UsageError
from seqid_cli.identify.log_set import LogSet, mapped
from seqid_cli.identify.settings import ImuCalibSettings, MountingSettings
from seqid_cli.identify.tolerances import deviations
from seqid_cli.imu.array import layout
from seqid_cli.imu.calibration import initial_guess, sensor_model
from seqid_cli.imu.calibration.deflection import SIGNIFICANT
from seqid_cli.imu.calibration.segments import (
    Segment,
    calibration_cutoff,
    segments_of,
    thinned,
)
from seqid_cli.imu.calibration.solve import Fit, fit_constants
from seqid_cli.imu.link_velocity import axes_in_link
from seqid_cli.imu.sensor import MOTION
from seqid_cli.logs.recording import Recording, every
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params import schema
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Mask

# Findings of readings that no calibration can be made of.
NO_READINGS = frozenset({"imu_slow", "imu_without_gravity", "imu_in_g"})


@dataclass(frozen=True, kw_only=True)
class _ImuData:
    """Data of one log on one IMU; `density` is its noise [rad/s^2/sqrt(Hz)]."""

    log: str
    segments: list[Segment]
    pairs: list[initial_guess.Pair]
    density: float


@dataclass(frozen=True, kw_only=True)
class _LogData:
    """Data of one log on every IMU that it records, at its cut-off [Hz].

    `refused` says of an IMU why this log tells nothing of it.
    """

    imus: dict[str, _ImuData]
    cutoff_hz: float
    refused: dict[str, str]


def calibrate_imus(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    options: MotionOptions,
    settings: ImuCalibSettings = ImuCalibSettings(),
) -> schema.ImuStage:
    """Calibrate every IMU of the robot file; name what these logs do not determine.

    Logs are best in which the joints before the IMUs move one at a time and fast, with
    the others locked in several postures.

    Parameters
    ----------
    recordings : iterable of Recording
        The logs.
    robot : Robot
        The robot with its IMUs.
    options : MotionOptions
        Options of the motion.
    settings : ImuCalibSettings
        Limits of cut-off and verdicts.

    Raises
    ------
    UsageError
        If the robot file has no IMU.
    QualityError
        If no log moves a joint before an IMU, or readings are not those of the IMU.
    """
    if not robot.imus:
        where, hint = str(robot.source), "describe the IMU in it"
        raise UsageError("the robot file has no [[imu]]", hint=hint, where=where)
    part = partial(_log_data, robot, options, settings.mounting.max_cutoff)
    logs = list(mapped(recordings, part))

    imus: dict[str, schema.ImuCalibration] = {}
    verdicts = []
    notes = []
    unusable = _unusable(recordings)
    for imu in robot.imus:
        if imu.name in unusable:
            continue  # the findings are its verdict
        imu_logs = [log.imus[imu.name] for log in logs if imu.name in log.imus]
        segments = [segment for data in imu_logs for segment in data.segments]
        if not any(segment.moving for segment in segments):
            reasons = [log.refused[imu.name] for log in logs if imu.name in log.refused]
            reason = next(
                iter(reasons),
                "no log moves a joint before this IMU with its readings recorded",
            )
            verdicts.append(schema.Verdict(joint=imu.name, good=False, reason=reason))
            continue
        imus[imu.name], converged = _calibrated(robot, imu, imu_logs)
        texts = [*imus[imu.name].not_determined, *clock_statements(imus[imu.name])]
        notes += [f"{imu.name}: {text}" for text in texts]
        verdict = verdict_of(
            robot, imu, imus[imu.name], converged=converged, settings=settings.mounting
        )
        verdicts.append(verdict)
    if not imus and unusable:
        finding = next(iter(unusable.values()))
        message = f"{finding.joint} {finding.message}"
        raise QualityError(message, hint=finding.remedy, where=finding.log)
    if not imus:
        message = f"{verdicts[0].joint}: {verdicts[0].reason}"
        hint = (
            "rotate the first joint back and forth with the others locked in several"
            " postures"
        )
        raise QualityError(message, hint=hint)
    cutoff = float(np.median([log.cutoff_hz for log in logs]))
    return schema.ImuStage(imus=imus, cutoff_hz=cutoff, verdicts=verdicts, notes=notes)


def _unusable(recordings: Iterable[Recording]) -> dict[str, InspectionFinding]:
    """Return why IMUs are not calibrated, by their names: what their readings are.

    Only a `LogSet` that was read knows it.
    """
    findings = recordings.findings if isinstance(recordings, LogSet) else []
    return {
        finding.joint: finding
        for finding in reversed(findings)
        if finding.code in NO_READINGS
    }


def _log_data(
    robot: Robot,
    options: MotionOptions,
    highest_hz: float,
    recording: Recording,
    number: int,
) -> _LogData:
    """Return the segments and the pairs of axes of one log, by IMU."""
    motion = estimate_motion(recording, robot, options)
    cutoff_hz = calibration_cutoff(motion, options.cutoff_hz, highest_hz)
    imus = {}
    refused = {}
    for imu in robot.imus:
        if imu.name not in recording.accelerometers:
            continue
        recorded = replace(imu, gyro=imu.gyro and imu.name in recording.gyros)
        # Between its own samples a slower IMU is a curve, which has no noise: of the
        # joints as many samples count as of the IMU.
        stride = _samples_per_reading(recording, imu)
        at_readings = every(recording, stride)
        its_motion = motion
        if stride > 1:
            try:
                its_motion = estimate_motion(at_readings, robot, options)
            except InputError as error:
                rate_hz = recording.rate_hz / stride
                refused[imu.name] = (
                    f"of its {rate_hz:.3g} readings a second no motion can be made:"
                    f" {error.message}"
                )
                continue
            its_cutoff_hz = calibration_cutoff(
                its_motion, options.cutoff_hz, highest_hz
            )
            cutoff_hz = min(cutoff_hz, its_cutoff_hz)
        segments = segments_of(
            at_readings, robot, recorded, its_motion, log=number, cutoff_hz=cutoff_hz
        )
        # Other layouts do not see angular acceleration.
        pairs: list[initial_guess.Pair] = []
        density = 0.0
        if layout(recorded).acceleration or recorded.gyro:
            pairs, density = initial_guess.axis_pairs(
                at_readings, robot, recorded, its_motion
            )
        imus[imu.name] = _ImuData(
            log=str(recording.path), segments=segments, pairs=pairs, density=density
        )
    return _LogData(imus=imus, cutoff_hz=cutoff_hz, refused=refused)


def _samples_per_reading(
    recording: Recording, imu: Imu, *, tolerance: float = 0.05
) -> int:
    """Return the samples of the time base for each of an IMU that is slower.

    `tolerance` is the share by which two clocks may differ.
    """
    imu_rate_hz = recording.health.imu_rates_hz.get(imu.name, 0.0)
    if imu_rate_hz <= 0.0:
        return 1
    return max(1, int(recording.rate_hz / imu_rate_hz + tolerance))


def _calibrated(
    robot: Robot,
    imu: Imu,
    logs: list[_ImuData],
) -> tuple[schema.ImuCalibration, bool]:
    """Return the calibration of an IMU, and whether its fit has converged."""
    segments = [segment for data in logs for segment in data.segments]
    pairs = [pair for data in logs for pair in data.pairs]
    densities = [data.density for data in logs if data.pairs]

    # Logs without the gyro are left out where others record it.
    n_channels = max(len(segment.readings.noise) for segment in segments)
    segments = thinned(
        [segment for segment in segments if len(segment.readings.noise) == n_channels]
    )
    recorded = replace(imu, gyro=n_channels > len(imu.axes))

    guess = initial_guess.fit_rotation(pairs) if pairs else np.eye(3)
    start = initial_guess.starting_constants(segments, robot, recorded, guess)
    others = [deviation.as_robot() for deviation in deviations(robot)]
    fit = fit_constants(segments, robot, recorded, start, others)
    density = float(np.median(densities)) if densities else None
    names = {data.segments[0].log: data.log for data in logs if data.segments}
    calibration = calibration_of(
        robot, recorded, fit, segments, pairs, density, names=names
    )
    return calibration, fit.converged


def calibration_of(
    robot: Robot,
    imu: Imu,
    fit: Fit,
    segments: list[Segment],
    pairs: list[initial_guess.Pair],
    density: float | None,
    *,
    names: Mapping[int, str],
    max_delay_error_s: float = 0.005,
    max_rate_error: float = 0.001,
    sampling: float = 0.01,
) -> schema.ImuCalibration:
    """Return the calibration of one IMU, as the parameter file has it.

    Parameters
    ----------
    robot : Robot
        The robot.
    imu : Imu
        The IMU, with a gyro only if the segments have one.
    fit : Fit
        Constants and their errors.
    segments : list of Segment
        Segments of the fit.
    pairs : list of Pair
        Directions of joint axes that the logs show.
    density : float or None
        Noise of the angular acceleration [rad/s^2/sqrt(Hz)].
    names : mapping of int to str
        Paths of the logs by their numbers.
    max_delay_error_s, max_rate_error : float
        Standard errors of the clock's offset in a log [s] and of its rate [s/s], from
        which they are not determined.
    sampling : float
        Share of the sampling period to which a coarse encoder shows the clock.
    """
    # A clock offset with a larger standard error than `max_delay_error_s` is not
    # determined. A coarse encoder crosses its edges somewhere between two samples, at
    # the same places in every swing that repeats itself: its clock is known to
    # `sampling` of their period at best. Codes of a fine encoder hold no such error,
    # and jolts between two samples are noise of the fit already.
    constants = fit.constants
    sigma = np.sqrt(np.diag(fit.covariance))
    at = constants.places
    worst, is_lever_known, missing = _of_mounting(fit.covariance)
    edges = sampling * segments[0].readings.period * any(s.by_edges for s in segments)
    clocks = [_clock_of(fit, log, names[log], edges_s=edges) for log in constants.logs]
    of_logs = [(c.time_offset_std_error_s, c.time_rate_std_error) for c in clocks]
    usual_error = np.median(np.array(of_logs), axis=0)
    delay_known = bool(usual_error[0] < max_delay_error_s)
    rate_known = bool(usual_error[1] < max_rate_error)
    # The next log has an offset of its own, as unlike the mean as these logs' are.
    from_log_to_log = np.zeros(2)
    if len(clocks) > 1:
        from_log_to_log = fit.prior[at.shared : at.shared + 2]
    delay_error = float(np.linalg.norm([sigma[at.delay], from_log_to_log[0], edges]))
    rate_error = float(np.hypot(sigma[at.rate], from_log_to_log[1]))

    by_tolerances = np.linalg.norm(fit.moves, axis=1)
    turn_errors = np.hypot(sigma[at.turn], by_tolerances[at.turn])
    lever_errors = np.hypot(sigma[at.lever], by_tolerances[at.lever])
    fields, open_channels = _of_sensors(imu, fit)
    # One-sided noise densities from the raw readings' white noise per sample.
    densities = [s.readings.noise * np.sqrt(2 * s.readings.period) for s in segments]
    noise = np.median(densities, axis=0).tolist()
    k = len(imu.axes)

    missing += open_channels
    if not delay_known:
        missing.append("the clock offset to the encoders is not determined")
    elif not rate_known:
        missing.append("the rate of its clock is not determined")
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
        time_rate=constants.rate if rate_known else 0.0,
        time_rate_std_error=rate_error if rate_known else None,
        clocks=clocks if delay_known else [],
        gyro_delay_s=constants.gyro_delay if imu.gyro else 0.0,
        gyro_delay_std_error_s=float(sigma[at.gyro_delay]) if imu.gyro else None,
        acceleration_std_error=_acceleration_error(robot, imu, fit),
        lever=_listed(constants.lever, is_lever_known),
        lever_std_errors=_listed(lever_errors, is_lever_known),
        accelerometer_noise=noise[:k],
        gyro_noise=noise[k:],
        samples=fit.kept,
        outliers=fit.outliers,
        holdout=fit.holdout,
        deflections=fit.deflections,
        **fields,
    )


def _clock_of(fit: Fit, log: int, name: str, *, edges_s: float) -> schema.ImuClock:
    """Return the clock of one log; `edges_s` is what a coarse encoder leaves open."""
    constants = fit.constants
    clock = constants.clock(log)
    # Both are sums of what all logs share and of the log's own change.
    of_log = constants.places_of(log)
    covariance = fit.covariance[np.ix_(of_log, of_log)]
    summed = np.zeros((2, len(of_log)))
    summed[0, [constants.places.delay, -2]] = 1.0
    summed[1, [constants.places.rate, -1]] = 1.0
    variance = np.diag(summed @ covariance @ summed.T)
    return schema.ImuClock(
        log=name,
        time_offset_s=clock.offset_s,
        time_offset_std_error_s=float(np.hypot(np.sqrt(variance[0]), edges_s)),
        time_rate=clock.rate,
        time_rate_std_error=float(np.sqrt(variance[1])),
    )


def clock_statements(
    calibration: schema.ImuCalibration,
    *,
    clear: float = 4.0,
    min_rate: float = 2e-4,
    min_apart_s: float = 0.002,
) -> list[str]:
    """Say that the clocks of IMU and encoders drift apart, or begin unlike.

    Parameters
    ----------
    calibration : ImuCalibration
        Calibration of an IMU.
    clear : float
        Standard errors from which on a rate is said.
    min_rate : float
        Rate that is worth a word [s/s]: twice what two quartzes differ by.
    min_apart_s : float
        Differences of offsets between logs that are worth a word [s].
    """
    statements = []
    rate = calibration.time_rate
    std_error = calibration.time_rate_std_error
    if std_error is not None and abs(rate) > max(clear * std_error, min_rate):
        statements.append(
            f"its clock and that of the encoders drift apart by {1e3 * rate:.2g} +-"
            f" {1e3 * std_error:.1g} ms/s"
        )
    offsets = [clock.time_offset_s for clock in calibration.clocks]
    if len(offsets) > 1 and max(offsets) - min(offsets) > min_apart_s:
        statements.append(
            f"its clock offset as a log begins is from {1e3 * min(offsets):.3g} to"
            f" {1e3 * max(offsets):.3g} ms, another in each log"
        )
    return statements


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
    """Return entries of a calibration on its channels, and notes on unknown ones.

    A constant is known if its standard error is below the given one [m/s^2, rad/s, 1
    and degrees]. Where there are few sensors, the priors of gains and tilts have fixed
    widths; a standard error must then also be below `max_share` of the prior's.
    """
    constants = fit.constants
    k = len(imu.axes)
    c = len(constants.bias)
    at = constants.places
    std_errors = np.sqrt(np.diag(fit.covariance))
    bias = std_errors[at.bias]
    gain = std_errors[at.gain]
    tilt = np.degrees(np.sqrt(np.mean(std_errors[at.tilt].reshape(c, 2) ** 2, axis=1)))
    gain_prior = fit.prior[at.gain]
    tilt_prior = fit.prior[at.tilt]
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
    for sensor, places in (("accelerometer", slice(k)), ("gyro", slice(k, None))):
        fields[f"{sensor}_axes"] = axes[places].tolist()
        for kind, values, name, error, known in (
            ("bias", constants.bias, "bias_std_errors", bias, bias_known),
            ("scale", np.exp(constants.log_gain), "scale_std_errors", gain, gain_known),
            ("axis", None, "tilt_std_errors_deg", tilt, tilt_known),
        ):
            fields[f"{sensor}_{name}"] = _listed(error[places], known[places])
            if values is not None:
                fields[f"{sensor}_{kind}"] = _listed(values[places], known[places])
            count = int((~known[places]).sum())
            if count:
                missing.append(
                    f"the {kind} of {count} {sensor} channel(s) is not determined"
                )
    return fields, missing


def _condition(pairs: list[initial_guess.Pair]) -> float:
    """Return the condition of directions B of Eq. 37; 0 if they do not span space."""
    s = np.linalg.svd(np.array([p.imu for p in pairs]), compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == 3 and s[-1] > 1e-3 * s[0] else 0.0


def _references(
    pairs: list[initial_guess.Pair], names: tuple[str, ...]
) -> dict[str, schema.AxisReference]:
    """Return the most certain reference (Eq. 30 and 31) of each joint with any."""
    most_certain = {}
    for name in names:
        references = [pair.reference for pair in pairs if pair.joint == name]
        if references:
            most_certain[name] = min(references, key=lambda r: r.gain_std_error)
    return most_certain


def _acceleration_error(robot: Robot, imu: Imu, fit: Fit) -> float:
    """Return the relative standard error of the last joint's accelerations."""
    # That joint's unit acceleration reads a (C,) at accelerometers; with da = D dc of
    # the constants, all channels together take it by a'da / a'a too large.
    axis = robot.chain.axis[imu.after_joint]
    x = np.zeros((1, MOTION))
    if robot.chain.prismatic[imu.after_joint]:
        x[0, :3] = axis
    else:
        x[0, 3:12] = np.cross(np.eye(3), axis).ravel()  # rows of the matrix dw x
    constants = fit.constants
    k = len(imu.axes)
    c = len(constants.bias)
    a = (sensor_model.mounted(imu, constants).matrix @ x[0])[:k]
    at = constants.places
    nothing = np.zeros((1, c))
    by_constants = sensor_model.design(imu, constants, x, nothing, np.zeros(1))
    slope = (a @ by_constants[0, :k])[: at.shared]
    slope[at.bias] = 0.0  # a bias is no acceleration
    slope /= max(float(a @ a), 1e-300)
    shared = slice(at.shared)
    return float(np.sqrt(slope @ fit.covariance[shared, shared] @ slope))


def _of_mounting(
    covariance: Array, *, max_deg: float = 5.0, max_error_m: float = 0.02
) -> tuple[float, Mask, list[str]]:
    """Return what is known of the mounting.

    Returns
    -------
    std_error_deg : float
        Largest standard error of the turn, without an angle that is open.
    is_lever_known : array (3,)
        Components of the lever that are known.
    missing : list of str
        Notes on what is not determined.
    """
    value, vector = np.linalg.eigh(covariance[:3, :3])
    worst = np.degrees(np.sqrt(value))
    known: Mask = np.sqrt(np.diag(covariance)[3:6]) < max_error_m
    missing = []
    is_open = bool(worst[2] > max_deg)
    # Where the angle about an axis is open, the place of the IMU around it is, too.
    if is_open:
        about = vector[:, 2] * np.sign(vector[np.argmax(np.abs(vector[:, 2])), 2])
        known &= np.linalg.norm(np.cross(np.eye(3), about), axis=1) < 0.1
        axis = ", ".join(f"{abs(x) if abs(x) < 5e-3 else x:.2f}" for x in about)
        missing.append(f"the angle about the link's axis ({axis}) is not determined")
    if not known.all():
        names = " and ".join(
            name for name, is_known in zip("xyz", known, strict=True) if not is_known
        )
        missing.append(f"the lever along the link's {names} is not determined")
    return float(worst[1 if is_open else 2]), known, missing


def _listed(values: Array, known: Mask) -> list[float | None]:
    """Return the known values as a list, None for the others."""
    return [
        float(value) if is_known else None
        for value, is_known in zip(values, known, strict=True)
    ]


def verdict_of(
    robot: Robot,
    imu: Imu,
    calibration: schema.ImuCalibration,
    *,
    converged: bool,
    settings: MountingSettings = MountingSettings(),
) -> schema.Verdict:
    """Return whether a mounting can be relied on, with the reason.

    It is good if it is known to `max_error` degrees, predicts a left-out log, and no
    joint deflects; usable if errors that a deflection has widened are as small.

    Parameters
    ----------
    robot : Robot
        The robot.
    imu : Imu
        The IMU.
    calibration : ImuCalibration
        Its calibration.
    converged : bool
        Whether the fit has converged.
    settings : MountingSettings
        Limits of the verdict.
    """
    worst = calibration.std_error_deg
    left_out = calibration.holdout
    bends = deflecting(calibration)
    angle = [
        text for text in calibration.not_determined if text.startswith("the angle")
    ]
    # An angle about the common axis of all joints before the IMU has no effect on what
    # the IMU tells of them.
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
    unlike = left_out is not None and left_out > settings.max_left_out
    if unlike:
        reason += f"; a log left out is predicted to {left_out:.2g} times the noise"
    if bends is not None:
        unit = robot.joints[robot.joint_names.index(bends.joint)].unit("rad/s^2")
        reason += (
            f"; the link after {bends.joint} accelerates {bends.acceleration:.2g}"
            f" {unit} (RMS) beyond what its encoder tells: the joint is elastic or has"
            " backlash; errors are widened: record slower, smoother swings, and run"
            " seqid diagnose"
        )
    if not layout(imu).acceleration and not calibration.gyro_axes:
        reason += "; without a gyro this layout does not see angular acceleration"
    reliable = worst < settings.max_error and converged and not (matters or unlike)
    good = reliable and bends is None
    # Errors hold what bends: that is more than noise, and no reason for doubt.
    level: schema.Level = "usable" if reliable else "poor"
    return schema.Verdict(joint=imu.name, good=good, level=level, reason=reason)


def _turns_about_one_axis(robot: Robot, imu: Imu) -> bool:
    """Return whether joints up to the IMU have parallel axes in any posture."""
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (8, robot.n))
    is_revolute = ~robot.chain.prismatic[: imu.after_joint + 1]
    axes = axes_in_link(robot, q, imu.after_joint)[:, is_revolute]
    return bool((np.abs(axes @ robot.chain.axis[imu.after_joint]) > 1 - 1e-9).all())


def deflecting(calibration: schema.ImuCalibration) -> schema.JointDeflection | None:
    """Return the joint that deflects by most, where one does significantly."""
    sure = [d for d in calibration.deflections if d.significance > SIGNIFICANT]
    return max(sure, key=lambda d: d.significance, default=None)
