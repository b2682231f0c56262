"""The low-pass: its response, its blocks, and thinning that commutes with it."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfreqz

from seqid_cli.motion.filters.butterworth import ORDER, SHORTEST, Lowpass, impulse_response
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.typing import Array, Mask


def recursive(values: Array, cutoff_hz: float, rate_hz: float, valid: Mask | None = None) -> Array:
    """The same filter by scipy's recursion, sample by sample, with long numbers."""
    _, poles, _ = butter(4, cutoff_hz, fs=rate_hz, output="zpk")
    lowpass = Lowpass(cutoff_hz, rate_hz)
    found = values.astype(np.longdouble)
    for start, stop in runs(valid, len(values)):
        if stop - start > SHORTEST:
            x, reach = found[start:stop], 2 * lowpass.memory
            x = np.pad(x, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
            for _ in range(2):
                x = one_way(x, poles[poles.imag > 0])[::-1]
            found[start:stop] = x[reach : len(x) - reach]
    return found.astype(np.float64)


def one_way(x: NDArray[np.longdouble], poles: NDArray[np.complex128]) -> NDArray[np.longdouble]:
    """One pass through sections with double zeros at the Nyquist rate, from rest at the first x."""
    for p in poles.astype(np.clongdouble):
        a1, a2 = -2 * p.real, p.real**2 + p.imag**2
        b = (1 + a1 + a2) / 4
        sos = np.array([[b, 2 * b, b, 1.0, a1, a2]], dtype=np.longdouble)
        rest = np.array([1 - b, b - a2], dtype=np.longdouble)
        x, _ = sosfilt(sos, x, axis=0, zi=rest[None, :, None] * x[:1])
    return x


def walk(rng: np.random.Generator, samples: int, channels: int) -> Array:
    """Drifting signals with noise, as positions and torques are."""
    return np.asarray(np.cumsum(rng.normal(size=(samples, channels)), axis=0))


def with_gaps(samples: int) -> Mask:
    """Runs of many lengths, some too short to filter."""
    valid = np.ones(samples, dtype=bool)
    for start, stop in ((100, 107), (112, 118), (140, 141), (900, 1300), (samples - 5, samples)):
        valid[start:stop] = False
    return valid


@pytest.mark.parametrize(
    ("cutoff_hz", "rate_hz"),
    [
        (20.0, 1000.0),
        (6.0, 1000.0),
        (3.0, 1000.0),
        (2.0, 1000.0),
        (0.3, 1000.0),
        (80.0, 1000.0),
        (44.0, 100.0),
        (10.0, 125.0),
    ],
)
@pytest.mark.parametrize("gaps", [False, True])
def test_it_is_the_global_filter(cutoff_hz: float, rate_hz: float, *, gaps: bool) -> None:
    rng = np.random.default_rng(1)
    values = walk(rng, 5003, 3)
    valid = with_gaps(5003) if gaps else None
    expected = recursive(values, cutoff_hz, rate_hz, valid)
    found = Lowpass(cutoff_hz, rate_hz)(values, valid)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(values).max()


@pytest.mark.parametrize("samples", [1, 8, 9, 31, 32, 33, 511, 512, 513, 20_000])
def test_any_length_will_do(samples: int) -> None:
    rng = np.random.default_rng(2)
    values = walk(rng, samples, 2)
    expected = recursive(values, 15.0, 500.0)
    found = Lowpass(15.0, 500.0)(values)
    assert np.abs(found - expected).max() < 1e-12 * max(1.0, float(np.abs(values).max()))


def test_a_chosen_few_are_filtered_and_the_others_stay() -> None:
    rng = np.random.default_rng(4)
    rows = np.ascontiguousarray(walk(rng, 3_000, 5).T)
    lowpass, only = Lowpass(15.0, 500.0), np.array([1, 4])
    every, some = rows.copy(), rows.copy()
    lowpass.filter_rows(every)
    lowpass.filter_rows(some, only=only)
    np.testing.assert_allclose(some[only], every[only], rtol=0, atol=1e-12 * np.abs(rows).max())
    np.testing.assert_array_equal(some[[0, 2, 3]], rows[[0, 2, 3]])


@pytest.mark.parametrize("cutoff_hz", [8.0, 40.0, 200.0])
def test_what_lies_beyond_its_memory_does_not_matter(cutoff_hz: float) -> None:
    rng = np.random.default_rng(5)
    lowpass = Lowpass(cutoff_hz, 1000.0)
    reach = lowpass.memory
    values = walk(rng, 4 * reach + 2000, 2)
    whole = lowpass(values)
    low, high = reach + 500, len(values) - reach - 700
    part = lowpass(values[low - reach : high + reach])
    error = np.abs(part[reach:-reach] - whole[low:high]).max()
    assert error < 1e-12 * np.abs(values).max()


def test_a_cutoff_near_the_nyquist_rate_filters_nothing() -> None:
    values = walk(np.random.default_rng(6), 300, 1)
    lowpass = Lowpass(49.0, 100.0)
    assert lowpass.memory == 0
    np.testing.assert_array_equal(lowpass(values), values)


@pytest.mark.parametrize("samples", [12, 300, 5003])
@pytest.mark.parametrize("every", [1, 3, 4])
def test_passes_at_once_are_passes_one_by_one(samples: int, every: int) -> None:
    values = walk(np.random.default_rng(4), samples, 2)
    valid = np.ones(samples, dtype=bool)
    valid[samples // 2 : samples // 2 + 2] = False
    lowpass = Lowpass(10.0, 250.0)
    expected = lowpass(lowpass(values, valid), valid)[::every]
    found = lowpass(values, valid, times=2, every=every)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(values).max())


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


RATE = 500.0
MASKS = st.lists(st.booleans(), max_size=60).map(lambda bits: np.array(bits, dtype=bool))


@pytest.mark.parametrize("length", range(1, 14))
def test_short_runs_are_survived(length: int) -> None:
    x = np.linspace(0.0, 1.0, length)[:, None] * np.array([1.0, 2.0])
    assert Lowpass(10.0, RATE)(x).shape == x.shape
    first, second = differentiate(x, RATE)
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()


@pytest.mark.parametrize("degree", range(9))
def test_derivatives_of_polynomials_are_exact_inside(degree: int) -> None:
    t = np.linspace(-1, 1, 81)
    rate = 1 / (t[1] - t[0])
    p = np.polynomial.Polynomial(np.random.default_rng(degree).standard_normal(degree + 1))
    first, second = differentiate(p(t), rate)
    inner = slice(4, -4)
    np.testing.assert_allclose(first[inner], p.deriv()(t)[inner], atol=1e-9)
    np.testing.assert_allclose(second[inner], p.deriv(2)(t)[inner], atol=1e-8)


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
