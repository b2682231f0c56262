"""Plan the stages of one joint at a time at steady speeds: friction and IMUs.

Friction: every joint over its range, both ways, at many speeds, in the posture that
loads it least, so that friction shows most clearly.

IMUs: the first joint turns in k postures, then each before an IMU. An IMU sees the
first joint's axis in its own frame (Eq. 29-31). Its mounting follows from k such
directions d_i, and rotations about an axis u have the information sum_i |u x d_i|^2.
Postures are chosen to raise the least information of all rotations and IMUs; levers and
scales come with the other joints.
"""

from dataclasses import dataclass

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
    """Move each joint in the posture that loads it least.

    Parameters
    ----------
    belief : Belief
    options : PlanOptions
    slowest : float
        The slowest speed, over the fastest.
    speeds_per_joint : int
        Number of speeds, in a geometric series.

    Returns
    -------
    Planned
        Its torque errors are of the mean friction at the fastest speed, by noise.
    """
    rng = np.random.default_rng(options.seed)
    moves = []
    errors = {}
    for j in belief.limits.moving:
        name = belief.robot.joint_names[j]
        sweep = lightest_posture(belief, j, rng)
        limits = sweep.belief.limits
        fastest = strokes.top_speed(limits, j, sweep.ends[1] - sweep.ends[0])
        speeds = np.geomspace(slowest * fastest, fastest, speeds_per_joint).tolist()
        move = strokes.stroke_move(
            sweep.belief, f"friction_{name}", j, sweep.posture, sweep.ends, speeds
        )
        moves.append(move)

        # The last two strokes are those at the fastest speed.
        seconds = strokes.seconds_of(move.strokes[-2:])
        errors[name] = float(1.0 / np.sqrt(belief.information_rate[j] * seconds))
    return Planned(moves, PlannedStage(torque_error=errors))


@dataclass(frozen=True)
class LightSweep:
    """A sweep of one joint in the posture that needs least of the torque limits.

    Parameters
    ----------
    belief : Belief
        With the acceleration that the load allows.
    posture : (n,) float
        Where the other joints are locked [rad; m where prismatic].
    ends : Ends
        Ends of the sweep [rad; m where prismatic].
    """

    belief: Belief
    posture: Array
    ends: strokes.Ends


def lightest_posture(
    belief: Belief,
    j: int,
    rng: np.random.Generator,
    *,
    share: float = 1.0,
    widest: float = 0.9,
    most_postures: int = 60,
) -> LightSweep:
    """Find the posture in which a sweep of joint j needs least of the torque limits.

    Parameters
    ----------
    belief : Belief
    j : int
    rng : Generator
        Draws the postures.
    share : float
        Share of the range that the sweep covers, about its middle, as far as it touches
        nothing.
    widest : float
        Share of the farthest sweep that a posture has to reach.
    most_postures : int
        Number of postures that are drawn.

    Returns
    -------
    LightSweep

    Raises
    ------
    ConfigError
        The sweep breaks a torque limit in all postures.
    """
    drawn = strokes.postures_of(belief.limits, most_postures, rng)
    postures, ends = strokes.reachable(belief, j, drawn, share, widest)
    span = float(ends[0, 1] - ends[0, 0])
    lifted = strokes.lifted(belief, j, postures, span, needed=1)
    best = int(np.argmin(lifted.overload))
    if lifted.overload[best] <= 1.0:
        return LightSweep(
            belief=lifted.belief,
            posture=np.asarray(postures[best]),
            ends=(float(ends[best, 0]), float(ends[best, 1])),
        )

    # The joint that is named is the one whose limit the best posture breaks most.
    eased = lifted.belief
    states = strokes.sweeps(eased, j, postures[[best]], lifted.speed, 1.0)
    torque = eased.torque(states, eased.regressor(states)).max(axis=(0, 1))
    overload = torque / eased.limits.torque
    names = belief.robot.joint_names
    message = (
        f"a sweep of joint {names[j]!r} breaks the torque limit of joint"
        f" {names[int(np.argmax(overload))]!r} in all of {most_postures} postures"
    )
    hint = "Correct effort in the URDF, or narrow position_limits in the robot file."
    raise ConfigError(message, where=str(belief.robot.source), hint=hint)


