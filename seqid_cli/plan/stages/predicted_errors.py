"""Predicted results of a set of moves: standard errors, rank, condition, torque error."""

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.regression.least_squares import RANK_TOLERANCE, whitened
from seqid_cli.identify.rigid.posterior import by_joint, gravity_prior
from seqid_cli.params.results.plan import PlanGrowth, PlannedStage, PredictedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, typical
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.stages.choose import VAGUE, Goal
from seqid_cli.robot.types import Array

OPEN_SHARE = 0.1  # of the vague prior, from which an error leaves a parameter open


def spread_of(belief: Belief, goal: Goal, stages: Stages, some: Moves, total: Array) -> Array:
    """Covariance (b, b) after moves with the scaled information `total`, friction's errors in it.

    Friction was subtracted: an error d of a surface's coefficients moves the parameters by
    -C (H' D F) d, and by what it moved gravity's parameters through their prior.
    """
    C = goal.covariance(total)
    whole = C.copy()
    H = belief.regressor(some)
    weights = belief.weights(some)
    prior = gravity_prior(stages.gravity, belief.basis)
    known = stages.gravity.friction_sensitivity if stages.gravity else {}
    sensitivity = by_joint(known, belief.robot.joint_names)
    for j, surface in enumerate(belief.surfaces):
        if surface is None:
            continue
        F = surface.columns(some.q[..., j].ravel(), some.dq[..., j].ravel())
        rows = weights[..., j, None] * H[:, :, j]
        moved = -C @ (rows.reshape(-1, len(C)).T @ F)
        if prior is not None and stages.gravity is not None and j in sensitivity:
            gain = C @ prior.A.T
            moved += gain @ whitened(np.array(stages.gravity.covariance)) @ sensitivity[j]
        whole += moved @ surface.covariance @ moved.T
    return whole


def rank_and_condition(information: Array) -> tuple[int, float]:
    """Rank and condition of the regressor with columns scaled to one, from its normal matrix."""
    size = np.sqrt(np.diag(information))
    alive = size > 1e-9 * size.max(initial=1e-300)
    scaled = information[np.ix_(alive, alive)] / np.outer(size[alive], size[alive])
    s = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled)[::-1], 0.0))
    kept = s > RANK_TOLERANCE * s[0] if len(s) else np.zeros(0, dtype=bool)
    return int(kept.sum()), float(s[0] / s[kept][-1]) if kept.any() else 0.0


def growth_of(goal: Goal, have: Array, each: Array, seconds: float) -> list[PlanGrowth]:
    """Results of the first moves, one more at a time; `each` (M, b, b) scaled."""
    found = []
    total = have
    for k, information in enumerate(each, start=1):
        total = total + information
        found.append(
            PlanGrowth(
                moves=k,
                duration_s=k * seconds,
                rank=rank_and_condition(total + goal.prior - np.eye(len(total)) / VAGUE**2)[0],
                error=float(np.sqrt(goal.errors(total) / len(goal.shared))),
            )
        )
    return found


def predicted_stage(
    belief: Belief,
    goal: Goal,
    stages: Stages,
    moves: Moves,
    each: Array,
    have: Array,
    *,
    wanted: NDArray[np.bool_] | None = None,
) -> PlannedStage:
    """Describe what moves add to `have`; `each` (M, b, b) is their scaled information.

    `moves` are the samples that the information was taken from, `wanted` (b,) the parameters that
    the stage is about; all by default.
    """
    basis = belief.basis
    wanted = np.ones(basis.size, dtype=bool) if wanted is None else wanted
    total = have + each.sum(axis=0)
    spread = spread_of(belief, goal, stages, moves, total)
    errors = np.sqrt(np.diag(spread))
    vague = errors * goal.scale > OPEN_SHARE * VAGUE
    known = {p.name for p in stages.gravity.parameters} if stages.gravity else set()
    earlier = goal.prior - np.eye(len(total)) / VAGUE**2
    rank, condition = rank_and_condition((total + earlier)[np.ix_(wanted, wanted)])
    seconds = float(moves.t[-1])
    return PlannedStage(
        parameters=[
            PredictedParameter(
                name=basis.names[k],
                joint=belief.robot.joint_names[basis.joint_index(k)],
                unit=basis.unit(k),
                std_error=float(errors[k]),
                value=None if belief.theta is None else float(belief.theta[k]),
                expression=basis.expression_text(k),
            )
            for k in range(basis.size)
            if wanted[k] and not vague[k] and basis.names[k] not in known
        ],
        rank=rank,
        structural_rank=int(wanted.sum()),
        condition=condition,
        not_excited=[basis.expression_text(int(k)) for k in np.flatnonzero(vague & wanted)],
        torque_error=_torque_error(belief, spread * np.outer(wanted, wanted)),
        growth=growth_of(goal, have, each, seconds),
        duration_s=seconds * len(each),
    )


def _torque_error(belief: Belief, covariance: Array) -> dict[str, float]:
    """Standard deviation of the predicted torque over typical moves, N m."""
    H = belief.regressor(typical(belief, seed=0))
    values, vectors = np.linalg.eigh(covariance)
    spread = H @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    sizes = np.sqrt(np.mean(np.sum(spread**2, axis=3), axis=(0, 1)))
    names = belief.robot.joint_names
    return {names[j]: float(sizes[j]) for j in belief.limits.moving}
