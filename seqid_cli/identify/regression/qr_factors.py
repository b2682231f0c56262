"""Triangular factors of rows [H y] by Householder reflections (LAPACK's `dtpqrt`)."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtpqrt

from seqid_cli.typing import Array, Index, Mask

Spans = list[tuple[int, int]]  # half-open ranges of rows


def triangular(rows: Array) -> Array:
    """Triangular factor (p, p) of rows (N, p), diagonal not negative.

    Columns of zeros give columns and rows of zeros.
    """
    H, y = rows[:, :-1], rows[:, -1]
    return by_reflections(H, y, not_zero(H, y))


def not_zero(H: Array, y: Array, loaded: Mask | None = None, spans: Spans | None = None) -> Mask:
    """Columns (p + 1,) of [H y] that are not all zero; only `loaded` ones (p,) are looked at.

    With `spans` of H, y holds the rows of these alone.
    """
    alive = np.zeros(H.shape[1] + 1, dtype=np.bool_)
    if not len(y):
        return alive
    first = H[0] if spans is None else H[spans[0][0]]
    alive[:-1], alive[-1] = first != 0.0, y.any()  # most show it in their first row
    rest = ~alive[:-1] if loaded is None else loaded & ~alive[:-1]
    if rest.any():
        for start, stop in _runs(np.flatnonzero(rest)):
            for low, high in spans or [(0, len(H))]:
                part = H[low:high, start:stop]
                alive[start:stop] |= (part.max(axis=0) != 0.0) | (part.min(axis=0) != 0.0)
    return alive


def spans_of(where: Mask) -> Spans:
    """Ranges of rows in which a mask (N,) is true."""
    edges = np.flatnonzero(where[1:] != where[:-1]) + 1
    ends = [0, *edges.tolist(), len(where)]
    first = 0 if where[0] else 1
    return list(zip(ends[first:-1:2], ends[first + 1 :: 2], strict=True))


def by_reflections(
    H: Array, y: Array, alive: Mask, spans: Spans | None = None, *, strip_rows: int = 1024
) -> Array:
    """Factor (p + 1, p + 1) of rows [H y], (N, p) and (N,), of which some columns are not zero.

    With `spans` of H, y holds the rows of these alone.
    """
    chosen, runs = np.flatnonzero(alive), _runs(np.flatnonzero(alive[:-1]))
    R = np.zeros((len(chosen), len(chosen)), order="F")
    if spans is not None and len(chosen):
        rows = np.empty((len(chosen), len(y)))
        _lay(rows, H.T, y, runs, spans)
        for start in range(0, len(y), strip_rows):
            R = _reflected(R, np.ascontiguousarray(rows[:, start : start + strip_rows]).T, 0)
        return _signed(R, chosen, len(alive))
    for start in range(0, len(y) if len(chosen) else 0, strip_rows):
        part = slice(start, start + strip_rows)
        strip = np.empty((len(chosen), len(y[part])))
        _lay(strip, H[part].T, y[part], runs)
        R = _reflected(R, strip.T, 0)
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


def _lay(
    out: Array, columns: Array, y: Array, runs: list[tuple[int, int]], spans: Spans | None = None
) -> None:
    """Put runs of columns (p, N), and y if there is room, into out (k, M); of all N or of spans."""
    to = 0
    for start, stop in runs:
        target, part = out[to : to + stop - start], columns[start:stop]
        if spans is None:
            target[:] = part
        else:
            at = 0
            for low, high in spans:
                target[:, at : at + high - low] = part[:, low:high]
                at += high - low
        to += stop - start
    out[to:] = y


def _runs(numbers: Index) -> Spans:
    """Half-open ranges of consecutive ones among ascending numbers."""
    if not len(numbers):
        return []
    ends = np.flatnonzero(numbers[1:] - numbers[:-1] > 1)
    starts = [int(numbers[0]), *numbers[ends + 1].tolist()]
    stops = [*(numbers[ends] + 1).tolist(), int(numbers[-1]) + 1]
    return list(zip(starts, stops, strict=True))


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
    return _in_full(np.ascontiguousarray(R), chosen, size)


def _in_full(R: Array, chosen: Index, size: int) -> Array:
    if len(chosen) == size:
        return R
    full = np.zeros((size, size))
    full[chosen[:, None], chosen] = R
    return full
