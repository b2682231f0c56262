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

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev
from scipy.linalg import block_diag

from seqid_cli.identify.friction_surface.trials import Trial, speed_levels
from seqid_cli.robot.kinematics import gravity_columns
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask


@dataclass(frozen=True)
class GravityGroup:
    """Trials in one configuration, p_xi (2,) kg m, torque `beyond` gravity over the position."""

    robot: Robot
    trials: list[Trial]
    p_xi: Array
    std_error: Array
    beyond: Chebyshev | None = None

    @property
    def configuration(self) -> Array:
        """Positions (n,) rad of the joints."""
        return self.trials[0].configuration

    def torque(self, q: Array) -> Array:
        """Torque (K,) N m that both ways have at positions q (K,) of the moving joint (Eq. 12)."""
        columns = gravity_columns(self.robot, self.trials[0].joint, self.configuration, q)
        more = self.beyond(np.clip(q, *self.beyond.domain)) if self.beyond is not None else 0.0
        return np.asarray(columns @ self.p_xi + more)


@dataclass(frozen=True)
class GravityFit:
    """p_xi of every configuration that has pairs."""

    groups: list[GravityGroup]
    unpaired: int  # trials of the other configurations
    directional: bool = False
    asymmetry: float = 0.0  # share of friction that depends on the direction


@dataclass(frozen=True)
class Clustered:
    """Least squares of rows that share errors in clusters, which pull theta by `moves` (G, p)."""

    theta: Array
    left: Array  # residual
    bread: Array  # inverse of the normal matrix
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


def configurations(trials: list[Trial], *, same_configuration: float = 0.03) -> list[list[Trial]]:
    """Group trials of one joint by where the other joints are locked."""
    groups: list[list[Trial]] = []
    for trial in trials:
        others = np.arange(len(trial.configuration)) != trial.joint
        for group in groups:
            off = np.abs(trial.configuration - group[0].configuration)
            if (off[others] < same_configuration).all():
                group.append(trial)
                break
        else:
            groups.append([trial])
    return groups


def _half_sums(group: list[Trial]) -> list[Array]:
    """Half-sums of forward and backward trials of one configuration (Eq. 15), pair by pair."""
    # Columns (K, 5): position rad, half-sum N m, half the difference N m, speed, samples per slice.
    result = []
    for level in speed_levels(group):
        back = [t for t in level if t.velocity < 0]
        for ahead in (t for t in level if t.velocity > 0):
            met = [(ahead.q >= twin.q.min()) & (ahead.q <= twin.q.max()) for twin in back]
            best = max(range(len(back)), key=lambda k: int(met[k].sum()), default=-1)
            if best < 0 or met[best].sum() < 4:
                continue
            at, twin = met[best], back.pop(best)
            order = np.argsort(twin.q)
            q, tau = ahead.q[at], ahead.tau[at]
            other = np.interp(q, twin.q[order], twin.tau[order])
            speed, weight = np.full(len(q), level[0].speed), np.full(len(q), ahead.weight)
            result.append(np.stack([q, (tau + other) / 2, (tau - other) / 2, speed, weight], 1))
    return result


def fit_gravity(
    robot: Robot, groups: list[list[Trial]], *, degree: int = 8, clear: float = 0.7
) -> GravityFit:
    """Fit p_xi to the half-sums of a joint's `configurations`, friction alike both ways or not."""

    # What depends on the position is a polynomial of some `degree`; another law is clearly better
    # where it leaves less than `clear` of the squares.
    def columns_of(group: list[Trial], q: Array) -> Array:
        return gravity_columns(robot, group[0].joint, group[0].configuration, q)

    none, paired = np.zeros(0), [(g, pairs) for g in groups if (pairs := _half_sums(g))]
    if len(paired) < len(groups) and not any(columns_of(g, none).shape[1] for g in groups):
        # Nothing to remove, no twin needed.
        return GravityFit([GravityGroup(robot, group, none, none) for group in groups], 0)
    unpaired = sum(map(len, groups)) - sum(len(group) for group, _ in paired)
    if not paired:
        return GravityFit([], unpaired)
    table = _Pairs([pair for _, pairs in paired for pair in pairs], degree, clear)
    a = [columns_of(group, np.vstack(pairs)[:, 0]) for group, pairs in paired]
    columns, kept = block_diag(*a), [group for group, _ in paired]
    # A share of friction may depend on the direction, or an offset, as a slide's gravity is one.
    slope = table.speed / table.speed.max()
    extras = [np.stack([x, slope], 1) for x in (table.dry(), np.ones_like(table.q))]
    if robot.chain.prismatic[kept[0][0].joint] and columns.shape[1]:
        extras = [slope[:, None]]
    plain, other, extra, beyond = table.both_ways(columns, extras)
    share, directional = _asymmetry(plain, other, extra, kept)
    found = other if directional else plain
    ends = pairwise(np.cumsum([0, *(own.shape[1] for own in a)]))
    fitted = [
        GravityGroup(robot, group, found.theta[i:j], found.std_error[i:j], beyond)
        for group, (i, j) in zip(kept, ends, strict=True)
    ]
    return GravityFit(fitted, unpaired, directional, share)


