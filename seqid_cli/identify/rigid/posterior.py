"""The joint posterior of all stages: the effect of an earlier stage's error on a later.

Every stage is a linear function of its own torque and of what earlier stages say,

    theta = theta_0(tau) + S_c c + S_g g,

c the coefficients of the friction surfaces, joint by joint, g the gravity parameters, S
the sensitivities. The noise in theta_0 is the stage's own. Gravity depends on friction
(S_c alone), and inertia on friction both directly and through gravity, so that

    T = S_c + S_g S_gc,    cov(theta) = own + S_g own_g S_g' + sum_j T_j cov(c_j) T_j'.

Friction is counted once, whatever way its errors take. A stage hands on its covariance
and its total sensitivity to friction, T; with the covariances of the surfaces that is
the covariance of everything with everything: cov(theta, c_j) = T_j cov(c_j).

The error e_k of a joint's torque constant, s_k its standard deviation, scales the right
side y_k of that joint's rows in every stage, friction c_k included. What it moves theta
by is linear as well,

    M_k = s_k dtheta_0/de_k + S_g M_gk,
    stated cov(theta) = cov(theta) + sum_k M_k M_k',

one common error for all stages. It cancels in the torque of the same drive, so what is
held against that torque uses cov(theta), and what is stated of physical values adds M.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from seqid_cli.identify.regression.least_squares import Prior, Solution, whitened
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import RigidStage
from seqid_cli.robot.base_parameters import Basis, standard_names
from seqid_cli.typing import Array

Surfaces = Sequence[FrictionSurface | None]  # of the joints, as far as they are known
# by joint: (p, K_j), change of parameters per coefficient of c_j
Sensitivity = dict[int, Array]
# by joint: (p,), change of parameters per error of its torque constant
Moves = dict[int, Array]


def friction_covariance(
    sensitivity: Sensitivity, surfaces: Surfaces, size: int
) -> Array:
    """Return the covariance (p, p) by errors of the friction surfaces.

    It is sum_j T_j cov(c_j) T_j'.
    """
    total = np.zeros((size, size))
    for j, T in sensitivity.items():
        surface = surfaces[j]
        assert surface is not None
        total += T @ surface.covariance @ T.T
    return total


def constant_moves(
    solution: Solution, errors: Array, computed: Moves, through: Moves
) -> Moves:
    """Return moves of a solution per standard error of each joint's torque constant.

    Parameters
    ----------
    solution : Solution
    errors : (n,) array
        Relative standard errors of the torque constants.
    computed : dict of (p,) arrays
        Moves by torque on the right side that was computed, not measured, such as that
        of known rotors. It does not scale with the torque constant.
    through : dict of (p,) arrays
        Moves by way of an earlier stage.

    Returns
    -------
    dict of (p,) arrays
        By joint; of joints with an error, or with a move through an earlier stage.
    """
    return {
        j: e * (solution.shares[j] - computed.get(j, 0.0)) + through.get(j, 0.0)
        for j, e in enumerate(errors)
        if e > 0.0 or j in through
    }


def moves_covariance(moves: Mapping[Any, Array], size: int) -> Array:
    """Return the covariance (p, p) by errors common to all rows: sum_k M_k M_k'."""
    return sum((np.outer(M, M) for M in moves.values()), np.zeros((size, size)))


@dataclass(frozen=True)
class Posterior:
    """Covariance (p, p) of a stage's parameters, and what it inherits."""

    covariance: Array  # without the errors of torque constants
    friction: Sensitivity  # the total one
    constants: Moves = field(default_factory=dict)
    # By its name: (p,) change of parameters per standard deviation of what no log
    # shows.
    tolerances: dict[str, Array] = field(default_factory=dict)

    @property
    def stated(self) -> Array:
        """Covariance (p, p) of physical values.

        It has what cancels in predicted torques.
        """
        size = len(self.covariance)
        common = moves_covariance(self.constants, size) + moves_covariance(
            self.tolerances, size
        )
        return self.covariance + common

    @property
    def beside_tolerances(self) -> Array:
        """Covariance (p, p) of a drive's terms, with the robot file's own errors.

        Gravity of another direction is a torque that does not turn with the motion,
        as an offset is. Predicted torques do not feel it, the drive's offset does.
        """
        size = len(self.covariance)
        return self.covariance + moves_covariance(self.tolerances, size)

    @classmethod
    def of(
        cls,
        solution: Solution,
        surfaces: Surfaces,
        errors: Array,
        direct: Sensitivity,
        computed: Moves,
        prior: Prior | None = None,
    ) -> "Posterior":
        """Join a solution's errors with those that it inherits.

        `direct` are those of friction with the prior held.
        """
        total = dict(direct)
        covariance = solution.covariance
        through: Moves = {}
        # The solution's covariance counts the prior's rows as independent of friction.
        if prior is not None:
            gain = solution.bread @ prior.A.T
            inherited = friction_covariance(prior.friction, surfaces, gain.shape[1])
            covariance = covariance - gain @ inherited @ gain.T
            for j, inner in prior.friction.items():
                total[j] = total.get(j, 0.0) + gain @ inner
            through = {j: gain @ move for j, move in prior.constants.items()}

        covariance = covariance + friction_covariance(total, surfaces, len(covariance))
        constants = constant_moves(solution, errors, computed, through)
        return cls((covariance + covariance.T) / 2, total, constants)

    def first(self, count: int) -> "Posterior":
        """Return the same of the first so many parameters."""
        return Posterior(
            covariance=self.covariance[:count, :count],
            friction={j: T[:count] for j, T in self.friction.items()},
            constants={j: move[:count] for j, move in self.constants.items()},
            tolerances={name: move[:count] for name, move in self.tolerances.items()},
        )

    def with_error(self, directions: Array) -> "Posterior":
        """Add an error along directions (p, d), one standard deviation each."""
        return replace(self, covariance=self.covariance + directions @ directions.T)


def gravity_prior(
    gravity: RigidStage | None, basis: Basis, joints: Sequence[str]
) -> Prior:
    """Return the gravity stage as rows of unit variance.

    They are on the base parameters that the stage determined.
    """
    if gravity is None or not gravity.parameters:
        return Prior(A=np.zeros((0, basis.size)), b=np.zeros(0))

    size = int(basis.gravity.sum())
    rows = whitened(np.array(gravity.covariance))
    wide = np.zeros((len(rows), basis.size))
    places = [basis.names.index(parameter.name) for parameter in gravity.parameters]
    wide[:, places] = rows

    # Base gravity parameters of the stage, undetermined ones at their smallest values.
    names = standard_names(basis.expression.shape[1] // 11)
    phi = np.array([gravity.representative.get(name, 0.0) for name in names])
    value = np.asarray((basis.expression @ phi)[:size])[places]

    def by_joint(moves: Mapping[str, Any]) -> dict[int, Array]:
        return {
            j: rows @ np.array(moves[name])
            for j, name in enumerate(joints)
            if moves.get(name)
        }

    return Prior(
        A=wide,
        b=rows @ value,
        friction=by_joint(gravity.friction_sensitivity),
        constants=by_joint(gravity.torque_constant_moves),
        tolerances={
            name: rows @ np.array(move)
            for name, move in gravity.tolerance_moves.items()
        },
    )
