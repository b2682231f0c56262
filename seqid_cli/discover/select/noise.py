"""How precise rows are: each joint's noise, and where residuals are larger than noise makes them.

Residuals have long tails, near reversals above all, and a Gaussian likelihood takes
those for evidence. Over a fraction of a second rows share a weight as under Student's
distribution (K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical
modeling using the t distribution", JASA 84, 1989): (nu + 1) / (nu + m), m their mean
square in units of the noise. Rows of low-passed signals tell partly the same: `ALIKE`
of them count as one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from seqid_cli.discover.candidates import CandidateColumns
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.rows import ALIKE, ColumnGroup, Observations
from seqid_cli.typing import Array, Index

ROUNDS = 3
INNER = 5


@dataclass(frozen=True)
class Noise:
    """Standard deviation (channels,) N m, and the precision [1 / (N m)^2] of each row."""

    sigma: Array
    weight: tuple[Array, ...]

    def slow(self, stage: CandidateColumns) -> list[ColumnGroup]:
        """What of it is slower than a block of time, by joint."""
        n = stage.rows.n
        below = [
            c for c in range(len(self.sigma)) if c // n != 1 and stage.rows.count(c % n)
        ]
        seen = [c for c in below if c < n or stage.drive.of(c % n)]
        return [slow_noise(stage, c, self.sigma[c]) for c in seen]


def settled(
    stage: CandidateColumns,
    rows: Observations,
    size: Array,
    parts: Sequence[ColumnGroup],
) -> tuple[LinearModel, Noise]:
    """Fit a model and its noise in turn."""
    windows, every = _windows(stage), zip(rows.y, size, strict=True)
    noise = Noise(size, tuple(np.full(len(y), 1.0 / s**2) for y, s in every))
    linear = LinearModel(rows, parts, noise.weight)
    for _ in range(ROUNDS):
        noise = _of_residual(
            linear.residual(), noise.sigma, windows, stage, rows.shared
        )
        linear = LinearModel(rows, [*parts, *noise.slow(stage)], noise.weight)
    return linear, noise


def _of_residual(
    left: Sequence[Array],
    sigma: Array,
    windows: Sequence[Index],
    stage: CandidateColumns,
    views: Array,
) -> Noise:
    """Noise of every channel; what two channels show counts half in each."""
    n, found, weight = len(windows), sigma.copy(), []
    for c, r in enumerate(left):
        if not len(r):
            weight.append(r)
        elif c // n == 1:
            found[c] = max(float(np.sqrt(np.mean(r**2))), 1e-12)
            own = found[c] * stage.high.weight[c - n]
            weight.append(np.full(len(r), 1.0 / (ALIKE * own**2)))
        else:
            found[c], shared = _student(r, sigma[c], windows[c % n])
            weight.append(shared / (views[c] * ALIKE * found[c] ** 2))
    return Noise(found, tuple(weight))


def _student(
    r: Array, sigma: float, window: Index, *, nu: float = 4.0
) -> tuple[float, Array]:
    """Scale of Student's distribution with `nu` degrees of freedom, and the weights (M,)."""
    count = np.maximum(np.bincount(window), 1)
    square = np.bincount(window, weights=r**2) / count
    weight = np.ones(len(r))
    for _ in range(INNER):
        weight = ((nu + 1.0) / (nu + square / sigma**2))[window]
        sigma = max(float(np.sqrt(np.mean(weight * r**2))), 1e-12)
    return sigma, weight


def slow_noise(
    stage: CandidateColumns,
    channel: int,
    size: float,
    *,
    slow: float = 0.3,
    waves: int = 4,
) -> ColumnGroup:
    """Torque noise that is slower than a block of time: an offset and cosines, of 1/f power.

    Each log has its own `waves` functions, whose torque is `slow` times `size`, the
    standard deviation [N m] of the channel's noise. Blocks that are left out tell
    nothing of it, and a function of time would pass for an effect.
    """
    rows, order, own = stage.rows, np.arange(waves), []
    for scene, picked, used in zip(rows.scenes, rows.samples, rows.used, strict=True):
        t = scene.motion.t[picked[used[:, channel % rows.n]]] / float(
            scene.motion.t[-1]
        )
        own.append(np.cos(np.pi * np.outer(t, order)))
    wide = np.asarray(block_diag(*own))
    power = 1.0 / np.maximum(order, 0.5)
    variance = 2.0 * (slow * size) ** 2 * power / np.sum(power)
    return ColumnGroup(
        {channel: wide}, np.diag(np.tile(1.0 / variance, len(rows.scenes)))
    )


def _windows(stage: CandidateColumns, *, window_s: float = 0.3) -> list[Index]:
    """Window (M_j,) of every row of a joint, whose rows share a weight."""
    rows, every, first = stage.rows, list[Index](), 0
    for scene, picked in zip(rows.scenes, rows.samples, strict=True):
        every.append((scene.motion.t[picked] / window_s).astype(np.intp) + first)
        first += int(scene.motion.t[-1] / window_s) + 1
    own = [
        [x[u[:, j]] for x, u in zip(every, rows.used, strict=True)]
        for j in range(rows.n)
    ]
    return [np.concatenate(parts) for parts in own]
