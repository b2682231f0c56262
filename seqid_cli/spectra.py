"""Spectra and correlations of signals, as `scipy.signal` has them.

That package imports nearly all of SciPy: half a second of CPU time, more than a command
needs for a log of some minutes. What is used of it takes a few lines. Transforms are
those of `numpy.fft`, which are those of `scipy.fft` to the last bit.
"""

import numpy as np
from numpy.fft import irfft, rfft
from numpy.lib.stride_tricks import sliding_window_view

from seqid_cli.typing import Array


def fast_length(least: int) -> int:
    """Return the smallest length from `least` on whose transform is fast.

    That is a product of twos, threes and fives.
    """
    best = 1 << max(least - 1, 0).bit_length()
    fives = 1
    while fives < best:
        threes = fives
        while threes < best:
            # As many twos as it takes.
            missing = -(-least // threes)
            best = min(best, threes << max(missing - 1, 0).bit_length())
            threes *= 3
        fives *= 5
    return best


def hann(length: int) -> Array:
    """Return the Hann window (length,) of a signal that repeats."""
    phase = 2.0 * np.pi * np.arange(length) / length
    return np.asarray(0.5 - 0.5 * np.cos(phase))


def welch(
    values: Array, rate_hz: float, length: int, *, centred: bool = True
) -> tuple[Array, Array]:
    """Average the spectra of pieces that overlap by half, each under a Hann window.

    P. D. Welch, IEEE Transactions on Audio and Electroacoustics 15(2), 1967.

    Parameters
    ----------
    values : Array
        (N, ...), in a unit u.
    rate_hz : float
    length : int
        Samples of a piece, at most N.
    centred : bool
        Whether the mean of each piece is taken out.

    Returns
    -------
    frequency : Array
        (length // 2 + 1,) Hz.
    density : Array
        (length // 2 + 1, ...) u^2/Hz, of both signs of the frequency together.
    """
    window = hann(length)
    hop = length - length // 2
    pieces = sliding_window_view(values, length, axis=0)[::hop]
    if centred:
        pieces = pieces - pieces.mean(axis=-1, keepdims=True)
    spectra = rfft(pieces * window, axis=-1)
    power = spectra.real**2 + spectra.imag**2
    power /= rate_hz * np.sum(window**2)
    _both_signs(power, length)
    density = np.moveaxis(power.mean(axis=0), -1, 0)
    return _frequencies(length, rate_hz), np.asarray(density)


def line_power(values: Array, rate_hz: float, length: int) -> tuple[Array, Array]:
    """Return frequencies (F,) Hz and the power (F,) of lines at them.

    Parameters
    ----------
    values : Array
        (N,), in a unit u. The mean is taken out.
    rate_hz : float
    length : int
        Values of the transform, N or more: zeros follow the signal.

    Returns
    -------
    frequency : Array
        (length // 2 + 1,) Hz.
    power : Array
        (length // 2 + 1,) u^2.
    """
    window = hann(len(values))
    spectrum = rfft(window * (values - values.mean()), length)
    power = (spectrum.real**2 + spectrum.imag**2) / np.sum(window) ** 2
    _both_signs(power, length)
    return _frequencies(length, rate_hz), np.asarray(power)


def _frequencies(length: int, rate_hz: float) -> Array:
    """Return the frequencies (length // 2 + 1,) Hz of a transform."""
    return np.asarray(np.arange(length // 2 + 1) * (rate_hz / length))


def _both_signs(power: Array, length: int) -> None:
    """Double a power (..., F) where a line has two signs, in place."""
    stop = -1 if length % 2 == 0 else None
    power[..., 1:stop] *= 2.0


def correlated(a: Array, b: Array) -> Array:
    """Correlate two signals by Fourier transforms.

    Parameters
    ----------
    a, b : Array
        (N,) and (M,).

    Returns
    -------
    Array
        (N + M - 1,), sums of a[i + k] b[i] for the shifts k from 1 - M on.
    """
    count = len(a) + len(b) - 1
    size = fast_length(count)
    product = rfft(np.asarray(a, dtype=np.float64), size) * rfft(b[::-1], size)
    return np.asarray(irfft(product, size)[:count])


def without_line(rows: Array) -> Array:
    """Return signals in rows (c, N), each without the straight line through it."""
    at = np.arange(rows.shape[1]) - 0.5 * (rows.shape[1] - 1)
    level = rows.mean(axis=1, keepdims=True)
    slope = (rows @ at / (at @ at))[:, None] if len(at) > 1 else 0.0
    return np.asarray(rows - level - slope * at)
