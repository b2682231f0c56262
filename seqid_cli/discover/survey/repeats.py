"""Which motion comes again, in a log and from log to log, and blocks of it.

Periodic excitation is what identification asks for, a cycle of work is done again and
again, and a trial is often repeated. Whatever is wrong in a model, or in the motion
itself, then comes back each time, as large and of the same sign: counts of an encoder,
a bend of a law. A fit that such a stretch is left out of has seen it all the same. So
all stretches of the same phase are left out together (see `survey.rows`).

A motion has a clock of its own, its *phase*. A log that has the motion of an earlier
one has its clock as well, from another time on. Motions that never come again have the
clock of their log.

In shapes, N is the number of samples of a data set, L that on a coarse grid of time,
and n the number of joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.effects.repetition import vertex
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.motion import Motion
from seqid_cli.spectra import correlated
from seqid_cli.typing import Array, Index

SAMPLES_PER_CUTOFF = 4
BLOCK_S = 2.0  # of the shortest blocks of time whose errors are compared
# Of a short period, so that some may be left out; odd, so that every second block of a
# long log is of all phases.
FEWEST_BLOCKS = 5
# Mean square of the difference of positions over that of both, all joints together,
# below which they do the same, and above which they do not.
SAME = 0.1
APART = 0.5
# Share of the shorter log in which both must be there to be compared.
OVERLAP = 1.0 / 3.0
RESTING = 0.01  # of the deviation of the joint that moves most, below which it rests
GRID_HZ = 20.0  # of positions that are compared
MOST_COMPARED = 40  # motions that a log is compared with


def stride_of(motion: Motion) -> int:
    """Return every how many samples of a motion one is kept."""
    return max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))


@dataclass(frozen=True)
class Blocks:
    """Blocks of a data set.

    Attributes
    ----------
    number : (N,) index array
        The block of each sample, from 0 on.
    group : (blocks,) index array
        Which of them are of the same motion and phase, over all data sets.
    moment : (N,) index array
        The moment of its motion in which each sample is, over all data sets. No two
        samples of a motion that never comes again have the same.
    """

    number: Index
    group: Index
    moment: Index


@dataclass(frozen=True, kw_only=True)
class _Clock:
    """The phase of a data set.

    Attributes
    ----------
    motion : int
        Number of the motion.
    start_s : float
        Phase [s] of its first sample.
    period_s : float
        Time after which the motion comes again [s]; infinite if it never does.
    """

    motion: int
    start_s: float = 0.0
    period_s: float = np.inf


def blocks_of(scenes: Sequence[Scene]) -> list[Blocks]:
    """Divide data sets into blocks of time, those of a repeated motion by its phase.

    Parameters
    ----------
    `scenes` : sequence of `Scene`
        The data sets, one per log.

    Returns
    -------
    list of Blocks
        One per data set. A block of a motion that never comes again has a group of its
        own.
    """
    phases = _phases(scenes)
    group_of_part: dict[tuple[int, int], int] = {}
    n_moments = max(phase.n_moments for phase in phases)
    result: list[Blocks] = []
    for phase in phases:
        begins = np.diff(phase.part, prepend=phase.part[0] - 1) != 0
        groups = [
            group_of_part.setdefault((phase.motion, int(part)), len(group_of_part))
            for part in phase.part[begins]
        ]
        result.append(
            Blocks(
                number=np.cumsum(begins) - 1,
                group=np.array(groups, dtype=np.intp),
                moment=phase.motion * n_moments + phase.moment,
            )
        )
    return result


@dataclass(frozen=True, kw_only=True)
class _Phase:
    """Where a data set is in its motion.

    Attributes
    ----------
    motion : int
        Number of the motion.
    part : (N,) index array
        The part of it in which each sample is.
    moment : (N,) index array
        The moment of it.
    n_moments : int
        How many there are.
    """

    motion: int
    part: Index
    moment: Index
    n_moments: int


def _phases(scenes: Sequence[Scene]) -> list[_Phase]:
    """Return where every data set is in its motion, sample by sample."""
    clocks = _clocks(scenes)
    begin_s = [clock.start_s for clock in clocks]
    end_s = [
        clock.start_s + float(scene.motion.t[-1] - scene.motion.t[0])
        for scene, clock in zip(scenes, clocks, strict=True)
    ]
    phases: list[_Phase] = []
    for scene, clock in zip(scenes, clocks, strict=True):
        motion = scene.motion
        same = [i for i, other in enumerate(clocks) if other.motion == clock.motion]
        first_s = min(begin_s[i] for i in same)
        extent_s = max(end_s[i] for i in same) - first_s
        length_s = max(min(extent_s, clock.period_s), 1e-9)

        comes_again = len(same) > 1 or np.isfinite(clock.period_s)
        n_parts = max(1, round(length_s / BLOCK_S))
        n_moments = scene.samples
        if comes_again:
            n_parts = max(n_parts, FEWEST_BLOCKS)
            n_parts += 1 - n_parts % 2
            # A moment is in one part: rows that share noise are left out together.
            kept_hz = motion.rate_hz / stride_of(motion)
            n_moments = n_parts * max(1, round(length_s * kept_hz / n_parts))

        share = (motion.t - motion.t[0] + clock.start_s - first_s) / length_s
        if np.isfinite(clock.period_s):
            share = np.mod(share, 1.0)
        phases.append(
            _Phase(
                motion=clock.motion,
                part=_numbered(share, n_parts),
                moment=_numbered(share, n_moments),
                n_moments=n_moments,
            )
        )
    return phases


def _numbered(share: Array, count: int) -> Index:
    """Return in which of so many equal parts shares (N,) from 0 to 1 are."""
    number = np.minimum(np.floor(share * count), count - 1)
    return np.asarray(number, dtype=np.intp)


def _clocks(scenes: Sequence[Scene]) -> list[_Clock]:
    """Return the clock of each data set: its own, or that of an earlier one."""
    courses = _courses(scenes)
    clocks: list[_Clock] = []
    first_of_motion: list[int] = []
    for course in courses:
        clock = _Clock(
            motion=len(first_of_motion), period_s=_time_after(course, course)
        )
        for motion, first in enumerate(first_of_motion[:MOST_COMPARED]):
            start_s = _time_after(courses[first], course)
            if np.isfinite(start_s):
                clock = replace(clock, motion=motion, start_s=start_s)
                break
        else:
            first_of_motion.append(len(clocks))
        clocks.append(clock)

    # A log may be too short to show a period that another one of its motion shows.
    period_of_motion = [
        min(clock.period_s for clock in clocks if clock.motion == motion)
        for motion in range(len(first_of_motion))
    ]
    return [replace(clock, period_s=period_of_motion[clock.motion]) for clock in clocks]


def _courses(scenes: Sequence[Scene]) -> list[Array]:
    """Return how joints that move go (L, m), on a coarse grid of time, about as far."""
    positions = []
    for scene in scenes:
        time = scene.motion.t - scene.motion.t[0]
        grid = np.arange(0.0, time[-1], 1.0 / GRID_HZ)
        of_joints = [np.interp(grid, time, of_joint) for of_joint in scene.motion.q.T]
        positions.append(np.stack(of_joints, axis=1))
    deviation = np.max([np.std(q, axis=0) for q in positions], axis=0)
    moves = deviation > RESTING * deviation.max()
    return [q[:, moves] / deviation[moves] for q in positions]


def _time_after(first: Array, second: Array) -> float:
    """Return when a course begins to do what the other does from its begin on.

    Parameters
    ----------
    first : (L, m) array
        The course that is looked at from some time on.
    second : (L', m) array
        The course that is compared with it; the same one if a period is wanted.

    Returns
    -------
    float
        Time [s], negative where the second one begins before the first; infinite if
        they have nothing in common.
    """
    n_first = len(first)
    n_second = len(second)
    least = max(int(OVERLAP * min(n_first, n_second)), int(BLOCK_S * GRID_HZ))
    lags = np.arange(-(n_second - least), n_first - least + 1)
    if not len(lags) or not first.shape[1]:
        return np.inf

    difference = _difference(first, second, lags)
    is_same = difference < SAME
    if first is second:
        # What has not been something else in between is the same stay, no repetition.
        parted = np.flatnonzero((difference > APART) & (lags > 0))
        is_same[: parted[0] if len(parted) else len(lags)] = False
    candidates = np.flatnonzero(is_same)
    if not len(candidates):
        return np.inf

    # A motion comes again after its period first, and as well after all multiples.
    if first is second:
        candidates = candidates[: np.argmax(np.append(np.diff(candidates), 2) > 1) + 1]
    best = int(candidates[np.argmin(difference[candidates])])
    return float(lags[best] + vertex(difference, best)) / GRID_HZ


def _difference(first: Array, second: Array, lags: Index) -> Array:
    """Return the mean square of a difference over that of both, lag by lag.

    Parameters
    ----------
    first, second : (L, m) and (L', m) arrays
        Courses; at a lag k, sample i of the second stands beside sample i + k of the
        first.
    lags : (K,) index array
        The lags.

    Returns
    -------
    (K,) array
        About 1 where they have nothing to do with each other. Where they are is a
        difference as well: gravity may be another one there.
    """
    start = np.maximum(lags, 0)
    stop = np.minimum(lags + len(second), len(first))
    count = stop - start

    def summed(values: Array, begin: Index) -> Array:
        """Sum values (L,) over what both courses have."""
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(sums[begin + count] - sums[begin])

    apart = np.zeros(len(lags))
    motion = np.full(len(lags), 1e-12)
    middle = first.mean(axis=0)
    for x, y in zip((first - middle).T, (second - middle).T, strict=True):
        squares = summed(x**2, start) + summed(y**2, start - lags)
        products = correlated(x, y)[lags + len(y) - 1]
        apart += squares - 2.0 * products
        motion += squares
        motion -= (summed(x, start) ** 2 + summed(y, start - lags) ** 2) / count
    return np.asarray(apart / motion)
