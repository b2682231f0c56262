"""The low-pass has no delay, runs do not leak, derivatives are what they say they are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.typing import Array, Mask

RATE = 500.0
MASKS = st.lists(st.booleans(), max_size=60).map(lambda bits: np.array(bits, dtype=bool))


def band_limited(rng: np.random.Generator, samples: int, top_hz: float) -> Array:
    """Smooth noise of unit size below `top_hz`."""
    t = np.arange(samples) / RATE
    frequency = rng.uniform(0.2, top_hz, 12)
    phase = rng.uniform(0, 2 * np.pi, 12)
    return np.asarray(np.sin(2 * np.pi * np.outer(t, frequency) + phase).sum(axis=1) / np.sqrt(6))


@pytest.mark.parametrize("frequency", [0.5, 2.0, 8.0, 12.0, 20.0])
def test_a_sine_keeps_its_phase_and_has_the_squared_butterworth_gain(frequency: float) -> None:
    cutoff = 10.0
    t = np.arange(5000) / RATE
    inner = slice(1000, 4000)
    y = Lowpass(cutoff, RATE)(np.sin(2 * np.pi * frequency * t))[inner]
    angle = 2 * np.pi * frequency * t[inner]
    in_phase, across = np.linalg.lstsq(
        np.column_stack([np.sin(angle), np.cos(angle)]), y, rcond=None
    )[0]
    warped = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * cutoff / RATE)
    assert in_phase == pytest.approx(1 / (1 + warped**8), rel=1e-6)
    assert abs(across) < 1e-6 * in_phase


def test_constants_and_ramps_pass_up_to_the_ends() -> None:
    t = np.arange(800) / RATE
    values = np.column_stack([np.full_like(t, 3.0), 1.0 - 2.0 * t])
    # The ramp's transient has decayed over the padding, not vanished.
    np.testing.assert_allclose(Lowpass(10.0, RATE)(values), values, atol=1e-5)


def test_reversed_time_gives_reversed_results() -> None:
    x = np.random.default_rng(0).standard_normal((600, 2))
    lowpass = Lowpass(12.0, RATE)
    middle = slice(150, 450)
    np.testing.assert_allclose(lowpass(x[::-1])[::-1][middle], lowpass(x)[middle], atol=1e-9)


def test_the_filter_is_linear() -> None:
    x, y = np.random.default_rng(1).standard_normal((2, 400, 3))
    lowpass = Lowpass(25.0, RATE)
    np.testing.assert_allclose(
        lowpass(2.0 * x - 0.3 * y), 2.0 * lowpass(x) - 0.3 * lowpass(y), atol=1e-12
    )


def test_too_high_a_cutoff_leaves_the_values_alone() -> None:
    x = np.random.default_rng(2).standard_normal(100)
    lowpass = Lowpass(300.0, RATE)
    result = lowpass(x)
    assert not lowpass.active
    np.testing.assert_array_equal(result, x)
    assert result is not x


def test_runs_do_not_leak_into_each_other() -> None:
    rng = np.random.default_rng(3)
    x = rng.standard_normal((500, 2))
    valid = np.ones(500, dtype=bool)
    valid[[0, 200, 201, 202, 350]] = False
    lowpass = Lowpass(15.0, RATE)
    changed = x.copy()
    changed[~valid] = 1e6
    changed[203:350] += 100.0
    before, after = lowpass(x, valid), lowpass(changed, valid)
    for kept in (slice(1, 200), slice(351, 500)):
        np.testing.assert_array_equal(before[kept], after[kept])
    np.testing.assert_allclose(after[203:350], before[203:350] + 100.0, atol=1e-9)
    np.testing.assert_array_equal(after[~valid], changed[~valid])


def test_each_run_is_filtered_as_if_it_were_alone() -> None:
    x = np.random.default_rng(4).standard_normal(700)
    valid = np.ones(700, dtype=bool)
    valid[300] = False
    lowpass = Lowpass(15.0, RATE)
    y = lowpass(x, valid)
    np.testing.assert_array_equal(y[:300], lowpass(x[:300]))
    np.testing.assert_array_equal(y[301:], lowpass(x[301:]))


@pytest.mark.parametrize("cutoff", [3.0, 10.0, 40.0])
def test_beyond_twice_the_settling_a_cut_is_not_felt(cutoff: float) -> None:
    rng = np.random.default_rng(5)
    long = band_limited(rng, 6000, 0.6 * cutoff) + 0.1 * rng.standard_normal(6000)
    lowpass = Lowpass(cutoff, RATE)
    cut = slice(2000, 4000)
    away = slice(2 * lowpass.settling, 2000 - 2 * lowpass.settling)
    off = np.abs(lowpass(long[cut]) - lowpass(long)[cut])[away]
    assert off.max() < 0.01  # of a signal of unit size


@pytest.mark.parametrize("length", range(1, 14))
def test_short_runs_are_survived(length: int) -> None:
    x = np.linspace(0.0, 1.0, length)[:, None] * np.array([1.0, 2.0])
    assert Lowpass(10.0, RATE)(x).shape == x.shape
    first, second = differentiate(x, RATE)
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()


def test_derivatives_err_by_less_than_a_thousandth_up_to_a_tenth_of_the_rate() -> None:
    t = np.arange(4000) / RATE
    for share in (0.002, 0.02, 0.05, 0.1):
        w = 2 * np.pi * share * RATE
        first, second = differentiate(np.sin(w * t), RATE)
        inner = slice(10, -10)
        assert np.abs(first - w * np.cos(w * t))[inner].max() < 1e-3 * w
        assert np.abs(second + w**2 * np.sin(w * t))[inner].max() < 1e-3 * w**2


@pytest.mark.parametrize("degree", range(9))
def test_derivatives_of_polynomials_are_exact_inside(degree: int) -> None:
    t = np.linspace(-1, 1, 81)
    rate = 1 / (t[1] - t[0])
    p = np.polynomial.Polynomial(np.random.default_rng(degree).standard_normal(degree + 1))
    first, second = differentiate(p(t), rate)
    inner = slice(4, -4)
    np.testing.assert_allclose(first[inner], p.deriv()(t)[inner], atol=1e-9)
    np.testing.assert_allclose(second[inner], p.deriv(2)(t)[inner], atol=1e-8)


def test_a_ramp_has_its_slope_up_to_the_ends() -> None:
    ramp = np.asarray(3.0 * np.arange(30) / RATE, dtype=np.float64)
    first, second = differentiate(ramp, RATE)
    np.testing.assert_allclose(first, 3.0, rtol=1e-12)
    np.testing.assert_allclose(second, 0.0, atol=1e-8)


def test_derivatives_do_not_reach_across_a_gap() -> None:
    t = np.arange(200) / RATE
    x = np.sin(20 * t)
    jump = x.copy()
    jump[100:] += 50.0
    valid = np.ones(200, dtype=bool)
    valid[100] = False
    for plain, jumped in zip(
        differentiate(x, RATE, valid), differentiate(jump, RATE, valid), strict=True
    ):
        np.testing.assert_allclose(jumped, plain, atol=1e-6)
        assert jumped[100] == 0.0


@given(MASKS)
def test_runs_are_the_true_samples_in_order(mask: Mask) -> None:
    found = runs(mask, len(mask))
    covered = [i for start, stop in found for i in range(start, stop)]
    assert covered == np.flatnonzero(mask).tolist()
    assert all(a < b for a, b in found)
    assert all(b < c for (_, b), (c, _) in pairwise(found))


@given(MASKS, st.integers(0, 8))
def test_shrink_keeps_what_has_enough_true_samples_on_both_sides(mask: Mask, k: int) -> None:
    wide = np.concatenate([np.zeros(k, dtype=bool), mask, np.zeros(k, dtype=bool)])
    expected = [bool(wide[i : i + 2 * k + 1].all()) for i in range(len(mask))]
    assert shrink(mask, k).tolist() == expected


def test_no_mask_is_one_run() -> None:
    assert runs(None, 7) == [(0, 7)]
