"""How precise rows are: each joint's noise, and where residuals are larger than it.

Residuals have long tails, near reversals above all, and a Gaussian likelihood takes
those for evidence. Over a fraction of a second rows share a weight as under Student's
distribution (K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical
modeling using the t distribution", JASA 84, 1989): (nu + 1) / (nu + m), m their mean
square in units of the noise. Rows of low-passed signals tell partly the same: `ALIKE`
of them count as one.

Where a motion comes again, so does what the model has wrong of it, and that is no more
sure for being seen again. It is noise that all rows of one moment of the motion share
(see `rows.Recurring`): what differs from one time to the next is as sure as ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seqid_cli.discover.candidates import CandidateColumns
from seqid_cli.discover.link_rows import KIND as LINKS
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.rows import (
    ALIKE,
    ColumnGroup,
    LogColumns,
    Observations,
    Recurring,
)
from seqid_cli.typing import Array, Index

ROUNDS = 3
INNER = 5
# Share of the noise that may come again: some is left to rows by themselves.
MOST_AGAIN = 0.99


@dataclass(frozen=True)
class Noise:
    """The noise of every channel.

    Attributes
    ----------
    sigma : (channels,) array
        Standard deviation [N m; N where prismatic].
    weight : tuple of (M_c,) arrays
        Precision of each row [1 / (N m)^2], without what comes again.
    recurring : tuple of Recurring or None
        What comes again with a motion, by channel.
    """

    sigma: Array
    weight: tuple[Array, ...]
    recurring: tuple[Recurring | None, ...]

    def slow(self, stage: CandidateColumns) -> list[LogColumns]:
        """Return the part of it that is slower than a block of time, by channel."""
        n = stage.rows.n
        groups = []
        for channel, sigma in enumerate(self.sigma):
            joint = channel % n
            if channel // n == 1 or not stage.rows.count(joint):
                continue  # above the cut-off nothing is slow
            is_of_link = channel // n == LINKS and stage.links.of(joint)
            is_of_drive = channel // n == 2 and stage.drive.of(joint)
            if channel < n or is_of_drive or is_of_link:
                groups.append(slow_noise(stage, channel, sigma))
        return groups


def settled(
    stage: CandidateColumns,
    rows: Observations,
    size: Array,
    parts: Sequence[ColumnGroup],
) -> tuple[LinearModel, Noise]:
    """Fit a model and its noise in turn.

    Parameters
    ----------
    stage : CandidateColumns
        The data sets.
    rows : Observations
        What is to be explained.
    size : (channels,) array
        Standard deviation [N m; N where prismatic] to begin with.
    parts : sequence of ColumnGroup
        What explains it; slow noise is added.
    """
    windows = _windows(stage)
    moments = _moments(stage)
    weight = [
        np.full(len(y), 1.0 / sigma**2) for y, sigma in zip(rows.y, size, strict=True)
    ]
    none = (None,) * len(weight)
    noise = Noise(sigma=size, weight=tuple(weight), recurring=none)
    linear = LinearModel(rows, parts, noise.weight)
    for _ in range(ROUNDS):
        noise = _of_residual(
            linear.residual(), noise.sigma, windows, moments, stage, rows.shared
        )
        linear = LinearModel(
            rows, parts, noise.weight, noise.slow(stage), recurring=noise.recurring
        )
    return linear, noise


def _of_residual(
    residual: Sequence[Array],
    sigma: Array,
    windows: Sequence[Index],
    moments: Sequence[Moments],
    stage: CandidateColumns,
    views: Array,
) -> Noise:
    """Return the noise of every channel; what two channels show counts half in each."""
    n = len(windows)
    new_sigma = sigma.copy()
    weight = []
    recurring: list[Recurring | None] = []
    for channel, r in enumerate(residual):
        of_channel = None
        if not len(r):
            weight.append(r)
        elif channel // n == 1:
            # Above the cut-off bursts are left out already: the plain RMS.
            new_sigma[channel] = max(float(np.sqrt(np.mean(r**2))), 1e-12)
            scaled = new_sigma[channel] * stage.high.weight[channel - n]
            weight.append(np.full(len(r), 1.0 / (ALIKE * scaled**2)))
        else:
            new_sigma[channel], relative = _student(
                r, sigma[channel], windows[channel % n]
            )
            variance = views[channel] * ALIKE * new_sigma[channel] ** 2
            of_joint = moments[channel % n]
            share = of_joint.share_again(r * np.sqrt(relative))
            weight.append(relative / (variance * (1.0 - share)))
            if share > 0.0:
                of_channel = Recurring.of(
                    weight[-1], of_joint.in_log, variance * share, of_joint.times_in_log
                )
        recurring.append(of_channel)
    return Noise(sigma=new_sigma, weight=tuple(weight), recurring=tuple(recurring))


def _student(
    r: Array, sigma: float, window: Index, *, nu: float = 4.0
) -> tuple[float, Array]:
    """Return the scale of Student's distribution, and the weights (M,) of rows r (M,).

    `nu` are its degrees of freedom, `window` (M,) says which rows share a weight.
    """
    count = np.maximum(np.bincount(window), 1)
    mean_square = np.bincount(window, weights=r**2) / count
    weight = np.ones(len(r))
    for _ in range(INNER):
        weight = ((nu + 1.0) / (nu + mean_square / sigma**2))[window]
        sigma = max(float(np.sqrt(np.mean(weight * r**2))), 1e-12)
    return sigma, weight


@dataclass(frozen=True)
class Moments:
    """The moment of its motion of every row of a joint.

    Attributes
    ----------
    number : (M_j,) index array
        Of each row, over all logs.
    in_log : (M_j,) index array
        The same, for each log by itself.
    """

    number: Index
    in_log: Index

    @classmethod
    def of(cls, number: Index, log: Index) -> Moments:
        """Count moments, and those of each log; `log` (M_j,) is the log of each row."""
        _, of_all = np.unique(number, return_inverse=True)
        _, in_log = np.unique(
            log * (1 + of_all.max(initial=0)) + of_all, return_inverse=True
        )
        return cls(number=of_all, in_log=in_log)

    @cached_property
    def times(self) -> Index:
        """How often each moment (moments,) is there in all logs."""
        return np.bincount(self.number)

    @cached_property
    def times_in_log(self) -> Array:
        """How often that is for each time in its log, by moment of a log; 0 if once."""
        times_there = np.bincount(self.in_log)
        times = np.zeros(len(times_there))
        times[self.in_log] = self.times[self.number]
        return np.where(times > 1, times / times_there, 0.0)

    def share_again(self, r: Array) -> float:
        """Return the share of the variance of rows r (M_j,) that comes again.

        It is told by the means of moments, against how rows of one moment differ
        (analysis of variance with random effects).
        """
        is_again = self.times > 1
        n_rows = int(self.times[is_again].sum())
        n_moments = int(is_again.sum())
        if n_rows == n_moments:
            return 0.0
        mean = np.bincount(self.number, r) / self.times
        inside = np.where(is_again[self.number], r - mean[self.number], 0.0)
        of_rows = float(inside @ inside) / (n_rows - n_moments)
        of_means = float(self.times[is_again] @ mean[is_again] ** 2) / n_moments
        again = max(of_means - of_rows, 0.0) / (n_rows / n_moments)
        return min(again / max(again + of_rows, 1e-300), MOST_AGAIN)


def _moments(stage: CandidateColumns) -> list[Moments]:
    """Return the moments of every joint's rows."""
    rows = stage.rows
    moments: list[Moments] = []
    for joint in range(rows.n):
        log = rows.log_of_block[rows.blocks_of(joint)]
        moments.append(Moments.of(rows.of_kept(joint, rows.moment), log))
    return moments


