"""Plan the inertia stage: moves of two joints, or of all, chosen and refined (Sec. 2.2.4).

The validation has moves of all joints, drawn by a seed of their own, not optimised.
"""

from dataclasses import replace

import numpy as np

from seqid_cli.identify.rigid.posterior import gravity_prior
from seqid_cli.motion.planned import Shapes
from seqid_cli.params.results.plan import PlannedStage, PredictedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, typical
from seqid_cli.plan.moves.fourier import COARSE_HZ, Moves
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Goal, Planned, predicted_stage
from seqid_cli.plan.stages.search import check_torque, draw_pool, optimised, within_limits
from seqid_cli.typing import Array, Mask


def plan_inertia(
    belief: Belief, stages: Stages, options: PlanOptions, have: Array | None = None
) -> Planned:
    """Choose the moves that lower the torque's error most beside `have` (b, b), from logs."""
    goal = Goal.of(belief, options.seed)
    known = np.zeros_like(goal.W) if have is None else goal.scaled(have)
    moves, dense, each = optimised(belief, goal, options, known, "inertia")
    every = np.ones(belief.basis.size, dtype=bool)
    return Planned(moves, rigid_stage(belief, goal, stages, dense, each, known, every))


def plan_validation(
    belief: Belief, options: PlanOptions, *, count: int = 4, own_seed: int = 1_000_003
) -> Planned:
    """Draw moves of all joints, the first that keep the torque limits."""
    own = replace(options, seed=options.seed + own_seed)
    goal = Goal.of(belief, own.seed)
    shapes = Shapes.over(own.length_s, COARSE_HZ)
    rng = np.random.default_rng(own.seed)
    drawn, _ = draw_pool(belief, goal, shapes, [tuple(belief.limits.moving)], 10 * count, rng)
    check_torque(belief, drawn, own)
    return Planned(within_limits(belief, drawn[:count], own, "validation")[0], PlannedStage())


def rigid_stage(
    belief: Belief, goal: Goal, stages: Stages, moves: Moves, each: Array, have: Array, wanted: Mask
) -> PlannedStage:
    """Describe what moves tell of the base parameters beyond `have`.

    `moves` are the samples that the scaled information `each` (M, b, b) was taken from, `wanted`
    (b,) the parameters that the stage is about.
    """
    basis, names = belief.basis, belief.robot.joint_names
    spread = spread_of(belief, goal, stages, moves, have + each.sum(axis=0))
    errors = np.sqrt(np.diag(spread))
    parameters = [
        PredictedParameter(
            name=basis.names[k],
            joint=names[basis.joint_index(k)],
            unit=basis.unit(k),
            std_error=float(errors[k]),
            value=None if belief.theta is None else float(belief.theta[k]),
            expression=basis.expression_text(k),
        )
        for k in range(basis.size)
    ]
    found = predicted_stage(goal, have, each, parameters, wanted, float(moves.t[-1]))
    known = {p.name for p in stages.gravity.parameters} if stages.gravity else set()
    found.parameters = [p for p in found.parameters if p.name not in known]
    values, vectors = np.linalg.eigh(spread * np.outer(wanted, wanted))
    H = belief.regressor(typical(belief, seed=0))
    torque = H @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    sizes = np.sqrt(np.mean(np.sum(torque**2, axis=3), axis=(0, 1)))
    found.torque_error = {names[j]: float(sizes[j]) for j in belief.limits.moving}
    return found


def spread_of(belief: Belief, goal: Goal, stages: Stages, some: Moves, total: Array) -> Array:
    """Covariance (b, b) after moves with the scaled information `total`, friction's errors in it.

    Friction was subtracted: an error d of a surface's coefficients moves the parameters by
    -C (H' D F) d, and by what it moved gravity's parameters through their prior.
    """
    C = goal.covariance(total)
    whole = C.copy()
    H = belief.regressor(some)
    weights = belief.weights(some)
    prior = gravity_prior(stages.gravity, belief.basis, belief.robot.joint_names)
    for j, surface in enumerate(belief.surfaces):
        if surface is None:
            continue
        F = surface.columns(some.q[..., j].ravel(), some.dq[..., j].ravel())
        rows = weights[..., j, None] * H[:, :, j]
        moved = -C @ (rows.reshape(-1, len(C)).T @ F)
        if j in prior.friction:
            moved += C @ prior.A.T @ prior.friction[j]
        whole += moved @ surface.covariance @ moved.T
    return whole
