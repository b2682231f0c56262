"""Plan the inertia stage: moves of two joints, or of all, chosen and refined (Sec. 2.2.4).

The validation has moves of all joints, drawn by a seed of their own, not optimised.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.rigid.posterior import gravity_prior
from seqid_cli.motion.planned import Shapes
from seqid_cli.params.results.plan import PlannedStage, PredictedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, typical
from seqid_cli.plan.moves.fourier import COARSE_HZ, Moves
from seqid_cli.plan.nuisance import NuisanceInformation, Terms, move_terms
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Goal, Planned, predicted_stage, with_criterion
from seqid_cli.plan.stages.search import (
    check_torque,
    draw_pool,
    optimised,
    within_limits,
)
from seqid_cli.typing import Array, Mask


def plan_inertia(
    belief: Belief, stages: Stages, options: PlanOptions, have: Array | None = None
) -> Planned:
    """Choose the moves that lower the torque's error most beside `have` (b, b), from logs."""
    goal = Goal.of(belief, options.seed)
    known = np.zeros_like(goal.W) if have is None else goal.scaled(have)
    moves, dense, each = optimised(belief, goal, options, known, "inertia")
    every = np.ones(belief.basis.size, dtype=bool)
    rows = rows_of_moves(belief, dense)
    stage = rigid_stage(belief, goal, stages, rows, each, known, every)
    return Planned(moves, with_criterion(stage, goal, known + each.sum(axis=0)))


def plan_validation(
    belief: Belief, options: PlanOptions, *, count: int = 4, own_seed: int = 1_000_003
) -> Planned:
    """Draw moves of all joints, the first that keep the torque limits."""
    own = replace(options, seed=options.seed + own_seed)
    goal = Goal.of(belief, own.seed)
    shapes = Shapes.over(own.length_s, COARSE_HZ)
    rng = np.random.default_rng(own.seed)
    drawn, _ = draw_pool(
        belief, goal, shapes, [tuple(belief.limits.moving)], 10 * count, rng
    )
    check_torque(belief, drawn, own)
    return Planned(
        within_limits(belief, drawn[:count], own, "validation")[0], PlannedStage()
    )


@dataclass(frozen=True, kw_only=True)
class StageRows:
    """The rows that a stage will see of its moves, and what it marginalises.

    Parameters
    ----------
    moves : Moves
        Samples of M moves.
    H : (M, N, n, b) float
        Columns of the base parameters.
    weights : (M, N, n) float
        Information of the rows, per (N m)^2; 0 where a row is not used.
    terms : Terms
        Nuisance terms of the stage.
    rates : (M, N, n) float, optional
        Rates of the torque, which a delay turns into torque [N m/s].
    """

    moves: Moves
    H: Array
    weights: Array
    terms: Terms
    rates: Array | None = None

    def lost(self, belief: Belief) -> Array:
        """Return the information (b, b) that the nuisance terms take away."""
        total = NuisanceInformation(belief.robot.n, self.H.shape[3], self.terms)
        belief.add_nuisances(total, self.moves, self.H, self.weights, self.rates)
        return total.lost


def rows_of_moves(belief: Belief, dense: Moves) -> StageRows:
    """Return the rows of moves, at a hundred samples a second or so: rates are differences."""
    return StageRows(
        moves=dense,
        H=belief.regressor(dense),
        weights=belief.weights(dense),
        terms=move_terms,
        rates=belief.torque_rates(dense),
    )


def rigid_stage(
    belief: Belief,
    goal: Goal,
    stages: Stages,
    rows: StageRows,
    each: Array,
    have: Array,
    wanted: Mask,
) -> PlannedStage:
    """Describe what moves tell of the base parameters beyond `have`.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    stages : Stages
        What is identified already.
    rows : StageRows
        The rows of M moves.
    each : (M, b, b) float
        Their scaled information.
    have : (b, b) float
        Scaled information that is there already.
    wanted : (b,) bool
        The parameters that the stage is about.
    """
    basis, names = belief.basis, belief.robot.joint_names
    total = have + each.sum(axis=0) - goal.scaled(rows.lost(belief))
    spread = spread_of(belief, goal, stages, rows, total)
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
    seconds = float(rows.moves.t[-1])
    found = predicted_stage(goal, have, each, parameters, wanted, seconds)
    known = {p.name for p in stages.gravity.parameters} if stages.gravity else set()
    found.parameters = [p for p in found.parameters if p.name not in known]
    found.torque_error = torque_errors(belief, spread * np.outer(wanted, wanted))
    return found


def torque_errors(belief: Belief, covariance: Array) -> dict[str, float]:
    """Return the torque error [N m] of each joint that moves, over typical moves."""
    values, vectors = np.linalg.eigh(covariance)
    H = belief.regressor(typical(belief, seed=0))
    torque = H @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    sizes = np.sqrt(np.mean(np.sum(torque**2, axis=3), axis=(0, 1)))
    names = belief.robot.joint_names
    return {names[j]: float(sizes[j]) for j in belief.limits.moving}


def spread_of(
    belief: Belief, goal: Goal, stages: Stages, rows: StageRows, total: Array
) -> Array:
    """Covariance (b, b) after moves with the scaled information `total`, friction's errors in it.

    Friction was subtracted: an error d of a surface's coefficients moves the parameters
    by -C (H' D F) d, and by what it moved gravity's parameters through their prior.
    """
    C = goal.covariance(total)
    whole = C.copy()
    moves = rows.moves
    prior = gravity_prior(stages.gravity, belief.basis, belief.robot.joint_names)
    for j, surface in enumerate(belief.surfaces):
        if surface is None:
            continue
        F = surface.columns(moves.q[..., j].ravel(), moves.dq[..., j].ravel())
        weighted = rows.weights[..., j, None] * rows.H[:, :, j]
        moved = -C @ (weighted.reshape(-1, len(C)).T @ F)
        if j in prior.friction:
            moved += C @ prior.A.T @ prior.friction[j]
        whole += moved @ surface.covariance @ moved.T
    return whole
