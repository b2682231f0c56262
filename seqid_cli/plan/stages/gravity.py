"""Plan the gravity stage: postures of the locked joints of least condition (Eq. 20-21).

Joints move one at a time, slowly, over their ranges. Postures are chosen greedily by the torque's
error, then exchanged one by one for others of the pool while that lowers cond(Phi(H_g)).
"""

from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.moves.strokes import (
    overloads,
    postures_of,
    reachable,
    reduced_accelerations,
    stroke_move,
    sweeps,
    there_and_back,
    top_speed,
)
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.choose import Goal, choose
from seqid_cli.plan.stages.inertia import Planned
from seqid_cli.plan.stages.predicted_errors import predicted_stage, rank_and_condition
from seqid_cli.robot.types import Array

SLOW = 0.3  # of the largest speed


@dataclass(frozen=True)
class _Sweeps:
    """All sweeps of the pool, M of them, `ends` rad, with their scaled information."""

    joint: NDArray[np.intp]
    posture: Array
    ends: Array
    moves: Moves
    information: Array


def plan_gravity(
    belief: Belief, stages: Stages, options: PlanOptions, *, per_joint: int = 3
) -> Planned:
    """Choose sweeps for the gravity parameters; none where gravity loads no joint."""
    wanted = belief.basis.gravity
    if not wanted.any():
        note = "gravity loads no joint of this robot: nothing to record"
        return Planned([], PlannedStage(rank=0, structural_rank=0, notes=[note]))
    fresh = replace(belief, prior=np.zeros_like(belief.prior))
    goal = Goal.of(fresh, options.seed)
    *_, slow = reduced_accelerations(fresh)  # slow sweeps need no more
    pool = _pool(slow, goal, np.random.default_rng(options.seed))
    count = per_joint * len(np.unique(pool.joint))
    greedy = choose(goal, pool.information, count, np.zeros_like(goal.W))
    chosen = _exchanged(pool, greedy, wanted)
    chosen.sort(key=lambda k: -int(pool.joint[k]))
    moves = _described(slow, pool, chosen)
    stage = predicted_stage(
        fresh,
        goal,
        msgspec.structs.replace(stages, gravity=None),
        pool.moves[np.array(chosen)],
        pool.information[chosen],
        np.zeros_like(goal.W),
        wanted=wanted,
    )
    seconds = sum(move.duration_s for move in moves)
    information = pool.information[chosen].sum(axis=0) * np.outer(goal.scale, goal.scale)
    return Planned(
        moves, msgspec.structs.replace(stage, duration_s=seconds, growth=[]), information
    )


def _pool(
    belief: Belief, goal: Goal, rng: np.random.Generator, *, most_postures: int = 60
) -> _Sweeps:
    """Sweeps of every joint that moves and that gravity loads, within the torque limits."""
    limits = belief.limits
    parts: list[tuple[Array, ...]] = []
    t = np.zeros(0)
    for j in limits.moving:
        drawn, ends = reachable(belief, j, postures_of(limits, most_postures, rng), 1.0, 0.5)
        fit = overloads(belief, j, drawn, SLOW * limits.speed[j]) <= 1.0
        drawn, ends = drawn[fit], ends[fit]
        if not len(drawn):
            continue
        speed = SLOW * float(limits.speed[j])
        swept = sweeps(belief, j, drawn, speed, 2 * float(limits.range[j]) / speed, ends)
        own = belief.regressor(swept) * (np.arange(belief.robot.n) == j)[:, None]
        own[..., ~belief.basis.gravity] = 0.0
        information = goal.scaled(belief.information(swept, own))
        if information.any():
            t = swept.t if not parts else t
            own_joint = np.full(len(drawn), j)
            parts.append((own_joint, drawn, ends, swept.q, swept.dq, swept.ddq, information))
    if not parts:
        message = "no sweep of any joint that gravity loads keeps the torque limits"
        hint = "Correct effort in the URDF."
        raise ConfigError(message, where=str(belief.robot.source), hint=hint)
    joint, posture, ends, *states, found = map(np.concatenate, zip(*parts, strict=True))
    return _Sweeps(joint, posture, ends, Moves(t, *states), found)


def _exchanged(
    pool: _Sweeps, chosen: list[int], wanted: NDArray[np.bool_], *, rounds: int = 3
) -> list[int]:
    """Exchange sweeps for others of the same joint while the condition falls and the rank stays."""
    chosen = list(chosen)
    parts = pool.information[:, wanted][:, :, wanted]
    best = _badness(parts[chosen].sum(axis=0))
    for _ in range(rounds):
        before = best
        for place, k in enumerate(chosen):
            rest = parts[chosen].sum(axis=0) - parts[k]
            others = np.setdiff1d(np.flatnonzero(pool.joint == pool.joint[k]), chosen)
            found = [(_badness(rest + parts[int(other)]), int(other)) for other in others]
            if found and min(found) < (best, 0):
                best, chosen[place] = min(found)
        if best >= before:
            break
    return chosen


def _badness(information: Array) -> tuple[int, float]:
    """Missing rank, then the condition."""
    rank, condition = rank_and_condition(information)
    return len(information) - rank, condition


def _described(belief: Belief, pool: _Sweeps, chosen: list[int]) -> list[PlannedMove]:
    limits = belief.limits
    moves: list[PlannedMove] = []
    for k in chosen:
        j = int(pool.joint[k])
        name = belief.robot.joint_names[j]
        number = 1 + sum(move.joints == [name] for move in moves)
        low, high = (float(x) for x in pool.ends[k])
        speed = min(SLOW * float(limits.speed[j]), top_speed(limits, j, high - low))
        strokes = there_and_back(limits, j, [speed], (low, high))
        label = f"gravity_{name}_{number}"
        moves.append(stroke_move(belief, label, "gravity", j, pool.posture[k], strokes))
    return moves
