"""IMUs against the encoders: delay, link, axes, gyro.

Whatever the mounting, an accelerometer on a link reads a linear function of the link's specific
force (3), angular acceleration (3) and products of angular velocity (6) in the link's frame, a gyro
one of the angular velocity (3), at the IMU's own time. Both sides go through the same low-pass; the
linear function is fitted to each channel for a range of time shifts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import SeqidError
from seqid_cli.inspect.imus import channel_name, odd_channel
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.report import Finding, found
from seqid_cli.logs.raw import GYRO
from seqid_cli.motion.motion import Motion, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.robot.types import Imu, Robot

Array = NDArray[np.float64]

LARGEST_S, GRID = 0.06, 25
ROWS = 4000
DELAY_S, DELAY_SAMPLES, SIGMAS = 0.005, 2.0, 4.0
FOLLOWS = 0.5
WIDE = 0.2  # of the variance left, from where larger shifts are tried
OTHER_LINK = 0.25
TELLS = 0.1  # of the variance, that may be left where a map is to tell axes
DEGREES = 180.0 / np.pi
TURNS = 0.02  # rad/s RMS of a link, above which its motion says something
MEMORY_S = 0.1
FAR_S, FAR_STEP_S, FAR_ROWS = 2.0, 0.01, 800
MAPPED = 0.03  # standard error of the map that tells axes
SCALED = 0.05


@dataclass(frozen=True)
class Fit:
    """How an IMU's readings follow a link: share of variance left, delay [s] and its error."""

    left: float
    delay: float
    delay_error: float
    map: Array  # (K, p) readings from the features
    map_error: float  # largest standard error of the map of specific force (angular velocity)


@dataclass(frozen=True)
class Following:
    """What the motion says of one IMU."""

    imu: Imu
    fit: Fit
    gyro: bool


def follow(data: LogData) -> list[Following]:
    """Fit every IMU of a log to the motion of its link; empty where nothing turns."""
    if not data.modelled:
        return []
    if not data.recording.accelerometers and not data.recording.gyros:
        return []
    try:
        motion = estimate_motion(data.recording, data.robot, MotionOptions())
    except SeqidError:
        return []
    result = []
    for imu in data.robot.imus:
        for gyro, source in ((False, data.recording.accelerometers), (True, data.recording.gyros)):
            values = source.get(imu.name)
            if values is not None:
                fit = _fit(data.robot, motion, values, imu.after_joint, gyro=gyro)
                if fit is not None:
                    result.append(Following(imu, fit, gyro))
    return result


def motion_findings(data: LogData, following: list[Following]) -> Iterator[Finding]:
    """Judge how the IMUs follow the encoders."""
    for item in following:
        name = item.imu.name
        if item.fit.left > FOLLOWS:
            yield _not_following(data, item)
            continue
        better = _better_link(data, item)
        if better is not None:
            yield better
            continue
        least = max(DELAY_S, DELAY_SAMPLES / data.recording.rate_hz)
        delay, error = item.fit.delay, item.fit.delay_error
        if abs(delay) > least and abs(delay) > SIGMAS * error:
            text = f"its readings are {1e3 * delay:.1f} +- {1e3 * error:.1g} ms behind the encoders"
            yield found("imu_delay", text, joint=name)
        if item.gyro:
            yield from _gyro(item)
        else:
            yield from _axes(data, item)


