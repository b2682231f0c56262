"""Motion that comes back: the period of a log, and logs that repeat each other.

Two stretches of motion are the same where every joint is within a small share of its travel of
where it was. Candidates for the lag are where the mean square difference of the positions is
least; the lag is refined below one sample, for torque changes much within one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array, Index, Mask

ALIKE = 0.02  # of a joint's travel (RMS) that positions may differ by and still repeat
LEAST_REPEATED = 0.8  # of the moving samples that must repeat
SOME = 0.8  # of a period, or of the shorter log, that must repeat at the least
NEARLY = 5.0  # times ALIKE: differences that the refinement of a lag looks at
NEWTON_STEPS = 3
MOST_CANDIDATES = 40
LEFT = 0.8  # likeness below which the motion has left where it began
PROMISING = 0.5  # likeness below which a lag is no candidate
SIMILAR_CUTOFF = 0.1  # relative difference of cut-offs up to which torques can be compared


@dataclass(frozen=True)
class Repeat:
    """Motion of data set `first` at time t is that of data set `second` at t + lag [s].

    `at` (K,) are the samples of the first one for which that holds, `then` (K,) the times of the
    second, s.
    """

    first: int
    second: int
    lag: float
    at: Index
    then: Array


def period_of(scene: Scene) -> float | None:
    """Period of the motion.

    Parameters
    ----------
    `scene` : `Scene`

    Returns
    -------
    float or None
        Seconds, the shortest after which all joints come back and go on as before; None where less
        than two whole periods of any are in the log.
    """
    return _lag(scene, scene)


def repeats_of(scenes: Sequence[Scene]) -> list[Repeat]:
    """Periods of single logs one after the other, and logs that repeat the first one like them."""
    found: list[Repeat] = []
    taken: set[int] = set()
    for i, scene in enumerate(scenes):
        period = period_of(scene)
        if period is not None:
            found.append(_repeat(scenes, i, i, period))
        if i in taken:
            continue
        for k in range(i + 1, len(scenes)):
            lag = (
                _lag(scene, scenes[k]) if k not in taken and _comparable(scene, scenes[k]) else None
            )
            if lag is not None:
                taken.add(k)
                found.append(_repeat(scenes, i, k, lag))
    return found


def _comparable(a: Scene, b: Scene) -> bool:
    """Whether two logs have nearly the same rate, cut-off and range of motion."""
    if abs(a.motion.rate_hz / b.motion.rate_hz - 1.0) > SIMILAR_CUTOFF:
        return False
    if abs(a.motion.lowpass.cutoff_hz / b.motion.lowpass.cutoff_hz - 1.0) > SIMILAR_CUTOFF:
        return False
    ranges = [np.stack([s.motion.q.min(axis=0), s.motion.q.max(axis=0)]) for s in (a, b)]
    return bool(np.all(np.abs(ranges[0] - ranges[1]) < 0.1 * np.ptp(ranges[0], axis=0) + 1e-3))


def _lag(a: Scene, b: Scene) -> float | None:
    """Shortest lag [s] at which b repeats a; of one data set with itself, without lag zero."""
    size = _travel(a)
    moving = size > 0
    if not moving.any():
        return None
    p, q = ((s.motion.q - a.motion.q.mean(axis=0))[:, moving] / size[moving] for s in (a, b))
    for lag in _candidates(p, q, alone=a is b):
        refined = _refined(p, q, lag)
        if _same(p, q, refined, a, b):
            return refined / a.motion.rate_hz
    return None


def _travel(scene: Scene) -> Array:
    """RMS travel (n,) of the joints that move, zero of the others."""
    motion = scene.motion
    size: Array = np.where(motion.moving.mean(axis=0) > 0.05, motion.q.std(axis=0), 0.0)
    return size


def _candidates(p: Array, q: Array, *, alone: bool) -> list[int]:
    """Lags [samples] at which positions come close, in the order of their size."""
    lags = np.arange(-len(p) + 1, len(q))
    score = _likeness(p, q, lags)
    overlap = np.minimum(len(p), len(q) - lags) - np.maximum(0, -lags)
    if alone:
        gone = lags[(lags > 0) & (score < LEFT)]
        kept = (lags >= gone[0]) & (lags <= len(p) // 2) if len(gone) else np.zeros_like(lags) > 0
    else:
        kept = overlap >= LEAST_REPEATED * min(len(p), len(q))
    there = np.flatnonzero(kept)
    peaks = there[find_peaks(np.append(score[there], -np.inf))[0]]
    peaks = peaks[score[peaks] > PROMISING]
    best = peaks[np.argsort(-score[peaks], kind="stable")[:MOST_CANDIDATES]]
    return sorted((int(lags[i]) for i in best), key=abs)


def _likeness(p: Array, q: Array, lags: Index) -> Array:
    """One minus half the mean square difference of p(t) and q(t + lag), per lag."""
    length = len(p) + len(q)
    cross = np.zeros(length)
    for x, y in zip(p.T, q.T, strict=True):
        spectrum = np.conj(np.fft.rfft(x, length)) * np.fft.rfft(y, length)
        cross += np.fft.irfft(spectrum, length)
    cross = np.roll(cross, len(p) - 1)[: len(lags)]
    first, stop = np.maximum(0, -lags), np.minimum(len(p), len(q) - lags)
    squares = [np.concatenate([[0.0], np.cumsum(np.sum(v**2, axis=1))]) for v in (p, q)]
    own = squares[0][stop] - squares[0][first]
    then = squares[1][stop + lags] - squares[1][first + lags]
    likeness: Array = 1.0 - 0.5 * (own + then - 2.0 * cross) / (stop - first) / p.shape[1]
    return likeness


def _refined(p: Array, q: Array, lag: int) -> float:
    """Lag below one sample [samples]: Newton's step on the differences that are small already."""
    refined = float(lag)
    slope = np.gradient(q, axis=0)
    for _ in range(NEWTON_STEPS):
        at = np.arange(len(p))
        at = at[(at + refined >= 0) & (at + refined <= len(q) - 1)]
        off, rate = _sampled(q, at + refined) - p[at], _sampled(slope, at + refined)
        near = np.abs(off).max(axis=1) < NEARLY * ALIKE
        square = float(np.sum(rate[near] ** 2))
        if square == 0.0:
            break
        step = -float(np.sum(off[near] * rate[near])) / square
        refined = float(np.clip(refined + step, lag - 2.0, lag + 2.0))
    return refined


