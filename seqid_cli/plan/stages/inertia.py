"""Plan the inertia stage: moves of two joints or all, chosen and refined (Sec. 2.2.4).

The validation has moves of all joints, drawn by a seed of their own, not optimised.

Letters: H (M, N, n, b) are the rows of the regressor, D their information per (N m)^2
and C the covariance of the base parameters. Friction was subtracted from the torque, so
that an error d of a surface's coefficients, with columns F, moves the parameters by
-C (H' D F) d.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import InputError
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
    """Choose the moves that lower the torque's error most.

    Parameters
    ----------
    belief : Belief
    stages : Stages
        What is identified already.
    options : PlanOptions
    have : (b, b) float, optional
        Information of logs and moves that are there already.

    Returns
    -------
    Planned
    """
    goal = Goal.of(belief, options.seed)
    scaled_have = np.zeros_like(goal.W) if have is None else goal.scaled(have)
    search = optimised(belief, goal, options, scaled_have, "inertia")
    stage = rigid_stage(
        belief,
        goal,
        stages,
        rows_of_moves(belief, search.samples),
        each=search.information,
        have=scaled_have,
        wanted=np.ones(belief.basis.size, dtype=bool),
    )
    total = scaled_have + search.information.sum(axis=0)
    return Planned(search.moves, with_criterion(stage, goal, total))


def plan_validation(
    belief: Belief, options: PlanOptions, *, count: int = 4, own_seed: int = 1_000_003
) -> Planned:
    """Draw moves of all joints, the first that keep the torque limits.

    Parameters
    ----------
    belief : Belief
    options : PlanOptions
    count : int
        Number of moves.
    own_seed : int
        Added to the seed: moves to judge a model by are not those to learn from.

    Returns
    -------
    Planned
    """
    with_own_seed = replace(options, seed=options.seed + own_seed)
    seed = with_own_seed.seed
    goal = Goal.of(belief, seed)
    shapes = Shapes.over(options.length_s, COARSE_HZ)
    all_joints = [tuple(belief.limits.moving)]
    rng = np.random.default_rng(seed)
    drawn, _ = draw_pool(belief, goal, shapes, all_joints, 10 * count, rng)
    check_torque(belief, drawn, with_own_seed)
    moves, _ = within_limits(belief, drawn[:count], with_own_seed, "validation")
    return Planned(moves, PlannedStage())


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


def rows_of_moves(belief: Belief, samples: Moves) -> StageRows:
    """Return the rows of moves, at a hundred samples a second or so.

    Sparser samples do not do: rates of the torque are differences of them.
    """
    return StageRows(
        moves=samples,
        H=belief.regressor(samples),
        weights=belief.weights(samples),
        terms=move_terms,
        rates=belief.torque_rates(samples),
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

    Returns
    -------
    PlannedStage
        Gravity parameters that a stage has identified are not listed again.
    """
    basis = belief.basis
    names = belief.robot.joint_names
    total = have + each.sum(axis=0) - goal.scaled(rows.lost(belief))
    covariance = covariance_with_friction(belief, goal, stages, rows, total)
    variances = np.diag(covariance)
    # A damaged file may hold covariances that no parameters can have.
    if np.any(variances < 0.0):
        worst = basis.names[int(np.argmin(variances))]
        raise InputError(
            f"by the covariances of the parameter file {worst} has a negative variance",
            hint="identify the stages again; do not edit their covariances",
        )
    std_errors = np.sqrt(variances)
    parameters = [
        PredictedParameter(
            name=basis.names[k],
            joint=names[basis.joint_index(k)],
            unit=basis.unit(k),
            std_error=float(std_errors[k]),
            value=None if belief.theta is None else float(belief.theta[k]),
            expression=basis.expression_text(k),
        )
        for k in range(basis.size)
    ]
    seconds = float(rows.moves.t[-1])
    stage = predicted_stage(goal, have, each, parameters, wanted, seconds)

    if stages.gravity:
        of_gravity = {parameter.name for parameter in stages.gravity.parameters}
        stage.parameters = [x for x in stage.parameters if x.name not in of_gravity]
    stage.torque_error = torque_errors(belief, covariance * np.outer(wanted, wanted))
    return stage


def torque_errors(belief: Belief, covariance: Array) -> dict[str, float]:
    """Return the torque error [N m] of each joint that moves, over typical moves.

    `covariance` (b, b) is that of the base parameters.
    """
    variances, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(variances, 0.0))
    torque = belief.regressor(typical(belief, seed=0)) @ root
    rms = np.sqrt(np.mean(np.sum(torque**2, axis=3), axis=(0, 1)))
    names = belief.robot.joint_names
    return {names[j]: float(rms[j]) for j in belief.limits.moving}


def covariance_with_friction(
    belief: Belief, goal: Goal, stages: Stages, rows: StageRows, total: Array
) -> Array:
    """Return the covariance of the parameters with the errors of friction in it.

    An error d of a surface's coefficients moves the parameters by -C (H' D F) d, and by
    what it moved gravity's parameters, through their prior.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    stages : Stages
        What is identified already.
    rows : StageRows
    total : (b, b) float
        Scaled information of all moves and logs, without nuisance terms.

    Returns
    -------
    (b, b) array
        In the parameters' own units.
    """
    C = goal.covariance(total)
    covariance = C.copy()
    q = rows.moves.q
    dq = rows.moves.dq
    prior = gravity_prior(stages.gravity, belief.basis, belief.robot.joint_names)
    for j, surface in enumerate(belief.surfaces):
        if surface is None:
            continue
        F = surface.columns(q[..., j].ravel(), dq[..., j].ravel())
        D_H = (rows.weights[..., j, None] * rows.H[:, :, j]).reshape(-1, len(C))
        moved = -C @ (D_H.T @ F)
        if j in prior.friction:
            moved += C @ prior.A.T @ prior.friction[j]
        covariance += moved @ surface.covariance @ moved.T
    return covariance
