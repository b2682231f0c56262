"""Excerpt design: which stretches of long logs are diagnosed.

The time of all logs is divided into as many parts as there are to be excerpts, so that whatever
comes and goes slowly (warm-up, a drift, a tool) is seen from the first to the last. In each part
the excerpt is taken in which the joints travel most,

    U = sum_j sum_d sqrt(s_jd),

s_jd being the way that joint j slides in direction d: a way of every joint counts for more than the
same way of one. The residual has no say in it: excerpts that were taken because the model is wrong
there would make it look more wrong than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.discover.excerpts.residual_survey import ResidualSurvey
from seqid_cli.discover.survey.rows import BLOCK_S
from seqid_cli.logs.pieces import Range
from seqid_cli.typing import Array, Index, Mask

PIECE_S = 20.0  # two periods of most trajectories, and long beside what the filters lose
MOST_PIECES = 16
WHOLE = 0.9  # share of an excerpt that must be free of gaps


@dataclass(frozen=True)
class _Places:
    """Where an excerpt may begin: log, start [s], length [s], part of the time and U, (P,) each."""

    log: Index
    start: Array
    length: Array
    part: Index
    worth: Array

    def apart(self, other: int) -> Mask:
        """Places (P,) that do not overlap another one."""
        before = self.start + self.length <= self.start[other]
        behind = self.start >= self.start[other] + self.length[other]
        return np.asarray((self.log != self.log[other]) | before | behind)


def excerpts_of(logs: Sequence[ResidualSurvey], samples: float) -> list[list[Range]]:
    """Choose excerpts of logs.

    Parameters
    ----------
    logs : sequence of ResidualSurvey
    samples : float
        Of all excerpts together, about.

    Returns
    -------
    list of list of (float, float)
        Per log, first and last moment of its excerpts in the order of time, s since its first
        sample. All of it where that is little enough.
    """
    total = sum(log.samples for log in logs)
    if total <= samples:
        return [[(0.0, log.whole.length)] for log in logs]
    seconds = samples * sum(log.whole.length for log in logs) / total
    count = int(np.clip(round(seconds / PIECE_S), 1, MOST_PIECES))
    places = _places(logs, seconds / count, count)
    result: list[list[Range]] = [[] for _ in logs]
    free = np.ones(len(places.log), dtype=bool)
    for part in range(count):
        there = np.flatnonzero(free & (places.part == part))
        if len(there):
            best = int(there[np.argmax(places.worth[there])])
            start = float(places.start[best])
            result[places.log[best]].append((start, start + float(places.length[best])))
            free &= places.apart(best)
    return [sorted(ranges) for ranges in result]


def _places(logs: Sequence[ResidualSurvey], length: float, count: int) -> _Places:
    """All places where an excerpt may be; a log that is shorter than one is one as a whole."""
    # Another log tells more that is new than more of the same one.
    weight = np.sqrt([log.whole.length for log in logs])
    edges = np.concatenate([[0.0], np.cumsum(weight)]) / weight.sum() * count
    found = []
    for number, log in enumerate(logs):
        whole = max(log.whole.length, 1e-9)
        piece = min(length, whole)
        steps = np.arange(int((whole - piece) / BLOCK_S) + 1)
        size = max(1, round(piece / BLOCK_S))
        travel = _moving_sums(log.travel.reshape(len(log.travel), -1), steps, size)
        usable = _moving_sums(log.usable[:, None], steps, size)[:, 0]
        there = usable >= WHOLE * np.max(usable, initial=0.0)
        at = edges[number] + np.diff(edges)[number] * (
            (steps * BLOCK_S + np.outer([0.0, 0.5, 0.999], [piece])) / whole
        )
        first, part, last = np.minimum((at + 1e-9).astype(np.intp), count - 1)
        # Within their own part excerpts cannot be in each other's way.
        within = there & (first == part) & (last == part)
        there &= within | ~np.isin(part, part[within])
        same = np.full(np.count_nonzero(there), number)
        worth = np.sqrt(travel[there]).sum(axis=1)
        length_there = np.full(len(same), piece)
        found.append((same, steps[there] * BLOCK_S, length_there, part[there], worth))
    return _Places(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _moving_sums(values: Array, steps: Index, size: int) -> Array:
    """Sums (P, k) of values (B, k) over `size` blocks from each step on."""
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    total: Array = sums[np.minimum(steps + size, len(values))] - sums[steps]
    return total
