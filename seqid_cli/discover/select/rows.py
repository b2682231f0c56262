"""Rows that are to be explained, columns that may explain them, and what they gain.

How sure a gain is over parts that differ is told by drawn weights of the parts (D. B.
Rubin, "The Bayesian bootstrap", Annals of Statistics 9, 1981): what shows in a few
parts alone may still be sure, if nothing speaks against it elsewhere.

A *channel* is one kind of rows of a joint. With n joints, channel j is the torque of
joint j below its cut-off, n + j what lies above the cut-off, 2 n + j its drive alone,
and 3 n + j its link against its motor, in standard deviations (see `link_rows`). In
shapes, M_c is the number of rows of channel c, k the number of columns of one group,
"blocks" the number of blocks of time, and "parts" that of the parts that are left out
in turn: each of them one block, or all blocks of the same stretch of a motion that
comes again (see `survey.repeats`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from seqid_cli.discover.survey.repeats import SAMPLES_PER_CUTOFF
from seqid_cli.motion.torque_noise import LEVEL
from seqid_cli.typing import Array, Index

Channels = Mapping[int, Array]  # channel -> its rows of some columns (M_c, k)

ALIKE = 0.5 * SAMPLES_PER_CUTOFF  # rows of low-passed signals that tell as much as one
DRAWS, SEED = 400, 0  # of weights of the parts


@dataclass(frozen=True)
class Observations:
    """What is to be explained.

    Attributes
    ----------
    y : tuple of (M_c,) arrays
        By channel, torque [N m; N where prismatic].
    block : tuple of (M_c,) index arrays
        By channel, the block of time of each row, ascending.
    blocks : int
        Number of blocks.
    views : tuple of int
        How many channels show the same as each does; empty where each shows its own.
    log_of_block : (blocks,) index array, optional
        The log of each block, ascending; all blocks are of one log if left out.
    part_of_block : (blocks,) index array, optional
        The part of each block; each is one by itself if left out.
    """

    y: tuple[Array, ...]
    block: tuple[Index, ...]
    blocks: int
    views: tuple[int, ...] = ()
    log_of_block: Index | None = None
    part_of_block: Index | None = None

    @cached_property
    def log(self) -> Index:
        """The log (blocks,) of each block."""
        if self.log_of_block is None:
            return np.zeros(self.blocks, dtype=np.intp)
        return self.log_of_block

    @cached_property
    def part(self) -> Index:
        """The part (blocks,) of each block."""
        if self.part_of_block is None:
            return np.arange(self.blocks)
        return self.part_of_block

    @cached_property
    def blocks_of_part(self) -> tuple[Index, ...]:
        """The blocks of every part."""
        n_parts = int(self.part.max(initial=-1)) + 1
        return tuple(np.flatnonzero(self.part == part) for part in range(n_parts))

    @property
    def parts(self) -> int:
        """Number of parts."""
        return len(self.blocks_of_part)

    def by_part(self, channel: int, values: Array | None = None) -> Array:
        """Sum values (M_c,) of a channel's rows over each part (parts,), or count."""
        part = self.part[self.block[channel]]
        return np.bincount(part, values, minlength=self.parts).astype(np.float64)

    @cached_property
    def independent(self) -> Array:
        """Number (channels, parts) of independent rows."""
        counts = np.stack([self.by_part(channel) for channel in range(len(self.y))])
        return counts / (ALIKE * self.shared[:, None])

    @property
    def shared(self) -> Array:
        """Number (channels,) of channels that show the same as each does."""
        return np.array(self.views or (1,) * len(self.y), dtype=np.float64)

    @cached_property
    def block_slices(self) -> tuple[tuple[slice, ...], ...]:
        """The rows of every block, channel by channel."""
        return tuple(self._block_slices_of(block) for block in self.block)

    @cached_property
    def log_slices(self) -> tuple[tuple[slice, ...], ...]:
        """The rows of every log, channel by channel."""
        n_logs = int(self.log.max(initial=0)) + 1
        first_block = np.searchsorted(self.log, np.arange(n_logs + 1))
        slices = []
        for block in self.block:
            edges = np.searchsorted(block, first_block)
            slices.append(
                tuple(slice(int(start), int(stop)) for start, stop in pairwise(edges))
            )
        return tuple(slices)

    def _block_slices_of(self, block: Index) -> tuple[slice, ...]:
        edges = np.searchsorted(block, np.arange(self.blocks + 1))
        return tuple(slice(int(start), int(stop)) for start, stop in pairwise(edges))


