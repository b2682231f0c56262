"""Plan the validation: moves of all joints, drawn by a seed of their own, not optimised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from seqid_cli.params.results.plan import PlannedStage
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import COARSE_HZ, Shapes
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.choose import Goal, draw_pool
from seqid_cli.plan.stages.inertia import Planned, check_torque, described, within_limits


def plan_validation(
    belief: Belief, options: PlanOptions, *, count: int = 4, own_seed: int = 1_000_003
) -> Planned:
    """Draw moves of all joints, the first that keep the torque limits."""
    own = replace(options, seed=options.seed + own_seed)
    goal = Goal.of(belief, own.seed)
    shapes = Shapes.over(own.length_s, COARSE_HZ)
    rng = np.random.default_rng(own.seed)
    pool = draw_pool(belief, goal, shapes, [tuple(belief.limits.moving)], 10 * count, rng)
    check_torque(belief, pool, own)
    drawn, moves = within_limits(belief, pool.drawn[slice(count)], own)
    named = described(belief, drawn, moves, own, "validation")
    return Planned(named, PlannedStage(duration_s=own.length_s * len(named)))
