"""Ways of one joint at constant speed, both ways over its range, all others locked."""

from collections.abc import Sequence
from dataclasses import replace

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
    """Largest speed that joint j can keep over `steady` of `span`: ramps take pi v^2 / (2 a)."""
    ramps = (1.0 - steady) * span
    return float(
        min(limits.speed[j], np.sqrt(2.0 * limits.acceleration[j] * ramps / np.pi))
    )


def gentler(belief: Belief, *, max_halvings: int = 4) -> list[Belief]:
    """The same with accelerations halved, again and again, for loads that leave no more."""
    fastest = belief.limits.acceleration
    eased = (
        replace(belief.limits, acceleration=fastest / 2.0**k)
        for k in range(max_halvings + 1)
    )
    return [replace(belief, limits=own) for own in eased]


def lifted(
    belief: Belief, j: int, postures: Array, span: float, needed: int
) -> tuple[Belief, float, Array]:
    """The largest accelerations with which joint j can sweep over `span` in `needed` postures.

    With them come the speed of the sweep and its largest torques over their limits
    (P,).
    """
    for reduced in gentler(belief):
        speed = top_speed(reduced.limits, j, span)
        load = overloads(reduced, j, postures, speed)
        if np.sum(load <= 1.0) >= needed:
            break
    return reduced, speed, load


def seconds_of(strokes: Sequence[Stroke]) -> float:
    """Time that strokes and the rests between them take, s."""
    return sum(stroke.seconds for stroke in strokes) + REST_S * (len(strokes) + 1)


def stroke_move(
    belief: Belief,
    name: str,
    j: int,
    posture: Array,
    ends: Ends,
    speeds: Sequence[float],
) -> PlannedMove:
    """A move of joint j there and back between two ends at each speed, all others at `posture`."""
    names = belief.robot.joint_names
    acceleration = float(belief.limits.acceleration[j])
    strokes = [
        Stroke(start=start, end=end, speed=float(v), acceleration=acceleration)
        for v in speeds
        for start, end in (ends, ends[::-1])
    ]
    start = posture.copy()
    start[j] = ends[0]
    return PlannedMove(
        name=name,
        stage="",
        joints=[names[j]],
        duration_s=seconds_of(strokes),
        start={name: float(x) for name, x in zip(names, start, strict=True)},
        strokes=strokes,
    )


def reachable(
    belief: Belief, j: int, postures: Array, share: float, widest: float
) -> tuple[Array, Array]:
    """Postures (P, n) in which joint j sweeps almost as far as in any, and the ends (P, 2) rad.

    It sweeps the longest part of its range that touches nothing, within a `share` of
    the range.
    """
    limits = belief.limits
    low, high = limits.lower[j], limits.upper[j]
    middle, half = (low + high) / 2, share * limits.range[j] / 2
    ends = free_ends(belief, j, postures, (middle - half, middle + half))
    width = np.diff(ends)[:, 0]
    if width.max() <= 0.0:
        name = belief.robot.joint_names[j]
        message = f"joint {name!r} touches something in all of {len(postures)} postures"
        hint = (
            "Narrow position_limits, widen --workspace and --keep-out, or, where the"
            " base stands on no floor, plan with --no-floor."
        )
        raise ConfigError(message, where=str(belief.robot.source), hint=hint)
    kept = width >= widest * width.max()
    return postures[kept], ends[kept]


def free_ends(
    belief: Belief, j: int, postures: Array, span: Ends, *, points: int = 60
) -> Array:
    """Return the ends (P, 2) rad of the longest way of joint j that touches nothing.

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
    """
    low = max(float(belief.limits.lower[j]), span[0])
    high = max(min(float(belief.limits.upper[j]), span[1]), low)
    ends = np.tile([low, high], (len(postures), 1))
    if not belief.bounded or low == high:
        return ends
    places = np.linspace(low, high, points)
    free = np.ones((len(postures), points), dtype=bool)
    if belief.floor is not None:
        joint = np.full(len(postures), j)
        same_places = np.tile(places, (len(postures), 1))
        free = belief.floor.height_along(joint, postures, same_places) >= 0.0
    if belief.geometry is not None:
        q = np.repeat(postures[:, None], points, axis=1)
        q[:, :, j] = places
        free[free] = ~belief.geometry.collides(q[free])
    for end, own in zip(ends, free, strict=True):
        first, stop = max(
            runs(own, points), key=lambda run: run[1] - run[0], default=(0, 1)
        )
        end[:] = places[first], places[stop - 1]
    return ends


def sweeps(
    belief: Belief,
    j: int,
    postures: Array,
    speed: float,
    seconds: float,
    ends: Array | None = None,
    *,
    points: int = 9,
) -> Moves:
    """Joint j at `points` positions in each of `postures` (P, n), both ways.

    Between `ends` (P, 2), by default of its range; their information is that of
    `seconds` of it.
    """
    limits = belief.limits
    low, high = (
        (limits.lower[j], limits.upper[j])
        if ends is None
        else (ends[:, :1], ends[:, 1:])
    )
    q = np.repeat(postures[:, None], 2 * points, axis=1)
    q[:, :, j] = low + np.tile(np.linspace(0.0, 1.0, points), 2) * (high - low)
    dq = np.zeros_like(q)
    dq[:, :, j] = np.repeat([speed, -speed], points)
    return Moves(
        np.arange(2 * points) * seconds / (2 * points), q, dq, np.zeros_like(q)
    )


def overloads(belief: Belief, j: int, postures: Array, speed: float) -> Array:
    """Largest torque over its limit (P,) while joint j sweeps, its ramps included."""
    moves, loads = sweeps(belief, j, postures, speed, 1.0), []
    for sign in (1.0, -1.0):
        moves.ddq[:, :, j] = sign * belief.limits.acceleration[j]
        loads.append(belief.overload(moves, belief.regressor(moves)))
    return np.asarray(np.max(loads, axis=0))


def postures_of(limits: Limits, count: int, rng: np.random.Generator) -> Array:
    """Draw postures (count, n) within the limits; the first is in the middle of all ranges."""
    places = rng.uniform(size=(count, len(limits.range)))
    places[0] = 0.5
    return np.asarray(limits.lower + places * limits.range)
