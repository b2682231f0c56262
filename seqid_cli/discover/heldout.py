"""Errors on logs that were never fitted, and how sure a gain is.

A gain's interval comes from blocks of time drawn again and again (bootstrap): neighbouring samples
share their error, so that single samples would make any gain look certain.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.predict import predict
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

BLOCK_S = 2.0
FEWEST_BLOCKS = 8  # of a log, however short: an interval needs some
DRAWS = 2000
LEVEL = 0.95
LEAST_GAIN = 0.005  # of the squared error, from which a gain is worth an effect


@dataclass(frozen=True)
class HeldOutError:
    """Squared error (N m)^2 and samples (B, n) of every block, over all samples that count.

    `sliding`, `sliding_samples` (B, n) are the same where a joint certainly slides.
    """

    squares: Array
    samples: Array
    sliding: Array
    sliding_samples: Array

    def beside(self, other: HeldOutError) -> HeldOutError:
        """The blocks of both."""
        pairs = zip(self._parts, other._parts, strict=True)
        return HeldOutError(*(np.vstack(pair) for pair in pairs))

    @property
    def _parts(self) -> tuple[Array, Array, Array, Array]:
        return self.squares, self.samples, self.sliding, self.sliding_samples

    def rmse(self) -> Array:
        """RMS error (n,) N m as `predict` reports it; NaN for a joint that is not judged."""
        judged = self.sliding_samples.sum(axis=0) > 0
        mean = self.squares.sum(axis=0) / np.maximum(self.samples.sum(axis=0), 1.0)
        return np.where(judged, np.sqrt(mean), np.nan)


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
    recordings: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    unexplained: bool = False,
) -> HeldOutError:
    """Predict logs and add up the squared errors, block by block."""
    parts: list[list[Array]] = [[], [], [], []]
    for log in predict(recordings, robot, stages, options=options, unexplained=unexplained):
        count = max(FEWEST_BLOCKS, round(float(log.t[-1] - log.t[0]) / BLOCK_S))
        block = np.minimum(np.arange(log.samples) * count // log.samples, count - 1)
        square = (log.tau - log.predicted) ** 2
        used = np.repeat(log.used[:, None], square.shape[1], axis=1)
        for part, counts in zip((0, 2), (used, used & log.sliding), strict=True):
            parts[part].append(_by_block(block, count, np.where(counts, square, 0.0)))
            parts[part + 1].append(_by_block(block, count, counts.astype(np.float64)))
    return HeldOutError(*(np.vstack(part) for part in parts))


def _by_block(block: NDArray[np.intp], count: int, values: Array) -> Array:
    columns = [np.bincount(block, weights=v, minlength=count) for v in values.T]
    return np.stack(columns, axis=1)


def gain(
    before: HeldOutError,
    after: HeldOutError,
    joints: Collection[int],
    rng: np.random.Generator,
) -> Gain:
    """Compare two models on the same logs at some joints, each weighed by its error before.

    Where joints slide counts: at rest a wider interval of friction always fits better.
    """
    chosen = [j for j in sorted(joints) if before.sliding[:, j].sum() > 0]
    if not chosen:
        return Gain(0.0, 0.0, 0.0)
    old, new = before.sliding[:, chosen], after.sliding[:, chosen]
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
