"""Eq. 12-15: the gravity torque of single-joint trials, and whether friction depends on direction.

Forward and backward trials at one speed have the half-sum

    (tau_1 + tau_2) / 2 = a(q)' p_xi + (f_forward - f_backward) / 2.

Gravity cannot know the speed and has the shape a(q); the second term is the direction dependence
that Eq. 15 takes to be zero. Both are fitted, the second as a share of friction and a slope over
the speed, and kept only where the data speak for it. Friction at a place is half the difference of
the two trials: an offset, the same at all places, would leave a part of what friction has over the
position to gravity, and is taken only where it leaves clearly less. What else is the same both ways
and depends on the position alone, as the torque of a spring or a cable does, is fitted as well:
left in, it would be friction's noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev
from scipy.linalg import block_diag

from seqid_cli.identify.friction_surface.trials import Trial, configurations, speed_levels
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask


def gravity_columns(robot: Robot, joint: int, configuration: Array, q: Array) -> Array:
    """Vector a of Eq. 13 at positions q of one joint, the others locked.

    `configuration` (n,): positions of the joints before it [rad]. `q` (K,): positions of the joint
    itself [rad]. Returns (K, 2): m/s^2, to be multiplied by p_xi of Eq. 14; (K, 1) for a prismatic
    joint, whose gravity force is mass times gravity along the axis; no column where gravity has no
    part across the axis.
    """
    zero = configuration.copy()
    zero[joint] = 0.0
    R = forward(robot.chain, zero[None]).R[0, joint]
    g = R.T @ robot.gravity
    axis = robot.chain.axis[joint]
    if robot.chain.prismatic[joint]:
        column = np.full((len(q), 1), -float(g @ axis))
        return column if abs(g @ axis) > 1e-6 else column[:, :0]
    e_x, e_y = plane_across(axis)
    g_x, g_y = float(g @ e_x), float(g @ e_y)
    if np.hypot(g_x, g_y) < 1e-6:
        return np.empty((len(q), 0))
    sin, cos = np.sin(q), np.cos(q)
    return np.column_stack([g_x * sin - g_y * cos, g_x * cos + g_y * sin])


def plane_across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors across a joint axis; x and y of the frame where the axis is z."""
    start = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    e_x = start - axis * (axis @ start)
    e_x /= np.linalg.norm(e_x)
    return e_x, np.cross(axis, e_x)


class HalfSum(NamedTuple):
    """Half-sum `tau` (K,) N m of a forward and a backward trial at `q` (K,) rad (Eq. 15).

    `friction` (K,) N m is half their difference, `speed` the pair's, `weight` samples per slice.
    """

    q: Array
    tau: Array
    friction: Array
    speed: float
    weight: float


def _half_sums(group: list[Trial]) -> list[HalfSum]:
    """Half-sums of forward and backward trials of one configuration, speed by speed."""
    result = []
    for level in speed_levels(group):
        back = [t for t in level if t.velocity < 0]
        for ahead in (t for t in level if t.velocity > 0):
            twin = max(back, key=lambda t: len(_inside(ahead, t)), default=None)
            if twin is not None and len(at := _inside(ahead, twin)) >= 4:
                back.remove(twin)
                result.append(_half_sum(ahead, twin, at, level[0].speed))
    return result


def _inside(ahead: Trial, back: Trial) -> Index:
    """Slices of a forward trial that lie where a backward trial has been."""
    return np.flatnonzero((ahead.q >= back.q.min()) & (ahead.q <= back.q.max()))


def _half_sum(ahead: Trial, back: Trial, at: Index, speed: float) -> HalfSum:
    order = np.argsort(back.q)
    tau, twin = ahead.tau[at], np.interp(ahead.q[at], back.q[order], back.tau[order])
    return HalfSum(ahead.q[at], (tau + twin) / 2, (tau - twin) / 2, speed, ahead.weight)


@dataclass(frozen=True)
class GravityGroup:
    """Trials in one locked configuration with p_xi (2,) kg m and its standard errors.

    `beyond` is the torque over the position that gravity does not make.
    """

    robot: Robot
    configuration: Array
    trials: list[Trial]
    p_xi: Array
    std_error: Array
    beyond: Chebyshev | None = None

    def torque(self, q: Array) -> Array:
        """Torque (K,) N m that both ways have at positions q (K,) of the moving joint (Eq. 12)."""
        joint = self.trials[0].joint
        torque: Array = gravity_columns(self.robot, joint, self.configuration, q) @ self.p_xi
        if self.beyond is not None:
            torque = torque + self.beyond(np.clip(q, *self.beyond.domain))
        return torque


@dataclass(frozen=True)
class GravityFit:
    """p_xi of every configuration; `asymmetry` is the direction-dependent share of friction."""

    groups: list[GravityGroup]
    unpaired: int
    directional: bool
    asymmetry: float


