"""Derivatives and shrunk masks are those of `scipy.ndimage`."""

import numpy as np
import pytest
from scipy import ndimage

from seqid_cli.motion.filters.differentiation import (
    FIRST,
    SECOND,
    SIDE,
    differentiate,
    shrink,
)

RNG = np.random.default_rng(3)
RATE_HZ = 125.0


@pytest.mark.parametrize("samples", [0, 1, 4, 40, 500])
def test_shrink_is_the_smallest_value_around(samples: int) -> None:
    mask = RNG.random(300) > 0.03
    expected = ndimage.minimum_filter1d(
        mask.astype(np.uint8), 2 * samples + 1, mode="constant"
    )
    np.testing.assert_array_equal(shrink(mask, samples), expected > 0)


def test_derivatives_are_correlations() -> None:
    values = np.cumsum(RNG.normal(size=(200, 2)), axis=0)
    margins = [(SIDE, SIDE), (0, 0)]
    wide = np.pad(values, margins, mode="reflect", reflect_type="odd")
    first, second = differentiate(values, RATE_HZ)
    inner = slice(SIDE, -SIDE)
    expected = ndimage.correlate1d(wide, FIRST * RATE_HZ, axis=0)[inner]
    np.testing.assert_allclose(first, expected, rtol=0, atol=1e-10)
    expected = ndimage.correlate1d(wide, SECOND * RATE_HZ**2, axis=0)[inner]
    np.testing.assert_allclose(second, expected, rtol=0, atol=1e-7)
