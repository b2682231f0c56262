"""How precise rows are: each joint's noise, and where residuals are larger than it.

Residuals have long tails, near reversals above all, and a Gaussian likelihood takes
those for evidence. Over a fraction of a second rows share a weight as under Student's
distribution (K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical
modeling using the t distribution", JASA 84, 1989): (nu + 1) / (nu + m), m their mean
square in units of the noise. Rows of low-passed signals tell partly the same: `ALIKE`
of them count as one.

Where a motion comes again, so does what the model has wrong of it, and that is no more
sure for being seen again. Of R times that are of variance s^2 each, of which a share
rho comes again, the mean has the variance (1 + (R - 1) rho) s^2 / R: each of them
counts that much less.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.discover.candidates import CandidateColumns
from seqid_cli.discover.link_rows import KIND as LINKS
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.rows import (
    ALIKE,
    ColumnGroup,
    LogColumns,
    Observations,
)
from seqid_cli.typing import Array, Index

ROUNDS = 3
INNER = 5


@dataclass(frozen=True)
class Noise:
    """The noise of every channel.

    Attributes
    ----------
    sigma : (channels,) array
        Standard deviation [N m; N where prismatic].
    weight : tuple of (M_c,) arrays
        Precision of each row [1 / (N m)^2].
    """

    sigma: Array
    weight: tuple[Array, ...]

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
    noise = Noise(sigma=size, weight=tuple(weight))
    linear = LinearModel(rows, parts, noise.weight)
    for _ in range(ROUNDS):
        noise = _of_residual(
            linear.residual(), noise.sigma, windows, moments, stage, rows.shared
        )
        linear = LinearModel(rows, parts, noise.weight, noise.slow(stage))
    return linear, noise


def _of_residual(
    residual: Sequence[Array],
    sigma: Array,
    windows: Sequence[Index],
    moments: Sequence[Index],
    stage: CandidateColumns,
    views: Array,
) -> Noise:
    """Return the noise of every channel; what two channels show counts half in each."""
    n = len(windows)
    new_sigma = sigma.copy()
    weight = []
    for channel, r in enumerate(residual):
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
            counted = counted_again(r * np.sqrt(relative), moments[channel % n])
            weight.append(relative / (variance * counted))
    return Noise(sigma=new_sigma, weight=tuple(weight))


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


def counted_again(r: Array, moment: Index) -> Array:
    """Return how many times too often rows count where a motion comes again.

    The share of a variance that comes again is told by the means of moments, against
    how rows of one moment differ (analysis of variance with random effects).

    Parameters
    ----------
    r : (M,) array
        What is left [N m; N where prismatic].
    moment : (M,) index array
        The moment of its motion in which each row is.

    Returns
    -------
    (M,) array
        1 + (R - 1) rho; 1 where a moment is there once.
    """
    count = np.bincount(moment)
    is_again = count > 1
    n_rows = int(count[is_again].sum())
    n_moments = int(is_again.sum())
    if n_rows == n_moments:
        return np.ones(len(r))
    mean = np.bincount(moment, r) / np.maximum(count, 1)
    inside = np.where(is_again[moment], r - mean[moment], 0.0)
    of_rows = float(inside @ inside) / (n_rows - n_moments)
    of_means = float(count[is_again] @ mean[is_again] ** 2) / n_moments
    again = max(of_means - of_rows, 0.0) / (n_rows / n_moments)
    share = again / max(again + of_rows, 1e-300)
    return np.asarray(1.0 + (count[moment] - 1.0) * share)


def _moments(stage: CandidateColumns) -> list[Index]:
    """Return the moment (M_j,) of its motion of every row of a joint, from 0 on."""
    rows = stage.rows
    moments: list[Index] = []
    for joint in range(rows.n):
        of_scenes = [
            moment[used[:, joint]]
            for moment, used in zip(rows.moment, rows.used, strict=True)
        ]
        _, number = np.unique(np.concatenate(of_scenes), return_inverse=True)
        moments.append(number)
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

    windows = []
    for joint in range(rows.n):
        parts = [
            window[used[:, joint]]
            for window, used in zip(window_by_scene, rows.used, strict=True)
        ]
        windows.append(np.concatenate(parts))
    return windows
