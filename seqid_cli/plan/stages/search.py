"""Search moves for a goal: drawn at random, chosen greedily, refined one by one.

Refinement is by L-BFGS-B on the Fourier coefficients. What is minimised is the product
of the goal, tr(W C), and the condition of the information: of sets with nearly the same
error of the torque the one in which no parameter is left far behind is taken. The
limits hold for every value of the variables, so that bounds are all the constraints;
torque limits and the floor enter as penalties, and a move that breaks them is not
taken. The gradient is by differences, all steps in one batch of regressors.

M moves are drawn as an array (M, n, 2 K + 2), as in `moves.fourier`. Information
(M, b, b) is scaled as the goal scales it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import Bounds, minimize

from seqid_cli.errors import ConfigError
from seqid_cli.motion.planned import COEFFICIENTS, Shapes
from seqid_cli.params.results.plan import HARMONICS, FourierMotion, PlannedMove
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.fourier import COARSE_HZ, EXTENT, PLACE, SPARSE, Moves, placed
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Goal
from seqid_cli.typing import Array, Mask

REDUCTION = 0.5  # factor on the amplitude of a move that needs too much torque


@dataclass(frozen=True)
class SearchResult:
    """Moves that were drawn, chosen and refined.

    Parameters
    ----------
    moves : list of PlannedMove
    samples : Moves
        Their samples at 100 Hz: errors of friction cancel over a move, which few
        samples do not show.
    information : (M, b, b) float
        Scaled information of each.
    """

    moves: list[PlannedMove]
    samples: Moves
    information: Array


def optimised(
    belief: Belief, goal: Goal, options: PlanOptions, have: Array, stage: str
) -> SearchResult:
    """Draw, choose and refine moves for a goal.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    options : PlanOptions
    have : (b, b) float
        Scaled information that is there already.
    stage : str
        What the names of the moves begin with.

    Returns
    -------
    SearchResult
    """
    shapes = Shapes.over(options.length_s, COARSE_HZ)
    count = max(1, int(options.duration_s / options.length_s))
    groups = groups_of(belief.limits, together=options.together)
    rng = np.random.default_rng(options.seed)
    drawn, information = draw_pool(belief, goal, shapes, groups, options.pool, rng)
    check_torque(belief, drawn, options)

    chosen = drawn[choose(goal, information, count, have)]
    refined = refine(belief, goal, shapes, chosen, have, sweeps=options.sweeps)
    moves, samples = within_limits(belief, refined, options, stage)

    # One move at a time: the rows of all would take much memory.
    samples = samples.every(2)
    of_moves = [
        belief.information(move, belief.regressor(move))[0] for move in samples.singly()
    ]
    return SearchResult(moves, samples, goal.scaled(np.array(of_moves)))


def groups_of(limits: Limits, *, together: bool) -> list[tuple[int, ...]]:
    """Return the joints that move at a time: each pair (Sec. 2.2.4), or all of them."""
    moving = tuple(limits.moving)
    if together or len(moving) < 3:
        return [moving]
    return list(combinations(moving, 2))


def assess(belief: Belief, goal: Goal, moves: Moves) -> tuple[Array, Array]:
    """Return what moves tell, and how much torque they need.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    moves : Moves
        At `COARSE_HZ`; one sample in `SPARSE` counts.

    Returns
    -------
    information : (M, b, b) array
        Scaled.
    overload : (M,) array
        Largest torque over its limit; at most 1 is allowed.
    """
    sparse = moves.every(SPARSE)
    H = belief.regressor(sparse)
    information = goal.scaled(belief.information(sparse, H))
    return information, belief.overload(sparse, H)


def draw_pool(
    belief: Belief,
    goal: Goal,
    shapes: Shapes,
    groups: Sequence[tuple[int, ...]],
    size: int,
    rng: np.random.Generator,
    *,
    at_once: int = 60,
    max_times: int = 3,
) -> tuple[Array, Array]:
    """Draw moves of each group of joints in turn.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    shapes : Shapes
    groups : sequence of tuples of int
        Joints that move at a time.
    size : int
        Number of moves that are drawn.
    rng : Generator
    at_once : int
        Moves whose regressor is held at a time.
    max_times : int
        How often a move of too much torque is made smaller. Those that still need too
        much, or that touch something, are left out.

    Returns
    -------
    drawn : (M, n, 2 K + 2) array
    information : (M, b, b) array
        Scaled.
    """
    n = belief.robot.n
    drawn = np.zeros((size, n, COEFFICIENTS + 2))
    # Harmonics have equal speed, which leaves room for wide positions, where gravity
    # shows.
    harmonic = np.repeat(np.arange(1, HARMONICS + 1), 2)
    for k in range(size):
        group = list(groups[k % len(groups)])
        coefficients = rng.uniform(-1.0, 1.0, (len(group), COEFFICIENTS)) / harmonic
        drawn[k, group, :COEFFICIENTS] = coefficients
    drawn[..., PLACE] = rng.uniform(size=(size, n))
    drawn[..., EXTENT] = 1.0

    information = np.empty((size, len(goal.W), len(goal.W)))
    overload = np.empty(size)
    for start in range(0, size, at_once):
        moves = np.arange(start, min(start + at_once, size))
        for _ in range(max_times + 1):
            states = placed(shapes, drawn[moves], belief.limits)
            information[moves], overload[moves] = assess(belief, goal, states)
            moves = moves[overload[moves] > 1.0]
            if not len(moves):
                break
            drawn[moves, :, EXTENT] *= REDUCTION

    is_allowed = overload <= 1.0
    if belief.bounded:
        is_allowed &= ~_still_touching(
            belief, shapes, drawn, information, goal, max_times=max_times
        )
    return drawn[is_allowed], information[is_allowed]


def _still_touching(
    belief: Belief,
    shapes: Shapes,
    drawn: Array,
    information: Array,
    goal: Goal,
    *,
    max_times: int,
) -> Mask:
    """Make moves that touch something smaller, and return which (M,) still do.

    `drawn` and `information` are changed in place.
    """
    moves = np.arange(len(drawn))
    for attempt in range(max_times + 1):
        states = placed(shapes, drawn[moves], belief.limits).every(2)
        moves = moves[belief.collides(states.q)]
        if attempt == max_times or not len(moves):
            break
        drawn[moves, :, EXTENT] *= REDUCTION
        smaller = placed(shapes, drawn[moves], belief.limits)
        information[moves], _ = assess(belief, goal, smaller)
    is_touching = np.zeros(len(drawn), dtype=bool)
    is_touching[moves] = True
    return is_touching


def check_torque(belief: Belief, drawn: Array, options: PlanOptions) -> None:
    """Stop where no move was drawn, naming the joint that the load is too heavy for.

    Parameters
    ----------
    belief : Belief
    drawn : (M, n, 2 K + 2) float
    options : PlanOptions

    Raises
    ------
    ConfigError
        `drawn` is empty.
    """
    if len(drawn):
        return
    rng = np.random.default_rng(options.seed)
    places = rng.uniform(size=(200, belief.robot.n))
    q = (belief.limits.lower + places * belief.limits.range)[:, None]
    at_rest = Moves(np.arange(2.0), q, np.zeros_like(q), np.zeros_like(q))
    load = belief.torque(at_rest, belief.regressor(at_rest)) / belief.limits.torque

    # Where the arm can be held at rest in some posture, it is touching that forbids
    # all moves.
    where = str(belief.robot.source)
    if load.max(axis=(1, 2)).min() <= 1.0 and belief.bounded:
        message = (
            f"no move of {options.pool} keeps the arm off itself, the boxes and the"
            " floor"
        )
        hint = (
            "Narrow position_limits, widen --workspace and --keep-out, or, where the"
            " base stands on no floor, plan with --no-floor."
        )
        raise ConfigError(message, where=where, hint=hint)

    j = int(np.argmax(load.min(axis=(0, 1))))
    joint = belief.robot.joints[j]
    torque = belief.limits.torque[j]
    message = (
        f"no move of {options.pool} keeps the torque limit of joint {joint.name!r}:"
        f" {torque:.4g} {joint.unit('N m')}"
    )
    hint = "Correct effort in the URDF, or lower speeds with a longer --ramp."
    raise ConfigError(message, where=where, hint=hint)


def choose(goal: Goal, information: Array, count: int, have: Array) -> list[int]:
    """Take moves one by one that lower the error most.

    Parameters
    ----------
    goal : Goal
    information : (M, b, b) float
        Scaled information of each move.
    count : int
        Number of moves to take.
    have : (b, b) float
        Scaled information that is there already.

    Returns
    -------
    list of int
        Numbers of the moves, the most useful first.
    """
    chosen: list[int] = []
    total = have
    for _ in range(min(count, len(information))):
        errors = goal.errors(total + information)
        errors[chosen] = np.inf
        best = int(np.argmin(errors))
        chosen.append(best)
        total = total + information[best]
    return chosen


def refine(
    belief: Belief,
    goal: Goal,
    shapes: Shapes,
    chosen: Array,
    have: Array,
    *,
    sweeps: int,
) -> Array:
    """Improve each of the chosen moves with the others held.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    shapes : Shapes
    chosen : (M, n, 2 K + 2) float
        Moves as they are drawn.
    have : (b, b) float
        Scaled information that is there already.
    sweeps : int
        How often all moves are gone through.

    Returns
    -------
    (M, n, 2 K + 2) array
    """
    drawn = chosen.copy()
    information, _ = assess(belief, goal, placed(shapes, drawn, belief.limits))
    total = have + information.sum(axis=0)
    for _ in range(sweeps):
        for k in range(len(drawn)):
            without_k = total - information[k]
            drawn[k] = _improved(belief, goal, shapes, without_k, drawn[k])
            move = placed(shapes, drawn[[k]], belief.limits)
            information[k] = assess(belief, goal, move)[0][0]
            total = without_k + information[k]
    return drawn


def _improved(
    belief: Belief,
    goal: Goal,
    shapes: Shapes,
    other_moves: Array,
    start: Array,
    *,
    iterations: int = 8,
    penalty: float = 100.0,
    low_m: float = 0.1,
    step: float = 1e-4,
) -> Array:
    """Return a better move of the same joints, or the start where none is near.

    Its variables x are the coefficients of the joints that move, then the places of
    all joints.

    Parameters
    ----------
    belief : Belief
    goal : Goal
    shapes : Shapes
    other_moves : (b, b) float
        Scaled information of all other moves.
    start : (n, 2 K + 2) float
        The move as it is drawn.
    iterations : int
        Of L-BFGS-B.
    penalty, low_m : float, float
        A move that comes `low_m` [m] below the floor, or needs twice the torque limit,
        raises the logarithm of what is minimised by `penalty`.
    step : float
        Of the differences that the gradient is made of.

    Returns
    -------
    (n, 2 K + 2) array
    """
    n = len(start)
    moving = np.flatnonzero(start[:, :COEFFICIENTS].any(axis=1))

    def drawn_at(x: Array) -> Array:
        """Return the moves (P, n, 2 K + 2) at variables x (P, X)."""
        drawn = np.repeat(start[None], len(x), axis=0)
        coefficients = x[:, :-n].reshape(len(x), -1, COEFFICIENTS)
        drawn[:, moving, :COEFFICIENTS] = coefficients
        drawn[..., PLACE] = x[:, -n:]
        return drawn

    def values(x: Array) -> Array:
        """Return log goal and condition (P,), with penalties on torque and floor."""
        moves = placed(shapes, drawn_at(x), belief.limits)
        information, overload = assess(belief, goal, moves)
        total = other_moves + information
        merit = np.log(goal.errors(total)) + goal.log_condition(total)

        depth_m = belief.depth(moves.every(SPARSE).q)
        excess = np.maximum(overload - 1.0, 0.0) ** 2 + (depth_m / low_m) ** 2
        return np.asarray(merit + penalty * excess)

    def with_gradient(x: Array) -> tuple[float, Array]:
        """Return value and gradient, by steps that lead inwards from the bounds."""
        steps = np.where(x > 0, -step, step)
        batch = values(np.vstack([x, x + np.diag(steps)]))
        return float(batch[0]), (batch[1:] - batch[0]) / steps

    x = np.append(start[moving, :COEFFICIENTS].ravel(), start[:, PLACE])
    n_coefficients = len(x) - n
    lower = np.append(np.full(n_coefficients, -1.0), np.zeros(n))
    result = minimize(
        with_gradient,
        x,
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(lower, np.ones(len(x))),
        options={"maxiter": iterations},
    )

    better = drawn_at(np.asarray(result.x)[None])
    moves = placed(shapes, better, belief.limits)
    if result.fun >= values(x[None])[0]:
        return start
    _, overload = assess(belief, goal, moves)
    if overload[0] > 1.0 or belief.collides(moves.q)[0]:
        return start
    return np.asarray(better[0])


def within_limits(
    belief: Belief,
    drawn: Array,
    options: PlanOptions,
    stage: str,
    *,
    most: int = 40,
    dense_hz: float = 200.0,
) -> tuple[list[PlannedMove], Moves]:
    """Make moves smaller until torques hold on dense samples and nothing is touched.

    Parameters
    ----------
    belief : Belief
    drawn : (M, n, 2 K + 2) float
    options : PlanOptions
    stage : str
        What the names of the moves begin with.
    most : int
        How often a move is made smaller. Those that touch something even then are left
        out.
    dense_hz : float
        Rate of the samples [Hz].

    Returns
    -------
    planned : list of PlannedMove
    moves : Moves
        Their dense samples.
    """
    shapes = Shapes.over(options.length_s, dense_hz)
    drawn = drawn.copy()
    too_large = np.arange(len(drawn))
    for _ in range(most + 1):
        moves = placed(shapes, drawn, belief.limits)
        candidates = moves[too_large]
        overload = np.array(
            [belief.overload(x, belief.regressor(x))[0] for x in candidates.singly()]
        )
        too_large = too_large[(overload > 1.0) | belief.collides(candidates.every(4).q)]
        if not len(too_large):
            break
        drawn[too_large, :, EXTENT] *= 1.0 - (1.0 - REDUCTION) / 10

    allowed = np.delete(np.arange(len(drawn)), too_large)
    planned = []
    for number, k in enumerate(allowed, start=1):
        move = _described(
            belief,
            shapes,
            drawn[k],
            moves.q[k],
            name=f"{stage}_{number:02d}",
            duration_s=options.length_s,
        )
        planned.append(move)
    return planned, moves[allowed]


def _described(
    belief: Belief,
    shapes: Shapes,
    drawn: Array,
    q: Array,
    *,
    name: str,
    duration_s: float,
) -> PlannedMove:
    """Return a move (n, 2 K + 2) as the plan file has it.

    `q` (N, n) are its positions [rad; m where prismatic]. Its `name` is completed by
    the joints that move.
    """
    names = belief.robot.joint_names
    moving = np.flatnonzero(drawn[:, :COEFFICIENTS].any(axis=1)).tolist()
    joints = [names[j] for j in moving]
    label = "__".join(joints) if len(joints) < 3 else "all"
    return PlannedMove(
        name=f"{name}_{label}",
        stage="",
        joints=joints,
        duration_s=duration_s,
        start={
            joint: float(position) for joint, position in zip(names, q[0], strict=True)
        },
        fourier={
            names[j]: _fourier_motion(shapes, drawn[j, :COEFFICIENTS], q[:, j])
            for j in moving
        },
    )


def _fourier_motion(shapes: Shapes, coefficients: Array, q: Array) -> FourierMotion:
    """Return the scaled coefficients of a joint, found from its motion q (N,)."""
    y = coefficients @ shapes.y
    centre = float(q[0])  # the window is zero at the ends
    amplitude = float(y @ (q - centre) / (y @ y))
    scaled = amplitude * coefficients
    return FourierMotion(
        centre=centre, sine=scaled[0::2].tolist(), cosine=scaled[1::2].tolist()
    )
