"""Plan the gravity stage: slow sweeps of one joint at a time, the others locked in postures.

Phi(H_g) stacks the rows of the joint that moves, at even times of its steady way. What
the postures of the locked joints are chosen by is Eq. 20 within the limits of Eq. 21,
in two forms at once:

    J = cond(Phi) cond(Phi S),

the condition to the letter (SI units, no weights), and that with columns of length 1 (S
diagonal), which is free of the units. Each by itself leaves the other far from its
best, since many postures are as good for the one; their product brings both to within a
few per cent of their own optima (tests/studies/planned/gravity.py compares).

J has kinks where singular values meet, as they do at its optimum, and a search that
changes one sweep at a time stops at the first of them. So the search goes by a smooth
J_p, in which the largest singular value is a p-norm of all, (sum s^2p)^(1/2p), and the
least one that of their inverses; J_p falls to J as p grows. From several random sets
sweeps are exchanged for others of the same joint out of a pool; then all postures
change at once by L-BFGS-B with p growing; then each is exchanged for postures near its
own, which needs no gradient: there a sweep counts only where it touches nothing and
keeps the torque limits.

Rows count where the gravity stage will count them: within the friction that is known
(`Coverage`).
"""

from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.optimize import Bounds, minimize

from seqid_cli.errors import ConfigError
from seqid_cli.params.results.plan import PlanCriterion, PlannedMove, PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves import strokes
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.nuisance import sweep_terms
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.coverage import Coverage, ramp_way
from seqid_cli.plan.stages.goal import Goal, Planned
from seqid_cli.plan.stages.inertia import StageRows, rigid_stage
from seqid_cli.plan.stages.sweeps import plan_friction
from seqid_cli.robot.base_parameters import gravity_base_regressor
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index, Mask

SLOW = 0.3  # of the largest speed
MINIMISED = "cond(Phi(H_g)) of Eq. 20 times that with columns of length 1"


@dataclass(frozen=True)
class GravityPlan:
    """The sweeps, and the friction trials that they need first, if any."""

    gravity: Planned
    friction: Planned | None = None


@dataclass(frozen=True, kw_only=True)
class Sweeps:
    """Sweeps of one joint each.

    Parameters
    ----------
    joint : (M,) int
        The joint that moves.
    posture : (M, n) float
        Where the others are locked [rad; m where prismatic].
    ends : (M, 2) float
        Ends of the way [rad; m where prismatic].
    information : (M, g, g) float
        Phi(H_g)' Phi(H_g) of each, rows weighted by time alone.
    """

    joint: Index
    posture: Array
    ends: Array
    information: Array

    def __getitem__(self, which: Index) -> "Sweeps":
        """Some of the sweeps."""
        return Sweeps(
            joint=self.joint[which],
            posture=self.posture[which],
            ends=self.ends[which],
            information=self.information[which],
        )

    def replaced(self, place: int, other: "Sweeps") -> "Sweeps":
        """The same with one sweep exchanged for a single other one."""
        parts = {name: value.copy() for name, value in vars(self).items()}
        for name, value in parts.items():
            value[place] = getattr(other, name)[0]
        return Sweeps(**parts)


