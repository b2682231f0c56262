"""Stretches of a log, of half a second and longer, in which far more is left.

A push of some seconds fills so much of a log that it passes for what is usual there: it
widens every robust size, and terms follow it. Stretches that may be one are left out
before anything is fitted, and are no measure of others. Whether they are pushes is
decided afterwards, by what a model leaves of them that has not seen them.

With e the mean square of a joint's residual, in units of its median over the moments
beside stretches, each moment scores

    s = log(max_j e_j / c),  between -1 and 1.

A stretch is a maximal scoring subsequence: it goes over gaps in which less is left, as
where a push has no lever, if as much stands on either side (W. L. Ruzzo, M. Tompa, "A
linear time algorithm for finding all maximal scoring subsequences", ISMB 1999).

In shapes, M is the number of kept samples of a log, and n that of the joints.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from seqid_cli.discover.settings import EventSettings
from seqid_cli.typing import Array, Mask

MOMENT_S = 0.15  # of the moments that are scored
STANDS_OUT = 3.0  # times the usual RMS
SHORTEST_S = 0.5  # what is shorter widens no robust size
MOST_OF_LOG = 0.6  # that a stretch may fill: something must be left to compare it with
AROUND_S = 0.1  # on either side of a sample, over which the size of a push is taken
LONGEST_ONSET_S = 1.0  # before a push stands out: a longer one is no onset but a gap
ONSET_SHARE = 0.1  # of a push, at most
EDGE_S = 2.0  # beyond the ends of an event, in which its edges are looked for


class Stretch(NamedTuple):
    """Start and end of a stretch, seconds since the start of its log."""

    start: float
    end: float


def usual_squares(residuals: Sequence[Array], times: Sequence[Array]) -> list[Array]:
    """Return by log what mean square of each joint's residual is usual there.

    It is the median over moments of all logs, or of the log alone where that is more:
    one log may be noisier than another.

    Parameters
    ----------
    residuals : sequence of (M, n) arrays
        By log [N m; N where prismatic], NaN where a joint does not count.
    times : sequence of (M,) arrays
        Seconds since each log's start.

    Returns
    -------
    list of (n,) arrays
        Infinite where no moment tells anything of a joint.
    """
    by_log = [
        _moments(residual**2, t) for residual, t in zip(residuals, times, strict=True)
    ]
    of_all = _usual(by_log)
    return [np.maximum(of_all, _usual([squares])) for squares in by_log]


def _usual(by_log: Sequence[Array]) -> Array:
    """Return the median (n,) of mean squares (moments, n) beside stretches.

    Of logs that are pushed for half of their time the median over all moments would be
    that of the pushes. So the least of all moments is taken for usual first, and then
    what is left beside the stretches, until no more comes back in.
    """
    of_all = _quantiles(by_log, 0.5)
    usual = _quantiles(by_log, 0.5 * (1.0 - MOST_OF_LOG))
    while True:
        beside = [_beside_stretches(squares, usual) for squares in by_log]
        if _count(beside) < (1.0 - MOST_OF_LOG) * _count(by_log):
            return of_all
        median = _quantiles(beside, 0.5)
        raised = np.maximum(usual, np.where(np.isfinite(median), median, of_all))
        if np.array_equal(raised, usual):
            return usual
        usual = raised


def _quantiles(by_log: Sequence[Array], share: float) -> Array:
    """Return a quantile (n,) of mean squares (moments, n) by log; infinite of none."""
    squares = np.concatenate(by_log)
    found = np.full(squares.shape[1], np.inf)
    for joint, of_joint in enumerate(squares.T):
        known = of_joint[of_joint > 0.0]
        if len(known):
            found[joint] = np.quantile(known, share)
    return found


def _beside_stretches(squares: Array, usual: Array) -> Array:
    """Return mean squares (moments, n) of a log, NaN in what may be stretches."""
    beside = squares.copy()
    for start, stop in _long_ranges(_scores(squares, usual)):
        beside[start:stop] = np.nan
    return beside


def _count(by_log: Sequence[Array]) -> int:
    """Return how many moments tell anything of a joint."""
    return sum(int(np.isfinite(squares).any(axis=1).sum()) for squares in by_log)


def long_stretches(
    residual: Array, t: Array, usual: Array, settings: EventSettings
) -> list[Stretch]:
    """Find the stretches of one log in which far more is left than elsewhere.

    Parameters
    ----------
    residual : (M, n) array
        What is left [N m; N where prismatic], NaN where a joint does not count.
    t : (M,) array
        Seconds since the log's start.
    usual : (n,) array
        Mean squares of the residual elsewhere.
    settings : EventSettings
        What may be an event.

    Returns
    -------
    list of Stretch
        By time. None where there are many, or one that is as long as the log, begins
        with it or ends with it: then a law errs, or the file's values.
    """
    squares = _moments(residual**2, t)
    scores = _scores(squares, usual)
    known = np.flatnonzero(np.isfinite(squares).any(axis=1))
    if len(known) == 0:
        return []

    ranges = _long_ranges(scores)
    log_s = MOMENT_S * (known[-1] - known[0] + 1)
    most_s = min(settings.longest, MOST_OF_LOG * log_s)
    for start, stop in ranges:
        is_inside = start > known[0] and stop - 1 < known[-1]
        if not is_inside or MOMENT_S * (stop - start) > most_s:
            return []
    if len(ranges) > settings.most_in(float(t[-1])):
        return []
    return [Stretch(MOMENT_S * start, MOMENT_S * stop) for start, stop in ranges]


def sharpened(stretch: Stretch, residual: Array, t: Array, usual: Array) -> Stretch:
    """Return a stretch with the edges that single samples tell.

    Parameters
    ----------
    stretch : Stretch
        Start and end to some tenths of a second.
    residual : (M, n) array
        What is left [N m; N where prismatic], NaN where a joint does not count.
    t : (M,) array
        Seconds since the log's start.
    usual : (n,) array
        Mean squares of the residual elsewhere.

    Returns
    -------
    Stretch
        As it was where no sample stands out.
    """
    is_near = (t >= stretch.start - EDGE_S) & (t <= stretch.end + EDGE_S)
    near = np.flatnonzero(is_near)
    scores = _scores(residual[near] ** 2, usual)
    parts = _maximal(scores)
    if not parts:
        return stretch
    start, stop = max(parts, key=lambda part: float(scores[slice(*part)].sum()))
    t_in = t[near[start:stop]]
    size = _envelope(residual[near[start:stop]] ** 2, t_in, usual)
    return Stretch(
        float(t_in[0]) - _onset_s(size, t_in - t_in[0]),
        float(t_in[-1]) + _onset_s(size[::-1], t_in[-1] - t_in[::-1]),
    )


def largest_part(squares: Array, least: Array, inside: Mask) -> slice | None:
    """Return the stretch of samples that has most of an event.

    Parameters
    ----------
    squares : (M, n) array
        Squares of what is left [N^2 m^2; N^2 where prismatic], NaN where a joint does
        not count.
    least : (n,) array
        Squares of each joint that belong to the event.
    inside : (M,) mask
        Samples that are known to.

    Returns
    -------
    slice, optional
        None where no sample is as large.
    """
    scores = _scores(squares, least / STANDS_OUT**2)
    shares = [
        (np.count_nonzero(inside[start:stop]), start, stop)
        for start, stop in _maximal(scores)
    ]
    most, start, stop = max(shares, default=(0, 0, 0))
    return slice(start, stop) if most else None


def _envelope(squares: Array, t: Array, usual: Array) -> Array:
    """Return the RMS (M,) around each sample, of the joint where it is largest.

    It is in units of the usual one; NaN where no joint counts near a sample.
    """
    counts = np.isfinite(squares)
    zero = np.zeros((1, squares.shape[1]))
    sums = np.vstack([zero, np.cumsum(np.where(counts, squares, 0.0), axis=0)])
    number = np.vstack([zero, np.cumsum(counts, axis=0)])
    low = np.searchsorted(t, t - AROUND_S)
    high = np.searchsorted(t, t + AROUND_S, side="right")
    n_near = number[high] - number[low]
    mean = (sums[high] - sums[low]) / np.maximum(n_near, 1) / usual
    size: Array = np.sqrt(np.max(mean, axis=1))
    return np.where(n_near.any(axis=1), size, np.nan)


def _onset_s(size: Array, since: Array) -> float:
    """Return how long before it stood out a push began [s].

    A push that sets in evenly takes as long from nothing to the size at which it is
    seen as from there to twice that size (M,), `since` (M,) s later.
    """
    longest_s = min(LONGEST_ONSET_S, ONSET_SHARE * float(since[-1]))
    reached = np.flatnonzero(size >= 2.0 * STANDS_OUT)
    if not len(reached) or since[reached[0]] > longest_s:
        return 0.0
    return float(since[reached[0]])


def _moments(squares: Array, t: Array) -> Array:
    """Return means (moments, n) of squares (M, n); NaN where none counts."""
    moment = (t / MOMENT_S).astype(np.intp)
    n_moments = int(moment[-1]) + 1 if len(moment) else 0
    counts = np.isfinite(squares)
    total = np.zeros((n_moments, squares.shape[1]))
    number = np.zeros_like(total)
    np.add.at(total, moment, np.where(counts, squares, 0.0))
    np.add.at(number, moment, counts)
    means: Array = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    return means


def _scores(squares: Array, usual: Array) -> Array:
    """Return the score of each row of squares (M, n); 0 where no joint counts."""
    known = np.where(np.isfinite(squares), squares, 0.0)
    relative = np.max(known / usual, axis=1) / STANDS_OUT**2
    scores = np.clip(np.log(np.maximum(relative, 1e-12)), -1.0, 1.0)
    return np.where(np.isfinite(squares).any(axis=1), scores, 0.0)


def _long_ranges(scores: Array) -> list[tuple[int, int]]:
    """Return those of the maximal scoring subsequences that widen robust sizes."""
    fewest = SHORTEST_S / MOMENT_S
    return [
        (start, stop)
        for start, stop in _maximal(scores)
        if scores[start:stop].sum() >= fewest
    ]


def _maximal(scores: Array) -> list[tuple[int, int]]:
    """Return the maximal scoring subsequences as half-open ranges, by place."""
    found: list[tuple[int, int]] = []
    remaining = [(0, len(scores))]
    while remaining:
        first, last = remaining.pop()
        sums = np.concatenate([[0.0], np.cumsum(scores[first:last])])
        lowest_before = np.minimum.accumulate(sums)
        gains = sums - lowest_before
        stop = int(np.argmax(gains))
        if gains[stop] <= 0.0:
            continue

        # Of equal sums the shortest range; what is on either side comes next.
        start = int(np.flatnonzero(sums[:stop] == lowest_before[stop])[-1])
        found.append((first + start, first + stop))
        remaining += [(first, first + start), (first + stop, last)]
    return sorted(found)
