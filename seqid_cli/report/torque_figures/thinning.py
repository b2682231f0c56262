"""Long time series as lines of few points: runs without a gap, and their extremes."""

import numpy as np

from seqid_cli.typing import Array, Index, Mask


def extremes(x: Array, y: Array, columns: int) -> Index:
    """Return the samples of smallest and largest y in each of equal parts of x.

    A line through them looks like that through all: a single bad sample shows.

    Parameters
    ----------
    x : (N,) float
        Does not fall.
    y : (N,) float
        Finite.
    columns : int
        Number of parts.

    Returns
    -------
    (K,) array of int
        Indices, 2 `columns` + 2 at most. They rise; the first and the last sample are
        always among them.
    """
    count = len(x)
    if count <= 2 * columns + 2:
        return np.arange(count)
    span = x[-1] - x[0]
    share = (x - x[0]) / span if span > 0.0 else np.zeros(count)
    column = np.minimum((share * columns).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    sizes = np.diff(np.append(starts, count))

    chosen = [np.array([0, count - 1])]
    for extreme in (np.minimum, np.maximum):
        # The first sample of each part that reaches its extreme.
        is_reached = y == np.repeat(extreme.reduceat(y, starts), sizes)
        candidates = np.where(is_reached, np.arange(count), count)
        chosen.append(np.minimum.reduceat(candidates, starts))
    return np.unique(np.concatenate(chosen))


def pieces(t: Array, good: Mask, *, max_gap: float = 5.0) -> list[slice]:
    """Return the runs of good samples without a gap in time.

    Parameters
    ----------
    t : (N,) float
        Times [s], which do not fall.
    good : (N,) bool
    max_gap : float
        Longest step within a run, over the usual step.

    Returns
    -------
    list of slice
    """
    if not len(t):
        return []
    steps = np.diff(t)
    positive = steps[steps > 0.0]
    usual_step = float(np.median(positive)) if len(positive) else np.inf
    is_cut = (steps > max_gap * usual_step) | (good[1:] != good[:-1])
    cuts = (np.flatnonzero(is_cut) + 1).tolist()
    starts = [0, *cuts]
    stops = [*cuts, len(t)]
    return [
        slice(start, stop)
        for start, stop in zip(starts, stops, strict=True)
        if good[start]
    ]