def _fit(robot: Robot, motion: Motion, values: Array, link: int, *, gyro: bool) -> Fit | None:
    features = _features(robot, motion, link, gyro=gyro)
    if features is None:
        return None
    readings = motion.lowpass(values, motion.valid)
    shift = max(1, round(LARGEST_S * motion.rate_hz))
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= shift) & (rows < len(values) - shift)]
    rows = rows[:: max(1, len(rows) // ROWS)]
    if len(rows) < 200:
        return None
    y = readings[rows] - readings[rows].mean(axis=0)
    total = float(np.mean(y**2)) * y.shape[1]
    if total == 0.0 or not np.isfinite(total):
        return None
    shifts = np.unique(np.rint(np.linspace(-shift, shift, GRID)).astype(np.intp))
    left = np.array([_left(features[rows - s], y)[0] for s in shifts])
    near = float(left.min()) / total
    if near > WIDE or int(left.argmin()) in (0, len(left) - 1):
        far = _far(motion, readings, features)
        if near > FOLLOWS or far.left < 0.5 * near:
            return far
    best = int(left.argmin())
    low, high = shifts[max(best - 1, 0)], shifts[min(best + 1, len(shifts) - 1)]
    fine = np.arange(max(low - 1, -shift), min(high + 1, shift) + 1)
    left = np.array([_left(features[rows - s], y)[0] for s in fine])
    best = int(left.argmin())
    delay, error = _vertex(fine, left, best, motion, rows)
    X = features[rows - fine[best]]
    spacing = float(np.median(np.diff(rows))) / motion.rate_hz
    return Fit(
        float(left[best]) / total,
        delay,
        error,
        _left(X, y)[1],
        _map_error(X, float(left[best]) / y.shape[1], MEMORY_S / spacing),
    )


def _far(motion: Motion, readings: Array, features: Array) -> Fit:
    """Look for a shift of up to two seconds, roughly, where none near zero fits."""
    step = max(1, round(FAR_STEP_S * motion.rate_hz))
    reach = min(round(FAR_S * motion.rate_hz), len(readings) // 4) // step * step
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= reach) & (rows < len(readings) - reach)]
    rows = rows[:: max(1, len(rows) // FAR_ROWS)]
    if len(rows) < FAR_ROWS // 4:
        return Fit(1.0, 0.0, np.inf, np.zeros((readings.shape[1], features.shape[1])), np.inf)
    y = readings[rows] - readings[rows].mean(axis=0)
    shifts = np.arange(-reach, reach + 1, step)
    left = np.array([_left(features[rows - s], y)[0] for s in shifts])
    best = int(left.argmin())
    share = float(left[best]) / max(float(np.mean(y**2)) * y.shape[1], 1e-300)
    fitted = _left(features[rows - shifts[best]], y)[1]
    return Fit(share, float(shifts[best]) / motion.rate_hz, FAR_STEP_S / SIGMAS, fitted, np.inf)


def _map_error(X: Array, variance: float, memory: float) -> float:
    """Largest standard error of the first three columns of a map, per unit of the feature."""
    X = X - X.mean(axis=0)
    scale = np.maximum(X.std(axis=0), 1e-9)
    _, s, Vt = np.linalg.svd(X / scale, full_matrices=False)
    if s[-1] < 1e-6 * s[0]:
        seen = np.sum(Vt[s >= 1e-6 * s[0]] ** 2, axis=0)[:3]
        if (seen < 1.0 - 1e-6).any():
            return float(np.inf)  # a direction that this motion does not show
    inverse = Vt.T / np.where(s >= 1e-6 * s[0], s, np.inf)
    spread = np.sqrt(variance * max(memory, 1.0) * np.sum(inverse**2, axis=1)) / scale
    return float(spread[:3].max())


def _features(robot: Robot, motion: Motion, link: int, *, gyro: bool) -> Array | None:
    moved = link_motion(robot.chain, robot.gravity, motion.q.T, motion.dq.T, motion.ddq.T)
    w = moved.w[link].T
    if float(np.sqrt(np.mean(np.sum(w**2, axis=1)))) < TURNS:
        return None
    if gyro:
        columns = w
    else:
        products = np.stack([w[:, a] * w[:, b] for a in range(3) for b in range(a, 3)], axis=1)
        columns = np.hstack([moved.a[link].T, moved.dw[link].T, products])
    return np.asarray(motion.filtered(columns))


def _left(X: Array, y: Array) -> tuple[float, Array]:
    """Squared error per sample that features (R, p) leave of readings (R, K), and the map."""
    X = X - X.mean(axis=0)
    scale = np.maximum(X.std(axis=0), 1e-9)
    theta = np.linalg.lstsq(X / scale, y, rcond=1e-6)[0]
    return float(np.mean((y - X / scale @ theta) ** 2)) * y.shape[1], (theta / scale[:, None]).T


def _vertex(
    shifts: NDArray[np.intp], left: Array, best: int, motion: Motion, rows: NDArray[np.intp]
) -> tuple[float, float]:
    """Delay [s] at the vertex of the parabola through the best shifts, and its error."""
    k = int(np.clip(best, 1, max(len(left) - 2, 1)))
    if len(left) < 3:
        return float(shifts[best]) / motion.rate_hz, np.inf
    below, middle, above = left[k - 1 : k + 2]
    curvature = below - 2 * middle + above
    dt = 1.0 / motion.rate_hz
    if curvature <= 0.0 or best != k:
        return float(shifts[best]) * dt, np.inf
    delay = (float(shifts[k]) + 0.5 * (below - above) / curvature) * dt
    spacing = float(np.median(np.diff(rows))) * dt
    memory = max(1.0, MEMORY_S / spacing)
    return delay, float(np.sqrt(memory * middle / (curvature * len(rows)))) * dt


def _better_link(data: LogData, item: Following) -> Finding | None:
    """Find a link whose motion the IMU follows far better than that of its own."""
    if item.fit.left < 0.01:
        return None
    motion = estimate_motion(data.recording, data.robot, MotionOptions())
    source = data.recording.gyros if item.gyro else data.recording.accelerometers
    fits = {
        j: fit
        for j in range(data.robot.n)
        if j != item.imu.after_joint
        and (fit := _fit(data.robot, motion, source[item.imu.name], j, gyro=item.gyro)) is not None
    }
    if not fits:
        return None
    j = min(fits, key=lambda link: fits[link].left)
    if fits[j].left > OTHER_LINK * item.fit.left:
        return None
    names = data.robot.joint_names
    text = (
        f"follows the link after {names[j]}, not the one after {names[item.imu.after_joint]}: "
        f"{fits[j].left:.1%} of its variance is left against {item.fit.left:.0%}"
    )
    return found("imu_wrong_link", text, joint=item.imu.name)


def _not_following(data: LogData, item: Following) -> Finding:
    better = _better_link(data, item)
    if better is not None:
        return better
    text = f"the motion of its link leaves {item.fit.left:.0%} of its variance unexplained"
    return found("imu_not_moving", text, joint=item.imu.name)


def _gyro(item: Following) -> Iterator[Finding]:
    size = np.linalg.svd(item.fit.map, compute_uv=False)
    text = f"reads {size[0]:.3g} times the link's angular velocity"
    if item.fit.left > TELLS:
        return
    if abs(size[0] / DEGREES - 1.0) < 0.2:
        yield found("gyro_in_degrees", text, joint=item.imu.name)
    elif item.fit.map_error < MAPPED and np.linalg.det(item.fit.map) < 0.0:
        channel = channel_name(item.imu, GYRO, 0)[:-1]
        text = "its gyro fits the link's motion as a mirror image only"
        yield found("imu_left_handed", text, joint=item.imu.name, channel=channel)
    elif abs(size[0] - 1.0) > 0.15:
        yield found("gyro_scale", text, joint=item.imu.name)


def _axes(data: LogData, item: Following) -> Iterator[Finding]:
    """Judge the axes by the map of specific force, which must be a rotation behind the axes."""
    if item.fit.map_error > MAPPED or item.fit.left > TELLS or _in_other_unit(item):
        return
    gravity = float(np.linalg.norm(data.robot.gravity)) or 9.81
    force = item.fit.map[:, :3]
    odd = odd_channel(item.imu, gravity * force.T, gravity)
    if odd is not None:
        yield odd
        return
    turned = np.linalg.pinv(item.imu.axes) @ force
    size = np.linalg.svd(turned, compute_uv=False)
    if np.linalg.det(turned) < 0.0 and size[2] > 0.7 * size[0]:
        text = "its accelerometers fit the link's motion as a mirror image only"
        yield found("imu_left_handed", text, joint=item.imu.name)
    elif abs(float(np.mean(size)) - 1.0) > SCALED and size[2] > 0.9 * size[0]:
        text = f"reads {float(np.mean(size)):.3g} times the link's specific force"
        yield found("imu_gravity", text, joint=item.imu.name)


def _in_other_unit(item: Following) -> bool:
    size = float(np.linalg.svd(item.fit.map[:, :3], compute_uv=False)[0])
    return not 0.5 < size / np.sqrt(max(len(item.imu.axes) / 3.0, 1.0)) < 2.0