@dataclass(frozen=True, kw_only=True)
class ColumnGroup:
    """Columns that are fitted together, and what is known of their coefficients.

    Attributes
    ----------
    columns : mapping of channel to (M_c, k_c) array
        Torque per unit coefficient [N m; N where prismatic].
    precision : (k, k) array
        Inverse covariance of the coefficients beforehand.
    precision_without_file : (k, k) array, optional
        The part of it that no parameter file says; None for all of it.
    first_column : mapping of channel to int
        Which of the k columns a channel's first one is, where it is not 0.
    absorbed_by_file : mapping of int to (p, k) array
        Coefficients of other groups of the model, by the number of the group, that
        stand for this one in a parameter file. Held to the file is what these are more
        than that.
    """

    columns: Channels
    precision: Array
    precision_without_file: Array | None = None
    first_column: Mapping[int, int] = field(default_factory=dict)
    absorbed_by_file: Mapping[int, Array] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.precision)

    def at(self, channel: int) -> slice:
        """Return which of the columns a channel has."""
        first = self.first_column.get(channel, 0)
        return slice(first, first + self.columns[channel].shape[1])

    def torque(self, channel: int, theta: Array) -> Array:
        """Return the torque (M_c,) N m of coefficients (k,) at a channel."""
        return np.asarray(self.columns[channel] @ theta[self.at(channel)])


@dataclass(frozen=True, kw_only=True)
class LogColumns:
    """Columns of a channel with coefficients of their own in each log.

    Attributes
    ----------
    channel : int
        The channel.
    columns : (M_c, s) array
        Torque per unit coefficient [N m; N where prismatic].
    precision : (s, s) array
        Inverse covariance of a log's coefficients beforehand, diagonal.
    """

    channel: int
    columns: Array
    precision: Array


@dataclass(frozen=True, kw_only=True)
class Recurring:
    """Noise that rows of one moment of a motion share, as it comes again with it.

    With the precision w of rows by themselves and the variance r of what they share,
    the precision of the rows of a moment is W - u u' r / (1 + r |u|^2), u being w. It
    is the square of a root that takes a share off the mean.

    Attributes
    ----------
    moment : (M_c,) index array
        The moment of each row of a channel; each is of one log.
    unit : (M_c,) array
        Roots of w, over their norm in the moment.
    share : (moments,) array
        How much is taken off the mean of each moment.
    """

    moment: Index
    unit: Array
    share: Array

    @classmethod
    def of(
        cls, weight: Array, moment: Index, variance: float, times_in_log: Array
    ) -> Recurring:
        """Take the precision from that of rows by themselves.

        Parameters
        ----------
        weight : (M_c,) array
            Their precision w [1 / (N m)^2].
        moment : (M_c,) index array
            The moment of each.
        variance : float
            Of what they share [(N m)^2].
        times_in_log : (moments,) array
            How often a moment is there in all logs, for each time in its own. Of
            several logs each tells as much less; 0 where it is there once.
        """
        squares = np.bincount(moment, weight)
        shared = variance * squares * times_in_log
        norm = np.sqrt(np.maximum(squares, 1e-300))
        return cls(
            moment=moment,
            unit=np.sqrt(weight) / norm[moment],
            share=1.0 - 1.0 / np.sqrt(1.0 + shared),
        )

    @cached_property
    def _means(self) -> csr_array:
        """The matrix (moments, M_c) of means."""
        n_rows = len(self.moment)
        at = (self.moment, np.arange(n_rows))
        return csr_array((self.unit, at), shape=(len(self.share), n_rows))

    def taken_off(self, scaled: Array) -> Array:
        """Return columns (M_c, m) of unit noise of columns times the roots of w."""
        return self._less(scaled, self.share)

    def taken_off_twice(self, scaled: Array) -> Array:
        """Return the same once more: the precision, but for the roots of w."""
        return self._less(scaled, self.share * (2.0 - self.share))

    def _less(self, scaled: Array, share: Array) -> Array:
        """Take a share (moments,) off the means of columns (M_c, m)."""
        # Sparse products go along rows: one copy here, or one in each of them.
        by_row = np.array(scaled, order="C")
        of_moments = self._means @ by_row
        of_moments *= share[:, None]
        by_row -= self._means.T @ of_moments
        return by_row


