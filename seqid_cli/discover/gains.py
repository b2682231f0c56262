"""What a candidate gains on every fold where it is fitted to the others, from Gram matrices.

Of candidates with columns X: D = X'X and d = X'y of every fold, C = B'X with the base's columns B.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

NEXT_TO_NOTHING = 1e-9  # of a candidate's longest column, below which one is rounding
LEAST_LEFT = 1e-7  # of a candidate's square, below which the base absorbs all of it
# Per fold, from all others: Z, A Z, the base's solution, its score on the fold, and B'X.
Trained = tuple[Array, Array, Array, Array, Array]


def gains_of(
    D: Array, d: Array, C: Array, trained: Sequence[Trained], where: slice, held: float
) -> Array:
    """Gain (F,) of one candidate of k columns: D (F, k, k), d (F, k), C (F, p, k).

    `where` are its columns in `trained`, `held` is what is known of its coefficients beforehand.
    """
    gain, prior = np.zeros(len(D)), held * np.eye(D.shape[1])
    total_D, total_d = D.sum(axis=0), d.sum(axis=0)
    for f, (Zf, AZ, solution, left, others) in enumerate(trained):
        z, rest = Zf[:, where], others[:, where]
        S = total_D - D[f] - rest.T @ z + prior
        a = inverse_of(S, total_D) @ (total_d - d[f] - rest.T @ solution)
        slope = d[f] - C[f].T @ solution - z.T @ left
        cross = C[f].T @ z
        square = D[f] - cross - cross.T + z.T @ AZ[:, where]
        gain[f] = 2 * a @ slope - a @ square @ a
    return gain


def single_gains(
    D: Array, d: Array, C: Array, trained: Sequence[Trained], where: Index, held: Array
) -> Array:
    """The same (K, F) for K candidates of one column each: D, d (K, F), C (F, p, K)."""
    gain = np.zeros_like(D)
    total_D, total_d = D.sum(axis=1), d.sum(axis=1)
    for f, (Zf, AZ, solution, left, others) in enumerate(trained):
        z, rest = Zf[:, where], others[:, where]
        S = total_D - D[:, f] - np.einsum("pk,pk->k", rest, z) + held
        known = LEAST_LEFT * np.maximum(total_D, 1e-300) < S
        a = np.where(known, total_d - d[:, f] - rest.T @ solution, 0.0) / np.where(known, S, 1.0)
        slope = d[:, f] - C[f].T @ solution - z.T @ left
        square = D[:, f] - 2 * np.einsum("pk,pk->k", C[f], z)
        square += np.einsum("pk,pk->k", z, AZ[:, where])
        gain[:, f] = 2 * a * slope - a**2 * square
    return gain


def inverse_of(S: Array, scale: Array) -> Array:
    """Inverse of a candidate's projected square; directions that the base absorbs give zero."""
    size = np.sqrt(np.maximum(np.diag(scale), 1e-300))
    size = np.maximum(size, NEXT_TO_NOTHING * size.max())
    value, vector = np.linalg.eigh(S / np.outer(size, size))
    kept = value > LEAST_LEFT
    inverse = (vector[:, kept] / value[kept]) @ vector[:, kept].T
    result: Array = inverse / np.outer(size, size)
    return result
