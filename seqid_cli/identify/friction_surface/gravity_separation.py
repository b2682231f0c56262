"""Eq. 12-15: gravity's torque of single-joint trials, and the even part of friction.

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

from seqid_cli.identify.friction_surface.trials import Trial, speed_levels
from seqid_cli.identify.nuisances import EVEN_TERMS, PRIORS, EvenPart
from seqid_cli.identify.settings import TrialSettings
from seqid_cli.matrices import block_diagonal
from seqid_cli.robot.kinematics import gravity_columns
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

# Slices at positions of both trials, that a pair needs.
LEAST_SHARED_SLICES = 4
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


@dataclass(frozen=True, kw_only=True)
class GravityGroup:
    """Trials in one configuration and their gravity.

    p_xi (2,) is in kg m; `beyond` is torque over the position that is no gravity.
    """

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
        """Return the torque (K,) N m common to both directions at q (K,) (Eq. 12)."""
        joint = self.trials[0].joint
        columns = gravity_columns(self.robot, joint, self.configuration, q)
        torque = columns @ self.p_xi
        if self.beyond is not None:
            torque = torque + self.beyond(np.clip(q, *self.beyond.domain))
        return np.asarray(torque)

    def slope(self, q: Array, *, step: float = 1e-4) -> Array:
        """Return the derivative (K,) N m/rad of gravity's torque by the joint's q."""
        joint = self.trials[0].joint
        ahead = gravity_columns(self.robot, joint, self.configuration, q + step)
        back = gravity_columns(self.robot, joint, self.configuration, q - step)
        return np.asarray((ahead - back) @ self.p_xi / (2.0 * step))


@dataclass(frozen=True)
class GravityFit:
    """p_xi of every configuration with pairs, and the even part of friction."""

    groups: list[GravityGroup]
    unpaired: int  # trials of the other configurations
    even: EvenPart = field(default=NO_EVEN_PART)
    friction: SmoothFriction | None = None  # that the asymmetries are shares of

    def even_torque(self, q: Array, speed: float) -> Array:
        """Return the even torque (K,) N m at q (K,) that is no gravity."""
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


@dataclass(frozen=True, kw_only=True)
class Clustered:
    """Least squares of rows that share errors in clusters.

    Each cluster pulls theta by a row of `moves` (G, p).
    """

    theta: Array
    residual: Array  # residual
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
        n_spare = max(len(y) - A.shape[1], 1)
        white_variance = float(free.residual @ free.residual) / n_spare
        white = white_variance * np.diag(free.bread)
        shared = np.diag(free.covariance)
        # How many times the clusters' variance is that of white noise.
        design = 1.0
        is_seen = white > 0.0
        if is_seen.any():
            design = max(float(np.median(shared[is_seen] / white[is_seen])), 1.0)
        return cls._solved(A, y, cluster, design * white_variance, prior_std)

    @classmethod
    def _solved(
        cls, A: Array, y: Array, cluster: Index, variance: float, prior_std: Array
    ) -> "Clustered":
        """Solve with a prior beside rows that weigh as errors of `variance` do."""
        precision = variance / prior_std**2
        rows = np.vstack([A, np.diag(np.sqrt(precision))])
        right = np.concatenate([y, np.zeros(A.shape[1])])
        theta = np.asarray(
            np.linalg.lstsq(rows, right, rcond=1e-10)[0], dtype=np.float64
        )
        residual = y - A @ theta
        bread = np.asarray(np.linalg.pinv(A.T @ A + np.diag(precision), hermitian=True))
        scores = np.zeros((int(cluster.max()) + 1, A.shape[1]))
        np.add.at(scores, cluster, A * residual[:, None])
        of_prior = bread * precision * np.where(np.isfinite(prior_std), prior_std, 0.0)
        return cls(
            theta=theta,
            residual=residual,
            bread=bread,
            moves=scores @ bread,
            prior_covariance=of_prior @ of_prior.T,
        )

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
    """Return half-sums of forward and backward trials of one configuration (Eq. 15).

    Each pair has columns (K, 5): position [rad], half the sum and half the difference
    of the torques [N m], speed [rad/s], samples per slice.
    """
    pairs = []
    for level in speed_levels(group):
        backward = [trial for trial in level if trial.velocity < 0]
        for forward in level:
            if forward.velocity <= 0 or not backward:
                continue
            shared = [
                (forward.q >= twin.q.min()) & (forward.q <= twin.q.max())
                for twin in backward
            ]
            best = max(range(len(backward)), key=lambda k: int(shared[k].sum()))
            inside = shared[best]
            if inside.sum() < LEAST_SHARED_SLICES:
                continue
            twin = backward.pop(best)
            order = np.argsort(twin.q)
            q = forward.q[inside]
            tau = forward.tau[inside]
            twin_tau = np.interp(q, twin.q[order], twin.tau[order])
            speed = np.full(len(q), level[0].speed)
            weight = np.full(len(q), forward.weight)
            half_sum = (tau + twin_tau) / 2
            half_difference = (tau - twin_tau) / 2
            pairs.append(np.stack([q, half_sum, half_difference, speed, weight], 1))
    return pairs


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
            [
                GravityGroup(robot=robot, trials=group, p_xi=none, std_error=none)
                for group in groups
            ],
            0,
        )
    unpaired = sum(map(len, groups)) - sum(len(group) for group, _ in paired)
    if not paired:
        return GravityFit([], unpaired)

    table = _Pairs([pair for _, pairs in paired for pair in pairs], degree, clear)
    by_group = [
        gravity_columns(robot, joint, group[0].configuration, np.vstack(pairs)[:, 0])
        for group, pairs in paired
    ]
    gravity = block_diagonal(*by_group)
    friction = table.smooth_friction()
    even_columns = friction.even_columns(table.q, table.speed)
    size = friction.torque(table.q, table.speed)
    prior_std = PRIORS.even_std(float(np.sqrt(np.mean(size**2))))
    fit, even, beyond = table.both_ways(gravity, even_columns, prior_std)
    std_error = fit.std_error
    ends = pairwise(np.cumsum([0, *(columns.shape[1] for columns in by_group)]))
    separated = [
        GravityGroup(
            robot=robot,
            trials=group,
            p_xi=fit.theta[start:stop],
            std_error=std_error[start:stop],
            beyond=beyond,
        )
        for (group, _), (start, stop) in zip(paired, ends, strict=True)
    ]
    return GravityFit(separated, unpaired, even, friction)


class _Pairs:
    """Half-sums of a joint, row by row (N,).

    `pair` numbers the pair of each row from 0.
    """

    def __init__(self, pairs: list[Array], degree: int, clear: float) -> None:
        self.q, self.tau, self.friction, self.speed, weight = np.vstack(pairs).T
        self.root = np.sqrt(weight)
        self.lengths = [len(pair) for pair in pairs]
        self.pair = np.repeat(np.arange(len(pairs)), self.lengths)
        self.degree = degree
        self.clear = clear

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
        slowest = float(self.speed.min())
        per_speed = float(entries[-1])
        dry = Chebyshev(entries[:-1], domain=domain) + per_speed * slowest
        return SmoothFriction(dry, per_speed, slowest)

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
        cuts = 1 if len(self.lengths) >= enough_pairs else 4
        block = np.hstack(
            [k * cuts + np.arange(n) * cuts // n for k, n in enumerate(self.lengths)]
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
        beyond = self._beyond(fit.residual / root)
        if beyond is None:
            return fit, even_part, None

        # A polynomial of the position beside offset and asymmetries, these held by
        # their prior: a spring is none of them.
        place = np.interp(self.q, beyond.domain, [-1.0, 1.0])
        terms = np.column_stack([even, chebyshev.chebvander(place, self.degree)])
        terms_std = np.concatenate([even_std, np.full(self.degree + 1, np.inf)])
        without_gravity = (self.tau - gravity @ fit.theta[:first]) * root
        split = Clustered.of(terms * root[:, None], without_gravity, block, terms_std)
        count = len(even_std)
        even_part = EvenPart(
            values=split.theta[:count], covariance=split.covariance[:count, :count]
        )
        return fit, even_part, Chebyshev(split.theta[count:], domain=beyond.domain)

    def _beyond(self, residual: Array) -> Chebyshev | None:
        """Return the torque over the position that is in a residual (N,) N m.

        None, unless of pairs that are left out it leaves less than `clear` of the
        squares.
        """
        domain = [float(self.q.min()), float(self.q.max())]

        def fitted(rows: Mask) -> Chebyshev:
            return Chebyshev.fit(
                self.q[rows],
                residual[rows],
                self.degree,
                domain=domain,
                w=self.root[rows],
            )

        without_pair = [self.pair != k for k in range(len(self.lengths))]
        if min(np.count_nonzero(rows) for rows in without_pair) <= self.degree:
            return None
        predicted = residual.copy()
        for rows in without_pair:
            low = self.q[rows].min()
            high = self.q[rows].max()
            left_out = ~rows & (self.q >= low) & (self.q <= high)
            predicted[left_out] -= fitted(rows)(self.q[left_out])
        squares = np.sum((residual * self.root) ** 2)
        if np.sum((predicted * self.root) ** 2) >= self.clear * squares:
            return None
        return fitted(self.pair >= 0)
