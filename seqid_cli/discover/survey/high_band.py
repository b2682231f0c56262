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
from functools import cached_property
from typing import cast

import numpy as np
from scipy.ndimage import uniform_filter1d

from seqid_cli.discover.survey.repeats import stride_of
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.effects.scene import Scene
from seqid_cli.typing import Array, Index, Mask

# share of the power above the cut-off, under which that below says nothing
PASSING = 0.05
# of all logs; of longer ones every second block counts, or every third, ...
MOST_SAMPLES = 80_000
BURST = 4.0  # times the usual RMS, over a period of the cut-off


@dataclass(frozen=True)
class HighBand:
    """Rows above the cut-off.

    Attributes
    ----------
    used : tuple of (N, n) masks
        By data set, at the log's own rate.
    block : tuple of (M_j,) index arrays
        By joint, the block of each row.
    y : tuple of (M_j,) arrays
        By joint, the measured torque above the cut-off less the model's [N m; N].
    weight : (n,) array
        A factor on each joint's noise.
    """

    used: tuple[Mask, ...]
    block: tuple[Index, ...]
    y: tuple[Array, ...]
    weight: Array

    def of(self, joint: int, values: Sequence[Array]) -> Array:
        """Stack the joint's rows of values (N, ...) at each data set's own rate."""
        parts = [
            of_scene[samples]
            for of_scene, samples in zip(values, self._samples[joint], strict=True)
        ]
        return np.concatenate(parts)

    @cached_property
    def _samples(self) -> list[list[Index]]:
        """By joint and data set, the samples that are used: quicker than their mask."""
        return [
            [np.flatnonzero(used[:, joint]) for used in self.used]
            for joint in range(len(self.y))
        ]


def high_band(rows: Rows) -> HighBand:
    """Take the rows above the cut-off where joints slide, in blocks of `rows`."""
    used_by_scene: list[Mask] = []
    block_by_scene: list[Index] = []
    torque_by_scene: list[Array] = []

    # Of long logs every second block counts, or every third, ...: memory.
    total_samples = sum((scene.full or scene).samples for scene in rows.scenes)
    block_stride = max(1, -(-total_samples // MOST_SAMPLES))

    for scene, samples, counts, block in zip(
        rows.scenes, rows.samples, rows.used, rows.block, strict=True
    ):
        full = scene.full or scene
        factor = round(full.motion.rate_hz / scene.motion.rate_hz)

        # Every sample at the log's own rate belongs to the kept sample before it.
        kept_samples = samples * factor
        sample = np.arange(full.samples)
        previous = np.searchsorted(kept_samples, sample, side="right") - 1
        nearest = np.clip(previous, 0, len(kept_samples) - 1)
        distance = np.abs(kept_samples[nearest] - sample)
        is_kept = distance < stride_of(scene.motion) * factor
        is_kept &= block[nearest] % block_stride == 0

        counting = full.slides & is_kept[:, None] & counts.any(axis=0)
        torque = _above(full)
        torque_by_scene.append(torque)
        used_by_scene.append(counting & ~_bursts(torque, counting, full))
        block_by_scene.append(block[nearest])

    block_by_joint: list[Index] = []
    torque_by_joint: list[Array] = []
    for joint in range(rows.n):
        masks = [used[:, joint] for used in used_by_scene]
        blocks = [b[mask] for b, mask in zip(block_by_scene, masks, strict=True)]
        torques = [
            torque[mask, joint]
            for torque, mask in zip(torque_by_scene, masks, strict=True)
        ]
        block_by_joint.append(np.concatenate(blocks))
        torque_by_joint.append(np.concatenate(torques))

    # There are many more rows above the cut-off: together they count as those below.
    weight = [
        np.sqrt(max(len(torque), 1) / max(rows.count(joint), 1))
        for joint, torque in enumerate(torque_by_joint)
    ]
    return HighBand(
        used=tuple(used_by_scene),
        block=tuple(block_by_joint),
        y=tuple(torque_by_joint),
        weight=np.array(weight),
    )


def both_bands(
    rows: Rows, high: HighBand, per_scene: Sequence[Mapping[int, Array]]
) -> dict[int, Array]:
    """Split columns at the logs' own rates into rows below and above the cut-off.

    Of a log in which nearly all of a column lies above, what is left below comes from
    where the joint reverses, and there its law is known least: then that log's rows
    above alone count.

    Parameters
    ----------
    rows : Rows
        The rows below the cut-off.
    high : HighBand
        The rows above it.
    per_scene : sequence of mappings of joint to (N, k) array
        Torque per unit coefficient [N m; N where prismatic], unfiltered.

    Returns
    -------
    dict of channel to (M_c, k) array
        Rows below the cut-off belong to channel `joint`, those above it to channel
        n + joint, in single precision.
    """
    below = defaultdict[int, list[Array]](list)
    above = defaultdict[int, list[Array]](list)
    for scene, columns in zip(rows.scenes, per_scene, strict=True):
        full = scene.full or scene
        factor = round(full.motion.rate_hz / scene.motion.rate_hz)
        for joint, X in columns.items():
            low = full.motion.filtered(X, times=2)
            lies_above = np.mean(low**2) < PASSING * np.mean((X - low) ** 2)
            slow = low[::factor]
            below[joint].append(np.zeros_like(slow) if lies_above else slow)
            above[joint].append(X - low)

    result = {}
    for joint, slow_by_scene in below.items():
        result[joint] = rows.torque(joint, slow_by_scene)
        # There are many rows above, and hundreds of candidates that keep theirs.
        fast = high.of(joint, above[joint]).astype(np.float32)
        result[rows.n + joint] = cast(Array, fast)
    return result


def full_residual(scene: Scene, residual: Array) -> Array:
    """Return a residual at the log's own rate, with what lies above the cut-off.

    Parameters
    ----------
    `scene` : `Scene`
        The data set.
    residual : (N, n) array
        The low-passed residual at the data set's rate [N m; N where prismatic].

    Returns
    -------
    (N_full, n) array
        Zero where no sample is usable.
    """
    full = scene.full or scene
    slow = [
        np.interp(full.motion.t, scene.motion.t, of_joint) for of_joint in residual.T
    ]
    total: Array = _above(full) + np.stack(slow, axis=1)
    total[~full.motion.usable] = 0.0
    return total


def _above(full: Scene) -> Array:
    """Return the measured torque (N, n) above the cut-off less the model's.

    It is kept with the data set: every search asks for it.
    """
    key = ("torque above the cut-off", 0)
    if key not in full.memo:
        assert full.measured is not None
        residual = full.measured - full.modelled
        above = np.asarray(residual - full.motion.filtered(residual, times=2))
        full.memo[key] = (above,)
    return full.memo[key][0]


def _bursts(above: Array, counting: Mask, full: Scene) -> Mask:
    """Return about which samples (N, n) there is far more than is usual in the log."""
    period = max(round(full.motion.rate_hz / full.motion.lowpass.cutoff_hz), 3)
    local_power = uniform_filter1d(above**2, period, axis=0)
    usual_power = []
    for of_joint, counts in zip(local_power.T, counting.T, strict=True):
        usual_power.append(np.median(of_joint[counts]) if counts.any() else np.inf)
    return np.asarray(local_power > BURST**2 * np.array(usual_power))
