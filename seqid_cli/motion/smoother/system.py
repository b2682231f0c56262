"""Normal equations of the motion smoother: encoders, jerk and IMUs along one stretch of a log."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from seqid_cli.motion.imu.sensor import link_slopes, link_state
from seqid_cli.motion.smoother import terms
from seqid_cli.motion.smoother.chunk import Chunk, Mounted, jerk_of, mean_motion, sampled
from seqid_cli.typing import Array, Index, Mask

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
class Normal:
    """Normal equations: lower `band` (4n, Kn), `border` (Kn, g), `corner` (g, g), gradients."""

    band: Array
    border: Array
    corner: Array
    gradient: Array
    corner_gradient: Array


def _encoder_terms(chunk: Chunk, c: Array, band: terms.Band) -> None:
    """Add what the encoders' samples and edges say of the coefficients `c`."""
    m, every, n = chunk.intervals, chunk.every, chunk.joints
    speed = sampled(c, chunk.knots[:, 1]).transpose(1, 0, 2).reshape(m * every, n)
    at_edges = terms.spline_weights((np.arange(every) + 0.5) / every, chunk.spacing)[:, 0]
    both = np.zeros((2, m * every, n)), np.zeros((2, m * every, n))
    for j, view in enumerate(chunk.views):
        own = slice(chunk.samples)
        both[0][0, own, j], both[0][1, own, j] = view.weights(speed[own, j], chunk.dt)
        both[1][0, own, j], both[1][1, own, j] = view.q, view.edges
    for B, weight, seen in zip((chunk.knots[:, 0], at_edges), *both, strict=True):
        w, y = (
            np.ascontiguousarray(v.reshape(m, every, n).transpose(1, 0, 2)) for v in (weight, seen)
        )
        band.add(B, w, w * (y - sampled(c, B)))


def encoder_information(chunk: Chunk, c: Array, jerk: Array) -> terms.Band:
    """What encoders and the size of the jerk say about the coefficients `c` (K, n).

    `jerk` is (n,) or (M, n) rad/s^3.
    """
    band = terms.Band(chunk.intervals, chunk.joints)
    _encoder_terms(chunk, c, band)
    weight = 1.0 / np.atleast_2d(jerk) ** 2
    pull = -jerk_of(c, chunk.spacing) * weight
    band.add(terms.JERK[None] / chunk.spacing**3, weight[None], pull[None])
    return band


