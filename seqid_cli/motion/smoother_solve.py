"""Gauss-Newton of the motion smoother, the size of the jerk, and covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.ndimage import uniform_filter1d

from seqid_cli.motion.smoother_imus import moved
from seqid_cli.motion.smoother_system import (
    Chunk,
    Linear,
    Normal,
    encoder_information,
    jerk_of,
    linearised,
    normal_equations,
)
from seqid_cli.motion.smoother_terms import JERK, Jerk

Array = NDArray[np.float64]

LEAST_JERK = 30.0  # rad/s^3 between knots
LARGEST_CHANGE, LEAST_KNOWN = 10.0, 0.01  # of the jerk's size in one round; of its intervals
NOISE_TOLERANCE, MOST_QUIETER, LEAST_FREE = 0.1, 2.0, 0.1
FIRST_MEAN_S = 0.05
PROBE_S, PROBE_COLUMNS, LEAST_SHARE = 0.5, 24, 0.2
ENCODER_ROUNDS = 4
SHRINK = 0.02  # of the jerks' correlations


@dataclass(frozen=True)
class Solution:
    """Coefficients (K, n) of a chunk, with what their covariance is made of."""

    chunk: Chunk
    c: Array
    jerk: Jerk
    factor: Array  # Cholesky factor of the band
    reach: Array  # (Kn, g): inverse of the band times the border
    schur: Array  # (g, g): information about the constants

    def inverse(self, right: Array) -> Array:
        """Covariance of the coefficients times `right` (Kn, m)."""
        x: Array = cho_solve_banded((self.factor, True), right, check_finite=False)
        return x + self.reach @ np.linalg.solve(self.schur, self.reach.T @ right)


def encoder_motion(chunk: Chunk, jerk: Array) -> tuple[Array, Array]:
    """Coefficients (K, n) and the jerk's size from the encoders alone, which couple no joints."""
    c, rng = _first_coefficients(chunk), np.random.default_rng(0)
    for _ in range(ENCODER_ROUNDS):
        band = encoder_information(chunk, c, jerk)
        factor = cholesky_banded(band.by_joint(), lower=True, check_finite=False)
        probe = _jerk_probe(chunk, jerk, rng)
        right = np.column_stack([band.gradient.T.ravel(), probe.T.ravel()])
        step, seen = cho_solve_banded((factor, True), right, check_finite=False).T
        c = c + step.reshape(c.T.shape).T
        jerk = _renewed_jerk(chunk, c, jerk, np.sum(probe * seen.reshape(c.T.shape).T, axis=0))
    return c, jerk


def _jerk_probe(
    chunk: Chunk, jerk: Array, rng: np.random.Generator, *, together: bool = False
) -> Array:
    """Random signs on every jerk, as they fall on the coefficients (K, n), over their size.

    `together` the joints have the same signs, as their covariance asks for.
    """
    spacing = chunk.every * chunk.dt
    signs = rng.choice([-1.0, 1.0], (chunk.intervals, 1 if together else chunk.joints))
    probe = np.zeros((chunk.intervals + 3, chunk.joints))
    for a in range(4):
        probe[a : a + chunk.intervals] += JERK[a] * signs
    return probe / (spacing**3 * jerk)


def all_together(chunk: Chunk, c: Array, size: Array) -> Solution:
    """Gauss-Newton over all joints: motion, then constants and noise too, then motion once more."""
    rng = np.random.default_rng(0)
    jerk = Jerk(size, np.eye(len(size)))
    if not chunk.imus:
        return solved(chunk, c, jerk, normal_equations(chunk, c, jerk))
    linear = linearised(chunk, c)
    for bordered in (False, True):
        normal = normal_equations(chunk, c, jerk, linear, bordered=bordered)
        solution = _stepped(solved(chunk, c, jerk, normal), normal)
        chunk, c = solution.chunk, solution.c
        jerk = _probed_jerk(solution, rng)
        if not bordered:
            linear = linearised(chunk, c, linear.blocks)
    return _finished(solution, linear, jerk)


