"""Linear equations of one segment of the IMU calibration, its joint motion eliminated.

About a trajectory c of the moving joints and the constants, the readings, the encoders
and a loose prior on the jerk are linear. The trajectory is eliminated (see
`imu.bordered`), so encoder noise counts as the error in the regressors that it is. What
is left per segment is a small dense system in the constants and in what belongs to the
segment alone: a change of each bias and the offsets of the locked joints.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from seqid_cli.imu.bordered import eliminated
from seqid_cli.imu.calibration.segments import Segment
from seqid_cli.imu.calibration.sensor_model import Constants, design, mounted
from seqid_cli.imu.sensor import link_slopes, link_state
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Index, Mask

ROBUST = 4.685  # Tukey's constant, 95 % efficient on normal noise
# what his weights leave of its mean square
WEIGHED = 1.0 - 6.0 / ROBUST**2 + 15.0 / ROBUST**4


@dataclass(frozen=True)
class Local:
    """Unknowns of one segment.

    `trajectory` (N + 2 REACH, m) are positions of the moving joints at the nodes. `own`
    (C + locked,) are changes of the biases, then offsets of the locked joints.
    """

    trajectory: Array
    own: Array


@dataclass(frozen=True)
class Sizes:
    """Sizes of the noise and of the deflections in a residual."""

    # (G,) factors on the variance that raw readings show: accelerometers, gyro
    noise: Array
    # (n,) rad/s^2 of a node, RMS, by which the joints before the IMU deflect
    deflection: Array


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Sums over the channels of each kind of sensor, of N nodes.

    They are of rows r (N, C) and of their slopes A (N, C, n) in the joints'
    accelerations.
    """

    B: Array  # (N, G, n, n) = A'A, both over the noise that raw readings show
    u: Array  # (N, G, n) = A'r
    squares: Array  # (N, G) = r'r
    count: Array  # (N, G) of readings
    share: Array  # (N,) of a node that each counts


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Readings of one segment minus their prediction, with the motion behind it."""

    value: Array  # (N, C) m/s^2 or rad/s
    good: Mask  # (N, C) readings that count
    motion: Array  # (3, n, N) q, dq, ddq of all joints
    link: Array  # (N, 15) state of the link (see `link_state`)


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """Linear equations of a segment about one point, residual and slopes whitened."""

    segment: Segment
    r: Array  # (N, C)
    J: Array  # (N, C, 3 m) in q, dq, ddq of the moving joints
    G: Array  # (N, C, b) in the constants at `places`, then in `Local.own`
    places: Index  # (s,) among all p, of the constants that the log knows
    off: Array  # (M,) residual of the segment's rows
    outliers: Mask
    weights: Array  # (N, C) robust, zero where a reading does not count
    deflection: Rows  # of the residual
    # of the raw readings' roughness over the root of their number at a node
    jolts: Rows


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """Equations of a segment in the s constants alone that its log knows.

    The trajectory and then the segment's own unknowns (`Local.own`) are eliminated.
    """

    linear: Linearised
    g: Array  # (b,) gradient in the border without priors
    back: Array  # (cells, b) by which the trajectory moves with the border
    free: Array  # (cells,) by which it moves with the border at rest
    own_free: Array  # what is the segment's own moves by own_free - follow @ step
    follow: Array
    covariance: Array  # of that
    precision: Array  # of the priors on it
    gradient: Array  # in the constants
    information: Array

    def followed(self, moves: Array) -> Array:
        """Return changes (N, C, k) of readings by moves (cells, k) of a trajectory."""
        linear = self.linear
        segment = linear.segment
        shape = segment.samples, linear.J.shape[2], moves.shape[1]
        return np.asarray(linear.J @ (segment.at_samples @ moves).reshape(shape))

    def through(self, columns: Array) -> Array:
        """Return columns (..., s) in the constants, of border columns (..., b)."""
        s = self.follow.shape[1]
        return np.asarray(columns[..., :s] - columns[..., s:] @ self.follow)

    def readings(self) -> Array:
        """Return columns (N, C, s) of the readings in the constants.

        The trajectory and the segment's own unknowns follow the constants.
        """
        return self.through(self.linear.G - self.followed(self.back))

    def moved(self, local: Local, step: Array, share: float) -> Local:
        """Return the segment's unknowns after a step (p,) of all constants."""
        of_log = step[self.linear.places]
        change = share * self.own_free - self.follow @ of_log
        moved = share * self.free - self.back @ np.concatenate([of_log, change])
        return Local(
            trajectory=local.trajectory + moved.reshape(local.trajectory.shape),
            own=local.own + change,
        )


