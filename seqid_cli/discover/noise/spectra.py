"""Spectra of what is random in a log's torque, and how the low-pass passes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import detrend

from seqid_cli.motion.filters.butterworth import ORDER, Lowpass
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.typing import Array, Mask

DETAIL = 0.002  # of a joint's torque, that no model gets right
# Bins of a tapered spectrum that count as one, times the variance of a median over that of a mean.
HANN_MEDIAN = 1.5 * 2.08
NYQUIST_SHARE = 0.9
SLOWEST = 2  # waves in a stretch, from which on its spectrum is free of its trend
PER_OCTAVE = 4  # bands


def power_gain(lowpass: Lowpass, frequency: Array, times: int) -> Array:
    """Power gain of `times` zero-phase passes at frequencies (F,) Hz."""
    if not lowpass.active:
        return np.ones_like(frequency)
    rate = lowpass.rate_hz
    warped = np.tan(np.pi * np.minimum(frequency, 0.499999 * rate) / rate)
    ratio = warped / np.tan(np.pi * lowpass.cutoff_hz / rate)
    gain: Array = (1.0 + ratio ** (2 * ORDER)) ** (-2.0 * times)
    return gain


def stretches(mask: Mask, length: int) -> list[int]:
    """First samples of as many stretches of `length` samples as lie within True."""
    return [s for a, b in runs(mask, len(mask)) for s in range(a, b - length + 1, length)]


@dataclass(frozen=True)
class Spectrum:
    """Two-sided densities (F,) N^2 m^2 / Hz of one joint's torque at frequencies (F,) Hz.

    `averaged` (F,) independent periodograms are behind each.
    """

    frequency: Array
    density: Array
    averaged: Array

    @classmethod
    def of(
        cls, values: Array, starts: Sequence[int], length: int, rate_hz: float, *, robust: bool
    ) -> Spectrum:
        """Spectrum of values (N,) over stretches, below the Nyquist frequency; none of no stretch.

        The stretches have `length` samples from each of `starts` on; the trend of each is removed.
        `robust` tapers them, as motion leaks, and takes the median over them instead of the mean.
        """
        frequency = np.fft.rfftfreq(length, 1.0 / rate_hz).astype(np.float64)
        kept = (np.arange(len(frequency)) >= SLOWEST) & (frequency < 0.5 * NYQUIST_SHARE * rate_hz)
        if not starts or not kept.any():
            return cls(np.zeros(0), np.zeros(0), np.zeros(0))
        window = np.hanning(length) if robust else np.ones(length)
        pieces = window * detrend(np.stack([values[s : s + length] for s in starts]), axis=1)
        power = np.abs(np.fft.rfft(pieces, axis=1)[:, kept]) ** 2 / (rate_hz * np.sum(window**2))
        # The median of an exponential distribution is log 2 of its mean; that of two is their mean.
        middle = robust and len(starts) > 2
        density = np.median(power, axis=0) / np.log(2.0) if middle else power.mean(axis=0)
        count = len(starts) / HANN_MEDIAN if robust else len(starts)
        return cls(frequency[kept], density, np.full(len(density), count))

    def within(self, low: float, high: float) -> Spectrum:
        """What lies between two frequencies, Hz."""
        kept = (self.frequency > low) & (self.frequency < high)
        return Spectrum(self.frequency[kept], self.density[kept], self.averaged[kept])

    def at_least(self, density: float) -> Spectrum:
        """The same where less than a density cannot be."""
        return replace(self, density=np.maximum(self.density, density))

    @property
    def bands(self) -> Spectrum:
        """The same in bands of a fraction of an octave."""
        band = np.floor(PER_OCTAVE * np.log2(self.frequency))
        starts = np.flatnonzero(np.diff(band, prepend=-np.inf))
        count = np.diff(starts, append=len(band))
        parts = (self.frequency, self.density, self.averaged)
        frequency, density, averaged = (np.add.reduceat(x, starts) for x in parts)
        return Spectrum(frequency / count, density / count, averaged)
