"""Plan the stages in which one joint moves at a time at steady speeds: friction, gravity, IMUs.

Friction: every joint over its range, both ways, at many speeds, in the posture that loads it least,
so that friction shows most clearly.

Gravity: postures of the locked joints of least condition (Eq. 20-21). Joints move slowly over their
ranges. Postures are chosen greedily by the torque's error, then exchanged one by one for others of
the pool while that lowers cond(Phi(H_g)).

IMUs: the first joint turns in k postures, then each before an IMU. An IMU sees the first joint's
axis in its own frame (Eq. 29-31). Its mounting follows from k such directions d_i, and rotations
about an axis u have the information sum_i |u x d_i|^2. Postures are chosen to raise the least
information of all rotations and IMUs; levers and scales come with the other joints.
"""

from dataclasses import replace

import msgspec
import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves import strokes
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Goal, Planned, rank_and_condition
from seqid_cli.plan.stages.inertia import rigid_stage
from seqid_cli.plan.stages.search import choose
from seqid_cli.robot.kinematics import forward
from seqid_cli.typing import Array, Index

SLOW = 0.3  # of the largest speed, for gravity
POSTURES = 6  # in which the first joint turns for the IMUs
SPAN = 0.5  # of the range that a swing for the IMUs covers, about its middle


def plan_friction(
    belief: Belief, options: PlanOptions, *, slowest: float = 0.08, speeds_per_joint: int = 10
) -> Planned:
    """Move each joint in the posture that loads it least."""
    rng = np.random.default_rng(options.seed)
    moves, errors = [], {}
    for j in belief.limits.moving:
        name = belief.robot.joint_names[j]
        reduced, posture, ends = lightest_posture(belief, j, rng)
        top = strokes.top_speed(reduced.limits, j, ends[1] - ends[0])
        speeds = np.geomspace(slowest * top, top, speeds_per_joint).tolist()
        moves.append(strokes.stroke_move(reduced, f"friction_{name}", j, posture, ends, speeds))
        fastest = strokes.seconds_of(moves[-1].strokes[-2:])
        # Of the mean friction at the fastest speed, by noise.
        errors[name] = float(1.0 / np.sqrt(belief.density[j] * fastest))
    return Planned(moves, PlannedStage(torque_error=errors))


def lightest_posture(
    belief: Belief,
    j: int,
    rng: np.random.Generator,
    *,
    share: float = 1.0,
    widest: float = 0.9,
    most_postures: int = 60,
) -> tuple[Belief, Array, strokes.Ends]:
    """The posture (n,) of those drawn in which a sweep of joint j needs least of the torques.

    The sweep covers `share` of the range, about its middle, as far as it touches nothing: postures
    count in which it reaches `widest` of the farthest. Before the posture comes the belief with the
    acceleration that the load allows, behind it the ends of the sweep, rad.
    """
    drawn = strokes.postures_of(belief.limits, most_postures, rng)
    postures, ends = strokes.reachable(belief, j, drawn, share, widest)
    reduced, speed, load = strokes.lifted(belief, j, postures, float(ends[0, 1] - ends[0, 0]), 1)
    best = int(np.argmin(load))
    if load[best] <= 1.0:
        return reduced, np.asarray(postures[best]), (float(ends[best, 0]), float(ends[best, 1]))
    names = belief.robot.joint_names
    swept = strokes.sweeps(reduced, j, postures[[best]], speed, 1.0)
    most = reduced.torque(swept, reduced.regressor(swept)).max(axis=(0, 1)) / reduced.limits.torque
    message = (
        f"a sweep of joint {names[j]!r} breaks the torque limit of joint"
        f" {names[int(np.argmax(most))]!r} in all of {most_postures} postures"
    )
    hint = "Correct effort in the URDF, or narrow position_limits in the robot file."
    raise ConfigError(message, where=str(belief.robot.source), hint=hint)


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
    slow = strokes.gentler(fresh)[-1]  # slow sweeps need no more
    rng = np.random.default_rng(options.seed)
    joints, postures, ends, pool, information = _pool(slow, goal, rng)
    nothing, count = np.zeros_like(goal.W), per_joint * len(np.unique(joints))
    chosen = choose(goal, information, count, nothing)
    chosen = _exchanged(joints, information[:, wanted][:, :, wanted], chosen)
    chosen.sort(key=lambda k: -int(joints[k]))
    moves: list[PlannedMove] = []
    for k in chosen:
        j = int(joints[k])
        name = belief.robot.joint_names[j]
        label = f"gravity_{name}_{1 + sum(move.joints == [name] for move in moves)}"
        low, high = (float(x) for x in ends[k])
        top = strokes.top_speed(slow.limits, j, high - low)
        speed = min(SLOW * float(slow.limits.speed[j]), top)
        moves.append(strokes.stroke_move(slow, label, j, postures[k], (low, high), [speed]))
    without = msgspec.structs.replace(stages, gravity=None)
    states, each = pool[np.array(chosen)], information[chosen]
    stage = rigid_stage(fresh, goal, without, states, each, nothing, wanted)
    stage.growth = []
    return Planned(moves, stage, each.sum(axis=0) * np.outer(goal.scale, goal.scale))


