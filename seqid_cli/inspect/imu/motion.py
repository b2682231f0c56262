"""IMUs against the encoders: delay, link, axes, gyro.

Whatever the mounting, an accelerometer on a link reads a linear function of the link's
specific force (3), angular acceleration (3) and products of angular velocity (6) in the
link's frame, a gyro one of the angular velocity (3), at the IMU's own time. Both sides
go through the same low-pass; the linear function is fitted to each channel for a range
of clocks (see `imu.clock`).

The p features of a link's motion are X (N, p), the K readings y (N, K); a shift of s
samples compares y(t) with X(t - s). `left` is what a fit leaves of the readings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from seqid_cli.imu.clock import (
    WINDOW_S,
    Likeliest,
    rates_of,
    scan_of,
    search,
)
from seqid_cli.inspect.findings import finding_of
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
TELLS = 0.1  # of the variance, that may be left where a map is to tell axes
MAPPED = 0.03  # standard error of the map that tells axes


@dataclass(frozen=True, kw_only=True)
class LinkFit:
    """How the readings of an IMU follow a link.

    Attributes
    ----------
    imu : Imu
        The IMU.
    gyro : bool
        Whether the readings are of its gyro.
    left : float
        Share of their variance that is left.
    delay, delay_error : float
        Time of the readings behind the encoders in the middle of the log, and its
        standard error [s].
    rate, rate_error : float
        By which the IMU's clock gains on the encoders', zero where that does not show,
        and its standard error [s/s].
    map : (K, p) array
        Readings from the features.
    map_error : float
        Largest standard error of the map of specific force (angular velocity).
    gain : float
        Of all channels together: RMS of what the map makes over that of its features.
    """

    imu: Imu
    gyro: bool
    left: float
    delay: float
    delay_error: float
    rate: float
    rate_error: float
    map: Array
    map_error: float
    gain: float


@dataclass(frozen=True, kw_only=True)
class ShiftScan:
    """Readings against the motion of a link, for shifts of some samples either way."""

    features: Array  # (N, p)
    readings: Array  # (N, K) through the motion's filter
    rows: Index  # that count
    total: float  # mean square of their readings without the mean, all channels
    shifts: Array  # s
    best: Likeliest
    without_rate: Likeliest

    @property
    def share(self) -> float:
        """Share of the variance that the best clock leaves."""
        return self.best.cost

    @property
    def is_at_end(self) -> bool:
        """Whether the best clock is the farthest that was tried."""
        return self.best.clock.offset_s in (self.shifts[0], self.shifts[-1])


def scan(
    motion: Motion,
    features: Array,
    values: Array,
    *,
    max_shift_s: float = 0.06,
    grid: int = 25,
) -> ShiftScan | None:
    """Compare readings with the features of a link over a range of clocks.

    Parameters
    ----------
    motion : Motion
        The filtered motion of the arm.
    features : (N, p) array
        Filtered features of the link's motion.
    values : (N, K) array
        Readings as they are.
    max_shift_s : float
        Largest shift either way [s].
    grid : int
        Number of shifts.

    Returns
    -------
    ShiftScan or None
        None where too few rows can be used.
    """
    reach = max(1, round(max_shift_s * motion.rate_hz))
    step = max(1, round(2 * reach / (grid - 1)))
    readings = motion.lowpass(values, motion.valid)
    return _shifted(motion, features, readings, reach // step, step)


def _shifted(
    motion: Motion,
    features: Array,
    readings: Array,
    reach: int,
    step: int,
    *,
    min_rows: int = 200,
    windows: int = 40,
) -> ShiftScan | None:
    """Scan `reach` shifts of `step` samples either way, by a fourth of some 4000 rows.

    The log is cut into so many `windows` at most.
    """
    farthest = reach * step
    rows = np.flatnonzero(motion.usable)
    rows = rows[(rows >= farthest) & (rows < len(readings) - farthest)]
    rows = rows[:: max(1, len(rows) // 4000)]
    if len(rows) < min_rows:
        return None
    total = float(np.sum(np.var(readings[rows], axis=0)))
    if total == 0.0 or not np.isfinite(total):
        return None

    few = rows[::4]
    rate_hz = motion.rate_hz
    mean = readings[rows].mean(axis=0)
    everywhere = np.ones(len(few))

    def read(stamps: Array) -> tuple[Array, Array]:
        """Return the readings (R, K) at stamps [s], without their mean."""
        return readings[np.rint(stamps * rate_hz).astype(np.intp)] - mean, everywhere

    x = np.column_stack([features[few] - features[few].mean(axis=0), everywhere])
    shifts = np.arange(-reach, reach + 1) * step / rate_hz
    window_s = max(WINDOW_S, len(readings) / rate_hz / windows)
    scans = [scan_of(few / rate_hz, x, read, shifts, window_s=window_s)]
    return ShiftScan(
        features=features,
        readings=readings,
        rows=rows,
        total=total,
        shifts=shifts,
        best=search(scans, rates_of(scans)),
        without_rate=search(scans, np.zeros(1)),
    )


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
    """Fit the readings of an IMU to the motion of its link at the best shift.

    Parameters
    ----------
    robot : Robot
        The arm.
    motion : Motion
        Its filtered motion.
    values : (N, K) array
        Readings of the accelerometers, or of the gyro.
    imu : Imu
        The IMU.
    gyro : bool
        Whether they are of the gyro.
    wide : float
        Share of the variance left, from which larger shifts are tried.
    far_s, step_s : float
        The largest of these, and their spacing [s].

    Returns
    -------
    LinkFit or None
        None where the link rests, or too few rows can be used.
    """
    features = _features(robot, motion, imu.after_joint, gyro=gyro)
    if features is None:
        return None
    best = scan(motion, features, values)
    if best is None:
        return None
    if best.share > wide or best.is_at_end:
        # None near zero fits: look farther, roughly.
        step = max(1, round(step_s * motion.rate_hz))
        reach = min(round(far_s * motion.rate_hz), len(values) // 4) // step
        far = _shifted(motion, best.features, best.readings, reach, step)
        if far is not None and (best.share > FOLLOWS or far.share < 0.5 * best.share):
            best = far
    return _fine(imu, gyro, motion, best)


class _Refined(NamedTuple):
    """The clock that is best to a fraction of a sample.

    `shift` is its delay in the middle of the rows, `drift` by how much it grows from
    one sample to the next, in samples; `errors` (1 or 2,) are those of both. `X` (R, p)
    are the features at its times, `fit` is what they leave.
    """

    shift: float
    drift: float
    errors: Array
    X: Array
    fit: "_MapFit"


def _refined(
    motion: Motion,
    scanned: ShiftScan,
    found: Likeliest,
    *,
    drifts: bool,
    blocks: int = 8,
    memory_s: float = 0.1,
    max_error_s: float = 0.06,
) -> _Refined:
    """Refine a clock by Gauss and Newton, with a rate if it `drifts`.

    Errors are the larger of what white noise leads to and of how the estimates move
    when one of `blocks` parts of the log is left out: a coarse encoder's noise is far
    from white. Rows within `memory_s` count as one. A clock that moves by more than
    `max_error_s` is not determined.
    """
    rate_hz = motion.rate_hz
    rows = scanned.rows
    y = scanned.readings[rows]
    middle = float(rows.mean())
    powers = np.vander(rows - middle, 2, increasing=True)[:, : 1 + drifts]
    start = rate_hz * found.clock.offset_s + found.clock.rate * middle
    clock = np.array([start, found.clock.rate])[: 1 + drifts]
    first = clock.copy()
    slopes = np.gradient(scanned.features, axis=0)
    limit = rate_hz * max_error_s

    errors = np.full(len(clock), np.inf)
    for _ in range(4):
        shift = powers @ clock
        nearest = np.rint(shift)
        at = np.clip(rows - nearest.astype(np.intp), 0, len(scanned.readings) - 1)
        X = scanned.features[at] + (nearest - shift)[:, None] * slopes[at]
        span = _Span.of(X)
        fit = span.fit(y)
        # How the residual moves with the clock, as far as no other map makes up for it.
        moved = slopes[at] @ fit.map.T
        by_clock = np.stack(
            [span.fit(moved * power[:, None]).residual for power in powers.T], axis=2
        )
        information = np.einsum("rka,rkb->ab", by_clock, by_clock)
        pull = -np.einsum("rka,rk->ra", by_clock, fit.residual)
        if not np.all(np.diag(information) > 0.0):
            break
        change = np.linalg.lstsq(information, pull.sum(axis=0), rcond=1e-12)[0]
        if abs(clock[0] + change[0] - first[0]) > limit:
            break
        covariance = np.linalg.pinv(information)
        # What white noise, and what whole parts of the log, make of the clock.
        mean_square = float(np.mean(fit.residual**2))
        row_spacing = float(np.median(np.diff(rows)))
        memory = max(1.0, memory_s * rate_hz / row_spacing)
        parts = [part.sum(axis=0) for part in np.array_split(pull, blocks)]
        by_parts = covariance @ np.transpose(parts)
        by_noise = np.sqrt(memory * mean_square * np.diag(covariance))
        errors = np.maximum(by_noise, np.linalg.norm(by_parts, axis=1))
        clock = clock + change
    drift = float(clock[1]) if drifts else 0.0
    return _Refined(float(clock[0]), drift, errors, X, fit)


def _fine(
    imu: Imu,
    gyro: bool,
    motion: Motion,
    scanned: ShiftScan,
    *,
    memory_s: float = 0.1,
    min_rate: float = 2e-4,
) -> LinkFit:
    """Fit at the clock that is best to a fraction of a sample.

    It has a rate if that is clear, and larger than `min_rate`: twice what two quartzes
    differ by.
    """
    best = _refined(motion, scanned, scanned.best, drifts=True)
    rate_error = float(best.errors[1])
    if not abs(best.drift) > max(SIGMAS * rate_error, min_rate):
        best = _refined(motion, scanned, scanned.without_rate, drifts=False)

    # Size of the map on its features, however few directions these show.
    X = best.X - best.X.mean(axis=0)
    size = max(float(np.linalg.norm(X)), 1e-12)
    mean_square = float(np.mean(best.fit.residual**2))
    memory = max(
        1.0, memory_s * motion.rate_hz / float(np.median(np.diff(scanned.rows)))
    )
    channels = scanned.readings.shape[1]
    return LinkFit(
        imu=imu,
        gyro=gyro,
        left=mean_square * channels / scanned.total,
        delay=best.shift / motion.rate_hz,
        delay_error=float(best.errors[0]) / motion.rate_hz,
        rate=best.drift,
        rate_error=rate_error,
        map=best.fit.map,
        map_error=_map_error(X, mean_square * memory),
        gain=float(np.linalg.norm(X @ best.fit.map.T) / size),
    )


def _map_error(X: Array, variance: float) -> float:
    """Return the largest standard error of a map's first three columns.

    X (N, p) are features without their mean.
    """
    scale = np.maximum(X.std(axis=0), 1e-9)
    _, s, Vt = np.linalg.svd(X / scale, full_matrices=False)
    # It is large where the motion does not show a direction.
    inverse = Vt.T / np.maximum(s, 1e-9 * s[0])
    std_errors = np.sqrt(variance * np.sum(inverse**2, axis=1)) / scale
    return float(std_errors[:3].max())


def _features(
    robot: Robot, motion: Motion, link: int, *, gyro: bool, min_turning: float = 0.02
) -> Array | None:
    """Return filtered features (N, p) of a link's motion, for readings on it.

    None where the link rests, below an RMS of `min_turning` rad/s.
    """
    moved = link_motion(
        robot.chain, robot.gravity, motion.q.T, motion.dq.T, motion.ddq.T
    )
    w = moved.w[link]
    if float(np.sqrt(np.mean(np.sum(w**2, axis=0)))) < min_turning:
        return None
    if gyro:
        return np.asarray(motion.filtered(w.T))
    products = [w[a] * w[b] for a in range(3) for b in range(a, 3)]
    features = np.vstack([moved.a[link], moved.dw[link], *products]).T
    return np.asarray(motion.filtered(features))


class _MapFit(NamedTuple):
    """What features leave of readings (R, K), and the map (K, p) from them."""

    residual: Array
    map: Array


class _Span(NamedTuple):
    """Features (R, p) without their means, by their directions (R, r) that show.

    `inverse` (p, r) takes what is along each direction to the features' coefficients.
    """

    directions: Array
    inverse: Array

    @classmethod
    def of(cls, X: Array, *, rcond: float = 1e-6) -> "_Span":
        """Find directions of features X (R, p), `rcond` times the largest or more."""
        X = X - X.mean(axis=0)
        scale = np.maximum(X.std(axis=0), 1e-9)
        Q, triangle = np.linalg.qr(X / scale)
        U, s, Vt = np.linalg.svd(triangle)
        shows = s > rcond * s[0]
        return cls(
            directions=Q @ U[:, shows],
            inverse=Vt[shows].T / (scale[:, None] * s[shows]),
        )

    def fit(self, y: Array) -> _MapFit:
        """Fit readings y (R, K), without their means, by the features."""
        y = y - y.mean(axis=0)
        along = self.directions.T @ y
        return _MapFit(
            residual=np.asarray(y - self.directions @ along),
            map=np.asarray((self.inverse @ along).T),
        )


def follow(data: LogData) -> list[LinkFit]:
    """Fit every IMU of a log to the motion of its link; none where nothing turns."""
    accelerometers = data.recording.accelerometers
    gyros = data.recording.gyros
    if not data.modelled or not (accelerometers or gyros) or data.motion is None:
        return []
    fits = []
    for imu in data.robot.imus:
        for is_gyro, readings in ((False, accelerometers), (True, gyros)):
            values = readings.get(imu.name)
            if values is None:
                continue
            fit = fit_link(data.robot, data.motion, values, imu, gyro=is_gyro)
            if fit is not None:
                fits.append(fit)
    return fits


def motion_findings(
    data: LogData,
    fits: Sequence[LinkFit],
    *,
    min_delay_s: float = 0.005,
    min_delay_samples: int = 2,
) -> Iterator[InspectionFinding]:
    """Judge how the IMUs follow the encoders.

    Parameters
    ----------
    data : LogData
        The log.
    fits : sequence of LinkFit
        Its IMUs, those of `follow`.
    min_delay_s, min_delay_samples : float, int
        Delay that is worth a finding [s], and the same in samples of the log; also by
        which a drift makes clocks differ from the log's start to its end.
    """
    for fit in fits:
        name = fit.imu.name
        better = _better(data, fit)
        if better:
            yield better
            continue
        if fit.left > FOLLOWS:
            share = percent(fit.left, 0)
            text = f"the motion of its link leaves {share} of its variance unexplained"
            yield finding_of("imu_not_moving", text, name)
            continue

        least_s = max(min_delay_s, min_delay_samples / data.recording.rate_hz)
        resolution_s = _resolution_s(data, fit.imu.after_joint)
        error_s = float(np.hypot(fit.delay_error, resolution_s))
        if abs(fit.delay) > least_s and abs(fit.delay) > SIGMAS * error_s:
            text = (
                f"its readings are {1e3 * fit.delay:.1f} +- {1e3 * error_s:.1g} ms"
                " behind the encoders"
            )
            if fit.rate:
                text += " in the middle of the log"
            yield finding_of("imu_delay", text, name)
        t = data.recording.t
        apart_s = abs(fit.rate) * float(t[-1] - t[0])
        if apart_s > least_s:
            text = (
                "the clocks of IMU and encoders drift apart by"
                f" {1e3 * fit.rate:.2g} +- {1e3 * fit.rate_error:.1g} ms/s"
            )
            yield finding_of("imu_clock_drift", text, name)
        yield from _gyro(fit) if fit.gyro else _axes(data, fit)


def _resolution_s(data: LogData, link: int) -> float:
    """Return the time in which the fastest joint moves by the error of its encoder."""
    # Joints rest anywhere within a count, on one side going forward and on the other
    # going back: the error is even within one step.
    assert data.motion is not None
    dq = data.motion.dq
    moving = data.motion.moving
    counts_per_s = [1e-9]
    for j in range(link + 1):
        rows = moving[:, j]
        if rows.any():
            rms_speed = float(np.sqrt(np.mean(dq[rows, j] ** 2)))
            counts_per_s.append(rms_speed / data.step[j])
    return float(1.0 / np.sqrt(12.0) / max(counts_per_s))


class _Alternative(NamedTuple):
    """Another link, or a joint reversed (-1: none), and the share that it leaves."""

    share: float
    reversed_joint: int
    link: int


def _better(
    data: LogData, fit: LinkFit, *, max_ratio: float = 0.25, min_left: float = 0.01
) -> InspectionFinding | None:
    """Find a link, or a joint reversed, that an IMU follows far better than its own.

    Far better leaves `max_ratio` of the variance; an IMU that leaves less than
    `min_left` follows its link well enough.
    """
    if fit.left < min_left or data.motion is None:
        return None
    robot = data.robot
    own_link = fit.imu.after_joint
    best = _Alternative(max_ratio * fit.left, -1, own_link)
    others = [(-1, link) for link in range(robot.n) if link != own_link]
    others += [(j, own_link) for j in range(own_link + 1) if data.moves(j)]
    for reversed_joint, link in others:
        share = _share_left(data, fit, data.motion, reversed_joint, link)
        if share is not None:
            best = min(best, _Alternative(share, reversed_joint, link))

    names = robot.joint_names
    text = f"{percent(best.share)} of its variance is left against"
    text += f" {percent(fit.left, 0)}"
    if best.reversed_joint >= 0:
        text = f"by IMU {fit.imu.name} it turns the other way round: {text}"
        return finding_of("axis_flipped", text, names[best.reversed_joint], "position")
    if best.link == own_link:
        return None
    text = (
        f"follows the link after {names[best.link]}, not the one after"
        f" {names[own_link]}: {text}"
    )
    return finding_of("imu_wrong_link", text, fit.imu.name)


def _share_left(
    data: LogData, fit: LinkFit, motion: Motion, reversed_joint: int, link: int
) -> float | None:
    """Return the share of variance that a link leaves, a joint reversed or none."""
    robot = data.robot
    sign = np.where(np.arange(robot.n) == reversed_joint, -1.0, 1.0)
    moved = replace(
        motion, q=motion.q * sign, dq=motion.dq * sign, ddq=motion.ddq * sign
    )
    features = _features(robot, moved, link, gyro=fit.gyro)
    if features is None:
        return None
    recording = data.recording
    readings = recording.gyros if fit.gyro else recording.accelerometers
    scanned = scan(moved, features, readings[fit.imu.name])
    return None if scanned is None else scanned.share


def _gyro(fit: LinkFit) -> Iterator[InspectionFinding]:
    """Judge unit, axes and scale of a gyro."""
    if fit.left > TELLS:
        return
    name = fit.imu.name
    text = f"reads {fit.gain:.3g} times the link's angular velocity"
    if abs(fit.gain / np.degrees(1.0) - 1.0) < 0.2:
        yield finding_of("gyro_in_degrees", text, name)
    elif fit.map_error < MAPPED and np.linalg.det(fit.map) < 0.0:
        text = "its gyro fits the link's motion as a mirror image only"
        yield finding_of("imu_left_handed", text, name, f"{name}.g")
    elif abs(fit.gain - 1.0) > 0.15:
        yield finding_of("gyro_scale", text, name)


def _axes(
    data: LogData, fit: LinkFit, *, max_scale_error: float = 0.05
) -> Iterator[InspectionFinding]:
    """Judge the axes by the map of specific force, a rotation behind the axes.

    Scales that are off by less than `max_scale_error` do no harm.
    """
    imu = fit.imu
    of_force = fit.map[:, :3]
    size = float(np.linalg.svd(of_force, compute_uv=False)[0])
    expected_size = np.sqrt(max(len(imu.axes) / 3.0, 1.0))
    is_other_unit = not 0.5 < size / expected_size < 2.0
    if fit.map_error > MAPPED or fit.left > TELLS or is_other_unit:
        return

    # What the channels would read at rest, gravity along each axis of the link.
    gravity = float(np.linalg.norm(data.robot.gravity)) or 9.81
    max_error = data.settings.imus.max_gravity_error
    odd = odd_channel(imu, gravity * of_force.T, gravity, max_error=max_error)
    if odd:
        yield odd
        return
    turned = np.linalg.pinv(imu.axes) @ of_force
    sizes = np.linalg.svd(turned, compute_uv=False)
    scale = float(np.mean(sizes))
    evenness = sizes[2] / sizes[0]
    if np.linalg.det(turned) < 0.0 and evenness > 0.7:
        text = "its accelerometers fit the link's motion as a mirror image only"
        yield finding_of("imu_left_handed", text, imu.name)
    elif abs(scale - 1.0) > max_scale_error and evenness > 0.9:
        text = f"reads {scale:.3g} times the link's specific force"
        yield finding_of("imu_gravity", text, imu.name)
