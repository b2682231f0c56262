"""Thinned samples see the filter of the full rate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import butter, sosfreqz

from seqid_cli.motion.block_filter import BlockLowpass
from seqid_cli.motion.filtering import ORDER, Lowpass
from seqid_cli.motion.matched import thinned_sections

Array = NDArray[np.float64]

RATE_HZ = 1000.0


def gain(sections: Array, frequency: Array, rate_hz: float) -> Array:
    """Of both ways."""
    return np.abs(sosfreqz(sections, frequency, fs=rate_hz)[1]) ** 2


@given(st.integers(2, 300), st.floats(10.0, 1000.0))
def test_the_response_is_that_of_the_full_rate(every: int, per_cutoff: float) -> None:
    cutoff = RATE_HZ / every / per_cutoff
    frequency = np.linspace(0.0, RATE_HZ / every / 2, 200)
    full = gain(butter(ORDER, cutoff, fs=RATE_HZ, output="sos"), frequency, RATE_HZ)
    found = thinned_sections(ORDER, cutoff, RATE_HZ, every)
    assert found.shape == (ORDER // 2, 6)
    np.testing.assert_allclose(gain(found, frequency, RATE_HZ / every), full, atol=4e-6)


def test_the_poles_lie_inside_the_unit_circle() -> None:
    for section in thinned_sections(ORDER, 5.0, RATE_HZ, 20):
        assert np.abs(np.roots(section[3:])).max() < 1.0


@pytest.mark.parametrize("kind", [Lowpass, BlockLowpass])
def test_filtering_and_thinning_commute(kind: type[Lowpass]) -> None:
    """Terms of thinned motion, filtered, are those of the full motion, filtered and thinned."""
    every, cutoff = 20, 5.0
    t = np.arange(40_000) / RATE_HZ
    values = np.stack([np.sin(9.0 * t), np.cos(25.0 * t + 1.0) + 0.3 * np.sin(31.0 * t)], axis=1)
    full = Lowpass(cutoff, RATE_HZ)(values)[::every]
    thinned = kind(cutoff, RATE_HZ / every, every)(values[::every])
    inner = slice(150, -150)
    np.testing.assert_allclose(thinned[inner], full[inner], atol=1e-5)
    other = kind(cutoff, RATE_HZ / every)(values[::every])
    assert np.abs(other - full)[inner].max() > 1e-3  # another filter