@dataclass(frozen=True, kw_only=True)
class SweepSpace:
    """What sweeps are drawn from: postures within the limits, ways within what is known.

    `speed` (n,) is that of each joint's sweeps, `span` (n, 2) where their ends may be,
    `steady` (n, 2) the positions that count, `least_width` (n,) the shortest steady way
    that is taken.
    """

    belief: Belief
    joints: list[int]
    speed: Array
    span: Array
    steady: Array
    least_width: Array

    def steady_ends(self, joint: Index, ends: Array) -> Array:
        """Return where sweeps (M, 2) are at speed and friction is known; empty ways have none."""
        acceleration = self.belief.limits.acceleration[joint]
        ramp = np.pi * self.speed[joint] ** 2 / (4.0 * acceleration)
        low = np.maximum(ends[:, 0] + ramp, self.steady[joint, 0])
        high = np.minimum(ends[:, 1] - ramp, self.steady[joint, 1])
        return np.stack([low, np.maximum(high, low)], axis=1)

    def draw(self, j: int, postures: Array) -> Sweeps:
        """Return the sweeps of joint j in postures (P, n), ways as free as they are."""
        joint = np.full(len(postures), j)
        span = float(self.span[j, 0]), float(self.span[j, 1])
        ends = strokes.free_ends(self.belief, j, postures, span)
        return self.with_ends(joint, postures, ends)

    def with_ends(
        self, joint: Index, postures: Array, ends: Array, *, points: int = 9
    ) -> Sweeps:
        """Return sweeps (M,) between ends (M, 2), at `points` positions of each steady way."""
        belief = self.belief
        count, n = postures.shape
        every = np.arange(count)

        # Gravity's torque at a joint is a cos q + b sin q + c in its own angle,
        # constant in its own slide: three places tell all others.
        nodes = np.linspace(0.0, 4.0 * np.pi / 3.0, 3)
        q = np.repeat(postures[:, None], 3, axis=1)
        q[every, :, joint] = nodes
        H = gravity_base_regressor(belief.robot, belief.basis, q.reshape(-1, n))
        at_nodes = H.reshape(count, 3, n, -1)[every, :, joint]
        harmonics: Array = np.linalg.inv(_harmonics(nodes)) @ at_nodes

        steady = self.steady_ends(joint, ends)
        rows = _harmonics(_middles(steady, points)) @ harmonics
        seconds = np.diff(steady)[:, 0] / self.speed[joint]
        information = rows.transpose(0, 2, 1) @ rows * (seconds / points)[:, None, None]
        return Sweeps(joint=joint, posture=postures, ends=ends, information=information)

    def depth(self, sweeps: Sweeps, *, points: int = 9) -> Array:
        """Return how far sweeps (M,) go below the floor at their lowest [m]."""
        if self.belief.floor is None:
            return np.zeros(len(sweeps.joint))
        places = np.linspace(sweeps.ends[:, 0], sweeps.ends[:, 1], points, axis=1)
        height = self.belief.floor.height_along(sweeps.joint, sweeps.posture, places)
        return np.asarray(np.maximum(-height.min(axis=1), 0.0))

    def allowed(self, sweeps: Sweeps) -> Mask:
        """Return which sweeps (M,) are wide enough and keep the torque limits."""
        steady = np.diff(self.steady_ends(sweeps.joint, sweeps.ends))[:, 0]
        wide = (steady >= self.least_width[sweeps.joint]) & (steady > 0.0)
        limits = self.belief.limits
        if self.belief.theta is None or not np.isfinite(limits.torque).any():
            return wide
        for j in np.unique(sweeps.joint):
            own = np.flatnonzero(wide & (sweeps.joint == j))
            if len(own):
                load = strokes.overloads(
                    self.belief, int(j), sweeps.posture[own], float(self.speed[j])
                )
                wide[own] &= load <= 1.0
        return wide


def _middles(ends: Array, parts: int) -> Array:
    """Return the middles (M, parts) of equal parts of ways between ends (M, 2).

    A sum over them is the integral over the way; one that counts the ends like all
    other places makes conditions look better by a tenth.
    """
    share = (np.arange(parts) + 0.5) / parts
    return np.asarray(ends[:, :1] + share * np.diff(ends, axis=1))


def _harmonics(q: Array) -> Array:
    """Return 1, cos q and sin q (..., 3)."""
    return np.stack([np.ones_like(q), np.cos(q), np.sin(q)], axis=-1)


