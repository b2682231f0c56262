"""The samples that count, as rows: per joint, low-passed, thinned to the band.

Twice low-passed signals hold nothing above about twice the cut-off, so four samples per
period of it lose nothing. Samples at which a joint does not certainly slide are left
out: whether and how long it sticks at a reversal is its controller's doing as much as
the friction's.

Rows belong to blocks of about two seconds, longer than the memory of the residual.
Blocks of the same motion, as far as it comes again, are a group, and groups belong to
folds. They are left out in turn: whatever is said to help must help where it was not
fitted.

In shapes, N is the number of samples of a data set, M that of the samples which are
kept of it, M_j the number of rows of joint j over all data sets, and n the number of
joints.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from seqid_cli.discover.survey.repeats import (
    SAMPLES_PER_CUTOFF,
    blocks_of,
    stride_of,
)
from seqid_cli.discover.survey.reversals import Reversal, Whitening, reversals_of
from seqid_cli.effects.scene import Scene
from seqid_cli.model.torque import REACH
from seqid_cli.running import Number
from seqid_cli.typing import Array, Index, Mask

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


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Which samples of each data set count, joint by joint.

    Attributes
    ----------
    `scenes` : tuple of `Scene`
        The data sets, one per log.
    samples : tuple of (M,) index arrays
        By data set: the samples that are kept of all N.
    used : tuple of (M, n) masks
        By data set: whether each joint counts at a kept sample.
    block : tuple of (M,) index arrays
        By data set: the block of each kept sample, counted over all data sets.
    moment : tuple of (M,) index arrays
        By data set: the moment of its motion at each kept sample, counted over all.
    group : (blocks,) index array
        The group of each block: those of the same motion.
    fold : (blocks,) index array
        The fold of each block.
    """

    scenes: tuple[Scene, ...]
    samples: tuple[Index, ...]
    used: tuple[Mask, ...]
    block: tuple[Index, ...]
    moment: tuple[Index, ...]
    group: Index
    fold: Index

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.scenes[0].robot.n

    @property
    def log_of_block(self) -> Index:
        """The data set (blocks,) of each block."""
        log = np.zeros(len(self.fold), dtype=np.intp)
        first_blocks = [int(block[0]) for block in self.block if len(block)]
        log[first_blocks[1:]] = 1
        return np.cumsum(log)

    def has_rows_of(self, others: Rows) -> bool:
        """Return whether the same samples count here and there."""
        return all(map(np.array_equal, self.used, others.used))

    def count(self, joint: int) -> int:
        """Return the number of rows of a joint."""
        return sum(int(used[:, joint].sum()) for used in self.used)

    def blocks_of(self, joint: int) -> Index:
        """Return the block (M_j,) of every row of a joint."""
        return self.of_kept(joint, self.block)

    def of(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of filtered values.

        Parameters
        ----------
        joint : int
            Index of the joint.
        values : sequence of (N, ...) arrays
            One per data set, in any unit.

        Returns
        -------
        (M_j, ...) array
            By data set, then by time.
        """
        parts = [
            of_scene[samples][used[:, joint]]
            for of_scene, samples, used in zip(
                values, self.samples, self.used, strict=True
            )
        ]
        return np.concatenate(parts)

    def of_kept(self, joint: int, values: Sequence[NDArray[Number]]) -> NDArray[Number]:
        """Stack the joint's rows of values (M, ...) at the kept samples alone."""
        parts = [
            of_scene[used[:, joint]]
            for of_scene, used in zip(values, self.used, strict=True)
        ]
        return np.concatenate(parts)

    def torque(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of filtered torques, and whiten them at reversals.

        Parameters
        ----------
        joint : int
            Index of the joint.
        values : sequence of (N, ...) arrays
            One per data set, torque [N m; N where prismatic] or columns of it.

        Returns
        -------
        (M_j, ...) array
            In the same unit.
        """
        return self.whitened(joint, self.of(joint, values))

    def whitened(self, joint: int, values: Array) -> Array:
        """Whiten a joint's rows for what reversals leave open.

        Parameters
        ----------
        joint : int
            Index of the joint.
        values : (M_j, ...) array
            Torque [N m; N where prismatic] or columns of it; it stays as it is.
        """
        result = np.array(values, dtype=np.float64)
        n_columns = math.prod(result.shape[1:])
        side_by_side = result.reshape(len(result), n_columns)  # a view of the result
        self._whitenings[joint].whiten(side_by_side)
        return result

    @cached_property
    def _whitenings(self) -> list[Whitening]:
        """What whitens each joint's rows."""
        return [
            Whitening.of(self._reversals_of(joint), self.count(joint))
            for joint in range(self.n)
        ]

    def _reversals_of(self, joint: int) -> list[Reversal]:
        """Return a joint's reversals, counted in its rows over all data sets."""
        reversals: list[Reversal] = []
        first_row = 0
        for scene, samples, used in zip(
            self.scenes, self.samples, self.used, strict=True
        ):
            for reversal in reversals_of(scene, samples, used[:, joint], joint):
                reversals.append(replace(reversal, first=reversal.first + first_row))
            first_row += int(used[:, joint].sum())
        return reversals

    def columns(
        self, per_scene: Iterable[Mapping[int, Array]], passes: int
    ) -> dict[int, Array]:
        """Low-pass an effect's columns, log by log, and keep the rows of each joint.

        Parameters
        ----------
        per_scene : iterable of mappings of joint to (N, k) array
            Torque per unit coefficient [N m; N where prismatic], unfiltered, in the
            order of the data sets. Each is low-passed before the next one is asked for.
        passes : int
            How often the low-pass is applied.

        Returns
        -------
        dict of joint to (M_j, k) array
            Whitened at reversals.
        """
        rows: dict[int, list[Array]] = {}
        for number, columns in enumerate(per_scene):
            motion = self.scenes[number].motion
            stride = stride_of(motion)
            kept_rows = self.samples[number] // stride
            used = self.used[number]
            if not columns:
                continue
            # All in one go: of a short log each call would cost more than it has to do.
            together = np.hstack(list(columns.values()))
            low = motion.filtered(together, passes, every=stride)[kept_rows]
            ends = np.cumsum([values.shape[1] for values in columns.values()])
            for joint, of_joint in zip(
                columns, np.split(low, ends[:-1], axis=1), strict=True
            ):
                rows.setdefault(joint, []).append(of_joint[used[:, joint]])
        return {
            joint: self.whitened(joint, np.concatenate(values))
            for joint, values in rows.items()
        }

    def without(self, masks: Sequence[Mask]) -> Rows:
        """Return the same rows without some samples (N, n) of each data set."""
        used_elsewhere = [
            used & ~mask[samples]
            for used, mask, samples in zip(self.used, masks, self.samples, strict=True)
        ]
        return replace(self, used=tuple(used_elsewhere))


def rows_of(scenes: Sequence[Scene]) -> Rows:
    """Choose the rows of all logs, their blocks and folds.

    Parameters
    ----------
    `scenes` : sequence of `Scene`
        The data sets, one per log.

    Returns
    -------
    Rows
        A joint counts where it certainly slides, at speeds and positions at which its
        friction was identified, in logs and folds in which it moves enough.
    """
    samples_by_scene: list[Index] = []
    used_by_scene: list[Mask] = []
    block_by_scene: list[Index] = []
    moment_by_scene: list[Index] = []
    blocks_by_scene = blocks_of(scenes)

    # Of very long logs every second block is kept, or every third, ...: memory.
    periods = sum(
        float(scene.motion.t[-1]) * scene.motion.lowpass.cutoff_hz for scene in scenes
    )
    block_stride = max(1, math.ceil(SAMPLES_PER_CUTOFF * periods / MOST_ROWS))

    n_blocks = 0
    for scene, blocks, outside in zip(
        scenes, blocks_by_scene, extrapolated(scenes), strict=True
    ):
        samples = np.arange(0, scene.samples, stride_of(scene.motion))
        block = blocks.number[samples]
        is_kept = block % block_stride == 0
        samples_by_scene.append(samples[is_kept])
        used_by_scene.append((scene.slides & ~outside)[samples[is_kept]])
        block_by_scene.append(block[is_kept] + n_blocks)
        moment_by_scene.append(blocks.moment[samples[is_kept]])
        n_blocks += len(blocks.group)

    group = np.concatenate([blocks.group for blocks in blocks_by_scene])
    fold = _folds([blocks.group for blocks in blocks_by_scene])[group]
    moving = _without_shaken_joints(scenes, samples_by_scene, used_by_scene)
    return Rows(
        scenes=tuple(scenes),
        samples=tuple(samples_by_scene),
        used=_without_unpredictable_joints(moving, block_by_scene, fold),
        block=tuple(block_by_scene),
        moment=tuple(moment_by_scene),
        group=group,
        fold=fold,
    )


def extrapolated(scenes: Sequence[Scene]) -> list[Mask]:
    """Return where a friction surface goes beyond what was identified.

    There it is only held, or bent, and what is left is no lack of the model. Not masked
    are joints that are hardly ever inside, of which a surface is all there is, and
    Coulomb and viscous friction, whose columns go on.

    Parameters
    ----------
    `scenes` : sequence of `Scene`
        The data sets, one per log.

    Returns
    -------
    list of (N, n) masks
        One per data set, with the samples that the low-pass reaches from there.
    """
    outside_by_scene: list[Mask] = []
    for scene in scenes:
        motion = scene.motion
        outside = scene.model.outside(motion)
        for joint, surface in enumerate(scene.model.surfaces):
            if surface is not None:
                outside[:, joint] |= surface.vague(
                    motion.q[:, joint], motion.dq[:, joint]
                )

        # What the model does there passes the low-pass into the samples around.
        reach = max(1, int(REACH * motion.rate_hz / motion.lowpass.cutoff_hz))
        neighbourhood = np.ones((2 * reach + 1, 1), dtype=bool)
        outside_by_scene.append(binary_dilation(outside, neighbourhood))

    share_outside = np.mean(np.concatenate(outside_by_scene), axis=0)
    is_simple = np.array(
        [
            surface is None or surface.positive.size <= SIMPLE
            for surface in scenes[0].model.surfaces
        ]
    )
    counts_anyway = is_simple | (share_outside > MOST_OUTSIDE)
    return [outside & ~counts_anyway for outside in outside_by_scene]


def _without_shaken_joints(
    scenes: Sequence[Scene], samples: Sequence[Index], used: Sequence[Mask]
) -> list[Mask]:
    """Leave out joints in logs in which they are only shaken or hardly move.

    A held joint that gives way a little shows its brake or stiction; a single move of a
    joint no other log predicts: left out, it would count for more than all of them. A
    joint of next to no rows is left out everywhere.
    """
    n_joints = used[0].shape[1]
    travel = np.zeros((len(scenes), n_joints))
    for number, scene in enumerate(scenes):
        counts = used[number]
        for joint in np.flatnonzero(counts.any(axis=0)):
            positions = scene.motion.q[samples[number][counts[:, joint]], joint]
            travel[number, joint] = np.ptp(positions)

    share_of_time = np.array([counts.mean(axis=0) for counts in used])
    travels = travel > SHAKEN * travel.max(axis=0)
    moves_often = share_of_time > SELDOM * share_of_time.max(axis=0)
    moves = travels & moves_often

    moving = [counts & in_log for counts, in_log in zip(used, moves, strict=True)]
    has_enough_rows = sum(counts.sum(axis=0) for counts in moving) >= FEWEST_ROWS
    return [counts & has_enough_rows for counts in moving]


def _without_unpredictable_joints(
    used: Sequence[Mask], block: Sequence[Index], fold: Index
) -> tuple[Mask, ...]:
    """Leave out joints that move in so few folds that others do not predict them.

    Of logs that are so short that they have no more folds no joint is left: nothing can
    be left out of a fit to them and predicted.
    """
    n_folds = int(fold.max()) + 1
    rows_in_fold = np.zeros((n_folds, used[0].shape[1]))
    for counts, block_of_sample in zip(used, block, strict=True):
        np.add.at(rows_in_fold, fold[block_of_sample], counts)

    share = rows_in_fold / np.maximum(rows_in_fold.sum(axis=0), 1)
    n_filled_folds = (share > LEAST_OF_FOLD).sum(axis=0)
    enough = n_filled_folds >= FEWEST_FOLDS
    return tuple(counts & enough for counts in used)


def _folds(group_by_scene: Sequence[Index]) -> Index:
    """Return the fold (groups,) of each group: about FOLDS in all, two a log at least.

    Groups are numbered as they come. A log that has the motion of others adds none.
    """
    total = 1 + max(int(group.max()) for group in group_by_scene)
    folds: list[Index] = []
    n_known = 0
    n_folds = 0
    for group in group_by_scene:
        n_new = max(int(group.max()) + 1 - n_known, 0)
        n_of_log = max(min(2, n_new), round(FOLDS * n_new / total))
        folds.append(n_folds + (np.arange(n_new) * n_of_log) // max(n_new, 1))
        n_known += n_new
        n_folds += n_of_log
    return np.concatenate(folds).astype(np.intp)