def residual(
    segment: Segment, robot: Robot, imu: Imu, constants: Constants, local: Local
) -> Residual:
    """Return the readings of a segment minus their prediction."""
    count = len(constants.bias)
    motion = segment.motion.copy()
    moving = list(segment.moving)
    shape = (segment.samples, 3, len(moving))
    moved = (segment.at_samples @ local.trajectory.ravel()).reshape(shape)
    motion[:, moving] = moved.transpose(1, 2, 0)
    motion[0, list(segment.locked)] += local.own[count:, None]
    x = link_state(robot, imu.after_joint, motion)
    stamps = stamps_of(segment, constants)
    y, good = segment.readings.at(stamps)
    if constants.gyro_delay:
        gyros = slice(len(imu.axes), None)
        later = stamps + constants.gyro_delay
        y[:, gyros] = segment.readings.at(later)[0][:, gyros]
    predicted = x @ mounted(imu, constants).matrix.T
    predicted = predicted + constants.bias + local.own[:count]
    return Residual(value=y - predicted, good=good, motion=motion, link=x)


def stamps_of(segment: Segment, constants: Constants) -> Array:
    """Return the IMU's stamps (N,) s of a segment's nodes, since its readings began."""
    clock = constants.clock(segment.log)
    return np.asarray(segment.t + clock.at(segment.elapsed))


def linearise(
    segment: Segment,
    robot: Robot,
    imu: Imu,
    constants: Constants,
    local: Local,
    sigma: Array,
    sizes: Sizes | None = None,
    weights: Array | None = None,
) -> Linearised:
    """Return the linear equations of one segment about a point.

    Parameters
    ----------
    segment : Segment
        The segment.
    robot : Robot
        The robot.
    imu : Imu
        The IMU.
    constants : Constants
        Constants of the IMU at the point.
    local : Local
        Unknowns of the segment at the point.
    sigma : array (C,)
        Standard deviation of a residual, for the robust weights.
    sizes : Sizes, optional
        Noise and deflections. Without them the noise is that of raw readings, and only
        jolts move the joints.
    weights : array (N, C), optional
        Weights to take instead of robust ones.
    """
    point = residual(segment, robot, imu, constants, local)
    r = point.value
    good = point.good
    x = point.link
    place = mounted(imu, constants)
    count = r.shape[1]

    slopes = place.by_motion(x, link_slopes(robot, imu.after_joint, point.motion))
    J = slopes[..., list(segment.moving)]
    dy = np.gradient(x @ place.matrix.T, segment.spacing, axis=0)
    bias = np.broadcast_to(np.eye(count), (*r.shape, count))
    offsets = slopes[:, :, 0, list(segment.locked)]
    rate = constants.clock(segment.log).rate
    by_constants = design(imu, constants, x, dy, segment.elapsed, rate)
    G = np.concatenate([by_constants, bias, offsets], axis=2)

    # Tukey's weights, unless these are given.
    u = r / (ROBUST * sigma)
    if weights is None:
        weights = np.maximum(1.0 - u**2, 0.0) ** 2
    weights = np.where(good, weights, 0.0)
    # A node weighs as much as all the raw samples that it stands for.
    raw_variance = np.maximum(segment.readings.noise, 1e-6) ** 2
    plain = np.sqrt(weights * segment.share / raw_variance)
    by_ddq = plain[:, :, None] * slopes[:, :, 2]
    # 0 is an accelerometer, 1 a gyro.
    kinds = np.asarray(np.arange(count) >= len(imu.axes), dtype=np.intp)
    if sizes is None:  # jolts alone, rad/s^2 of a node, alike at all joints
        power = float(np.mean(np.sum(J[:, :, 2] ** 2, axis=(1, 2)))) if J.size else 0.0
        jolt = segment.readings.jolts / power / segment.share if power > 0.0 else 0.0
        root = plain
        scaled = plain[:, :, None] * J[:, :, 2] * float(np.sqrt(jolt))
    else:
        over = 1.0 / np.sqrt(sizes.noise[kinds])
        root = plain * over
        scaled = by_ddq * over[:, None] * sizes.deflection
    whiten = _whitener(root, scaled)

    near = segment.readings.near(stamps_of(segment, constants))
    rough = segment.readings.rough[near] / np.sqrt(segment.share)
    known = np.isfinite(rough)
    jolts = _rows(
        by_ddq * known[:, :, None],
        np.where(known, plain * rough, 0.0),
        np.where(known, weights, 0.0),
        kinds,
        1.0,
    )
    band = band_share(segment.cutoff_hz, segment.share, segment.spacing)
    weighed = np.where(plain > 0.0, WEIGHED, 0.0)
    return Linearised(
        segment=segment,
        r=whiten(r[:, :, None])[:, :, 0],
        J=whiten(J.reshape(*r.shape, 3 * J.shape[3])),
        G=whiten(G),
        places=constants.places_of(segment.log),
        off=segment.value - segment.rows @ local.trajectory.ravel(),
        outliers=good & (np.abs(u) >= 1.0),
        weights=weights,
        deflection=_rows(by_ddq, plain * r, weighed, kinds, band),
        jolts=jolts,
    )


