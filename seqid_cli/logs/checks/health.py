"""Cheap checks of units and clocks: each warning names the channel, the value and the remedy."""

import numpy as np

from seqid_cli.logs.raw import Array, Mask
from seqid_cli.robot.types import Imu, Joint, Robot
from seqid_cli.shares import percent

STANDARD_GRAVITY = 9.80665
_DEGREES = 180.0 / np.pi


def position_warnings(
    robot: Robot,
    t: Array,
    q: Array,
    dq: Array | None,
    *,
    most_rad: float = 20.0,
    least_speed: float = 1e-3,
) -> list[str]:
    """Check positions (N, n) against the limits and the logged velocities (N, n).

    Beyond the limits and `most_rad`, three turns either way, they look like degrees; velocities are
    compared from `least_speed` [rad/s] RMS on.
    """
    warnings = []
    for i, joint in enumerate(robot.joints):
        text = _limits(joint, q[:, i], most_rad)
        if not text and dq is not None:
            text = _velocity(joint, t, q[:, i], dq[:, i], least_speed)
        if text:
            warnings.append(text)
    return warnings


def current_warnings(robot: Robot, current: Array, *, most_a: float = 200.0) -> list[str]:
    """Check motor currents (M, n), NaN where missing: beyond `most_a` RMS they look like mA."""
    warnings = []
    for joint, values in zip(robot.joints, current.T, strict=True):
        present = values[np.isfinite(values)]
        rms = float(np.sqrt(np.mean(present**2))) if present.size else 0.0
        if rms > most_a:
            warnings.append(
                f"{joint.name}: the current is {rms:.3g} A RMS: it looks like mA, A are expected"
            )
    return warnings


def accelerometer_warnings(robot: Robot, imu: Imu, values: Array, valid: Mask) -> list[str]:
    """Check that accelerometers (N, K) read about gravity in the median."""
    gravity = float(np.linalg.norm(robot.gravity))
    if np.linalg.matrix_rank(imu.axes) < 3 or abs(gravity - STANDARD_GRAVITY) > 0.5:
        return []
    rows = values[valid & np.isfinite(values).all(axis=1)]
    if not len(rows):
        return []
    size = float(np.median(np.linalg.norm(rows @ np.linalg.pinv(imu.axes).T, axis=1)))
    for unit, factor in (("g", 1.0), ("mg", 1000.0)):
        if 0.8 * factor < size < 1.2 * factor:
            return [
                f"{imu.name}: the accelerometers read {size:.3g} in the median: it looks like "
                f"{unit}, m/s^2 are expected (multiply by {STANDARD_GRAVITY / factor:.6g})"
            ]
    return []


def clock_warnings(
    rate_hz: float, jitter: float, jitter_limit: float, *, least_hz: float = 5.0
) -> list[str]:
    """Check rate and jitter."""
    warnings = []
    if rate_hz < least_hz:
        warnings.append(
            f"only {rate_hz:.3g} samples per second: check that time is in seconds; 100 Hz or "
            "more are needed to see accelerations"
        )
    if jitter > jitter_limit:
        warnings.append(
            f"the sample interval scatters by {percent(jitter, 0)} (limit "
            f"{percent(jitter_limit, 0)}): resampling is not reliable; log with the controller's "
            "own clock"
        )
    return warnings


def _limits(joint: Joint, q: Array, most_rad: float) -> str:
    if joint.prismatic or joint.position_limits is None:
        return ""
    low, high = joint.position_limits
    least, most = float(q.min()), float(q.max())
    margin = 0.1 * (high - low)
    if least >= low - margin and most <= high + margin:
        return ""
    in_degrees = max(abs(least), abs(most)) > most_rad
    looks = " It looks like degrees: rad are expected" if in_degrees else " Check zero and unit"
    return (
        f"{joint.name}: the position runs from {least:.4g} to {most:.4g} rad, the limits are "
        f"{low:.4g} to {high:.4g} rad.{looks}"
    )


def _velocity(joint: Joint, t: Array, q: Array, dq: Array, least_speed: float) -> str:
    if joint.prismatic or not np.isfinite(dq).all():
        return ""
    slope = float(np.sqrt(np.mean(np.gradient(q, t) ** 2)))
    logged = float(np.sqrt(np.mean(dq**2)))
    if min(slope, logged) < least_speed:
        return ""
    ratio = slope / logged
    if 0.85 < ratio / _DEGREES < 1.15:
        return f"{joint.name}: the position looks like degrees (the velocity is in rad/s)"
    if 0.85 < ratio * _DEGREES < 1.15:
        return f"{joint.name}: the velocity looks like deg/s (the position is in rad)"
    return ""
