"""Normal equations of the motion smoother: encoders, jerk and IMUs along one stretch of a log."""

from collections.abc import Iterator
from typing import Literal

import numpy as np

from seqid_cli.motion.imu.sensor import link_slopes, link_state
from seqid_cli.motion.smoother import chunk as splines
from seqid_cli.motion.smoother.chunk import (
    Chunk,
    Jerk,
    Mounted,
    jerk_of,
    mean_motion,
    sampled,
)
from seqid_cli.typing import Array, Index, Mask

# all but the channels' axes: "place"
Constants = Literal["none", "clock", "place", "all"]


# Jacobians (C, K, 3, m) in q, dq, ddq and (C, K, g) in constants
Cells = tuple[Array, Array]
Linear = tuple[Cells, ...]  # of all IMUs
Told = tuple[Array, ...] | None  # their expected readings (M, K), if known


def _encoders(chunk: Chunk, c: Array) -> tuple[Array, Array]:
    """What encoders say of each joint: information (M, n, 4, 4) and gradients (4, M, n)."""
    m, every, n = chunk.intervals, chunk.every, chunk.joints
    at_edges = splines.spline_weights((np.arange(every) + 0.5) / every, chunk.spacing)[
        :, 0
    ]
    speed = sampled(c, chunk.knots[:, 1]).transpose(1, 0, 2).reshape(m * every, n)
    # of samples, and of the edges behind them
    weight, seen = np.zeros((2, 2, m * every, n))
    for j, view in enumerate(chunk.views):
        own = slice(chunk.samples)
        weight[:, own, j] = view.weights(speed[own, j], chunk.dt)
        seen[:, own, j] = view.q, np.nan_to_num(view.edge)
    rows = np.concatenate([chunk.knots[:, 0], at_edges])
    w, y = (
        v.reshape(2, m, every, n).swapaxes(1, 2).reshape(-1, m, n)
        for v in (weight, seen)
    )
    both = (rows[:, :, None] * rows[:, None]).reshape(-1, 16)
    information = np.tensordot(w, both, (0, 0)).reshape(m, n, 4, 4)
    return information, np.tensordot(rows, w * (y - sampled(c, rows)), (0, 0))


