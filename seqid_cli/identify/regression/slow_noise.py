"""Noise of averages over slices of slow trials: white, common to a trial, and 1/f.

Averages leave little of white noise, so that what is slow decides: drift and 1/f noise
of the drive in what neighbouring trials share, and what friction's surface misses in a
whole trial. With rows in time order the covariance of their errors is

    V = s_w W + s_t T + s_f F,

W diagonal (one over the samples of a row), T one within a trial and zero elsewhere, F
that of 1/f noise between a quarter of one over the log's length and one over twice a
row's,

    F(tau) = Ci(2 pi f_2 tau) - Ci(2 pi f_1 tau).

The three strengths maximise the restricted likelihood (H. D. Patterson and R. Thompson,
"Recovery of inter-block information when block sizes are unequal", Biometrika 58(3),
1971): what the fitted parameters take away is allowed for. Rows divided by V's root are
generalised least squares. A log of more than `MOST_ROWS` rows counts as several.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.typing import Array, Index

# Logarithms of the strengths against white noise, from which the likelihood is climbed:
# it has one maximum where noise is common to trials, as an offset of the torque is, and
# another elsewhere.
STARTS = ((0.0, 0.0, 0.0), (-4.0, 2.0, -4.0))
# Rows whose covariance is held as a whole, and factored for each strength that is
# tried: more take gigabytes (two hours of trials are 9,600 rows). A longer log counts
# as several that were recorded one after the other.
MOST_ROWS = 500


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Rows H (N, p) theta + error = y of one joint, in any order; all others (N,)."""

    H: Array
    y: Array  # N m
    t: Array  # s within the log
    weight: Array  # samples
    seconds: Array  # length of a row
    trial: Index  # which it is of
    log: Index


def whitener_of(rows: Rows, *, least: float = 1e-6) -> Callable[[Array], Array]:
    """Fit the noise of a joint's rows, and return the function that whitens rows.

    There are more rows than columns. The function takes and returns rows (N, ...).
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import minimize

    # A part's strength against white noise counts from `least` on.
    order = np.lexsort((rows.t, rows.log))  # of each log, in time order
    whole_logs = np.split(order, np.flatnonzero(np.diff(rows.log[order])) + 1)
    logs = [
        part
        for at in whole_logs
        for part in np.array_split(at, math.ceil(len(at) / MOST_ROWS))
    ]
    shapes = [_shapes(rows, at) for at in logs]

    # Independent of any strength: the scale of the residual.
    root = np.sqrt(rows.weight)
    A = rows.H * root[:, None]
    y = rows.y * root
    residual = y - A @ np.linalg.lstsq(A, y, rcond=1e-10)[0]
    white = max(float(residual @ residual) / max(len(y) - A.shape[1], 1), 1e-300)
    typical = white / float(np.median(rows.weight))

    def roots(logarithms: Array) -> list[Array]:
        parts = np.exp(np.clip(logarithms, np.log(least), -np.log(least)))
        return [_root(shape, parts * (white, typical, typical)) for shape in shapes]

    def cost(logarithms: Array) -> float:
        return _restricted(rows, logs, roots(logarithms))

    optima = [
        minimize(cost, at, method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.02})
        for at in np.array(STARTS)
    ]
    best = roots(min(optima, key=lambda optimum: float(optimum.fun)).x)

    def white_rows(values: Array) -> Array:
        white = np.empty_like(values)
        for at, root in zip(logs, best, strict=True):
            white[at] = solve_triangular(root, values[at], lower=True)
        return white

    return white_rows


def _shapes(
    rows: Rows, at: Index, *, lengths: float = 4.0
) -> tuple[Array, Array, Array]:
    """Return W's diagonal, T and F of the rows of one log."""
    from scipy.special import sici

    # The lowest frequency of 1/f noise is one over so many `lengths` of the log.
    t = rows.t[at]
    trial = rows.trial[at]
    common = (trial[:, None] == trial[None, :]).astype(np.float64)
    low = 1.0 / (lengths * max(float(np.ptp(t)), float(rows.seconds[at].max())))
    high = np.maximum(1.0 / (2.0 * rows.seconds[at]), 2.0 * low)
    # Each row passes what is below its own frequency.
    lag = 2.0 * np.pi * np.abs(t[:, None] - t[None, :])
    upper = np.minimum(high[:, None], high[None, :])
    at_once = lag * upper < 1e-6
    safe = np.where(at_once, 1.0, lag)
    slow = np.where(
        at_once, np.log(upper / low), sici(safe * upper)[1] - sici(safe * low)[1]
    )
    return 1.0 / rows.weight[at], common, slow


def _root(
    shape: tuple[Array, Array, Array], strengths: Array, *, stiffness: float = 1e-9
) -> Array:
    """Return the Cholesky factor of one log's covariance."""
    white, common, slow = shape
    V = strengths[1] * common + strengths[2] * slow
    V[np.diag_indices_from(V)] += strengths[0] * white
    # Rows at nearly the same time leave V as good as singular.
    V[np.diag_indices_from(V)] += stiffness * float(np.trace(V)) / len(V)
    return np.asarray(np.linalg.cholesky(V))


def _restricted(rows: Rows, logs: Sequence[Index], roots: Sequence[Array]) -> float:
    """Return twice the negative logarithm of the restricted likelihood.

    A constant is left out.
    """
    from scipy.linalg import solve_triangular

    table = np.column_stack([rows.H, rows.y])
    log_determinant = 0.0
    normal = np.zeros((table.shape[1], table.shape[1]))
    for at, root in zip(logs, roots, strict=True):
        white = solve_triangular(root, table[at], lower=True, check_finite=False)
        normal += white.T @ white
        log_determinant += 2.0 * float(np.log(np.diag(root)).sum())

    A = normal[:-1, :-1]
    right = normal[:-1, -1]
    scale = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    value, vector = np.linalg.eigh(A / np.outer(scale, scale))
    is_determined = value > 1e-10 * value.max(initial=0.0)
    fitted = (vector.T @ (right / scale))[is_determined]
    fitted_square = float(np.sum(fitted**2 / value[is_determined]))
    residual_square = float(normal[-1, -1]) - fitted_square
    log_information = float(
        np.log(value[is_determined]).sum() + 2.0 * np.log(scale).sum()
    )
    return log_determinant + residual_square + log_information
