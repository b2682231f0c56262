"""The search for the sweeps of least J: from random sets, by exchange and by descent.

From several random sets sweeps are exchanged for others of the same joint out of a
pool; then all postures change at once by L-BFGS-B, down the smooth J_p with p growing;
then each is exchanged for postures near its own, which needs no gradient: there a sweep
counts only where it touches nothing and keeps the torque limits.
"""

import numpy as np
from scipy.optimize import Bounds, minimize

from seqid_cli.plan.moves import strokes
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.gravity_sweeps.criterion import Criterion, common_rank
from seqid_cli.plan.stages.gravity_sweeps.space import Sweeps, SweepSpace
from seqid_cli.typing import Array, Index


def best_sweeps(
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
    space : SweepSpace
    pool : Sweeps
        Drawn sweeps to begin with.
    per_joint : int
        Sweeps of each joint.
    options : PlanOptions
    starts : int
        Random sets that the search begins with.
    powers : tuple of float
        Powers p of the smooth criterion, one after the other.

    Returns
    -------
    Sweeps
        So many of each joint.
    """
    rng = np.random.default_rng([options.seed, 1])
    rank = common_rank(pool.information)
    criterion = Criterion(rank)

    candidates = []
    for _ in range(starts):
        places = _random_set(space, pool, per_joint, rng)
        sweeps = pool[_exchanged(pool, places, Criterion(rank, powers[0]))]
        for power in powers:
            sweeps = _descended(space, sweeps, Criterion(rank, power))
        candidates.append(sweeps)
    best = min(candidates, key=lambda sweeps: float(criterion(sweeps.total)))

    # First by the smooth criterion: J itself stops at the first kink.
    best = _refined(space, best, Criterion(rank, powers[-1]), rng)
    return _refined(space, best, criterion, rng)


def quick_sweeps(
    space: SweepSpace, pool: Sweeps, per_joint: int, options: PlanOptions
) -> Sweeps:
    """Return sweeps by exchange within the pool alone: enough to compare two spaces.

    Parameters
    ----------
    space : SweepSpace
    pool : Sweeps
    per_joint : int
        Sweeps of each joint.
    options : PlanOptions

    Returns
    -------
    Sweeps
    """
    rng = np.random.default_rng([options.seed, 2])
    places = _random_set(space, pool, per_joint, rng)
    criterion = Criterion(common_rank(pool.information), 4.0)
    return pool[_exchanged(pool, places, criterion)]


def _random_set(
    space: SweepSpace, pool: Sweeps, per_joint: int, rng: np.random.Generator
) -> Index:
    """Return places in the pool of a random set with so many sweeps of each joint."""
    parts = []
    for j in space.joints:
        of_joint = np.flatnonzero(pool.joint == j)
        if len(of_joint):
            too_few = len(of_joint) < per_joint
            parts.append(rng.choice(of_joint, per_joint, replace=too_few))
    return np.concatenate(parts)


def _exchanged(
    pool: Sweeps, chosen: Index, criterion: Criterion, *, rounds: int = 20
) -> Index:
    """Exchange sweeps for others of the same joint out of the pool while J falls.

    `chosen` (K,) are places in the pool; the places of a better set are returned.
    """
    chosen = chosen.copy()
    total = pool[chosen].total
    least = float(criterion(total))
    for _ in range(rounds):
        before_round = least
        for k in range(len(chosen)):
            # What J would be with each sweep of this joint in place of sweep k.
            candidates = np.flatnonzero(pool.joint == pool.joint[chosen[k]])
            without_k = total - pool.information[chosen[k]]
            values = criterion(without_k + pool.information[candidates])
            best = int(np.argmin(values))
            if values[best] < least:
                least = float(values[best])
                chosen[k] = candidates[best]
                total = pool[chosen].total
        if least >= before_round:
            break
    return chosen


def _descended(
    space: SweepSpace,
    sweeps: Sweeps,
    criterion: Criterion,
    *,
    iterations: int = 40,
    step: float = 1e-4,
    penalty: float = 100.0,
    low_m: float = 0.1,
    ways_back: tuple[float, ...] = (1.0, 0.6, 0.3),
) -> Sweeps:
    """Move all postures at once down the smooth criterion, as the limits let them.

    Parameters
    ----------
    space : SweepSpace
    sweeps : Sweeps
        M sweeps to begin with.
    criterion : Criterion
        With a finite power.
    iterations : int
        Of L-BFGS-B.
    step : float
        Of the differences that the gradient is made of, over the joints' ranges.
    penalty, low_m : float, float
        A sweep that comes `low_m` [m] below the floor raises log J by `penalty`.
    ways_back : tuple of float
        Shares of the way that are tried where the end of it touches something.

    Returns
    -------
    Sweeps
        Those that were given where none better are found.
    """
    limits = space.belief.limits
    count = len(sweeps.joint)
    n = len(limits.range)
    g = sweeps.information.shape[1]
    joints = np.tile(sweeps.joint, n + 1)
    ends = np.tile(sweeps.ends, (n + 1, 1))

    def with_gradient(x: Array) -> tuple[float, Array]:
        """Return value and gradient at postures x (M n,), as shares of the ranges."""
        # In one batch: the postures as they are, then all with joint k moved, for each
        # k. A sweep's posture changes its own information alone, so that one batch
        # gives the differences of all sweeps. Steps lead inwards from the bounds.
        places = x.reshape(count, n)
        steps = np.where(places > 0.5, -step, step)
        batch = np.repeat(places[None], n + 1, axis=0)
        for k in range(n):
            batch[k + 1, :, k] += steps[:, k]
        postures = limits.lower + batch.reshape(-1, n) * limits.range
        drawn = space.with_ends(joints, postures, ends)

        information = drawn.information.reshape(n + 1, count, g, g)
        total = information[0].sum(axis=0)
        moved_totals = (total + information[1:] - information[0]).reshape(-1, g, g)
        too_low = (space.depth(drawn) / low_m).reshape(n + 1, count)
        penalties = penalty * too_low**2

        value = float(criterion(total))
        change_of_criterion = criterion(moved_totals).reshape(n, count) - value
        change = change_of_criterion + penalties[1:] - penalties[0]
        gradient = (change / steps.T).T.ravel()
        return value + float(penalties[0].sum()), gradient

    start = (sweeps.posture - limits.lower) / np.maximum(limits.range, 1e-12)
    result = minimize(
        with_gradient,
        start.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(np.zeros(start.size), np.ones(start.size)),
        options={"maxiter": iterations, "maxfun": iterations + iterations // 4},
    )
    goal = limits.lower + result.x.reshape(count, n) * limits.range

    # Of each sweep the largest part of its way after which it still keeps all limits.
    moved = sweeps
    for k, j in enumerate(sweeps.joint):
        for share in ways_back:
            displacement = goal[k] - sweeps.posture[k]
            posture = sweeps.posture[k] + share * displacement
            candidate = space.draw(int(j), posture[None])
            if space.allowed(candidate)[0]:
                moved = moved.with_one_replaced(k, candidate)
                break
    is_better = float(criterion(moved.total)) < float(criterion(sweeps.total))
    return moved if is_better else sweeps


def _refined(
    space: SweepSpace,
    sweeps: Sweeps,
    criterion: Criterion,
    rng: np.random.Generator,
    *,
    rounds: int = 25,
    enough: float = 1e-3,
    patience: int = 3,
) -> Sweeps:
    """Exchange each sweep for postures near its own, or new ones, while J falls.

    Parameters
    ----------
    space, sweeps, criterion, rng
    rounds : int
        Most rounds over all sweeps.
    enough, patience : float, int
        The search ends after so many rounds that lower log J by less.

    Returns
    -------
    Sweeps
    """
    least = float(criterion(sweeps.total))
    idle_rounds = 0
    for _ in range(rounds):
        before_round = least
        for k in range(len(sweeps.joint)):
            postures = _postures_to_try(space, sweeps.posture[k], rng)
            drawn = space.draw(int(sweeps.joint[k]), postures)
            without_k = sweeps.total - sweeps.information[k]
            values = criterion(without_k + drawn.information)

            # The best that is allowed: limits are dear to check, so only better ones
            # are.
            for place in np.argsort(values):
                if values[place] >= least:
                    break
                candidate = drawn[np.array([place])]
                if space.allowed(candidate)[0]:
                    least = float(values[place])
                    sweeps = sweeps.with_one_replaced(k, candidate)
                    break

        gained_little = before_round - least < enough
        idle_rounds = idle_rounds + 1 if gained_little else 0
        if idle_rounds >= patience:
            break
    return sweeps


def _postures_to_try(
    space: SweepSpace,
    posture: Array,
    rng: np.random.Generator,
    *,
    near: int = 24,
    anew: int = 6,
) -> Array:
    """Return postures (P, n) near a posture (n,), and some that are drawn anew."""
    limits = space.belief.limits
    n = len(limits.range)

    # Steps of all sizes at once: which one helps depends on how far the search has
    # come.
    size = 10.0 ** rng.uniform(-2.5, -0.3, (near, 1))
    steps = size * rng.normal(size=(near, n)) * limits.range
    # Some joints at a time: most do not matter to one sweep.
    lots = rng.uniform(size=steps.shape)
    moving_share = rng.uniform(0.2, 1.0, (near, 1))
    steps = np.where(lots < moving_share, steps, 0.0)

    nearby = np.clip(posture + steps, limits.lower, limits.upper)
    fresh = strokes.postures_of(limits, anew + 1, rng)[1:]
    return np.vstack([nearby, fresh])
