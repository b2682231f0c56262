"""Sizes of the terms of a friction surface and of the errors of its trials, from data.

Slices of motion k, reduced (`reduction`), are

    z_k = R_k (D phi(u_k) + e_k) + n_k,

D the surface, phi Chebyshev polynomials of the scaled speed, n_k white noise of
variance s_n^2, and e_k what the motion, a trial as a rule, has for itself: an offset of
variance s_t^2 and terms of degree j of variance s_s^2 / j, which is how 1/f noise over
the length of a trial spreads over polynomials; torque of a speed that changes by a
share of itself along its way, I dv/dt ~ v^2, of variance s_a^2 (v / v_max)^4 / max(j,
1); and at its ends what is left of acceleration, of variance s_e^2 (R_k has columns for
it). All
trials share the error of the inertia whose torque was taken off them, that of how far
held joints gave way, the delay of the torque and the change of friction per kelvin:
entries of D beside the surface, of variance 1, whose columns are the torque of one
standard error. The other entries of D are Gaussian too. Coulomb and viscous friction,
d_00 and d_01, are as large as they like; others have variances that fall with their
degrees,

    var d_j0 = s_q^2 / j^a,   var d_0r = s_v^2 / r^b,   var d_jr = s_qv^2 / (j^a r^b).

The eight sizes and both powers maximise the marginal likelihood of all slices (C. E.
Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, Sec.
5.4), which, as restricted likelihood does, allows for what the surface takes. What data
do not tell stays near what is usual.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.friction_surface.reduction import (
    EDGES,
    EXTRA,
    SHARED,
    Orders,
    Reduced,
)
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.typing import Array

# Usual sizes in shares of the RMS friction: of position, speed, surface, trial, slow,
# unsteady and edge, in the order of `Sizes`.
USUAL_SHARES = (0.1, 0.1, 0.03, 0.01, 0.01, 0.01, 0.1)
USUAL_DECAY = 3.0  # power with which variances fall with the degree
BROAD = 3.0  # of Coulomb and viscous friction, in RMS frictions
# Standard deviation of a size's logarithm about the usual one, and of a power's.
SPREAD = float(np.log(10.0))
DECAY_SPREAD = float(np.log(2.0))
# Noise is no smaller than this share of the RMS friction.
LEAST_NOISE = 1e-6
# The covariance of a trial gets this share of its largest variance, against rounding.
ROUNDING = 1e-14
# The search goes no further than so many spreads from the usual sizes.
SEARCH_LIMIT = 5.0
# By which the logarithm of the noise is below that of what is left of trials, at most.
LOWEST_NOISE = float(np.log(3.0))
# Newton's method is believed within this reach of its start, in logarithms.
NEWTON_REACH = 0.3
NEWTON_ROUNDS = 20
CAUSES = 4  # of what a trial has for itself: offset, slow changes, speed, edges


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Standard deviations [N m] of the surface's terms and of the errors of trials.

    Terms are those over `position`, over `speed`, and over both (`surface`). Errors are
    a `trial`'s own offset, its `slow` changes, its `unsteady` speed if it is the
    fastest, its `edge`s, and the white `noise` of one sample. `position_decay` and
    `speed_decay` are the powers with which variances fall. `broad`, of Coulomb and
    viscous friction, is fixed.
    """

    position: float
    speed: float
    surface: float
    trial: float
    slow: float
    unsteady: float
    edge: float
    noise: float
    position_decay: float
    speed_decay: float
    broad: float

    def prior(self, scaling: Scaling, size: int, orders: Orders) -> Array:
        """Return standard deviations (size + 6, l + 1) of a surface's entries.

        They are 0 above position order m, and for the ends of a trial, which the
        surface has not. The last four are those of errors that are one and the same in
        all trials.
        """
        over_position = scaling.over_position
        j = over_position.degrees(over_position.order(size))[:, None]
        r = np.arange(orders.velocity + 1.0)[None, :]
        decay = np.maximum(j, 1.0) ** (-self.position_decay / 2.0)
        decay = decay * np.maximum(r, 1.0) ** (-self.speed_decay / 2.0)
        of_position = np.where(r == 0, self.position, self.surface)
        kind = np.where(j == 0, self.speed, of_position)
        is_broad = (j == 0) & (r <= 1)
        entries = np.where(is_broad, self.broad, kind * decay)
        entries[over_position.size(orders.position) :] = 0.0
        edges = np.zeros((EDGES, entries.shape[1]))
        shared = np.tile(np.eye(1, entries.shape[1]), (SHARED, 1))
        return np.vstack([entries, edges, shared])

    def trial_variances(self, scaling: Scaling, size: int, speeds: Array) -> Array:
        """Return variances (4, T, size + 6) of trials' own terms, by causes.

        `speeds` (T,) are those of the trials.
        """
        degree = scaling.over_position.degrees(scaling.over_position.order(size))
        at_least_one = np.maximum(degree, 1.0)
        variances = np.zeros((CAUSES, len(speeds), size + EXTRA))
        variances[0, :, :size] = np.where(degree == 0, self.trial**2, 0.0)
        variances[1, :, :size] = np.where(degree > 0, self.slow**2 / at_least_one, 0.0)
        fast = (speeds / scaling.speed[1]) ** 4
        variances[2, :, :size] = self.unsteady**2 * np.outer(fast, 1.0 / at_least_one)
        variances[3, :, size : size + EDGES] = self.edge**2
        return variances


