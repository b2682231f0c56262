"""Eq. 12-15: the gravity torque of single-joint trials, and what friction has alike both ways.

Forward and backward trials at one speed have the half-sum

    (tau_1 + tau_2) / 2 = a(q)' p_xi + o + (f_forward - f_backward) / 2.

Gravity cannot know the speed and has the shape a(q). The offset o of the drive, and the
last term, which Eq. 15 takes to be zero, look like it where trials sweep a short way.
Friction that depends on the direction is a share of its dry part and a share of what it
has more at higher speeds. All three are unknowns beside p_xi with the priors of
`identify.nuisances`, and none of them is decided upon: what the sweep does not tell
apart goes into the standard errors of all.

Friction at a place is half the difference of the two trials. What else is the same both
ways and depends on the position alone, as the torque of a spring or a cable does, is
fitted as well: left in, it would be friction's noise.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev
from scipy.linalg import block_diag

from seqid_cli.identify.friction_surface.trials import Trial, speed_levels
from seqid_cli.identify.nuisances import EVEN_TERMS, PRIORS, EvenPart
from seqid_cli.identify.settings import TrialSettings
from seqid_cli.robot.kinematics import gravity_columns
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

NO_EVEN_PART = EvenPart(
    values=np.zeros(EVEN_TERMS), covariance=np.zeros((EVEN_TERMS, EVEN_TERMS))
)


@dataclass(frozen=True)
class SmoothFriction:
    """Friction of one joint, smooth over the position and straight over the speed."""

    over_position: Chebyshev  # at the slowest speed
    per_speed: float  # N m s/rad
    slowest: float  # rad/s

    def torque(self, q: Array, speed: Array | float) -> Array:
        """Return the size (K,) N m of friction at positions q (K,) rad and a speed."""
        domain = self.over_position.domain
        dry = self.over_position(np.clip(q, domain[0], domain[1]))
        return np.asarray(dry + self.per_speed * (speed - self.slowest))

    def even_columns(self, q: Array, speed: Array) -> Array:
        """Return torques (K, 3) of one offset, and of one of each asymmetry [N m]."""
        dry = self.torque(q, self.slowest)
        return np.column_stack([np.ones(len(q)), dry, self.torque(q, speed) - dry])


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
        columns = gravity_columns(
            self.robot, self.trials[0].joint, self.configuration, q
        )
        more = (
            self.beyond(np.clip(q, *self.beyond.domain))
            if self.beyond is not None
            else 0.0
        )
        return np.asarray(columns @ self.p_xi + more)

    def slope(self, q: Array, *, step: float = 1e-4) -> Array:
        """Derivative (K,) N m/rad of gravity's torque by the position of the moving joint."""
        joint = self.trials[0].joint
        ahead = gravity_columns(self.robot, joint, self.configuration, q + step)
        back = gravity_columns(self.robot, joint, self.configuration, q - step)
        return np.asarray((ahead - back) @ self.p_xi / (2.0 * step))


@dataclass(frozen=True)
class GravityFit:
    """p_xi of every configuration that has pairs, and what friction has alike both ways."""

    groups: list[GravityGroup]
    unpaired: int  # trials of the other configurations
    even: EvenPart = field(default=NO_EVEN_PART)
    friction: SmoothFriction | None = None  # that the asymmetries are shares of

    def even_torque(self, q: Array, speed: float) -> Array:
        """Torque (K,) N m that is no gravity and the same both ways at positions q (K,)."""
        if self.friction is None:
            return np.zeros(len(q))
        columns = self.friction.even_columns(q, np.full(len(q), speed))
        return np.asarray(columns @ self.even.values)

    @property
    def asymmetry(self) -> float:
        """Share of the friction that does not turn with the direction, RMS."""
        if self.friction is None:
            return 0.0
        low, high = self.friction.over_position.domain
        q = np.linspace(float(low), float(high), 33)
        size = self.friction.torque(q, self.friction.slowest)
        even = self.even_torque(q, self.friction.slowest)
        return float(np.sqrt(np.mean(even**2) / max(float(np.mean(size**2)), 1e-300)))


