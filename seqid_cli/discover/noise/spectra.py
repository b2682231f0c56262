"""Spectra of what is random in a log's torque, and how the low-pass passes them."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import detrend

from seqid_cli.motion.filters.butterworth import ORDER, Lowpass
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.typing import Array, Mask

LEAST_SHARE = 0.1  # of the residual's power that stays noise, whatever else explains
DETAIL = 0.002  # of a joint's torque, that no model gets right


def power_gain(lowpass: Lowpass, frequency: Array, times: int) -> Array:
    """Power gain of `times` zero-phase passes at frequencies (F,) Hz."""
    if not lowpass.active:
        return np.ones_like(frequency)
    rate = lowpass.rate_hz
    warped = np.tan(np.pi * np.minimum(frequency, 0.499999 * rate) / rate)
    ratio = warped / np.tan(np.pi * lowpass.cutoff_hz / rate)
    gain: Array = (1.0 + ratio ** (2 * ORDER)) ** (-2.0 * times)
    return gain


def median_spectrum(values: Array, starts: Sequence[int], length: int, rate_hz: float) -> Array:
    """Two-sided density (length // 2 + 1,) of values (N,): the median over stretches.

    Parameters
    ----------
    values : (N,) array
    starts : sequence of int
        First samples of the stretches of `length` samples, each tapered, its trend removed.
    length : int
    rate_hz : float
    """
    window = np.hanning(length)
    pieces = detrend(np.stack([values[s : s + length] for s in starts]), axis=1)
    power = np.abs(np.fft.rfft(window * pieces, axis=1)) ** 2 / (rate_hz * np.sum(window**2))
    if len(starts) < 3:
        return np.asarray(power.mean(axis=0))
    # The median of an exponential distribution is log 2 of its mean.
    return np.asarray(np.median(power, axis=0) / np.log(2.0))


def stretches(mask: Mask, length: int) -> list[int]:
    """First samples of as many stretches of `length` samples as lie within True."""
    return [s for a, b in runs(mask, len(mask)) for s in range(a, b - length + 1, length)]


def nearest(mask: Mask, samples: int) -> Mask:
    """A mask (M, ...) of a data set at the log's own `samples`."""
    spread: Mask = mask[np.linspace(0, len(mask) - 1, samples).round().astype(int)]
    return spread
