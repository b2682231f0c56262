"""Normal equations of the motion smoother: encoders, jerk and IMUs along one stretch of a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seqid_cli.motion.smoother_chunk import Chunk, Mounted, jerk_of, mean_motion, motion_at, windows
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

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Constants = Literal["none", "clock", "place", "all"]  # all but the channels' axes: "place"


@dataclass(frozen=True)
class Cells:
    """Jacobians of one IMU in every cell: (C, K, 3, m) in q, dq, ddq, (C, K, g) in constants."""

    by_motion: Array
    by_constants: Array

    def by_coefficients(self, chunk: Chunk, x: Mounted) -> Array:
        """Whitened Jacobians (C, K, 4, m) in the coefficients."""
        J = chunk.mean_knots(x.fraction).T @ self.by_motion
        return np.asarray(J / x.spread[:, None, None])


@dataclass(frozen=True)
class Linear:
    """What the IMUs add to the normal equations, about one motion.

    `blocks` (4, n, n, K) is the information about the coefficients.
    """

    cells: tuple[Cells, ...]
    blocks: Array


@dataclass(frozen=True)
class Normal:
    """Normal equations: lower `band` (4n, Kn), `border` (Kn, g), `corner` (g, g), gradients."""

    band: Array
    border: Array
    corner: Array
    gradient: Array
    corner_gradient: Array


def _encoder_terms(chunk: Chunk, c: Array, band: Band) -> None:
    """Add what the encoders' samples and edges say of the coefficients `c`."""
    m, every, n = chunk.intervals, chunk.every, chunk.joints
    speed = motion_at(chunk, c)[:, 1]
    at_edges = spline_weights((np.arange(every) + 0.5) / every, chunk.spacing)[:, 0]
    both = np.zeros((2, m * every, n)), np.zeros((2, m * every, n))
    for j, view in enumerate(chunk.views):
        both[0][:, : chunk.samples, j] = view.weights(speed[:, j], chunk.dt)
        both[1][:, : chunk.samples, j] = view.q, np.nan_to_num(view.edge)
    for B, weight, seen in zip((chunk.knots[:, 0], at_edges), *both, strict=True):
        w, y = weight.reshape(m, every, n), seen.reshape(m, every, n)
        r = w * (y - B @ windows(c))
        info = np.tensordot(B[:, :, None] * B[:, None, :], w, (0, 1))
        band.add(info, np.tensordot(B, r, (0, 1)))


def encoder_information(chunk: Chunk, c: Array, jerk: Array) -> Band:
    """What encoders and the size of the jerk say about the coefficients `c` (K, n).

    `jerk` is (n,) or (M, n) rad/s^3.
    """
    band = Band(chunk.intervals, chunk.joints)
    _encoder_terms(chunk, c, band)
    row = JERK / chunk.spacing**3
    weight = 1.0 / np.atleast_2d(jerk) ** 2
    pull = jerk_of(c, chunk.spacing) * weight
    band.add(np.multiply.outer(np.outer(row, row), weight), -np.multiply.outer(row, pull))
    return band