def plan_gravity(
    belief: Belief,
    stages: Stages,
    options: PlanOptions,
    friction: Planned | None = None,
    *,
    per_joint: int = 3,
    worth: float = 0.2,
) -> GravityPlan:
    """Choose sweeps for the gravity parameters; none where gravity loads no joint.

    Parameters
    ----------
    belief : Belief
    stages : Stages
        What is identified already: sweeps keep to its friction.
    options : PlanOptions
    friction : Planned, optional
        Friction trials that are planned already, where no friction is given.
    per_joint : int
        Sweeps of each joint that gravity loads.
    worth : float
        Share by which the torque's error has to fall for friction trials over a wider
        range to be worth their time.
    """
    wanted = belief.basis.gravity
    if not wanted.any():
        note = "gravity loads no joint of this robot: nothing to record"
        return GravityPlan(
            Planned([], PlannedStage(rank=0, structural_rank=0, notes=[note]))
        )
    fresh = replace(belief, prior=np.zeros_like(belief.prior))
    given = stages.friction is not None
    if given:
        coverage = Coverage.of_surfaces(fresh)
    else:
        friction = friction or plan_friction(belief, options)
        coverage = Coverage.of_moves(fresh, friction.moves)

    space, pool = _drawn(fresh, coverage, options)
    chosen = _optimised(space, pool, per_joint, options)
    planned = _described(space, chosen, stages, options)
    if not given:
        ranges = "; ".join(coverage.text(fresh, j) for j in space.joints)
        planned.stage.notes.append(
            "friction has to be known first where these sweeps go, seqid plan friction"
            f" (or all) covers it: {ranges}"
        )
        return GravityPlan(planned)
    more = _wider_friction(
        fresh, belief, coverage, planned, per_joint, options, worth=worth
    )
    return GravityPlan(planned, more)


def conditions(information: Array, rank: int) -> tuple[Array, Array]:
    """Return the plain and the scaled condition (...) of Phi from Phi' Phi (..., g, g).

    `rank` is the most that any set of sweeps reaches: the condition is that of so many
    directions.
    """
    return _condition(information, rank), _condition(_scaled(information), rank)


def _scaled(information: Array) -> Array:
    """Return the information (..., g, g) on columns scaled to length 1."""
    size = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(information / (size[..., :, None] * size[..., None, :]))


def _condition(normal: Array, rank: int) -> Array:
    """Return the ratio of the largest singular value to the `rank`-th of a normal matrix's root."""
    values = np.linalg.eigvalsh(normal)
    largest = np.maximum(values[..., -1], 1e-300)
    least = np.maximum(values[..., -rank], 1e-15 * largest)
    return np.asarray(np.sqrt(largest / least))


def _drawn(
    belief: Belief,
    coverage: Coverage,
    options: PlanOptions,
    *,
    enough: int = 10,
) -> tuple[SweepSpace, Sweeps]:
    """Draw sweeps of every joint that moves, that gravity loads, and whose friction is known.

    Accelerations are halved until of each joint `enough` sweeps keep the torque limits.
    """
    loaded = _loaded_joints(belief)
    joints = [j for j in belief.limits.moving if loaded[j] and coverage.known[j]]
    for gentler in strokes.gentler(belief):
        space, pool = _drawn_of(gentler, joints, coverage, options)
        if pool and all(np.sum(pool.joint == j) >= enough for j in joints):
            break
    if pool is None:
        message = (
            "no sweep of a joint that gravity loads keeps the limits within known"
            " friction"
        )
        hint = (
            "Correct effort in the URDF, give a friction file that covers more, or,"
            " where the base stands on no floor, plan with --no-floor."
        )
        raise ConfigError(message, where=str(belief.robot.source), hint=hint)
    return space, pool


def _drawn_of(
    belief: Belief,
    joints: list[int],
    coverage: Coverage,
    options: PlanOptions,
    *,
    most_postures: int = 60,
    widest: float = 0.5,
) -> tuple[SweepSpace, Sweeps | None]:
    """Draw sweeps with the accelerations of a belief; None where no sweep keeps the limits."""
    rng = np.random.default_rng(options.seed)
    limits, n = belief.limits, belief.robot.n
    fastest = np.minimum(SLOW * limits.speed, coverage.fastest)
    speed = np.maximum(fastest, np.minimum(coverage.slowest, limits.speed))
    ramp = np.pi * speed**2 / (4.0 * np.maximum(limits.acceleration, 1e-300))
    space = SweepSpace(
        belief=belief,
        joints=joints,
        speed=speed,
        span=np.stack([coverage.lower - ramp, coverage.upper + ramp], axis=1),
        steady=np.stack([coverage.lower, coverage.upper], axis=1),
        least_width=np.zeros(n),
    )
    parts = []
    for j in joints:
        drawn = space.draw(j, strokes.postures_of(limits, most_postures, rng))
        steady = np.diff(space.steady_ends(drawn.joint, drawn.ends))[:, 0]
        space.least_width[j] = widest * steady.max(initial=0.0)
        kept = drawn[np.flatnonzero(space.allowed(drawn))]
        if len(kept.joint):
            parts.append(kept)
    if not parts:
        return space, None
    names = ("joint", "posture", "ends", "information")
    pool = Sweeps(
        **{name: np.concatenate([vars(part)[name] for part in parts]) for name in names}
    )
    return space, pool


