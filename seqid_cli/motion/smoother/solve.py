"""Gauss-Newton of the motion smoother, the size of the jerk, and covariances."""

import contextlib
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.ndimage import uniform_filter1d

from seqid_cli.motion.smoother import system
from seqid_cli.motion.smoother.chunk import JERK, Chunk, Jerk, jerk_of
from seqid_cli.motion.smoother.imus import moved
from seqid_cli.motion.smoother.system import Constants, Linear, Told, normal_equations
from seqid_cli.typing import Array, Index


@dataclass(frozen=True)
class Solution:
    """Coefficients (K, n) of a chunk, with what their covariance is made of."""

    chunk: Chunk
    c: Array
    jerk: Jerk
    factor: Array  # Cholesky factor of the band
    border: Array  # (Kn, g): inverse of the factor times the border
    schur: Array  # (g, g): information about the constants
    constants: Constants = "none"

    def inverse(self, right: Array) -> Array:
        """Covariance of the coefficients times `right` (Kn, m)."""
        x = halved(self.factor, right)
        if len(self.schur):
            x = x + self.border @ np.linalg.solve(self.schur, self.border.T @ x)
        return halved(self.factor, x, transposed=True)

    def reach(self, *, felt: float = 0.01) -> Array:
        """Independent deviations (Kn, r) of the coefficients by which constants move them."""
        half = np.linalg.inv(np.linalg.cholesky(self.schur))
        size, along = np.linalg.eigh(half @ (self.border.T @ self.border) @ half.T)
        return halved(
            self.factor, self.border @ (half.T @ along[:, size > felt]), transposed=True
        )


