"""The low-pass of thinned samples: the response of the one at the log's own rate, not another's.

A Butterworth filter designed for every M-th sample by the bilinear transform is not the filter that
ran at the full rate: near its cut-off the two differ by what the frequency axis is bent. Terms
computed from thinned motion must see the filter that the torque has seen, so this one has the
impulse response of the full rate's zero-phase filter at the kept samples. With the poles p_i of
one pass B(z) inside the unit circle,

    B(z) B(1/z):  h[k] = sum_i c_i p_i^|k|,      kept:  M h[M k] = sum_i M c_i (p_i^M)^|k|

(impulse invariance), again the response of a filter with poles p_i^M that is run forward and
backward; its zeros follow from the spectral factorisation of the numerator. Both responses differ
only by what lies above half of the kept rate, 3e-6 at ten samples per period of the cut-off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, zpk2sos

Array = NDArray[np.float64]
Complex = NDArray[np.clongdouble]


def thinned_sections(order: int, cutoff_hz: float, rate_hz: float, every: int) -> Array:
    """Second-order sections (order / 2, 6) of one pass over every `every`-th sample.

    Parameters
    ----------
    order : int
        Of the Butterworth filter at the full rate.
    cutoff_hz : float
        Of one pass.
    rate_hz : float
        Samples per second before thinning.
    every : int
        Samples per kept one.

    Returns
    -------
    (order / 2, 6) array
        With a gain of 1 at rest.
    """
    _, found, _ = butter(order, cutoff_hz, fs=rate_hz, output="zpk")
    poles = np.asarray(found, dtype=np.clongdouble)
    kept = poles**every
    zeros = _inner_roots(_numerator(_weights(poles) * (1 - kept**2), kept))
    gain = np.prod(1 - kept) / np.prod(1 - zeros)
    sos: Array = zpk2sos(
        zeros.astype(np.complex128), kept.astype(np.complex128), float(np.real(gain))
    )
    return sos


def _weights(poles: Complex) -> Complex:
    """Weights c_i of p_i^|k| in the impulse response, up to one factor."""
    apart = poles[:, None] - poles
    np.fill_diagonal(apart, 1.0)
    both = np.prod(apart, axis=1) * np.prod(1 - np.outer(poles, poles), axis=1)
    weights: Complex = (1 + poles) ** (2 * len(poles)) / (poles * both)
    return weights


def _numerator(weights: Complex, poles: Complex) -> Array:
    """Numerator of sum_i w_i / ((1 - p_i / z) (1 - p_i z)) as a polynomial in z + 1 / z."""
    total = np.zeros(len(poles), dtype=np.clongdouble)
    for i, weight in enumerate(weights):
        term = np.array([weight])
        for p in np.delete(poles, i):
            term = np.convolve(term, np.array([-p, 1 + p**2]))
        total += term
    return np.asarray(total.real, dtype=np.float64)


def _inner_roots(numerator: Array) -> Complex:
    """For each root x of a polynomial the solution of z + 1 / z = x inside the unit circle."""
    roots = np.roots(numerator).astype(np.complex128)
    # On the unit circle a response has double zeros; rounding tears them apart where it is tiny.
    torn = (roots.imag == 0.0) & (np.abs(roots.real) < 2.0)
    half = np.where(torn, np.sign(roots.real), roots / 2)
    outer = np.sqrt(half - 1) * np.sqrt(half + 1)
    larger = np.where(np.abs(half + outer) >= 1.0, half + outer, half - outer)
    return np.asarray(1 / larger, dtype=np.clongdouble)
