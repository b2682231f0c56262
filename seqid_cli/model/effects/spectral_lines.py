"""Lines at a fixed frequency of time in several logs: found by power, refined by phase.

Power, summed over the logs, finds a line to within one over the longest log. Where the logs share
a clock, the phases that the line has in them fix its frequency to a fraction of one over the time
that they span: demodulated to a few values per log, that search costs next to nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import periodogram

from seqid_cli.typing import Array, Complex

PEAK = 12.0  # power over that of the neighbourhood, below which nothing is looked at
NEIGHBOURHOOD_HZ = 1.5
PIECES = 8  # values that a log is demodulated to
STEPS = 6.0  # frequencies per one over the span
MOST_STEPS = 200_000


@dataclass(frozen=True)
class Signal:
    """One log's values (N,) at `rate_hz`, the first at time `start` s; zero where none counts."""

    values: Array
    rate_hz: float
    start: float = 0.0

    @property
    def time(self) -> Array:
        """Time (N,) s."""
        return self.start + np.arange(len(self.values)) / self.rate_hz

    @property
    def length_s(self) -> float:
        """Duration."""
        return len(self.values) / self.rate_hz


def strongest_lines(signals: Sequence[Signal], low_hz: float, count: int) -> list[float]:
    """Frequencies from `low_hz` on at which the logs' summed power stands out, highest first."""
    longest = max((signal.length_s for signal in signals), default=0.0)
    top = 0.45 * min((signal.rate_hz for signal in signals), default=0.0)
    low = max(low_hz, 8.0 / longest) if longest > 0.0 else np.inf
    if low >= top:
        return []
    grid = np.arange(low, top, 0.25 / longest)
    power = np.zeros(len(grid))
    for own in signals:
        size = 4 * len(own.values)
        lines = periodogram(own.values, own.rate_hz, "hann", size, scaling="spectrum")
        power += np.interp(grid, *lines)
    width = max(9, int(NEIGHBOURHOOD_HZ / (0.25 / longest)))
    floor = median_filter(power, size=min(width, len(grid)), mode="nearest")
    ratio = power / np.maximum(floor, 1e-12 * max(float(power.max()), 1e-300))
    found: list[float] = []
    for k in np.argsort(-ratio):
        if ratio[k] < PEAK or len(found) == count:
            break
        if all(abs(grid[k] - f) > 4.0 / longest for f in found):
            found.append(float(grid[k]))
    return found


def amplitude(signal: Signal, frequency: float) -> float:
    """Amplitude of the signal's line at a frequency, over the values that count."""
    z, _, weight = _demodulated(signal, frequency)
    return float(2.0 * np.abs(weight @ z) / max(float(weight.sum()), 1.0))


def refined(signals: Sequence[Signal], near: float) -> tuple[float, float]:
    """Sharpen a line's frequency by its phases; the logs share the clock of their starts.

    Returns the frequency (Hz) and the coherence: 1 if amplitude and phase are always the same.
    """
    parts = zip(*(_demodulated(signal, near) for signal in signals), strict=True)
    z, t, weight = map(np.concatenate, parts)
    longest = max(signal.length_s for signal in signals)
    reach, step = 0.75 / longest, 1.0 / (STEPS * max(float(np.ptp(t)), longest))
    half = min(int(np.ceil(reach / step)), MOST_STEPS)
    offsets = step * np.arange(-half, half + 1)
    score = _coherence(z, t, weight, np.asarray(offsets, dtype=np.float64))
    centre = offsets[int(np.argmax(score))]
    for _ in range(3):  # each closes in by a factor of eight
        close = centre + step * np.linspace(-1.0, 1.0, 33)
        score = _coherence(z, t, weight, close)
        centre, step = close[int(np.argmax(score))], step / 8.0
    return near + float(centre), float(score.max())


def _coherence(z: Complex, t: Array, weight: Array, offsets: Array) -> Array:
    total = float(weight @ np.abs(z) ** 2) * float(weight.sum())
    chunks = np.array_split(offsets, max(1, len(offsets) * len(t) // 2_000_000))
    sums = [np.abs(np.exp(-2j * np.pi * np.outer(part, t)) @ (weight * z)) ** 2 for part in chunks]
    return np.concatenate(sums) / max(total, 1e-300)


def _demodulated(signal: Signal, frequency: float) -> tuple[Complex, Array, Array]:
    """Means of a signal, turned back by a frequency, in equal pieces; their times and numbers."""
    counts = np.flatnonzero(signal.values)
    time = signal.time[counts]
    turned = signal.values[counts] * np.exp(-2j * np.pi * frequency * time)
    piece = counts * PIECES // max(len(signal.values), 1)
    weight = np.bincount(piece, minlength=PIECES).astype(np.float64)
    number, there = np.maximum(weight, 1.0), [turned.real, turned.imag, time]
    real, imag, t = (np.bincount(piece, x, minlength=PIECES) / number for x in there)
    return real + 1j * imag, t, weight
