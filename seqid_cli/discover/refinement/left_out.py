"""Blocks of time of the training logs, left out in turn: who predicts them best decides.

Every log is cut into stretches of equal length, one for each fold, shifted from log to log, so that
no fold misses one part of all motions. A model of a fold is fitted to logs whose samples in its
stretches are marked as not to be used, and predicts these from the logs as they are: same filter,
same samples for every model. A stretch is long against what the low-pass remembers and against
most that a residual does; what is correlated for longer widens the interval of a gain (see
`heldout`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.discover.refinement.held_out import BlockSums, HeldOutError, joined
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index

FOLDS = 3
STRETCH_S = 4.0  # of a stretch, at least; a shorter log is left out as a whole


@dataclass(frozen=True)
class Folds:
    """Which fold leaves out which moment: per log, the fold of each of its stretches."""

    of_stretch: tuple[Index, ...]

    @classmethod
    def of(cls, logs: Sequence[Recording]) -> Folds:
        """Cut logs; folds that no stretch is in are not counted."""
        found = []
        for number, log in enumerate(logs):
            stretches = int(np.clip(_length(log) // STRETCH_S, 1, FOLDS))
            found.append((np.arange(stretches, dtype=np.intp) + number) % FOLDS)
        used = np.unique(np.concatenate(found))
        return cls(tuple(np.searchsorted(used, own) for own in found))

    @property
    def count(self) -> int:
        """Number of folds; with one alone nothing can be left out."""
        return 1 + max(int(own.max()) for own in self.of_stretch)

    def of_samples(self, log: int, t: Array, length: float) -> Index:
        """Fold (N,) of moments t (N,) s since the first sample of a log of this length."""
        own = self.of_stretch[log]
        stretch = (t / max(length, 1e-9) * len(own)).astype(np.intp)
        return np.asarray(own[np.clip(stretch, 0, len(own) - 1)])

    def without(self, logs: Sequence[Recording], fold: int) -> tuple[Recording, ...]:
        """The logs with one fold's samples marked as not to be used."""
        result = []
        for number, log in enumerate(logs):
            own = self.of_samples(number, log.t - log.t[0], _length(log))
            result.append(replace(log, valid=log.valid & (own != fold)))
        return tuple(result)


def _length(log: Recording) -> float:
    return float(log.t[-1] - log.t[0])


def left_out_error(
    logs: Sequence[Recording],
    folds: Folds,
    robot: Robot,
    models: Sequence[Stages],
    *,
    options: InertiaOptions,
) -> HeldOutError:
    """Squared errors of every block, each sample predicted by the model that has not seen it.

    Parameters
    ----------
    logs : sequence of Recording
        As they are, in the order in which `folds` counts them.
    folds : Folds
    robot : Robot
    models : sequence of Stages
        Of the folds from the first on. Samples of folds that have none do not count.
    options : InertiaOptions
        With `slides_from`, so that all models are judged on the same samples.
    """
    sums: list[BlockSums] = []
    for fold, stages in enumerate(models):
        found = predict(logs, robot, stages, options=options, unexplained=True)
        for number, (log, prediction) in enumerate(zip(logs, found, strict=True)):
            if fold == 0:
                sums.append(BlockSums.of(prediction))
            own = folds.of_samples(number, prediction.t - prediction.t[0], _length(log))
            sums[number].seen = 0
            sums[number].add(prediction, prediction.sliding & (own == fold)[:, None])
    return joined(own.error for own in sums)
