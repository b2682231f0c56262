"""Normal equations of the motion smoother: encoders, jerk and IMUs along one stretch.

The unknowns are the coefficients c of all joints, knot after knot, and the constants of
the IMUs behind them. An interval concerns four coefficients of each joint alone, so
that the information is a band with a border:

    [ band    border ]
    [ border' corner ].

The letters are those of `chunk`; P is the number of all constants that take part.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from seqid_cli.imu.sensor import constant_slopes, link_slopes, link_state
from seqid_cli.imu.smoother import chunk as splines
from seqid_cli.imu.smoother.chunk import (
    Chunk,
    Jerk,
    Mounted,
    jerk_of,
    mean_motion,
    sampled,
)
from seqid_cli.typing import Array, Index, Mask

# Constants that take part; "place" is all but the channels' axes.
Constants = Literal["none", "clock", "place", "all"]

BLOCK = 256  # intervals whose matrices are laid out at once


class Cells(NamedTuple):
    """Jacobians of an IMU in every cell.

    `by_motion` (C, L, 3, m) in q, dq, ddq of its joints, `by_constants` (C, L, g).
    `amid` (C,) are the intervals about which they are taken.
    """

    by_motion: Array
    by_constants: Array
    amid: Index


Linear = tuple[Cells, ...]  # of all IMUs
Expected = tuple[Array, ...] | None  # readings (M, L) of all IMUs, if computed


class Slot(NamedTuple):
    """An IMU, those of its constants that take part, and their places among all."""

    imu: Mounted
    taken: Index
    at: slice


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """Information about coefficients and constants, and gradients.

    Attributes
    ----------
    band : Array
        (4 n, K n), the lower band as LAPACK has it.
    border : Array
        (K n, P).
    corner : Array
        (P, P).
    gradient : Array
        (K n,) of the coefficients.
    constants_gradient : Array
        (P,) of the constants.
    """

    band: Array
    border: Array
    corner: Array
    gradient: Array
    constants_gradient: Array


class _Encoders(NamedTuple):
    """What encoders say of each joint in each interval.

    `information` (M, n, 4, 4) about its four coefficients, `gradient` (4, M, n).
    """

    information: Array
    gradient: Array


def _encoders(chunk: Chunk, c: Array) -> _Encoders:
    """Compute what encoders say about the coefficients `c` (K, n)."""
    m = chunk.intervals
    every = chunk.every
    n = chunk.joints
    speed = sampled(c, chunk.knots[:, 1]).transpose(1, 0, 2).reshape(m * every, n)

    # Of samples (0) and of the edges behind them (1): weights and positions.
    weight = np.zeros((2, m * every, n))
    position = np.zeros((2, m * every, n))
    samples = slice(chunk.samples)
    for j, view in enumerate(chunk.views):
        of_samples, of_edges = view.weights(speed[samples, j], chunk.dt)
        weight[0, samples, j] = of_samples
        weight[1, samples, j] = of_edges
        position[0, samples, j] = view.q
        position[1, samples, j] = np.nan_to_num(view.edge)

    # By place within the interval: first its samples, then its edges.
    def by_place(values: Array) -> Array:
        return values.reshape(2, m, every, n).swapaxes(1, 2).reshape(-1, m, n)

    u_edges = (np.arange(every) + chunk.views[0].edge_offset) / every
    at_edges = splines.spline_weights(u_edges, chunk.spacing)[:, 0]
    rows = np.concatenate([chunk.knots[:, 0], at_edges])
    w = by_place(weight)
    y = by_place(position)
    products = (rows[:, :, None] * rows[:, None]).reshape(-1, 16)
    return _Encoders(
        information=np.tensordot(w, products, (0, 0)).reshape(m, n, 4, 4),
        gradient=np.tensordot(rows, w * (y - sampled(c, rows)), (0, 0)),
    )


def jacobians(chunk: Chunk, c: Array, x: Mounted, *, gains: bool) -> Cells:
    """Compute the Jacobians of an IMU about the coefficients `c` (K, n).

    They are taken amid each cell's readings. `gains` says whether the channels' axes
    are among the constants.
    """
    # The interval in the middle of the readings of each cell, or of the cell.
    starts = chunk.cells
    has_reading = x.there.astype(float)
    count = np.add.reduceat(has_reading, starts)
    intervals = has_reading * np.arange(chunk.intervals)
    mean = np.add.reduceat(intervals, starts) / np.maximum(count, 1.0)
    middle = np.minimum(starts + chunk.cell // 2, chunk.intervals - 1)
    amid = np.where(count > 0, mean.astype(int), middle)

    of_head = c[:, : x.joints]
    motion = mean_motion(chunk, of_head, x.fraction, amid)
    state = link_state(chunk.robot, x.place.link, motion)
    slopes = link_slopes(chunk.robot, x.place.link, motion)
    by_motion = x.place.by_motion(state, slopes)

    rate = _rate(chunk, of_head, x.fraction)
    dy = np.einsum("nkdm,dmn->nk", by_motion, rate)
    amid_samples = x.fraction[amid] + 0.5 * (chunk.every - 1)
    t = chunk.from_middle[amid] + amid_samples * chunk.dt
    by_constants = constant_slopes(x.place, state, dy, t, x.rate)

    # A channel's reading depends on its own axis alone.
    by_axis = by_constants.by_axis
    in_imu = by_axis @ x.place.R if gains else by_axis[..., :0]
    by_axes = np.einsum("kl,nka->nkla", np.eye(x.place.channels), in_imu)
    parts = [by_constants.head, by_axes.reshape(*dy.shape, -1)]
    return Cells(by_motion, np.concatenate(parts, axis=2), amid)


def _rate(chunk: Chunk, c: Array, fraction: Array) -> Array:
    """Compute the time derivatives (3, n, C) of q, dq, ddq in every cell.

    They are those of the spline where a cell is one interval. Of a longer cell they are
    the change from the interval before to the one behind, which the noise of a first
    motion disturbs less.
    """
    if chunk.cell == 1:
        jerk = jerk_of(c, chunk.spacing).T[None]
        return np.concatenate([mean_motion(chunk, c, fraction)[1:], jerk])

    first = np.maximum(chunk.cells - 1, 0)
    last = np.minimum(chunk.cells + chunk.cell, chunk.intervals - 1)
    motion_before = mean_motion(chunk, c, fraction, first)
    motion_behind = mean_motion(chunk, c, fraction, last)
    return np.asarray(
        (motion_behind - motion_before) / ((last - first) * chunk.spacing)
    )


def linearised(chunk: Chunk, c: Array, *, gains: bool = False) -> Linear:
    """Compute the Jacobians of all IMUs about the coefficients `c` (K, n)."""
    return tuple(jacobians(chunk, c, x, gains=gains) for x in chunk.imus)


def normal_equations(
    chunk: Chunk,
    c: Array,
    jerk: Jerk,
    linear: Linear,
    constants: Constants,
    expected: Expected,
) -> NormalEquations:
    """Set up the normal equations at some coefficients.

    Parameters
    ----------
    chunk : Chunk
    c : Array
        (K, n).
    jerk : Jerk
        The prior of the motion.
    linear : tuple of Cells
        Jacobians of the IMUs; none leaves the IMUs out.
    constants : {"none", "clock", "place", "all"}
        Constants of the IMUs that take part.
    expected : tuple of Array, optional
        Readings (M, L) of each IMU that are expected at `c`.
    """
    m = chunk.intervals
    n = chunk.joints
    slots = list(chosen(chunk, constants)) if linear else []
    total = sum(len(slot.taken) for slot in slots)
    expected = expected or tuple(predicted(chunk, c, slot.imu) for slot in slots)

    # Each interval tells of its own four coefficients: gradients (4, M, n).
    encoders = _encoders(chunk, c)
    rise = splines.JERK / chunk.spacing**3
    precision = jerk.precision
    scaled = jerk_of(c, chunk.spacing) / jerk.relative
    of_jerk = scaled @ precision / jerk.relative
    pulls = encoders.gradient - rise[:, None, None] * of_jerk

    of_cells = np.arange(m) // chunk.cell
    border = np.zeros((total, m + 3, n))
    corner = np.zeros((total, total))
    constants_gradient = np.zeros(total)
    of_imus: list[_OfImu] = []
    for slot, cells, readings in zip(slots, linear, expected, strict=True):
        part = _of_imu(chunk, slot, cells, readings)
        of_imus.append(part)
        for b in range(4):
            of_intervals = part.coupling[b][:, of_cells] * part.there[:, None]
            border[slot.at, b : b + m] += of_intervals
        corner[slot.at, slot.at] = part.corner
        constants_gradient[slot.at] = part.constants_gradient
        pulls += part.gradient

    gradient = np.zeros((m + 3, n))
    for a in range(4):
        gradient[a : a + m] += pulls[a]
    coupling = np.kron(np.multiply.outer(rise, rise), precision)
    band = _band(chunk, encoders.information, jerk.relative, coupling, of_imus)
    return NormalEquations(
        band=band,
        border=border.reshape(total, c.size).T,
        corner=corner,
        gradient=gradient.ravel(),
        constants_gradient=constants_gradient,
    )


class _OfImu(NamedTuple):
    """What an IMU adds to the normal equations.

    `there` (M,) are the intervals with readings. In each cell, `information` (C, 4 n, 4
    n) is about an interval's coefficients and `coupling` (4, p, C, n) is of them with
    the IMU's p constants. `corner` (p, p) and `constants_gradient` (p,) are of the
    constants, `gradient` (4, M, n) of the coefficients.
    """

    there: Mask
    information: Array
    coupling: Array
    corner: Array
    gradient: Array
    constants_gradient: Array


def _of_imu(chunk: Chunk, slot: Slot, cells: Cells, expected: Array) -> _OfImu:
    """Compute what an IMU adds, of which readings (M, L) are expected."""
    x = slot.imu
    m = chunk.intervals
    n = chunk.joints
    count = len(chunk.cells)
    channels = len(x.noise)

    # W: whitened slopes by the four coefficients of an interval, then by constants.
    weights = chunk.mean_knots(x.fraction[cells.amid]).transpose(0, 2, 1)
    by_coefficients = weights[:, None] @ cells.by_motion
    W = np.zeros((count, channels, 4, n))
    W[..., : x.joints] = by_coefficients / x.spread[:, None, None]
    G = cells.by_constants[:, :, slot.taken] / x.spread[:, None]
    W = np.concatenate([W.reshape(count, -1, 4 * n), G], axis=2)

    # Of each cell's intervals with readings, those in which a channel has one.
    n_intervals = np.add.reduceat(x.there.astype(float), chunk.cells)
    of_channels = np.add.reduceat(x.seen.astype(float), chunk.cells)
    share = of_channels / np.maximum(n_intervals, 1.0)[:, None]
    H = (W * share[:, :, None]).transpose(0, 2, 1) @ W

    coupling = H[:, : 4 * n, 4 * n :].reshape(count, 4, n, -1).transpose(1, 3, 0, 2)
    corner = np.tensordot(n_intervals, H[:, 4 * n :, 4 * n :], 1)
    corner += x.precision[np.ix_(slot.taken, slot.taken)]

    # Whitened residuals by cell; the last cell may be short of intervals.
    r: Array = np.zeros((count * chunk.cell, channels))
    r[:m] = ((x.y - expected) / x.spread) * x.seen
    r = r.reshape(count, chunk.cell, -1)
    pulls = (r @ W[..., : 4 * n]).reshape(-1, 4, n)[:m].swapaxes(0, 1)
    of_prior = (x.precision @ x.away)[slot.taken]
    return _OfImu(
        there=x.there,
        information=H[:, : 4 * n, : 4 * n],
        coupling=coupling,
        corner=corner,
        gradient=pulls,
        constants_gradient=np.tensordot(r.sum(axis=1), G, 2) - of_prior,
    )


def _band(
    chunk: Chunk,
    of_encoders: Array,
    relative: Array,
    jerk_coupling: Array,
    of_imus: list[_OfImu],
) -> Array:
    """Lay out the lower band (4 n, K n) of the coefficients' information.

    Parameters
    ----------
    chunk : Chunk
    of_encoders : Array
        (M, n, 4, 4), of each joint.
    relative : Array
        (M, n), of the jerk.
    jerk_coupling : Array
        (4 n, 4 n), information of the usual jerk about an interval's coefficients.
    of_imus : list of _OfImu
    """
    m = chunk.intervals
    n = chunk.joints
    of_cells = np.arange(m) // chunk.cell
    band = np.zeros((m + 3, n, 4 * n))

    # Entries of the joints' products (n n) in the order of the coupling.
    places = np.tile(np.arange(n * n).reshape(n, n), (4, 4)).ravel()
    coupling = jerk_coupling.ravel()
    for start in range(0, m, BLOCK):
        block = slice(start, start + BLOCK)
        size = 1.0 / relative[block]
        products = (size[:, :, None] * size[:, None]).reshape(-1, n * n)
        H = (products.take(places, axis=1) * coupling).reshape(-1, 4, n, 4, n)
        for j in range(n):
            H[:, :, j, :, j] += of_encoders[block, j]
        H = H.reshape(-1, 4 * n, 4 * n)
        for part in of_imus:
            has_reading = part.there[block, None, None]
            H += part.information[of_cells[block]] * has_reading

        # LAPACK's order: entry r of coefficient k is of it and of k + r.
        for k in range(4 * n):
            first = start + k // n
            band[first : first + len(H), k % n, : 4 * n - k] += H[:, k, k:]
    return band.reshape((m + 3) * n, -1).T


def chosen(chunk: Chunk, constants: Constants) -> Iterator[Slot]:
    """Yield each IMU with those of its constants that take part."""
    start = 0
    for x in chunk.imus:
        of_all = np.arange(len(x.away))
        taken = {
            "none": of_all[:0],
            "clock": of_all[x.places.clock],
            "place": of_all[: x.places.head],
            "all": of_all,
        }[constants]
        yield Slot(x, taken, slice(start, start + len(taken)))
        start += len(taken)


def predicted(chunk: Chunk, c: Array, x: Mounted) -> Array:
    """Return the readings (M, L) of an IMU that are expected, its bias included."""
    motion = mean_motion(chunk, c[:, : x.joints], x.fraction)
    state = link_state(chunk.robot, x.place.link, motion)
    return np.asarray(state @ x.place.matrix.T + x.bias)
