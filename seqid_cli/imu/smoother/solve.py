"""Gauss-Newton of the motion smoother, the size of the jerk, and covariances.

The equations of `system` are solved as `imu.bordered` has it: F is the factor of the
band, B = F^-1 border, S the information about the P constants that take part once the
motion follows them. The other letters are those of `chunk`.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from seqid_cli.imu.bordered import eliminated, halved
from seqid_cli.imu.smoother import system
from seqid_cli.imu.smoother.chunk import JERK, Chunk, Jerk, jerk_of
from seqid_cli.imu.smoother.imus import moved
from seqid_cli.imu.smoother.system import (
    Constants,
    Expected,
    Linear,
    normal_equations,
)
from seqid_cli.running import running_mean
from seqid_cli.typing import Array, Index


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Coefficients of a chunk, with what their covariance is made of.

    Attributes
    ----------
    chunk : Chunk
        With the constants of its IMUs as they were estimated.
    c : Array
        (K, n) rad.
    jerk : Jerk
    factor : Array
        F, as a lower band.
    border : Array
        B (K n, P).
    schur : Array
        S (P, P).
    constants : {"none", "clock", "place", "all"}
        Constants that took part.
    """

    chunk: Chunk
    c: Array
    jerk: Jerk
    factor: Array
    border: Array
    schur: Array
    constants: Constants = "none"

    def inverse(self, right: Array) -> Array:
        """Return the covariance of the coefficients times `right` (K n, r)."""
        x = halved(self.factor, right)
        if len(self.schur):
            x = x + self.border @ np.linalg.solve(self.schur, self.border.T @ x)
        return halved(self.factor, x, transposed=True)

    def reach(self, *, felt: float = 0.01) -> Array:
        """Return deviations of the coefficients by which constants move them.

        They are independent of each other, each of one standard deviation (K n, r).
        Directions that move the motion by less than `felt` are left out.
        """
        half = np.linalg.inv(np.linalg.cholesky(self.schur))
        size, directions = np.linalg.eigh(half @ (self.border.T @ self.border) @ half.T)
        moves = self.border @ (half.T @ directions[:, size > felt])
        return halved(self.factor, moves, transposed=True)


def encoder_motion(
    chunk: Chunk, size: Array, *, encoder_rounds: int = 4, first_mean_s: float = 0.05
) -> tuple[Array, Jerk]:
    """Estimate motion and jerk from the encoders alone, which couple no joints.

    Parameters
    ----------
    chunk : Chunk
    size : Array
        (n,) rad/s^3, a first guess of the jerk.
    encoder_rounds : int
        Steps of Gauss-Newton, with the jerk renewed after each.
    first_mean_s : float
        Seconds over which positions are averaged to begin with.

    Returns
    -------
    tuple of Array and Jerk
        Coefficients (K, n).
    """
    q = np.column_stack([view.q for view in chunk.views])
    q = running_mean(q, max(3, int(first_mean_s / chunk.dt)))
    at_knots = (np.arange(chunk.intervals + 3) - 1) * chunk.every
    c = q[np.clip(at_knots, 0, len(q) - 1)]

    rng = np.random.default_rng(0)
    uncorrelated = np.eye(len(size))
    jerk = Jerk(size, uncorrelated, np.ones((chunk.intervals, len(size))))
    for _ in range(encoder_rounds):
        solution = renewed(chunk, c, jerk, (), "none")
        c = solution.c
        jerk = replace(_probed_jerk(solution, rng), correlation=uncorrelated)
    return c, jerk