@dataclass(frozen=True)
class Clustered:
    """Least squares `theta` (p,) whose rows share errors within clusters.

    `left` is the residual, `bread` the inverse of the normal matrix, `moves` (G, p) what each
    cluster pulls the estimate by.
    """

    theta: Array
    left: Array
    bread: Array
    moves: Array

    @classmethod
    def of(cls, A: Array, y: Array, cluster: Index) -> "Clustered":
        """Solve rows A (N, p), y (N,) of clusters (N,), numbered from 0."""
        theta = np.asarray(np.linalg.lstsq(A, y, rcond=1e-10)[0], dtype=np.float64)
        left = y - A @ theta
        bread = np.asarray(np.linalg.pinv(A.T @ A, hermitian=True))
        scores = np.zeros((int(cluster.max()) + 1, A.shape[1]))
        np.add.at(scores, cluster, A * left[:, None])
        return cls(theta, left, bread, scores @ bread)

    @property
    def std_error(self) -> Array:
        """Standard errors (p,), robust within clusters."""
        count, p = self.moves.shape
        return np.asarray(np.sqrt(np.sum(self.moves**2, axis=0) * count / max(count - p, 1)))


@dataclass(frozen=True)
class _Pairs:
    """Half-sums of a joint, row by row (N,), and the pair that each is of, numbered from 0."""

    q: Array
    tau: Array
    friction: Array
    speed: Array
    weight: Array
    pair: Index
    slice: Index

    @classmethod
    def of(cls, pairs: Sequence[HalfSum]) -> "_Pairs":
        """Stack pairs."""
        lengths = [len(half.q) for half in pairs]
        q, tau, friction = (
            np.concatenate([getattr(half, x) for half in pairs]) for x in ("q", "tau", "friction")
        )
        speed, weight = (
            np.repeat([getattr(half, x) for half in pairs], lengths) for x in ("speed", "weight")
        )
        pair, at = np.repeat(np.arange(len(pairs)), lengths), [np.arange(n) for n in lengths]
        return cls(q, tau, friction, speed, weight, pair, np.concatenate(at))

    def blocks(self, parts: int) -> Index:
        """Blocks (N,), so many to a pair."""
        return self.pair * parts + self.slice * parts // np.bincount(self.pair)[self.pair]

    def dry(self, degree: int) -> Array:
        """Friction (N,) N m less what goes with the speed, smooth over the position."""
        place = np.interp(self.q, [self.q.min(), self.q.max()], [-1.0, 1.0])
        columns = np.column_stack([chebyshev.chebvander(place, degree), self.speed])
        root = np.sqrt(self.weight)
        found = np.linalg.lstsq(columns * root[:, None], self.friction * root, rcond=1e-10)[0]
        return np.asarray(columns[:, :-1] @ found[:-1])


def fit_gravity(
    robot: Robot, joint: int, trials: list[Trial], *, degree: int = 8, clear: float = 0.7
) -> GravityFit:
    """Fit p_xi per configuration to the half-sums, with or without direction dependence.

    What depends on the position is a polynomial of some `degree`; another law is clearly better
    where it leaves less than `clear` of the squares. Returns: groups without a forward/backward
    pair are left out and counted in `unpaired`.
    """
    groups = configurations(trials)
    sums = [_half_sums(group) for group in groups]
    places = [np.concatenate([np.zeros(0), *(half.q for half in own)]) for own in sums]
    a = [
        gravity_columns(robot, joint, group[0].configuration, q)
        for group, q in zip(groups, places, strict=True)
    ]
    kept = [k for k, own in enumerate(sums) if own]
    if len(kept) < len(groups) and not any(own.shape[1] for own in a):
        none = np.zeros(0)  # nothing to remove, no twin needed
        free = [GravityGroup(robot, group[0].configuration, group, none, none) for group in groups]
        return GravityFit(free, 0, False, 0.0)
    unpaired = len(trials) - sum(len(groups[k]) for k in kept)
    if not kept:
        return GravityFit([], unpaired, False, 0.0)
    pairs, columns = (
        _Pairs.of([x for k in kept for x in sums[k]]),
        block_diag(*(a[k] for k in kept)),
    )
    extras = [np.column_stack([x, pairs.speed / pairs.speed.max()]) for x in _uneven(pairs, degree)]
    if robot.chain.prismatic[joint] and columns.shape[1]:
        extras = [extras[1][:, 1:]]  # the gravity force of a prismatic joint is itself an offset
    friction = _usual_friction([groups[k] for k in kept])
    found, beyond, share, directional = _both_ways(pairs, columns, extras, friction, degree, clear)
    ends = np.cumsum([a[k].shape[1] for k in kept])
    each = zip(
        kept, np.split(found.theta, ends)[:-1], np.split(found.std_error, ends)[:-1], strict=True
    )
    fitted = [
        GravityGroup(robot, groups[k][0].configuration, groups[k], p_xi, error, beyond)
        for k, p_xi, error in each
    ]
    return GravityFit(fitted, unpaired, directional, share)


