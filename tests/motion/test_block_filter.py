"""The low-pass by blocks against the recursive one, and what it remembers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.motion.block_filter import REACH, STEP, BlockLowpass
from seqid_cli.motion.filtering import Lowpass

Array = NDArray[np.float64]


def walk(rng: np.random.Generator, samples: int, channels: int) -> Array:
    """Drifting signals with noise, as positions and torques are."""
    return np.asarray(np.cumsum(rng.normal(size=(samples, channels)), axis=0))


def with_gaps(samples: int) -> NDArray[np.bool_]:
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
    expected = Lowpass(cutoff_hz, rate_hz)(values, valid)
    found = BlockLowpass(cutoff_hz, rate_hz)(values, valid)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(values).max()


@pytest.mark.parametrize("samples", [1, 8, 9, 31, 32, 33, 511, 512, 513, 20_000])
def test_any_length_will_do(samples: int) -> None:
    rng = np.random.default_rng(2)
    values = walk(rng, samples, 2)
    expected = Lowpass(15.0, 500.0)(values)
    found = BlockLowpass(15.0, 500.0)(values)
    assert np.abs(found - expected).max() < 1e-12 * max(1.0, float(np.abs(values).max()))


def test_more_signals_than_one_tile_holds() -> None:
    rng = np.random.default_rng(3)
    values = walk(rng, 9_000, 40)
    expected = Lowpass(15.0, 500.0)(values)
    found = BlockLowpass(15.0, 500.0)(values)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(values).max()


def test_a_chosen_few_are_filtered_and_the_others_stay() -> None:
    rng = np.random.default_rng(4)
    rows = np.ascontiguousarray(walk(rng, 3_000, 5).T)
    lowpass, only = BlockLowpass(15.0, 500.0), np.array([1, 4])
    every, some = rows.copy(), rows.copy()
    lowpass.filter_rows(every)
    lowpass.filter_rows(some, only=only)
    np.testing.assert_allclose(some[only], every[only], rtol=0, atol=1e-12 * np.abs(rows).max())
    np.testing.assert_array_equal(some[[0, 2, 3]], rows[[0, 2, 3]])


@pytest.mark.parametrize("cutoff_hz", [8.0, 40.0, 200.0])
def test_what_lies_beyond_its_memory_does_not_matter(cutoff_hz: float) -> None:
    rng = np.random.default_rng(5)
    lowpass = BlockLowpass(cutoff_hz, 1000.0)
    reach = lowpass.memory + REACH
    values = walk(rng, 4 * reach + 2000, 2)
    whole = lowpass(values)
    low, high = reach + 500, len(values) - reach - 700
    part = lowpass(values[low - reach : high + reach])
    error = np.abs(part[reach:-reach] - whole[low:high]).max()
    assert error < 1e-12 * np.abs(values).max()


def test_a_cutoff_near_the_nyquist_rate_filters_nothing() -> None:
    values = walk(np.random.default_rng(6), 300, 1)
    lowpass = BlockLowpass(49.0, 100.0)
    assert lowpass.memory == 0
    np.testing.assert_array_equal(lowpass(values), values)


def gone_on(lowpass: BlockLowpass, rows: Array, part: int, reach: int) -> Array:
    """Signals 0, 2, 3 and 4 from `reach` on, filtered part by part; what is behind stays."""
    only, found = np.array([0, 2, 3, 4]), rows.copy()
    states = lowpass.state_behind(rows[only, :reach])
    start = reach
    while start + part + reach <= rows.shape[1]:
        room = found[:, start : start + part + reach].copy()
        known = room.shape[1]
        lowpass.filter_on(room, known, part, states, only=only)
        found[:, start : start + part + reach] = room
        start += part
    np.testing.assert_array_equal(found[:, start:], rows[:, start:])
    np.testing.assert_array_equal(found[1], rows[1])
    return found[:, reach:start]


@pytest.mark.parametrize("cutoff_hz", [6.0, 40.0, 200.0])
def test_signals_that_go_on_are_filtered_part_by_part(cutoff_hz: float) -> None:
    lowpass = BlockLowpass(cutoff_hz, 1000.0)
    assert lowpass.can_go_on()
    reach = lowpass.memory + REACH
    rows = np.ascontiguousarray(walk(np.random.default_rng(8), 3 * reach + 4_000, 5).T)
    expected = lowpass(rows.T).T
    found = gone_on(lowpass, rows, 10 * STEP, reach)
    assert found.shape[1] >= 3_000
    expected = expected[:, reach : reach + found.shape[1]]
    expected[1] = found[1]
    assert np.abs(found - expected).max() < 1e-12 * np.abs(rows).max()


def test_only_what_is_exact_goes_on() -> None:
    assert not BlockLowpass(49.0, 100.0).can_go_on()
    assert not BlockLowpass(1.0, 1000.0).can_go_on()
