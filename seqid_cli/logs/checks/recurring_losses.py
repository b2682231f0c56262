"""Losses that single increments do not show: below a count of the encoder, and at slow motion.

A coarse encoder moves by less than a count in an interval, and a loss may move it by hardly one.
Beside a velocity channel the counts average out: of

    e = q - integral of v dt

the means over `edge_s` before and behind a loss differ by v L. The noise of such differences is
taken from the log itself, so that what velocities lack elsewhere counts as noise; it is at least
what a mean over k counts leaves of them, half a count over k.

Losses that recur at one distance tell where the next one is. At such a place, or a row beside it,
a step is one too if the motion of the usual lost time explains it better than no loss does.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.checks.bridging import Losses
from seqid_cli.logs.checks.criteria import LossCriteria
from seqid_cli.logs.raw import Array, Rows
from seqid_cli.robust import gaussian_spread


def joined(first: Losses, second: Losses) -> Losses:
    """Losses of both, in their order."""
    rows = np.concatenate([first.rows, second.rows])
    order = np.argsort(rows, kind="stable")
    return Losses(rows[order], np.concatenate([first.seconds, second.seconds])[order])


def below_counts(
    t: Array, q: Array, dq: Array, count: Array, known: Losses, criteria: LossCriteria
) -> Losses:
    """Losses that only means over many counts show.

    `t` (M,): as stamped [s]. `q`, `dq` (M, n): positions and logged velocities. `count` (n,): step
    of the encoders. `known`: what single increments show. Returns: others; none where a joint that
    moves passes a count in an interval.
    """
    step = float(np.median(np.diff(t)))
    width = max(3, round(criteria.edge_s / step))
    coarse = np.abs(dq) * step < count
    if len(t) <= 4 * width or not coarse.all(axis=1).mean() > criteria.recurs or not count.any():
        return Losses(np.zeros(0, np.intp), np.zeros(0))
    edges, v = _edges(t, q, dq, known, width)
    passed = np.abs(v) * criteria.edge_s / np.maximum(count, 1e-15)  # counts in a mean
    moves = passed > 1.0
    spread = np.array([_usual(x[own]) for x, own in zip(edges.T, moves.T, strict=True)])
    noise = np.maximum(spread, 0.5 * count / np.maximum(passed, 1.0)) + 1e-15
    power = np.maximum(np.sum((v / noise) ** 2, axis=1), 1e-300)
    lost = np.sum(v * edges / noise**2, axis=1) / power
    score = lost * np.sqrt(power)
    off = np.abs(edges - v * lost[:, None])
    alike = (off < criteria.sure * noise + criteria.uneven_means * np.abs(v) * lost[:, None]).all(
        axis=1
    )
    sure = alike & (score > criteria.sure) & (lost > criteria.least_intervals * step)
    rows = np.array(_peaks(np.where(sure, score, 0.0), width), dtype=np.intp)
    return Losses(rows + width - 1, lost[rows])


def _edges(t: Array, q: Array, dq: Array, known: Losses, width: int) -> tuple[Array, Array]:
    """Differences (K, n) of the means of e behind and before, and velocities (K, n) there."""
    travel = np.diff(q, axis=0) - 0.5 * (dq[1:] + dq[:-1]) * np.diff(t)[:, None]
    travel[known.rows] = 0.0
    e = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(travel, axis=0)])
    total = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(e, axis=0)])
    means = (total[width:] - total[:-width]) / width
    speed = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(dq, axis=0)])
    return means[width:] - means[:-width], (speed[2 * width :] - speed[: -2 * width]) / (2 * width)


def _usual(values: Array) -> float:
    return float(gaussian_spread(values[:, None])[0]) if len(values) else 0.0


def _peaks(score: Array, width: int) -> list[int]:
    """The largest of every stretch, no two closer than a width."""
    found: list[int] = []
    left = score.copy()
    while len(left) and left.max() > 0.0:
        at = int(np.argmax(left))
        found.append(at)
        left[max(0, at - width) : at + width + 1] = 0.0
    return sorted(found)


def recurring(
    t: Array, q: Array, v: Array, noise: Array, known: Losses, criteria: LossCriteria
) -> Losses:
    """Losses at slow motion, where those at faster motion say that there must be one.

    `t` (M,): as stamped [s]. `q` (M, n). `v` (M - 1, n): velocity before and behind each increment,
    on average. `noise` (n,): of increments. `known`: at least `criteria.least_losses`. Returns:
    others, each of the usual time; none where losses do not recur at one distance.
    """
    nothing = Losses(np.zeros(0, np.intp), np.zeros(0))
    distances = np.diff(known.rows)
    period = int(np.bincount(distances).argmax())
    if np.mean(distances == period) < criteria.recurs:
        return nothing
    usual = float(np.median(known.seconds))
    step = np.diff(q, axis=0) - v * np.diff(t)[:, None]
    motion = v * usual
    without, left = (np.sum((x / noise) ** 2, axis=1) for x in (step, step - motion))
    uneven = np.sum(
        ((step - motion) / (noise + criteria.uneven_means * np.abs(motion))) ** 2, axis=1
    )
    likely = (left < without) & (without > criteria.sure**2) & (uneven < criteria.sure**2)
    rows = [row for row in _places(known.rows, period, len(v)) if likely[row]]
    return Losses(np.array(rows, dtype=np.intp), np.full(len(rows), usual))


def _places(rows: Rows, period: int, count: int) -> NDArray[np.intp]:
    """Rows at multiples of the period from a loss, or one beside, but for the losses."""
    inner = [np.arange(a + period, b - 1, period) for a, b in pairwise(rows)]
    ends = [np.arange(rows[0] - period, 0, -period), np.arange(rows[-1] + period, count, period)]
    places = np.concatenate([*inner, *ends])
    near = np.unique(np.concatenate([places - 1, places, places + 1]))
    return np.setdiff1d(near[(near >= 2) & (near < count - 2)], rows)
