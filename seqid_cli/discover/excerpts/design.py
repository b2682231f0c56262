"""Which pieces of long logs are diagnosed: spread over the time, and varied in their motion.

What a model lacks shows in motion that is varied rather than long. The time of all logs is divided
into as many parts as there are to be pieces, so that whatever comes and goes slowly (warm-up, a
drift, a tool) is seen from the first to the last; in each part the piece is taken whose motion adds
most to that of the others,

    U = sum_j sum_c sqrt(T_jc),

T_jc [s] the time that joint j certainly slides in cell c of position, speed and direction. The
residual has no say in it: pieces that were taken because the model is wrong there would make it
look more wrong than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.excerpts.residual_survey import BLOCK_S, LookedOver
from seqid_cli.logs.pieces import Range

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

PIECE_S = 20.0  # two periods of most trajectories, and long beside what the filters lose
MOST_PIECES = 16
POSITIONS = 4  # cells of a joint's travel
SPEEDS = (0.15, 0.5)  # of the top speed, where the cells of speed are divided
TOP = 0.99  # quantile of the speed that counts as the top
SWEEPS = 3
WHOLE = 0.9  # share of a piece that must be free of gaps


@dataclass(frozen=True)
class _Places:
    """Where a piece of each log may begin: log, start [s], length [s], part, time per cell."""

    log: Index
    start: Array
    length: Array
    part: Index
    cells: Array  # (P, c) s


def chosen(logs: Sequence[LookedOver], samples: float) -> list[list[Range]]:
    """Choose pieces of logs.

    Parameters
    ----------
    logs : sequence of LookedOver
    samples : float
        Of all pieces together, about.

    Returns
    -------
    list of list of (float, float)
        Per log, first and last moment of its pieces in the order of time, s since its first sample.
        All of it where that is little enough.
    """
    total = sum(log.samples for log in logs)
    if total <= samples:
        return [[(0.0, log.whole.length)] for log in logs]
    seconds = samples * sum(log.whole.length for log in logs) / total
    count = int(np.clip(round(seconds / PIECE_S), 1, MOST_PIECES))
    places = _places(logs, seconds / count, count)
    taken: list[int] = []
    for _ in range(SWEEPS):
        before = list(taken)
        taken = _swept(places, count, taken)
        if taken == before:
            break
    result: list[list[Range]] = [[] for _ in logs]
    for k in taken:
        start = float(places.start[k])
        result[places.log[k]].append((start, start + float(places.length[k])))
    return [sorted(ranges) for ranges in result]


def _swept(places: _Places, count: int, before: Sequence[int]) -> list[int]:
    """The best place of every part beside the others; those before, where they are known."""
    taken = {int(places.part[k]): k for k in before}
    for part in range(count):
        taken.pop(part, None)
        others = list(taken.values())
        free = np.flatnonzero(places.part == part)
        free = free[~_overlaps(places, free, others)]
        if len(free):
            have = places.cells[np.array(others, dtype=np.intp)].sum(axis=0)
            gain = np.sqrt(have + places.cells[free]).sum(axis=1)
            taken[part] = int(free[np.argmax(gain)])
    return [taken[part] for part in sorted(taken)]


def _overlaps(places: _Places, some: Index, taken: Sequence[int]) -> Mask:
    result = np.zeros(len(some), dtype=bool)
    for k in taken:
        apart = (places.start[some] >= places.start[k] + places.length[k]) | (
            places.start[some] + places.length[some] <= places.start[k]
        )
        result |= (places.log[some] == places.log[k]) & ~apart
    return result


def _places(logs: Sequence[LookedOver], length: float, count: int) -> _Places:
    """All places where a piece may be; a log that is shorter than a piece is one as a whole."""
    cells = _cells(logs)
    # Another log tells more that is new than more of the same one.
    weight = np.sqrt([log.whole.length for log in logs])
    before = np.concatenate([[0.0], np.cumsum(weight)])

    def part_at(place: Array) -> Index:
        part = (place / before[-1] * count + 1e-9).astype(np.intp)
        return np.asarray(np.minimum(part, count - 1))

    found = []
    for number, (log, own) in enumerate(zip(logs, cells, strict=True)):
        whole = log.whole.length
        piece = min(length, whole)
        steps = np.arange(int((whole - piece) / BLOCK_S) + 1)
        start = steps * BLOCK_S
        sums = np.vstack([np.zeros(own.shape[1]), np.cumsum(own, axis=0)])
        size = max(1, round(piece / BLOCK_S))
        high = np.minimum(steps + size, len(own))
        inside = sums[high] - sums[steps]
        there = inside[:, -1] >= WHOLE * np.max(inside[:, -1], initial=0.0)
        first, part, last = (
            part_at(before[number] + weight[number] * (start + share * piece) / max(whole, 1e-9))
            for share in (0.0, 0.5, 0.999)
        )
        # Within their own part pieces cannot be in each other's way.
        within = there & (first == part) & (last == part)
        there &= within | ~np.isin(part, part[within])
        n = np.count_nonzero(there)
        found.append(
            (np.full(n, number), start[there], np.full(n, piece), part[there], inside[there, :-1])
        )
    return _Places(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _cells(logs: Sequence[LookedOver]) -> list[Array]:
    """Seconds (B, c + 1) of each log's blocks in each cell; the last, that are usable at all."""
    q = np.concatenate([log.q[log.usable] for log in logs])
    dq = np.abs(np.concatenate([log.dq[log.usable] for log in logs]))
    if not len(q):
        return [np.zeros((len(log.squares), 1)) for log in logs]
    low, span = q.min(axis=0), np.maximum(np.ptp(q, axis=0), 1e-9)
    top = np.maximum(np.quantile(dq, TOP, axis=0), 1e-9)
    per_joint = 2 * POSITIONS * (len(SPEEDS) + 1)
    result = []
    for log in logs:
        place = np.clip(((log.q - low) / span * POSITIONS).astype(np.intp), 0, POSITIONS - 1)
        fast = np.searchsorted(SPEEDS, np.abs(log.dq) / top)
        cell = (place * (len(SPEEDS) + 1) + fast) * 2 + (log.dq > 0)
        n, blocks = cell.shape[1], len(log.squares)
        cell = cell + per_joint * np.arange(n)
        width = per_joint * n + 1
        row = np.minimum((log.t / BLOCK_S).astype(np.intp), blocks - 1)
        at = (row[:, None] * width + cell)[log.slides]
        sums = np.bincount(at, minlength=blocks * width).astype(np.float64).reshape(blocks, width)
        sums[:, -1] = np.bincount(row[log.usable], minlength=blocks)
        step = float(log.t[1] - log.t[0]) if len(log.t) > 1 else 0.0
        result.append(sums * step)
    return result
