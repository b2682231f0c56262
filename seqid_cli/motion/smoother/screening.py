"""Placing IMUs on the encoders' motion, clocks included, and whether to believe them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from seqid_cli.motion.smoother.chunk import Chunk, Mounted, mean_motion
from seqid_cli.motion.smoother.imus import moved
from seqid_cli.motion.smoother.system import jacobians, predicted
from seqid_cli.robust import gaussian_spread
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

BEYOND_NOISE = 2.3  # limits of what joint motion leaves of an IMU's readings


def believed(
    chunk: Chunk, c: Array, *, largest_offset: float = 2.0, least_seen: float = 0.3
) -> tuple[Chunk, list[str]]:
    """Place the IMUs on the encoders' motion `c`; those that cannot be right are left out."""
    kept, notes = [], []
    for given in chunk.imus:
        x = located(chunk, c, given)
        share = float(x.seen.mean()) * chunk.stride
        off = np.sum((x.y - predicted(chunk, c, x)) * x.seen, axis=0)
        mean = float(np.abs(off / np.maximum(x.seen.sum(axis=0), 1)).max())
        if share < least_seen:
            notes.append(f"{x.name} is left out: it reads in {percent(share, 0)} of the samples")
        elif not mean < largest_offset:
            reason = f"its mean reading is off by {mean:.3g} (limit {largest_offset:g})"
            notes.append(f"{x.name} is left out: {reason}")
        else:
            kept.append(x)
    return replace(chunk, imus=tuple(kept)), notes


class Misfit(NamedTuple):
    """What no joint motion explains of an IMU's readings.

    `size` is the RMS over the channels that `typical` of the intervals in motion do not exceed,
    m/s^2 (rad/s): a jolt is over in less time than there is between coarse knots, which cannot
    follow it. `noises` is the same over its noise, `share` over what encoders alone leave.
    """

    name: str
    size: float
    noises: float
    share: float


def misfits(
    chunk: Chunk, alone: Array, together: Array, *, in_motion: float = 0.05
) -> Iterator[Misfit]:
    """IMUs that leave more than noise of the motion by coefficients (K, n), encoders' and all."""
    for x in chunk.imus:
        speed = np.abs(mean_motion(chunk, alone[:, : x.joints])[1])
        fastest = np.maximum(speed.max(axis=1, keepdims=True), 1e-9)
        own = x.there & (speed > in_motion * fastest).any(axis=0)
        own = own if own.any() else x.there
        off = _without_drift(x, predicted(chunk, together, x))
        size, noises = (_typical(v, x.seen, own) for v in (off, off / x.spread))
        if noises > BEYOND_NOISE:
            before = _without_drift(x, predicted(chunk, alone, x))
            share = noises / max(_typical(before / x.spread, x.seen, own), 1e-9)
            yield Misfit(x.name, size, noises, share)


def contradiction(found: Sequence[Misfit], *, unexplained: float = 0.36) -> tuple[str, list[str]]:
    """The IMU to be left out, if any, and what is to be said of those that fit badly."""
    # A right model leaves noise: motion that follows an IMU takes up nearly all in which it differs
    # from the encoders' motion. Wrong geometry or an arm that bends leaves much more.
    texts = {
        x.name: f"it differs from the motion by {x.size:.3g}, {x.noises:.1f} times its noise and "
        f"{percent(x.share, 0)} of what it differs from the encoders'"
        for x in found
    }
    worst = max(found, key=lambda x: x.share, default=None)
    if worst is not None and worst.share > unexplained:
        limit = f"(limit {percent(unexplained, 0)})"
        return worst.name, [f"{worst.name} is left out: {texts[worst.name]} {limit}"]
    remedy = "check geometry, mounting and gravity"
    return "", [f"{name} fits badly: {text}; {remedy}" for name, text in texts.items()]


def _without_drift(x: Mounted, told: Array) -> Array:
    """Residual (M, K) of the readings without what a drifting bias explains."""
    t = np.linspace(-1.0, 1.0, len(told))[:, None] * x.seen
    off = (x.y - told) * x.seen
    slope = np.sum(t * off, axis=0) / np.maximum(np.sum(t * t, axis=0), 1e-9)
    return np.asarray(off - slope * t)