def _uneven(pairs: _Pairs, degree: int) -> tuple[Array, Array]:
    """What differs between the directions, to a factor: a share of friction, or an offset (N,)."""
    return pairs.dry(degree), np.ones_like(pairs.q)


def _usual_friction(groups: Sequence[Sequence[Trial]]) -> float:
    """RMS [N m] of half the difference of the directions, over configurations."""
    squares = []
    for group in groups:
        ahead = [t.tau.mean() for t in group if t.velocity > 0]
        back = [t.tau.mean() for t in group if t.velocity < 0]
        squares.append(((np.mean(ahead) - np.mean(back)) / 2) ** 2)
    return float(np.sqrt(np.mean(squares)))


def _both_ways(
    pairs: _Pairs,
    columns: Array,
    extras: Sequence[Array],
    friction: float,
    degree: int,
    clear: float,
    *,
    enough_pairs: int = 8,
) -> tuple[Clustered, Chebyshev | None, float, bool]:
    """Fit what both ways have, columns (N, p) of gravity and one of the `extras`, or none.

    Drift and friction errors are shared within a pair; fewer than `enough_pairs` are cut up. Also
    what is left over the position, and the share of friction that depends on the direction.
    """
    root = np.sqrt(pairs.weight)
    block = pairs.blocks(1 if pairs.pair[-1] + 1 >= enough_pairs else 4)

    def fits(y: Array) -> list[Clustered]:
        bases = (columns, *(np.hstack([columns, extra]) for extra in extras))
        return [Clustered.of(A * root[:, None], y * root, block) for A in bases]

    plain, *others = fits(pairs.tau)
    number = _of_fewest(others, clear)
    left = [each.left / root for each in (plain, others[number])]
    beyond = _beyond(pairs.q, root, pairs.pair, *left, degree=degree, most=clear)
    if beyond is not None:
        plain, *others = fits(pairs.tau - beyond(pairs.q))
        number = _of_fewest(others, clear)
    share, directional = _asymmetry(plain, others[number], extras[number], friction)
    return others[number] if directional else plain, beyond, share, directional


def _of_fewest(fits: Sequence[Clustered], clear: float) -> int:
    """The first of several fits, or one that leaves clearly less than those before it."""
    best, squares = 0, [float(fit.left @ fit.left) for fit in fits]
    for number in range(1, len(fits)):
        best = number if squares[number] < clear * squares[best] else best
    return best


def _beyond(
    q: Array,
    root: Array,
    pair: Index,
    left: Array,
    unlike: Array,
    *,
    degree: int,
    most: float,
) -> Chebyshev | None:
    """Torque over the position q (N,) that half-sums have beyond gravity, `left` (N,) N m.

    A polynomial of some `degree` over all pairs, which `pair` (N,) numbers; rows weigh `root` (N,).
    None, unless of what friction that depends on the direction does not make either, `unlike` (N,)
    N m, one like it leaves pairs that are left out less than `most` of their squares: what pairs
    share is no noise.
    """

    def fitted(values: Array, some: Mask) -> Chebyshev:
        domain = [float(q.min()), float(q.max())]
        return Chebyshev.fit(q[some], values[some], degree, domain=domain, w=root[some])

    others = [pair != k for k in range(int(pair.max()) + 1)]
    if min(np.count_nonzero(some) for some in others) <= degree:
        return None
    rest = unlike.copy()
    for some in others:
        own = ~some & (q >= q[some].min()) & (q <= q[some].max())
        rest[own] -= fitted(unlike, some)(q[own])
    if np.sum((rest * root) ** 2) >= most * np.sum((unlike * root) ** 2):
        return None
    return fitted(left, pair >= 0)


def _asymmetry(
    plain: Clustered,
    extended: Clustered,
    extra: Array,
    friction: float,
    *,
    min_share: float = 0.02,
    min_sigma: float = 6.0,
) -> tuple[float, bool]:
    """Share of friction that depends on direction, and whether it is large and significant."""
    solution, errors = (x[len(plain.theta) :] for x in (extended.theta, extended.std_error))
    share = float(np.sqrt(np.mean((extra @ solution) ** 2)) / max(friction, 1e-12))
    sigma = np.abs(solution) / np.maximum(errors, 1e-300)
    helps = extended.left @ extended.left < 0.97 * (plain.left @ plain.left)
    return share, bool(share > min_share and sigma.max() > min_sigma and helps)
