"""Losses at slow motion that single increments do not show, where losses recur.

Losses that recur at one distance tell where the next one is. At such a place, or a row beside it,
a step is one too if the motion of the usual lost time explains it better than no loss does.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.checks.bridging import Losses
from seqid_cli.logs.checks.criteria import LossCriteria
from seqid_cli.logs.raw import Array, Rows


def joined(first: Losses, second: Losses) -> Losses:
    """Losses of both, in their order."""
    rows = np.concatenate([first.rows, second.rows])
    order = np.argsort(rows, kind="stable")
    return Losses(rows[order], np.concatenate([first.seconds, second.seconds])[order])


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
        ((step - motion) / (noise + criteria.uneven_usual * np.abs(motion))) ** 2, axis=1
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