@dataclass(frozen=True, kw_only=True)
class EntryPosterior:
    """Mean (k,) and covariance (k, k) of a surface's entries beside their prior.

    `log_size` is log det(1 + P^1/2 N P^1/2), with P the prior's variances.
    """

    mean: Array
    covariance: Array
    log_size: float


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Normal equations of a surface's k entries, row-major: N (k, k) d = b (k,).

    With T trials of p functions of position and r of speed, `phi` (T, r) are the
    trials' functions of speed, `trial_variances` (4, T, p) those of their own terms,
    `inverse` (T, p, p) the inverses of their covariances V_k, and `S` (T, p, p) is
    R' V^-1 R. `log_size` is the sum of log det V_k, `power` the sum of z' V^-1 z.
    """

    N: Array
    b: Array
    phi: Array
    trial_variances: Array
    inverse: Array
    S: Array
    log_size: float
    power: float

    @classmethod
    def of(cls, trials: Reduced, sizes: Sizes, velocity_order: int) -> "Normal":
        """Add up the trials."""
        R = trials.R
        z = trials.z
        phi = trials.over_speed(velocity_order)
        variances = sizes.trial_variances(trials.scaling, trials.size, trials.speeds)
        scaled = R * np.sqrt(variances.sum(axis=0))[:, None, :]
        V = scaled @ scaled.transpose(0, 2, 1)
        diagonal = np.arange(V.shape[1])
        rounding = ROUNDING * V[:, diagonal, diagonal].max(axis=1, keepdims=True)
        V[:, diagonal, diagonal] += sizes.noise**2 + rounding

        inverse = np.asarray(np.linalg.inv(V), dtype=np.float64)
        weighted_R = R.transpose(0, 2, 1) @ inverse
        S: Array = weighted_R @ R
        t = (weighted_R @ z[:, :, None])[:, :, 0]
        p = V.shape[1]
        r = phi.shape[1]
        summed = S.reshape(-1, p * p).T @ _products(phi)
        N = summed.reshape(p, p, r, r).transpose(0, 2, 1, 3).reshape(p * r, p * r)
        return cls(
            N=N,
            b=(t.T @ phi).ravel(),
            phi=phi,
            trial_variances=variances,
            inverse=inverse,
            S=S,
            log_size=float(np.linalg.slogdet(V)[1].sum()),
            power=float(np.sum(z * (inverse @ z[:, :, None])[:, :, 0])),
        )

    def posterior(self, prior: Array) -> EntryPosterior:
        """Return the posterior of the entries, given prior standard deviations (k,)."""
        from scipy.linalg import cho_factor
        from scipy.linalg.lapack import dpotri

        free = np.flatnonzero(prior)  # of the others nothing is left open
        among_free = np.ix_(free, free)
        scale = np.outer(prior[free], prior[free])
        inner = self.N[among_free] * scale
        inner[np.diag_indices_from(inner)] += 1.0
        try:
            factor, _ = cho_factor(inner, lower=True, check_finite=False)
            lower = np.tril(dpotri(factor, lower=True)[0])
            inverse = lower + np.tril(lower, -1).T
            log_size = 2.0 * float(np.log(np.diag(factor)).sum())
        except np.linalg.LinAlgError:
            # No eigenvalue is below 1, but by rounding, where sizes are far apart.
            values, vectors = np.linalg.eigh(inner)
            values = np.maximum(values, 1.0)
            inverse = (vectors / values) @ vectors.T
            log_size = float(np.log(values).sum())
        covariance = np.zeros_like(self.N)
        covariance[among_free] = scale * inverse
        return EntryPosterior(
            mean=covariance @ self.b, covariance=covariance, log_size=log_size
        )


@dataclass(frozen=True)
class Cost:
    """Twice the negative logarithm of a likelihood, and its gradient (10,)."""

    value: float
    gradient: Array

    def __add__(self, other: "Cost") -> "Cost":
        return Cost(self.value + other.value, self.gradient + other.gradient)


class Evidence:
    """Marginal likelihood of sets of trials, a surface each and the sizes in common.

    It is a function of the logarithms (10,) of the sizes over the usual ones: seven
    sizes of terms and errors, the noise, and the two powers of decay.
    """

    def __init__(self, sets: Sequence[Reduced], highest: Orders) -> None:
        mean_squares = []
        residual_squares = 0.0
        n_free = 0.0
        for trials in sets:
            squares = np.sum(trials.z**2) + trials.residual_squares.sum()
            mean_squares.append(squares / trials.total.sum())
            residual_squares += float(trials.residual_squares.sum())
            spare = trials.slices - trials.z.shape[1]
            n_free += float(np.maximum(spare, 0.0).sum())
        level = max(float(np.sqrt(max(mean_squares))), 1e-300)
        noise = float(np.sqrt(residual_squares / n_free)) if n_free > 0 else 0.0
        noise = max(noise, LEAST_NOISE * level)

        self.sets = sets
        self.highest = highest
        self.broad = BROAD * level
        usual_sizes = level * np.array(USUAL_SHARES)
        self.usual = np.array([*usual_sizes, noise, USUAL_DECAY, USUAL_DECAY])
        spreads = [SPREAD] * (len(USUAL_SHARES) + 1) + [DECAY_SPREAD] * 2
        self.spread = np.array(spreads)

        # What functions of the position leave of a trial tells the noise. Far below it
        # the likelihood is the difference of huge numbers, and anything.
        self.highest_logs = SEARCH_LIMIT * self.spread
        self.lowest_logs = -self.highest_logs
        if n_free > 0:
            self.lowest_logs[SEARCHED.index("noise")] = -LOWEST_NOISE

    def sizes(self, logs: Array) -> Sizes:
        """Return sizes from logarithms (10,) of their factors on the usual sizes."""
        values = (self.usual * np.exp(logs)).tolist()
        return Sizes(**dict(zip(SEARCHED, values, strict=True)), broad=self.broad)

    def __call__(self, logs: Array) -> tuple[float, Array]:
        """Return twice the negative logarithm and its gradient (10,).

        A constant is left out.
        """
        sizes = self.sizes(logs)
        deviation = logs / self.spread
        cost = Cost(float(np.sum(deviation**2)), 2.0 * logs / self.spread**2)
        for trials in self.sets:
            cost += self._of_set(trials, sizes)
        return cost.value, cost.gradient

    def _of_set(self, trials: Reduced, sizes: Sizes) -> Cost:
        """Return the cost of one set of trials."""
        prior = sizes.prior(trials.scaling, trials.size, self.highest)
        normal = Normal.of(trials, sizes, self.highest.velocity)
        posterior = normal.posterior(prior.ravel())
        n_beyond = float(np.sum(trials.slices - trials.z.shape[1]))
        scaled_squares = float(trials.residual_squares.sum()) / sizes.noise**2
        value = normal.log_size + normal.power + posterior.log_size
        value -= float(posterior.mean @ normal.b)
        value += 2.0 * n_beyond * np.log(sizes.noise) + scaled_squares

        # How much of each entry's prior variance the data have taken away.
        second_moment = np.diag(posterior.covariance) + posterior.mean**2
        has_prior = prior > 0
        variance = np.where(has_prior, prior, 1.0) ** 2
        share = 1.0 - second_moment.reshape(prior.shape) / variance
        share = np.where(has_prior, share, 0.0)
        share[trials.size :] = 0.0

        slope = np.empty(len(self.usual))
        slope[0] = share[1:, 0].sum()
        slope[1] = share[0, 2:].sum()
        slope[2] = share[1:, 1:].sum()
        slope[3:8] = self._error_slopes(trials, sizes, normal, posterior)
        slope[7] += n_beyond - scaled_squares
        share[0, :2] = 0.0  # of broad ones, whose variances do not fall
        surface_share = share[: trials.size]
        over_position = trials.scaling.over_position
        degrees = over_position.degrees(over_position.order(trials.size))
        log_degrees = np.log(np.maximum(degrees, 1.0))
        log_orders = np.log(np.maximum(np.arange(share.shape[1]), 1.0))
        by_position = float(log_degrees @ surface_share.sum(axis=1))
        by_speed = float(surface_share.sum(axis=0) @ log_orders)
        slope[8] = -0.5 * (sizes.position_decay * by_position)
        slope[9] = -0.5 * (sizes.speed_decay * by_speed)
        return Cost(value, 2.0 * slope)

    def strongest(self, near: Sizes | None = None) -> tuple[Sizes, float]:
        """Return the sizes of the largest marginal likelihood, and twice its logarithm.

        They are searched from those `near`, or from the usual ones.
        """
        from scipy.optimize import minimize

        start = np.zeros(len(self.usual))
        lowest = self.lowest_logs
        highest = self.highest_logs
        logs: Array | None = None
        if near is not None:
            values = np.array([getattr(near, name) for name in SEARCHED])
            start = np.log(values / self.usual).clip(lowest, highest)
            logs = self._polished(start)
        if logs is None:
            bounds = list(zip(lowest.tolist(), highest.tolist(), strict=True))
            climbed: Array = minimize(
                self, start, jac=True, method="L-BFGS-B", bounds=bounds
            ).x
            logs = self._polished(climbed)
            if logs is None:
                logs = climbed
        return self.sizes(logs), -self(logs)[0]

    def _polished(self, logs: Array) -> Array | None:
        """Return the maximum by Newton's method: the likelihood is flat about it.

        None beyond `NEWTON_REACH` and the limits of the search, and where the
        likelihood is not curved down.
        """
        slope = self(logs)[1]
        difference = 1e-4
        steps = difference * np.eye(len(logs))
        curvature = np.stack(
            [(self(logs + step)[1] - slope) / difference for step in steps]
        )
        curvature = 0.5 * (curvature + curvature.T)
        if np.linalg.eigvalsh(curvature)[0] <= 0.0:
            return None
        for _ in range(NEWTON_ROUNDS):
            step = np.linalg.solve(curvature, slope)
            if np.abs(step).max() > NEWTON_REACH:
                return None
            logs = logs - step
            slope_before = slope
            if np.abs(step).max() < 1e-10:
                break
            slope = self(logs)[1]
            change = slope_before - slope
            if change @ step > 0.0:  # the secant of BFGS; rounding has none
                bent = curvature @ step
                curvature += np.outer(change, change) / (change @ step)
                curvature -= np.outer(bent, bent) / (step @ bent)
        is_within = np.all((logs >= self.lowest_logs) & (logs <= self.highest_logs))
        return logs if is_within else None

    def _error_slopes(
        self,
        trials: Reduced,
        sizes: Sizes,
        normal: Normal,
        posterior: EntryPosterior,
    ) -> Array:
        """Return derivatives (5,) by half the logarithms of trial ... noise.

        They leave out the `residual_squares` of the reduction.
        """
        R = trials.R
        phi = normal.phi
        p = trials.z.shape[1]
        r = phi.shape[1]
        entries = posterior.mean.reshape(p, r)
        at_trials = (phi @ entries.T)[:, :, None]
        residual = trials.z - (R @ at_trials)[:, :, 0]
        # Covariance (T, p, p) of the surface at each trial's speed.
        blocks = posterior.covariance.reshape(p, r, p, r)
        by_speed = blocks.transpose(1, 3, 0, 2).reshape(r * r, p * p)
        covariance = (_products(phi) @ by_speed).reshape(-1, p, p)

        white = (normal.inverse @ residual[:, :, None])[:, :, 0]
        pulled = (R.transpose(0, 2, 1) @ white[:, :, None])[:, :, 0] ** 2
        pulled += np.sum((normal.S @ covariance) * normal.S, axis=2)
        by_term = np.diagonal(normal.S, axis1=1, axis2=2) - pulled
        by_cause = np.sum(by_term * normal.trial_variances, axis=(1, 2))

        weighted_R = normal.inverse @ R
        by_noise = np.trace(normal.inverse, axis1=1, axis2=2).sum() - np.sum(white**2)
        by_noise -= np.sum((weighted_R @ covariance) * weighted_R)
        return np.append(by_cause, sizes.noise**2 * by_noise)


# What `Evidence` searches, in its order.
SEARCHED = (
    "position",
    "speed",
    "surface",
    "trial",
    "slow",
    "unsteady",
    "edge",
    "noise",
    "position_decay",
    "speed_decay",
)


def _products(phi: Array) -> Array:
    """Return the products (T, r^2) of every two functions (T, r)."""
    return (phi[:, :, None] * phi[:, None, :]).reshape(len(phi), -1)
