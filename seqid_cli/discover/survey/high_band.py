"""What lies above the cut-off: rows for ripples and lines in time.

There the rigid body and friction have next to nothing to say but for the steps at
reversals, which the model as it stands takes away; what is left, less its low-passed
part, is what a ripple or a line has to explain. A burst, as a stop from full speed
leaves it, is left out. These rows are further channels of the normal equations, one per
joint, that no base column touches; together they count as much as the joint's rows
below the cut-off.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.ndimage import uniform_filter1d

from seqid_cli.discover.survey.rows import Rows, stride_of
from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array, Index, Mask

# share of the power above the cut-off, under which that below says nothing
PASSING = 0.05
# of all logs; of longer ones every second block counts, or every third, ...
MOST_SAMPLES = 80_000
BURST = 4.0  # times the usual RMS, over a period of the cut-off


@dataclass(frozen=True)
class HighBand:
    """Rows above the cut-off."""

    used: tuple[Mask, ...]  # (N, n) by data set, at the log's own rate
    block: tuple[Index, ...]  # (M_j,) by joint, of each row
    y: tuple[Array, ...]  # (M_j,) by joint, measured torque above the cut-off [N m]
    weight: Array  # (n,), a factor on each joint's noise

    def of(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of values (N, ...), one array per data set at its own rate."""
        return np.concatenate(
            [v[u[:, joint]] for v, u in zip(values, self.used, strict=True)]
        )


def high_band(rows: Rows) -> HighBand:
    """Take the rows above the cut-off where joints slide, in blocks of `rows`."""
    used, blocks, high = [], [], []
    thin = max(
        1,
        -(-sum((scene.full or scene).samples for scene in rows.scenes) // MOST_SAMPLES),
    )
    parts = zip(rows.scenes, rows.picked, rows.used, rows.block, strict=True)
    for scene, picked, counts, block in parts:
        full = scene.full or scene
        every = round(full.motion.rate_hz / scene.motion.rate_hz)
        at, own = picked * every, np.arange(full.samples)
        nearest = np.clip(np.searchsorted(at, own, side="right") - 1, 0, len(at) - 1)
        kept = np.abs(at[nearest] - own) < stride_of(scene.motion) * every
        kept &= block[nearest] % thin == 0
        counting = full.slides & kept[:, None] & counts.any(axis=0)
        high.append(_above(full))
        used.append(counting & ~_bursts(high[-1], counting, full))
        blocks.append(block[nearest])
    of, y = list[Index](), list[Array]()
    for j in range(rows.n):
        of.append(
            np.concatenate([b[u[:, j]] for b, u in zip(blocks, used, strict=True)])
        )
        y.append(
            np.concatenate([h[u[:, j], j] for h, u in zip(high, used, strict=True)])
        )
    weight = [
        np.sqrt(max(len(own), 1) / max(rows.count(j), 1)) for j, own in enumerate(y)
    ]
    return HighBand(tuple(used), tuple(of), tuple(y), np.array(weight))


def both_bands(
    rows: Rows, high: HighBand, per_scene: Sequence[Mapping[int, Array]]
) -> dict[int, Array]:
    """Split columns at the logs' own rates into rows below and above the cut-off.

    Rows above it belong to channel n + joint, in single precision. Of a log in which
    nearly all of a column lies above, what is left below comes from where the joint
    reverses, and there its law is known least: then that log's rows above alone count.
    """
    below, above = (
        defaultdict[int, list[Array]](list),
        defaultdict[int, list[Array]](list),
    )
    for scene, columns in zip(rows.scenes, per_scene, strict=True):
        full = scene.full or scene
        every = round(full.motion.rate_hz / scene.motion.rate_hz)
        for joint, X in columns.items():
            low = full.motion.filtered(X, times=2)
            passing = np.mean(low**2) < PASSING * np.mean((X - low) ** 2)
            below[joint].append(low[::every] * (not passing))
            above[joint].append(X - low)
    result = {}
    for joint, slow in below.items():
        result[joint] = rows.torque(joint, slow)
        # There are many rows above, and hundreds of candidates that keep theirs.
        result[rows.n + joint] = cast(
            Array, high.of(joint, above[joint]).astype(np.float32)
        )
    return result


def _above(full: Scene) -> Array:
    """Measured torque (N, n) above the cut-off, that of the model taken away."""
    assert full.measured is not None
    left = full.measured - full.modelled
    return np.asarray(left - full.motion.filtered(left, times=2))


def _bursts(above: Array, counting: Mask, full: Scene) -> Mask:
    """Samples (N, n) about which there is far more above the cut-off than is usual in the log."""
    size = max(round(full.motion.rate_hz / full.motion.lowpass.cutoff_hz), 3)
    local = uniform_filter1d(above**2, size, axis=0)
    every = zip(local.T, counting.T, strict=True)
    usual = np.array([np.median(x[c]) if c.any() else np.inf for x, c in every])
    return np.asarray(local > BURST**2 * usual)


def full_residual(scene: Scene, left: Array) -> Array:
    """Residual (N, n) at the log's own rate: `left` (N', n), above the cut-off the measured."""
    full = scene.full or scene
    slow = [
        np.interp(full.motion.t, scene.motion.t, left[:, j])
        for j in range(left.shape[1])
    ]
    total = _above(full) + np.stack(slow, axis=1)
    total[~full.motion.usable] = 0.0
    return total