def _loaded_joints(belief: Belief, *, negligible: float = 1e-9) -> Mask:
    """Return which joints (n,) gravity loads: an upright axis is loaded by rounding alone."""
    postures = strokes.postures_of(belief.limits, 50, np.random.default_rng(0))
    H = np.abs(gravity_base_regressor(belief.robot, belief.basis, postures)).max(
        axis=(0, 2)
    )
    return np.asarray(negligible * H.max() < H)


def _rank_of(pool: Sweeps, *, tolerance: float = 1e-6) -> int:
    """Return the rank that all sweeps of a pool reach together."""
    total = pool.information.sum(axis=0)
    size = np.sqrt(np.diag(total))
    alive = size > tolerance * size.max()
    values = np.linalg.eigvalsh((total / np.outer(size, size))[np.ix_(alive, alive)])
    return int(np.sum(values > tolerance * values[-1]))


@dataclass(frozen=True)
class Judge:
    """The criterion J, as a logarithm; with a finite `power` p the smooth J_p."""

    rank: int
    power: float = np.inf

    def __call__(self, information: Array) -> Array:
        """Return log J (...) of the sum of information (..., g, g)."""
        if np.isinf(self.power):
            plain, scaled = conditions(information, self.rank)
            return np.asarray(np.log(plain) + np.log(scaled))
        return self._smooth(information) + self._smooth(_scaled(information))

    def _smooth(self, normal: Array) -> Array:
        values = np.linalg.eigvalsh(normal)[..., -self.rank :]
        logs = np.log(np.maximum(values, 1e-15 * np.maximum(values[..., -1:], 1e-285)))
        # Powers over the largest, or the least, of them: no overflow.
        above = np.exp(self.power * (logs - logs[..., -1:])).sum(axis=-1)
        below = np.exp(self.power * (logs[..., :1] - logs)).sum(axis=-1)
        ratio = logs[..., -1] - logs[..., 0]
        return np.asarray((ratio + (np.log(above) + np.log(below)) / self.power) / 2.0)


def _optimised(
    space: SweepSpace,
    pool: Sweeps,
    per_joint: int,
    options: PlanOptions,
    *,
    starts: int = 6,
    powers: tuple[float, ...] = (6.0, 40.0),
) -> Sweeps:
    """Return the sweeps of least J that a search finds.

    Parameters
    ----------
    space, pool, per_joint, options
    starts : int
        Random sets that the search begins with.
    powers : tuple of float
        Powers p of the smooth criterion, one after the other.
    """
    rng = np.random.default_rng([options.seed, 1])
    rank = _rank_of(pool)
    judge = Judge(rank)
    found = []
    for _ in range(starts):
        places = _random_set(space, pool, per_joint, rng)
        sweeps = pool[_exchanged(pool, places, Judge(rank, powers[0]))]
        for power in powers:
            sweeps = _descended(space, sweeps, Judge(rank, power))
        found.append((float(judge(sweeps.information.sum(axis=0))), sweeps))
    best = min(found, key=lambda one: one[0])[1]
    best = _refined(space, best, Judge(rank, powers[-1]), rng)
    return _refined(space, best, judge, rng)


def _random_set(
    space: SweepSpace, pool: Sweeps, per_joint: int, rng: np.random.Generator
) -> Index:
    """Return places in the pool of a random set with so many sweeps of each joint."""
    owns = [np.flatnonzero(pool.joint == j) for j in space.joints]
    return np.concatenate(
        [
            rng.choice(own, per_joint, replace=len(own) < per_joint)
            for own in owns
            if len(own)
        ]
    )


