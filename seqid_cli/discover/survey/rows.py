"""The samples that count, as rows: per joint, low-passed, thinned to what the band holds.

Twice low-passed signals hold nothing above about twice the cut-off, so four samples per
period of it lose nothing. Samples at which a joint does not certainly slide are left
out: whether and how long it sticks at a reversal is its controller's doing as much as
the friction's.

Rows belong to blocks of about two seconds, longer than the memory of the residual, and
blocks to folds, which are left out in turn: whatever is said to help must help where it
was not fitted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation

from seqid_cli.discover.survey.reversals import Reversal, reversals_of
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import REACH
from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array, Index, Mask

SAMPLES_PER_CUTOFF = 4
BLOCK_S = 2.0  # of the shortest blocks of time whose errors are compared
FOLDS = 10
MOST_ROWS = 40_000
TOGETHER = 64  # columns that are worked out together
FEWEST_ROWS = 40  # of a joint, all logs together, that are worth looking at
# of a joint's travel in other logs, below which it is held and only shaken
SHAKEN = 0.002
FEWEST_FOLDS = 3  # in which a joint must have rows
LEAST_OF_FOLD = 0.02  # of a joint's rows, that a fold must have to count
# of the share of time that it moves in another log: it only goes to its place
SELDOM = 0.15
SIMPLE = 2  # coefficients: Coulomb and viscous
# share of the logs outside the identified friction, from which it counts all
MOST_OUTSIDE = 0.6


@dataclass(frozen=True)
class Rows:
    """Which samples of each data set count, joint by joint."""

    scenes: tuple[Scene, ...]
    picked: tuple[Index, ...]  # (M,) by data set: the samples that are kept of all N
    used: tuple[Mask, ...]  # (M, n): whether each joint counts there
    block: tuple[Index, ...]  # (M,): the block of each, counted over all data sets
    fold: Index  # (blocks,), of each block

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.scenes[0].robot.n

    def count(self, joint: int) -> int:
        """Number of rows of a joint."""
        return sum(int(used[:, joint].sum()) for used in self.used)

    def blocks_of(self, joint: int) -> Index:
        """Block of every row of a joint."""
        return np.concatenate(
            [b[u[:, joint]] for b, u in zip(self.block, self.used, strict=True)]
        )

    def of(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of filtered values (N, ...), one array per data set."""
        parts = [
            v[p][u[:, joint]]
            for v, p, u in zip(values, self.picked, self.used, strict=True)
        ]
        return np.concatenate(parts)

    def torque(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of filtered torques (N, ...), whitened at reversals."""
        return self.whitened(joint, self.of(joint, values))

    def whitened(self, joint: int, values: Array) -> Array:
        """Whiten a joint's rows (M, ...) for what reversals leave open."""
        result = np.array(values, dtype=np.float64)
        wide = result.reshape(len(result), math.prod(result.shape[1:]))
        for reversal in self._reversals[joint]:
            reversal.whiten(wide)
        return result

    @cached_property
    def _reversals(self) -> list[list[Reversal]]:
        result: list[list[Reversal]] = [[] for _ in range(self.n)]
        for j, found in enumerate(result):
            first = 0
            for scene, picked, used in zip(
                self.scenes, self.picked, self.used, strict=True
            ):
                own = reversals_of(scene, picked, used[:, j], j)
                found += [
                    replace(reversal, first=reversal.first + first) for reversal in own
                ]
                first += int(used[:, j].sum())
        return result

    def columns(
        self, per_scene: Iterable[Mapping[int, Array]], passes: int
    ) -> dict[int, Array]:
        """Low-pass an effect's columns, log by log, and keep the rows of each joint."""
        rows: dict[int, list[Array]] = {}
        for number, columns in enumerate(per_scene):
            motion = self.scenes[number].motion
            every = stride_of(motion)
            at, used = self.picked[number] // every, self.used[number]
            for joint, values in columns.items():
                low = motion.filtered(values, passes, every=every)[at]
                rows.setdefault(joint, []).append(low[used[:, joint]])
        return {
            j: self.whitened(j, np.concatenate(values)) for j, values in rows.items()
        }

    def without(self, masks: Sequence[Mask]) -> Rows:
        """The same rows without some samples (N, n) of each data set."""
        parts = zip(self.used, masks, self.picked, strict=True)
        return replace(self, used=tuple(u & ~m[p] for u, m, p in parts))


def stride_of(motion: Motion) -> int:
    """Every how many samples of a motion one is kept."""
    return max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))