@dataclass(frozen=True)
class Clustered:
    """Least squares of rows that share errors in clusters, which pull theta by `moves` (G, p)."""

    theta: Array
    left: Array  # residual
    bread: Array  # inverse of the normal matrix
    moves: Array
    prior_covariance: Array  # (p, p) what the prior's own errors make

    @classmethod
    def of(
        cls, A: Array, y: Array, cluster: Index, prior_std: Array | None = None
    ) -> "Clustered":
        """Solve the rows of clusters.

        Parameters
        ----------
        A : (N, p) array
        y : (N,) array
        cluster : (N,) array
            Of each row, numbered from 0.
        prior_std : (p,) array, optional
            Standard deviations of theta about zero before the rows; infinite where
            nothing is known. A prior counts beside rows whose errors are shared, so its
            weight is that of the rows' errors as their clusters show them, not of white
            noise.
        """
        unknown = np.full(A.shape[1], np.inf)
        free = cls._solved(A, y, cluster, 1.0, unknown)
        if prior_std is None:
            return free
        spare = max(len(y) - A.shape[1], 1)
        white = float(free.left @ free.left) / spare * np.diag(free.bread)
        shared = np.diag(free.covariance)
        seen = white > 0.0
        design = (
            max(float(np.median(shared[seen] / white[seen])), 1.0)
            if seen.any()
            else 1.0
        )
        variance = design * float(free.left @ free.left) / spare
        return cls._solved(A, y, cluster, variance, prior_std)

    @classmethod
    def _solved(
        cls, A: Array, y: Array, cluster: Index, variance: float, prior_std: Array
    ) -> "Clustered":
        """Solve with a prior beside rows whose errors weigh as those of a `variance` do."""
        precision = variance / prior_std**2
        rows = np.vstack([A, np.diag(np.sqrt(precision))])
        right = np.concatenate([y, np.zeros(A.shape[1])])
        theta = np.asarray(
            np.linalg.lstsq(rows, right, rcond=1e-10)[0], dtype=np.float64
        )
        left = y - A @ theta
        bread = np.asarray(np.linalg.pinv(A.T @ A + np.diag(precision), hermitian=True))
        scores = np.zeros((int(cluster.max()) + 1, A.shape[1]))
        np.add.at(scores, cluster, A * left[:, None])
        of_prior = bread * precision * np.where(np.isfinite(prior_std), prior_std, 0.0)
        return cls(theta, left, bread, scores @ bread, of_prior @ of_prior.T)

    @property
    def covariance(self) -> Array:
        """Covariance (p, p), robust within clusters."""
        count, p = self.moves.shape
        factor = count / max(count - p, 1)
        return np.asarray(factor * self.moves.T @ self.moves + self.prior_covariance)

    @property
    def std_error(self) -> Array:
        """Standard errors (p,), robust within clusters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def configurations(
    trials: list[Trial], settings: TrialSettings = TrialSettings()
) -> list[list[Trial]]:
    """Group trials of one joint by where the other joints are locked."""
    groups: list[list[Trial]] = []
    for trial in trials:
        others = np.arange(len(trial.configuration)) != trial.joint
        for group in groups:
            off = np.abs(trial.configuration - group[0].configuration)
            if (off[others] < settings.same_configuration).all():
                group.append(trial)
                break
        else:
            groups.append([trial])
    return groups


def _half_sums(group: list[Trial]) -> list[Array]:
    """Half-sums of forward and backward trials of one configuration (Eq. 15), pair by pair."""
    # Columns (K, 5): position rad, half-sum N m, half the difference N m, speed,
    # samples per slice.
    result = []
    for level in speed_levels(group):
        back = [t for t in level if t.velocity < 0]
        for ahead in (t for t in level if t.velocity > 0):
            met = [
                (ahead.q >= twin.q.min()) & (ahead.q <= twin.q.max()) for twin in back
            ]
            best = max(range(len(back)), key=lambda k: int(met[k].sum()), default=-1)
            if best < 0 or met[best].sum() < 4:
                continue
            at, twin = met[best], back.pop(best)
            order = np.argsort(twin.q)
            q, tau = ahead.q[at], ahead.tau[at]
            other = np.interp(q, twin.q[order], twin.tau[order])
            speed, weight = (
                np.full(len(q), level[0].speed),
                np.full(len(q), ahead.weight),
            )
            result.append(
                np.stack([q, (tau + other) / 2, (tau - other) / 2, speed, weight], 1)
            )
    return result


def fit_gravity(
    robot: Robot, groups: list[list[Trial]], *, degree: int = 8, clear: float = 0.7
) -> GravityFit:
    """Separate gravity, offset and asymmetry of one joint from its friction.

    Parameters
    ----------
    robot : Robot
    groups : list of lists of Trial
        The joint's trials by where the others are locked (`configurations`).
    degree : int
        Of the polynomial over the position that friction is smoothed by.
    clear : float
        Torque over the position that is no gravity is believed where trials that are
        left out keep less than this share of their squares.
    """
    none = np.zeros(0)
    joint = groups[0][0].joint
    paired = [(group, pairs) for group in groups if (pairs := _half_sums(group))]
    loads = any(
        gravity_columns(robot, joint, g[0].configuration, none).shape[1] for g in groups
    )
    if len(paired) < len(groups) and not loads:
        # Nothing to remove, no twin needed.
        return GravityFit(
            [GravityGroup(robot, group, none, none) for group in groups], 0
        )
    unpaired = sum(map(len, groups)) - sum(len(group) for group, _ in paired)
    if not paired:
        return GravityFit([], unpaired)

    table = _Pairs([pair for _, pairs in paired for pair in pairs], degree, clear)
    by_group = [
        gravity_columns(robot, joint, group[0].configuration, np.vstack(pairs)[:, 0])
        for group, pairs in paired
    ]
    gravity = block_diag(*by_group)
    friction = table.smooth_friction()
    even_columns = friction.even_columns(table.q, table.speed)
    size = friction.torque(table.q, table.speed)
    prior_std = PRIORS.even_std(float(np.sqrt(np.mean(size**2))))
    fit, even, beyond = table.both_ways(gravity, even_columns, prior_std)
    std_error = fit.std_error
    ends = pairwise(np.cumsum([0, *(columns.shape[1] for columns in by_group)]))
    separated = [
        GravityGroup(robot, group, fit.theta[start:stop], std_error[start:stop], beyond)
        for (group, _), (start, stop) in zip(paired, ends, strict=True)
    ]
    return GravityFit(separated, unpaired, even, friction)


class _Pairs:
    """Half-sums of a joint, row by row (N,), and the pair that each is of, numbered from 0."""

    def __init__(self, pairs: list[Array], degree: int, clear: float) -> None:
        self.q, self.tau, self.friction, self.speed, weight = np.vstack(pairs).T
        self.root = np.sqrt(weight)
        self.lengths = [len(pair) for pair in pairs]
        self.pair = np.repeat(np.arange(len(pairs)), self.lengths)
        self.degree, self.clear = degree, clear

    def smooth_friction(self) -> SmoothFriction:
        """Return friction, smooth over the position and straight over the speed."""
        domain = [float(self.q.min()), float(self.q.max())]
        place = np.interp(self.q, domain, [-1.0, 1.0])
        columns = np.column_stack(
            [chebyshev.chebvander(place, self.degree), self.speed]
        )
        root = self.root[:, None]
        entries = np.linalg.lstsq(
            columns * root, self.friction * self.root, rcond=1e-10
        )[0]
        slowest, slope = float(self.speed.min()), float(entries[-1])
        dry = Chebyshev(entries[:-1], domain=domain) + slope * slowest
        return SmoothFriction(dry, slope, slowest)

    def both_ways(
        self, gravity: Array, even: Array, even_std: Array, *, enough_pairs: int = 8
    ) -> tuple[Clustered, EvenPart, Chebyshev | None]:
        """Fit what both ways have.

        Parameters
        ----------
        gravity : (N, p) array
            Columns of p_xi, per kg m.
        even : (N, 3) array
            Columns of offset and asymmetries, with standard deviations `even_std` (3,)
            about zero.
        enough_pairs : int
            Drift and errors of friction are shared within a pair; fewer pairs are cut
            up.

        Returns
        -------
        fit : Clustered
            Of [gravity, even].
        even : EvenPart
        beyond : Chebyshev or None
            Torque over the position that half-sums have beyond all of it.
        """
        cut = 1 if len(self.lengths) >= enough_pairs else 4
        block = np.hstack(
            [k * cut + np.arange(n) * cut // n for k, n in enumerate(self.lengths)]
        )
        columns = np.hstack([gravity, even])
        prior_std = np.concatenate([np.full(gravity.shape[1], np.inf), even_std])
        root = self.root
        weighted = columns * root[:, None]

        fit = Clustered.of(weighted, self.tau * root, block, prior_std)
        first = gravity.shape[1]
        even_part = EvenPart(
            values=fit.theta[first:], covariance=fit.covariance[first:, first:]
        )
        beyond = self._beyond(fit.left / root)
        if beyond is None:
            return fit, even_part, None

        # A polynomial of the position beside offset and asymmetries, these held by
        # their prior: a spring is none of them.
        place = np.interp(self.q, beyond.domain, [-1.0, 1.0])
        terms = np.column_stack([even, chebyshev.chebvander(place, self.degree)])
        terms_std = np.concatenate([even_std, np.full(self.degree + 1, np.inf)])
        rest = (self.tau - gravity @ fit.theta[:first]) * root
        split = Clustered.of(terms * root[:, None], rest, block, terms_std)
        count = len(even_std)
        even_part = EvenPart(
            values=split.theta[:count], covariance=split.covariance[:count, :count]
        )
        return fit, even_part, Chebyshev(split.theta[count:], domain=beyond.domain)

    def _beyond(self, left: Array) -> Chebyshev | None:
        """Return the torque over the position that is in what is `left` (N,) N m, or None."""
        # None, unless of pairs that are left out it leaves less than `clear` of the
        # squares.
        domain = [float(self.q.min()), float(self.q.max())]

        def fitted(some: Mask) -> Chebyshev:
            q, w = self.q[some], self.root[some]
            return Chebyshev.fit(q, left[some], self.degree, domain=domain, w=w)

        others = [self.pair != k for k in range(len(self.lengths))]
        if min(np.count_nonzero(some) for some in others) <= self.degree:
            return None
        rest = left.copy()
        for some in others:
            inside = (self.q >= self.q[some].min()) & (self.q <= self.q[some].max())
            left_out = ~some & inside
            rest[left_out] -= fitted(some)(self.q[left_out])
        if np.sum((rest * self.root) ** 2) >= self.clear * np.sum(
            (left * self.root) ** 2
        ):
            return None
        return fitted(self.pair >= 0)
