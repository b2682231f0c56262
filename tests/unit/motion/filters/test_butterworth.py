"""The low-pass by convolution against the recursive one, and what it remembers."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from seqid_cli.motion.filters.butterworth import SHORTEST, Lowpass
from seqid_cli.motion.filters.differentiation import runs
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