@lru_cache(maxsize=64)
def band_share(cutoff_hz: float, share: float, spacing: float) -> float:
    """Return the variance of low-passed white noise of unit variance per node."""
    lowpass = Lowpass(cutoff_hz, share / spacing)
    impulse = np.eye(4 * lowpass.settling + 1)[:, [2 * lowpass.settling]]
    return float(
        share * np.sum(lowpass(impulse, np.ones(len(impulse), dtype=bool)) ** 2)
    )


def _rows(A: Array, rows: Array, counts: Array, kinds: Index, share: float) -> Rows:
    """Return the sums of rows (N, C) and slopes A (N, C, n) by kind of sensor."""
    B = []
    u = []
    squares = []
    count = []
    for kind in range(int(kinds.max()) + 1):
        of_kind = kinds == kind
        across = A[:, of_kind].transpose(0, 2, 1)
        r = rows[:, of_kind]
        B.append(across @ A[:, of_kind])
        u.append((across @ r[:, :, None])[:, :, 0])
        squares.append(np.sum(r**2, axis=1))
        count.append(np.sum(counts[:, of_kind], axis=1))
    return Rows(
        B=np.stack(B, axis=1),
        u=np.stack(u, axis=1),
        squares=np.stack(squares, axis=1),
        count=np.stack(count, axis=1),
        share=np.full(len(A), share),
    )


def _whitener(root: Array, scaled: Array) -> Callable[[Array], Array]:
    """Return the function that scales rows (N, C, b) to unit noise and deflection."""
    # A link moves otherwise than the encoder before its gear shows where the gear bends
    # or has play, and jolts faster than the log's rate alias. Either is in all channels
    # an acceleration that the encoders do not know of; its covariance A A', A =
    # `scaled` (N, C, n) over the readings' noise, has few directions, and so has its
    # inverse's root.
    value, vector = np.linalg.eigh(scaled.transpose(0, 2, 1) @ scaled)
    value = np.maximum(value, 1e-12)
    directions = scaled @ (vector / np.sqrt(value)[:, None, :])
    shrink = 1.0 - 1.0 / np.sqrt(1.0 + value)

    def whiten(rows: Array) -> Array:
        """Return the whitened rows (N, C, b)."""
        rows = root[:, :, None] * rows
        along = shrink[:, :, None] * (directions.transpose(0, 2, 1) @ rows)
        return np.asarray(rows - directions @ along)

    return whiten


def reduced(linear: Linearised, local: Local, drift: Array) -> Reduced:
    """Eliminate the trajectory, then the segment's own unknowns.

    `drift` (C,) are the prior standard deviations of the changes of the biases.
    """
    segment = linear.segment
    G = linear.G
    rows = G.reshape(-1, G.shape[2])
    S = rows.T @ rows
    g = rows.T @ linear.r.ravel()
    back = np.zeros((0, len(g)))
    free = np.zeros(0)
    if segment.moving:
        across = linear.J.transpose(0, 2, 1)
        pulls = across @ np.concatenate([G, linear.r[:, :, None]], axis=2)
        right = segment.at_samples.T @ pulls.reshape(-1, len(g) + 1)
        right[:, -1] += segment.rows.T @ (segment.information * linear.off)
        bordered = eliminated(
            segment.band(across @ linear.J), right[:, :-1], S, right[:, -1], g
        )
        S = bordered.schur
        g = bordered.pull
        back = bordered.back
        free = bordered.free

    precision = np.concatenate([drift, segment.offset_sigma]) ** -2.0
    p = G.shape[2] - len(precision)
    covariance = np.asarray(
        np.linalg.inv(S[p:, p:] + np.diag(precision)), dtype=np.float64
    )
    pull = g[p:] - precision * local.own
    follow = covariance @ S[p:, :p]
    return Reduced(
        linear=linear,
        g=g,
        back=back,
        free=free,
        own_free=covariance @ pull,
        follow=follow,
        covariance=covariance,
        precision=precision,
        gradient=g[:p] - follow.T @ pull,
        information=S[:p, :p] - S[:p, p:] @ follow,
    )
