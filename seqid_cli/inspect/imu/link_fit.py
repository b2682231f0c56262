"""The motion of a link fitted to the readings of an IMU, for a range of time shifts."""

from dataclasses import dataclass

import numpy as np

from seqid_cli.motion.motion import Motion
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Index

SIGMAS = 4.0
FOLLOWS = 0.5  # of the variance: an IMU that leaves more does not follow its link


@dataclass(frozen=True)
class LinkFit:
    """How an IMU's readings follow a link: share of variance left, delay [s] and its error."""

    imu: Imu
    gyro: bool
    left: float
    delay: float
    delay_error: float
    map: Array  # (K, p) readings from the features
    map_error: float  # largest standard error of the map of specific force (angular velocity)
    gain: float  # of all channels together: RMS of what the map makes over that of its features


@dataclass(frozen=True)
class ShiftScan:
    """Readings against the motion of a link, for shifts of some samples either way."""

    features: Array  # (N, p)
    readings: Array  # (N, K) through the motion's filter
    rows: Index  # that count
    total: float  # mean square of their readings without the mean, all channels
    shifts: Index
    left: Array  # mean square that each shift leaves

    @property
    def share(self) -> float:
        """Share of the variance that the best shift leaves."""
        return float(self.left.min()) / self.total


def scan(
    robot: Robot,
    motion: Motion,
    values: Array,
    link: int,
    *,
    gyro: bool,
    max_shift_s: float = 0.06,
    grid: int = 25,
) -> ShiftScan | None:
    """Compare readings (N, K) with the motion of a link; None where it rests."""
    features = _features(robot, motion, link, gyro=gyro)
    if features is None:
        return None
    reach = max(1, round(max_shift_s * motion.rate_hz))
    shifts = np.unique(np.rint(np.linspace(-reach, reach, grid)).astype(np.intp))
    return _shifted(motion, features, motion.lowpass(values, motion.valid), shifts)


def _shifted(
    motion: Motion, features: Array, readings: Array, shifts: Index, *, min_rows: int = 200
) -> ShiftScan | None:
    """What features leave of readings at each shift, by every fourth of some 4000 rows."""
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= shifts[-1]) & (rows < len(readings) - shifts[-1])]
    rows = rows[:: max(1, len(rows) // 4000)]
    total = float(np.sum(np.var(readings[rows], axis=0))) if len(rows) >= min_rows else 0.0
    if total == 0.0 or not np.isfinite(total):
        return None
    few = rows[::4]
    left = [np.sum(_left(features[few - s], readings[few])[0] ** 2, axis=1).mean() for s in shifts]
    return ShiftScan(features, readings, rows, total, shifts, np.array(left))


def fit_link(
    robot: Robot,
    motion: Motion,
    values: Array,
    imu: Imu,
    *,
    gyro: bool,
    wide: float = 0.2,
    far_s: float = 2.0,
    step_s: float = 0.01,
) -> LinkFit | None:
    """Fit readings (N, K) to the motion of a link at the shift that is best; None if it rests."""
    tried = scan(robot, motion, values, imu.after_joint, gyro=gyro)
    if tried is None:
        return None
    if tried.share > wide or int(tried.left.argmin()) in (0, len(tried.left) - 1):
        # None near zero fits: look farther, roughly.
        step = max(1, round(step_s * motion.rate_hz))
        reach = min(round(far_s * motion.rate_hz), len(values) // 4) // step * step
        shifts = np.arange(-reach, reach + 1, step)
        far = _shifted(motion, tried.features, tried.readings, shifts)
        if far is not None and (tried.share > FOLLOWS or far.share < 0.5 * tried.share):
            tried = far
    return _fine(imu, gyro, motion, tried)


def _fine(
    imu: Imu, gyro: bool, motion: Motion, scan: ShiftScan, *, blocks: int = 8, memory_s: float = 0.1
) -> LinkFit:
    """Fit at the shift that is best to a fraction of a sample, by Gauss and Newton."""
    # The delay's error is the larger of what white noise leads to and of how it moves when one of
    # `blocks` parts of the log is left out: a coarse encoder's noise is far from white.
    rows, y = scan.rows, scan.readings[scan.rows]
    low, high = scan.shifts[[0, -1]]
    shift, slopes = float(scan.shifts[scan.left.argmin()]), np.gradient(scan.features, axis=0)
    for _ in range(3):
        at = rows - round(shift)
        X = scan.features[at] + (round(shift) - shift) * slopes[at]
        left, fitted = _left(X, y)
        across = _left(X, slopes[at] @ fitted.T)[0]
        power, pull = float(np.sum(across**2)), -np.sum(across * left, axis=1)
        if not low < shift < high or power == 0.0:
            break
        shift = float(np.clip(shift + pull.sum() / power, low, high))
    square = float(np.mean(left**2))
    memory = max(1.0, memory_s * motion.rate_hz / float(np.median(np.diff(rows))))
    error = np.inf
    if low < shift < high and power > 0.0:
        parts = [part.sum() for part in np.array_split(pull, blocks)]
        error = max(float(np.sqrt(memory * square * power)), float(np.linalg.norm(parts))) / power
    # Size of the map on its features, however few directions these show.
    X = X - X.mean(axis=0)
    gain = float(np.linalg.norm(X @ fitted.T) / max(float(np.linalg.norm(X)), 1e-12))
    share, rate = square * y.shape[1] / scan.total, motion.rate_hz
    map_error = _map_error(X, square * memory)
    return LinkFit(imu, gyro, share, shift / rate, error / rate, fitted, map_error, gain)


def _map_error(X: Array, variance: float) -> float:
    """Largest standard error of a map's first three columns, of features (N, p) without mean."""
    scale = np.maximum(X.std(axis=0), 1e-9)
    _, s, Vt = np.linalg.svd(X / scale, full_matrices=False)
    inverse = Vt.T / np.maximum(s, 1e-9 * s[0])  # large where the motion does not show a direction
    spread = np.sqrt(variance * np.sum(inverse**2, axis=1)) / scale
    return float(spread[:3].max())


def _features(
    robot: Robot, motion: Motion, link: int, *, gyro: bool, min_turning: float = 0.02
) -> Array | None:
    """Filtered features (N, p) of a link's motion, for readings on it; None if it rests."""
    moved = link_motion(robot.chain, robot.gravity, motion.q.T, motion.dq.T, motion.ddq.T)
    w = moved.w[link]
    if float(np.sqrt(np.mean(np.sum(w**2, axis=0)))) < min_turning:
        return None
    products = [w[a] * w[b] for a in range(3) for b in range(a, 3)]
    features = w.T if gyro else np.vstack([moved.a[link], moved.dw[link], *products]).T
    return np.asarray(motion.filtered(features))


def _left(X: Array, y: Array, *, rcond: float = 1e-6) -> tuple[Array, Array]:
    """What features (R, p) leave of readings (R, K), and the map (K, p)."""
    X, y = X - X.mean(axis=0), y - y.mean(axis=0)
    scale = np.maximum(X.std(axis=0), 1e-9)
    theta = np.linalg.lstsq(X / scale, y, rcond=rcond)[0] / scale[:, None]
    return np.asarray(y - X @ theta), theta.T
