"""Plan the stages in which one joint moves at a time at steady speeds: friction and IMUs.

Friction: every joint over its range, both ways, at many speeds, in the posture that
loads it least, so that friction shows most clearly.

IMUs: the first joint turns in k postures, then each before an IMU. An IMU sees the
first joint's axis in its own frame (Eq. 29-31). Its mounting follows from k such
directions d_i, and rotations about an axis u have the information sum_i |u x d_i|^2.
Postures are chosen to raise the least information of all rotations and IMUs; levers and
scales come with the other joints.
"""

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves import strokes
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.robot.kinematics import forward
from seqid_cli.typing import Array

POSTURES = 6  # in which the first joint turns for the IMUs
SPAN = 0.5  # of the range that a swing for the IMUs covers, about its middle


def plan_friction(
    belief: Belief,
    options: PlanOptions,
    *,
    slowest: float = 0.08,
    speeds_per_joint: int = 10,
) -> Planned:
    """Move each joint in the posture that loads it least."""
    rng = np.random.default_rng(options.seed)
    moves, errors = [], {}
    for j in belief.limits.moving:
        name = belief.robot.joint_names[j]
        reduced, posture, ends = lightest_posture(belief, j, rng)
        top = strokes.top_speed(reduced.limits, j, ends[1] - ends[0])
        speeds = np.geomspace(slowest * top, top, speeds_per_joint).tolist()
        moves.append(
            strokes.stroke_move(reduced, f"friction_{name}", j, posture, ends, speeds)
        )
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

    The sweep covers `share` of the range, about its middle, as far as it touches
    nothing: postures count in which it reaches `widest` of the farthest. Before the
    posture comes the belief with the acceleration that the load allows, behind it the
    ends of the sweep, rad.
    """
    drawn = strokes.postures_of(belief.limits, most_postures, rng)
    postures, ends = strokes.reachable(belief, j, drawn, share, widest)
    reduced, speed, load = strokes.lifted(
        belief, j, postures, float(ends[0, 1] - ends[0, 0]), 1
    )
    best = int(np.argmin(load))
    if load[best] <= 1.0:
        return (
            reduced,
            np.asarray(postures[best]),
            (float(ends[best, 0]), float(ends[best, 1])),
        )
    names = belief.robot.joint_names
    swept = strokes.sweeps(reduced, j, postures[[best]], speed, 1.0)
    most = (
        reduced.torque(swept, reduced.regressor(swept)).max(axis=(0, 1))
        / reduced.limits.torque
    )
    message = (
        f"a sweep of joint {names[j]!r} breaks the torque limit of joint"
        f" {names[int(np.argmax(most))]!r} in all of {most_postures} postures"
    )
    hint = "Correct effort in the URDF, or narrow position_limits in the robot file."
    raise ConfigError(message, where=str(belief.robot.source), hint=hint)


def plan_imu(belief: Belief, options: PlanOptions, *, pool: int = 300) -> Planned:
    """Choose the postures in which the first joint swings, and swing the others before an IMU."""
    robot, first = belief.robot, belief.limits.moving[0]
    if not robot.imus:
        hint = "Add an [[imu]] table, or plan another stage."
        raise ConfigError(
            "the robot file lists no IMU", where=str(robot.source), hint=hint
        )
    rng = np.random.default_rng(options.seed)
    drawn = strokes.postures_of(belief.limits, pool, rng)
    drawn, ends = strokes.reachable(belief, first, drawn, SPAN, 0.5)
    reduced, _, load = strokes.lifted(
        belief, first, drawn, float(np.diff(ends).max()), POSTURES
    )
    fit = load <= 1.0
    if np.sum(fit) < POSTURES:
        name = robot.joint_names[first]
        message = (
            f"swings of joint {name!r} break a torque limit in nearly all postures"
        )
        hint = (
            "Correct effort in the URDF, or narrow position_limits in the robot file."
        )
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
        least = [
            float(_least_information(directions[:, [*chosen, k]]).min()) for k in others
        ]
        chosen.append(others[int(np.argmax(least))])
    numbered = enumerate(chosen, start=1)
    moves = [_swing(reduced, first, postures[k], ends[k], f"_{i}") for i, k in numbered]
    # No IMU rides behind later joints.
    for j in (j for j in belief.limits.moving[1:] if j <= max(links)):
        own, posture, span = lightest_posture(belief, j, rng, share=SPAN)
        moves.append(_swing(own, j, posture, np.array(span)))
    shares = _least_information(directions[:, chosen]) / len(chosen)
    notes = [
        f"{imu.name}: turns about the worst axis are told {worst:.2f} times as well as"
        f" by {len(chosen)} directions at right angles to it"
        for imu, worst in zip(robot.imus, shares, strict=True)
    ]
    return Planned(moves, PlannedStage(notes=notes))


def _least_information(directions: Array) -> Array:
    """Least sum (I,) of |u x d|^2 over unit axes u: k minus the largest eigenvalue of sum d d'."""
    spread = np.einsum("ipa,ipb->iab", directions, directions)
    return np.asarray(directions.shape[1] - np.linalg.eigvalsh(spread)[:, -1])


def _swing(
    belief: Belief,
    j: int,
    posture: Array,
    ends: Array,
    label: str = "",
    *,
    turns: int = 3,
) -> PlannedMove:
    low, high = float(ends[0]), float(ends[1])
    speeds = [strokes.top_speed(belief.limits, j, high - low)] * turns
    name = f"imu_{belief.robot.joint_names[j]}{label}"
    return strokes.stroke_move(belief, name, j, posture, (low, high), speeds)