def halved(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    """Inverse of a lower band's Cholesky factor, or of its transpose, times `right` (Kn, m)."""
    if not right.size:  # LAPACK would write into memory that is not its own
        return right
    x, _ = dtbtrs(factor, right, uplo="L", trans="T" if transposed else "N")
    return np.asarray(x)


def encoder_motion(
    chunk: Chunk, size: Array, *, encoder_rounds: int = 4, first_mean_s: float = 0.05
) -> tuple[Array, Jerk]:
    """Coefficients (K, n) and the jerk from the encoders alone, which couple no joints."""
    q = np.column_stack([view.q for view in chunk.views])
    q = uniform_filter1d(q, max(3, int(first_mean_s / chunk.dt)), axis=0)
    c = q[np.clip((np.arange(chunk.intervals + 3) - 1) * chunk.every, 0, len(q) - 1)]
    rng, alone = np.random.default_rng(0), np.eye(len(size))
    jerk = Jerk(size, alone, np.ones((chunk.intervals, len(size))))
    for _ in range(encoder_rounds):
        solution = renewed(chunk, c, jerk, (), "none")
        c, jerk = solution.c, replace(_probed_jerk(solution, rng), correlation=alone)
    return c, jerk


def _factor(
    band: Array, *, stiffness: tuple[float, ...] = (0.0, 1e-14, 1e-12, 1e-10)
) -> Array:
    """Cholesky factor of a lower band (k, K); of nearly it where a long hole tells nothing."""
    for share in stiffness:
        own = band.copy()
        own[0] += share * np.abs(band[0]).max()
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.asarray(cholesky_banded(own, lower=True, check_finite=False))
    raise np.linalg.LinAlgError("the encoders' information is not positive definite")


def settled(
    coarse: Chunk, c: Array, jerk: Jerk, *, known_axes: float = 0.002
) -> Solution:
    """Find the IMUs' constants with the motion on coarse knots; axes that are known stay."""
    rng = np.random.default_rng(0)
    rounds: list[Constants] = ["place" if coarse.imus else "none"]
    axes = [np.diag(x.precision)[x.place.channels + 7 :].min() for x in coarse.imus]
    if axes and min(axes) <= known_axes**-2.0:
        rounds.append("all")
    for constants in rounds:
        linear = system.linearised(coarse, c, gains=constants == "all")
        solution = renewed(coarse, c, jerk, linear, constants)
        jerk = _probed_jerk(solution, rng)
        coarse, c = solution.chunk.gathered(), solution.c
    return replace(solution, chunk=coarse, jerk=jerk)


def detailed(
    fine: Chunk, c: Array, jerk: Jerk, *, noise_tolerance: float = 0.1
) -> Solution:
    """Motion on fine knots about `c` (K, n), with the IMUs' clocks, other constants as they are."""
    rng = np.random.default_rng(0)
    linear = system.linearised(fine, c)
    first = renewed(fine, c, jerk, linear, "clock")
    fine, c, jerk = first.chunk.gathered(), first.c, _probed_jerk(first, rng)
    told = tuple(system.predicted(fine, c, x) for x in fine.imus)
    factors = _noise_factors(first, fine, jerk, told)
    if any(np.any(np.abs(f - 1.0) > noise_tolerance) for f in factors):
        pairs = zip(fine.imus, factors, strict=True)
        fine = replace(
            fine, imus=tuple(replace(x, noise=x.noise * f) for x, f in pairs)
        )
    return renewed(fine, c, jerk, linear, "none", told)


def renewed(
    chunk: Chunk,
    c: Array,
    jerk: Jerk,
    linear: Linear,
    constants: Constants,
    told: Told = None,
) -> Solution:
    """One step of Gauss-Newton about the coefficients `c` (K, n), constants with them."""
    band, border, corner, gradient, pull = normal_equations(
        chunk, c, jerk, linear, constants, told
    )
    factor = _factor(band)
    border = halved(factor, border)
    schur = corner - border.T @ border
    free = halved(factor, gradient[:, None])[:, 0]
    if len(schur):
        right = pull - border.T @ free
        found: Array = np.asarray(np.linalg.solve(schur, right), dtype=np.float64)
        free = free - border @ found
        imus = []
        for x, taken, own in system.chosen(chunk, constants):
            moves = np.zeros(len(x.away))
            moves[taken] = found[own]
            imus.append(moved(x, moves))
        chunk = replace(chunk, imus=tuple(imus))
    c = c + halved(factor, free[:, None], transposed=True).reshape(c.shape)
    return Solution(chunk, c, jerk, factor, border, schur, constants)


def _noise_factors(
    solution: Solution,
    fine: Chunk,
    jerk: Jerk,
    told: tuple[Array, ...],
    *,
    most_quieter: float = 2.0,
    least_free: float = 0.1,
) -> list[Array]:
    """Noise of each IMU's channels over what they were weighted with, most likely."""
    # The motion has followed the noise in as many directions as the readings determine.
    factors = []
    found = jerk_of(solution.c, fine.spacing) / jerk.relative
    determined = np.sum((found @ jerk.precision) * found)
    readings = sum(x.seen.sum() for x in solution.chunk.imus)
    free = max(1.0 - determined / max(readings, 1), least_free)
    for x, y in zip(fine.imus, told, strict=True):
        square = np.sum((((x.y - y) / x.spread) * x.seen) ** 2, axis=0)
        misfit = np.sqrt(square / np.maximum(x.seen.sum(axis=0), 1) / free)
        factors.append(np.maximum(misfit, 1.0 / most_quieter))
    return factors


def _probed_jerk(solution: Solution, rng: np.random.Generator) -> Jerk:
    """Jerk renewed by what the solution shows of it and by what it leaves open."""
    chunk, jerk, n = solution.chunk, solution.jerk, solution.chunk.joints
    # on every jerk, over its size
    signs = rng.choice([-1.0, 1.0], (chunk.intervals, n))
    over = signs / (chunk.spacing**3 * jerk.size * jerk.relative)
    probe = np.zeros((chunk.intervals + 3, n))
    for a in range(4):
        probe[a : a + chunk.intervals] += JERK[a] * over
    answer = solution.inverse(probe.reshape(-1, 1)).reshape(-1, n)
    usual = jerk.size * jerk.relative
    found, seen = (jerk_of(c, chunk.spacing) / usual for c in (solution.c, answer))
    # Expectation and maximisation for the correlations, the faster fixed point for the
    # sizes.
    left_open = signs.T @ seen
    second = found.T @ found + 0.5 * (left_open + left_open.T)
    return replace(
        _renewed_jerk(solution, seen * signs), correlation=_correlation(second)
    )


def _correlation(second: Array, *, shrink: float = 0.02) -> Array:
    """Correlation (n, n) by second moments that chance may have made slightly impossible."""
    deviation = np.sqrt(np.maximum(np.diag(second), 1e-12))
    values, axes = np.linalg.eigh(second / np.outer(deviation, deviation))
    possible = (axes * np.maximum(values, 0.0)) @ axes.T
    deviation = np.sqrt(np.diag(possible))
    possible /= np.outer(deviation, deviation)
    return np.asarray((1.0 - shrink) * possible + shrink * np.eye(len(second)))


def _renewed_jerk(
    solution: Solution,
    left_open: Array,
    *,
    least_jerk: float = 30.0,
    largest_change: float = 10.0,
    least_known: float = 0.01,
    freedom: float = 4.0,
    nearby: float = 2.0,
    least_nearby: int = 5,
    open_s: float = 0.25,
    most_dark: float = 4.0,
    relative_limits: tuple[float, float] = (0.1, 30.0),
) -> Jerk:
    """One step towards the most likely jerk of each joint, and towards its changes over time."""
    # `left_open` (M, n) estimates, each very roughly, the share of each interval's jerk
    # that the data leave to its prior. The rest tells its size: all intervals together,
    # those nearby how it compares there. Where they tell nothing it is taken to be as
    # large as on the average.
    chunk, jerk, m = solution.chunk, solution.jerk, solution.chunk.intervals
    known = np.maximum(m - left_open.sum(axis=0), least_known * m)
    found = jerk_of(solution.c, chunk.spacing)
    size = np.sqrt(np.sum((found / jerk.relative) ** 2, axis=0) / known)
    size = np.clip(size, jerk.size / largest_change, jerk.size * largest_change)
    size = np.maximum(size, least_jerk)
    around = max(3, int(open_s / chunk.spacing))
    relative = np.empty_like(found)
    for j, share in enumerate(known / m):
        told = np.clip(1.0 - uniform_filter1d(left_open[:, j], around), 0.0, 1.0)
        width = int(np.clip(nearby / share, least_nearby, m))
        near = uniform_filter1d(
            uniform_filter1d((found[:, j] / size[j]) ** 2, width), width
        )
        average = float(np.mean(jerk.relative[:, j] ** 2 * told) / np.mean(told + 1e-9))
        average = float(np.clip(average, 1.0, most_dark))
        dark = 1.0 / (1.0 + (width * told) ** 2)
        usual = freedom * (1.0 - dark + dark * average)
        relative[:, j] = np.sqrt((usual + width * near) / (freedom + width * told))
    return Jerk(size, jerk.correlation, np.clip(relative, *relative_limits))


def probed_variance(
    solution: Solution, shared: Solution, *, probe_s: float = 0.125, fewer: int = 4
) -> tuple[Index, Array]:
    """Variance (G, n, 3) of q, dq, ddq at samples (G,); `shared` tells of the constants."""
    chunk = solution.chunk
    every = max(1, int(probe_s / chunk.spacing))
    knots = np.arange(min(every, chunk.intervals) // 2, chunk.intervals, every)
    knots = np.unique(
        np.minimum(-(-knots // chunk.stride) * chunk.stride, chunk.intervals - 1)
    )
    # of q, dq where others lie further apart
    places, few = np.arange(len(knots)), knots[::fewer]
    found = interpolated(places, places[::fewer], _forward(solution, few, slice(0, 3)))
    found[:, :, 2] = _forward(solution, knots, slice(2, 3))[:, :, 0]
    if len(shared.schur):
        at = np.round(knots * chunk.spacing / shared.chunk.spacing).astype(int)
        at = np.minimum(at, shared.chunk.intervals - 1)
        reach = shared.reach().reshape(len(shared.c), chunk.joints, -1)
        near = np.stack([reach[at + a] for a in range(4)])
        along = np.tensordot(shared.chunk.knots[0], near, (1, 0))  # (3, G, n, r)
        # constants move the motion
        found += np.moveaxis(np.sum(along**2, axis=3), 0, 2)
    return _everywhere(solution, knots, found)


def _everywhere(
    solution: Solution,
    knots: Index,
    found: Array,
    *,
    dense_s: float = 0.01,
    follows: tuple[float, float] = (0.0, 2.0),
    few: float = 0.3,
) -> tuple[Index, Array]:
    """Variance at samples closer together, by the power of the jerk that it follows."""
    chunk, size = solution.chunk, np.log(solution.jerk.relative)
    every = max(1, int(dense_s / chunk.spacing))
    places = -(-np.arange(0, chunk.intervals, every) // chunk.stride) * chunk.stride
    places = np.unique(np.minimum(places, chunk.intervals - 1))
    spread = size[knots] - size[knots].mean(axis=0)
    follow = np.sum(spread * np.log(found[:, :, 2]), axis=0) + few
    rise = np.exp(np.clip(follow / (np.sum(spread**2, axis=0) + few), *follows) * size)[
        :, :, None
    ]
    usual = found / rise[knots]
    return (
        places * chunk.every // chunk.stride,
        interpolated(places, knots, usual) * rise[places],
    )


def _forward(solution: Solution, knots: Index, which: slice) -> Array:
    """Variance (G, n, d) of some derivatives at knots."""
    # The factor's rows of a knot hold all that comes before it. What comes after the
    # next knot is left away: it hardly tells more.
    n, W = solution.chunk.joints, solution.chunk.knots[0][which]
    found = np.empty((len(knots), n, len(W)))
    for k, (start, after) in enumerate(pairwise(np.append(knots, len(solution.c)) * n)):
        stop = max(after, start + 4 * n)
        right = np.zeros((stop - start, n, len(W)))
        for j in range(n):
            right[j : 4 * n : n, j] = W.T
        own = halved(solution.factor[:, start:stop], right.reshape(stop - start, -1))
        found[k] = np.sum(own**2, axis=0).reshape(n, -1)
    return found


def interpolated(at: Index, places: Index, values: Array) -> Array:
    """Values (G, ...) at `places` (G,), interpolated linearly to others (M,)."""
    columns = [
        np.interp(at, places, column) for column in values.reshape(len(places), -1).T
    ]
    return np.stack(columns, axis=1).reshape(len(at), *values.shape[1:])
