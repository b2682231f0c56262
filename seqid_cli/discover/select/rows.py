"""Rows that are to be explained, columns that may explain them, and what they gain.

How sure a gain is over blocks that differ is told by drawn weights of the blocks (D. B.
Rubin, "The Bayesian bootstrap", Annals of Statistics 9, 1981): what shows in a few
blocks alone may still be sure, if nothing speaks against it elsewhere.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from seqid_cli.discover.survey.rows import SAMPLES_PER_CUTOFF
from seqid_cli.motion.torque_noise import LEVEL
from seqid_cli.typing import Array, Index

Channels = Mapping[int, Array]  # channel -> its rows of some columns (M_c, k)

ALIKE = 0.5 * SAMPLES_PER_CUTOFF  # rows of low-passed signals that tell as much as one
DRAWS, SEED = 400, 0  # of weights of the blocks


@dataclass(frozen=True)
class Observations:
    """What is to be explained."""

    y: tuple[Array, ...]  # (M_c,) by channel, torque [N m; N where prismatic]
    # (M_c,) by channel, the block of time of each row, ascending
    block: tuple[Index, ...]
    blocks: int
    # how many channels show the same as each does; empty: one
    views: tuple[int, ...] = ()

    @cached_property
    def independent(self) -> Array:
        """Number (channels, blocks) of independent rows."""
        counts = np.stack(
            [np.bincount(block, minlength=self.blocks) for block in self.block]
        )
        return counts / (ALIKE * self.shared[:, None])

    @property
    def shared(self) -> Array:
        """`views` of all channels."""
        return np.array(self.views or (1,) * len(self.y), dtype=np.float64)

    @cached_property
    def at(self) -> tuple[tuple[slice, ...], ...]:
        """The rows of every block, channel by channel."""
        every = np.arange(self.blocks + 1)
        edges = [np.searchsorted(block, every) for block in self.block]
        return tuple(
            tuple(slice(int(a), int(b)) for a, b in pairwise(edge)) for edge in edges
        )


@dataclass(frozen=True)
class ColumnGroup:
    """Columns that are fitted together, and the precision (k, k) that their coefficients had.

    `in_file` are coefficients (., k) of other parts of the model, by their number, that
    stand for the part in a parameter file: held to the file is what they are more than
    that.
    """

    columns: Channels
    precision: Array
    # of the precision what is no parameter file's; None: all
    precision_without_file: Array | None = None
    # channel -> its first column, if not 0
    first_column: Mapping[int, int] = field(default_factory=dict)
    absorbed_by_file: Mapping[int, Array] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.precision)

    def at(self, channel: int) -> slice:
        """Which of the columns a channel has."""
        first = self.first_column.get(channel, 0)
        return slice(first, first + self.columns[channel].shape[1])

    def torque(self, channel: int, theta: Array) -> Array:
        """Torque (M_c,) N m of coefficients (k,) at a channel."""
        return np.asarray(self.columns[channel] @ theta[self.at(channel)])


@dataclass(frozen=True)
class TermFit:
    """What one term does to a model that does not have it."""

    log_bayes_factor: float
    coefficients: Array  # (k,)
    covariance: Array  # (k, k)
    visible_share: float  # share of the columns' square that the model does not absorb


@dataclass(frozen=True)
class Score:
    """What one term does to blocks that were left out."""

    block_gains: Array  # (blocks,) gain in log predictive density
    rows: Array  # (blocks,) number of independent rows at its channels
    file_gain: float = 0.0  # gain in the density of what the parameter file says

    @property
    def total(self) -> float:
        """Gain of all blocks and of the file."""
        return float(self.block_gains.sum()) + self.file_gain

    @cached_property
    def drawn(self) -> Array:
        """The same (DRAWS,) over drawn weights of the blocks; there is one file."""
        return np.asarray(
            weights_of(len(self.block_gains)) @ self.block_gains + self.file_gain
        )

    @property
    def doubt(self) -> float:
        """Probability that nothing is gained, over drawn weights of the blocks."""
        return float(np.mean(self.drawn <= 0.0))

    @property
    def share(self) -> float:
        """Share of the squared error that goes, where noise of unit variance remains.

        By the density: it knows what other blocks do not tell of one, squared errors do
        not.
        """
        return float(self._share_of(self.total))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of that share, over drawn weights of the blocks."""
        low, high = np.quantile(
            self._share_of(self.drawn), (0.5 - LEVEL / 2, 0.5 + LEVEL / 2)
        )
        return float(low), float(high)

    def _share_of(self, gain: float | Array) -> Array:
        rows = max(float(self.rows.sum()), 1.0)
        return np.asarray(2.0 * np.asarray(gain) / (2.0 * np.maximum(gain, 0.0) + rows))


def joints_below(channels: Iterable[int], n: int) -> list[int]:
    """Joints of n whose torque below the cut-off some channels show.

    Channel j is that of joint j, n + j what lies above its cut-off, 2 n + j its drive
    alone.
    """
    return sorted({c % n for c in channels if c // n != 1})


@lru_cache
def weights_of(blocks: int) -> Array:
    """Weights (DRAWS, blocks) of the Bayesian bootstrap."""
    return np.random.default_rng(SEED).exponential(size=(DRAWS, blocks))


def doubt_of(gains: Array) -> float:
    """Probability that gains of blocks (B,) come to nothing, over drawn weights of the blocks."""
    return float(np.mean(weights_of(len(gains)) @ gains <= 0.0))


def scatter(values: Array) -> float:
    """Standard error of the sum of independent values (blocks,)."""
    many = len(values) > 1
    return float(np.std(values, ddof=1) * np.sqrt(len(values))) if many else np.inf
