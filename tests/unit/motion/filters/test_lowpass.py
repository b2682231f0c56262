"""The low-pass has no delay, runs do not leak, derivatives are what they say they are."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.typing import Mask

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
