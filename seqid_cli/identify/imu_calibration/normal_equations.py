"""One segment of the IMU calibration: its linear equations with the joint motion taken out.

About a trajectory c of the moving joints and the constants, the readings, the encoders and a
loose prior on the jerk are linear. The trajectory is eliminated by the banded Cholesky factor of
its own normal equations, so encoder noise counts as the error in the regressors that it is; what is
left per segment is a small dense system in the constants and in what belongs to the segment alone:
a change of each bias and the offsets of the locked joints.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from seqid_cli.identify.imu_calibration import sensor_model
from seqid_cli.identify.imu_calibration.segments import REACH, EncoderRows, Segment
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import FIRST, SECOND
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Index, Mask

WIDTH = 2 * REACH + 1
THIRD = np.array([-1.0, 3.0, -3.0, 1.0])
ROBUST = 4.685  # Tukey's constant, 95 % efficient on normal noise
WEIGHED = 1.0 - 6.0 / ROBUST**2 + 15.0 / ROBUST**4  # what his weights leave of its mean square


@dataclass(frozen=True)
class Local:
    """What is a segment's own: `trajectory` (N + 2 REACH, m), `bias` (C,), `offset` (locked,)."""

    trajectory: Array
    bias: Array
    offset: Array


@dataclass(frozen=True)
class Sizes:
    """What a residual is made of.

    `noise` (G,) are factors on the variance that raw readings show of theirs, one for each kind of
    sensor (`kinds_of`), `deflection` (n,) the standard deviation of the accelerations by which the
    joints before the IMU deflect, rad/s^2 of a node.
    """

    noise: Array
    deflection: Array


@dataclass(frozen=True)
class Rows:
    """Sums of rows r (N, C) over accelerations, by kind of sensor (G).

    `B` (N, G, n, n) = A'A and `u` (N, G, n) = A'r; A (N, C, n) are the slopes in the accelerations
    of all joints before the IMU, both over the noise that raw readings show; `squares` (N, G) is
    r'r, `count` (N, G) of readings, `share` (N,) of a node that each counts.
    """

    B: Array
    u: Array
    squares: Array
    count: Array
    share: Array


@dataclass(frozen=True)
class Linearised:
    """A segment about one point: residual `r` (N, C), `J` and border `G`, all whitened.

    `J` (N, C, 3, m) is in q, dq, ddq of the moving joints. The border (N, C, b) is in the
    constants, then bias changes, then offsets. `used` says which readings count, `weights` (N, C)
    are robust. `deflection` has rows of the residual, `jolts` of the raw readings' roughness over
    the root of their number at a node; `jerk_residual` is (N + 2 REACH - 3, m).
    """

    segment: Segment
    r: Array
    used: Mask
    J: Array
    G: Array
    encoder_residuals: tuple[Array, ...]
    jerk_residual: Array
    outliers: Mask
    weights: Array
    deflection: Rows
    jolts: Rows


@dataclass(frozen=True)
class Reduced:
    """Normal equations `S` (b, b), `g` (b,) after elimination, and the way back.

    The trajectory moves by `back` (cells, b) with the border, by `free` (cells,) with it at rest.
    """

    linear: Linearised
    S: Array
    g: Array
    back: Array
    free: Array


def stencils(spacing: float) -> Array:
    """Weights (3, 9) of nine nodes in q, dq and ddq at the middle one."""
    return np.stack([np.eye(WIDTH)[REACH], FIRST / spacing, SECOND / spacing**2])


def _taps(segment: Segment) -> Iterator[tuple[slice, int, float]]:
    """Nodes, derivative and weight of all terms of `stencils`."""
    weights = stencils(segment.spacing)
    for o, kind in zip(*np.nonzero(weights.T), strict=True):
        yield slice(o, o + segment.samples), int(kind), float(weights[kind, o])


