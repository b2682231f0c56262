"""From the fit of an IMU's constants to the parameter file: numbers where the logs give them."""

from typing import Any

import numpy as np

from seqid_cli.identify.imu_calibration import sensor_model
from seqid_cli.identify.imu_calibration.deflection import SIGNIFICANT
from seqid_cli.identify.imu_calibration.initial_guess import Pair
from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.identify.imu_calibration.solve import Fit
from seqid_cli.motion.imu.array import layout
from seqid_cli.motion.imu.link_acceleration import axes_in_link
from seqid_cli.motion.imu.sensor import MOTION
from seqid_cli.params.schema import AxisReference, ImuCalibration, JointDeflection, Verdict
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Mask


def calibration_of(
    robot: Robot,
    imu: Imu,
    fit: Fit,
    segments: list[Segment],
    pairs: list[Pair],
    density: float | None,
    *,
    max_delay_error_s: float = 0.005,
    sampling: float = 0.01,
) -> ImuCalibration:
    """Calibration of one IMU as the parameter file has it.

    A clock offset with a larger standard error than `max_delay_error_s` is not determined. Jolts
    between two samples shift a clock by `sampling` of their period.
    """
    constants, sigma = fit.constants, np.sqrt(np.diag(fit.covariance))
    worst, lever, missing = _of_mounting(fit.covariance)
    delay_error = float(np.hypot(sigma[6], sampling * segments[0].readings.period))
    delay_known = delay_error < max_delay_error_s
    fields, open_channels = _of_sensors(imu, fit, segments)
    missing += open_channels
    if not delay_known:
        missing.append("the clock offset to the encoders is not determined")
    off = np.array([np.linalg.norm(constants.R @ p.imu - p.link) for p in pairs])
    return ImuCalibration(
        rotation=constants.R.tolist(),
        std_error_deg=worst,
        std_errors_deg=np.degrees(np.minimum(sigma[:3], np.pi)).tolist(),
        configurations=len(pairs) or len({s.log for s in segments if s.moving}),
        condition=_condition(pairs) if pairs else 0.0,
        references=_references(pairs, robot.joint_names),
        not_determined=missing,
        axis_rmse_deg=float(np.degrees(np.sqrt(np.mean(off**2)))) if pairs else None,
        noise_density=density,
        time_offset_s=constants.delay if delay_known else 0.0,
        time_offset_std_error_s=delay_error if delay_known else None,
        acceleration_std_error=_acceleration_error(robot, imu, fit),
        lever=_listed(constants.lever, lever),
        lever_std_errors=_listed(sigma[3:6], lever),
        samples=fit.kept,
        outliers=fit.outliers,
        holdout=fit.holdout,
        deflections=list(fit.deflections),
        **fields,
    )


def _of_sensors(imu: Imu, fit: Fit, segments: list[Segment]) -> tuple[dict[str, Any], list[str]]:
    """Entries of a calibration about its channels, and in words what is left open."""
    # One-sided noise densities from the raw readings' white noise per sample.
    found = [s.readings.noise * np.sqrt(2 * s.readings.period) for s in segments]
    noise, nominal = np.median(found, axis=0), sensor_model.nominal_axes(imu)
    k, fields, missing = len(imu.axes), {}, []
    for sensor, own in (("accelerometer", slice(k)), ("gyro", slice(k, None))):
        fields[f"{sensor}_noise"] = noise[own].tolist()
        for kind, (value, error, known) in _channels(imu, fit).items():
            there = known[own]
            if kind == "axis":
                axes = np.where(there[:, None], value[own], nominal[own])
                fields[f"{sensor}_axes"] = axes.tolist()
                fields[f"{sensor}_tilt_std_errors_deg"] = _listed(error[own], there)
            else:
                fields[f"{sensor}_{kind}"] = _listed(value[own], there)
                fields[f"{sensor}_{kind}_std_errors"] = _listed(error[own], there)
            if not there.all():
                count = int((~there).sum())
                missing.append(f"the {kind} of {count} {sensor} channel(s) is not determined")
    return fields, missing