def _finished(solution: Solution, linear: Linear, jerk: Jerk) -> Solution:
    """Motion once more, with constants and their share of the covariance as they are."""
    chunk = solution.chunk
    normal = normal_equations(chunk, solution.c, jerk, linear)
    factors = _noise_factors(solution, jerk, normal.misfit)
    if np.any(np.abs(factors - 1.0) > NOISE_TOLERANCE):
        pairs = zip(chunk.imus, factors, strict=True)
        chunk = replace(chunk, imus=tuple(replace(x, noise=x.noise * f) for x, f in pairs))
        normal = normal_equations(chunk, solution.c, jerk, linearised(chunk, solution.c))
    last = _stepped(solved(chunk, solution.c, jerk, normal), normal)
    return replace(last, reach=solution.reach, schur=solution.schur)


def _noise_factors(solution: Solution, jerk: Jerk, misfit: tuple[float, ...]) -> Array:
    """Noise of each IMU over what its readings were weighted with, most likely.

    The motion has followed the noise in as many directions as the readings determine.
    """
    chunk = solution.chunk
    spacing = chunk.every * chunk.dt
    found = jerk_of(solution.c, spacing)
    determined = np.sum((found @ jerk.precision) * found)
    readings = sum(x.seen.sum() * len(x.noise) for x in chunk.imus)
    free = max(1.0 - determined / max(readings, 1), LEAST_FREE)
    return np.asarray(np.maximum(np.array(misfit) / np.sqrt(free), 1.0 / MOST_QUIETER))


def _first_coefficients(chunk: Chunk) -> Array:
    """Moving averages of the positions."""
    q = np.column_stack([view.q for view in chunk.views])
    q = uniform_filter1d(q, max(3, int(FIRST_MEAN_S / chunk.dt)), axis=0)
    index = np.clip((np.arange(chunk.intervals + 3) - 1) * chunk.every, 0, len(q) - 1)
    return np.asarray(q[index])


def solved(chunk: Chunk, c: Array, jerk: Jerk, normal: Normal) -> Solution:
    """Factor the normal equations; the coefficients stay as they are."""
    factor = cholesky_banded(normal.band, lower=True, check_finite=False, overwrite_ab=True)
    reach = normal.border
    if reach.shape[1]:
        reach = cho_solve_banded((factor, True), normal.border, check_finite=False)
    return Solution(chunk, c, jerk, factor, reach, normal.corner - normal.border.T @ reach)


def _stepped(solution: Solution, normal: Normal) -> Solution:
    """Coefficients, and constants where they take part, after one step of Gauss-Newton."""
    free = cho_solve_banded((solution.factor, True), normal.gradient, check_finite=False)
    chunk = solution.chunk
    if len(solution.schur):
        right = normal.corner_gradient - normal.border.T @ free
        constants: Array = np.asarray(np.linalg.solve(solution.schur, right), dtype=np.float64)
        free = free - solution.reach @ constants
        imus, start = [], 0
        for x in chunk.imus:
            imus.append(moved(x, constants[start : start + len(x.prior)]))
            start += len(x.prior)
        chunk = replace(chunk, imus=tuple(imus))
    return replace(solution, chunk=chunk, c=solution.c + free.reshape(-1, chunk.joints))


def _probed_jerk(solution: Solution, rng: np.random.Generator) -> Jerk:
    """Jerk renewed by what the solution shows of it and by what it leaves open."""
    chunk, size = solution.chunk, solution.jerk.size
    probe = _jerk_probe(chunk, size, rng, together=True)
    right = (probe[:, :, None] * np.eye(len(size))).reshape(probe.size, -1)
    left_open = right.T @ solution.inverse(right)
    found = jerk_of(solution.c, chunk.every * chunk.dt) / size
    # Expectation and maximisation for the correlations, the faster fixed point for the sizes.
    second = found.T @ found + 0.5 * (left_open + left_open.T)
    deviation = np.sqrt(np.diag(second))
    correlation = (1.0 - SHRINK) * second / np.outer(deviation, deviation) + SHRINK * np.eye(
        len(size)
    )
    return Jerk(_renewed_jerk(chunk, solution.c, size, np.diag(left_open)), correlation)


