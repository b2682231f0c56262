"""Search moves for a goal: drawn at random, chosen greedily, refined one after the other.

Refinement is by L-BFGS-B on the Fourier coefficients. What is minimised is the product
of the goal, tr(W C), and the condition of the information: of sets with nearly the same
error of the torque the one in which no parameter is left far behind is taken. The
limits hold for every value of the variables, so that bounds are all the constraints;
torque limits and the floor enter as penalties, and a move that breaks them is not
taken. The gradient is by differences, all steps in one batch of regressors.
"""

from collections.abc import Sequence
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


def optimised(
    belief: Belief, goal: Goal, options: PlanOptions, known: Array, stage: str
) -> tuple[list[PlannedMove], Moves, Array]:
    """Draw, choose and refine moves for a goal; with them come their samples and information.

    Samples are dense: errors of friction cancel over a move, which few samples do not
    show. The information (M, b, b) is scaled, as is `known` (b, b), which is there
    already.
    """
    shapes = Shapes.over(options.length_s, COARSE_HZ)
    count = max(1, int(options.duration_s / options.length_s))
    groups = groups_of(belief.limits, together=options.together)
    rng = np.random.default_rng(options.seed)
    drawn, information = draw_pool(belief, goal, shapes, groups, options.pool, rng)
    check_torque(belief, drawn, options)
    chosen = drawn[choose(goal, information, count, known)]
    refined = refine(belief, goal, shapes, chosen, known, sweeps=options.sweeps)
    moves, sampled = within_limits(belief, refined, options, stage)
    dense = sampled.every(2)
    each = [belief.information(one, belief.regressor(one))[0] for one in dense.singly()]
    return moves, dense, goal.scaled(np.array(each))


def groups_of(limits: Limits, *, together: bool) -> list[tuple[int, ...]]:
    """Joints that move at a time: every pair (Sec. 2.2.4), or all of them."""
    free = tuple(limits.moving)
    return [free] if together or len(free) < 3 else list(combinations(free, 2))


def assess(belief: Belief, goal: Goal, moves: Moves) -> tuple[Array, Array]:
    """Scaled information (M, b, b) of moves, and the largest torque over its limit (M,)."""
    some = moves.every(SPARSE)
    H = belief.regressor(some)
    return goal.scaled(belief.information(some, H)), belief.overload(some, H)


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
    """Draw moves of each group in turn; with them comes their scaled information (M, b, b).

    Moves of too much torque are made smaller `max_times` at most; those that still need
    too much or that collide are left out. Harmonics have equal speed, which leaves room
    for wide positions, where gravity shows.
    """
    n, b = belief.robot.n, len(goal.W)
    drawn = np.zeros((size, n, COEFFICIENTS + 2))
    harmonic = np.repeat(np.arange(1, HARMONICS + 1), 2)
    for k in range(size):
        group = list(groups[k % len(groups)])
        coefficients = rng.uniform(-1.0, 1.0, (len(group), COEFFICIENTS)) / harmonic
        drawn[k, group, :COEFFICIENTS] = coefficients
    drawn[..., PLACE], drawn[..., EXTENT] = rng.uniform(size=(size, n)), 1.0
    information, overload = np.empty((size, b, b)), np.empty(size)
    for start in range(0, size, at_once):
        where = np.arange(start, min(start + at_once, size))
        for _ in range(max_times + 1):
            moves = placed(shapes, drawn[where], belief.limits)
            information[where], overload[where] = assess(belief, goal, moves)
            where = where[overload[where] > 1.0]
            if not len(where):
                break
            drawn[where, :, EXTENT] *= REDUCTION
    kept = overload <= 1.0
    if belief.bounded:
        kept &= ~_out_of_reach(
            belief, shapes, drawn, information, goal, max_times=max_times
        )
    return drawn[kept], information[kept]


def _out_of_reach(
    belief: Belief,
    shapes: Shapes,
    drawn: Array,
    information: Array,
    goal: Goal,
    *,
    max_times: int,
) -> Mask:
    """Make drawn moves that touch something smaller, and return those (M,) that still do.

    `drawn` and `information` are changed in place.
    """
    where = np.arange(len(drawn))
    for attempt in range(max_times + 1):
        moves = placed(shapes, drawn[where], belief.limits).every(2)
        where = where[belief.collides(moves.q)]
        if attempt == max_times or not len(where):
            break
        drawn[where, :, EXTENT] *= REDUCTION
        information[where] = assess(
            belief, goal, placed(shapes, drawn[where], belief.limits)
        )[0]
    touching = np.zeros(len(drawn), dtype=bool)
    touching[where] = True
    return touching


def check_torque(belief: Belief, drawn: Array, options: PlanOptions) -> None:
    """Stop where no move was drawn, naming the joint that the load is too heavy for."""
    if len(drawn):
        return
    places = np.random.default_rng(options.seed).uniform(size=(200, belief.robot.n))
    q = (belief.limits.lower + places * belief.limits.range)[:, None]
    still = Moves(np.arange(2.0), q, np.zeros_like(q), np.zeros_like(q))
    load = belief.torque(still, belief.regressor(still)) / belief.limits.torque
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
    joint, torque = belief.robot.joints[j], belief.limits.torque[j]
    limit = f"torque limit of joint {joint.name!r}: {torque:.4g} {joint.unit('N m')}"
    hint = "Correct effort in the URDF, or lower speeds with a longer --ramp."
    raise ConfigError(
        f"no move of {options.pool} keeps the {limit}", where=where, hint=hint
    )


