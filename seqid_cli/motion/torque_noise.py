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

from seqid_cli.distributions import digamma, normal_probability, trigamma
from seqid_cli.motion.filters.butterworth import ORDER, Lowpass
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.motion import Motion
from seqid_cli.spectra import without_line
from seqid_cli.typing import Array, Mask

# Motion of a log, and for how many seconds the joint slides.
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
    """Return the power gain of some zero-phase passes.

    Parameters
    ----------
    lowpass : Lowpass
    frequency : Array
        (F,) Hz.
    times : int
        Number of passes.

    Returns
    -------
    Array
        (F,), 1 at rest.
    """
    if not lowpass.active:
        return np.ones_like(frequency)
    rate_hz = lowpass.rate_hz
    # The bilinear transform bends the axis of frequencies: the tangent has no end.
    below_nyquist = np.minimum(frequency, 0.499999 * rate_hz)
    warped = np.tan(np.pi * below_nyquist / rate_hz)
    ratio = warped / np.tan(np.pi * lowpass.cutoff_hz / rate_hz)
    return np.asarray((1.0 + ratio ** (2 * ORDER)) ** (-2.0 * times))


def stretches(mask: Mask, length: int) -> list[int]:
    """Return the first samples of as many stretches of a length as lie within True."""
    starts: list[int] = []
    for first, last in runs(mask, len(mask)):
        starts += range(first, last - length + 1, length)
    return starts


@dataclass(frozen=True)
class Spectrum:
    """Two-sided densities of a torque.

    Attributes
    ----------
    frequency : Array
        (F,) Hz.
    density : Array
        (F,) N^2 m^2 / Hz.
    averaged : Array
        (F,), numbers of periodograms that the densities are means of.
    """

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
        """Compute the spectrum over some stretches, below the Nyquist frequency.

        Parameters
        ----------
        values : Array
            (N,) N m.
        starts : sequence of int
            First samples of the stretches. The trend of each stretch is removed.
        length : int
            Samples of a stretch.
        rate_hz : float
        robust : bool
            Whether stretches are tapered, as motion leaks, and the median over them is
            taken instead of the mean.

        Returns
        -------
        Spectrum
            Empty where there is no stretch.
        """
        frequency = np.fft.rfftfreq(length, 1.0 / rate_hz).astype(np.float64)
        free_of_trend = np.arange(len(frequency)) >= SLOWEST
        used = free_of_trend & (frequency < 0.5 * NYQUIST_SHARE * rate_hz)
        if not starts or not used.any():
            return cls(np.zeros(0), np.zeros(0), np.zeros(0))

        window = np.hanning(length) if robust else np.ones(length)
        stacked = np.stack([values[start : start + length] for start in starts])
        pieces = window * without_line(stacked)
        spectra = np.fft.rfft(pieces, axis=1)[:, used]
        power = np.abs(spectra) ** 2 / (rate_hz * np.sum(window**2))

        # The median of an exponential distribution is log 2 of its mean; that of two is
        # their mean.
        if robust and len(starts) > 2:
            density = np.median(power, axis=0) / np.log(2.0)
        else:
            density = power.mean(axis=0)
        count = len(starts) / HANN_MEDIAN if robust else len(starts)
        return cls(frequency[used], density, np.full(len(density), count))

    def within(self, low: float, high: float) -> Spectrum:
        """Return the part between two frequencies, Hz."""
        inside = (self.frequency > low) & (self.frequency < high)
        return Spectrum(
            self.frequency[inside], self.density[inside], self.averaged[inside]
        )

    def at_least(self, density: float) -> Spectrum:
        """Return the spectrum where less than a density cannot be."""
        return replace(self, density=np.maximum(self.density, density))

    def in_bands(self) -> Spectrum:
        """Return the spectrum averaged over bands of a fraction of an octave."""
        band = np.floor(PER_OCTAVE * np.log2(self.frequency))
        starts = np.flatnonzero(np.diff(band, prepend=-np.inf))
        count = np.diff(starts, append=len(band))
        return Spectrum(
            frequency=np.add.reduceat(self.frequency, starts) / count,
            density=np.add.reduceat(self.density, starts) / count,
            averaged=np.add.reduceat(self.averaged, starts),
        )


