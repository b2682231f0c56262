"""Reversal uncertainty: what is not known of friction where a joint turns back or rests.

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

import numpy as np

from seqid_cli.model.effects.scene import Scene
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
    """What is uncertain in some rows, from `first` on."""

    first: int
    directions: Array  # (m, k)
    # (k,) of each: 1 - 1 / sqrt(1 + s^2), its uncertainty s times torque noise
    taken: Array

    @classmethod
    def of(cls, first: int, uncertain: Array) -> Reversal:
        """From standard deviations (m, k), in units of torque noise."""
        U, s, _ = np.linalg.svd(uncertain, full_matrices=False)
        return cls(first, U, 1.0 - 1.0 / np.sqrt(1.0 + s**2))

    def whiten(self, values: Array) -> None:
        """Whiten values (M, k) in place."""
        part = values[self.first : self.first + len(self.directions)]
        part -= self.directions @ (self.taken[:, None] * (self.directions.T @ part))


def reversals_of(scene: Scene, picked: Index, used: Mask, joint: int) -> list[Reversal]:
    """Find what is uncertain in one joint's rows: samples `picked` (M,), where `used` (M,)."""
    noise, number = _noise(scene, joint), np.cumsum(used) - 1
    uncertain = [(start, pulses / noise) for start, pulses in _uncertain(scene, joint)]
    found: list[Reversal] = []
    for row, every in low_passed(scene.motion, picked, uncertain):
        counts = np.flatnonzero(used[row : row + len(every)])
        size = np.abs(seen := every[counts])
        felt = np.flatnonzero(
            size.max(axis=1, initial=0.0) > SEEN * size.max(initial=0.0)
        )
        # not where friction is small beside torque noise, or either is unknown
        if len(felt):
            first = int(number[row + counts[felt[0]]])
            found.append(Reversal.of(first, seen[felt[0] : felt[-1] + 1]))
    return sorted(found, key=lambda one: one.first)


def low_passed(
    motion: Motion, picked: Index, uncertain: Sequence[tuple[int, Array]]
) -> Iterator[tuple[int, Array]]:
    """Low-pass pulses (m, k) from a sample on, twice; first row and rows (r, k) that feel each."""
    lowpass, alike = motion.lowpass, dict[int, list[tuple[int, Array]]]()
    reach = lowpass.memory
    for first, pulses in uncertain:
        low, high = first - reach, first + len(pulses) + reach
        if low >= 0 and high <= motion.samples and motion.valid[low:high].all():
            alike.setdefault(len(pulses), []).append((low, pulses))
            continue
        low, high = max(0, low), min(motion.samples, high)
        values = np.zeros((high - low, pulses.shape[1]))
        start, stop = max(first, 0), min(first + len(pulses), motion.samples)
        values[start - low : stop - low] = pulses[start - first : stop - first]
        valid = motion.valid[low:high]
        yield _at_rows(picked, low, lowpass(lowpass(values, valid), valid))
    for own in alike.values():  # of one length, with nothing missing: at once
        values = np.pad(
            np.hstack([pulses for _, pulses in own]), ((reach, reach), (0, 0))
        )
        valid = np.ones(len(values), dtype=bool)
        values = lowpass(lowpass(values, valid), valid)
        ends = np.cumsum([pulses.shape[1] for _, pulses in own])
        for (low, _), part in zip(
            own, np.split(values, ends[:-1], axis=1), strict=True
        ):
            yield _at_rows(picked, low, part)


def _at_rows(picked: Index, low: int, values: Array) -> tuple[int, Array]:
    """The first row, and the rows, of values (m, k) from sample `low` on."""
    row, end = np.searchsorted(picked, [low, low + len(values)])
    return int(row), values[picked[row:end] - low]


def _uncertain(scene: Scene, joint: int) -> Iterator[tuple[int, Array]]:
    """First sample and standard deviations (m, k) N m of friction, for all that is uncertain."""
    v, friction = scene.motion.dq[:, joint], scene.friction[:, joint]
    rate = scene.motion.rate_hz
    period = rate / scene.motion.lowpass.cutoff_hz
    for start, stop in runs(~scene.slides[:, joint], len(v)):
        first, last = max(start - 1, 0), min(stop, len(v) - 1)
        turned = start > 0 and stop < len(v) and v[first] * v[last] < 0
        if turned:
            step, length = abs(friction[last] - friction[first]), (last - first) / rate
            for at in _crossings(v[first : last + 1]):
                yield _displaced(first + at, step, length, rate)
        if not turned or last - first >= period:
            size = ANYTHING * max(abs(friction[first]), abs(friction[last]))
            yield from _free(start, stop, size, max(1, round(SPACING * period)))


def _crossings(v: Array) -> list[float]:
    """Where velocities (N,) change their sign for the first and for the last time, in samples."""
    at = np.flatnonzero(v[:-1] * v[1:] <= 0)
    both = np.unique([at[0], at[-1]])
    apart = np.where(v[both] == v[both + 1], 1.0, v[both] - v[both + 1])
    return [float(x) for x in both + v[both] / apart]


def _displaced(at: float, step: float, length: float, rate: float) -> tuple[int, Array]:
    """What a step that is off, and one that takes its time, add to friction (4, 2)."""
    low = int(at)
    pulse = rate * np.array([0.0, 0.0, 1.0 - (at - low), at - low, 0.0, 0.0])
    slope = 0.5 * rate * (pulse[2:] - pulse[:-2])
    off, long = OFF * length, (ANYTHING * length) ** 2 / 24.0
    # The first of the four samples may lie before the log; its weight is none then.
    return low - 1, step * np.stack([off * pulse[1:-1], long * slope], axis=1)


def _free(
    start: int, stop: int, size: float, every: int
) -> Iterator[tuple[int, Array]]:
    """Pulses (m, k) of friction that may be anything, from both ends of a rest inwards."""
    width = min(every, max(1, (stop - start) // 2))
    count = min(EDGE, max(1, (stop - start) // (2 * width)))
    reach = min(width * count, stop - start)
    pulses = np.zeros((reach, count))
    pulses[
        np.minimum(width * np.arange(count) + width // 2, reach - 1), np.arange(count)
    ] = width
    yield start, size * pulses
    yield stop - reach, size * pulses[::-1]


def _noise(scene: Scene, joint: int) -> float:
    """RMS [N m] that torque noise has in the rows, if as white as it is fast, and a detail."""
    full = scene.full or scene
    if full.measured is None or scene.motion.tau is None:
        return np.inf
    quick = np.diff(full.measured[full.motion.valid, joint], n=3)
    white = float(gaussian_spread(quick)) / THIRD if len(quick) else 0.0
    frequency = np.linspace(0.0, 0.5 * full.motion.rate_hz, GRID)
    passed = float(np.sqrt(np.mean(power_gain(full.motion.lowpass, frequency, 2))))
    torque = scene.motion.tau[scene.motion.usable, joint]
    detail = DETAIL * float(np.linalg.norm(torque)) / np.sqrt(max(len(torque), 1))
    return max(float(np.hypot(white * passed, detail)), 1e-12)