def settled(
    coarse: Chunk, c: Array, jerk: Jerk, *, known_axes: float = 0.002
) -> Solution:
    """Find the IMUs' constants with the motion on coarse knots.

    Axes that the calibration knows better than `known_axes` stay.
    """
    rng = np.random.default_rng(0)
    rounds: list[Constants] = ["place" if coarse.imus else "none"]
    precisions = [np.diag(x.precision)[x.places.head :].min() for x in coarse.imus]
    if precisions and min(precisions) <= known_axes**-2.0:
        rounds.append("all")

    for constants in rounds:
        linear = system.linearised(coarse, c, gains=constants == "all")
        solution = renewed(coarse, c, jerk, linear, constants)
        jerk = _probed_jerk(solution, rng)
        coarse = solution.chunk.gathered()
        c = solution.c
    return replace(solution, chunk=coarse, jerk=jerk)


def detailed(
    fine: Chunk, c: Array, jerk: Jerk, *, noise_tolerance: float = 0.1
) -> Solution:
    """Find the motion on fine knots about `c` (K, n), with the IMUs' clocks.

    Other constants stay. A noise that is off by more than `noise_tolerance` is
    corrected before the last step.
    """
    rng = np.random.default_rng(0)
    linear = system.linearised(fine, c)
    first = renewed(fine, c, jerk, linear, "clock")
    fine = first.chunk.gathered()
    c = first.c
    jerk = _probed_jerk(first, rng)

    expected = tuple(system.predicted(fine, c, x) for x in fine.imus)
    factors = _noise_factors(first, fine, jerk, expected)
    if any(np.any(np.abs(factor - 1.0) > noise_tolerance) for factor in factors):
        imus = [
            replace(x, noise=x.noise * factor)
            for x, factor in zip(fine.imus, factors, strict=True)
        ]
        fine = replace(fine, imus=tuple(imus))
    return renewed(fine, c, jerk, linear, "none", expected)


def renewed(
    chunk: Chunk,
    c: Array,
    jerk: Jerk,
    linear: Linear,
    constants: Constants,
    expected: Expected = None,
) -> Solution:
    """Take one step of Gauss-Newton, constants with the coefficients.

    Parameters
    ----------
    chunk : Chunk
    c : Array
        (K, n), about which the step is taken.
    jerk : Jerk
    linear : tuple of Cells
        Jacobians of the IMUs; none leaves the IMUs out.
    constants : {"none", "clock", "place", "all"}
        Constants that take part.
    expected : tuple of Array, optional
        Readings (M, L) of each IMU that are expected at `c`.
    """
    equations = normal_equations(chunk, c, jerk, linear, constants, expected)
    solved = eliminated(
        equations.band,
        equations.border,
        equations.corner,
        equations.gradient,
        equations.constants_gradient,
    )
    step = np.zeros(0)
    if len(solved.schur):
        # The constants first, then the motion that goes with them.
        step = np.asarray(np.linalg.solve(solved.schur, solved.pull), dtype=np.float64)
        imus = []
        for slot in system.chosen(chunk, constants):
            change = np.zeros(len(slot.imu.away))
            change[slot.taken] = step[slot.at]
            imus.append(moved(slot.imu, change))
        chunk = replace(chunk, imus=tuple(imus))

    return Solution(
        chunk=chunk,
        c=c + solved.trajectory(step).reshape(c.shape),
        jerk=jerk,
        factor=solved.factor,
        border=solved.border,
        schur=solved.schur,
        constants=constants,
    )


def _noise_factors(
    solution: Solution,
    fine: Chunk,
    jerk: Jerk,
    expected: tuple[Array, ...],
    *,
    most_quieter: float = 2.0,
    least_free: float = 0.1,
) -> list[Array]:
    """Return the most likely noise of each IMU's channels over the assumed noise."""
    # The motion has followed the noise in as many directions as the readings determine.
    scaled = jerk_of(solution.c, fine.spacing) / jerk.relative
    n_determined = np.sum((scaled @ jerk.precision) * scaled)
    n_readings = sum(x.seen.sum() for x in solution.chunk.imus)
    free = max(1.0 - n_determined / max(n_readings, 1), least_free)

    factors = []
    for x, readings in zip(fine.imus, expected, strict=True):
        whitened = ((x.y - readings) / x.spread) * x.seen
        square = np.sum(whitened**2, axis=0)
        misfit = np.sqrt(square / np.maximum(x.seen.sum(axis=0), 1) / free)
        factors.append(np.maximum(misfit, 1.0 / most_quieter))
    return factors