def at_samples(segment: Segment, nodes: Array) -> Array:
    """q, dq, ddq (N, 3, ...) at the samples from values at the nodes (N + 2 REACH, ...)."""
    out = np.zeros((segment.samples, 3, *nodes.shape[1:]))
    for where, kind, weight in _taps(segment):
        out[:, kind] += weight * nodes[where]
    return out


def joints_of(segment: Segment, local: Local) -> tuple[Array, Array, Array]:
    """Motion (N, n) of all joints: the trajectory, and locked joints with their offsets."""
    q, dq, ddq = segment.q.copy(), segment.dq.copy(), segment.ddq.copy()
    moving = list(segment.moving)
    x = at_samples(segment, local.trajectory)
    q[:, moving], dq[:, moving], ddq[:, moving] = x[:, 0], x[:, 1], x[:, 2]
    q[:, list(segment.locked)] += local.offset
    return q, dq, ddq


def residual(
    segment: Segment, robot: Robot, imu: Imu, constants: sensor_model.Constants, local: Local
) -> tuple[Array, Mask, Array]:
    """Readings minus prediction (N, C), which of them count, and the link's motion (N, 15)."""
    x = sensor_model.link_state(robot, imu.after_joint, *joints_of(segment, local))
    y, good = segment.readings.at(segment.t + constants.delay)
    r = y - sensor_model.predicted(sensor_model.mounted(imu, constants), x) - local.bias
    return r, good, x


def linearise(
    segment: Segment,
    robot: Robot,
    imu: Imu,
    constants: sensor_model.Constants,
    local: Local,
    sigma: Array,
    sizes: Sizes | None = None,
    weights: Array | None = None,
) -> Linearised:
    """Equations of one segment.

    `sigma` (C,) is the noise of a residual, for robust weights; without `sizes` the noise is that
    of raw readings, and joints are moved by jolts alone.
    """
    r, good, x = residual(segment, robot, imu, constants, local)
    motion, channels = joints_of(segment, local), sensor_model.mounted(imu, constants)
    A, c = channels.matrix, r.shape[1]

    def slopes(joints: tuple[int, ...], kind: int) -> Array:
        return A @ sensor_model.link_state_slopes(robot, imu.after_joint, motion, joints, kind)

    J = np.stack([slopes(segment.moving, kind) for kind in range(3)], axis=2)
    dy = np.gradient(sensor_model.predicted(channels, x), segment.spacing, axis=0)
    own = np.broadcast_to(np.eye(c), (len(r), c, c))
    G = np.concatenate(
        [sensor_model.design(channels, x, dy), own, slopes(segment.locked, 0)], axis=2
    )
    u = r / (ROBUST * sigma)
    outliers = good & (np.abs(u) >= 1.0)
    if weights is None:
        weights = np.maximum(1.0 - u**2, 0.0) ** 2
    weights = np.where(good, weights, 0.0)
    # As much as all the raw samples that a node stands for.
    plain = np.sqrt(weights * segment.share / np.maximum(segment.readings.noise, 1e-6) ** 2)
    by_ddq = plain[:, :, None] * slopes(tuple(range(imu.after_joint + 1)), 2)
    kinds = kinds_of(imu)
    if sizes is None:
        root, scaled = plain, plain[:, :, None] * J[:, :, 2] * _jolt(segment, J[:, :, 2])
    else:
        over = 1.0 / np.sqrt(sizes.noise[kinds])
        root, scaled = plain * over, by_ddq * over[:, None] * sizes.deflection
    whiten = _whitener(root, scaled)
    rough = segment.readings.rough_at(segment.t + constants.delay) / np.sqrt(segment.share)
    known = np.isfinite(rough)
    counts = np.where(plain > 0.0, WEIGHED, 0.0), np.where(known, weights, 0.0)
    raw = by_ddq * known[:, :, None], np.where(known, plain * rough, 0.0)
    band = band_share(segment.cutoff_hz, segment.share, segment.spacing)
    return Linearised(
        segment=segment,
        r=whiten(r[:, :, None])[:, :, 0],
        used=weights > 0,
        J=whiten(J.reshape(*r.shape, -1)).reshape(J.shape),
        G=whiten(G),
        encoder_residuals=tuple(
            rows.value - np.sum(rows.weights * _gathered(rows, local.trajectory[:, j]), axis=1)
            for j, rows in enumerate(segment.encoders)
        ),
        jerk_residual=-np.diff(local.trajectory, 3, axis=0) / segment.spacing**3,
        outliers=outliers,
        weights=weights,
        deflection=_rows(by_ddq, plain * r, counts[0], kinds, band),
        jolts=_rows(*raw, counts[1], kinds, 1.0),
    )