def _typical(off: Array, seen: Mask, own: Mask, *, typical: float = 0.8) -> float:
    """Root mean square over the channels, where it is larger than in most of the intervals."""
    square = np.sum(off[own] ** 2, axis=1) / np.maximum(seen[own].sum(axis=1), 1)
    return float(np.sqrt(np.quantile(square, typical)))


def located(
    chunk: Chunk, c: Array, x: Mounted, *, sure_s: float = 0.002, sure_m: float = 0.005
) -> Mounted:
    """Fit an IMU's place, biases and clock offset to a motion that is taken as given."""
    late = x.place.channels + 6
    known = np.diag(x.precision) ** -0.5
    sure = known[late] < sure_s
    if not x.seen.any() or (sure and known[late - 6 : late - 3].max() < sure_m):
        return x
    if not sure:
        x = _searched(chunk, c, x)
    for count in (late, late + 1):  # one step of least squares for the first constants
        r, noise, G, info = _design(chunk, c, x, count)
        right = np.tensordot(r / noise, G, 2) - (x.precision @ x.away)[:count]
        change = np.zeros(len(x.away))
        change[:count] = np.linalg.solve(info, right)
        x = _placed(chunk, x, change)
    return x


def _placed(chunk: Chunk, x: Mounted, change: Array) -> Mounted:
    """An IMU with its constants changed, its readings where the clock has them."""
    return replace(chunk, imus=(moved(x, change),)).gathered().imus[0]


def _searched(
    chunk: Chunk, c: Array, x: Mounted, *, search_s: float = 0.06, independent_s: float = 0.05
) -> Mounted:
    """The clock offset, of a grid of knots, that leaves least of the readings, all else fitted."""
    # The encoders' motion errs over long stretches; few of the residuals are independent.
    h, late = chunk.spacing, x.place.channels + 6
    told = predicted(chunk, c, x)
    _, noise, G, info = _design(chunk, c, x, late)
    lags = range(-int(search_s / h), int(search_s / h) + 1)
    left = np.empty(len(lags))
    for i, lag in enumerate(lags):
        seen = _later(np.asarray(x.seen, dtype=np.float64), lag) > 0
        later = replace(x, y=_later(x.y, lag), seen=seen)
        r = _cell_means(chunk, later, later.y - told) / noise
        g = np.tensordot(r, G, 2)
        left[i] = np.sum(r**2) - g @ np.linalg.solve(info, g)
    independent = chunk.samples * chunk.dt / independent_s
    away = np.array(lags) * h + x.away[late]
    cost = 0.5 * independent * np.log(np.maximum(left, 1e-12))
    lag = lags[int(np.argmin(cost + 0.5 * x.precision[late, late] * away**2))]
    return _placed(chunk, x, lag * h * np.eye(len(x.away))[late])


def _later(values: Array, lag: int) -> Array:
    """Rows `lag` further on, zero where there are none."""
    out = np.zeros_like(values)
    m = len(values)
    out[max(-lag, 0) : m - max(lag, 0)] = values[max(lag, 0) : m + min(lag, 0)]
    return out


def _cell_means(chunk: Chunk, x: Mounted, off: Array) -> Array:
    """Mean (C, K) over the readings of each cell; zero where there are none."""
    count = np.add.reduceat(x.seen.astype(float), chunk.cells)
    return np.asarray(np.add.reduceat(off * x.seen, chunk.cells) / np.maximum(count, 1.0))


def _design(chunk: Chunk, c: Array, x: Mounted, count: int) -> tuple[Array, Array, Array, Array]:
    """Residuals (C, K), their noise (K,), whitened Jacobians (C, K, g), information (g, g)."""
    r = _cell_means(chunk, x, x.y - predicted(chunk, c, x))
    noise: Array = np.maximum(x.spread, gaussian_spread(r))
    G = jacobians(chunk, c, x, gains=False).by_constants[:, :, :count]
    there = np.add.reduceat(x.seen.astype(float), chunk.cells) > 0
    G = G * there[:, :, None] / noise[:, None]
    return r, noise, G, np.tensordot(G, G, ([0, 1], [0, 1])) + x.precision[:count, :count]
