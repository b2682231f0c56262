"""Plan the friction stage: every joint by itself over its range, both ways, at many speeds."""

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import PlannedStage
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.strokes import (
    overloads,
    postures_of,
    reachable,
    reduced_accelerations,
    seconds_of,
    stroke_move,
    sweeps,
    there_and_back,
    top_speed,
)
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.inertia import Planned
from seqid_cli.robot.types import Array


def plan_friction(
    belief: Belief, options: PlanOptions, *, slowest: float = 0.08, speeds_per_joint: int = 10
) -> Planned:
    """Move each joint in the posture that loads it least, so that friction shows most clearly.

    `torque_error` of the stage is the error of the mean friction at the fastest speed by noise.
    """
    rng = np.random.default_rng(options.seed)
    moves, errors = [], {}
    for j in belief.limits.moving:
        name = belief.robot.joint_names[j]
        reduced, posture, ends = lightest_posture(belief, j, rng)
        top = top_speed(reduced.limits, j, ends[1] - ends[0])
        speeds = np.geomspace(slowest * top, top, speeds_per_joint).tolist()
        strokes = there_and_back(reduced.limits, j, speeds, ends)
        moves.append(stroke_move(reduced, f"friction_{name}", "friction", j, posture, strokes))
        errors[name] = float(1.0 / np.sqrt(belief.density[j] * seconds_of(strokes[-2:])))
    seconds = sum(move.duration_s for move in moves)
    return Planned(moves, PlannedStage(torque_error=errors, duration_s=seconds))


def lightest_posture(
    belief: Belief,
    j: int,
    rng: np.random.Generator,
    *,
    share: float = 1.0,
    widest: float = 0.9,
    most_postures: int = 60,
) -> tuple[Belief, Array, tuple[float, float]]:
    """The posture (n,) of those drawn in which a sweep of joint j needs least of the torques.

    The sweep covers `share` of the range, about its middle, as far as it touches nothing: postures
    count in which it reaches `widest` of the farthest. Before the posture comes the belief with the
    acceleration that the load allows, behind it the ends of the sweep, rad.
    """
    postures, ends = reachable(
        belief, j, postures_of(belief.limits, most_postures, rng), share, widest
    )
    for reduced in reduced_accelerations(belief):
        speed = top_speed(reduced.limits, j, float(ends[0, 1] - ends[0, 0]))
        load = overloads(reduced, j, postures, speed)
        best = int(np.argmin(load))
        if load[best] <= 1.0:
            return reduced, np.asarray(postures[best]), (float(ends[best, 0]), float(ends[best, 1]))
    names = belief.robot.joint_names
    swept = sweeps(reduced, j, postures[[best]], speed, 1.0)
    load = reduced.torque(swept, reduced.regressor(swept)).max(axis=(0, 1)) / reduced.limits.torque
    message = (
        f"a sweep of joint {names[j]!r} breaks the torque limit of joint"
        f" {names[int(np.argmax(load))]!r} in all of {most_postures} postures"
    )
    hint = "Correct effort in the URDF, or narrow position_limits in the robot file."
    raise ConfigError(message, where=str(belief.robot.source), hint=hint)
