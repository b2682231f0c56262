"""Triangular factors of rows [H y] by Householder reflections (LAPACK's `dtpqrt`)."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtpqrt

from seqid_cli.typing import Array, Index, Mask


def triangular(rows: Array) -> Array:
    """Triangular factor (p, p) of rows (N, p), diagonal not negative.

    Columns of zeros give columns and rows of zeros.
    """
    return by_reflections(rows[:, :-1], rows[:, -1])


def not_zero(H: Array, y: Array) -> Mask:
    """Columns (p + 1,) of [H y] that are not all zero."""
    alive = np.zeros(H.shape[1] + 1, dtype=np.bool_)
    if len(y):
        alive[:-1], alive[-1] = H[0] != 0.0, y.any()  # most show it in their first row
        rest = np.flatnonzero(~alive[:-1])
        if len(rest):
            low, high = rest[0], rest[-1] + 1
            alive[low:high] |= (H[:, low:high] != 0.0).any(axis=0)
    return alive


def by_reflections(
    H: Array, y: Array, where: Mask | None = None, *, strip_rows: int = 1024
) -> Array:
    """Factor (p + 1, p + 1) of rows [H y], (N, p) and (N,), or of those where a mask (N,) is true.

    Some columns may be zero. So many rows are taken at once: they stay in cache.
    """
    alive = not_zero(H, y)
    chosen = np.flatnonzero(alive)
    inner = np.flatnonzero(alive[:-1])
    R = np.zeros((len(chosen), len(chosen)), order="F")
    for start in range(0, len(y) if len(chosen) else 0, strip_rows):
        part = slice(start, start + strip_rows)
        rows, right = H.T[inner, part], y[part]
        if where is not None:
            rows, right = np.compress(where[part], rows, axis=1), right[where[part]]
        strip = np.vstack([rows, right]) if alive[-1] else rows
        R = _reflected(R, strip.T, 0) if strip.size else R
    return _signed(R, chosen, len(alive))


def merged(first: Array, second: Array) -> Array:
    """Factor of the rows that two factors stand for."""
    alive = np.flatnonzero(first.any(axis=0) | second.any(axis=0))
    if not len(alive):
        return first
    R, below = (np.asfortranarray(factor[alive[:, None], alive]) for factor in (first, second))
    return _signed(_reflected(R, below, len(alive)), alive, len(first))


def merged_pairs(factors: list[Array]) -> list[Array]:
    """Merge each two neighbours; one without a partner stays."""
    pairs = [merged(*factors[i : i + 2]) for i in range(0, len(factors) - 1, 2)]
    return pairs + factors[2 * len(pairs) :]


def _reflected(R: Array, rows: Array, triangle: int, *, panel_size: int = 8) -> Array:
    """R (k, k) of R on top of rows (m, k), the last `triangle` of them upper trapezoidal.

    Both must be Fortran-ordered and are used up.
    """
    panel = min(panel_size, len(R))
    R, *_ = dtpqrt(triangle, panel, R, rows, overwrite_a=True, overwrite_b=True)
    return R


def _signed(R: Array, chosen: Index, size: int) -> Array:
    """R of the chosen columns in a factor (size, size) with no negative entry on its diagonal."""
    flipped = np.flatnonzero(R.diagonal() < 0)
    R[flipped] *= -1.0
    full = np.zeros((size, size))
    full[chosen[:, None], chosen] = R
    return full
