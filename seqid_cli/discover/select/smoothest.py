"""Splines that are safe to judge by leaving out: their knots, and the smoothest out of them."""

import numpy as np
from scipy.linalg import eigh

from seqid_cli.typing import Array, Index

EDGE = 0.01  # share of the rows beyond the first knot (and the last), whatever fold is left out
STILL = 1e-9  # range of a quantity, relative to its size, below which it has not moved
RIDGE = 1e-6  # of the splines' mean square: for pieces that hold no rows


def knots_of(x: Array, fold: Index, count: int) -> tuple[float, ...] | None:
    """Knots half way between equal steps and equal shares of x; None if x hardly varies.

    Equal shares alone would crowd at rest and turning points, equal steps leave pieces empty. The
    outer knots are such that without any one fold some rows still lie beyond them: what one fold
    alone has seen cannot be judged by leaving it out.

    Parameters
    ----------
    x, fold : (M,) arrays
        The quantity at the rows and the fold of each.
    count : int
        Number of knots.
    """
    if len(x) < 10 * count:
        return None
    left = [x[fold != f] for f in np.unique(fold)]
    edges = np.array([np.quantile(rest, (EDGE, 1.0 - EDGE)) for rest in left if len(rest)])
    if not len(edges):
        return None
    low, high = float(edges[:, 0].max()), float(edges[:, 1].min())
    if high - low <= STILL * max(1.0, float(np.max(np.abs(x)))):
        return None
    inside = x[(x >= low) & (x <= high)]
    shares = np.quantile(inside, np.linspace(0.0, 1.0, count))
    steps = np.linspace(low, high, count)
    return tuple(float(knot) for knot in 0.5 * (shares + steps))


def smoothest(basis: Array, abscissae: Array) -> Array:
    """Combinations of splines (M, K), smoothest first, orthonormal over the rows.

    Parameters
    ----------
    basis : (M, K) array
        Splines at the rows; they sum to one.
    abscissae : (K,) array
        Greville abscissae.

    Returns
    -------
    (K, K) array
        One combination per column: the constant, nearly the straight line, and so on.
    """
    K = basis.shape[1]
    G = basis.T @ basis / len(basis)
    G[np.diag_indices(K)] += RIDGE * np.trace(G) / K
    one = np.ones(K)
    null = np.linalg.qr(np.column_stack([G @ one, np.eye(K)[:, : K - 1]]))[0][:, 1:]
    bend = _second_differences(abscissae) @ null
    _, vectors = eigh(bend.T @ bend, null.T @ G @ null)
    return np.column_stack([one / np.sqrt(one @ G @ one), null @ vectors])


def _second_differences(x: Array) -> Array:
    """Second divided differences (K - 2, K) at abscissae x, which a straight line makes zero."""
    first = np.diff(np.eye(len(x)), axis=0) / np.diff(x)[:, None]
    second: Array = np.diff(first, axis=0) * np.ptp(x)
    return second
