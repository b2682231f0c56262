"""The low-pass: its response, its blocks, and thinning that commutes with it;
derivatives.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, fftconvolve, sosfreqz

from seqid_cli.motion.filters.butterworth import (
    ORDER,
    SHORTEST,
    Lowpass,
    impulse_response,
    single,
)
from seqid_cli.motion.filters.differentiation import differentiate, runs
from seqid_cli.typing import Array, Mask

RATE = 500.0


def convolved(values: Array, lowpass: Lowpass, valid: Mask | None = None) -> Array:
    """The same filter at once on each whole run, prolonged by point reflections at its
    ends.
    """
    filtered = values.copy()
    reach = lowpass.memory
    around = ((reach, reach), (0, 0))
    h = impulse_response(lowpass)[:, None]
    for start, stop in runs(valid, len(values)):
        if stop - start > SHORTEST:
            wide = np.pad(
                values[start:stop], around, mode="reflect", reflect_type="odd"
            )
            filtered[start:stop] = fftconvolve(wide, h, mode="valid", axes=0)
    return filtered


def walk(samples: int, channels: int = 2) -> Array:
    """Drifting signals with noise, as positions and torques are."""
    return np.cumsum(
        np.random.default_rng(samples).normal(size=(samples, channels)), axis=0
    )


def with_gaps(samples: int) -> Mask:
    """Runs of many lengths, some too short to filter."""
    valid = np.ones(samples, dtype=bool)
    for start, stop in (
        (100, 107),
        (112, 118),
        (140, 141),
        (900, 1300),
        (samples - 5, samples),
    ):
        valid[start:stop] = False
    return valid


SHARES = [(20.0, 1000.0), (6.0, 1000.0), (0.3, 1000.0), (80.0, 1000.0), (44.0, 100.0)]
LENGTHS = (1, 8, 9, 31, 32, 33, 511, 512, 513, 20_000)


@pytest.mark.parametrize(
    ("cutoff_hz", "rate_hz", "samples", "gaps"),
    [
        *((*share, 5003, gaps) for share in SHARES for gaps in (False, True)),
        *((15.0, 500.0, samples, False) for samples in LENGTHS),
    ],
)
def test_it_filters_each_run(
    cutoff_hz: float, rate_hz: float, samples: int, *, gaps: bool
) -> None:
    values = walk(samples, 3)
    lowpass = Lowpass(cutoff_hz, rate_hz)
    valid = with_gaps(samples) if gaps else None
    filtered = lowpass(values, valid)
    error = np.abs(filtered - convolved(values, lowpass, valid)).max()
    assert error < 1e-12 * max(1.0, float(np.abs(values).max()))
    rows = values.T.copy()
    lowpass.filter_rows(rows, valid, only=np.array([0, 2]))
    np.testing.assert_allclose(rows[[0, 2]].T, filtered[:, [0, 2]], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(rows[1], values[:, 1])


def test_a_cutoff_near_the_nyquist_rate_filters_nothing() -> None:
    values = walk(300)
    lowpass = Lowpass(49.0, 100.0)
    assert lowpass.memory == 0
    np.testing.assert_array_equal(lowpass(values), values)


@pytest.mark.parametrize("samples", [12, 300, 5003])
@pytest.mark.parametrize("every", [1, 3, 4])
def test_passes_at_once_are_passes_one_by_one(samples: int, every: int) -> None:
    values = walk(samples)
    valid = np.ones(samples, dtype=bool)
    lowpass = Lowpass(10.0, 250.0)
    valid[samples // 2 : samples // 2 + 2] = False
    expected = lowpass(lowpass(values, valid), valid)[::every]
    filtered = lowpass(values, valid, times=2, every=every)
    np.testing.assert_allclose(filtered, expected, atol=1e-12 * np.abs(values).max())
    rough = lowpass(single(values), valid, times=2, every=every)
    assert rough.dtype == np.float32
    assert np.abs(rough - filtered).max() < 1e-6 * np.abs(values).max()


def assert_butterworth(lowpass: Lowpass, frequency: Array, atol: float) -> None:
    """The gain of both ways is that of scipy's filter at the full rate."""
    h = impulse_response(lowpass)
    reach = lowpass.memory
    angle = 2 * np.pi / lowpass.rate_hz * np.outer(frequency, np.arange(reach + 1))
    gain = 2 * np.cos(angle) @ h[reach:] - h[reach]
    sections = butter(ORDER, lowpass.cutoff_hz, fs=RATE, output="sos")
    usual = np.abs(sosfreqz(sections, frequency, fs=RATE)[1]) ** 2
    np.testing.assert_allclose(gain, usual, atol=atol)


@settings(deadline=None, max_examples=40)
@given(st.floats(1e-3, 0.44))
def test_both_ways_are_a_butterworth_filters(share: float) -> None:
    frequency = np.append(np.geomspace(0.01 * share, 0.49, 200), 0.0) * RATE
    assert_butterworth(Lowpass(share * RATE, RATE), frequency, 1e-10)


@settings(deadline=None, max_examples=40)  # the transforms of low cut-offs are long
@given(st.integers(2, 300), st.floats(10.0, 100.0))
def test_the_response_is_that_of_the_full_rate(every: int, per_cutoff: float) -> None:
    rate = RATE / every
    lowpass = Lowpass(rate / per_cutoff, rate, every)
    assert_butterworth(lowpass, np.linspace(0.0, rate / 2, 200), 4e-6)


@pytest.mark.parametrize("degree", range(9))
def test_derivatives_of_polynomials_are_exact_inside(degree: int) -> None:
    t = np.linspace(-1, 1, 81)
    p = np.polynomial.Polynomial(
        np.random.default_rng(degree).standard_normal(degree + 1)
    )
    first, second = differentiate(p(t), 1 / (t[1] - t[0]))
    inner = slice(4, -4)
    np.testing.assert_allclose(first[inner], p.deriv()(t)[inner], atol=1e-9)
    np.testing.assert_allclose(second[inner], p.deriv(2)(t)[inner], atol=1e-8)


def test_derivatives_do_not_reach_across_a_gap() -> None:
    x = np.sin(20 * np.arange(200) / RATE)
    valid = np.ones(200, dtype=bool)
    valid[100] = False
    jump = x + np.where(np.arange(200) >= 100, 50.0, 0.0)
    plain, jumped = (
        np.array(differentiate(values, RATE, valid)) for values in (x, jump)
    )
    np.testing.assert_allclose(jumped, plain, atol=1e-6)
    assert not jumped[:, 100].any()


@pytest.mark.parametrize("samples", [40, 900, 2000, 3100, 5000, 12000])
@pytest.mark.parametrize("every", [1, 4])
def test_pieces_of_any_length_give_the_same(samples: int, every: int) -> None:
    """A run is filtered alike whatever follows it, in pieces of its own or of a long
    log.
    """
    lowpass = Lowpass(27.0, RATE)
    x = np.random.default_rng(samples).standard_normal((30_000, 1))
    valid = np.arange(len(x)) != samples  # a run of so many samples, and a long one
    filtered = lowpass(x, valid, times=2, every=every)[: -(-samples // every)]
    for _ in range(2):
        x = convolved(x, lowpass, valid)
    np.testing.assert_allclose(filtered, x[:samples:every], atol=1e-11)