def _condition(pairs: list[Pair]) -> float:
    """Condition of the directions B of Eq. 37; 0 where they do not span space."""
    s = np.linalg.svd(np.array([p.imu for p in pairs]), compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == 3 and s[-1] > 1e-3 * s[0] else 0.0


def _references(pairs: list[Pair], names: tuple[str, ...]) -> dict[str, AxisReference]:
    """The most certain reference of Eq. 30 and 31 for each joint."""
    known = [(p.joint, p.reference) for p in pairs if p.reference]
    found = {name: [reference for joint, reference in known if joint == name] for name in names}
    return {name: min(own, key=lambda r: r.gain_std_error) for name, own in found.items() if own}


def _acceleration_error(robot: Robot, imu: Imu, fit: Fit) -> float:
    """Relative standard error of the accelerations that the readings give of the last joint."""
    # That joint's unit acceleration reads a (C,) at accelerometers; with da = D dc of the
    # constants, all channels together take it by a'da / a'a too large.
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


def _channels(
    imu: Imu,
    fit: Fit,
    *,
    max_bias: float = 0.2,
    max_rate: float = 0.02,
    max_gain: float = 0.005,
    max_tilt_deg: float = 0.25,
    max_share: float = 0.5,
) -> dict[str, tuple[Array, Array, Mask]]:
    """Values of biases, gains and axes, their standard errors (C,), and which are known.

    Those are, whose standard errors are up to so many m/s^2, rad/s, 1 and degrees.
    """
    constants, k, c = fit.constants, len(imu.axes), len(fit.constants.bias)
    accelerometers = np.arange(c) < k

    def told(error: Array, prior: Array, limit: float) -> Mask:
        # The logs show more than a prior of fixed width did; widths of many sensors are found.
        own = accelerometers & (k >= sensor_model.FEW)
        return np.asarray((error < limit) & (own | (error < max_share * prior)))

    bias, gain, tilt = np.split(np.sqrt(np.diag(fit.covariance))[7:], [c, 2 * c])
    tilt = np.degrees(np.sqrt(np.mean(tilt.reshape(c, 2) ** 2, axis=1)))
    _, gain_prior, tilt_prior = np.split(fit.prior[7:], [c, 2 * c])
    axes = sensor_model.tilted(sensor_model.nominal_axes(imu), constants.tilt)
    return {
        "bias": (constants.bias, bias, bias < np.where(accelerometers, max_bias, max_rate)),
        "scale": (np.exp(constants.log_gain), gain, told(gain, gain_prior, max_gain)),
        "axis": (axes, tilt, told(tilt, np.degrees(tilt_prior[::2]), max_tilt_deg)),
    }


def _of_mounting(
    covariance: Array, *, max_deg: float = 5.0, max_error_m: float = 0.02
) -> tuple[float, Mask, list[str]]:
    """Standard error in degrees, known components of the lever, and in words what is left open."""
    value, vector = np.linalg.eigh(covariance[:3, :3])
    worst = np.degrees(np.sqrt(value))
    known: Mask = np.sqrt(np.diag(covariance)[3:6]) < max_error_m
    missing, is_open = [], bool(worst[2] > max_deg)
    if is_open:  # where the angle about an axis is open, so is where the IMU sits around it
        about = vector[:, 2] * np.sign(vector[np.argmax(np.abs(vector[:, 2])), 2])
        known &= np.linalg.norm(np.cross(np.eye(3), about), axis=1) < 0.1
        axis = ", ".join(f"{abs(x) if abs(x) < 5e-3 else x:.2f}" for x in about)
        missing.append(f"the angle about the link's axis ({axis}) is not determined")
    if not known.all():
        names = " and ".join(n for n, there in zip("xyz", known, strict=True) if not there)
        missing.append(f"the lever along the link's {names} is not determined")
    return float(worst[1 if is_open else 2]), known, missing


def _listed(values: Array, known: Mask) -> list[float | None]:
    return [float(v) if k else None for v, k in zip(values, known, strict=True)]


def verdict_of(
    robot: Robot,
    imu: Imu,
    calibration: ImuCalibration,
    *,
    converged: bool,
    max_deg: float = 0.5,
    max_holdout: float = 1.5,
) -> Verdict:
    """Whether the mounting can be trusted, and why not.

    It is known to better than `max_deg` degrees, and a log that is left out is predicted to
    `max_holdout` times the noise.
    """
    worst = calibration.std_error_deg
    reason = f"mounting known to {worst:.3g} degrees from {calibration.configurations} trials"
    angle = [text for text in calibration.not_determined if text.startswith("the angle")]
    good = worst < max_deg
    if angle:
        reason += "; " + "; ".join(angle)
        # Whether all joints up to the IMU turn about parallel axes, whatever their angles.
        q = np.random.default_rng(0).uniform(-3.0, 3.0, (8, robot.n))
        turning = ~robot.chain.prismatic[: imu.after_joint + 1]
        axes = axes_in_link(robot, q, imu.after_joint)[:, turning]
        if (np.abs(axes @ robot.chain.axis[imu.after_joint]) > 1 - 1e-9).all():
            reason += ", and does not matter: every joint before the IMU turns about that axis"
        else:
            good = False
    if not converged:
        good, reason = False, reason + "; the fit has not settled"
    if calibration.holdout is not None and calibration.holdout > max_holdout:
        good = False
        reason += f"; a log left out is predicted to {calibration.holdout:.2g} times the noise"
    bends = deflecting(calibration)
    if bends is not None:
        good, unit = False, robot.joints[robot.joint_names.index(bends.joint)].unit("rad/s^2")
        reason += (
            f"; the link after {bends.joint} accelerates {bends.acceleration:.2g} "
            f"{unit} (RMS) beyond what its encoder tells: the joint is "
            "elastic or has backlash, or the clocks of IMU and encoders drift apart; errors are "
            "widened: record slower, smoother swings, and run seqid diagnose"
        )
    if not layout(imu).acceleration and not calibration.gyro_axes:
        reason += "; without a gyro this layout does not see angular acceleration"
    return Verdict(joint=imu.name, good=good, reason=reason)


def deflecting(calibration: ImuCalibration) -> JointDeflection | None:
    """Return the joint that deflects by most, where one does significantly."""
    sure = [d for d in calibration.deflections if d.significance > SIGNIFICANT]
    return max(sure, key=lambda d: d.significance, default=None)