def _probed_jerk(solution: Solution, rng: np.random.Generator) -> Jerk:
    """Renew the jerk by what the solution shows of it and by what it leaves open."""
    chunk = solution.chunk
    jerk = solution.jerk
    n = chunk.joints

    # Random signs on every jerk, over its size: their answer has the traces of the
    # covariance on the average.
    signs = rng.choice([-1.0, 1.0], (chunk.intervals, n))
    scaled_signs = signs / (chunk.spacing**3 * jerk.size * jerk.relative)
    probe = np.zeros((chunk.intervals + 3, n))
    for a in range(4):
        probe[a : a + chunk.intervals] += JERK[a] * scaled_signs
    answer = solution.inverse(probe.reshape(-1, 1)).reshape(-1, n)

    usual = jerk.size * jerk.relative
    estimated = jerk_of(solution.c, chunk.spacing) / usual
    answered = jerk_of(answer, chunk.spacing) / usual

    # Expectation and maximisation for the correlations, the faster fixed point for the
    # sizes.
    left_open = signs.T @ answered
    second = estimated.T @ estimated + 0.5 * (left_open + left_open.T)
    renewed_jerk = _renewed_jerk(solution, answered * signs)
    return replace(renewed_jerk, correlation=_correlation(second))


def _correlation(second: Array, *, shrink: float = 0.02) -> Array:
    """Return the correlation (n, n) of second moments (n, n).

    Chance may have made these slightly impossible: negative eigenvalues are taken away,
    and the rest shrunk towards none.
    """
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
    """Take one step towards the most likely jerk of each joint over time.

    `left_open` (M, n) estimates, each very roughly, the share of each interval's jerk
    that the data leave to its prior. The rest tells its size: all intervals together,
    those nearby how it compares there. Where they tell nothing it is taken to be as
    large as on the average.
    """
    chunk = solution.chunk
    jerk = solution.jerk
    m = chunk.intervals
    estimated = jerk_of(solution.c, chunk.spacing)

    # Of all intervals.
    n_told = np.maximum(m - left_open.sum(axis=0), least_known * m)
    size = np.sqrt(np.sum((estimated / jerk.relative) ** 2, axis=0) / n_told)
    size = np.clip(size, jerk.size / largest_change, jerk.size * largest_change)
    size = np.maximum(size, least_jerk)

    # Of those nearby.
    around = max(3, int(open_s / chunk.spacing))
    relative = np.empty_like(estimated)
    for j, share_told in enumerate(n_told / m):
        informed = np.clip(1.0 - running_mean(left_open[:, j], around), 0.0, 1.0)
        width = int(np.clip(nearby / share_told, least_nearby, m))
        square = (estimated[:, j] / size[j]) ** 2
        near = running_mean(running_mean(square, width), width)

        average = float(
            np.mean(jerk.relative[:, j] ** 2 * informed) / np.mean(informed + 1e-9)
        )
        average = float(np.clip(average, 1.0, most_dark))
        dark = 1.0 / (1.0 + (width * informed) ** 2)
        usual = freedom * (1.0 - dark + dark * average)
        relative[:, j] = np.sqrt((usual + width * near) / (freedom + width * informed))
    return Jerk(
        size=size,
        correlation=jerk.correlation,
        relative=np.clip(relative, *relative_limits),
    )


