"""The criterion that sweeps for gravity are chosen by: two conditions of the regressor.

Phi(H_g) stacks the rows of the joint that moves, at even times of its steady way. What
the postures of the locked joints are chosen by is Eq. 20 within the limits of Eq. 21,
in two forms at once:

    J = cond(Phi) cond(Phi S),

the condition to the letter (SI units, no weights), and that with columns of length 1 (S
diagonal), which is free of the units. Each by itself leaves the other far from its
best, since many postures are as good for the one; their product brings both to within a
few per cent of their own optima (tests/studies/planned/gravity.py compares).

J has kinks where singular values meet, as they do at its optimum, and a search that
changes one sweep at a time stops at the first of them. So the search goes by a smooth
J_p, in which the largest singular value is a p-norm of all, (sum s^2p)^(1/2p), and the
least one that of their inverses; J_p falls to J as p grows.

All functions take the normal matrix Phi' Phi (..., g, g), whose eigenvalues are the
squares of the singular values s of Phi.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.typing import Array

MINIMISED = "cond(Phi(H_g)) of Eq. 20 times that with columns of length 1"


@dataclass(frozen=True)
class Criterion:
    """The criterion J, as a logarithm; with a finite `power` p the smooth J_p.

    Parameters
    ----------
    rank : int
        The most that any set of sweeps reaches: conditions are those of so many
        directions.
    power : float
        p; infinite for J itself.
    """

    rank: int
    power: float = np.inf

    def __call__(self, information: Array) -> Array:
        """Return log J (...) of the information Phi' Phi (..., g, g) of sets."""
        if np.isinf(self.power):
            plain, scaled = conditions(information, self.rank)
            return np.asarray(np.log(plain) + np.log(scaled))
        smooth_plain = self._smooth_log_condition(information)
        return smooth_plain + self._smooth_log_condition(_unit_columns(information))

    def _smooth_log_condition(self, normal: Array) -> Array:
        """Return the log (...) of the condition, its largest and least as p-norms."""
        eigenvalues = np.linalg.eigvalsh(normal)[..., -self.rank :]
        largest = np.maximum(eigenvalues[..., -1:], 1e-285)
        logs = np.log(np.maximum(eigenvalues, 1e-15 * largest))

        # Powers over the largest, or the least, of them: no overflow.
        over_largest = np.exp(self.power * (logs - logs[..., -1:])).sum(axis=-1)
        over_least = np.exp(self.power * (logs[..., :1] - logs)).sum(axis=-1)
        log_ratio = logs[..., -1] - logs[..., 0]
        smoothing = (np.log(over_largest) + np.log(over_least)) / self.power
        # Half of it: eigenvalues are squares of singular values.
        return np.asarray((log_ratio + smoothing) / 2.0)


def conditions(information: Array, rank: int) -> tuple[Array, Array]:
    """Return the plain and the scaled condition of Phi.

    Parameters
    ----------
    information : (..., g, g) float
        Phi' Phi of sets of sweeps.
    rank : int
        The most that any set reaches: the condition is that of so many directions.

    Returns
    -------
    plain, scaled : (...) arrays
        cond(Phi), and cond(Phi S) with columns of length 1.
    """
    plain = _condition(information, rank)
    scaled = _condition(_unit_columns(information), rank)
    return plain, scaled


def _unit_columns(information: Array) -> Array:
    """Return the information (..., g, g) on columns scaled to length 1."""
    length = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    length = np.where(length > 0.0, length, 1.0)
    return np.asarray(information / (length[..., :, None] * length[..., None, :]))


def _condition(normal: Array, rank: int) -> Array:
    """Return the largest singular value over the `rank`-th, from a normal matrix."""
    eigenvalues = np.linalg.eigvalsh(normal)
    largest = np.maximum(eigenvalues[..., -1], 1e-300)
    least = np.maximum(eigenvalues[..., -rank], 1e-15 * largest)
    return np.asarray(np.sqrt(largest / least))


def common_rank(information: Array, *, tolerance: float = 1e-6) -> int:
    """Return the rank that sweeps reach together, from Phi' Phi (M, g, g) of each."""
    total = information.sum(axis=0)
    length = np.sqrt(np.diag(total))
    is_excited = length > tolerance * length.max()
    scaled = (total / np.outer(length, length))[np.ix_(is_excited, is_excited)]
    eigenvalues = np.linalg.eigvalsh(scaled)
    return int(np.sum(eigenvalues > tolerance * eigenvalues[-1]))
