"""Least squares of a trajectory and of the constants beside it: a band with a border.

The K unknowns x of a trajectory are linked to those nearby alone, the P constants b to
all of them. So the normal equations are

    [ band    border ] [x]   [gradient          ]
    [ border' corner ] [b] = [constants_gradient],

with band = F F'. With B = F^-1 border and f = F^-1 gradient, the constants see

    S = corner - B'B,      S b = constants_gradient - B'f,

and the trajectory that goes with them is x = F'^-1 (f - B b). Calibration and smoother
are both of this kind: the one asks for b, with many trajectories, the other for x.
"""

import contextlib
from dataclasses import dataclass

import numpy as np

from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class Bordered:
    """Normal equations whose trajectory is eliminated.

    Attributes
    ----------
    factor : Array
        F, as a lower band.
    border : Array
        B (K, P).
    schur : Array
        S (P, P), the information about the constants once the trajectory follows them.
    half : Array
        f (K,).
    pull : Array
        (P,), constants_gradient - B'f.
    """

    factor: Array
    border: Array
    schur: Array
    half: Array
    pull: Array

    @property
    def free(self) -> Array:
        """The trajectory (K,) with the constants at rest."""
        return halved(self.factor, self.half[:, None], transposed=True)[:, 0]

    @property
    def back(self) -> Array:
        """By how much (K, P) the trajectory moves back with each constant."""
        return halved(self.factor, self.border, transposed=True)

    def trajectory(self, step: Array) -> Array:
        """Return the trajectory (K,) that goes with constants (P,)."""
        right = self.half - self.border @ step
        return halved(self.factor, right[:, None], transposed=True)[:, 0]


def eliminated(
    band: Array,
    border: Array,
    corner: Array,
    gradient: Array,
    constants_gradient: Array,
) -> Bordered:
    """Eliminate the trajectory from its normal equations.

    Parameters
    ----------
    band : Array
        Lower band of the information on the trajectory, as LAPACK has it.
    border, corner : Array
        (K, P) and (P, P).
    gradient, constants_gradient : Array
        (K,) and (P,).
    """
    factor = factored(band)
    right = halved(factor, np.column_stack([border, gradient]))
    B = right[:, :-1]
    half = right[:, -1]
    return Bordered(
        factor=factor,
        border=B,
        schur=corner - B.T @ B,
        half=half,
        pull=constants_gradient - B.T @ half,
    )


def factored(
    band: Array, *, stiffness: tuple[float, ...] = (0.0, 1e-14, 1e-12, 1e-10)
) -> Array:
    """Return the Cholesky factor of a lower band.

    Where a long hole tells nothing, rounding may make the band indefinite: a share of
    `stiffness` of its largest entry is then added to the diagonal.
    """
    from scipy.linalg import cholesky_banded

    for share in stiffness:
        stiffened = band.copy()
        stiffened[0] += share * np.abs(band[0]).max()
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.asarray(
                cholesky_banded(stiffened, lower=True, check_finite=False)
            )
    raise np.linalg.LinAlgError("the encoders' information is not positive definite")


def halved(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    """Solve with half of a band: return F^-1 `right` (K, r), or F'^-1 `right`."""
    if not right.size:  # LAPACK would write into memory that is not its own
        return right
    from scipy.linalg.lapack import dtbtrs

    x, _ = dtbtrs(factor, right, uplo="L", trans="T" if transposed else "N")
    return np.asarray(x)
