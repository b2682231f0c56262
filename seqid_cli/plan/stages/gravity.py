"""Plan the gravity stage: slow sweeps of one joint, all others locked in postures.

The postures are chosen by the condition of the regressor
(`gravity_sweeps.criterion`) in a search (`gravity_sweeps.search`) over sweeps that keep
the limits (`gravity_sweeps.space`). Rows count where the gravity stage will count them:
within the friction that is known (`Coverage`). Where that is narrow, friction trials
are planned as well if they would pay (`gravity_sweeps.friction`).
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.params.results.plan import PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.coverage import Coverage
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.plan.stages.gravity_sweeps.friction import wider_friction
from seqid_cli.plan.stages.gravity_sweeps.prediction import predicted
from seqid_cli.plan.stages.gravity_sweeps.search import best_sweeps
from seqid_cli.plan.stages.gravity_sweeps.space import draw_sweeps
from seqid_cli.plan.stages.sweeps import plan_friction


@dataclass(frozen=True)
class GravityPlan:
    """The sweeps, and the friction trials that they need first, if any."""

    gravity: Planned
    friction: Planned | None = None


def plan_gravity(
    belief: Belief,
    stages: Stages,
    options: PlanOptions,
    friction: Planned | None = None,
    *,
    per_joint: int = 3,
    worth: float = 0.2,
) -> GravityPlan:
    """Choose sweeps for the gravity parameters; none where gravity loads no joint.

    Parameters
    ----------
    belief : Belief
    stages : Stages
        What is identified already: sweeps keep to its friction.
    options : PlanOptions
    friction : Planned, optional
        Friction trials that are planned already, where no friction is given.
    per_joint : int
        Sweeps of each joint that gravity loads.
    worth : float
        Share by which the torque's error has to fall for friction trials over a wider
        range to be worth their time.

    Returns
    -------
    GravityPlan
    """
    if not belief.basis.gravity.any():
        note = "gravity loads no joint of this robot: nothing to record"
        nothing = PlannedStage(rank=0, structural_rank=0, notes=[note])
        return GravityPlan(Planned([], nothing))

    # The stage will identify gravity anew: what is known of it does not count.
    without_prior = replace(belief, prior=np.zeros_like(belief.prior))
    has_friction = stages.friction is not None
    if has_friction:
        coverage = Coverage.of_surfaces(without_prior)
    else:
        friction = friction or plan_friction(belief, options)
        coverage = Coverage.of_moves(without_prior, friction.moves)

    space, pool = draw_sweeps(without_prior, coverage, options)
    sweeps = best_sweeps(space, pool, per_joint, options)
    planned = predicted(space, sweeps, stages, options)

    if not has_friction:
        ranges = "; ".join(coverage.text(without_prior, j) for j in space.joints)
        planned.stage.notes.append(
            "friction has to be known first where these sweeps go, seqid plan friction"
            f" (or all) covers it: {ranges}"
        )
        return GravityPlan(planned)
    wider = wider_friction(belief, coverage, per_joint, options, worth=worth)
    planned.stage.notes.extend(wider.notes)
    return GravityPlan(planned, wider.trials)
