"""Plan the calibration of IMUs: the first joint turns in k postures, then each before an IMU.

An IMU sees the first joint's axis in its own frame (Eq. 29-31). Its mounting follows from k such
directions d_i, and rotations about an axis u have the information sum_i |u x d_i|^2. Postures are
chosen to raise the least information of all rotations and IMUs; levers and scales come with the
other joints.
"""

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.strokes import (
    overloads,
    postures_of,
    reachable,
    reduced_accelerations,
    stroke_move,
    there_and_back,
    top_speed,
)
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.friction import lightest_posture
from seqid_cli.plan.stages.inertia import Planned
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Array

POSTURES = 6  # in which the first joint turns
SPAN = 0.5  # of the range that a swing covers, about its middle


def plan_imu(belief: Belief, options: PlanOptions, *, pool: int = 300) -> Planned:
    """Choose the postures and describe the swings."""
    robot, first = belief.robot, belief.limits.moving[0]
    if not robot.imus:
        hint = "Add an [[imu]] table, or plan another stage."
        raise ConfigError("the robot file lists no IMU", where=str(robot.source), hint=hint)
    rng = np.random.default_rng(options.seed)
    drawn = postures_of(belief.limits, pool, rng)
    reduced, postures, ends = _turned(belief, first, *reachable(belief, first, drawn, SPAN, 0.5))
    chosen = _chosen(_directions(belief, first, postures))
    moves = [
        _swing(reduced, first, postures[k], ends[k], f"_{i}") for i, k in enumerate(chosen, start=1)
    ]
    last = max(imu.after_joint for imu in robot.imus)  # no IMU rides behind later joints
    for j in (j for j in belief.limits.moving[1:] if j <= last):
        own, posture, span = lightest_posture(belief, j, rng, share=SPAN)
        moves.append(_swing(own, j, posture, np.array(span)))
    least = _least_information(_directions(belief, first, postures)[:, chosen])
    notes = [
        f"{imu.name}: turns about the worst axis are told {worst:.2f} times as well as by"
        f" {len(chosen)} directions at right angles to it"
        for imu, worst in zip(robot.imus, least / len(chosen), strict=True)
    ]
    seconds = sum(move.duration_s for move in moves)
    return Planned(moves, PlannedStage(duration_s=seconds, notes=notes))


def _turned(belief: Belief, first: int, drawn: Array, ends: Array) -> tuple[Belief, Array, Array]:
    """The postures in which the first joint can swing, with the acceleration that they allow."""
    for reduced in reduced_accelerations(belief):
        speed = top_speed(reduced.limits, first, float(np.diff(ends).max()))
        fit = overloads(reduced, first, drawn, speed) <= 1.0
        if np.sum(fit) >= POSTURES:
            return reduced, drawn[fit], ends[fit]
    name = belief.robot.joint_names[first]
    message = f"swings of joint {name!r} break a torque limit in nearly all postures"
    hint = "Correct effort in the URDF, or narrow position_limits in the robot file."
    raise ConfigError(message, where=str(belief.robot.source), hint=hint)


def _directions(belief: Belief, first: int, postures: Array) -> Array:
    """The first joint's axis in the frame of each IMU's link (I, P, 3)."""
    frames = forward(belief.robot.chain, postures)
    links = [imu.after_joint for imu in belief.robot.imus]
    seen = [np.einsum("pab,pa->pb", frames.R[:, i], frames.z[:, first]) for i in links]
    return np.array(seen)


def _least_information(directions: Array) -> Array:
    """Least sum (I,) of |u x d|^2 over unit axes u: k minus the largest eigenvalue of sum d d'."""
    spread = np.einsum("ipa,ipb->iab", directions, directions)
    return np.asarray(directions.shape[1] - np.linalg.eigvalsh(spread)[:, -1])


def _chosen(directions: Array) -> list[int]:
    """Postures taken one by one for the worst IMU's worst rotation; the first is the middle."""
    chosen = [0]
    while len(chosen) < min(POSTURES, directions.shape[1]):
        others = [k for k in range(directions.shape[1]) if k not in chosen]
        least = [float(_least_information(directions[:, [*chosen, k]]).min()) for k in others]
        chosen.append(others[int(np.argmax(least))])
    return chosen


def _swing(
    belief: Belief, j: int, posture: Array, ends: Array, label: str = "", *, turns: int = 3
) -> PlannedMove:
    low, high = float(ends[0]), float(ends[1])
    speeds = [top_speed(belief.limits, j, high - low)] * turns
    strokes = there_and_back(belief.limits, j, speeds, (low, high))
    name = f"imu_{belief.robot.joint_names[j]}{label}"
    return stroke_move(belief, name, "imu-calib", j, posture, strokes)