def rows_of(scenes: Sequence[Scene]) -> Rows:
    """Choose the rows of all logs, their blocks and folds."""
    picked, used, block, lengths = (
        list[Index](),
        list[Mask](),
        list[Index](),
        list[int](),
    )
    periods = sum(float(s.motion.t[-1]) * s.motion.lowpass.cutoff_hz for s in scenes)
    # very long logs: memory
    thin = max(1, math.ceil(SAMPLES_PER_CUTOFF * periods / MOST_ROWS))
    for scene, outside in zip(scenes, extrapolated(scenes), strict=True):
        motion = scene.motion
        at = np.arange(0, motion.samples, stride_of(motion))
        count = max(1, round(motion.t[-1] / BLOCK_S))
        own = np.minimum((at * count) // motion.samples, count - 1)
        kept = own % thin == 0
        picked.append(at[kept])
        used.append((scene.slides & ~outside)[at[kept]])
        block.append(own[kept] + sum(lengths))
        lengths.append(count)
    folds = _folds(lengths)
    counts = _predictable(_moved(scenes, picked, used), block, folds)
    return Rows(tuple(scenes), tuple(picked), counts, tuple(block), folds)


def extrapolated(scenes: Sequence[Scene]) -> list[Mask]:
    """Samples (N, n) where a friction surface is only held, or bent, beyond what was identified.

    Nothing that the model lacks is left there. Not masked are joints that are hardly
    ever inside, of which a surface is all there is, and Coulomb and viscous friction,
    whose columns go on.
    """
    found, surfaces = list[Mask](), scenes[0].model.surfaces
    for scene in scenes:
        motion, outside = scene.motion, scene.model.outside(scene.motion)
        for j, surface in enumerate(scene.model.surfaces):
            if surface is not None:
                outside[:, j] |= surface.vague(motion.q[:, j], motion.dq[:, j])
        # of the low-pass
        reach = max(1, int(REACH * motion.rate_hz / motion.lowpass.cutoff_hz))
        found.append(binary_dilation(outside, np.ones((2 * reach + 1, 1), dtype=bool)))
    share = np.mean(np.concatenate(found), axis=0)
    simple = np.array([s is None or s.positive.size <= SIMPLE for s in surfaces])
    return [outside & ~(simple | (share > MOST_OUTSIDE)) for outside in found]


def _moved(
    scenes: Sequence[Scene], picked: Sequence[Index], used: Sequence[Mask]
) -> tuple[Mask, ...]:
    """Leave out joints in logs in which they are only shaken or hardly move, or of next to no rows.

    A held joint that gives way a little shows its brake or stiction; a single move of a
    joint no other log predicts: left out, it would count for more than all of them.
    """
    travel = np.zeros((len(scenes), used[0].shape[1]))
    for own, scene, at, counts in zip(travel, scenes, picked, used, strict=True):
        for j in np.flatnonzero(counts.any(axis=0)):
            own[j] = np.ptp(scene.motion.q[at[counts[:, j]], j])
    often = np.array([u.mean(axis=0) for u in used])
    moves = (travel > SHAKEN * travel.max(axis=0)) & (
        often > SELDOM * often.max(axis=0)
    )
    kept = [u & m for u, m in zip(used, moves, strict=True)]
    enough = sum(u.sum(axis=0) for u in kept) >= FEWEST_ROWS
    return tuple(u & enough for u in kept)


def _predictable(
    used: Sequence[Mask], block: Sequence[Index], folds: Index
) -> tuple[Mask, ...]:
    """Leave out joints that move in too few folds: the other folds would not predict them."""
    counts = np.zeros((int(folds.max()) + 1, used[0].shape[1]))
    for u, b in zip(used, block, strict=True):
        np.add.at(counts, folds[b], u)
    share = counts / np.maximum(counts.sum(axis=0), 1)
    enough = (share > LEAST_OF_FOLD).sum(axis=0) >= min(FEWEST_FOLDS, len(counts))
    enough |= not enough.any()
    return tuple(u & enough for u in used)


def _folds(lengths: Sequence[int]) -> Index:
    """Folds of contiguous blocks: about FOLDS over all logs, and two in each at the least."""
    folds: list[Index] = []
    for length in lengths:
        pieces = max(min(2, length), round(FOLDS * length / sum(lengths)))
        start = folds[-1][-1] + 1 if folds else 0
        folds.append(start + (np.arange(length) * pieces) // length)
    return np.concatenate(folds).astype(np.intp)
