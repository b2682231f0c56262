"""Factors of scaled precisions, and Bayes factors of columns from their products."""

import numpy as np
from scipy.linalg import cho_factor

from seqid_cli.typing import Array

Factor = tuple[Array, bool]  # of Cholesky, as scipy has it

RIDGE = 1e-10  # of a scaled column's square


def scale_of(diagonal: Array) -> Array:
    """Factors (p,) that make ones of what is not zero in a matrix's diagonal."""
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def factored(scaled: Array) -> Factor:
    """Cholesky factor of a matrix (p, p) whose rows and columns are scaled."""
    scaled[np.diag_indices(len(scaled))] += RIDGE
    return cho_factor(scaled, check_finite=False)


def taken_back(a: Array, covariance: Array, precision: Array) -> float:
    """Log Bayes factor of what a model has, from its coefficients (k,) and their covariance."""
    size = np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(covariance * np.outer(size, size))
    value = np.maximum(value, 1e-300)
    u = (a * size) @ vector
    return 0.5 * float(np.sum(u**2 / value + np.log(value)))


def half_log_det(factor: Factor) -> float:
    """Half the logarithm of the determinant."""
    return float(np.sum(np.log(np.diag(factor[0]))))


def bayes_factor(D: Array, d: Array, precision: Array) -> tuple[Array, Array, Array]:
    """Log Bayes factor, coefficients and covariance of D (..., k, k), d (..., k).

    `precision` (k, k) is diagonal.
    """
    size = 1.0 / np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(D * np.outer(size, size))
    value = np.maximum(value, 0.0)
    u = ((d * size)[..., None, :] @ vector)[..., 0, :]
    gain = 0.5 * np.sum(u**2 / (1.0 + value) - np.log1p(value), axis=-1)
    inverse = (vector / (1.0 + value)[..., None, :]) @ np.swapaxes(vector, -1, -2)
    a = size * (inverse @ (d * size)[..., None])[..., 0]
    return gain, a, inverse * np.outer(size, size)