def _same(p: Array, q: Array, lag: float, a: Scene, b: Scene) -> bool:
    """Whether what moves repeats at the lag, from the first move of either data set to its last."""
    moves: Mask = np.any(a.motion.moving, axis=1)
    then_moves: Mask = np.any(b.motion.moving, axis=1)
    at = np.flatnonzero(a.motion.usable & _between(moves))
    at = at[(at + lag >= 0) & (at + lag <= len(q) - 1)]
    then = np.round(at + lag).astype(int)
    inside = _between(then_moves)[then]
    at, then = at[inside], then[inside]
    alike = np.abs(_sampled(q, at + lag) - p[at]).max(axis=1) < ALIKE
    moved = alike[moves[at] | then_moves[then]]
    enough = abs(lag) if a is b else LEAST_REPEATED * min(moves.sum(), then_moves.sum())
    return bool(len(moved) and moved.mean() > LEAST_REPEATED and alike.sum() > SOME * enough)


def _between(moves: Mask) -> Mask:
    """Samples (N,) from the first that moves to the last."""
    there = np.flatnonzero(moves)
    result = np.zeros(len(moves), dtype=bool)
    if len(there):
        result[there[0] : there[-1] + 1] = True
    return result


def _sampled(values: Array, at: NDArray[np.floating]) -> Array:
    """Values (N, ...) at fractional samples (K,), straight lines between."""
    low = np.clip(np.floor(at).astype(int), 0, len(values) - 2)
    share = (at - low).reshape(-1, *[1] * (values.ndim - 1))
    between: Array = values[low] * (1 - share) + values[low + 1] * share
    return between


def _repeat(scenes: Sequence[Scene], first: int, second: int, lag: float) -> Repeat:
    a, b = scenes[first].motion, scenes[second].motion
    then = a.t + lag
    inside = (then >= 0) & (then <= b.t[-1]) & a.usable
    at = np.flatnonzero(inside)
    at = at[b.usable[np.round(then[at] * b.rate_hz).astype(int).clip(0, b.samples - 1)]]
    size = _travel(scenes[first])
    q = np.stack([np.interp(then[at], b.t, column) for column in b.q.T], axis=1)
    alike = np.all(np.abs(q - a.q[at]) <= np.where(size > 0, ALIKE * size, np.inf), axis=1)
    return Repeat(first, second, lag, at[alike], then[at][alike])