def jacobians(chunk: Chunk, c: Array, x: Mounted, *, gains: bool) -> Cells:
    """Jacobians of an IMU about the coefficients `c` (K, n), amid each cell's readings."""
    m, size, head = chunk.intervals, chunk.cell, x.joints
    starts, seen = chunk.cells, x.there.astype(float)
    count = np.add.reduceat(seen, starts)
    mean = np.add.reduceat(seen * np.arange(m), starts) / np.maximum(count, 1.0)
    amid = np.where(count > 0, mean.astype(int), np.minimum(starts + size // 2, m - 1))
    motion = mean_motion(chunk, c[:, :head], x.fraction, amid)
    state = link_state(chunk.robot, x.place.link, motion)
    by_motion = x.place.by_motion(state, link_slopes(chunk.robot, x.place.link, motion))
    seen, lever, turn = x.place.by_place(state)
    late = -np.einsum("nkdm,dmn->nk", by_motion, _rate(chunk, c[:, :head], x.fraction))
    channels = np.eye(x.place.channels)
    own = np.einsum(
        "kl,nka->nkla", channels, seen @ x.place.R if gains else seen[..., :0]
    )
    bias = np.broadcast_to(channels, (len(seen), *channels.shape))
    parts = [
        bias,
        lever,
        turn @ x.place.R,
        late[:, :, None],
        own.reshape(*late.shape, -1),
    ]
    return by_motion, np.concatenate(parts, axis=2)


def _rate(chunk: Chunk, c: Array, fraction: float) -> Array:
    """Time derivatives (3, n, C) of q, dq, ddq in every cell."""
    # Those of the spline where a cell is one interval; of a longer cell the change from
    # the interval before to the one behind, which the noise of a first motion disturbs
    # less.
    m, starts = chunk.intervals, chunk.cells
    if chunk.cell == 1:
        jerk = jerk_of(c, chunk.spacing).T[None]
        return np.concatenate([mean_motion(chunk, c, fraction)[1:], jerk])
    first, last = np.maximum(starts - 1, 0), np.minimum(starts + chunk.cell, m - 1)
    before, after = (mean_motion(chunk, c, fraction, at) for at in (first, last))
    return np.asarray((after - before) / ((last - first) * chunk.spacing))


def linearised(chunk: Chunk, c: Array, *, gains: bool = False) -> Linear:
    """Jacobians of all IMUs about the coefficients `c` (K, n)."""
    return tuple(jacobians(chunk, c, x, gains=gains) for x in chunk.imus)


def normal_equations(
    chunk: Chunk, c: Array, jerk: Jerk, linear: Linear, constants: Constants, told: Told
) -> tuple[Array, ...]:
    """Lower band (4n, Kn), border (Kn, g), corner (g, g), and gradients of both at `c` (K, n)."""
    # Each interval tells of its own four coefficients.
    m, n, count = chunk.intervals, chunk.joints, len(chunk.cells)
    own, pulls = _encoders(chunk, c)
    rise, precision = splines.JERK / chunk.spacing**3, jerk.precision
    unlikely = jerk_of(c, chunk.spacing) / jerk.relative @ precision / jerk.relative
    pulls -= rise[:, None, None] * unlikely
    slots = list(chosen(chunk, constants)) if linear else []
    total = sum(len(taken) for _, taken, _ in slots)
    border, corner, right = (
        np.zeros((total, m + 3, n)),
        np.zeros((total, total)),
        np.zeros(total),
    )
    told = told or tuple(predicted(chunk, c, x) for x, *_ in slots)
    of_cells = np.arange(m) // chunk.cell
    # intervals (M,), cells' coefficients (C, 4n, 4n)
    told_of: list[tuple[Mask, Array]] = []
    for (x, taken, at), cells, expected in zip(slots, linear, told, strict=True):
        by_motion, by_constants = cells
        # Of the four coefficients of an interval, and of the constants.
        W = np.zeros((count, len(x.noise), 4, n))
        by_coefficients = chunk.mean_knots(x.fraction).T @ by_motion
        W[..., : x.joints] = by_coefficients / x.spread[:, None, None]
        G = by_constants[:, :, taken] / x.spread[:, None]
        W = np.concatenate([W.reshape(count, -1, 4 * n), G], axis=2)
        there = np.add.reduceat(x.there.astype(float), chunk.cells)
        # Of each cell's intervals with readings, those in which a channel has one.
        share = (
            np.add.reduceat(x.seen.astype(float), chunk.cells)
            / np.maximum(there, 1.0)[:, None]
        )
        H = (W * share[:, :, None]).transpose(0, 2, 1) @ W
        told_of.append((x.there, H[:, : 4 * n, : 4 * n]))
        both = H[:, : 4 * n, 4 * n :].reshape(count, 4, n, -1).transpose(1, 3, 0, 2)
        for b in range(4):
            border[at, b : b + m] += both[b][:, of_cells] * x.there[:, None]
        corner[at, at] = np.tensordot(there, H[:, 4 * n :, 4 * n :], 1)
        corner[at, at] += x.precision[np.ix_(taken, taken)]
        r: Array = np.zeros((count * chunk.cell, len(x.noise)))
        r[:m] = ((x.y - expected) / x.spread) * x.seen
        r = r.reshape(count, chunk.cell, -1)
        pulls += (r @ W[..., : 4 * n]).reshape(-1, 4, n)[:m].swapaxes(0, 1)
        right[at] = np.tensordot(r.sum(axis=1), G, 2) - (x.precision @ x.away)[taken]
    band, gradient = np.zeros((m + 3, n, 4 * n)), np.zeros((m + 3, n))
    for a in range(4):
        gradient[a : a + m] += pulls[a]
    places = np.tile(np.arange(n * n).reshape(n, n), (4, 4)).ravel()
    rises = np.kron(np.multiply.outer(rise, rise), precision).ravel()
    for start in range(0, m, 256):  # intervals laid out at once
        now = slice(start, start + 256)
        size = 1.0 / jerk.relative[now]
        coupled = (size[:, :, None] * size[:, None]).reshape(-1, n * n)
        H = (coupled.take(places, axis=1) * rises).reshape(-1, 4, n, 4, n)
        for j in range(n):
            H[:, :, j, :, j] += own[now, j]
        H = H.reshape(-1, 4 * n, 4 * n)
        for seen, part in told_of:
            H += part[of_cells[now]] * seen[now, None, None]
        # LAPACK's: entry r of coefficient k is of it and of k + r
        for k in range(4 * n):
            first = start + k // n
            band[first : first + len(H), k % n, : 4 * n - k] += H[:, k, k:]
    whole = band.reshape(c.size, -1).T, border.reshape(total, c.size).T
    return *whole, corner, gradient.ravel(), right


def chosen(
    chunk: Chunk, constants: Constants
) -> Iterator[tuple[Mounted, Index, slice]]:
    """Each IMU, which of its constants take part, and where they are among all that do."""
    start = 0
    for x in chunk.imus:
        late = len(x.noise) + 6
        first = late if constants == "clock" else 0
        stops = {"none": 0, "clock": late + 1, "place": late + 1, "all": len(x.away)}
        taken = np.arange(first, stops[constants])
        yield x, taken, slice(start, start + len(taken))
        start += len(taken)


def predicted(chunk: Chunk, c: Array, x: Mounted) -> Array:
    """An IMU's readings (M, K), its bias included."""
    motion = mean_motion(chunk, c[:, : x.joints], x.fraction)
    return np.asarray(
        link_state(chunk.robot, x.place.link, motion) @ x.place.matrix.T + x.bias
    )