def jacobians(chunk: Chunk, c: Array, x: Mounted, *, gains: bool) -> Cells:
    """Jacobians of an IMU about the coefficients `c` (K, n), amid each cell's readings."""
    m, size, head = chunk.intervals, chunk.cell, x.joints
    starts = chunk.cells
    seen = x.there.astype(float)
    count = np.add.reduceat(seen, starts)
    mean = np.add.reduceat(seen * np.arange(m), starts) / np.maximum(count, 1.0)
    amid = np.where(count > 0, mean.astype(int), np.minimum(starts + size // 2, m - 1))
    motion = mean_motion(chunk, c[:, :head], x.fraction)
    q, dq, ddq = np.ascontiguousarray(motion[:, :, amid])
    first, last = np.maximum(starts - 1, 0), np.minimum(starts + size, m - 1)
    rate = (motion[:, :, last] - motion[:, :, first]) / ((last - first) * chunk.spacing)
    chain = chunk.robot.chain
    state = chain_state(chain, chunk.robot.gravity, q, dq, ddq)
    rows = imu_rows(chain, state, dq, x.place)
    return Cells(rows.by_motion, rows.by_constants(np.moveaxis(rate, 2, 0), gains=gains))


def linearised(chunk: Chunk, c: Array, *, gains: bool = False) -> Linear:
    """Information of all IMUs about the coefficients `c` (K, n)."""
    cells = tuple(jacobians(chunk, c, x, gains=gains) for x in chunk.imus)
    blocks = np.zeros((4, chunk.joints, chunk.joints, chunk.intervals + 3))
    alike: dict[bytes, list[tuple[Mounted, Cells]]] = {}
    for pair in zip(chunk.imus, cells, strict=True):
        alike.setdefault(pair[0].there.tobytes(), []).append(pair)
    for pairs in alike.values():
        _add_blocks(blocks, _information(chunk, pairs), chunk, pairs[0][0].there)
    return Linear(cells, blocks)


def _share(chunk: Chunk, x: Mounted) -> Array:
    """Share (C, K) of each cell's intervals with readings in which the channels have one."""
    count = np.maximum(np.add.reduceat(x.there.astype(float), chunk.cells), 1.0)
    if x.seen.all():
        return np.ones((len(count), x.seen.shape[1]))
    return np.asarray(np.add.reduceat(x.seen.astype(float), chunk.cells) / count[:, None])


def _information(chunk: Chunk, pairs: list[tuple[Mounted, Cells]]) -> Array:
    """Information (C, 4, n, 4, n) of one interval with readings in each cell."""
    n, count = chunk.joints, len(chunk.cells)
    H = np.zeros((count, 4, n, 4, n))
    for x, cells in pairs:
        m = x.joints
        J = cells.by_coefficients(chunk, x).reshape(count, -1, 4 * m)
        shared = J * _share(chunk, x)[:, :, None]
        H[:, :, :m, :, :m] += (shared.transpose(0, 2, 1) @ J).reshape(count, 4, m, 4, m)
    return H


def _add_blocks(blocks: Array, H: Array, chunk: Chunk, there: Mask) -> None:
    """Add (C, 4, n, 4, n) of every cell to blocks (4, n, n, K) of the coefficients."""
    m, whole = chunk.intervals, bool(there.all())
    by_part = np.ascontiguousarray(H.transpose(1, 3, 2, 4, 0))
    for a in range(4):
        for b in range(a + 1):
            repeated = np.repeat(by_part[a, b], chunk.cell, axis=-1)[..., :m]
            blocks[a - b, ..., b : b + m] += repeated if whole else repeated * there


def _constants(chunk: Chunk, linear: Linear, constants: Constants) -> tuple[Array, Array]:
    """Border (Kn, g) and corner (g, g) of the constants that take part."""
    used = [chosen(x, constants) for x in chunk.imus]
    n, m, total = chunk.joints, chunk.intervals, sum(len(x) for x in used)
    border = np.zeros((total, m + 3, n))
    corner, start = np.zeros((total, total)), 0
    for x, cells, taken in zip(chunk.imus, linear.cells, used, strict=True):
        count = len(taken)
        own = slice(start, start + count)
        start += count
        share, whole = _share(chunk, x)[:, :, None], bool(x.there.all())
        J = cells.by_coefficients(chunk, x)
        G = cells.by_constants[:, :, taken] / x.spread[:, None]
        flat = J.reshape(*J.shape[:2], -1).transpose(0, 2, 1)
        each = (flat @ (share * G)).reshape(len(G), 4, x.joints, count).transpose(1, 3, 0, 2)
        for a in range(4):
            wide = np.repeat(each[a], chunk.cell, axis=1)[:, :m]
            if not whole:
                wide = wide * x.there[:, None]
            border[own, a : a + m, : x.joints] += wide
        count_there = np.add.reduceat(x.there.astype(float), chunk.cells)[:, None, None]
        corner[own, own] = np.tensordot(count_there * share * G, G, ([0, 1], [0, 1]))
        corner[own, own] += x.precision[np.ix_(taken, taken)]
    return border.reshape(total, (m + 3) * n).T, corner


def normal_equations(
    chunk: Chunk,
    c: Array,
    jerk: Jerk,
    linear: Linear | None = None,
    *,
    constants: Constants = "none",
    told: tuple[Array, ...] | None = None,
) -> Normal:
    """Gradients at the coefficients `c` (K, n), information with the IMUs' from `linear`.

    `constants` are those of the IMUs that take part; `told` the readings expected at `c`, where
    they are known already.
    """
    spacing, m = chunk.spacing, chunk.intervals
    precision = jerk.precision
    own = np.diag(precision)
    between = (precision - np.diag(own)) / spacing**3
    band = encoder_information(chunk, c, jerk.relative / np.sqrt(own))
    pull = (jerk_of(c, spacing) / jerk.relative) @ between / jerk.relative
    for a in range(4):
        band.gradient[a : a + m] -= JERK[a] * pull
    lower = band.banded(linear.blocks if linear else None)
    couple_jerks(lower, between / spacing**3, jerk.relative)
    border, corner = np.zeros((c.size, 0)), np.zeros((0, 0))
    right = []
    if linear:
        border, corner = _constants(chunk, linear, constants)
        told = told or tuple(predicted(chunk, c, x) for x in chunk.imus)
        for x, cells, expected in zip(chunk.imus, linear.cells, told, strict=True):
            right.append(_imu_gradient(chunk, x, cells, constants, expected, band))
    return Normal(
        lower,
        border,
        corner,
        band.gradient.ravel(),
        np.concatenate(right) if right else np.zeros(0),
    )


def chosen(x: Mounted, constants: Constants) -> NDArray[np.intp]:
    """Which of an IMU's constants take part."""
    channels = len(x.noise)
    first = {"none": 0, "clock": channels + 6, "place": 0, "all": 0}[constants]
    stop = {"none": 0, "clock": channels + 7, "place": channels + 7, "all": len(x.away)}[constants]
    return np.arange(first, stop)


def _imu_gradient(
    chunk: Chunk, x: Mounted, cells: Cells, constants: Constants, told: Array, band: Band
) -> Array:
    """Add an IMU's gradient to the coefficients'; return that of its constants."""
    m, size = chunk.intervals, chunk.cell
    J = cells.by_coefficients(chunk, x)
    r = (x.y - told) / x.spread
    if not x.seen.all():
        r *= x.seen
    own = np.pad(r, [(0, len(J) * size - m), (0, 0)]).reshape(len(J), -1, r.shape[1])
    g = (own @ J.reshape(*J.shape[:2], -1)).reshape(-1, 4, x.joints)[:m]
    for a in range(4):
        band.gradient[a : a + m, : x.joints] += g[:, a]
    taken = chosen(x, constants)
    G = cells.by_constants[:, :, taken] / x.spread[:, None]
    return np.asarray(np.tensordot(own.sum(axis=1), G, 2) - (x.precision @ x.away)[taken])


def misfit(x: Mounted, told: Array) -> Array:
    """Residual of each channel over its noise, (K,)."""
    r = ((x.y - told) / x.spread) * x.seen
    return np.asarray(np.sqrt(np.sum(r**2, axis=0) / np.maximum(x.seen.sum(axis=0), 1)))


def state_of(chunk: Chunk, c: Array, x: Mounted) -> ChainState:
    """Motion of the links up to an IMU's, when it was read."""
    motion = mean_motion(chunk, c[:, : x.joints], x.fraction)
    return chain_state(chunk.robot.chain, chunk.robot.gravity, *motion)


def predicted(chunk: Chunk, c: Array, x: Mounted) -> Array:
    """An IMU's readings (M, K), its bias included."""
    return readings(x.place, felt(state_of(chunk, c, x), x.place)) + x.bias
