"""Spectra of what is random in a joint's torque; its noise as white and 1/f^a noise.

    S(f) = s (1 + r (f / f0)^-a)

Motion, its steps and a controller that hunts only add to noise, in bands that are not
known. So a band of a spectrum that lies z standard errors from S costs z^2 / 2 in
log-likelihood (P. Whittle, "Estimation and information in stationary time series",
Arkiv foer Matematik 2(5), 1953); but one above it never more than an excess there does,
a parameter of its own. For each r and a the most likely s is then the mean of the
lowest bands. What r and a may be is weighed by likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import detrend
from scipy.special import digamma, ndtr, polygamma, softmax

from seqid_cli.motion.filters.butterworth import ORDER, Lowpass
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array, Mask

# motion of a log, and for how many seconds the joint slides
Slid = Sequence[tuple[Motion, float]]

GRID = 400  # frequencies, over which a band is integrated
LEVEL = 0.95  # of the interval
TAIL = 0.5 * (1.0 - LEVEL)
STEPS = 2000  # of a distribution
REACH = 5.0  # standard deviations, up to which it is followed
UNLIKELY = 1e-6
RATIOS = np.geomspace(1e-2, 1e2, 25)
EXPONENTS = (1.0, 0.5, 0.75, 1.25, 1.5)
# Shapes that noise may have, each with how many parameters it has more than white
# noise: white, 1/f, and other exponents.
EXPONENT = np.concatenate([[0.0], np.repeat(EXPONENTS, len(RATIOS))])
RATIO = np.concatenate([[0.0], np.tile(RATIOS, len(EXPONENTS))])
MORE = np.concatenate([[0.0], np.repeat([1.0, 2.0, 2.0, 2.0, 2.0], len(RATIOS))])
WHITE = RATIO == 0.0
TINY = 1e-300

DETAIL = 0.002  # of a joint's torque, that no model gets right
# Bins of a tapered spectrum that count as one, times the variance of a median over that
# of a mean.
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
    return np.asarray((1.0 + ratio ** (2 * ORDER)) ** (-2.0 * times))


def stretches(mask: Mask, length: int) -> list[int]:
    """First samples of as many stretches of `length` samples as lie within True."""
    return [
        s for a, b in runs(mask, len(mask)) for s in range(a, b - length + 1, length)
    ]


@dataclass(frozen=True)
class Spectrum:
    """Two-sided densities (F,) N^2 m^2 / Hz, each of so many `averaged` (F,) periodograms."""

    frequency: Array
    density: Array
    averaged: Array

    @classmethod
    def of(
        cls,
        values: Array,
        starts: Sequence[int],
        length: int,
        rate_hz: float,
        *,
        robust: bool,
    ) -> Spectrum:
        """Spectrum of values (N,) over stretches, below the Nyquist frequency; none of no stretch.

        The stretches have `length` samples from each of `starts` on; the trend of each
        is removed. `robust` tapers them, as motion leaks, and takes the median over
        them instead of the mean.
        """
        frequency = np.fft.rfftfreq(length, 1.0 / rate_hz).astype(np.float64)
        kept = (np.arange(len(frequency)) >= SLOWEST) & (
            frequency < 0.5 * NYQUIST_SHARE * rate_hz
        )
        if not starts or not kept.any():
            return cls(np.zeros(0), np.zeros(0), np.zeros(0))
        window = np.hanning(length) if robust else np.ones(length)
        pieces = window * detrend(
            np.stack([values[s : s + length] for s in starts]), axis=1
        )
        power = np.abs(np.fft.rfft(pieces, axis=1)[:, kept]) ** 2 / (
            rate_hz * np.sum(window**2)
        )
        # The median of an exponential distribution is log 2 of its mean; that of two is
        # their mean.
        middle = robust and len(starts) > 2
        density = (
            np.median(power, axis=0) / np.log(2.0) if middle else power.mean(axis=0)
        )
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
    def bands(self) -> tuple[Array, Array, Array]:
        """The same, array by array, in bands of a fraction of an octave."""
        band = np.floor(PER_OCTAVE * np.log2(self.frequency))
        starts = np.flatnonzero(np.diff(band, prepend=-np.inf))
        count = np.diff(starts, append=len(band))
        parts = (self.frequency, self.density, self.averaged)
        frequency, density, averaged = (np.add.reduceat(x, starts) for x in parts)
        return frequency / count, density / count, averaged


@dataclass(frozen=True)
class Level:
    """What noise may be: for each shape (K,) the logarithm of s, its variance, and a weight."""

    log_scale: Array
    variance: Array
    weight: Array
    reference_hz: float

    def rms(self, slid: Slid) -> Array:
        """RMS of the low-passed noise, ends of its 95 % interval, the most of any shape (4,)."""
        total = sum(seconds for _, seconds in slid)
        passed, scatter = np.zeros(len(RATIO)), np.zeros(len(RATIO))
        for motion, seconds in slid:
            top = min(0.5 * motion.rate_hz, 2.0 * motion.lowpass.cutoff_hz)
            frequency = np.geomspace(1.0 / motion.t[-1], top, GRID)
            # of both signs together
            passing = 2.0 * power_gain(motion.lowpass, frequency, 2)
            density = passing * _shapes(frequency / self.reference_hz)
            passed += seconds / total * np.trapezoid(density, frequency)
            scatter += seconds / total**2 * np.trapezoid(density**2, frequency)
        middle = self.log_scale + np.log(passed)
        spread = np.sqrt(self.variance + scatter / passed**2)
        likely, white = self.weight > UNLIKELY, self.weight[WHITE].sum() > 0.5
        most_likely = likely & (WHITE if white else ~WHITE)
        found = self._quantiles(middle, spread, most_likely, [0.5])
        low, high = self._quantiles(middle, spread, likely, [TAIL, 1.0 - TAIL])
        ends = min(low, found[0]), max(high, found[0]), max(high, middle.max())
        return np.exp(0.5 * np.array([found[0], *ends]))

    def _quantiles(
        self, middle: Array, spread: Array, some: Mask, shares: list[float]
    ) -> Array:
        """Quantiles of the logarithm of a mean square over some of the shapes."""
        middle, spread = middle[some, None], spread[some, None]
        ends = (middle - REACH * spread).min(), (middle + REACH * spread).max()
        at = np.linspace(*ends, STEPS)
        below = self.weight[some] @ ndtr((at - middle) / spread)
        return np.interp(shares, below / below[-1], at)


def level_of(spectra: Sequence[Spectrum], reference_hz: float) -> Level:
    """White and 1/f^a noise of a joint, of which spectra show at least as much as there is.

    r is their ratio at `reference_hz`. The excess of a band, noise that is not white
    and an exponent other than 1 must each gain a log-likelihood of one (Akaike's
    criterion).
    """
    bands = zip(*(one.bands for one in spectra), strict=True)
    frequency, density, averaged = map(np.concatenate, bands)
    # A mean of so many periodograms has a gamma distribution; its logarithm is off and
    # scatters.
    known = np.log(np.maximum(density, TINY)) - digamma(averaged) + np.log(averaged)
    above = known - np.log(_shapes(frequency / reference_hz))
    order = np.argsort(above, axis=1)
    above = np.take_along_axis(above, order, axis=1)
    precision = 1.0 / polygamma(1, averaged)[order]
    # Of the lowest 1, 2, ... bands: their mean, and what they and an excess of all
    # others cost.
    total = np.cumsum(precision, axis=1)
    mean = np.cumsum(precision * above, axis=1) / total
    lost = 0.5 * (np.cumsum(precision * above**2, axis=1) - total * mean**2)
    lost += np.arange(len(frequency))[::-1]
    best = np.arange(len(above)), np.argmin(lost, axis=1)
    prior = -MORE - np.log([np.count_nonzero(more == MORE) for more in MORE])
    weight = softmax(prior - lost[best] - 0.5 * np.log(total[best]))
    return Level(mean[best], 1.0 / total[best], weight, reference_hz)


def _shapes(relative: Array) -> Array:
    """S over s (K, F) at frequencies (F,) relative to f0."""
    return np.asarray(1.0 + RATIO[:, None] * relative ** -EXPONENT[:, None])