def _exchanged(pool: Sweeps, chosen: Index, judge: Judge, *, rounds: int = 20) -> Index:
    """Exchange sweeps for others of the same joint out of the pool while J falls."""
    chosen = chosen.copy()
    total = pool.information[chosen].sum(axis=0)
    best = float(judge(total))
    for _ in range(rounds):
        before = best
        for place in range(len(chosen)):
            others = np.flatnonzero(pool.joint == pool.joint[chosen[place]])
            sums = total - pool.information[chosen[place]] + pool.information[others]
            values = judge(sums)
            k = int(np.argmin(values))
            if values[k] < best:
                best, chosen[place] = float(values[k]), others[k]
                total = pool.information[chosen].sum(axis=0)
        if best >= before:
            break
    return chosen


def _descended(
    space: SweepSpace,
    sweeps: Sweeps,
    judge: Judge,
    *,
    iterations: int = 40,
    step: float = 1e-4,
    penalty: float = 100.0,
    low_m: float = 0.1,
    ways_back: tuple[float, ...] = (1.0, 0.6, 0.3),
) -> Sweeps:
    """Move all postures at once down the smooth criterion, as far as the limits let them.

    Parameters
    ----------
    space, sweeps, judge
    iterations : int
        Of L-BFGS-B.
    step : float
        Of the differences that the gradient is made of, over the joints' ranges.
    penalty, low_m : float, float
        A sweep that comes `low_m` [m] below the floor raises log J by `penalty`.
    ways_back : tuple of float
        Shares of the way that are tried where the end of it touches something.
    """
    limits, count = space.belief.limits, len(sweeps.joint)
    n, g = len(limits.range), sweeps.information.shape[1]
    joints, ends = np.tile(sweeps.joint, n + 1), np.tile(sweeps.ends, (n + 1, 1))

    def with_gradient(x: Array) -> tuple[float, Array]:
        """Value and gradient, by steps that lead inwards from the bounds; all in one batch."""
        places = x.reshape(count, n)
        steps = np.where(places > 0.5, -step, step)
        tried = np.repeat(places[None], n + 1, axis=0)
        for k in range(n):
            tried[k + 1, :, k] += steps[:, k]
        postures = limits.lower + tried.reshape(-1, n) * limits.range
        drawn = space.with_ends(joints, postures, ends)
        information = drawn.information.reshape(n + 1, count, g, g)
        total = information[0].sum(axis=0)
        each = (total + information[1:] - information[0]).reshape(-1, g, g)
        low = penalty * (space.depth(drawn) / low_m).reshape(n + 1, count) ** 2
        here = float(judge(total))
        changed = judge(each).reshape(n, count) - here + low[1:] - low[0]
        return here + float(low[0].sum()), (changed / steps.T).T.ravel()

    start = (sweeps.posture - limits.lower) / np.maximum(limits.range, 1e-12)
    found = minimize(
        with_gradient,
        start.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(np.zeros(start.size), np.ones(start.size)),
        options={"maxiter": iterations, "maxfun": iterations + iterations // 4},
    )
    wanted = limits.lower + found.x.reshape(count, n) * limits.range

    # Of each sweep the largest part of its way after which it still keeps all limits.
    best = sweeps
    for place, j in enumerate(sweeps.joint):
        for share in ways_back:
            posture = sweeps.posture[place] + share * (
                wanted[place] - sweeps.posture[place]
            )
            one = space.draw(int(j), posture[None])
            if space.allowed(one)[0]:
                best = best.replaced(place, one)
                break
    before, after = (float(judge(x.information.sum(axis=0))) for x in (sweeps, best))
    return best if after < before else sweeps


def _refined(
    space: SweepSpace,
    sweeps: Sweeps,
    judge: Judge,
    rng: np.random.Generator,
    *,
    rounds: int = 25,
    near: int = 24,
    anew: int = 6,
    enough: float = 1e-3,
    patience: int = 3,
) -> Sweeps:
    """Exchange each sweep for postures near its own, or new ones, while J falls.

    Parameters
    ----------
    space, sweeps, judge, rng
    rounds : int
        Most rounds over all sweeps.
    near, anew : int
        Postures near the sweep's own and drawn anew, of each exchange.
    enough, patience : float, int
        The search ends after so many rounds that lower log J by less.
    """
    limits = space.belief.limits
    best = float(judge(sweeps.information.sum(axis=0)))
    idle = 0
    for _ in range(rounds):
        before = best
        for place in range(len(sweeps.joint)):
            # Steps of all sizes at once: which one helps depends on how far the search
            # has come.
            size = 10.0 ** rng.uniform(-2.5, -0.3, (near, 1))
            steps = size * rng.normal(size=(near, len(limits.range))) * limits.range
            # Some joints at a time: most do not matter to one sweep.
            steps *= rng.uniform(size=steps.shape) < rng.uniform(0.2, 1.0, (near, 1))
            around = np.clip(sweeps.posture[place] + steps, limits.lower, limits.upper)
            fresh = strokes.postures_of(limits, anew + 1, rng)[1:]
            drawn = space.draw(int(sweeps.joint[place]), np.vstack([around, fresh]))

            rest = sweeps.information.sum(axis=0) - sweeps.information[place]
            values = judge(rest + drawn.information)
            for k in np.argsort(values):
                if values[k] >= best:
                    break
                one = drawn[np.array([k])]
                if space.allowed(one)[0]:
                    best, sweeps = float(values[k]), sweeps.replaced(place, one)
                    break
        idle = idle + 1 if before - best < enough else 0
        if idle >= patience:
            break
    return sweeps


def _described(
    space: SweepSpace, chosen: Sweeps, stages: Stages, options: PlanOptions
) -> Planned:
    """Return the moves, and the errors that their rows will give."""
    belief = space.belief
    wanted = belief.basis.gravity
    goal = Goal.of(belief, options.seed)
    order = np.lexsort((np.arange(len(chosen.joint)), -chosen.joint))
    chosen = chosen[order]
    rows = _rows(belief, space, chosen)
    each = np.einsum("mnjb,mnj,mnjc->mbc", rows.H, rows.weights, rows.H, optimize=True)
    nothing = np.zeros_like(goal.W)
    without = msgspec.structs.replace(stages, gravity=None)
    stage = rigid_stage(belief, goal, without, rows, goal.scaled(each), nothing, wanted)
    stage.growth = []

    plain, scaled = conditions(chosen.information.sum(axis=0), int(stage.rank or 1))
    stage.plain_condition, stage.scaled_condition = float(plain), float(scaled)
    stage.criterion = PlanCriterion(minimised=MINIMISED, value=float(plain * scaled))
    information = each.sum(axis=0) - rows.lost(belief)
    return Planned(_moves(belief, space, chosen), stage, information)


def _moves(belief: Belief, space: SweepSpace, chosen: Sweeps) -> list[PlannedMove]:
    """Return the moves of sweeps, numbered joint by joint."""
    moves: list[PlannedMove] = []
    for j, posture, (low, high) in zip(
        chosen.joint, chosen.posture, chosen.ends, strict=True
    ):
        name = belief.robot.joint_names[j]
        label = f"gravity_{name}_{1 + sum(move.joints == [name] for move in moves)}"
        ends = float(low), float(high)
        speed = min(
            float(space.speed[j]),
            strokes.top_speed(belief.limits, int(j), ends[1] - ends[0]),
        )
        moves.append(strokes.stroke_move(belief, label, int(j), posture, ends, [speed]))
    return moves


def _rows(
    belief: Belief, space: SweepSpace, chosen: Sweeps, *, points: int = 24
) -> StageRows:
    """Return the rows that the gravity stage will see: of the moving joint, both ways, at speed."""
    n = belief.robot.n
    every = np.arange(len(chosen.joint))
    steady = space.steady_ends(chosen.joint, chosen.ends)
    q = np.repeat(chosen.posture[:, None], 2 * points, axis=1)
    there = _middles(steady, points)
    q[every, :, chosen.joint] = np.hstack([there, there[:, ::-1]])
    dq = np.zeros_like(q)
    speed = space.speed[chosen.joint]
    dq[every, :, chosen.joint] = np.repeat([1.0, -1.0], points) * speed[:, None]
    moves = Moves(np.arange(2.0 * points), q, dq, np.zeros_like(q))

    H = np.zeros((len(every), 2 * points, n, belief.basis.size))
    H[..., belief.basis.gravity] = belief.regressor(moves)[..., belief.basis.gravity]

    # What one way of a sweep tells: by what friction's surface leaves of it, else by
    # the noise.
    seconds = np.diff(steady)[:, 0] / speed
    by_noise = belief.density[chosen.joint] * seconds
    measured = belief.sweep_variance[chosen.joint]
    of_way = np.where(measured > 0.0, 1.0 / np.maximum(measured, 1e-300), by_noise)
    weights = np.zeros(q.shape)
    weights[every, :, chosen.joint] = (of_way / points)[:, None]
    return StageRows(moves=moves, H=H, weights=weights, terms=sweep_terms)


def _wider_friction(
    fresh: Belief,
    belief: Belief,
    coverage: Coverage,
    planned: Planned,
    per_joint: int,
    options: PlanOptions,
    *,
    worth: float,
    narrow: float = 0.8,
) -> Planned | None:
    """Return friction trials over the whole ranges, where sweeps over these would pay.

    The plan with the friction that is given is compared with one that knew it
    everywhere, both without the errors of the surfaces. A joint is tried again where
    its sweeps cover less than a `narrow` share of what they could.
    """
    bare = replace(fresh, surfaces=[None] * fresh.robot.n)
    wide, pool = _drawn(bare, Coverage.everywhere(bare), options)
    lacking = []
    for j in wide.joints:
        reach = float(np.max(np.diff(pool.ends[pool.joint == j]), initial=0.0))
        known = (
            float(coverage.upper[j] - coverage.lower[j]) if coverage.known[j] else 0.0
        )
        if known < narrow * reach - 2.0 * ramp_way(
            float(wide.speed[j]), float(wide.belief.limits.acceleration[j])
        ):
            lacking.append(j)
    if not lacking:
        return None
    names = [belief.robot.joint_names[j] for j in lacking]
    space, near = _drawn(bare, coverage, options)
    covered = _described(
        space, _quick(space, near, per_joint, options), Stages(), options
    )
    whole = _described(wide, _quick(wide, pool, per_joint, options), Stages(), options)
    gain = _gain(covered.stage, whole.stage)
    missing_rank = (covered.stage.rank or 0) < (whole.stage.rank or 0)
    ranges = "; ".join(coverage.text(belief, j) for j in lacking if coverage.known[j])
    if ranges:
        planned.stage.notes.append(
            "sweeps keep to the friction that is given, rows outside would be lost:"
            f" {ranges}"
        )
    unknown = [
        name for name, j in zip(names, lacking, strict=True) if not coverage.known[j]
    ]
    if unknown:
        planned.stage.notes.append(
            f"no friction is given for {', '.join(unknown)}: their sweeps would be"
            " left out"
        )
    if gain < worth and not missing_rank:
        return None
    planned.stage.notes.append(
        "more range would pay: with friction known over the whole range of"
        f" {', '.join(names)} the torque's error would fall by {percent(gain, 0)};"
        " friction trials for it are planned as well, record them, run seqid friction"
        " with all, and plan gravity again"
    )
    trials = plan_friction(belief, options)
    moves = [move for move in trials.moves if move.joints[0] in names]
    errors = {name: trials.stage.torque_error[name] for name in names}
    return Planned(moves, PlannedStage(torque_error=errors))


def _quick(
    space: SweepSpace, pool: Sweeps, per_joint: int, options: PlanOptions
) -> Sweeps:
    """Return sweeps by exchange within the pool alone: enough to compare two spaces."""
    places = _random_set(
        space, pool, per_joint, np.random.default_rng([options.seed, 2])
    )
    return pool[_exchanged(pool, places, Judge(_rank_of(pool), 4.0))]


def _gain(covered: PlannedStage, whole: PlannedStage) -> float:
    """Return the largest share by which a joint's torque error falls."""
    pairs = (
        (covered.torque_error[name], whole.torque_error[name])
        for name in whole.torque_error
    )
    return max(
        (1.0 - after / before for before, after in pairs if before > 0.0), default=0.0
    )