def probed_variance(
    solution: Solution, shared: Solution, *, probe_s: float = 0.125, fewer: int = 4
) -> tuple[Index, Array]:
    """Compute the variance of the motion at some samples.

    Parameters
    ----------
    solution : Solution
        The motion.
    shared : Solution
        Tells of the constants.
    probe_s : float
        Time between knots [s] at which that of ddq is computed.
    fewer : int
        Of these every `fewer`-th has those of q and dq.

    Returns
    -------
    tuple of Array
        Samples (G,), and variance (G, n, 3) of q, dq, ddq at them.
    """
    chunk = solution.chunk
    every = max(1, int(probe_s / chunk.spacing))
    knots = np.arange(min(every, chunk.intervals) // 2, chunk.intervals, every)
    at_samples = -(-knots // chunk.stride) * chunk.stride
    knots = np.unique(np.minimum(at_samples, chunk.intervals - 1))

    places = np.arange(len(knots))
    of_q_and_dq = _forward(solution, knots[::fewer], slice(0, 3))
    variance = interpolated(places, places[::fewer], of_q_and_dq)
    variance[:, :, 2] = _forward(solution, knots, slice(2, 3))[:, :, 0]

    # Constants that are not known move the motion.
    if len(shared.schur):
        at = np.round(knots * chunk.spacing / shared.chunk.spacing).astype(int)
        at = np.minimum(at, shared.chunk.intervals - 1)
        reach = shared.reach().reshape(len(shared.c), chunk.joints, -1)
        near = np.stack([reach[at + a] for a in range(4)])
        deviations = np.tensordot(shared.chunk.knots[0], near, (1, 0))  # (3, G, n, r)
        variance += np.moveaxis(np.sum(deviations**2, axis=3), 0, 2)
    return _everywhere(solution, knots, variance)


def _everywhere(
    solution: Solution,
    knots: Index,
    variance: Array,
    *,
    dense_s: float = 0.01,
    follows: tuple[float, float] = (0.0, 2.0),
    few: float = 0.3,
) -> tuple[Index, Array]:
    """Return the variance (G, n, 3) at samples (G,) closer together than the knots.

    It follows a power of the jerk, which is estimated within the limits of `follows`;
    `few` holds it where the jerk hardly changes.
    """
    chunk = solution.chunk
    log_jerk = np.log(solution.jerk.relative)
    every = max(1, int(dense_s / chunk.spacing))
    places = -(-np.arange(0, chunk.intervals, every) // chunk.stride) * chunk.stride
    places = np.unique(np.minimum(places, chunk.intervals - 1))

    spread = log_jerk[knots] - log_jerk[knots].mean(axis=0)
    covariance = np.sum(spread * np.log(variance[:, :, 2]), axis=0) + few
    power = np.clip(covariance / (np.sum(spread**2, axis=0) + few), *follows)
    rise = np.exp(power * log_jerk)[:, :, None]
    usual = variance / rise[knots]
    samples = places * chunk.every // chunk.stride
    return samples, interpolated(places, knots, usual) * rise[places]


def _forward(solution: Solution, knots: Index, derivatives: slice) -> Array:
    """Compute the variance (G, n, d) of some derivatives at knots (G,)."""
    # The factor's rows of a knot hold all that comes before it. What comes after the
    # next knot is left away: it hardly tells more.
    n = solution.chunk.joints
    weights = solution.chunk.knots[0][derivatives]
    variance = np.empty((len(knots), n, len(weights)))
    rows = np.append(knots, len(solution.c)) * n
    for k, (start, following) in enumerate(pairwise(rows)):
        stop = max(following, start + 4 * n)
        right = np.zeros((stop - start, n, len(weights)))
        for j in range(n):
            right[j : 4 * n : n, j] = weights.T
        of_rows = solution.factor[:, start:stop]
        half = halved(of_rows, right.reshape(stop - start, -1))
        variance[k] = np.sum(half**2, axis=0).reshape(n, -1)
    return variance


def interpolated(at: Index, places: Index, values: Array) -> Array:
    """Interpolate values (G, ...) at `places` (G,) linearly to other places (M,)."""
    columns = [
        np.interp(at, places, column) for column in values.reshape(len(places), -1).T
    ]
    return np.stack(columns, axis=1).reshape(len(at), *values.shape[1:])
