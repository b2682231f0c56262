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

from seqid_cli.inspect.imus import channel_name, odd_channel
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.report import Finding, found
from seqid_cli.logs.raw import GYRO
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.robot.types import Imu, Robot

Array = NDArray[np.float64]

LARGEST_S, GRID = 0.06, 25
ROWS = 4000
COARSE = 4  # of them, every so many for the first search
BLOCKS = 8
FEWEST = 200  # rows
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
RCOND = 1e-6
UNIFORM = 1.0 / np.sqrt(12.0)  # standard deviation of an error within one step


@dataclass(frozen=True)
class Fit:
    """How an IMU's readings follow a link: share of variance left, delay [s] and its error."""

    left: float
    delay: float
    delay_error: float
    map: Array  # (K, p) readings from the features
    map_error: float  # largest standard error of the map of specific force (angular velocity)
    gain: float  # of all channels together: RMS of what the map makes over that of its features


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
    if data.motion is None:
        return []
    result = []
    for imu in data.robot.imus:
        for gyro, source in ((False, data.recording.accelerometers), (True, data.recording.gyros)):
            values = source.get(imu.name)
            if values is not None:
                fit = _fit(data.robot, data.motion, values, imu.after_joint, gyro=gyro)
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
        delay = item.fit.delay
        error = float(np.hypot(item.fit.delay_error, _resolution_s(data, item.imu.after_joint)))
        if abs(delay) > least and abs(delay) > SIGMAS * error:
            text = f"its readings are {1e3 * delay:.1f} +- {1e3 * error:.1g} ms behind the encoders"
            yield found("imu_delay", text, joint=name)
        if item.gyro:
            yield from _gyro(item)
        else:
            yield from _axes(data, item)


def _resolution_s(data: LogData, link: int) -> float:
    """Time that the fastest joint before a link takes for the error of its encoder, s.

    Joints rest anywhere within a count, on one side going forward and on the other going back.
    """
    assert data.motion is not None
    motion = data.motion
    speeds = [
        float(np.sqrt(np.mean(motion.dq[motion.moving[:, j], j] ** 2))) / data.step[j]
        for j in range(link + 1)
        if motion.moving[:, j].any()
    ]
    return float(UNIFORM / max(max(speeds, default=0.0), 1e-9))


@dataclass(frozen=True)
class _Scan:
    """Readings against the motion of a link, for shifts of some samples either way."""

    features: Array  # (N, p)
    readings: Array  # (N, K) through the motion's filter
    rows: NDArray[np.intp]  # that count
    y: Array  # (R, K) their readings without the mean
    total: float  # mean square of them, all channels
    shifts: NDArray[np.intp]
    left: Array  # mean square that each shift leaves

    @property
    def share(self) -> float:
        """Share of the variance that the best shift leaves."""
        return float(self.left.min()) / self.total


