"""Normal equations of the motion smoother: encoders, jerk and IMUs along one stretch of a log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.motion.smoother_encoder import EncoderView
from seqid_cli.motion.smoother_terms import (
    JERK,
    Band,
    ChainState,
    Jerk,
    chain_state,
    couple_jerks,
    felt,
    imu_rows,
    readings,
    spline_weights,
)
from seqid_cli.robot.types import Imu, Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELL_S = 0.016  # within which an arm hardly turns


@dataclass(frozen=True)
class Mounted:
    """An IMU in one chunk: readings (M, K) averaged over knot intervals, and its constants."""

    imu: Imu
    y: Array
    seen: Mask  # (M,)
    noise: Array  # (K,) of the averaged readings
    R: Array
    lever: Array
    bias: Array
    turn: Array  # (3,) rad, of R since the calibration
    prior: Array  # (K + 6,) standard deviations of bias, lever and turn
    gyro: bool

    @property
    def constants(self) -> Array:
        """Bias, lever and turn, (K + 6,)."""
        return np.concatenate([self.bias, self.lever, self.turn])


@dataclass(frozen=True)
class Chunk:
    """What one stretch of a log holds; `every` samples per knot."""

    robot: Robot
    views: tuple[EncoderView, ...]
    valid: Mask
    dt: float
    every: int
    imus: tuple[Mounted, ...]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.views)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.valid)

    @property
    def intervals(self) -> int:
        """Number of knot intervals that hold them."""
        return -(-self.samples // self.every)

    @property
    def sampled(self) -> Array:
        """One (M,) for intervals that hold a sample, else zero."""
        view, mask = self.views[0], np.zeros(self.intervals)
        mask[view.start :: view.stride] = 1.0
        return mask

    @property
    def knots(self) -> Array:
        """Weights (every, 3, 4) of the coefficients at an interval's samples."""
        return spline_weights(np.arange(self.every) / self.every, self.every * self.dt)


@dataclass(frozen=True)
class Linear:
    """What the IMUs add to the normal equations, about one motion.

    `blocks` (4, n, n, K), `border` (4, g, C, n), `corner` (g, g).
    """

    cells: Cells
    blocks: Array
    border: Array
    corner: Array


@dataclass(frozen=True)
class Normal:
    """Normal equations: lower `band` (4n, Kn), `border` (Kn, g), `corner` (g, g), gradients."""

    band: Array
    border: Array
    corner: Array
    gradient: Array
    corner_gradient: Array
    misfit: tuple[float, ...]  # normalised residual of each IMU


def windows(c: Array) -> Array:
    """Four coefficients (M, 4, n) of every interval."""
    return np.stack([c[k : len(c) - 3 + k] for k in range(4)], axis=1)


def motion_at(chunk: Chunk, c: Array) -> Array:
    """q, dq, ddq (N, 3, n) at the samples."""
    x = np.tensordot(windows(c), chunk.knots, (1, 2)).transpose(0, 2, 3, 1)
    return x.reshape(-1, *x.shape[2:])[: chunk.samples]


def _encoder_terms(chunk: Chunk, c: Array, band: Band) -> None:
    """Add what the encoders' samples and edges say of the coefficients `c`."""
    m, every, n = chunk.intervals, chunk.every, chunk.joints
    speed = motion_at(chunk, c)[:, 1]
    at_edges = spline_weights((np.arange(every) + 0.5) / every, every * chunk.dt)[:, 0]
    both = np.zeros((2, m * every, n)), np.zeros((2, m * every, n))
    inner = chunk.valid & np.append(chunk.valid[1:], False)
    for j, view in enumerate(chunk.views):
        samples, edges = view.weights(speed[:, j], chunk.dt)
        both[0][:, : chunk.samples, j] = samples * chunk.valid, edges * inner
        both[1][:, : chunk.samples, j] = view.q, np.nan_to_num(view.edge)
    for B, weight, seen in zip((chunk.knots[:, 0], at_edges), *both, strict=True):
        w, y = weight.reshape(m, every, n), seen.reshape(m, every, n)
        r = w * (y - B @ windows(c))
        info = np.tensordot(B[:, :, None] * B[:, None, :], w, (0, 1))
        band.add(info, np.tensordot(B, r, (0, 1)))