def plan_imu(belief: Belief, options: PlanOptions, *, pool: int = 300) -> Planned:
    """Choose the postures for swings of the first joint; other joints swing in one.

    Parameters
    ----------
    belief : Belief
    options : PlanOptions
    pool : int
        Number of postures that are drawn to choose from.

    Returns
    -------
    Planned

    Raises
    ------
    ConfigError
        The robot has no IMU, or swings break a torque limit.
    """
    robot = belief.robot
    first = belief.limits.moving[0]
    if not robot.imus:
        hint = "Add an [[imu]] table, or plan another stage."
        raise ConfigError(
            "the robot file lists no IMU", where=str(robot.source), hint=hint
        )

    rng = np.random.default_rng(options.seed)
    drawn = strokes.postures_of(belief.limits, pool, rng)
    postures, ends = strokes.reachable(belief, first, drawn, SPAN, 0.5)
    widest = float(np.diff(ends).max())
    lifted = strokes.lifted(belief, first, postures, widest, needed=POSTURES)
    is_allowed = lifted.overload <= 1.0
    if np.sum(is_allowed) < POSTURES:
        name = robot.joint_names[first]
        message = (
            f"swings of joint {name!r} break a torque limit in nearly all postures"
        )
        hint = (
            "Correct effort in the URDF, or narrow position_limits in the robot file."
        )
        raise ConfigError(message, where=str(robot.source), hint=hint)
    postures = postures[is_allowed]
    ends = ends[is_allowed]

    directions = _axis_directions(belief, first, postures)
    chosen = _spread_directions(directions)
    moves = [
        _swing(lifted.belief, first, postures[k], ends[k], label=f"_{number}")
        for number, k in enumerate(chosen, start=1)
    ]
    # No IMU rides behind later joints.
    last = max(imu.after_joint for imu in robot.imus)
    for j in belief.limits.moving[1:]:
        if j <= last:
            sweep = lightest_posture(belief, j, rng, share=SPAN)
            move = _swing(sweep.belief, j, sweep.posture, np.array(sweep.ends))
            moves.append(move)

    share_of_ideal = _least_information(directions[:, chosen]) / len(chosen)
    notes = [
        f"{imu.name}: turns about the worst axis are told {worst:.2f} times as well as"
        f" by {len(chosen)} directions at right angles to it"
        for imu, worst in zip(robot.imus, share_of_ideal, strict=True)
    ]
    return Planned(moves, PlannedStage(notes=notes))


def _axis_directions(belief: Belief, j: int, postures: Array) -> Array:
    """Return the directions (I, P, 3) of joint j's axis as each IMU's link sees it."""
    frames = forward(belief.robot.chain, postures)
    axis = frames.z[:, j]
    directions = [
        np.einsum("pab,pa->pb", frames.R[:, imu.after_joint], axis)
        for imu in belief.robot.imus
    ]
    return np.array(directions)


def _spread_directions(directions: Array) -> list[int]:
    """Choose postures one by one that raise the least information of all IMUs most."""
    chosen = [0]  # in the middle of all ranges
    while len(chosen) < POSTURES:
        candidates = [k for k in range(directions.shape[1]) if k not in chosen]
        least = [
            float(_least_information(directions[:, [*chosen, k]]).min())
            for k in candidates
        ]
        chosen.append(candidates[int(np.argmax(least))])
    return chosen


def _least_information(directions: Array) -> Array:
    """Return the least sum (I,) of |u x d|^2 over unit axes u, of directions (I, k, 3).

    For unit vectors d it is k minus the largest eigenvalue of the sum of d d'.
    """
    spread = np.einsum("ipa,ipb->iab", directions, directions)
    largest = np.linalg.eigvalsh(spread)[:, -1]
    return np.asarray(directions.shape[1] - largest)


def _swing(
    belief: Belief,
    j: int,
    posture: Array,
    ends: Array,
    label: str = "",
    *,
    turns: int = 3,
) -> PlannedMove:
    """Return swings of joint j between ends (2,) at the largest speed that it keeps."""
    low = float(ends[0])
    high = float(ends[1])
    speeds = [strokes.top_speed(belief.limits, j, high - low)] * turns
    name = f"imu_{belief.robot.joint_names[j]}{label}"
    return strokes.stroke_move(belief, name, j, posture, (low, high), speeds)
