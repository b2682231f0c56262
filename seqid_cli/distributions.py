"""Normal, Student's and gamma distributions, as `scipy.special` has them.

That package takes longer to import than a command needs for a log of some minutes. What
is used of it takes a few lines.
"""

import math
from statistics import NormalDist

import numpy as np

from seqid_cli.typing import Array

STANDARD_NORMAL = NormalDist()
ASYMPTOTIC = 12  # from which the series of digamma and trigamma are exact to 1e-15


def normal_quantile(probability: float) -> float:
    """Return what a standard normal value is below with a probability."""
    return STANDARD_NORMAL.inv_cdf(probability)


def normal_probability(values: Array) -> Array:
    """Return the probabilities (...) that a standard normal value is below (...)."""
    flat = (-math.sqrt(0.5) * values).ravel().tolist()
    tails = np.fromiter(map(math.erfc, flat), dtype=np.float64, count=len(flat))
    return np.asarray(0.5 * tails.reshape(values.shape))


def student_quantile(freedom: int, probability: float) -> float:
    """Return what Student's t is below with a probability, by bisection.

    Parameters
    ----------
    freedom : int
        Degrees of freedom, 1 or more.
    probability : float
        Between 0 and 1.
    """
    if probability < 0.5:
        return -student_quantile(freedom, 1.0 - probability)
    # t is sqrt(freedom) times the tangent of an angle.
    low = 0.0
    high = 0.5 * math.pi
    middle = 0.5 * high
    while low < middle < high:
        if _within(freedom, middle) < 2.0 * probability - 1.0:
            low = middle
        else:
            high = middle
        middle = 0.5 * (low + high)
    return math.sqrt(freedom) * math.tan(middle)


def _within(freedom: int, angle: float) -> float:
    """Return the probability that |t| is below sqrt(freedom) tan(angle).

    M. Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 26.7.3 and 26.7.4.
    """
    cosine = math.cos(angle)
    is_odd = freedom % 2
    term = cosine if is_odd else 1.0
    total = 0.0
    for power in range(is_odd, freedom - 1, 2):
        total += term
        term *= cosine**2 * (power + 1) / (power + 2)
    total *= math.sin(angle)
    return 2.0 / math.pi * (angle + total) if is_odd else total


def digamma(values: Array) -> Array:
    """Return the derivative (...) of the logarithm of gamma at values (...) above 0."""
    steps = np.arange(ASYMPTOTIC)
    before = (1.0 / (values[..., None] + steps)).sum(axis=-1)
    x = values + ASYMPTOTIC
    s = x**-2.0
    series = s * (1 / 12 - s * (1 / 120 - s * (1 / 252 - s * (1 / 240 - s / 132))))
    return np.asarray(np.log(x) - 0.5 / x - series - before)


def trigamma(values: Array) -> Array:
    """Return the derivative (...) of digamma at values (...) above 0."""
    steps = np.arange(ASYMPTOTIC)
    before = ((values[..., None] + steps) ** -2.0).sum(axis=-1)
    x = values + ASYMPTOTIC
    s = x**-2.0
    series = s * (1 / 6 - s * (1 / 30 - s * (1 / 42 - s * (1 / 30 - s * 5 / 66))))
    return np.asarray((1.0 + 0.5 / x + series) / x + before)
