"""Factors of scaled precisions, and Bayes factors of columns from their products.

A term has coefficients a ~ N(0, Q^-1) beforehand and products D, d with the rows, freed
of what the rest of the model explains. Its log Bayes factor is

    E = d' (Q + D)^-1 d / 2 - log det(I + Q^-1 D) / 2.

Columns are scaled to unit prior variance first, so that eigenvalues are signal over
noise.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor

from seqid_cli.typing import Array

Factor = tuple[Array, bool]  # of Cholesky, as scipy has it

RIDGE = 1e-10  # of a scaled column's square


class BayesFactors(NamedTuple):
    """Log Bayes factors (...), coefficients (..., k), covariances (..., k, k)."""

    log_factor: Array
    coefficients: Array
    covariance: Array


def scale_of(diagonal: Array) -> Array:
    """Return factors (p,) that make ones of what is not zero in a diagonal (p,)."""
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def factored(scaled: Array) -> Factor:
    """Factor a matrix (p, p), whose rows and columns are scaled, in place."""
    scaled[np.diag_indices(len(scaled))] += RIDGE
    return cho_factor(scaled, check_finite=False)


def taken_back(a: Array, covariance: Array, precision: Array) -> float:
    """Return the log Bayes factor of a term that a model has.

    Parameters
    ----------
    a : (k,) array
        Its coefficients.
    covariance : (k, k) array
        Of these, given the rows.
    precision : (k, k) array
        Of these beforehand, diagonal.
    """
    scale = np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(covariance * np.outer(scale, scale))
    value = np.maximum(value, 1e-300)
    u = (a * scale) @ vector
    return 0.5 * float(np.sum(u**2 / value + np.log(value)))


def half_log_det(factor: Factor) -> float:
    """Return half the logarithm of the determinant."""
    return float(np.sum(np.log(np.diag(factor[0]))))


def bayes_factor(D: Array, d: Array, precision: Array) -> BayesFactors:
    """Return the log Bayes factor, coefficients and covariance of terms.

    Parameters
    ----------
    D : (..., k, k) array
        Products of the columns, the rest of the model eliminated.
    d : (..., k) array
        Products of the columns and the residual.
    precision : (..., k, k) array
        Of the coefficients beforehand, diagonal; one for all terms, or one of each.
    """
    scale = 1.0 / np.sqrt(np.diagonal(precision, axis1=-2, axis2=-1))
    scales = scale[..., :, None] * scale[..., None, :]
    value, vector = np.linalg.eigh(D * scales)
    value = np.maximum(value, 0.0)
    u = ((d * scale)[..., None, :] @ vector)[..., 0, :]
    log_factor = 0.5 * np.sum(u**2 / (1.0 + value) - np.log1p(value), axis=-1)

    inverse = (vector / (1.0 + value)[..., None, :]) @ np.swapaxes(vector, -1, -2)
    a = scale * (inverse @ (d * scale)[..., None])[..., 0]
    return BayesFactors(
        log_factor=log_factor,
        coefficients=a,
        covariance=inverse * scales,
    )
