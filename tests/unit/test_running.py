"""Running extremes, means and medians are those of `scipy.ndimage`."""

import numpy as np
import pytest
from scipy import ndimage

from seqid_cli import running

RNG = np.random.default_rng(5)
SIGNALS = {count: RNG.normal(size=(count, 3)) for count in (1, 2, 7, 400)}
WIDTHS = (1, 2, 3, 4, 5, 10, 25, 64, 121)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("count", SIGNALS)
def test_extremes_are_those_of_ndimage(count: int, width: int) -> None:
    signals = SIGNALS[count]
    smallest = ndimage.minimum_filter1d(signals, width, axis=0)
    largest = ndimage.maximum_filter1d(signals, width, axis=0)
    np.testing.assert_array_equal(running.running_min(signals, width), smallest)
    np.testing.assert_array_equal(running.running_max(signals, width), largest)


@pytest.mark.parametrize("reach", WIDTHS)
@pytest.mark.parametrize("count", SIGNALS)
def test_dilation_is_that_of_ndimage(count: int, reach: int) -> None:
    mask = SIGNALS[count] > 1.5
    window = np.ones((2 * reach + 1, 1), dtype=bool)
    expected = ndimage.binary_dilation(mask, window)
    np.testing.assert_array_equal(running.dilated(mask, reach), expected)


@pytest.mark.parametrize(
    ("beyond", "mode"), [("symmetric", "reflect"), ("edge", "nearest")]
)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("count", SIGNALS)
def test_means_are_those_of_ndimage(
    count: int, width: int, beyond: running.Beyond, mode: str
) -> None:
    signals = SIGNALS[count]
    expected = ndimage.uniform_filter1d(signals, width, axis=0, mode=mode)  # type: ignore[call-overload]
    found = running.running_mean(signals, width, beyond=beyond)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("count", SIGNALS)
def test_medians_of_five_are_those_of_ndimage(count: int) -> None:
    signals = SIGNALS[count]
    by_edge = ndimage.median_filter(signals, (5, 1), mode="nearest")
    by_wrap = ndimage.median_filter(signals, (5, 1), mode="wrap")
    found = running.median_of_five(signals, beyond="edge")
    np.testing.assert_array_equal(found, by_edge)
    found = running.median_of_five(signals, beyond="wrap")
    np.testing.assert_array_equal(found, by_wrap)


def test_nothing_has_no_extremes() -> None:
    assert running.running_min(np.zeros((0, 2)), 5).shape == (0, 2)