def choose(goal: Goal, information: Array, count: int, have: Array) -> list[int]:
    """Take moves one by one that lower the error most on top of `have` (b, b); all is scaled."""
    chosen: list[int] = []
    total = have
    for _ in range(min(count, len(information))):
        errors = goal.errors(total + information)
        errors[chosen] = np.inf
        chosen.append(int(np.argmin(errors)))
        total = total + information[chosen[-1]]
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
    """Improve each of the `chosen` moves with the others held, `sweeps` times; `have` is scaled."""
    drawn = chosen.copy()
    information, _ = assess(belief, goal, placed(shapes, drawn, belief.limits))
    total = have + information.sum(axis=0)
    for _ in range(sweeps):
        for k in range(len(drawn)):
            rest = total - information[k]
            drawn[k] = _improved(belief, goal, shapes, rest, drawn[k])
            information[k] = assess(
                belief, goal, placed(shapes, drawn[[k]], belief.limits)
            )[0][0]
            total = rest + information[k]
    return drawn


def _improved(
    belief: Belief,
    goal: Goal,
    shapes: Shapes,
    rest: Array,
    start: Array,
    *,
    iterations: int = 8,
    penalty: float = 100.0,
    low_m: float = 0.1,
    step: float = 1e-4,
) -> Array:
    """A better move (n, 2 K + 2) of the same joints, or the `start` where there is none near.

    Its variables are the coefficients of the joints that move and the places of all;
    `rest` (b, b) is the information of all other moves.
    """
    moving, n = np.flatnonzero(start[:, :COEFFICIENTS].any(axis=1)), len(start)

    def moves_of(x: Array) -> tuple[Array, Moves]:
        drawn = np.repeat(start[None], len(x), axis=0)
        drawn[:, moving, :COEFFICIENTS] = x[:, :-n].reshape(len(x), -1, COEFFICIENTS)
        drawn[..., PLACE] = x[:, -n:]
        return drawn, placed(shapes, drawn, belief.limits)

    def values(x: Array) -> Array:
        """Log of the goal and of the condition (P,), with the penalty on torque."""
        moves = moves_of(x)[1]
        information, overload = assess(belief, goal, moves)
        total = rest + information
        error = np.log(goal.errors(total)) + goal.log_condition(total)
        too_low = belief.depth(moves.every(SPARSE).q)
        excess = np.maximum(overload - 1.0, 0.0) ** 2 + (too_low / low_m) ** 2
        return np.asarray(error + penalty * excess)

    def with_gradient(x: Array) -> tuple[float, Array]:
        """Value and gradient, by steps that lead inwards from the bounds."""
        steps = np.where(x > 0, -step, step)
        found = values(np.vstack([x, x + np.diag(steps)]))
        return float(found[0]), (found[1:] - found[0]) / steps

    x = np.append(start[moving, :COEFFICIENTS].ravel(), start[:, PLACE])
    box = Bounds(np.append(np.full(len(x) - n, -1.0), np.zeros(n)), np.ones(len(x)))
    found = minimize(
        with_gradient,
        x,
        jac=True,
        method="L-BFGS-B",
        bounds=box,
        options={"maxiter": iterations},
    )
    better, moves = moves_of(np.asarray(found.x)[None])
    worse = found.fun >= values(x[None])[0]
    too_much = assess(belief, goal, moves)[1][0] > 1.0
    return start if worse or too_much or belief.collides(moves.q)[0] else better[0]


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

    Those that touch something even when they are small are left out; the others are
    described, and sampled.
    """
    shapes, drawn = Shapes.over(options.length_s, dense_hz), drawn.copy()
    where = np.arange(len(drawn))
    for _ in range(most + 1):
        moves = placed(shapes, drawn, belief.limits)
        own = moves[where]
        loads = [belief.overload(x, belief.regressor(x))[0] for x in own.singly()]
        where = where[(np.array(loads) > 1.0) | belief.collides(own.every(4).q)]
        if not len(where):
            break
        drawn[where, :, EXTENT] *= 1.0 - (1.0 - REDUCTION) / 10
    kept = np.delete(np.arange(len(drawn)), where)
    names = belief.robot.joint_names

    def fourier(k: int, j: int) -> FourierMotion:
        """The scaled coefficients of joint j in move k, found from the motion itself."""
        coefficients = drawn[k, j, :COEFFICIENTS]
        y = coefficients @ shapes.y
        centre = float(moves.q[k, 0, j])  # the window is zero at the ends
        own = float(y @ (moves.q[k, :, j] - centre) / (y @ y)) * coefficients
        return FourierMotion(
            centre=centre, sine=own[0::2].tolist(), cosine=own[1::2].tolist()
        )

    found = []
    for number, k in enumerate(kept.tolist(), start=1):
        moving = np.flatnonzero(drawn[k, :, :COEFFICIENTS].any(axis=1)).tolist()
        joints = [names[j] for j in moving]
        found.append(
            PlannedMove(
                name=(
                    f"{stage}_{number:02d}_{'__'.join(joints) if len(joints) < 3 else 'all'}"
                ),
                stage="",
                joints=joints,
                duration_s=options.length_s,
                start={
                    name: float(x) for name, x in zip(names, moves.q[k, 0], strict=True)
                },
                fourier={names[j]: fourier(k, j) for j in moving},
            )
        )
    return found, moves[kept]
