"""Errors on logs that were never fitted, and how sure a gain is.

A gain's interval comes from blocks of time drawn again and again (bootstrap): neighbouring samples
share their error, so that single samples would make any gain look certain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.predict import predict
from seqid_cli.identify.predict_long import local_effects
from seqid_cli.identify.prediction import LogPrediction
from seqid_cli.identify.streaming import LONG, open_if_long, streams
from seqid_cli.logs.long import likely_rows
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.stored import local_copy
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.survey import SurveyedLog
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

BLOCK_S = 2.0
FEWEST_BLOCKS = 8  # of a log, however short: an interval needs some
MOST_BLOCKS = 1000  # of a log that comes in parts
DRAWS = 2000
LEVEL = 0.95
LEAST_GAIN = 0.005  # of the squared error, from which a gain is worth an effect


@dataclass(frozen=True)
class HeldOutError:
    """Squared error (N m)^2 and samples (B, n) of every block, where a joint certainly slides.

    At rest the model says an interval: a wider one always fits better, and nothing is gained by it.
    """

    squares: Array
    samples: Array

    def beside(self, other: HeldOutError) -> HeldOutError:
        """The blocks of both."""
        return HeldOutError(
            np.vstack([self.squares, other.squares]), np.vstack([self.samples, other.samples])
        )

    def rmse(self) -> Array:
        """RMS error (n,) N m as `predict` reports it; NaN for a joint that never slides."""
        count = self.samples.sum(axis=0)
        mean = self.squares.sum(axis=0) / np.maximum(count, 1.0)
        return np.where(count > 0, np.sqrt(mean), np.nan)


@dataclass(frozen=True)
class Gain:
    """1 - after / before of the squared error, with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def certain(self) -> bool:
        """Whether it is worth an effect, and not by chance."""
        return self.value >= LEAST_GAIN and self.low > 0.0

    @property
    def loses(self) -> bool:
        """Whether something is lost that counts, and not by chance."""
        return self.value <= -LEAST_GAIN and self.high < 0.0


def held_out_error(
    recordings: Iterable[Recording | SurveyedLog],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    unexplained: bool = False,
) -> HeldOutError:
    """Predict logs and add up the squared errors, block by block.

    Two models are compared on the same samples where `options.slides_from` is given.
    """
    sums: list[_Sums] = []
    logs = cast("Iterable[Recording]", recordings)  # those that are passed over are predicted alike
    for log in predict(logs, robot, stages, options=options, unexplained=unexplained):
        if log.part == 0:
            sums.append(_Sums.of(log))
        sums[-1].add(log)
    return HeldOutError(
        np.vstack([own.squares for own in sums]), np.vstack([own.counts for own in sums])
    )


@dataclass
class _Sums:
    """Sums over the blocks of one log, whose samples come in parts."""

    squares: Array  # (B, n), as in HeldOutError
    counts: Array
    samples: int
    seen: int = 0

    @classmethod
    def of(cls, first: LogPrediction) -> _Sums:
        length = float(first.t[-1] - first.t[0])
        if first.last:
            count = max(FEWEST_BLOCKS, round(length / BLOCK_S))
        else:  # blocks of a log that is too long to be held are as many as draws bear
            length *= first.samples / len(first.t)
            count = min(max(FEWEST_BLOCKS, round(length / BLOCK_S)), MOST_BLOCKS)
        n = first.tau.shape[1]
        return cls(np.zeros((count, n)), np.zeros((count, n)), first.samples)

    def add(self, log: LogPrediction) -> None:
        """Add the next samples."""
        count = len(self.squares)
        at = np.arange(self.seen, self.seen + len(log.t))
        self.seen += len(log.t)
        block = np.minimum(at * count // self.samples, count - 1)
        self.squares += _by_block(block, count, np.where(log.sliding, log.residual**2, 0.0))
        self.counts += _by_block(block, count, log.sliding.astype(np.float64))


def _by_block(block: NDArray[np.intp], count: int, values: Array) -> Array:
    columns = [np.bincount(block, weights=v, minlength=count) for v in values.T]
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class WholeLogs:
    """Held-out logs that are too long to be held, whole, to be passed over."""

    paths: tuple[Path, ...]
    robot: Robot
    time_source: TimeSource = "header"

    def error(
        self, stages: Stages, *, options: InertiaOptions, unexplained: bool = False
    ) -> HeldOutError | None:
        """Error of a model on all samples; None where it cannot be predicted part by part.

        Raises
        ------
        InputError
            A log can no longer be read.
        """
        model = TorqueModel.from_stages(stages, self.robot)
        effects = fitted_effects(stages, self.robot, unexplained=unexplained)
        if not (streams(stages, options) and local_effects(model, effects)):
            return None
        found: HeldOutError | None = None
        for path in self.paths:
            with local_copy(path) as file:
                log = self._opened(Path(file))
                if log is None:
                    return None
                own = held_out_error(
                    [log], self.robot, stages, options=options, unexplained=unexplained
                )
            found = own if found is None else found.beside(own)
        return found

    def _opened(self, file: Path) -> Recording | SurveyedLog | None:
        """A log to be passed over, or a short one; None for a long one that must be held."""
        least = likely_rows(file)
        if least < LONG:
            return read_recording(file, self.robot, time_source=self.time_source) if least else None
        return open_if_long(file, self.robot, time_source=self.time_source, least=1)


def gain(
    before: HeldOutError,
    after: HeldOutError,
    joints: Collection[int],
    rng: np.random.Generator,
) -> Gain:
    """Compare two models on the same samples at some joints, each weighed by its error before."""
    chosen = [j for j in sorted(joints) if before.squares[:, j].sum() > 0]
    if not chosen:
        return Gain(0.0, 0.0, 0.0)
    old, new = before.squares[:, chosen], after.squares[:, chosen]
    weight = 1.0 / np.maximum(old.sum(axis=0), 1e-300)
    draws = rng.integers(0, len(old), (DRAWS, len(old)))
    counts = np.stack([np.bincount(d, minlength=len(old)) for d in draws]).astype(np.float64)
    ratio = (counts @ (new * weight)).sum(axis=1) / np.maximum(
        (counts @ (old * weight)).sum(axis=1), 1e-300
    )
    value = 1.0 - float((new * weight).sum() / max((old * weight).sum(), 1e-300))
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(1.0 - ratio, [tail, 1.0 - tail])
    return Gain(value, float(low), float(high))