@dataclass(frozen=True, kw_only=True)
class TermFit:
    """What one term does to a model that does not have it, given all rows.

    Attributes
    ----------
    log_bayes_factor : float
        Of the model with the term against the one without.
    coefficients : (k,) array
        Of the term.
    covariance : (k, k) array
        Of the coefficients.
    visible_share : float
        Share of the columns' square that the model does not absorb.
    """

    log_bayes_factor: float
    coefficients: Array
    covariance: Array
    visible_share: float


@dataclass(frozen=True, kw_only=True)
class Score:
    """How much better parts are predicted with a term that was fitted to the others.

    Attributes
    ----------
    part_gains : (parts,) array
        Gain in log predictive density.
    rows : (parts,) array
        Number of independent rows at the term's channels.
    file_gain : float
        Gain in the log density of what the parameter file says.
    """

    part_gains: Array
    rows: Array
    file_gain: float = 0.0

    @property
    def total(self) -> float:
        """Gain of all parts and of the file."""
        return float(self.part_gains.sum()) + self.file_gain

    @cached_property
    def drawn(self) -> Array:
        """Total gains (DRAWS,) over drawn weights of the parts; there is one file."""
        weights = weights_of(len(self.part_gains))
        return np.asarray(weights @ self.part_gains + self.file_gain)

    @property
    def doubt(self) -> float:
        """Probability that nothing is gained, over drawn weights of the parts."""
        return float(np.mean(self.drawn <= 0.0))

    @property
    def share(self) -> float:
        """Share of the squared error that goes, where noise of unit variance remains.

        By the density: it knows what other parts do not tell of one, squared errors do
        not.
        """
        return float(self._share_of(self.total))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of that share, over drawn weights of the parts."""
        low, high = np.quantile(
            self._share_of(self.drawn), (0.5 - LEVEL / 2, 0.5 + LEVEL / 2)
        )
        return float(low), float(high)

    def _share_of(self, gain: float | Array) -> Array:
        n_rows = max(float(self.rows.sum()), 1.0)
        gained = np.maximum(gain, 0.0)
        return np.asarray(2.0 * np.asarray(gain) / (2.0 * gained + n_rows))


def joints_below(channels: Iterable[int], n: int) -> list[int]:
    """Return the joints of n whose torque below the cut-off some channels show."""
    return sorted({channel % n for channel in channels if channel // n != 1})


@lru_cache
def weights_of(parts: int) -> Array:
    """Return weights (DRAWS, parts) of the Bayesian bootstrap."""
    return np.random.default_rng(SEED).exponential(size=(DRAWS, parts))


def doubt_of(gains: Array) -> float:
    """Return the probability that gains of parts (parts,) come to nothing."""
    return float(np.mean(weights_of(len(gains)) @ gains <= 0.0))


def scatter(values: Array) -> float:
    """Return the standard error of the sum of independent values (parts,)."""
    if len(values) < 2:
        return np.inf
    return float(np.std(values, ddof=1) * np.sqrt(len(values)))
