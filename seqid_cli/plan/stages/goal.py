"""The goal of a plan, a small torque error, and the predicted results of moves.

The goal is tr(W C): C the covariance of the base parameters, W the mean of H' D H over
typical all-joint moves with D the noise information, so that it is the mean square of
the predicted torque's error in units of the noise (A-optimality in the sense of the
torque). Parameters are scaled by the diagonal of W; a vague prior of `VAGUE` times the
noise keeps C finite. Pukelsheim, Optimal Design of Experiments, SIAM 2006, ch. 6 and 9
(A-optimality, linear criteria).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import msgspec
import numpy as np

from seqid_cli.identify.regression.least_squares import RANK_TOLERANCE
from seqid_cli.params.results.plan import (
    PlanCriterion,
    PlanGrowth,
    PlannedMove,
    PlannedStage,
    PredictedParameter,
)
from seqid_cli.plan.belief import NOISE_HZ, Belief, typical
from seqid_cli.typing import Array, Mask

# torque error, in noise, that a parameter of which nothing is known could make
VAGUE = 1e3
OPEN_SHARE = 0.1  # of the vague prior, from which an error leaves a parameter open


@dataclass(frozen=True)
class Planned:
    """The moves of a stage and their predicted results.

    `information` (b, b) is that of the moves on the base parameters, for the stages
    that follow.
    """

    moves: list[PlannedMove]
    stage: PlannedStage
    information: Array | None = None


@dataclass(frozen=True)
class Goal:
    """The criterion tr(W C) on scaled parameters.

    Parameters
    ----------
    W : (b, b) float
        Of scaled parameters.
    scale : (b,) float
        Torque of each parameter in units of the noise, per unit of the parameter.
    prior : (b, b) float
        Scaled information of earlier stages, and the vague prior.
    shared : list of int
        The joints that W is the sum over.
    """

    W: Array
    scale: Array
    prior: Array
    shared: list[int]

    @classmethod
    def of(cls, belief: Belief, seed: int) -> Self:
        """Average over typical moves.

        Parameters
        ----------
        belief : Belief
        seed : int
            Of the moves, which are drawn.

        Returns
        -------
        Goal
        """
        moves = typical(belief, seed)
        H = belief.regressor(moves)
        seconds = float(moves.t[-1] - moves.t[0])
        independent_samples = 2.0 * NOISE_HZ * seconds
        W = belief.information(moves, H).mean(axis=0) / independent_samples

        squares = np.diag(W)
        scale = np.sqrt(np.maximum(squares, 1e-12 * squares.max()))
        units = np.outer(scale, scale)
        prior = belief.prior / units + np.eye(len(W)) / VAGUE**2
        return cls(W / units, scale, prior, belief.limits.moving)

    @property
    def earlier_information(self) -> Array:
        """The prior (b, b) without its vague part: that of earlier stages."""
        return np.asarray(self.prior - np.eye(len(self.W)) / VAGUE**2)

    def scaled(self, information: Array) -> Array:
        """Return information (..., b, b) on the scaled parameters."""
        return np.asarray(information / np.outer(self.scale, self.scale))

    def errors(self, information: Array) -> Array:
        """Return tr(W C) (...) of scaled information (..., b, b), prior included."""
        C = np.linalg.inv(information + self.prior)
        return np.asarray(np.einsum("ab,...ba->...", self.W, C))

    def log_condition(self, information: Array) -> Array:
        """Return the log (...) of the condition of the weighted regressor.

        It is that of scaled information (..., b, b), prior included, with columns of
        length 1.
        """
        N = information + self.prior
        length = np.sqrt(np.diagonal(N, axis1=-2, axis2=-1))
        unit_N = N / (length[..., :, None] * length[..., None, :])
        eigenvalues = np.linalg.eigvalsh(unit_N)
        least = np.maximum(eigenvalues[..., 0], 1e-15)
        # Half of it: eigenvalues are squares of the regressor's singular values.
        return np.asarray(np.log(eigenvalues[..., -1] / least) / 2.0)

    def covariance(self, information: Array) -> Array:
        """Return the covariance (b, b) of the parameters in their own units.

        `information` (b, b) is scaled; the prior is included.
        """
        C = np.linalg.inv(information + self.prior)
        return np.asarray(C / np.outer(self.scale, self.scale))


def rank_and_condition(information: Array) -> tuple[int, float]:
    """Return rank and condition of a regressor from its normal matrix.

    Parameters
    ----------
    information : (b, b) float
        Normal matrix; columns of the regressor are scaled to length 1.

    Returns
    -------
    rank : int
    condition : float
        Of the directions that count for the rank; 0 where there are none.
    """
    length = np.sqrt(np.diag(information))
    is_excited = length > 1e-9 * length.max(initial=1e-300)
    units = np.outer(length[is_excited], length[is_excited])
    scaled = information[np.ix_(is_excited, is_excited)] / units
    s = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled)[::-1], 0.0))
    if not len(s):
        return 0, 0.0
    determined = s[s > RANK_TOLERANCE * s[0]]
    if not len(determined):
        return 0, 0.0
    return len(determined), float(s[0] / determined[-1])


def predicted_stage(
    goal: Goal,
    have: Array,
    each: Array,
    parameters: Sequence[PredictedParameter],
    wanted: Mask,
    seconds: float,
) -> PlannedStage:
    """Describe what moves add to the information that there is.

    Parameters
    ----------
    goal : Goal
    have : (b, b) float
        Scaled information that is there already.
    each : (M, b, b) float
        Scaled information of each move.
    parameters : sequence of PredictedParameter
        The first of the b unknowns with their errors.
    wanted : (b,) bool
        The unknowns that the stage is about. Those of them that the moves leave open
        are named, not listed.
    seconds : float
        Length of each move [s].

    Returns
    -------
    PlannedStage
    """
    total = have + each.sum(axis=0) + goal.earlier_information
    rank, condition = rank_and_condition(total[np.ix_(wanted, wanted)])

    determined = []
    open_expressions = []
    for k, parameter in enumerate(parameters):
        if not wanted[k]:
            continue
        if parameter.std_error * goal.scale[k] > OPEN_SHARE * VAGUE:
            open_expressions.append(parameter.expression)
        else:
            determined.append(parameter)

    growth = []
    grown = have
    for k, information in enumerate(each, start=1):
        grown = grown + information
        error = float(np.sqrt(goal.errors(grown) / len(goal.shared)))
        reached_rank, _ = rank_and_condition(grown + goal.earlier_information)
        growth.append(
            PlanGrowth(moves=k, duration_s=k * seconds, rank=reached_rank, error=error)
        )
    return PlannedStage(
        parameters=determined,
        rank=rank,
        structural_rank=int(wanted.sum()),
        condition=condition,
        not_excited=open_expressions,
        growth=growth,
    )


def with_criterion(stage: PlannedStage, goal: Goal, total: Array) -> PlannedStage:
    """Return a stage that says what the search for its moves minimised.

    Parameters
    ----------
    stage : PlannedStage
    goal : Goal
    total : (b, b) float
        Scaled information of all moves and logs.

    Returns
    -------
    PlannedStage
    """
    condition = float(np.exp(goal.log_condition(total)))
    criterion = PlanCriterion(
        minimised="tr(W C) times the condition of the regressor weighted by the noise",
        value=float(goal.errors(total)) * condition,
    )
    return msgspec.structs.replace(stage, criterion=criterion)
