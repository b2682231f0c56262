"""Distributions are those of `scipy.special`."""

import numpy as np
import pytest
from scipy import special

from seqid_cli import distributions

PROBABILITIES = (1e-9, 0.001, 0.025, 0.3, 0.5, 0.8, 0.975, 0.999, 1.0 - 1e-6)


@pytest.mark.parametrize("probability", PROBABILITIES)
def test_normal_quantile(probability: float) -> None:
    found = distributions.normal_quantile(probability)
    assert found == pytest.approx(float(special.ndtri(probability)), rel=1e-9)


def test_normal_probability() -> None:
    values = np.linspace(-30.0, 9.0, 400).reshape(4, 100)
    found = distributions.normal_probability(values)
    np.testing.assert_allclose(found, special.ndtr(values), rtol=1e-12)


@pytest.mark.parametrize("probability", PROBABILITIES[1:])
@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 9, 30, 1001])
def test_student_quantile(freedom: int, probability: float) -> None:
    found = distributions.student_quantile(freedom, probability)
    expected = float(special.stdtrit(freedom, probability))
    assert found == pytest.approx(expected, rel=1e-7, abs=1e-12)


def test_derivatives_of_the_logarithm_of_gamma() -> None:
    values = np.geomspace(1e-3, 1e5, 300)
    found = distributions.digamma(values)
    np.testing.assert_allclose(found, special.digamma(values), rtol=0, atol=1e-12)
    found = distributions.trigamma(values)
    np.testing.assert_allclose(found, special.polygamma(1, values), rtol=1e-12)