def jerk_of(c: Array, spacing: float) -> Array:
    """Jerk (M, n) rad/s^3 in every interval."""
    return np.diff(c, 3, axis=0) / spacing**3


@dataclass(frozen=True)
class Cells:
    """Whitened Jacobians of every IMU, (C, R, 4, n) and (C, R, g), for cells of `size` intervals.

    Jacobians change slowly: one serves all intervals of a cell.
    """

    size: int
    rows: tuple[tuple[Array, Array], ...]


def jacobians(chunk: Chunk, c: Array) -> Cells:
    """Jacobians of all IMUs about the coefficients `c` (K, n), in the middle of each cell."""
    m = chunk.intervals
    size = max(1, int(CELL_S / (chunk.dt * chunk.every)))
    middles = np.minimum(np.arange(0, m, size) + size // 2, m - 1)
    mean = chunk.knots.mean(axis=0)
    q, dq, ddq = np.ascontiguousarray(mean_motion(chunk, c)[:, :, middles])
    chain = chunk.robot.chain
    state = chain_state(chain, chunk.robot.gravity, q, dq, ddq)
    kept = []
    for x in chunk.imus:
        rows = imu_rows(chain, state, dq, x.imu, x.R, x.lever, gyro=x.gyro)
        J = (mean.T @ rows.by_motion) / x.noise[:, None, None]
        kept.append((J, rows.by_constants / x.noise[:, None]))
    return Cells(size, tuple(kept))


def linearised(chunk: Chunk, c: Array, blocks: Array | None = None) -> Linear:
    """Information of all IMUs about the coefficients `c` (K, n) and the constants.

    The information about the coefficients comes first; given as `blocks`, of this motion or one
    nearby, it serves again, and that about the constants joins it.
    Readings that are missing take their share off the whole cell's information.
    """
    n, m, cells = chunk.joints, chunk.intervals, jacobians(chunk, c)
    starts = np.arange(0, m, cells.size)
    count = np.maximum(np.add.reduceat(chunk.sampled, starts), 1.0)
    total = sum(len(x.prior) for x in chunk.imus)
    H = np.zeros((len(starts), 4 * n, 4 * n))
    border = np.zeros((4, total, len(starts), n))
    corner, start = np.zeros((total, total)), 0
    for x, (J, G) in zip(chunk.imus, cells.rows, strict=True):
        own = slice(start, start + len(x.prior))
        start += len(x.prior)
        seen = np.add.reduceat(x.seen.astype(float), starts)[:, None, None]
        flat = J.reshape(*J.shape[:2], -1).transpose(0, 2, 1)
        shared = flat * (seen / count[:, None, None])
        if blocks is None:
            H += shared @ flat.transpose(0, 2, 1)
            continue
        border[:, own] = (shared @ G).reshape(-1, 4, n, len(x.prior)).transpose(1, 3, 0, 2)
        corner[own, own] = np.tensordot(G * seen, G, ([0, 1], [0, 1]))
    if blocks is None:
        blocks = _blocks(H, cells.size, chunk)
    return Linear(cells, blocks, border, corner)


def _blocks(H: Array, size: int, chunk: Chunk) -> Array:
    """Blocks (4, n, n, K) of the coefficients, from one (4n, 4n) for every cell."""
    n, m, sampled = chunk.joints, chunk.intervals, chunk.sampled
    whole = bool(sampled.all())
    by_part = np.ascontiguousarray(H.reshape(-1, 4, n, 4, n).transpose(1, 3, 2, 4, 0))
    blocks = np.zeros((4, n, n, m + 3))
    for a in range(4):
        for b in range(a + 1):
            repeated = np.repeat(by_part[a, b], size, axis=-1)[..., :m]
            blocks[a - b, ..., b : b + m] += repeated if whole else repeated * sampled
    return blocks


def spread(border: Array, size: int, chunk: Chunk) -> Array:
    """Border (Kn, g) of the coefficients, from one (4, g, C, n) for every cell."""
    m, sampled = chunk.intervals, chunk.sampled[:, None]
    whole = np.zeros((border.shape[1], m + 3, border.shape[3]))
    for a in range(4):
        whole[:, a : a + m] += np.repeat(border[a], size, axis=1)[:, :m] * sampled
    return whole.reshape(len(whole), -1).T


def encoder_information(chunk: Chunk, c: Array, jerk: Array) -> Band:
    """What encoders and the size (n,) of the jerk say about the coefficients `c` (K, n)."""
    spacing = chunk.every * chunk.dt
    band = Band(chunk.intervals, chunk.joints)
    _encoder_terms(chunk, c, band)
    row = JERK[:, None] / (spacing**3 * jerk)
    band.add((row[:, None] * row)[:, :, None], -row[:, None] * (jerk_of(c, spacing) / jerk))
    return band


def normal_equations(
    chunk: Chunk, c: Array, jerk: Jerk, linear: Linear | None = None, *, bordered: bool = False
) -> Normal:
    """Gradients at the coefficients `c` (K, n), information with the IMUs' from `linear`."""
    n, m = chunk.joints, chunk.intervals
    precision = jerk.precision
    own = np.diag(precision)
    between = (precision - np.diag(own)) / (chunk.every * chunk.dt) ** 3
    band = encoder_information(chunk, c, 1.0 / np.sqrt(own))
    pull = jerk_of(c, chunk.every * chunk.dt) @ between
    for a in range(4):
        band.gradient[a : a + m] -= JERK[a] * pull
    lower = band.banded(linear.blocks if linear else None)
    couple_jerks(lower, between / (chunk.every * chunk.dt) ** 3, m)
    if linear is None:
        none = np.zeros((c.size, 0))
        return Normal(lower, none, np.zeros((0, 0)), band.gradient.ravel(), np.zeros(0), ())
    right, misfit = [], []
    for x, (J, G), told in zip(
        chunk.imus, linear.cells.rows, predicted(chunk, state_of(chunk, c)), strict=True
    ):
        r = np.where(x.seen[:, None], (x.y - told) / x.noise, 0.0)
        misfit.append(float(np.sqrt(np.sum(r**2) / max(x.seen.sum() * r.shape[1], 1))))
        cells = np.pad(r, [(0, len(J) * linear.cells.size - m), (0, 0)]).reshape(
            len(J), -1, r.shape[1]
        )
        g = (cells @ J.reshape(*J.shape[:2], -1)).reshape(-1, 4, n)[:m]
        for a in range(4):
            band.gradient[a : a + m] += g[:, a]
        right.append(np.tensordot(cells.sum(axis=1), G, 2) - x.constants / x.prior**2)
    prior = np.concatenate([x.prior for x in chunk.imus])
    return Normal(
        lower,
        spread(linear.border, linear.cells.size, chunk) if bordered else np.zeros((c.size, 0)),
        linear.corner + np.diag(prior**-2.0) if bordered else np.zeros((0, 0)),
        band.gradient.ravel(),
        np.concatenate(right),
        tuple(misfit),
    )


def mean_motion(chunk: Chunk, c: Array) -> Array:
    """q, dq, ddq (3, n, M) averaged over every interval's samples."""
    x = np.tensordot(chunk.knots.mean(axis=0), windows(c), (1, 1))
    return np.ascontiguousarray(x.transpose(0, 2, 1))


def state_of(chunk: Chunk, c: Array) -> ChainState:
    """Every link's motion in the middle of the intervals."""
    return chain_state(chunk.robot.chain, chunk.robot.gravity, *mean_motion(chunk, c))


def predicted(chunk: Chunk, state: ChainState) -> list[Array]:
    """Every IMU's readings (M, K), its bias included."""
    return [
        readings(x.imu, felt(state, x.imu.after_joint, x.R, x.lever), gyro=x.gyro) + x.bias
        for x in chunk.imus
    ]
