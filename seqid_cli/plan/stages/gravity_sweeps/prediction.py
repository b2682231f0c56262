"""Sweeps as planned moves, and the errors that the gravity stage will make of them.

Letters: H (M, N, n, b) are the rows of the regressor at N samples of M sweeps, and a
weight is the information of a row, per (N m)^2. The information of one sweep is the sum
of weight H' H over its rows.
"""

import msgspec
import numpy as np

from seqid_cli.params.results.plan import PlanCriterion, PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves import strokes
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.nuisance import sweep_terms
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Goal, Planned
from seqid_cli.plan.stages.gravity_sweeps.criterion import MINIMISED, conditions
from seqid_cli.plan.stages.gravity_sweeps.space import Sweeps, SweepSpace, middles
from seqid_cli.plan.stages.inertia import StageRows, rigid_stage


def predicted(
    space: SweepSpace, chosen: Sweeps, stages: Stages, options: PlanOptions
) -> Planned:
    """Return the moves of sweeps, and the errors that their rows will give.

    Parameters
    ----------
    space : SweepSpace
    chosen : Sweeps
    stages : Stages
        What is identified already; gravity is to be identified anew.
    options : PlanOptions

    Returns
    -------
    Planned
    """
    belief = space.belief
    goal = Goal.of(belief, options.seed)

    # The last joint first, each joint's sweeps in the order in which they were chosen.
    order = np.lexsort((np.arange(len(chosen.joint)), -chosen.joint))
    chosen = chosen[order]
    rows = _rows(belief, space, chosen)
    information = np.einsum(
        "mnjb,mnj,mnjc->mbc", rows.H, rows.weights, rows.H, optimize=True
    )
    stage = rigid_stage(
        belief,
        goal,
        msgspec.structs.replace(stages, gravity=None),
        rows,
        each=goal.scaled(information),
        have=np.zeros_like(goal.W),
        wanted=belief.basis.gravity,
    )
    stage.growth = []

    plain, scaled = conditions(chosen.total, int(stage.rank or 1))
    stage.plain_condition = float(plain)
    stage.scaled_condition = float(scaled)
    stage.criterion = PlanCriterion(minimised=MINIMISED, value=float(plain * scaled))
    return Planned(
        _moves(belief, space, chosen),
        stage,
        information.sum(axis=0) - rows.lost(belief),
    )


def _moves(belief: Belief, space: SweepSpace, chosen: Sweeps) -> list[PlannedMove]:
    """Return the moves of sweeps, numbered joint by joint."""
    moves: list[PlannedMove] = []
    for k, joint in enumerate(chosen.joint):
        j = int(joint)
        name = belief.robot.joint_names[j]
        number = 1 + sum(move.joints == [name] for move in moves)
        ends = (float(chosen.ends[k, 0]), float(chosen.ends[k, 1]))
        speed = min(
            float(space.speed[j]),
            strokes.top_speed(belief.limits, j, ends[1] - ends[0]),
        )
        move = strokes.stroke_move(
            belief, f"gravity_{name}_{number}", j, chosen.posture[k], ends, [speed]
        )
        moves.append(move)
    return moves


def _rows(
    belief: Belief, space: SweepSpace, chosen: Sweeps, *, points: int = 24
) -> StageRows:
    """Return the rows that the gravity stage will see.

    They are of the joint that moves, both ways, at steady speed.
    """
    n = belief.robot.n
    joint = chosen.joint
    sweep = np.arange(len(joint))
    steady = space.steady_ends(joint, chosen.ends)
    places = middles(steady, points)
    speed = space.speed[joint]

    q = np.repeat(chosen.posture[:, None], 2 * points, axis=1)
    q[sweep, :, joint] = np.hstack([places, places[:, ::-1]])
    dq = np.zeros_like(q)
    dq[sweep, :, joint] = np.repeat([1.0, -1.0], points) * speed[:, None]
    moves = Moves(np.arange(2.0 * points), q, dq, np.zeros_like(q))

    is_gravity = belief.basis.gravity
    H = np.zeros((len(sweep), 2 * points, n, belief.basis.size))
    H[..., is_gravity] = belief.regressor(moves)[..., is_gravity]

    # Information of one way of a sweep: by what friction's surface leaves of it, else
    # by the noise.
    seconds = np.diff(steady)[:, 0] / speed
    by_noise = belief.information_rate[joint] * seconds
    left_by_surface = belief.sweep_variance[joint]
    information_of_way = np.where(
        left_by_surface > 0.0, 1.0 / np.maximum(left_by_surface, 1e-300), by_noise
    )
    weights = np.zeros(q.shape)
    weights[sweep, :, joint] = (information_of_way / points)[:, None]
    return StageRows(moves=moves, H=H, weights=weights, terms=sweep_terms)
