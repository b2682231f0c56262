"""Gauss-Newton over windows of a simulated joint, with a prior.

The cost of unknowns theta is

    sum_w weight_w sum_r (q_sim - q)^2 / (rho sigma^2)
        + sum_k ((theta_k - mean_k) / std_k)^2

over windows w and rows r. Neighbouring rows are off alike, so that rho of them count as
one. sigma is what is left at the moment. A window that is off much more than others (a
touch, a cable) counts less. Several lengths of a step are simulated at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.rollouts.loop import JointLoop, LoopValues
from seqid_cli.drive.rollouts.unknowns import Unknowns
from seqid_cli.typing import Array

ROUNDS = 12
ENOUGH = 1e-4  # share by which the cost falls in the last round
DAMPINGS = np.array([0.0, 1e-6, 1e-4, 1e-2, 1.0, 100.0])
# Rows are off alike over so long [s].
ALIKE_S = 0.1
# Of the median of windows, from which on a window counts less.
USUAL = 3.0
ROWS_PER_S = 50.0  # others repeat them
START_STEP = 1e-3  # rad, rad/s: of slopes over where windows begin


@dataclass(frozen=True, kw_only=True)
class Solved:
    """What Gauss-Newton found.

    Attributes
    ----------
    theta : (p,) array
        What is searched.
    errors : (R, B) list of arrays
        rad, simulated less measured, of each rate; freed of where windows begin.
    jacobian : (p, R, B) list of arrays
        The same.
    starts : (2, R, B) list of arrays
        Slopes over position and speed where windows begin.
    weights : (W,) array
    scale : (rates,) array
        rad^2, rho sigma^2.
    cost : float
        With the prior.
    rms : float
        rad, of all windows.
    """

    theta: Array
    errors: list[Array]
    jacobian: list[Array]
    starts: list[Array]
    weights: Array
    scale: Array
    cost: float
    rms: float

    @property
    def by_window(self) -> Array:
        """Mean squares (W,) [rad^2] of the windows."""
        return mean_squares(self.errors)


def mean_squares(errors: Sequence[Array]) -> Array:
    """Return the mean squares (..., W) of errors (..., R, W) of each rate."""
    return np.concatenate(
        [np.mean(each[..., 1:, :] ** 2, axis=-2) for each in errors], axis=-1
    )


def errors_of(
    loops: Sequence[JointLoop], unknowns: Unknowns, theta: Array
) -> list[Array]:
    """Return simulated less measured positions (S, R, B) of each rate [rad]."""
    return _errors_at(loops, unknowns.values(theta))


def start_slopes(
    loops: Sequence[JointLoop], unknowns: Unknowns, theta: Array
) -> list[Array]:
    """Return slopes (2, R, B) of each rate over where windows begin.

    The first is that over the position, the second that over the speed [s].
    """
    values = unknowns.values(np.tile(theta, (3, 1)))
    moved = replace(
        values,
        start_offset=np.array([[0.0], [START_STEP], [0.0]]),
        start_speed=np.array([[0.0], [0.0], [START_STEP]]),
    )
    return [(each[1:] - each[:1]) / START_STEP for each in _errors_at(loops, moved)]


def freed(errors: Sequence[Array], starts: Sequence[Array]) -> list[Array]:
    """Return errors (..., R, B) of each rate without what a window's begin makes.

    A log says where a window begins to within the noise of its speed only. So each
    window has two numbers of its own, which are solved for at once.
    """
    results = []
    for off, slopes in zip(errors, starts, strict=True):
        size = np.sqrt(np.sum(slopes**2, axis=1, keepdims=True)) + 1e-300
        unit = slopes / size
        square = np.einsum("irb,jrb->bij", unit, unit)
        inverse = np.linalg.pinv(square, rcond=1e-6, hermitian=True)
        product = np.einsum("irb,...rb->...ib", unit, off)
        own = np.einsum("bij,...jb->...ib", inverse, product)
        results.append(off - np.einsum("irb,...ib->...rb", unit, own))
    return results


def _errors_at(loops: Sequence[JointLoop], values: LoopValues) -> list[Array]:
    results = []
    for loop in loops:
        course = loop.course
        stride = max(1, int(1.0 / (course.row_s * ROWS_PER_S)))
        off = loop.run(values) - course.q
        results.append(off[:, ::stride])
    return results


def solved(
    loops: Sequence[JointLoop],
    unknowns: Unknowns,
    theta: Array,
    *,
    rounds: int = ROUNDS,
) -> Solved:
    """Search from some values (p,)."""
    mean = unknowns.mean
    information = unknowns.std**-2.0
    steps = unknowns.steps
    p = len(theta)
    whole = errors_of(loops, unknowns, theta[None])
    for _ in range(rounds):
        starts = start_slopes(loops, unknowns, theta)
        current = freed(whole, starts)
        squares = mean_squares(current)[0]
        weights = window_weights(squares)
        scale = _scale(loops, current, weights)

        moved = theta + np.vstack([np.diag(steps), -np.diag(steps)])
        sides = errors_of(loops, unknowns, moved)
        jacobians = [
            (each[:p] - each[p:]) / (2.0 * steps)[:, None, None] for each in sides
        ]
        jacobians = freed(jacobians, starts)
        H, g = _normal(jacobians, current, weights, scale)
        g = g + information * (theta - mean)
        H = H + np.diag(information)
        diagonal = np.diag(np.diag(H))
        candidates = np.stack(
            [theta - np.linalg.solve(H + d * diagonal, g) for d in DAMPINGS]
        )
        tried = errors_of(loops, unknowns, candidates)
        off = freed(tried, starts)
        costs = _costs(off, candidates, weights, scale, mean, information)
        before = _costs(current, theta[None], weights, scale, mean, information)[0]
        best = int(np.argmin(costs))
        if not costs[best] < before:
            break
        theta = candidates[best]
        whole = [each[best : best + 1] for each in tried]
        current = freed(whole, starts)
        if before - costs[best] < ENOUGH * before:
            break
    squares = mean_squares(current)[0]
    weights = window_weights(squares)
    scale = _scale(loops, current, weights)
    cost = _costs(current, theta[None], weights, scale, mean, information)[0]
    return Solved(
        theta=theta,
        errors=[each[0] for each in current],
        jacobian=jacobians,
        starts=starts,
        weights=weights,
        scale=scale,
        cost=float(cost),
        rms=float(np.sqrt(np.mean(squares))),
    )


def window_weights(squares: Array) -> Array:
    """Return weights (W,) of windows by their mean squares."""
    limit = USUAL**2 * float(np.median(squares)) + 1e-300
    return np.asarray(np.minimum(1.0, limit / np.maximum(squares, 1e-300)))


def _scale(
    loops: Sequence[JointLoop], errors: Sequence[Array], weights: Array
) -> Array:
    """Return rho sigma^2 of each rate [rad^2]."""
    squares = mean_squares(errors)[0]
    mean = float(np.average(squares, weights=weights)) + 1e-18
    scales = []
    for loop, each in zip(loops, errors, strict=True):
        rho = max(1.0, ALIKE_S * (each.shape[-2] - 1) / loop.course.seconds)
        scales.append(rho * mean)
    return np.array(scales)


def _normal(
    jacobians: Sequence[Array], errors: Sequence[Array], weights: Array, scale: Array
) -> tuple[Array, Array]:
    p = len(jacobians[0])
    H = np.zeros((p, p))
    g = np.zeros(p)
    first = 0
    for jacobian, off, rho in zip(jacobians, errors, scale, strict=True):
        count = off.shape[-1]
        w = weights[first : first + count] / rho
        first += count
        J = jacobian.reshape(p, -1)
        weighted = (jacobian * w).reshape(p, -1)
        H += weighted @ J.T
        g += weighted @ off[0].ravel()
    return H, g


def _costs(
    errors: Sequence[Array],
    theta: Array,
    weights: Array,
    scale: Array,
    mean: Array,
    information: Array,
) -> Array:
    """Return the costs (S,) of sets of unknowns (S, p)."""
    total = np.sum(information * (theta - mean) ** 2, axis=1)
    first = 0
    for off, rho in zip(errors, scale, strict=True):
        count = off.shape[-1]
        w = weights[first : first + count] / rho
        first += count
        total = total + np.einsum("srb,b->s", off**2, w)
    return np.asarray(total)
