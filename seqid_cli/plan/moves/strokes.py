"""Ways of one joint at constant speed, both ways over its range, all others locked.

A stroke gets up to its speed v and back to rest in cosine ramps of acceleration a. Each
ramp takes a way of pi v^2 / (4 a).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.planned import REST_S
from seqid_cli.params.results.plan import PlannedMove, Stroke
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.typing import Array

Ends = tuple[float, float]  # of one joint's way, rad; m where prismatic


def top_speed(limits: Limits, j: int, span: float, *, steady: float = 0.5) -> float:
    """Return the largest speed that a joint can keep over most of a way.

    Parameters
    ----------
    limits : Limits
    j : int
        The joint.
    span : float
        Width of the way [rad; m where prismatic]. Both ramps together take
        pi v^2 / (2 a) of it.
    steady : float
        Share of the way over which the speed is kept.

    Returns
    -------
    float
        [rad/s; m/s where prismatic].
    """
    ramps = (1.0 - steady) * span
    by_acceleration = np.sqrt(2.0 * limits.acceleration[j] * ramps / np.pi)
    return float(min(limits.speed[j], by_acceleration))


def gentler(belief: Belief, *, max_halvings: int = 4) -> list[Belief]:
    """Return beliefs with accelerations halved, again and again, for heavy loads."""
    fastest = belief.limits.acceleration
    beliefs = []
    for k in range(max_halvings + 1):
        limits = replace(belief.limits, acceleration=fastest / 2.0**k)
        beliefs.append(replace(belief, limits=limits))
    return beliefs


@dataclass(frozen=True)
class Lifted:
    """Sweeps of one joint with the largest accelerations that its load allows.

    Parameters
    ----------
    belief : Belief
        With these accelerations.
    speed : float
        Speed of the sweeps [rad/s; m/s where prismatic].
    overload : (P,) float
        Largest torque over its limit in each posture; at most 1 is allowed.
    """

    belief: Belief
    speed: float
    overload: Array


def lifted(belief: Belief, j: int, postures: Array, span: float, needed: int) -> Lifted:
    """Find the largest accelerations with which joint j can sweep in enough postures.

    Parameters
    ----------
    belief : Belief
    j : int
        The joint that sweeps.
    postures : (P, n) float
        Where the other joints are locked [rad; m where prismatic].
    span : float
        Width of the sweep [rad; m where prismatic].
    needed : int
        Postures in which torques must keep their limits. With the least accelerations
        there may be fewer.

    Returns
    -------
    Lifted
    """
    for eased in gentler(belief):
        speed = top_speed(eased.limits, j, span)
        overload = overloads(eased, j, postures, speed)
        if np.sum(overload <= 1.0) >= needed:
            break
    return Lifted(belief=eased, speed=speed, overload=overload)


def seconds_of(strokes: Sequence[Stroke]) -> float:
    """Return the time that strokes and the rests between them take [s]."""
    return sum(stroke.seconds for stroke in strokes) + REST_S * (len(strokes) + 1)


def stroke_move(
    belief: Belief,
    name: str,
    j: int,
    posture: Array,
    ends: Ends,
    speeds: Sequence[float],
) -> PlannedMove:
    """Return a move of one joint there and back at each speed, all others locked.

    Parameters
    ----------
    belief : Belief
    name : str
        Name of the move.
    j : int
        The joint that moves.
    posture : (n,) float
        Where the other joints are locked [rad; m where prismatic].
    ends : Ends
        Ends of the way [rad; m where prismatic].
    speeds : sequence of float
        Speeds, in the order in which they are driven [rad/s; m/s where prismatic].

    Returns
    -------
    PlannedMove
    """
    acceleration = float(belief.limits.acceleration[j])
    strokes = []
    for speed in speeds:
        for start, end in (ends, ends[::-1]):
            stroke = Stroke(
                start=start, end=end, speed=float(speed), acceleration=acceleration
            )
            strokes.append(stroke)

    names = belief.robot.joint_names
    first_posture = posture.copy()
    first_posture[j] = ends[0]
    return PlannedMove(
        name=name,
        stage="",
        joints=[names[j]],
        duration_s=seconds_of(strokes),
        start={
            joint: float(position)
            for joint, position in zip(names, first_posture, strict=True)
        },
        strokes=strokes,
    )


def reachable(
    belief: Belief, j: int, postures: Array, share: float, widest: float
) -> tuple[Array, Array]:
    """Return the postures in which joint j sweeps almost as far as in any.

    It sweeps the longest part of its range that touches nothing.

    Parameters
    ----------
    belief : Belief
    j : int
    postures : (P, n) float
        Where the other joints are locked [rad; m where prismatic].
    share : float
        Share of the range that a sweep may use, about its middle.
    widest : float
        Share of the widest sweep from which a posture counts.

    Returns
    -------
    postures : (Q, n) array
    ends : (Q, 2) array
        Ends of the sweep in each of them [rad; m where prismatic].

    Raises
    ------
    ConfigError
        The joint touches something in all postures.
    """
    limits = belief.limits
    middle = (limits.lower[j] + limits.upper[j]) / 2
    half_range = share * limits.range[j] / 2
    span = (middle - half_range, middle + half_range)
    ends = free_ends(belief, j, postures, span)

    width = np.diff(ends)[:, 0]
    if width.max() <= 0.0:
        name = belief.robot.joint_names[j]
        message = f"joint {name!r} touches something in all of {len(postures)} postures"
        hint = (
            "Narrow position_limits, widen --workspace and --keep-out, or, where the"
            " base stands on no floor, plan with --no-floor."
        )
        raise ConfigError(message, where=str(belief.robot.source), hint=hint)
    is_wide = width >= widest * width.max()
    return postures[is_wide], ends[is_wide]


def free_ends(
    belief: Belief, j: int, postures: Array, span: Ends, *, points: int = 60
) -> Array:
    """Return the ends of the longest way of joint j that touches nothing.

    Parameters
    ----------
    belief : Belief
    j : int
    postures : (P, n) float
        Where the other joints are locked [rad; m where prismatic].
    span : Ends
        Where the way has to stay; its ends are equal where all of that touches
        something.
    points : int
        Places of the way that are looked at.

    Returns
    -------
    (P, 2) array
        [rad; m where prismatic].
    """
    low = max(float(belief.limits.lower[j]), span[0])
    high = max(min(float(belief.limits.upper[j]), span[1]), low)
    ends = np.tile([low, high], (len(postures), 1))
    if not belief.bounded or low == high:
        return ends

    # Shapes are dear to check: only places above the floor are.
    places = np.linspace(low, high, points)
    is_free = np.ones((len(postures), points), dtype=bool)
    if belief.floor is not None:
        joint = np.full(len(postures), j)
        same_places = np.tile(places, (len(postures), 1))
        is_free = belief.floor.height_along(joint, postures, same_places) >= 0.0
    if belief.geometry is not None:
        q = np.repeat(postures[:, None], points, axis=1)
        q[:, :, j] = places
        is_free[is_free] = ~belief.geometry.collides(q[is_free])

    for k, free_places in enumerate(is_free):
        first, stop = max(
            runs(free_places, points), key=lambda run: run[1] - run[0], default=(0, 1)
        )
        ends[k] = places[first], places[stop - 1]
    return ends


def sweeps(
    belief: Belief,
    j: int,
    postures: Array,
    speed: float,
    seconds: float,
    *,
    points: int = 9,
) -> Moves:
    """Return samples of sweeps of joint j over its range, both ways.

    Parameters
    ----------
    belief : Belief
    j : int
    postures : (P, n) float
        Where the other joints are locked [rad; m where prismatic].
    speed : float
        Speed of the sweep [rad/s; m/s where prismatic].
    seconds : float
        Time that all samples of a sweep stand for [s].
    points : int
        Positions in each direction.

    Returns
    -------
    Moves
        P moves of 2 `points` samples each, without acceleration.
    """
    limits = belief.limits
    width = limits.upper[j] - limits.lower[j]
    share = np.tile(np.linspace(0.0, 1.0, points), 2)
    q = np.repeat(postures[:, None], 2 * points, axis=1)
    q[:, :, j] = limits.lower[j] + share * width
    dq = np.zeros_like(q)
    dq[:, :, j] = np.repeat([speed, -speed], points)
    t = np.arange(2 * points) * seconds / (2 * points)
    return Moves(t, q, dq, np.zeros_like(q))


def overloads(belief: Belief, j: int, postures: Array, speed: float) -> Array:
    """Return the largest torque over its limit while a joint sweeps its range.

    The accelerations of its ramps count in both directions, at all positions.

    Parameters
    ----------
    belief : Belief
    j : int
        The joint that sweeps.
    postures : (P, n) float
        Where the other joints are locked [rad; m where prismatic].
    speed : float
        Speed of the sweep [rad/s; m/s where prismatic].

    Returns
    -------
    (P,) array
        At most 1 is allowed.
    """
    moves = sweeps(belief, j, postures, speed, 1.0)
    loads = []
    for sign in (1.0, -1.0):
        moves.ddq[:, :, j] = sign * belief.limits.acceleration[j]
        loads.append(belief.overload(moves, belief.regressor(moves)))
    return np.asarray(np.max(loads, axis=0))


def postures_of(limits: Limits, count: int, rng: np.random.Generator) -> Array:
    """Draw postures (count, n) within the limits, the first amid all ranges."""
    places = rng.uniform(size=(count, len(limits.range)))
    places[0] = 0.5
    return np.asarray(limits.lower + places * limits.range)
