"""One pass is a Butterworth filter, and thinned samples see that of the full rate."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfreqz

from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.design import ORDER, StateSpace, one_pass
from seqid_cli.typing import Array

RATE_HZ = 1000.0


def gain(space: StateSpace, frequency: Array, rate_hz: float) -> Array:
    """Of both ways."""
    z = np.exp(2j * np.pi * frequency / rate_hz)[:, None, None]
    states = np.linalg.solve(z * np.eye(len(space.A)) - space.A, space.B[:, None])[:, :, 0]
    return np.abs(states @ space.C + space.D) ** 2


def usual(cutoff_hz: float, frequency: Array, rate_hz: float) -> Array:
    """Of both ways of scipy's Butterworth filter."""
    sections = butter(ORDER, cutoff_hz, fs=rate_hz, output="sos")
    return np.abs(sosfreqz(sections, frequency, fs=rate_hz)[1]) ** 2


@given(st.floats(1e-3, 0.44))
def test_one_pass_is_a_butterworth_filter(share: float) -> None:
    cutoff = share * RATE_HZ
    frequency = np.concatenate([np.geomspace(0.01 * cutoff, 0.49 * RATE_HZ, 200), [0.0]])
    found = gain(one_pass(cutoff, RATE_HZ), frequency, RATE_HZ)
    np.testing.assert_allclose(found, usual(cutoff, frequency, RATE_HZ), atol=1e-10)


@given(st.integers(2, 300), st.floats(10.0, 1000.0))
def test_the_response_is_that_of_the_full_rate(every: int, per_cutoff: float) -> None:
    cutoff = RATE_HZ / every / per_cutoff
    frequency = np.linspace(0.0, RATE_HZ / every / 2, 200)
    found = gain(one_pass(cutoff, RATE_HZ / every, every), frequency, RATE_HZ / every)
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
