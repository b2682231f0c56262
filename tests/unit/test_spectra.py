"""Spectra and correlations are those of `scipy.signal`."""

import numpy as np
import pytest
from scipy import fft, signal

from seqid_cli import spectra

RATE_HZ = 250.0
RNG = np.random.default_rng(7)
WANDERING = np.cumsum(RNG.normal(size=(4000, 3)), axis=0)
SHORT = RNG.normal(size=777)
CLOSE = 1e-12


@pytest.mark.parametrize("length", [512, 513, 1000])
@pytest.mark.parametrize(("centred", "detrend"), [(True, "constant"), (False, False)])
def test_density_is_welchs(length: int, centred: bool, detrend: str | bool) -> None:
    found = spectra.welch(WANDERING, RATE_HZ, length, centred=centred)
    expected = signal.welch(
        WANDERING,
        RATE_HZ,
        nperseg=length,
        detrend=detrend,  # type: ignore[arg-type]
        axis=0,
    )
    np.testing.assert_allclose(found[0], expected[0], rtol=CLOSE)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-9)


def test_power_of_lines_is_that_of_the_periodogram() -> None:
    length = 4 * len(SHORT)
    found = spectra.line_power(SHORT, RATE_HZ, length)
    expected = signal.periodogram(SHORT, RATE_HZ, "hann", length, scaling="spectrum")
    np.testing.assert_allclose(found[0], expected[0], rtol=CLOSE)
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=CLOSE)


@pytest.mark.parametrize("other", [SHORT, SHORT[:50], np.ones(9)])
def test_correlation_is_the_direct_one(other: np.ndarray) -> None:
    found = spectra.correlated(SHORT > 0.0, other)
    expected = np.correlate((SHORT > 0.0).astype(float), other, mode="full")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_no_line_is_left() -> None:
    rows = WANDERING[:64].T
    expected = signal.detrend(rows, axis=1)
    found = spectra.without_line(rows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_fast_lengths_are_those_of_scipy() -> None:
    for least in (*range(1, 2000), 12345, 99_999, 1_000_001):
        assert spectra.fast_length(least) == fft.next_fast_len(least, real=True)