def _renewed_jerk(chunk: Chunk, c: Array, jerk: Array, open_share: Array) -> Array:
    """One step towards the most likely standard deviation (n,) of each joint's jerk.

    `open_share` (n,) estimates in how many intervals the data leave the jerk to its prior.
    """
    known = np.maximum(chunk.intervals - open_share, LEAST_KNOWN * chunk.intervals)
    size = np.sqrt(np.sum(jerk_of(c, chunk.every * chunk.dt) ** 2, axis=0) / known)
    size = np.clip(size, jerk / LARGEST_CHANGE, jerk * LARGEST_CHANGE)
    return np.asarray(np.maximum(size, LEAST_JERK))


def probed_covariance(solution: Solution) -> Array:
    """Covariance (N, n, 3, 3) of q, dq, ddq: probes at knots far apart, in between interpolated."""
    chunk, n = solution.chunk, solution.chunk.joints
    every = max(1, int(PROBE_S / (chunk.dt * chunk.every)))
    knots = np.arange(min(every, chunk.intervals) // 2, chunk.intervals, every)
    places = np.flatnonzero(chunk.sampled)
    knots = np.unique(places[np.minimum(np.searchsorted(places, knots), len(places) - 1)])
    found = np.zeros((len(knots), n, 3, 3))
    rng = np.random.default_rng(1)
    sets = min(max(1, PROBE_COLUMNS // (3 * n)), len(knots))
    for k in range(sets):
        found[k::sets] = _probed(solution, knots[k::sets], rng)
    W = chunk.knots[0]
    reach = solution.reach.reshape(len(solution.c), n, len(solution.schur))
    along = np.stack([reach[knots + a] for a in range(4)])
    along = np.moveaxis(np.tensordot(W, along, (1, 0)), 0, 2)
    found += along @ np.linalg.solve(solution.schur, np.swapaxes(along, 2, 3))
    # Chance may leave a variance too small, never less than its neighbours' share.
    d = np.arange(3)
    floor = LEAST_SHARE * np.median(found[:, :, d, d], axis=0)
    found[:, :, d, d] = np.maximum(found[:, :, d, d], floor)
    return _between(found, knots * chunk.every, chunk.samples)


def _probed(solution: Solution, knots: NDArray[np.intp], rng: np.random.Generator) -> Array:
    """Covariance (G, n, 3, 3) at knots so far apart that they hardly depend on each other."""
    n, W = solution.chunk.joints, solution.chunk.knots[0]
    signs = rng.choice([-1.0, 1.0], len(knots))
    right = np.zeros((solution.c.size, 3 * n))
    for a in range(4):
        for j in range(n):
            right[(knots + a) * n + j, 3 * j : 3 * j + 3] = np.outer(signs, W[:, a])
    x = cho_solve_banded((solution.factor, True), right, check_finite=False, overwrite_b=True)
    x = x.reshape(-1, n, n, 3)
    near = np.stack([x[knots + a][:, np.arange(n), np.arange(n)] for a in range(4)])
    local = np.tensordot(W, near, (1, 0)) * signs[:, None, None]
    local = np.moveaxis(local, 0, 2)
    return np.asarray(0.5 * (local + np.swapaxes(local, 2, 3)))


def _between(values: Array, at: NDArray[np.intp], samples: int) -> Array:
    """Interpolate (G, ...) linearly to all samples."""
    k = np.clip(np.searchsorted(at, np.arange(samples)) - 1, 0, max(len(at) - 2, 0))
    after = np.minimum(k + 1, len(at) - 1)
    share = np.clip((np.arange(samples) - at[k]) / np.maximum(at[after] - at[k], 1), 0.0, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[k] * (1 - share) + values[after] * share)
