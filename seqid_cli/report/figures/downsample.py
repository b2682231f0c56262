"""Series of any length as a few points that keep every extreme."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot.types import Array

Indices = NDArray[np.int64]


def extremes(x: Array, y: Array, columns: int) -> Indices:
    """Return the indices of the smallest and largest y in each of `columns` equal parts of x.

    `x` (N,): not falling. `y` (N,): finite. `columns`: as many as the drawing has pixels across.
    Returns (M,) array of int: rising, M <= 2 * columns + 2; the first and the last sample are
    always among them.
    """
    if len(x) <= 2 * columns + 2:
        return np.arange(len(x))
    span = x[-1] - x[0]
    share = (x - x[0]) / span if span > 0.0 else np.zeros(len(x))
    column = np.minimum((share * columns).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    sizes = np.diff(np.append(starts, len(x)))
    first_low = _first(y == np.repeat(low, sizes), starts)
    first_high = _first(y == np.repeat(high, sizes), starts)
    return np.unique(np.concatenate([first_low, first_high, [0, len(x) - 1]]))


def _first(marked: NDArray[np.bool_], starts: Indices) -> Indices:
    place = np.where(marked, np.arange(len(marked)), len(marked))
    return np.asarray(np.minimum.reduceat(place, starts), dtype=np.int64)


def pieces(t: Array, good: NDArray[np.bool_], *, max_gap: float = 5.0) -> list[slice]:
    """Return the runs of good samples without a gap in time, as slices."""
    if not len(t):
        return []
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    # With few steps, all long, the median is no measure: then nothing counts as a gap.
    cut = np.concatenate(
        [[True], (steps > max_gap * usual) if usual else np.zeros(len(steps), bool)]
    )
    cut |= np.concatenate([[False], good[1:] != good[:-1]])
    starts = np.flatnonzero(cut)
    ends = np.append(starts[1:], len(t))
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if good[a]]