def kinds_of(imu: Imu) -> Index:
    """Kind (C,) of every channel's sensor: 0 for accelerometers, 1 for the gyro."""
    axes, _, accelerometers = sensor_model.channels_of(imu)
    return np.asarray(np.arange(len(axes)) >= accelerometers, dtype=np.intp)


@lru_cache(maxsize=64)
def band_share(cutoff_hz: float, share: float, spacing: float) -> float:
    """Variance that the low-pass leaves of white noise of unit variance per node."""
    lowpass = Lowpass(cutoff_hz, share / spacing)
    impulse = np.eye(4 * lowpass.settling + 1)[:, [2 * lowpass.settling]]
    return float(share * np.sum(lowpass(impulse, np.ones(len(impulse), dtype=bool)) ** 2))


def _rows(A: Array, rows: Array, counts: Array, kinds: Index, share: float) -> Rows:
    parts = []
    for kind in range(int(kinds.max()) + 1):
        own = kinds == kind
        across, r = A[:, own].transpose(0, 2, 1), rows[:, own]
        u = (across @ r[:, :, None])[:, :, 0]
        squares, count = np.sum(r**2, axis=1), np.sum(counts[:, own], axis=1)
        parts.append((across @ A[:, own], u, squares, count))
    B, u, squares, count = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
    return Rows(B, u, squares, count, np.full(len(A), share))


def _jolt(segment: Segment, by_ddq: Array) -> float:
    """Jolts' acceleration, rad/s^2 of a node, alike at all joints with slopes (N, C, m)."""
    power = float(np.mean(np.sum(by_ddq**2, axis=(1, 2)))) if by_ddq.size else 0.0
    return float(np.sqrt(segment.readings.jolts / power / segment.share)) if power > 0.0 else 0.0


def _whitener(root: Array, scaled: Array) -> Callable[[Array], Array]:
    """Scale rows (N, C, b) to unit noise, the joints' deflection included."""
    # A link moves otherwise than the encoder before its gear shows where the gear bends or has
    # play, and jolts faster than the log's rate alias. Either is in all channels an acceleration
    # that the encoders do not know of; its covariance A A', A = `scaled` (N, C, n) over the
    # readings' noise, has few directions, and so has its inverse's root.
    value, vector = np.linalg.eigh(scaled.transpose(0, 2, 1) @ scaled)
    value = np.maximum(value, 1e-12)
    directions = scaled @ (vector / np.sqrt(value)[:, None, :])
    shrink = 1.0 - 1.0 / np.sqrt(1.0 + value)

    def whiten(rows: Array) -> Array:
        rows = root[:, :, None] * rows
        along = shrink[:, :, None] * (directions.transpose(0, 2, 1) @ rows)
        return np.asarray(rows - directions @ along)

    return whiten


def _gathered(rows: EncoderRows, nodes: Array) -> Array:
    return np.asarray(nodes[rows.at[:, None] + np.arange(4)])