def _scan(robot: Robot, motion: Motion, values: Array, link: int, *, gyro: bool) -> _Scan | None:
    features = _features(robot, motion, link, gyro=gyro)
    if features is None:
        return None
    readings = motion.lowpass(values, motion.valid)
    shift = max(1, round(LARGEST_S * motion.rate_hz))
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= shift) & (rows < len(values) - shift)]
    rows = rows[:: max(1, len(rows) // ROWS)]
    if len(rows) < FEWEST:
        return None
    y = readings[rows] - readings[rows].mean(axis=0)
    total = float(np.mean(y**2)) * y.shape[1]
    if total == 0.0 or not np.isfinite(total):
        return None
    shifts = np.unique(np.rint(np.linspace(-shift, shift, GRID)).astype(np.intp))
    few = slice(None, None, COARSE)
    left = np.array([_left(features[rows[few] - s], y[few]) for s in shifts])
    return _Scan(features, readings, rows, y, total, shifts, left)


def _fit(robot: Robot, motion: Motion, values: Array, link: int, *, gyro: bool) -> Fit | None:
    scan = _scan(robot, motion, values, link, gyro=gyro)
    if scan is None:
        return None
    near, best = scan.share, int(scan.left.argmin())
    if near > WIDE or best in (0, len(scan.left) - 1):
        far = _far(motion, scan.readings, scan.features)
        if near > FOLLOWS or far.left < 0.5 * near:
            return far
    return _fine(motion, scan)


def _fine(motion: Motion, scan: _Scan) -> Fit:
    """Fit at the shift that is best to a fraction of a sample."""
    rows, y, shifts, coarse = scan.rows, scan.y, scan.shifts, int(scan.left.argmin())
    low, high = shifts[max(coarse - 1, 0)], shifts[min(coarse + 1, len(shifts) - 1)]
    fine = np.arange(max(low - 1, shifts[0]), min(high + 1, shifts[-1]) + 1)
    errors = np.array([_errors(scan.features[rows - s], y)[0] for s in fine])
    left = errors.mean(axis=1)
    best = int(left.argmin())
    delay, error = _vertex(fine, errors, best, motion, rows)
    X = scan.features[rows - fine[best]]
    spacing = float(np.median(np.diff(rows))) / motion.rate_hz
    fitted = _errors(X, y)[1]
    return Fit(
        float(left[best]) / scan.total,
        delay,
        error,
        fitted,
        _map_error(X, float(left[best]) / y.shape[1], MEMORY_S / spacing),
        _gain(X, fitted),
    )


def _far(motion: Motion, readings: Array, features: Array) -> Fit:
    """Look for a shift of up to two seconds, roughly, where none near zero fits."""
    step = max(1, round(FAR_STEP_S * motion.rate_hz))
    reach = min(round(FAR_S * motion.rate_hz), len(readings) // 4) // step * step
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= reach) & (rows < len(readings) - reach)]
    rows = rows[:: max(1, len(rows) // FAR_ROWS)]
    if len(rows) < FAR_ROWS // 4:
        nothing = np.zeros((readings.shape[1], features.shape[1]))
        return Fit(1.0, 0.0, np.inf, nothing, np.inf, 0.0)
    y = readings[rows] - readings[rows].mean(axis=0)
    shifts = np.arange(-reach, reach + 1, step)
    left = np.array([_left(features[rows - s], y) for s in shifts])
    best = int(left.argmin())
    share = float(left[best]) / max(float(np.mean(y**2)) * y.shape[1], 1e-300)
    X = features[rows - shifts[best]]
    fitted = _errors(X, y)[1]
    delay = float(shifts[best]) / motion.rate_hz
    return Fit(share, delay, FAR_STEP_S / SIGMAS, fitted, np.inf, _gain(X, fitted))


def _gain(X: Array, fitted: Array) -> float:
    """Size of a map (K, p) on its features (N, p), however few directions these show."""
    X = X - X.mean(axis=0)
    return float(np.linalg.norm(X @ fitted.T) / max(float(np.linalg.norm(X)), 1e-12))


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


def _left(X: Array, y: Array) -> float:
    """Squared error per sample that features (R, p) leave of readings (R, K)."""
    return float(_errors(X, y)[0].mean())


def _errors(X: Array, y: Array) -> tuple[Array, Array]:
    """Squared errors (R,) that features (R, p) leave of readings (R, K), and the map (K, p)."""
    X = X - X.mean(axis=0)
    scale = np.maximum(X.std(axis=0), 1e-9)
    X = X / scale
    values, vectors = np.linalg.eigh(X.T @ X)
    kept = values > RCOND**2 * values[-1]
    theta = vectors[:, kept] @ ((X @ vectors[:, kept]).T @ y / values[kept, None])
    return np.asarray(np.sum((y - X @ theta) ** 2, axis=1)), (theta / scale[:, None]).T


def _vertex(
    shifts: NDArray[np.intp], errors: Array, best: int, motion: Motion, rows: NDArray[np.intp]
) -> tuple[float, float]:
    """Delay [s] at the vertex of the parabola through the best shifts, and its error.

    The error is the larger of what white noise leads to and of how the vertex moves when one of
    `BLOCKS` parts of the log is left out: a coarse encoder's noise is far from white.
    """
    k = int(np.clip(best, 1, max(len(errors) - 2, 1)))
    dt = 1.0 / motion.rate_hz
    if len(errors) < 3 or best != k:
        return float(shifts[best]) * dt, np.inf
    near = errors[k - 1 : k + 2]
    middle = float(near[1].mean())
    offset, curvature = _parabola(near.mean(axis=1))
    if curvature <= 0.0:
        return float(shifts[best]) * dt, np.inf
    parts = np.array([part.sum(axis=1) for part in np.array_split(near, BLOCKS, axis=1)])
    without = np.array([_parabola(parts.sum(axis=0) - part)[0] for part in parts])
    scatter = float(np.sqrt((BLOCKS - 1) * np.mean((without - without.mean()) ** 2)))
    spacing = float(np.median(np.diff(rows))) * dt
    memory = max(1.0, MEMORY_S / spacing)
    white = float(np.sqrt(memory * middle / (curvature * len(rows))))
    return (float(shifts[k]) + offset) * dt, max(white, scatter) * dt


def _parabola(three: Array) -> tuple[float, float]:
    """Vertex, from the middle one, and curvature of the parabola through three values."""
    below, middle, above = (float(x) for x in three)
    curvature = below - 2.0 * middle + above
    return 0.5 * (below - above) / (curvature if curvature else np.inf), curvature


def _better_link(data: LogData, item: Following) -> Finding | None:
    """Find a link whose motion the IMU follows far better than that of its own."""
    motion = data.motion
    if item.fit.left < 0.01 or motion is None:
        return None
    source = data.recording.gyros if item.gyro else data.recording.accelerometers
    fits = {
        j: scan.share
        for j in range(data.robot.n)
        if j != item.imu.after_joint
        and (scan := _scan(data.robot, motion, source[item.imu.name], j, gyro=item.gyro))
        is not None
    }
    if not fits:
        return None
    j = min(fits, key=lambda link: fits[link])
    if fits[j] > OTHER_LINK * item.fit.left:
        return None
    names = data.robot.joint_names
    text = (
        f"follows the link after {names[j]}, not the one after {names[item.imu.after_joint]}: "
        f"{fits[j]:.1%} of its variance is left against {item.fit.left:.0%}"
    )
    return found("imu_wrong_link", text, joint=item.imu.name)


def _not_following(data: LogData, item: Following) -> Finding:
    better = _better_link(data, item)
    if better is not None:
        return better
    text = f"the motion of its link leaves {item.fit.left:.0%} of its variance unexplained"
    return found("imu_not_moving", text, joint=item.imu.name)


def _gyro(item: Following) -> Iterator[Finding]:
    size = item.fit.gain
    text = f"reads {size:.3g} times the link's angular velocity"
    if item.fit.left > TELLS:
        return
    if abs(size / DEGREES - 1.0) < 0.2:
        yield found("gyro_in_degrees", text, joint=item.imu.name)
    elif item.fit.map_error < MAPPED and np.linalg.det(item.fit.map) < 0.0:
        channel = channel_name(item.imu, GYRO, 0)[:-1]
        text = "its gyro fits the link's motion as a mirror image only"
        yield found("imu_left_handed", text, joint=item.imu.name, channel=channel)
    elif abs(size - 1.0) > 0.15:
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
