"""The joint posterior of all stages: what an error of an earlier stage does to a later one.

Every stage is a linear function of its own torque and of what earlier stages say,

    theta = theta_0(tau) + S_c c + S_g g,

c the coefficients of the friction surfaces, joint by joint, g the gravity parameters, S the
sensitivities. The noise in theta_0 is the stage's own. Gravity depends on friction (S_c alone), and
inertia on friction both directly and through gravity, so that

    T = S_c + S_g S_gc,    cov(theta) = own + S_g own_g S_g' + sum_j T_j cov(c_j) T_j'.

Friction is counted once, whatever way its errors take. A stage hands on its covariance and its
total sensitivity to friction, T; with the covariances of the surfaces that is the covariance of
everything with everything: cov(theta, c_j) = T_j cov(c_j).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.least_squares import Solution
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import Matrix, RigidStage

Array = NDArray[np.float64]

Sensitivity = dict[int, Array]  # by joint: (p, K_j), change of parameters per coefficient of c_j


def friction_covariance(
    sensitivity: Mapping[int, Array], surfaces: Sequence[FrictionSurface | None], size: int
) -> Array:
    """Covariance (p, p) that the errors of the friction surfaces make: sum_j T_j cov(c_j) T_j'."""
    total = np.zeros((size, size))
    for j, T in sensitivity.items():
        surface = surfaces[j]
        assert surface is not None
        total += T @ surface.covariance @ T.T
    return total


def sensitivity_of(stage: RigidStage | None, names: Sequence[str]) -> Sensitivity:
    """Sensitivity (p, K_j) of a stage's parameters to friction, by joint, as its file says it."""
    told = stage.friction_sensitivity if stage is not None else {}
    return {j: np.array(told[name]) for j, name in enumerate(names) if told.get(name)}


@dataclass(frozen=True)
class Posterior:
    """Covariance (p, p) of a stage's parameters, and their total sensitivity to friction."""

    covariance: Array
    friction: Sensitivity

    @classmethod
    def of(
        cls,
        solution: Solution,
        surfaces: Sequence[FrictionSurface | None],
        direct: Sensitivity,
        gain: Array,
        through: Sensitivity,
    ) -> Posterior:
        """Join a solution's own errors with those that it inherits.

        Parameters
        ----------
        solution : Solution
            Its covariance counts the prior's rows as independent of friction.
        surfaces : sequence of FrictionSurface or None
            With their covariances.
        direct : Sensitivity
            Of the solution to friction, the prior held.
        gain : (p, k) array
            Of the solution on the prior's right side.
        through : Sensitivity
            Of the prior's right side (k, K_j) to friction.
        """
        inherited = friction_covariance(through, surfaces, gain.shape[1])
        total = combined(direct, gain, through)
        covariance = solution.covariance - gain @ inherited @ gain.T
        covariance += friction_covariance(total, surfaces, len(covariance))
        return cls((covariance + covariance.T) / 2, total)

    def with_doubt(self, directions: Array) -> Posterior:
        """Add an error along directions (p, d), one standard deviation each."""
        return replace(self, covariance=self.covariance + directions @ directions.T)


def combined(direct: Sensitivity, gain: Array, through: Sensitivity) -> Sensitivity:
    """Total sensitivity to friction: direct, and through what has a gain (p, k) on the result."""
    total = dict(direct)
    for j, inner in through.items():
        moved = gain @ inner
        total[j] = total[j] + moved if j in total else moved
    return total


def as_matrices(
    sensitivity: Mapping[int, Array], chosen: NDArray[np.intp], names: Sequence[str]
) -> dict[str, Matrix]:
    """Sensitivities of the parameters `chosen` for the parameter file, every joint named."""
    return {
        name: sensitivity[j][chosen].tolist() if j in sensitivity else []
        for j, name in enumerate(names)
    }