@dataclass(frozen=True)
class Level:
    """What noise may be, for each of K shapes.

    Attributes
    ----------
    log_scale, variance : Array
        (K,), the logarithm of s and its variance.
    weight : Array
        (K,), probability of the shape.
    reference_hz : float
        f0.
    """

    log_scale: Array
    variance: Array
    weight: Array
    reference_hz: float

    def rms(self, slid: Slid) -> Array:
        """Return the RMS of the low-passed noise where a joint slides.

        Returns
        -------
        Array
            (4,) N m: the most likely one, the ends of its 95 % interval, the largest of
            any shape.
        """
        total_s = sum(seconds for _, seconds in slid)
        passed = np.zeros(len(RATIO))
        scatter = np.zeros(len(RATIO))
        for motion, seconds in slid:
            top = min(0.5 * motion.rate_hz, 2.0 * motion.lowpass.cutoff_hz)
            frequency = np.geomspace(1.0 / motion.t[-1], top, GRID)
            # A two-sided density: frequencies of both signs pass.
            gain = 2.0 * power_gain(motion.lowpass, frequency, 2)
            density = gain * _shapes(frequency / self.reference_hz)
            passed += seconds / total_s * np.trapezoid(density, frequency)
            scatter += seconds / total_s**2 * np.trapezoid(density**2, frequency)

        # Logarithm of the mean square, by shape.
        log_square = self.log_scale + np.log(passed)
        spread = np.sqrt(self.variance + scatter / passed**2)

        likely = self.weight > UNLIKELY
        is_white = self.weight[WHITE].sum() > 0.5
        most_likely = likely & (WHITE if is_white else ~WHITE)
        (middle,) = self._quantiles(log_square, spread, most_likely, [0.5])
        low, high = self._quantiles(log_square, spread, likely, [TAIL, 1.0 - TAIL])
        log_squares = [
            middle,
            min(low, middle),
            max(high, middle),
            max(high, log_square.max()),
        ]
        return np.exp(0.5 * np.array(log_squares))

    def _quantiles(
        self, middle: Array, spread: Array, some: Mask, shares: list[float]
    ) -> Array:
        """Return quantiles of the logarithm of a mean square over some shapes."""
        middle = middle[some, None]
        spread = spread[some, None]
        lowest = (middle - REACH * spread).min()
        highest = (middle + REACH * spread).max()
        at = np.linspace(lowest, highest, STEPS)
        below = self.weight[some] @ normal_probability((at - middle) / spread)
        return np.interp(shares, below / below[-1], at)


def level_of(spectra: Sequence[Spectrum], reference_hz: float) -> Level:
    """Estimate white and 1/f^a noise of a joint.

    The excess of a band, noise that is not white and an exponent other than 1 must each
    gain a log-likelihood of one (Akaike's criterion).

    Parameters
    ----------
    spectra : sequence of Spectrum
        They show at least as much noise as there is.
    reference_hz : float
        f0, where r is the ratio of 1/f^a to white noise.
    """
    bands = [spectrum.in_bands() for spectrum in spectra]
    frequency = np.concatenate([band.frequency for band in bands])
    density = np.concatenate([band.density for band in bands])
    averaged = np.concatenate([band.averaged for band in bands])

    # A mean of so many periodograms has a gamma distribution: its logarithm is off by
    # digamma(a) - log(a) on the average, with the variance trigamma(a).
    log_density = np.log(np.maximum(density, TINY)) - digamma(averaged)
    log_density = log_density + np.log(averaged)
    log_scale = log_density - np.log(_shapes(frequency / reference_hz))
    order = np.argsort(log_scale, axis=1)
    log_scale = np.take_along_axis(log_scale, order, axis=1)
    precision = 1.0 / trigamma(averaged)[order]

    # For the lowest 1, 2, ... bands: their mean, and the log-likelihood that they and
    # an excess of all others cost.
    total = np.cumsum(precision, axis=1)
    mean = np.cumsum(precision * log_scale, axis=1) / total
    squares = np.cumsum(precision * log_scale**2, axis=1)
    cost = 0.5 * (squares - total * mean**2)
    cost += np.arange(len(frequency))[::-1]
    best = (np.arange(len(log_scale)), np.argmin(cost, axis=1))

    n_alike = [np.count_nonzero(n_parameters == MORE) for n_parameters in MORE]
    prior = -MORE - np.log(n_alike)
    log_weight = prior - cost[best] - 0.5 * np.log(total[best])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    return Level(mean[best], 1.0 / total[best], weight, reference_hz)


def _shapes(relative: Array) -> Array:
    """Return S over s (K, F) at frequencies (F,) relative to f0."""
    return np.asarray(1.0 + RATIO[:, None] * relative ** -EXPONENT[:, None])