class _Pairs:
    """Half-sums of a joint, row by row (N,), and the pair that each is of, numbered from 0."""

    def __init__(self, pairs: list[Array], degree: int, clear: float) -> None:
        self.q, self.tau, self.friction, self.speed, weight = np.vstack(pairs).T
        self.root = np.sqrt(weight)
        self.lengths = [len(pair) for pair in pairs]
        self.pair = np.repeat(np.arange(len(pairs)), self.lengths)
        self.degree, self.clear = degree, clear

    def dry(self) -> Array:
        """Friction (N,) N m less what goes with the speed, smooth over the position."""
        place = np.interp(self.q, [self.q.min(), self.q.max()], [-1.0, 1.0])
        columns = np.column_stack([chebyshev.chebvander(place, self.degree), self.speed])
        root = self.root[:, None]
        found = np.linalg.lstsq(columns * root, self.friction * self.root, rcond=1e-10)[0]
        return np.asarray(columns[:, :-1] @ found[:-1])

    def both_ways(
        self, columns: Array, extras: list[Array], *, enough_pairs: int = 8
    ) -> tuple[Clustered, Clustered, Array, Chebyshev | None]:
        """Fit what both ways have: gravity's columns (N, p), these with the best of `extras`."""
        # Drift and friction errors are shared within a pair; fewer than `enough_pairs` are cut up.
        # Returns both fits, the extra one, and what is left over the position.
        cut = 1 if len(self.lengths) >= enough_pairs else 4
        block = np.hstack([k * cut + np.arange(n) * cut // n for k, n in enumerate(self.lengths)])

        def fits(y: Array) -> tuple[Clustered, Clustered, Array]:
            """The first of several, or one that leaves clearly less than those before it."""
            bases = (columns, *(np.hstack([columns, extra]) for extra in extras))
            root = self.root
            plain, best, *others = (Clustered.of(A * root[:, None], y * root, block) for A in bases)
            extra = extras[0]
            for fit, own in zip(others, extras[1:], strict=True):
                if fit.left @ fit.left < self.clear * (best.left @ best.left):
                    best, extra = fit, own
            return plain, best, extra

        found = fits(self.tau)
        beyond = self._beyond(*(fit.left / self.root for fit in found[:2]))
        return (*(found if beyond is None else fits(self.tau - beyond(self.q))), beyond)

    def _beyond(self, left: Array, unlike: Array) -> Chebyshev | None:
        """Torque over the position that half-sums have beyond gravity, from what is `left`."""
        # None, unless it leaves of pairs that are left out less than `clear` of the squares of
        # `unlike` (N,) N m, without friction that depends on the direction.
        domain = [float(self.q.min()), float(self.q.max())]

        def fitted(values: Array, some: Mask) -> Chebyshev:
            q, w = self.q[some], self.root[some]
            return Chebyshev.fit(q, values[some], self.degree, domain=domain, w=w)

        others = [self.pair != k for k in range(len(self.lengths))]
        if min(np.count_nonzero(some) for some in others) <= self.degree:
            return None
        rest = unlike.copy()
        for some in others:
            own = ~some & (self.q >= self.q[some].min()) & (self.q <= self.q[some].max())
            rest[own] -= fitted(unlike, some)(self.q[own])
        if np.sum((rest * self.root) ** 2) >= self.clear * np.sum((unlike * self.root) ** 2):
            return None
        return fitted(left, self.pair >= 0)


def _asymmetry(
    plain: Clustered,
    extended: Clustered,
    extra: Array,
    groups: list[list[Trial]],
    *,
    min_share: float = 0.02,
    min_sigma: float = 6.0,
) -> tuple[float, bool]:
    """Share of friction that depends on direction, and whether it is large and significant."""
    means = [
        [np.mean([t.tau.mean() for t in g if t.velocity * way > 0]) for way in (1, -1)]
        for g in groups
    ]
    friction = float(np.sqrt(np.mean((np.diff(means) / 2) ** 2)))  # of half the difference
    solution, errors = (x[len(plain.theta) :] for x in (extended.theta, extended.std_error))
    share = float(np.sqrt(np.mean((extra @ solution) ** 2)) / max(friction, 1e-12))
    sigma = np.abs(solution) / np.maximum(errors, 1e-300)
    helps = extended.left @ extended.left < 0.97 * (plain.left @ plain.left)
    return share, bool(share > min_share and sigma.max() > min_sigma and helps)
