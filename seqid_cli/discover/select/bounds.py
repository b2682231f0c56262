"""Coefficients within their bounds, which count within the errors of a coefficient.

A truth at the edge of what is physical is estimated beyond the edge half of the time: a
gear that loses power only while it drives has a loss of -0.00002 while it is driven.
Refused for that, the right law leaves its place to a wrong one. So a coefficient beyond
a bound by no more than its error is at the bound, and the other coefficients of the
effect are what they are if it is there.

The error is that of the noise, and that of the law: what a column's torque beyond the
bound adds to the effect is negligible where it is a small share of the effect's largest
column.
"""

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.typing import Array

# of its error, by which a coefficient may be beyond a bound: 95 % of truths at the
# bound are estimated nearer
BOUND_ERRORS = 2.0


def within_bounds(
    candidate: Candidate,
    coefficients: Array,
    covariance: Array,
    precision: Array,
    *,
    negligible_share: float,
) -> Array:
    """Move coefficients to bounds that they exceed by no more than their errors.

    Parameters
    ----------
    candidate : Candidate
        The effect and its settings.
    coefficients, covariance : (k,) and (k, k) arrays
        Of its columns, by the fit.
    precision : (k, k) array
        Inverse covariance beforehand, by which columns are of one size.
    negligible_share : float
        Share of the effect's largest column that its law does not tell.

    Returns
    -------
    (k,) array
        What is beyond a bound by more than that stays where it is.
    """
    specs = candidate.effect.coefficients(candidate.settings)
    pairs = zip(specs, coefficients, strict=True)
    if all(spec.low <= value <= spec.high for spec, value in pairs):
        return np.array(coefficients, dtype=float)  # most of the time

    low = np.array([spec.low for spec in specs])
    high = np.array([spec.high for spec in specs])
    moved = np.array(coefficients, dtype=float)
    covariance = np.array(covariance, dtype=float)

    # Torque of a coefficient over what is likely beforehand.
    inverse_size = np.sqrt(np.diag(precision))
    largest = float(np.max(np.abs(moved) * inverse_size, initial=0.0))
    error_of_law = negligible_share * largest / inverse_size

    # One after the other, the one that is furthest beyond first: given that it is at
    # the bound the others move, and are known better.
    for _ in specs:
        beyond = moved - np.clip(moved, low, high)
        variance = np.maximum(np.diag(covariance), 0.0)
        errors = np.maximum(np.hypot(np.sqrt(variance), error_of_law), 1e-300)
        number = int(np.argmax(np.abs(beyond) / errors))
        if not 0.0 < abs(beyond[number]) <= BOUND_ERRORS * errors[number]:
            break
        if variance[number] > 0.0:
            gain = covariance[:, number] / variance[number]
            moved -= gain * beyond[number]
            covariance -= np.outer(gain, covariance[number])
        # exactly there, whatever rounding makes of the step
        moved[number] = high[number] if beyond[number] > 0.0 else low[number]
    return moved
