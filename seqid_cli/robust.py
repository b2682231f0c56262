"""Sizes of values: RMS, and deviations that a few large ones do not move."""

import numpy as np

from seqid_cli.typing import Array, Mask

# Standard deviation of Gaussian values per median of their magnitudes.
PER_MEDIAN = 1.4826
DIFFERENCES = 4
# By which fourth differences raise white noise: the sum of squares of 1, 4, 6, 4, 1.
DIFFERENCES_GAIN = 70.0**0.5


def rms(values: Array) -> float:
    """Return the root of the mean square; zero of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def gaussian_spread(values: Array) -> Array:
    """Return the standard deviation (...) of Gaussian values (N, ...) about zero."""
    return np.asarray(PER_MEDIAN * np.median(np.abs(values), axis=0))


def white_noise(
    values: Array, valid: Mask | None = None, *, min_samples: int = 9
) -> Array:
    """Return the standard deviation of the white part of signals.

    Fourth differences keep the noise and drop the motion; their median drops jolts.

    Parameters
    ----------
    values : (N, ...) array
        Signals, evenly sampled.
    valid : (N,) array of bool, optional
        Samples that count; by default all do.
    min_samples : int
        Samples below which there is nothing to estimate from.

    Returns
    -------
    (...) array
        Standard deviations in the unit of `values`; zero where there are too few
        samples.
    """
    if len(values) < min_samples:
        return np.zeros(values.shape[1:])
    magnitudes = np.abs(np.diff(np.ascontiguousarray(values.T), DIFFERENCES))
    if valid is not None and not valid.all():
        # A difference counts where all five samples of it do.
        n_valid = np.convolve(valid, np.ones(DIFFERENCES + 1), "valid")
        magnitudes = magnitudes[..., n_valid > DIFFERENCES + 0.5]
    if not magnitudes.size:
        return np.zeros(values.shape[1:])
    median = np.median(magnitudes, axis=-1)
    return np.asarray(PER_MEDIAN / DIFFERENCES_GAIN * median)


def rough(values: Array) -> Array:
    """Return fourth differences (N - 4, ...) of signals (N, ...), noise as it is."""
    return np.asarray(np.diff(values, DIFFERENCES, axis=0) / DIFFERENCES_GAIN)
