"""The samples that count, as rows: per joint, low-passed, thinned to what the band holds.

Twice low-passed signals hold nothing above about twice the cut-off, so five samples per period of
it lose nothing. Samples at which a joint does not certainly slide are left out: whether and how
long it sticks at a reversal is its controller's doing as much as the friction's.

Rows belong to blocks of about two seconds, longer than the memory of the residual, and blocks to
folds, which are left out in turn: whatever is said to help must help where it was not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import sliding

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

SAMPLES_PER_CUTOFF = 5
BLOCK_S = 2.0
FOLDS = 10
MOST_ROWS = 40_000


@dataclass(frozen=True)
class Rows:
    """Which samples of each scene count, joint by joint.

    Attributes
    ----------
    scenes : tuple of Scene
    picked : tuple of (M,) index arrays
        Per scene, the samples that are kept of all N.
    used : tuple of (M, n) masks
        Per scene, the kept samples at which each joint counts.
    block : tuple of (M,) index arrays
        Per scene, the block (counted over all scenes) of each kept sample.
    fold : (blocks,) index array
        The fold of each block.
    """

    scenes: tuple[Scene, ...]
    picked: tuple[Index, ...]
    used: tuple[Mask, ...]
    block: tuple[Index, ...]
    fold: Index

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.scenes[0].robot.n

    def count(self, joint: int) -> int:
        """Number of rows of a joint."""
        return sum(int(used[:, joint].sum()) for used in self.used)

    def blocks_of(self, joint: int) -> Index:
        """Block of every row of a joint."""
        parts = [b[u[:, joint]] for b, u in zip(self.block, self.used, strict=True)]
        return np.concatenate(parts)

    def folds_of(self, joint: int) -> Index:
        """Fold of every row of a joint."""
        return self.fold[self.blocks_of(joint)]

    def of(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of filtered values (N, ...), one array per scene."""
        parts = [v[p][u[:, joint]] for v, p, u in zip(values, self.picked, self.used, strict=True)]
        return np.concatenate(parts)

    def columns(self, per_scene: Sequence[Mapping[int, Array]], passes: int) -> dict[int, Array]:
        """Low-pass an effect's columns, scene by scene, and keep the rows of each joint."""
        filtered: dict[int, list[Array]] = {}
        for scene, columns in zip(self.scenes, per_scene, strict=True):
            for joint, values in columns.items():
                filtered.setdefault(joint, []).append(scene.motion.filtered(values, times=passes))
        return {joint: self.of(joint, values) for joint, values in filtered.items()}

    def without(self, events: Sequence[Mask]) -> Rows:
        """The same rows without the samples (N,) of each scene that belong to events."""
        used = tuple(
            u & ~e[p][:, None] for u, e, p in zip(self.used, events, self.picked, strict=True)
        )
        return replace(self, used=used)


def rows_of(scenes: Sequence[Scene]) -> Rows:
    """Choose the rows of all logs, their blocks and folds."""
    picked, used, block, lengths = [], [], [], []
    thin = _thinning(scenes)
    first = 0
    for scene in scenes:
        motion = scene.motion
        stride = max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))
        at = np.arange(0, motion.samples, stride)
        count = max(1, round(motion.t[-1] / BLOCK_S))
        own = np.minimum((at * count) // motion.samples, count - 1)
        kept = own % thin == 0
        picked.append(at[kept])
        used.append(sliding(motion, 2.0 * scene.sign_width)[at[kept]])
        block.append(own[kept] + first)
        lengths.append(count)
        first += count
    return Rows(
        tuple(scenes),
        tuple(picked),
        tuple(used),
        tuple(block),
        _folds(lengths),
    )


def _thinning(scenes: Sequence[Scene]) -> int:
    """Every how many blocks one is kept, so that very long logs fit into memory."""
    rows = sum(
        float(s.motion.t[-1]) * SAMPLES_PER_CUTOFF * s.motion.lowpass.cutoff_hz for s in scenes
    )
    return max(1, int(np.ceil(rows / MOST_ROWS)))


def _folds(lengths: Sequence[int]) -> Index:
    """Folds of contiguous blocks: about FOLDS over all logs, and at least two in each log."""
    total = sum(lengths)
    folds: list[Index] = []
    for length in lengths:
        pieces = max(min(2, length), round(FOLDS * length / total))
        start = folds[-1][-1] + 1 if folds else 0
        folds.append(start + (np.arange(length) * pieces) // length)
    return np.concatenate(folds).astype(np.intp)
