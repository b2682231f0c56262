"""Standard deviations that a few large values do not move."""

import numpy as np

from seqid_cli.typing import Array, Mask

# standard deviation of Gaussian values per median of their magnitudes
PER_MEDIAN = 1.4826
DIFFERENCES = 4
DIFFERENCES_GAIN = 70.0**0.5  # by which fourth differences raise white noise


def gaussian_spread(values: Array) -> Array:
    """Return the standard deviation (...) of Gaussian values (N, ...) about zero."""
    return np.asarray(PER_MEDIAN * np.median(np.abs(values), axis=0))


def white_noise(values: Array, known: Mask | None = None, *, fewest: int = 9) -> Array:
    """Return the standard deviation (...) of the white part of signals (N, ...).

    Fourth differences keep the noise and drop the motion; the median drops jolts. Only
    those within stretches that are `known` (N,) count; zero where there are too few.
    """
    if len(values) < fewest:
        return np.zeros(values.shape[1:])
    columns = np.abs(np.diff(np.ascontiguousarray(values.T), DIFFERENCES))
    if known is not None and not known.all():
        whole = (
            np.convolve(known, np.ones(DIFFERENCES + 1), "valid") > DIFFERENCES + 0.5
        )
        columns = columns[..., whole]
    if not columns.size:
        return np.zeros(values.shape[1:])
    return np.asarray(PER_MEDIAN / DIFFERENCES_GAIN * np.median(columns, axis=-1))


def rough(values: Array) -> Array:
    """Return fourth differences (N - 4, ...) of signals (N, ...), scaled as the noise is."""
    return np.asarray(np.diff(values, DIFFERENCES, axis=0) / DIFFERENCES_GAIN)
