"""Normal equations of the motion smoother: encoders, jerk and IMUs along one stretch of a log."""

from collections.abc import Iterator
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


@dataclass(frozen=True)
class Normal:
    """Normal equations: lower `band` (4n, Kn), `border` (Kn, g), `corner` (g, g), gradients."""

    band: Array
    border: Array
    corner: Array
    gradient: Array
    corner_gradient: Array


def encoder_information(chunk: Chunk, c: Array, jerk: Array) -> terms.Band:
    """What encoders and jerk, (n,) or (M, n) rad/s^3, say about coefficients `c` (K, n)."""
    band = terms.Band(chunk.intervals, chunk.joints)
    m, every, n = chunk.intervals, chunk.every, chunk.joints
    speed = sampled(c, chunk.knots[:, 1]).transpose(1, 0, 2).reshape(m * every, n)
    at_edges = terms.spline_weights((np.arange(every) + 0.5) / every, chunk.spacing)[:, 0]
    both = np.zeros((2, m * every, n)), np.zeros((2, m * every, n))
    for j, view in enumerate(chunk.views):
        own = slice(chunk.samples)
        both[0][0, own, j], both[0][1, own, j] = view.weights(speed[own, j], chunk.dt)
        both[1][0, own, j], both[1][1, own, j] = view.q, np.nan_to_num(view.edge)
    for B, weight, seen in zip((chunk.knots[:, 0], at_edges), *both, strict=True):
        w, y = (
            np.ascontiguousarray(v.reshape(m, every, n).transpose(1, 0, 2)) for v in (weight, seen)
        )
        band.add(B, w, w * (y - sampled(c, B)))
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


def _lay_out(chunk: Chunk, part: Array, there: Mask, out: Array) -> None:
    """Add to `out` (..., K, V) `part` (4, ..., C, V) of each cell where readings are `there`."""
    m = chunk.intervals
    cells = np.arange(m) // chunk.cell
    for b, own in enumerate(part):
        out[..., b : b + m, :] += own[..., cells, :] * there[:, None]


def normal_equations(
    chunk: Chunk,
    c: Array,
    jerk: terms.Jerk,
    linear: tuple[Cells, ...] = (),
    *,
    constants: Constants = "none",
    told: tuple[Array, ...] | None = None,
) -> Normal:
    """Gradients at `c` (K, n) and information; `told` are the readings expected there."""
    spacing, m, n, count = chunk.spacing, chunk.intervals, chunk.joints, len(chunk.cells)
    precision = jerk.precision
    own = np.diag(precision)
    between = (precision - np.diag(own)) / spacing**3
    band = encoder_information(chunk, c, jerk.relative / np.sqrt(own))
    pull = (jerk_of(c, spacing) / jerk.relative) @ between / jerk.relative
    for a in range(4):
        band.gradient[a : a + m] -= terms.JERK[a] * pull
    slots = list(chosen(chunk, constants)) if linear else []
    total = sum(len(taken) for _, taken, _ in slots)
    border, corner, right = np.zeros((total, m + 3, n)), np.zeros((total, total)), np.zeros(total)
    told = told or tuple(predicted(chunk, c, x) for x, *_ in slots)
    flat = np.zeros((m + 3, 4 * n * n))
    for (x, taken, at), cells, expected in zip(slots, linear, told, strict=True):
        # Of the four coefficients of an interval, and of the constants.
        W = np.zeros((count, len(x.noise), 4, n))
        by_coefficients = chunk.mean_knots(x.fraction).T @ cells.by_motion
        W[..., : x.joints] = by_coefficients / x.spread[:, None, None]
        G = cells.by_constants[:, :, taken] / x.spread[:, None]
        W = np.concatenate([W.reshape(count, -1, 4 * n), G], axis=2)
        H = (W * _share(chunk, x)[:, :, None]).transpose(0, 2, 1) @ W
        _lay_out(chunk, _columns(H, n), x.there, flat)
        both = H[:, : 4 * n, 4 * n :].reshape(count, 4, n, -1).transpose(1, 3, 0, 2)
        _lay_out(chunk, both, x.there, border[at])
        there = np.add.reduceat(x.there.astype(float), chunk.cells)
        corner[at, at] = np.tensordot(there, H[:, 4 * n :, 4 * n :], 1)
        corner[at, at] += x.precision[np.ix_(taken, taken)]
        r: Array = np.zeros((count * chunk.cell, len(x.noise)))
        r[:m] = ((x.y - expected) / x.spread) * x.seen
        r = r.reshape(count, chunk.cell, -1)
        g = (r @ W[..., : 4 * n]).reshape(-1, 4, n)[:m]
        for a in range(4):
            band.gradient[a : a + m] += g[:, a]
        right[at] = np.tensordot(r.sum(axis=1), G, 2) - (x.precision @ x.away)[taken]
    lower = band.added_to(flat.reshape(-1, n, 4 * n))
    terms.couple_jerks(lower, between / spacing**3, jerk.relative)
    whole = lower.reshape(c.size, -1).T, border.reshape(total, c.size).T
    return Normal(*whole, corner, band.gradient.ravel(), right)


def _columns(H: Array, n: int) -> Array:
    """Columns (4, C, n * 4n) of a lower band that belong to an interval's four coefficients."""
    columns = np.zeros((4, len(H), n, 4 * n))
    for k in range(4 * n):
        columns[k // n, :, k % n, : 4 * n - k] = H[:, k, k : 4 * n]
    return columns.reshape(4, len(H), -1)


def chosen(chunk: Chunk, constants: Constants) -> Iterator[tuple[Mounted, Index, slice]]:
    """Each IMU, which of its constants take part, and where they are among all that do."""
    start = 0
    for x in chunk.imus:
        late = len(x.noise) + 6
        first = late if constants == "clock" else 0
        stops = {"none": 0, "clock": late + 1, "place": late + 1, "all": len(x.away)}
        taken = np.arange(first, stops[constants])
        yield x, taken, slice(start, start + len(taken))
        start += len(taken)


def misfit(x: Mounted, told: Array) -> Array:
    """Residual of each channel over its noise, (K,)."""
    r = ((x.y - told) / x.spread) * x.seen
    return np.asarray(np.sqrt(np.sum(r**2, axis=0) / np.maximum(x.seen.sum(axis=0), 1)))


def predicted(chunk: Chunk, c: Array, x: Mounted) -> Array:
    """An IMU's readings (M, K), its bias included."""
    motion = mean_motion(chunk, c[:, : x.joints], x.fraction)
    return np.asarray(link_state(chunk.robot, x.place.link, motion) @ x.place.matrix.T + x.bias)
