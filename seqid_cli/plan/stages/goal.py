"""The goal of a plan: a small torque error; and the results that a set of moves will give.

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

    `information` (b, b) is theirs on the base parameters, for the stages that follow.
    """

    moves: list[PlannedMove]
    stage: PlannedStage
    information: Array | None = None


@dataclass(frozen=True)
class Goal:
    """`W` (b, b) of scaled parameters, `scale` (b,) noise per unit, `prior` (b, b) scaled.

    `shared` are the joints that W is the sum over.
    """

    W: Array
    scale: Array
    prior: Array
    shared: list[int]

    @classmethod
    def of(cls, belief: Belief, seed: int) -> Self:
        """Average over typical moves."""
        moves = typical(belief, seed)
        H = belief.regressor(moves)
        seconds = float(moves.t[-1] - moves.t[0])
        W = belief.information(moves, H).mean(axis=0) / (2.0 * NOISE_HZ * seconds)
        scale = np.sqrt(np.maximum(np.diag(W), 1e-12 * np.diag(W).max()))
        prior = belief.prior / np.outer(scale, scale) + np.eye(len(W)) / VAGUE**2
        return cls(W / np.outer(scale, scale), scale, prior, belief.limits.moving)

    @property
    def known(self) -> Array:
        """The prior (b, b) without its vague part: what earlier stages tell."""
        return np.asarray(self.prior - np.eye(len(self.W)) / VAGUE**2)

    def scaled(self, information: Array) -> Array:
        """Information (..., b, b) on the scaled parameters."""
        return np.asarray(information / np.outer(self.scale, self.scale))

    def errors(self, information: Array) -> Array:
        """tr(W C) of scaled information matrices (..., b, b), prior included."""
        C = np.linalg.inv(information + self.prior)
        return np.asarray(np.einsum("ab,...ba->...", self.W, C))

    def log_condition(self, information: Array) -> Array:
        """Log (...) of the condition of information (..., b, b) with columns of length 1."""
        N = information + self.prior
        size = np.sqrt(np.diagonal(N, axis1=-2, axis2=-1))
        values = np.linalg.eigvalsh(N / (size[..., :, None] * size[..., None, :]))
        return np.asarray(
            np.log(values[..., -1] / np.maximum(values[..., 0], 1e-15)) / 2.0
        )

    def covariance(self, information: Array) -> Array:
        """Covariance (b, b) of the parameters in their own units, prior included."""
        C = np.linalg.inv(information + self.prior)
        return np.asarray(C / np.outer(self.scale, self.scale))


def rank_and_condition(information: Array) -> tuple[int, float]:
    """Rank and condition of the regressor with columns scaled to one, from its normal matrix."""
    size = np.sqrt(np.diag(information))
    alive = size > 1e-9 * size.max(initial=1e-300)
    scaled = information[np.ix_(alive, alive)] / np.outer(size[alive], size[alive])
    s = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled)[::-1], 0.0))
    kept = s > RANK_TOLERANCE * s[0] if len(s) else np.zeros(0, dtype=bool)
    return int(kept.sum()), float(s[0] / s[kept][-1]) if kept.any() else 0.0


def predicted_stage(
    goal: Goal,
    have: Array,
    each: Array,
    parameters: Sequence[PredictedParameter],
    wanted: Mask,
    seconds: float,
) -> PlannedStage:
    """Describe what moves of `seconds` add to what there is.

    `have` (b, b) and `each` (M, b, b) are scaled information. `parameters` are the
    first of the b unknowns with their errors, `wanted` (b,) those that the stage is
    about: of these the ones stay that are not left open.
    """
    total = have + each.sum(axis=0)
    rank, condition = rank_and_condition((total + goal.known)[np.ix_(wanted, wanted)])
    errors = np.array([parameter.std_error for parameter in parameters])
    vague = errors * goal.scale[: len(errors)] > OPEN_SHARE * VAGUE
    about = [k for k in range(len(parameters)) if wanted[k]]
    growth, grown = [], have
    for k, information in enumerate(each, start=1):
        grown = grown + information
        error = float(np.sqrt(goal.errors(grown) / len(goal.shared)))
        reached, _ = rank_and_condition(grown + goal.known)
        growth.append(
            PlanGrowth(moves=k, duration_s=k * seconds, rank=reached, error=error)
        )
    return PlannedStage(
        parameters=[parameters[k] for k in about if not vague[k]],
        rank=rank,
        structural_rank=int(wanted.sum()),
        condition=condition,
        not_excited=[parameters[k].expression for k in about if vague[k]],
        growth=growth,
    )


def with_criterion(stage: PlannedStage, goal: Goal, total: Array) -> PlannedStage:
    """Return a stage that says what the search for its moves minimised.

    `total` (b, b) is the scaled information of all moves and logs.
    """
    value = float(goal.errors(total)) * float(np.exp(goal.log_condition(total)))
    criterion = PlanCriterion(
        minimised="tr(W C) times the condition of the regressor weighted by the noise",
        value=value,
    )
    return msgspec.structs.replace(stage, criterion=criterion)