def slow_noise(
    stage: CandidateColumns,
    channel: int,
    size: float,
    *,
    slow: float = 0.3,
    waves: int = 4,
) -> LogColumns:
    """Return torque noise that is slower than a block of time, of 1/f power.

    It is an offset and cosines. Each log has its own `waves` functions, whose torque is
    `slow` times `size`, the standard deviation [N m] of the channel's noise. Blocks
    that are left out tell nothing of it, and a function of time would pass for an
    effect.
    """
    rows = stage.rows
    joint = channel % rows.n
    order = np.arange(waves)
    by_log = []
    for scene, samples, used in zip(rows.scenes, rows.samples, rows.used, strict=True):
        motion = scene.motion
        share_of_log = motion.t[samples[used[:, joint]]] / float(motion.t[-1])
        by_log.append(np.cos(np.pi * np.outer(share_of_log, order)))

    power = 1.0 / np.maximum(order, 0.5)
    variance = 2.0 * (slow * size) ** 2 * power / np.sum(power)
    return LogColumns(
        channel=channel,
        columns=np.concatenate(by_log),
        precision=np.diag(1.0 / variance),
    )


def _windows(stage: CandidateColumns, *, window_s: float = 0.3) -> list[Index]:
    """Return the window (M_j,) of every row of a joint, whose rows share a weight."""
    rows = stage.rows
    window_by_scene: list[Index] = []
    first = 0
    for scene, samples in zip(rows.scenes, rows.samples, strict=True):
        t = scene.motion.t
        window_by_scene.append((t[samples] / window_s).astype(np.intp) + first)
        first += int(t[-1] / window_s) + 1

    return [rows.of_kept(joint, window_by_scene) for joint in range(rows.n)]