def jacobians(chunk: Chunk, c: Array, x: Mounted, *, gains: bool) -> Cells:
    """Jacobians of an IMU about the coefficients `c` (K, n), amid each cell's readings."""
    m, size, head = chunk.intervals, chunk.cell, x.joints
    starts = chunk.cells
    seen = x.there.astype(float)
    count = np.add.reduceat(seen, starts)
    mean = np.add.reduceat(seen * np.arange(m), starts) / np.maximum(count, 1.0)
    amid = np.where(count > 0, mean.astype(int), np.minimum(starts + size // 2, m - 1))
    motion = mean_motion(chunk, c[:, :head], x.fraction, amid)
    state = link_state(chunk.robot, x.place.link, motion)
    slopes = link_slopes(chunk.robot, x.place.link, motion)
    by_motion = x.place.by_motion(state, slopes)
    seen, lever, turn = x.place.by_place(state)
    late = -np.einsum("nkdm,dmn->nk", by_motion, _rate(chunk, c[:, :head], x.fraction))
    channels = np.eye(x.place.channels)
    own = np.einsum("kl,nka->nkla", channels, seen @ x.place.R if gains else seen[..., :0])
    bias = np.broadcast_to(channels, (len(seen), *channels.shape))
    parts = [bias, lever, turn @ x.place.R, late[:, :, None], own.reshape(*late.shape, -1)]
    return Cells(by_motion, np.concatenate(parts, axis=2))


def _rate(chunk: Chunk, c: Array, fraction: float) -> Array:
    """Time derivatives (3, n, C) of q, dq, ddq in every cell."""
    # Those of the spline where a cell is one interval; of a longer cell the change from the
    # interval before to the one behind, which the noise of a first motion disturbs less.
    m, starts = chunk.intervals, chunk.cells
    if chunk.cell == 1:
        jerk = jerk_of(c, chunk.spacing).T[None]
        return np.concatenate([mean_motion(chunk, c, fraction)[1:], jerk])
    first, last = np.maximum(starts - 1, 0), np.minimum(starts + chunk.cell, m - 1)
    before, after = (mean_motion(chunk, c, fraction, at) for at in (first, last))
    return np.asarray((after - before) / ((last - first) * chunk.spacing))


def linearised(chunk: Chunk, c: Array, *, gains: bool = False) -> tuple[Cells, ...]:
    """Jacobians of all IMUs about the coefficients `c` (K, n)."""
    return tuple(jacobians(chunk, c, x, gains=gains) for x in chunk.imus)


def _share(chunk: Chunk, x: Mounted) -> Array:
    """Share (C, K) of each cell's intervals with readings in which the channels have one."""
    count = np.maximum(np.add.reduceat(x.there.astype(float), chunk.cells), 1.0)
    if x.seen.all():
        return np.ones((len(count), x.seen.shape[1]))
    return np.asarray(np.add.reduceat(x.seen.astype(float), chunk.cells) / count[:, None])


def _columns(chunk: Chunk, x: Mounted, cells: Cells) -> Array:
    """Information of one interval with readings in each cell."""
    # (4, C, n, 4n): of the columns of a lower band that belong to the interval's four coefficients.
    n, m, count = chunk.joints, x.joints, len(chunk.cells)
    by_joint = np.zeros((count, len(x.noise), 4, n))
    by_joint[..., :m] = cells.by_coefficients(chunk, x)
    J = by_joint.reshape(count, -1, 4 * n)
    H = (J * _share(chunk, x)[:, :, None]).transpose(0, 2, 1) @ J
    columns = np.zeros((4, count, n, 4 * n))
    for k in range(4 * n):
        columns[k // n, :, k % n, : 4 * n - k] = H[:, k, k:]
    return columns


def _coupled(chunk: Chunk, cells: tuple[Cells, ...]) -> Array:
    """Lower band (K, n, 4n) of what all IMUs say about the coefficients."""
    n = chunk.joints
    band = np.empty((chunk.intervals + 3, n * 4 * n))
    parts = [
        (_columns(chunk, x, own).reshape(4, len(chunk.cells), -1), x.there)
        for x, own in zip(chunk.imus, cells, strict=True)
    ]
    _lay_out(chunk, parts, band)
    return band.reshape(-1, n, 4 * n)


def _lay_out(chunk: Chunk, parts: list[tuple[Array, Mask]], out: Array) -> None:
    """Fill `out` (..., K, V) with what intervals with readings add to their four coefficients."""
    # `parts` are pairs of (4, ..., C, V), the same throughout a cell, and whether (M,) there are
    # readings. Where a cell has them in all intervals, but three of its coefficients get the same.
    m, size, starts = chunk.intervals, chunk.cell, chunk.cells
    alike = np.zeros((4, *out.shape[:-2], len(starts), out.shape[-1]))
    for part, there in parts:
        alike += part * np.logical_and.reduceat(there, starts)[:, None]
    total = alike.sum(axis=0)
    out[..., m:, :] = 0.0
    for k in range(min(size, m)):
        own = out[..., k:m:size, :]
        own[...] = total[..., : own.shape[-2], :]
    edges = np.append(starts, m)
    for b in range(1, 4):
        for k in range(b):
            out[..., edges[1:] + k, :] += alike[b]
            out[..., edges[:-1] + k, :] -= alike[b]
    for part, there in parts:
        whole = np.logical_and.reduceat(there, starts)
        rows = np.flatnonzero(there & ~whole[np.arange(m) // size])
        for b in range(4 * bool(len(rows))):
            out[..., rows + b, :] += part[b][..., rows // size, :]


def _constants(
    chunk: Chunk, linear: tuple[Cells, ...], constants: Constants
) -> tuple[Array, Array]:
    """Border (Kn, g) and corner (g, g) of the constants that take part."""
    used = [chosen(x, constants) for x in chunk.imus]
    n, m, total = chunk.joints, chunk.intervals, sum(len(x) for x in used)
    border = np.zeros((total, m + 3, n))
    corner, start = np.zeros((total, total)), 0
    for x, cells, taken in zip(chunk.imus, linear, used, strict=True):
        count = len(taken)
        own = slice(start, start + count)
        start += count
        share = _share(chunk, x)[:, :, None]
        J = cells.by_coefficients(chunk, x)
        G = cells.by_constants[:, :, taken] / x.spread[:, None]
        flat = J.reshape(*J.shape[:2], -1).transpose(0, 2, 1)
        each = (flat @ (share * G)).reshape(len(G), 4, x.joints, count).transpose(1, 3, 0, 2)
        _lay_out(chunk, [(each, x.there)], border[own, :, : x.joints])
        count_there = np.add.reduceat(x.there.astype(float), chunk.cells)[:, None, None]
        corner[own, own] = np.tensordot(count_there * share * G, G, ([0, 1], [0, 1]))
        corner[own, own] += x.precision[np.ix_(taken, taken)]
    return border.reshape(total, (m + 3) * n).T, corner


def normal_equations(
    chunk: Chunk,
    c: Array,
    jerk: terms.Jerk,
    linear: tuple[Cells, ...] = (),
    *,
    constants: Constants = "none",
    told: tuple[Array, ...] | None = None,
) -> Normal:
    """Gradients at the coefficients `c` (K, n), information with the IMUs' Jacobians `linear`.

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
        band.gradient[a : a + m] -= terms.JERK[a] * pull
    lower = band.added_to(_coupled(chunk, linear))
    terms.couple_jerks(lower, between / spacing**3, jerk.relative)
    border, corner = np.zeros((c.size, 0)), np.zeros((0, 0))
    right = []
    if linear:
        border, corner = _constants(chunk, linear, constants)
        told = told or tuple(predicted(chunk, c, x) for x in chunk.imus)
        for x, cells, expected in zip(chunk.imus, linear, told, strict=True):
            right.append(_imu_gradient(chunk, x, cells, constants, expected, band))
    return Normal(
        lower.reshape(c.size, -1).T,
        border,
        corner,
        band.gradient.ravel(),
        np.concatenate(right) if right else np.zeros(0),
    )


def chosen(x: Mounted, constants: Constants) -> Index:
    """Which of an IMU's constants take part."""
    channels = len(x.noise)
    first = {"none": 0, "clock": channels + 6, "place": 0, "all": 0}[constants]
    stop = {"none": 0, "clock": channels + 7, "place": channels + 7, "all": len(x.away)}[constants]
    return np.arange(first, stop)


def _imu_gradient(
    chunk: Chunk, x: Mounted, cells: Cells, constants: Constants, told: Array, band: terms.Band
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


def predicted(chunk: Chunk, c: Array, x: Mounted) -> Array:
    """An IMU's readings (M, K), its bias included."""
    motion = mean_motion(chunk, c[:, : x.joints], x.fraction)
    return np.asarray(link_state(chunk.robot, x.place.link, motion) @ x.place.matrix.T + x.bias)
