"""Plan the inertia stage: moves of two joints, or of all, chosen and refined (Sec. 2.2.4).

The validation has moves of all joints, drawn by a seed of their own, not optimised.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import FourierMotion, PlannedMove, PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import COARSE_HZ, Drawn, Moves, Shapes
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.choose import REDUCTION, Goal, Pool, choose, draw_pool, groups_of
from seqid_cli.plan.stages.predicted_errors import predicted_stage
from seqid_cli.plan.stages.refine import refine
from seqid_cli.robot.types import Array


@dataclass(frozen=True)
class Planned:
    """The moves of a stage and their predicted results.

    `information` (b, b) is theirs on the base parameters, for the stages that follow.
    """

    moves: list[PlannedMove]
    stage: PlannedStage
    information: Array | None = None


def plan_inertia(
    belief: Belief, stages: Stages, options: PlanOptions, have: Array | None = None
) -> Planned:
    """Choose the moves that lower the torque's error most in the given time.

    `have` (b, b) is information that recorded logs hold already.
    """
    goal = Goal.of(belief, options.seed)
    known = np.zeros_like(goal.W) if have is None else goal.scaled(have)
    moves, dense, each = optimised(belief, goal, options, known, "inertia")
    stage = predicted_stage(belief, goal, stages, dense, each, known)
    return Planned(moves, stage)


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
    moves, _ = within_limits(belief, pool.drawn[slice(count)], own, "validation")
    return Planned(moves, PlannedStage(duration_s=own.length_s * len(moves)))


def optimised(
    belief: Belief, goal: Goal, options: PlanOptions, known: Array, stage: str
) -> tuple[list[PlannedMove], Moves, Array]:
    """Draw, choose and refine moves for a goal; with them come their samples and information.

    Samples are dense: errors of friction cancel over a move, which few samples do not show. The
    information (M, b, b) is scaled.
    """
    shapes = Shapes.over(options.length_s, COARSE_HZ)
    count = max(1, int(options.duration_s / options.length_s))
    groups = groups_of(belief.limits, together=options.together)
    rng = np.random.default_rng(options.seed)
    pool = draw_pool(belief, goal, shapes, groups, options.pool, rng)
    check_torque(belief, pool, options)
    chosen = pool.drawn[choose(goal, pool.information, count, known)]
    refined = refine(belief, goal, shapes, chosen, known, sweeps=options.sweeps)
    moves, sampled = within_limits(belief, refined, options, stage)
    dense = sampled.every(2)
    each = [belief.information(one, belief.regressor(one))[0] for one in dense.singly()]
    return moves, dense, goal.scaled(np.array(each))


def check_torque(belief: Belief, pool: Pool, options: PlanOptions) -> None:
    """Stop where the pool is empty, naming the joint that the load is too heavy for."""
    if len(pool.drawn):
        return
    places = np.random.default_rng(options.seed).uniform(size=(200, belief.robot.n))
    q = (belief.limits.lower + places * belief.limits.range)[:, None]
    still = Moves(np.arange(2.0), q, np.zeros_like(q), np.zeros_like(q))
    load = belief.torque(still, belief.regressor(still)) / belief.limits.torque
    where = str(belief.robot.source)
    if load.max(axis=(1, 2)).min() <= 1.0 and belief.geometry is not None:
        message = f"no move of {options.pool} keeps the arm off itself and the boxes"
        hint = "Narrow position_limits, or widen --workspace and --keep-out."
        raise ConfigError(message, where=where, hint=hint)
    j = int(np.argmax(load.min(axis=(0, 1))))
    joint, torque = belief.robot.joints[j], belief.limits.torque[j]
    limit = f"torque limit of joint {joint.name!r}: {torque:.4g} {joint.unit('N m')}"
    hint = "Correct effort in the URDF, or lower speeds with a longer --ramp."
    raise ConfigError(f"no move of {options.pool} keeps the {limit}", where=where, hint=hint)


def within_limits(
    belief: Belief,
    drawn: Drawn,
    options: PlanOptions,
    stage: str,
    *,
    most: int = 40,
    dense_hz: float = 200.0,
) -> tuple[list[PlannedMove], Moves]:
    """Make moves smaller until torques hold on dense samples and nothing is touched.

    Those that touch something even when they are small are left out; the others are described, and
    sampled.
    """
    shapes = Shapes.over(options.length_s, dense_hz)
    moves, where = shapes.moves(drawn, belief.limits), np.arange(len(drawn))
    bad, shares = np.ones(len(drawn), dtype=bool), np.zeros(len(drawn))
    for k in range(most + 1):
        if k:
            drawn = drawn.smaller(where, 1.0 - (1.0 - REDUCTION) / 10)
            moves = shapes.moves(drawn, belief.limits)
        own = moves[where]
        shares[where] = [belief.overload(x, belief.regressor(x))[0] for x in own.singly()]
        bad[where] = (shares[where] > 1.0) | belief.collides(own.every(4).q)
        where = np.flatnonzero(bad)
        if not len(where):
            break
    kept, names, found = np.flatnonzero(~bad), belief.robot.joint_names, []
    for number, k in enumerate(kept.tolist(), start=1):
        moving = np.flatnonzero(drawn.coefficients[k].any(axis=1)).tolist()
        joints = [names[j] for j in moving]
        found.append(
            PlannedMove(
                name=f"{stage}_{number:02d}_{'__'.join(joints) if len(joints) < 3 else 'all'}",
                stage=stage,
                joints=joints,
                duration_s=options.length_s,
                start={name: float(x) for name, x in zip(names, moves.q[k, 0], strict=True)},
                fourier={names[j]: _fourier(moves, drawn, k, j) for j in moving},
                torque_share=float(shares[k]) if belief.checks_torque else None,
            )
        )
    return found, moves[kept]


def _fourier(moves: Moves, drawn: Drawn, k: int, j: int) -> FourierMotion:
    """The scaled coefficients of joint j in move k, found from the motion itself."""
    shape = Shapes.over(float(moves.t[-1]), (len(moves.t) - 1) / float(moves.t[-1]))
    y = drawn.coefficients[k, j] @ shape.y
    centre = float(moves.q[k, 0, j])  # the window is zero at the ends
    amplitude = float(y @ (moves.q[k, :, j] - centre) / (y @ y))
    scaled = amplitude * drawn.coefficients[k, j]
    return FourierMotion(centre=centre, sine=scaled[0::2].tolist(), cosine=scaled[1::2].tolist())