def _pool(
    belief: Belief, goal: Goal, rng: np.random.Generator, *, most_postures: int = 60
) -> tuple[Index, Array, Array, Moves, Array]:
    """Sweeps of every joint that moves and that gravity loads, within the torque limits.

    Joints, postures and ends [rad] of M sweeps, their samples and scaled information.
    """
    limits = belief.limits
    parts: list[tuple[Array, ...]] = []
    t = np.zeros(0)
    for j in limits.moving:
        speed = SLOW * float(limits.speed[j])
        drawn = strokes.postures_of(limits, most_postures, rng)
        drawn, ends = strokes.reachable(belief, j, drawn, 1.0, 0.5)
        fit = strokes.overloads(belief, j, drawn, speed) <= 1.0
        drawn, ends = drawn[fit], ends[fit]
        if not len(drawn):
            continue
        swept = strokes.sweeps(belief, j, drawn, speed, 2 * float(limits.range[j]) / speed, ends)
        own = belief.regressor(swept) * (np.arange(belief.robot.n) == j)[:, None]
        own[..., ~belief.basis.gravity] = 0.0
        information = goal.scaled(belief.information(swept, own))
        if information.any():
            t = swept.t if not parts else t
            joint = np.full(len(drawn), j)
            parts.append((joint, drawn, ends, swept.q, swept.dq, swept.ddq, information))
    if not parts:
        message = "no sweep of any joint that gravity loads keeps the torque limits"
        hint = "Correct effort in the URDF."
        raise ConfigError(message, where=str(belief.robot.source), hint=hint)
    joint, posture, ends, *states, information = map(np.concatenate, zip(*parts, strict=True))
    return joint, posture, ends, Moves(t, *states), information


def _exchanged(joints: Index, parts: Array, chosen: list[int], *, rounds: int = 3) -> list[int]:
    """Exchange sweeps for others of the same joint while the condition falls and the rank stays."""
    chosen = list(chosen)

    def badness(information: Array) -> tuple[int, float]:
        """Missing rank, then the condition."""
        rank, condition = rank_and_condition(information)
        return -rank, condition

    best = badness(parts[chosen].sum(axis=0))
    for _ in range(rounds):
        before = best
        for place, k in enumerate(chosen):
            rest = parts[chosen].sum(axis=0) - parts[k]
            others = np.setdiff1d(np.flatnonzero(joints == joints[k]), chosen)
            found = [(badness(rest + parts[int(other)]), int(other)) for other in others]
            if found and min(found) < (best, 0):
                best, chosen[place] = min(found)
        if best >= before:
            break
    return chosen


def plan_imu(belief: Belief, options: PlanOptions, *, pool: int = 300) -> Planned:
    """Choose the postures in which the first joint swings, and swing the others before an IMU."""
    robot, first = belief.robot, belief.limits.moving[0]
    if not robot.imus:
        hint = "Add an [[imu]] table, or plan another stage."
        raise ConfigError("the robot file lists no IMU", where=str(robot.source), hint=hint)
    rng = np.random.default_rng(options.seed)
    drawn = strokes.postures_of(belief.limits, pool, rng)
    drawn, ends = strokes.reachable(belief, first, drawn, SPAN, 0.5)
    reduced, _, load = strokes.lifted(belief, first, drawn, float(np.diff(ends).max()), POSTURES)
    fit = load <= 1.0
    if np.sum(fit) < POSTURES:
        name = robot.joint_names[first]
        message = f"swings of joint {name!r} break a torque limit in nearly all postures"
        hint = "Correct effort in the URDF, or narrow position_limits in the robot file."
        raise ConfigError(message, where=str(robot.source), hint=hint)
    postures, ends = drawn[fit], ends[fit]
    frames = forward(robot.chain, postures)
    links = [imu.after_joint for imu in robot.imus]
    # The first joint's axis in the frame of each IMU's link (I, P, 3).
    seen = [np.einsum("pab,pa->pb", frames.R[:, i], frames.z[:, first]) for i in links]
    directions = np.array(seen)
    chosen = [0]  # the middle
    while len(chosen) < POSTURES:
        others = [k for k in range(len(postures)) if k not in chosen]
        least = [float(_least_information(directions[:, [*chosen, k]]).min()) for k in others]
        chosen.append(others[int(np.argmax(least))])
    numbered = enumerate(chosen, start=1)
    moves = [_swing(reduced, first, postures[k], ends[k], f"_{i}") for i, k in numbered]
    # No IMU rides behind later joints.
    for j in (j for j in belief.limits.moving[1:] if j <= max(links)):
        own, posture, span = lightest_posture(belief, j, rng, share=SPAN)
        moves.append(_swing(own, j, posture, np.array(span)))
    shares = _least_information(directions[:, chosen]) / len(chosen)
    notes = [
        f"{imu.name}: turns about the worst axis are told {worst:.2f} times as well as by"
        f" {len(chosen)} directions at right angles to it"
        for imu, worst in zip(robot.imus, shares, strict=True)
    ]
    return Planned(moves, PlannedStage(notes=notes))


def _least_information(directions: Array) -> Array:
    """Least sum (I,) of |u x d|^2 over unit axes u: k minus the largest eigenvalue of sum d d'."""
    spread = np.einsum("ipa,ipb->iab", directions, directions)
    return np.asarray(directions.shape[1] - np.linalg.eigvalsh(spread)[:, -1])


def _swing(
    belief: Belief, j: int, posture: Array, ends: Array, label: str = "", *, turns: int = 3
) -> PlannedMove:
    low, high = float(ends[0]), float(ends[1])
    speeds = [strokes.top_speed(belief.limits, j, high - low)] * turns
    name = f"imu_{belief.robot.joint_names[j]}{label}"
    return strokes.stroke_move(belief, name, j, posture, (low, high), speeds)
