"""Both ways are a Butterworth filter's, and thinned samples see that of the full rate."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfreqz

from seqid_cli.motion.filters.butterworth import ORDER, Lowpass, impulse_response
from seqid_cli.typing import Array

RATE_HZ = 1000.0


def gain(lowpass: Lowpass, frequency: Array) -> Array:
    """Of both ways."""
    h, reach = impulse_response(lowpass), lowpass.memory
    angle = 2 * np.pi / lowpass.rate_hz * np.outer(frequency, np.arange(reach + 1))
    return np.asarray(2 * np.cos(angle) @ h[reach:] - h[reach])


def usual(cutoff_hz: float, frequency: Array, rate_hz: float) -> Array:
    """Of both ways of scipy's Butterworth filter."""
    sections = butter(ORDER, cutoff_hz, fs=rate_hz, output="sos")
    return np.abs(sosfreqz(sections, frequency, fs=rate_hz)[1]) ** 2


@settings(deadline=None)
@given(st.floats(1e-3, 0.44))
def test_both_ways_are_a_butterworth_filters(share: float) -> None:
    cutoff = share * RATE_HZ
    frequency = np.concatenate([np.geomspace(0.01 * cutoff, 0.49 * RATE_HZ, 200), [0.0]])
    found = gain(Lowpass(cutoff, RATE_HZ), frequency)
    np.testing.assert_allclose(found, usual(cutoff, frequency, RATE_HZ), atol=1e-10)


@settings(deadline=None)  # the transforms of low cut-offs are long
@given(st.integers(2, 300), st.floats(10.0, 100.0))
def test_the_response_is_that_of_the_full_rate(every: int, per_cutoff: float) -> None:
    cutoff = RATE_HZ / every / per_cutoff
    frequency = np.linspace(0.0, RATE_HZ / every / 2, 200)
    found = gain(Lowpass(cutoff, RATE_HZ / every, every), frequency)
    np.testing.assert_allclose(found, usual(cutoff, frequency, RATE_HZ), atol=4e-6)


def test_filtering_and_thinning_commute() -> None:
    """Terms of thinned motion, filtered, are those of the full motion, filtered and thinned."""
    every, cutoff = 20, 5.0
    t = np.arange(40_000) / RATE_HZ
    values = np.stack([np.sin(9.0 * t), np.cos(25.0 * t + 1.0) + 0.3 * np.sin(31.0 * t)], axis=1)
    full = Lowpass(cutoff, RATE_HZ)(values)[::every]
    thinned = Lowpass(cutoff, RATE_HZ / every, every)(values[::every])
    inner = slice(150, -150)
    np.testing.assert_allclose(thinned[inner], full[inner], atol=1e-5)
    other = Lowpass(cutoff, RATE_HZ / every)(values[::every])
    assert np.abs(other - full)[inner].max() > 1e-3  # another filter