def reduced(linear: Linearised) -> Reduced:
    """Eliminate the trajectory."""
    segment, J, G = linear.segment, linear.J, linear.G
    m, b = len(segment.moving), G.shape[2]
    rows = G.reshape(-1, b)
    S, g = rows.T @ rows, rows.T @ linear.r.ravel()
    if not m:
        return Reduced(linear, S, g, np.zeros((0, b)), np.zeros(0))
    J3 = np.moveaxis(J.reshape(*J.shape[:2], -1), 1, 2)  # (N, 3 m, C)
    cross = J3 @ np.concatenate([G, linear.r[:, :, None]], axis=2)
    # Transpose of `at_samples`: (N, 3, ...) to (N + 2 REACH, ...).
    values = cross.reshape(len(G), 3, m, b + 1)
    out = np.zeros((segment.samples + 2 * REACH, *values.shape[2:]))
    for where, kind, weight in _taps(segment):
        out[where] += weight * values[:, kind]
    right = out.reshape(-1, b + 1)
    right[:, b] += _own_gradient(linear).ravel()
    factor = cholesky_banded(_band(linear), lower=True, check_finite=False)
    solved = cho_solve_banded((factor, True), right, check_finite=False)
    both = right[:, :b].T @ solved
    return Reduced(linear, S - both[:, :b], g - both[:, b], solved[:, :b], solved[:, b])


def _band(linear: Linearised) -> Array:
    """Lower band of the trajectory's normal equations, joints interleaved."""
    segment, J = linear.segment, linear.J
    m, n = len(segment.moving), segment.samples
    JJ = np.einsum("ncdi,ncej->nijde", J, J, optimize=True)
    weights = stencils(segment.spacing)
    nodes = n + 2 * REACH
    band = np.zeros((WIDTH * m, nodes * m))
    for o in range(WIDTH):
        for p in range(o + 1):
            block = np.einsum("nijde,d,e->nij", JJ, weights[:, o], weights[:, p])
            for i in range(m):
                for j in range(m):
                    row = (o - p) * m + i - j
                    if row >= 0:
                        band[row, p * m + j : (p + n) * m + j : m] += block[:, i, j]
    for j, rows in enumerate(segment.encoders):
        third = THIRD / segment.spacing**3 / segment.jerk[j]
        for a in range(4):
            for c in range(a + 1):
                value = rows.information * rows.weights[:, a] * rows.weights[:, c]
                np.add.at(band[(a - c) * m], (rows.at + c) * m + j, value)
                span = slice(c * m + j, (c + nodes - 3) * m + j, m)
                band[(a - c) * m, span] += third[a] * third[c]
    return band


def _own_gradient(linear: Linearised) -> Array:
    """What encoders and jerk pull on the trajectory, (N + 2 REACH, m)."""
    segment = linear.segment
    out = np.zeros((segment.samples + 2 * REACH, len(segment.moving)))
    pull = linear.jerk_residual / segment.jerk**2
    for a in range(4):
        for j, rows in enumerate(segment.encoders):
            off = rows.information * rows.weights[:, a] * linear.encoder_residuals[j]
            np.add.at(out[:, j], rows.at + a, off)
        out[a : a + len(pull)] += THIRD[a] / segment.spacing**3 * pull
    return out


def effective(reduction: Reduced) -> tuple[Array, tuple[Array, ...], Array]:
    """Columns left of the border once the trajectory has followed it.

    Of the readings (N, C, b), of each joint's encoder rows (M, b) and of the jerk
    (N + 2 REACH - 3, m, b).
    """
    linear, segment = reduction.linear, reduction.linear.segment
    m, b = len(segment.moving), linear.G.shape[2]
    back = reduction.back.reshape(segment.samples + 2 * REACH, m, b)
    moved = at_samples(segment, back).reshape(segment.samples, 3 * m, b)
    readings = linear.G - linear.J.reshape(*linear.r.shape, -1) @ moved
    encoders = tuple(
        -np.einsum("ra,rab->rb", rows.weights, _gathered(rows, back[:, j]))
        for j, rows in enumerate(segment.encoders)
    )
    return readings, encoders, -np.diff(back, 3, axis=0) / segment.spacing**3
