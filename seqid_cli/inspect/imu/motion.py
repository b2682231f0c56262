"""IMUs against the encoders: delay, link, axes, gyro.

Whatever the mounting, an accelerometer on a link reads a linear function of the link's
specific force (3), angular acceleration (3) and products of angular velocity (6) in the
link's frame, a gyro one of the angular velocity (3), at the IMU's own time. Both sides
go through the same low-pass; the linear function is fitted to each channel for a range
of time shifts.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.imu.readings import odd_channel
from seqid_cli.inspect.material import LogData
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.shares import percent
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
    # largest standard error of the map of specific force (angular velocity)
    map_error: float
    # of all channels together: RMS of what the map makes over that of its features
    gain: float


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
    motion: Motion,
    features: Array,
    values: Array,
    *,
    max_shift_s: float = 0.06,
    grid: int = 25,
) -> ShiftScan | None:
    """Compare readings (N, K) with a link's features (N, p); None where too few rows are usable."""
    reach = max(1, round(max_shift_s * motion.rate_hz))
    shifts = np.unique(np.rint(np.linspace(-reach, reach, grid)).astype(np.intp))
    return _shifted(motion, features, motion.lowpass(values, motion.valid), shifts)


def _shifted(
    motion: Motion,
    features: Array,
    readings: Array,
    shifts: Index,
    *,
    min_rows: int = 200,
) -> ShiftScan | None:
    """What features leave of readings at each shift, by every fourth of some 4000 rows."""
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= shifts[-1]) & (rows < len(readings) - shifts[-1])]
    rows = rows[:: max(1, len(rows) // 4000)]
    total = (
        float(np.sum(np.var(readings[rows], axis=0))) if len(rows) >= min_rows else 0.0
    )
    if total == 0.0 or not np.isfinite(total):
        return None
    few = rows[::4]
    left = [
        np.sum(_left(features[few - s], readings[few])[0] ** 2, axis=1).mean()
        for s in shifts
    ]
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
    features = _features(robot, motion, imu.after_joint, gyro=gyro)
    tried = None if features is None else scan(motion, features, values)
    if tried is None:
        return None
    if tried.share > wide or int(tried.left.argmin()) in (0, len(tried.left) - 1):
        # None near zero fits: look farther, roughly.
        step = max(1, round(step_s * motion.rate_hz))
        reach = min(round(far_s * motion.rate_hz), len(values) // 4) // step * step
        far = _shifted(
            motion, tried.features, tried.readings, np.arange(-reach, reach + 1, step)
        )
        if far is not None and (tried.share > FOLLOWS or far.share < 0.5 * tried.share):
            tried = far
    return _fine(imu, gyro, motion, tried)


def _fine(
    imu: Imu,
    gyro: bool,
    motion: Motion,
    scan: ShiftScan,
    *,
    blocks: int = 8,
    memory_s: float = 0.1,
) -> LinkFit:
    """Fit at the shift that is best to a fraction of a sample, by Gauss and Newton."""
    # The delay's error is the larger of what white noise leads to and of how it moves
    # when one of `blocks` parts of the log is left out: a coarse encoder's noise is far
    # from white.
    rows, y = scan.rows, scan.readings[scan.rows]
    low, high = scan.shifts[[0, -1]]
    shift, slopes = (
        float(scan.shifts[scan.left.argmin()]),
        np.gradient(scan.features, axis=0),
    )
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
        error = (
            max(float(np.sqrt(memory * square * power)), float(np.linalg.norm(parts)))
            / power
        )
    # Size of the map on its features, however few directions these show.
    X = X - X.mean(axis=0)
    gain = float(np.linalg.norm(X @ fitted.T) / max(float(np.linalg.norm(X)), 1e-12))
    share, rate = square * y.shape[1] / scan.total, motion.rate_hz
    map_error = _map_error(X, square * memory)
    return LinkFit(
        imu, gyro, share, shift / rate, error / rate, fitted, map_error, gain
    )


def _map_error(X: Array, variance: float) -> float:
    """Largest standard error of a map's first three columns, of features (N, p) without mean."""
    scale = np.maximum(X.std(axis=0), 1e-9)
    _, s, Vt = np.linalg.svd(X / scale, full_matrices=False)
    # large where the motion does not show a direction
    inverse = Vt.T / np.maximum(s, 1e-9 * s[0])
    spread = np.sqrt(variance * np.sum(inverse**2, axis=1)) / scale
    return float(spread[:3].max())


def _features(
    robot: Robot, motion: Motion, link: int, *, gyro: bool, min_turning: float = 0.02
) -> Array | None:
    """Filtered features (N, p) of a link's motion, for readings on it; None if it rests."""
    moved = link_motion(
        robot.chain, robot.gravity, motion.q.T, motion.dq.T, motion.ddq.T
    )
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


TELLS = 0.1  # of the variance, that may be left where a map is to tell axes
MAPPED = 0.03  # standard error of the map that tells axes


def follow(data: LogData) -> list[LinkFit]:
    """Fit every IMU of a log to the motion of its link; empty where nothing turns."""
    sources = (data.recording.accelerometers, data.recording.gyros)
    if not data.modelled or not any(sources) or data.motion is None:
        return []
    result = []
    for imu in data.robot.imus:
        for gyro, source in zip((False, True), sources, strict=True):
            if (values := source.get(imu.name)) is not None:
                result.append(fit_link(data.robot, data.motion, values, imu, gyro=gyro))
    return [fit for fit in result if fit is not None]


def motion_findings(
    data: LogData,
    fits: list[LinkFit],
    *,
    min_delay_s: float = 0.005,
    min_delay_samples: int = 2,
) -> Iterator[InspectionFinding]:
    """Judge how the IMUs follow the encoders."""
    for item in fits:
        name = item.imu.name
        if better := _better(data, item):
            yield better
            continue
        if item.left > FOLLOWS:
            left = percent(item.left, 0)
            text = f"the motion of its link leaves {left} of its variance unexplained"
            yield found("imu_not_moving", text, name)
            continue
        least, delay = (
            max(min_delay_s, min_delay_samples / data.recording.rate_hz),
            item.delay,
        )
        error = float(
            np.hypot(item.delay_error, _resolution_s(data, item.imu.after_joint))
        )
        if abs(delay) > least and abs(delay) > SIGMAS * error:
            text = (
                f"its readings are {1e3 * delay:.1f} +- {1e3 * error:.1g} ms behind the"
                " encoders"
            )
            yield found("imu_delay", text, name)
        yield from _gyro(item) if item.gyro else _axes(data, item)


def _resolution_s(data: LogData, link: int) -> float:
    """Time that the fastest joint before a link takes for the error of its encoder, s."""
    # Joints rest anywhere within a count, on one side going forward and on the other
    # going back.
    assert data.motion is not None
    dq, moving = data.motion.dq, data.motion.moving
    there = [j for j in range(link + 1) if moving[:, j].any()]
    speeds = [
        float(np.sqrt(np.mean(dq[moving[:, j], j] ** 2))) / data.step[j] for j in there
    ]
    # the error is even within one step
    return float(1.0 / np.sqrt(12.0) / max([*speeds, 1e-9]))


def _better(
    data: LogData, item: LinkFit, *, max_ratio: float = 0.25, min_left: float = 0.01
) -> InspectionFinding | None:
    """Find another link, or a joint reversed, that the IMU follows far better than its own link."""
    motion, robot = data.motion, data.robot
    if item.left < min_left or motion is None:
        return None
    name, own = item.imu.name, item.imu.after_joint
    values = (data.recording.gyros if item.gyro else data.recording.accelerometers)[
        name
    ]
    names = robot.joint_names
    # the joint that is reversed, the link
    tried = [(-1, k) for k in range(robot.n) if k != own]
    tried += [(j, own) for j in range(own + 1) if data.moves(j)]
    best = (max_ratio * item.left, -1, own)
    for joint, link in tried:
        sign = np.where(np.arange(robot.n) == joint, -1.0, 1.0)
        moved = replace(
            motion, q=motion.q * sign, dq=motion.dq * sign, ddq=motion.ddq * sign
        )
        features = _features(robot, moved, link, gyro=item.gyro)
        if features is not None and (scanned := scan(moved, features, values)):
            best = min(best, (scanned.share, joint, link))
    share, joint, link = best
    text = f"{percent(share)} of its variance is left against {percent(item.left, 0)}"
    if joint >= 0:
        text = f"by IMU {name} it turns the other way round: {text}"
        return found("axis_flipped", text, names[joint], "position")
    text = (
        f"follows the link after {names[link]}, not the one after {names[own]}: {text}"
    )
    return None if link == own else found("imu_wrong_link", text, name)


def _gyro(item: LinkFit) -> Iterator[InspectionFinding]:
    size, name = item.gain, item.imu.name
    text = f"reads {size:.3g} times the link's angular velocity"
    if item.left > TELLS:
        return
    if abs(size / np.degrees(1.0) - 1.0) < 0.2:
        yield found("gyro_in_degrees", text, name)
    elif item.map_error < MAPPED and np.linalg.det(item.map) < 0.0:
        text = "its gyro fits the link's motion as a mirror image only"
        yield found("imu_left_handed", text, name, f"{name}.g")
    elif abs(size - 1.0) > 0.15:
        yield found("gyro_scale", text, name)


def _axes(
    data: LogData, item: LinkFit, *, max_scale_error: float = 0.05
) -> Iterator[InspectionFinding]:
    """Judge the axes by the map of specific force, which must be a rotation behind the axes."""
    force, imu = item.map[:, :3], item.imu
    size = float(np.linalg.svd(force, compute_uv=False)[0])
    other_unit = not 0.5 < size / np.sqrt(max(len(imu.axes) / 3.0, 1.0)) < 2.0
    if item.map_error > MAPPED or item.left > TELLS or other_unit:
        return
    gravity = float(np.linalg.norm(data.robot.gravity)) or 9.81
    if odd := odd_channel(imu, gravity * force.T, gravity):
        yield odd
        return
    turned = np.linalg.pinv(imu.axes) @ force
    sizes = np.linalg.svd(turned, compute_uv=False)
    scale, evenness = float(np.mean(sizes)), sizes[2] / sizes[0]
    if np.linalg.det(turned) < 0.0 and evenness > 0.7:
        text = "its accelerometers fit the link's motion as a mirror image only"
        yield found("imu_left_handed", text, imu.name)
    elif abs(scale - 1.0) > max_scale_error and evenness > 0.9:
        text = f"reads {scale:.3g} times the link's specific force"
        yield found("imu_gravity", text, imu.name)
