"""Reversals: what is not known of friction where a joint turns back or rests.

A joint that turns back sticks until its drive has overcome friction twice. When it
stopped and when it broke loose is known to a share of the time for which it does not
certainly slide, and friction may take any part of that time to change. Its step passes
the low-pass and reaches samples that count:

    row = ... + D h(t - t_r) dt + D h'(t - t_r) T^2 / 24,

D being the step, h the low-pass's response to a pulse, dt how far off the step is and T
how long it takes, other ones at every reversal. Near the ends of a longer rest friction
may be anything up to its size. Rows are whitened for both: what such errors look like
counts for less, the more so the larger friction is over torque noise, and all else for
as much as it did (generalised least squares, one reversal after the other; Aitken,
Proceedings of the Royal Society of Edinburgh 55, 1935).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.torque_noise import DETAIL, power_gain
from seqid_cli.robust import gaussian_spread
from seqid_cli.typing import Array, Index, Mask

# of the time for which a joint does not certainly slide: standard error of its middle
OFF = 0.03
SPACING = 0.15  # periods of the cut-off between times at which friction may be anything
EDGE = 3  # such times that are felt from either end of a rest
SEEN = 1e-3  # of the largest, below which a row does not feel a reversal
GRID = 400
# standard deviation of what may be all from minus one to one
ANYTHING = 1.0 / np.sqrt(3.0)
# standard deviation of third differences of white noise of unit size
THIRD = np.sqrt(20.0)


@dataclass(frozen=True)
class Reversal:
    """What is uncertain in some rows, from `first` on.

    Attributes
    ----------
    first : int
        The first of the joint's rows that feels the reversal.
    directions : (m, k) array
        Orthonormal directions of the uncertain torque, over these m rows.
    shrinkage : (k,) array
        Share by which each direction is shrunk: 1 - 1 / sqrt(1 + s^2), with its
        standard deviation s in units of torque noise.
    """

    first: int
    directions: Array
    shrinkage: Array

    @classmethod
    def of(cls, first: int, std: Array) -> Reversal:
        """Return it from standard deviations (m, k), in units of torque noise."""
        directions, s, _ = np.linalg.svd(std, full_matrices=False)
        return cls(
            first=first,
            directions=directions,
            shrinkage=1.0 - 1.0 / np.sqrt(1.0 + s**2),
        )


@dataclass(frozen=True)
class _Layer:
    """Reversals that share no row: in which order these are whitened is no matter.

    Attributes
    ----------
    rows : (R, m) index array
        The rows of each, some before and after those that it is felt in.
    directions : (R, m, k) array
        Its directions, zero where there are fewer rows or directions.
    shrinkage : (R, k) array
        Its shares.
    """

    rows: Index
    directions: Array
    shrinkage: Array

    @classmethod
    def of(cls, members: Sequence[tuple[Reversal, int]], window: int) -> _Layer:
        """Put reversals side by side, each with the start of its window of rows."""
        n_directions = max(len(reversal.shrinkage) for reversal, _ in members)
        directions = np.zeros((len(members), window, n_directions))
        shrinkage = np.zeros((len(members), n_directions))
        for number, (reversal, start) in enumerate(members):
            m, k = reversal.directions.shape
            first = reversal.first - start
            directions[number, first : first + m, :k] = reversal.directions
            shrinkage[number, :k] = reversal.shrinkage
        starts = np.array([start for _, start in members])
        rows = starts[:, None] + np.arange(window)
        return cls(rows=rows, directions=directions, shrinkage=shrinkage)

    def whiten(self, values: Array) -> None:
        """Whiten values (M_j, c) in place."""
        part = values[self.rows]
        along = np.swapaxes(self.directions, 1, 2) @ part
        along *= self.shrinkage[:, :, None]
        part -= self.directions @ along
        values[self.rows] = part


def _window(length: int) -> int:
    """Return the next power of two: reversals of about one length lie side by side."""
    return 1 << max(length - 1, 0).bit_length()


@dataclass(frozen=True)
class Whitening:
    """All reversals of a joint, those that share no row together.

    A call for each of them takes longer than what it has to do.

    Attributes
    ----------
    layers : tuple of _Layer
        To be whitened one after the other.
    """

    layers: tuple[_Layer, ...]

    @classmethod
    def of(cls, reversals: Sequence[Reversal], n_rows: int) -> Whitening:
        """Arrange reversals, which are in the order of time, of a joint's rows.

        Parameters
        ----------
        reversals : sequence of Reversal
            Counted in the joint's rows.
        n_rows : int
            Number of these.
        """
        # A reversal comes after all that share a row with its window: so each row is
        # whitened in the order of time.
        reached = np.zeros(n_rows, dtype=np.intp)
        members: dict[tuple[int, int], list[tuple[Reversal, int]]] = {}
        for reversal in reversals:
            window = min(_window(len(reversal.directions)), n_rows)
            start = min(reversal.first, n_rows - window)
            at = slice(start, start + window)
            level = int(reached[at].max(initial=0)) + 1
            reached[at] = level
            members.setdefault((level, window), []).append((reversal, start))
        layers = [
            _Layer.of(of_layer, window)
            for (_, window), of_layer in sorted(
                members.items(), key=lambda item: item[0]
            )
        ]
        return cls(layers=tuple(layers))

    def whiten(self, values: Array) -> None:
        """Whiten values (M_j, c) in place."""
        for layer in self.layers:
            layer.whiten(values)


class Pulses(NamedTuple):
    """Torque from a sample, or a row, on: each column is one uncertain direction.

    Attributes
    ----------
    first : int
        Sample or row of the first value.
    values : (m, k) array
        Standard deviations, N m or in units of torque noise.
    """

    first: int
    values: Array


def reversals_of(
    scene: Scene, samples: Index, used: Mask, joint: int
) -> list[Reversal]:
    """Find what is uncertain in one joint's rows of a data set.

    Parameters
    ----------
    `scene` : `Scene`
        The data set.
    samples : (M,) index array
        The samples that are kept.
    used : (M,) mask
        At which of these the joint counts.
    joint : int
        Index of the joint.

    Returns
    -------
    list of Reversal
        In the order of time, counted in the joint's rows.
    """
    noise = _noise(scene, joint)
    uncertain = [
        Pulses(first=pulses.first, values=pulses.values / noise)
        for pulses in _uncertain(scene, joint)
    ]
    row_number = np.cumsum(used) - 1

    reversals: list[Reversal] = []
    for first, std in low_passed(scene.motion, samples, uncertain):
        counting = np.flatnonzero(used[first : first + len(std)])
        std_of_rows = std[counting]
        size = np.abs(std_of_rows)
        is_felt = size.max(axis=1, initial=0.0) > SEEN * size.max(initial=0.0)
        felt = np.flatnonzero(is_felt)
        # None is felt where friction is small beside torque noise or either is unknown.
        if len(felt):
            first_row = int(row_number[first + counting[felt[0]]])
            reversals.append(
                Reversal.of(first_row, std_of_rows[felt[0] : felt[-1] + 1])
            )
    return sorted(reversals, key=lambda reversal: reversal.first)


def low_passed(
    motion: Motion, samples: Index, uncertain: Sequence[Pulses]
) -> Iterator[Pulses]:
    """Low-pass pulses twice, and yield of each the kept samples that feel it.

    Parameters
    ----------
    motion : Motion
        The motion of the data set.
    samples : (M,) index array
        The samples that are kept.
    uncertain : sequence of Pulses
        Each from a sample on.

    Yields
    ------
    Pulses
        From the first of the kept samples on that feels it, in no certain order.
    """
    lowpass = motion.lowpass
    reach = lowpass.memory
    by_length: dict[int, list[Pulses]] = {}
    for pulses in uncertain:
        low = pulses.first - reach
        high = pulses.first + len(pulses.values) + reach
        is_within = low >= 0 and high <= motion.samples
        if is_within and motion.valid[low:high].all():
            shifted = Pulses(first=low, values=pulses.values)
            by_length.setdefault(len(pulses.values), []).append(shifted)
            continue

        # At the ends of the log and about gaps each is low-passed by itself.
        low = max(0, low)
        high = min(motion.samples, high)
        padded = np.zeros((high - low, pulses.values.shape[1]))
        start = max(pulses.first, 0)
        stop = min(pulses.first + len(pulses.values), motion.samples)
        padded[start - low : stop - low] = pulses.values[
            start - pulses.first : stop - pulses.first
        ]
        valid = motion.valid[low:high]
        yield _at_rows(samples, low, lowpass(lowpass(padded, valid), valid))

    # Pulses of one length with nothing missing around are low-passed side by side.
    for same_length in by_length.values():
        side_by_side = np.hstack([pulses.values for pulses in same_length])
        padded = np.pad(side_by_side, ((reach, reach), (0, 0)))
        valid = np.ones(len(padded), dtype=bool)
        padded = lowpass(lowpass(padded, valid), valid)

        ends = np.cumsum([pulses.values.shape[1] for pulses in same_length])
        of_each = np.split(padded, ends[:-1], axis=1)
        for pulses, values in zip(same_length, of_each, strict=True):
            yield _at_rows(samples, pulses.first, values)


def _at_rows(samples: Index, low: int, values: Array) -> Pulses:
    """Return those of values (m, k), from sample `low` on, that lie at kept samples."""
    row, end = np.searchsorted(samples, [low, low + len(values)])
    return Pulses(first=int(row), values=values[samples[row:end] - low])


def _uncertain(scene: Scene, joint: int) -> Iterator[Pulses]:
    """Yield the standard deviations [N m] of friction, for all that is uncertain."""
    v = scene.motion.dq[:, joint]
    friction = scene.friction[:, joint]
    rate_hz = scene.motion.rate_hz
    period = rate_hz / scene.motion.lowpass.cutoff_hz

    for start, stop in runs(~scene.slides[:, joint], len(v)):
        last_before = max(start - 1, 0)
        first_after = min(stop, len(v) - 1)
        is_within = start > 0 and stop < len(v)
        turns_back = is_within and v[last_before] * v[first_after] < 0
        if turns_back:
            step = abs(friction[first_after] - friction[last_before])
            duration_s = (first_after - last_before) / rate_hz
            for crossing in _crossings(v[last_before : first_after + 1]):
                yield _displaced_step(last_before + crossing, step, duration_s, rate_hz)

        # At a longer rest friction may be anything as well, whether it turns or not.
        if not turns_back or first_after - last_before >= period:
            size = ANYTHING * max(
                abs(friction[last_before]), abs(friction[first_after])
            )
            spacing = max(1, round(SPACING * period))
            yield from _ends_of_rest(start, stop, size, spacing)


def _crossings(v: Array) -> list[float]:
    """Return the first and the last change of sign of velocities (N,), in samples."""
    changes = np.flatnonzero(v[:-1] * v[1:] <= 0)
    first_and_last = np.unique([changes[0], changes[-1]])
    fall = v[first_and_last] - v[first_and_last + 1]
    fall = np.where(v[first_and_last] == v[first_and_last + 1], 1.0, fall)
    return [float(sample) for sample in first_and_last + v[first_and_last] / fall]


def _displaced_step(
    crossing: float, step: float, duration_s: float, rate_hz: float
) -> Pulses:
    """Return what a step of friction that is off, and one that takes its time, add.

    The values are (4, 2) N m: the first column for the time of the step, the second
    for how long it takes.
    """
    sample = int(crossing)
    fraction = crossing - sample
    pulse = rate_hz * np.array([0.0, 0.0, 1.0 - fraction, fraction, 0.0, 0.0])
    slope = 0.5 * rate_hz * (pulse[2:] - pulse[:-2])
    std_of_time = OFF * duration_s
    std_of_spread = (ANYTHING * duration_s) ** 2 / 24.0

    columns = np.stack([std_of_time * pulse[1:-1], std_of_spread * slope], axis=1)
    # The first of the four samples may lie before the log; its weight is none then.
    return Pulses(first=sample - 1, values=step * columns)


def _ends_of_rest(start: int, stop: int, size: float, spacing: int) -> Iterator[Pulses]:
    """Yield pulses of friction that may be anything, from a rest's ends inwards."""
    width = min(spacing, max(1, (stop - start) // 2))
    count = min(EDGE, max(1, (stop - start) // (2 * width)))
    reach = min(width * count, stop - start)

    pulses = np.zeros((reach, count))
    number = np.arange(count)
    middle = np.minimum(width * number + width // 2, reach - 1)
    pulses[middle, number] = width
    yield Pulses(first=start, values=size * pulses)
    yield Pulses(first=stop - reach, values=size * pulses[::-1])


def _noise(scene: Scene, joint: int) -> float:
    """Return the RMS [N m] that torque noise and a detail have in the rows.

    The noise is taken to be as white as it is fast. It is infinite where no torque was
    measured.
    """
    full = scene.full or scene
    if full.measured is None or scene.motion.tau is None:
        return np.inf

    # Third differences hold next to nothing of the motion, and all of white noise.
    quick = np.diff(full.measured[full.motion.valid, joint], n=3)
    white = float(gaussian_spread(quick)) / THIRD if len(quick) else 0.0
    frequency = np.linspace(0.0, 0.5 * full.motion.rate_hz, GRID)
    passed = float(np.sqrt(np.mean(power_gain(full.motion.lowpass, frequency, 2))))

    torque = scene.motion.tau[scene.motion.usable, joint]
    detail = DETAIL * float(np.linalg.norm(torque)) / np.sqrt(max(len(torque), 1))
    return max(float(np.hypot(white * passed, detail)), 1e-12)
