"""Excerpt design: which stretches of long logs are diagnosed.

Every log is divided into as many parts as it is to have excerpts, so that whatever comes and goes
slowly (warm-up, a drift, a tool) is seen from the first to the last. In each part the excerpt is
taken in which the joints travel most,

    U = sum_j sum_d sqrt(s_jd),

s_jd being the way that joint j slides in direction d: a way of every joint counts for more than the
same way of one. The residual has no say in it: excerpts that were taken because the model is wrong
there would make it look more wrong than it is.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from seqid_cli.discover.excerpts.residual_survey import ResidualSurvey
from seqid_cli.discover.survey.rows import BLOCK_S
from seqid_cli.logs.pieces import Range
from seqid_cli.typing import Array, Index

PIECE_S = 20.0  # two periods of most trajectories, and long beside what the filters lose
WHOLE = 0.9  # share of an excerpt that must be free of gaps


def excerpts_of(
    logs: Sequence[ResidualSurvey], samples: float, *, most: int = 16
) -> list[list[Range]]:
    """Choose at most `most` excerpts of logs, of about so many samples together.

    Returns, per log, first and last moment of each in the order of time, s since the first sample;
    all of it where that is little enough.
    """
    total, lengths = sum(log.samples for log in logs), [log.whole.length for log in logs]
    if total <= samples:
        return [[(0.0, length)] for length in lengths]
    seconds = samples * sum(lengths) / total
    count = int(np.clip(round(seconds / PIECE_S), 1, most))
    # Another log tells more that is new than more of the same one.
    weight = np.cumsum(np.sqrt(lengths))
    parts = np.diff(np.round(count * weight / weight[-1]), prepend=0.0).astype(int)
    return [list(_of_log(log, k, seconds / count)) for log, k in zip(logs, parts, strict=True)]


def _of_log(log: ResidualSurvey, parts: int, length: float) -> Iterator[Range]:
    """The excerpt of most travel in each part of a log, of this length or of the whole log's."""
    whole = max(log.whole.length, 1e-9)
    piece, parts = min(length, whole), min(parts, max(1, int(whole / length)))
    size = max(1, round(piece / BLOCK_S))
    blocks = np.column_stack([log.travel.reshape(len(log.travel), -1), log.usable])
    sums = np.vstack([np.zeros(blocks.shape[1]), np.cumsum(blocks, axis=0)])

    def within(first: Index) -> Array:
        """Sums (P, k) over the blocks of excerpts."""
        return np.asarray(sums[np.minimum(first + size, len(blocks))] - sums[first])

    most = np.max(within(np.arange(max(1, len(blocks) - size + 1)))[:, -1])
    for low, high in pairwise(np.linspace(0.0, whole, parts + 1)):
        starts = np.arange(low, max(high - piece, low) + 1e-9, BLOCK_S)
        found = within((starts / BLOCK_S).astype(np.intp))
        worth = np.sqrt(np.maximum(found[:, :-1], 0.0)).sum(axis=1)
        worth[found[:, -1] < WHOLE * most] = -1.0
        if worth.max() >= 0.0:
            start = float(starts[np.argmax(worth)])
            yield start, start + piece
