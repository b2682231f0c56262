"""Zero-phase low-pass and differentiation of uniformly sampled channels.

The low-pass is a fourth-order Butterworth run forward and backward, so its gain is the squared one
and its phase zero. Every quantity of one equation goes through the same filter (parallel
filtering): a linear equation stays exact whatever the cut-off, only its information shrinks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.signal import butter, sosfiltfilt

from seqid_cli.motion.matched import thinned_sections

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ORDER = 4
SHORTEST = 8  # samples of a run that is filtered at all
# Central differences of eighth order: the error is below 1e-3 up to a tenth of the sampling rate.
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040


@dataclass(frozen=True)
class Lowpass:
    """Zero-phase low-pass at `cutoff_hz` for signals sampled at `rate_hz`.

    Where they are every `every`-th sample of a log, the filter has the response that it has at the
    log's own rate.
    """

    cutoff_hz: float
    rate_hz: float
    every: int = 1

    @property
    def active(self) -> bool:
        """False where the cut-off lies too close to the Nyquist rate to filter anything."""
        return self.cutoff_hz < 0.45 * self.rate_hz

    @property
    def settling(self) -> int:
        """Samples near an end that still feel the missing data beyond it."""
        return int(np.ceil(0.6 * self.rate_hz / self.cutoff_hz)) + 4

    def __call__(self, values: Array, valid: Mask | None = None) -> Array:
        """Filter along the first axis, each run of valid samples by itself.

        Parameters
        ----------
        values : (N, ...) array
            Samples in time order.
        valid : (N,) bool array, optional
            False where samples must not leak into others.

        Returns
        -------
        (N, ...) array
            Filtered values; samples outside valid runs are returned as they came.
        """
        if not self.active:
            return values.copy()
        sos = sections(self.cutoff_hz, self.rate_hz, self.every)
        result = values.copy()
        for start, stop in runs(valid, len(values)):
            pad = min(6 * self.settling, stop - start - 1)
            if stop - start > SHORTEST:
                piece = sosfiltfilt(sos, values[start:stop], axis=0, padtype="odd", padlen=pad)
                result[start:stop] = piece
        return result


@lru_cache(maxsize=64)
def sections(cutoff_hz: float, rate_hz: float, every: int = 1) -> Array:
    """Second-order sections (ORDER / 2, 6) of one pass."""
    if every > 1:
        return thinned_sections(ORDER, cutoff_hz, rate_hz * every, every)
    sos: Array = butter(ORDER, cutoff_hz, fs=rate_hz, output="sos")
    return sos


def runs(mask: Mask | None, length: int) -> list[tuple[int, int]]:
    """Half-open index ranges in which `mask` is True; the whole length where it is None."""
    if mask is None:
        return [(0, length)]
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def shrink(mask: Mask, samples: int) -> Mask:
    """Take `samples` off both ends of every run of True."""
    result = np.zeros_like(mask)
    for start, stop in runs(mask, len(mask)):
        result[start + samples : max(stop - samples, start + samples)] = True
    return result


def differentiate(values: Array, rate_hz: float, valid: Mask | None = None) -> tuple[Array, Array]:
    """First and second time derivative of band-limited samples.

    Parameters
    ----------
    values : (N, ...) array
        Low-passed well below a fifth of the sampling rate.
    rate_hz : float
        Samples per second.
    valid : (N,) bool array, optional
        Derivatives do not reach across samples that are not valid.

    Returns
    -------
    tuple of (N, ...) arrays
        Per second and per second squared; zero outside valid runs.
    """
    first, second = np.zeros_like(values), np.zeros_like(values)
    for start, stop in runs(valid, len(values)):
        piece = _extended(values[start:stop])
        first[start:stop] = correlate1d(piece, _FIRST * rate_hz, axis=0)[4:-4]
        second[start:stop] = correlate1d(piece, _SECOND * rate_hz**2, axis=0)[4:-4]
    return first, second


def _extended(values: Array) -> Array:
    """Four samples more on each side, mirrored through the end points."""
    reach = min(4, len(values) - 1)
    before = 2 * values[:1] - values[reach:0:-1]
    after = 2 * values[-1:] - values[-2 : -2 - reach : -1]
    padded = np.concatenate([before, values, after])
    missing = 4 - reach
    if missing:
        width = [(missing, missing)] + [(0, 0)] * (values.ndim - 1)
        padded = np.pad(padded, width, mode="edge")
    return padded
