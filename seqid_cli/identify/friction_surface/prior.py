"""Sizes of the terms of a friction surface and of the errors of its trials, from the data.

Slices of trial k, reduced (`reduction`), are

    z_k = R_k (D phi(u_k) + e_k) + n_k,

D the surface, phi Chebyshev polynomials of the scaled speed, n_k white noise of
variance s_n^2, and e_k what the trial has for itself: an offset of variance s_t^2 and
terms of degree j of variance s_s^2 / j, which is how 1/f noise over the length of a
trial spreads over polynomials; torque of a speed that changes by a share of itself
along its way, I dv/dt ~ v^2, of variance s_a^2 (v / v_max)^4 / max(j, 1); and at its
ends what is left of acceleration, of variance s_e^2 (R_k has columns for it). All
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
from dataclasses import astuple, dataclass

import numpy as np
from scipy.linalg import cho_factor
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from seqid_cli.identify.friction_surface.reduction import (
    EDGES,
    EXTRA,
    SHARED,
    Orders,
    Reduced,
)
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.typing import Array

DECAY_SPREAD = float(np.log(2.0))  # standard deviation of its logarithm
# standard deviation of a size's logarithm about the usual one
SPREAD = float(np.log(10.0))


@dataclass(frozen=True)
class Sizes:
    """Standard deviations, N m, of the surface's terms over `position`, `speed` and `both`.

    Then of a `trial`'s own offset, of its `slow` changes, of its `unsteady` speed if it
    is the fastest, of its `edge`s; of the white `noise` of one sample. `over_position`
    and `over_speed` are the powers with which variances fall. `broad`, of Coulomb and
    viscous friction, is fixed.
    """

    position: float
    speed: float
    both: float
    trial: float
    slow: float
    unsteady: float
    edge: float
    noise: float
    over_position: float
    over_speed: float
    broad: float

    def prior(self, scaling: Scaling, size: int, orders: Orders) -> Array:
        """Standard deviations (size + 6, l + 1) of a surface's entries."""
        # They are 0 above position order m, and for the ends of a trial, which the
        # surface has not. The last four are those of errors that are one and the same
        # in all trials.
        over_position = scaling.over_position
        j = over_position.degrees(over_position.order(size))[:, None]
        r = np.arange(orders.velocity + 1.0)[None, :]
        fall = np.maximum(j, 1.0) ** (-self.over_position / 2.0)
        fall = fall * np.maximum(r, 1.0) ** (-self.over_speed / 2.0)
        kind = np.where(j == 0, self.speed, np.where(r == 0, self.position, self.both))
        found = np.where((j == 0) & (r <= 1), self.broad, kind * fall)
        found[over_position.size(orders.position) :] = 0.0
        shared = np.tile(np.eye(1, found.shape[1]), (SHARED, 1))
        return np.vstack([found, np.zeros((EDGES, found.shape[1])), shared])

    def own(self, scaling: Scaling, size: int, speeds: Array) -> Array:
        """Variances (4, T, size + 6) of own terms of trials at speeds (T,), by their causes."""
        degree = scaling.over_position.degrees(scaling.over_position.order(size))
        found = np.zeros((4, len(speeds), size + EXTRA))
        found[0, :, :size] = self.trial**2 * (degree == 0)
        found[1, :, :size] = self.slow**2 * (degree > 0) / np.maximum(degree, 1.0)
        fast = (speeds / scaling.speed[1]) ** 4
        found[2, :, :size] = self.unsteady**2 * np.outer(
            fast, 1.0 / np.maximum(degree, 1.0)
        )
        found[3, :, size : size + EDGES] = self.edge**2
        return found


@dataclass(frozen=True)
class Normal:
    """Normal equations of a surface's entries, row-major: N (k, k) d = b (k,)."""

    N: Array
    b: Array
    phi: Array  # (T, r) the trials' functions of speed
    own: Array  # (4, T, p) variances of their own terms (`Sizes.own`)
    inverse: Array  # (T, p, p) of their covariances V_k
    S: Array  # (T, p, p) = R' V^-1 R
    log_size: float  # sum of log det V_k
    power: float  # sum of z' V^-1 z

    @classmethod
    def of(
        cls, trials: Reduced, sizes: Sizes, order: int, *, min_share: float = 1e-14
    ) -> "Normal":
        """Add up the trials; `order` is that over speed."""
        R, z, phi = trials.R, trials.z, trials.over_speed(order)
        own = sizes.own(trials.scaling, trials.size, trials.speeds)
        scaled = R * np.sqrt(own.sum(axis=0))[:, None, :]
        V = scaled @ scaled.transpose(0, 2, 1)
        diagonal = np.arange(V.shape[1])
        rounding = min_share * V[:, diagonal, diagonal].max(axis=1, keepdims=True)
        V[:, diagonal, diagonal] += sizes.noise**2 + rounding
        inverse = np.asarray(np.linalg.inv(V), dtype=np.float64)
        toward = R.transpose(0, 2, 1) @ inverse
        S: Array = toward @ R
        t = (toward @ z[:, :, None])[:, :, 0]
        p, r = V.shape[1], phi.shape[1]
        both = S.reshape(-1, p * p).T @ _products(phi)
        N = both.reshape(p, p, r, r).transpose(0, 2, 1, 3).reshape(p * r, p * r)
        log_size = float(np.linalg.slogdet(V)[1].sum())
        power = float(np.sum(z * (inverse @ z[:, :, None])[:, :, 0]))
        return cls(N, (t.T @ phi).ravel(), phi, own, inverse, S, log_size, power)

    def posterior(self, prior: Array) -> tuple[Array, Array, float]:
        """Mean (k,), covariance (k, k) and log det(1 + P^1/2 N P^1/2), P = diag(prior^2) (k,)."""
        free = np.flatnonzero(prior)  # of the others nothing is left open
        across = np.ix_(free, free)
        scale = np.outer(prior[free], prior[free])
        inner = self.N[across] * scale
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
            inverse, log_size = (
                (vectors / values) @ vectors.T,
                float(np.log(values).sum()),
            )
        covariance = np.zeros_like(self.N)
        covariance[across] = scale * inverse
        return covariance @ self.b, covariance, log_size


class Evidence:
    """Marginal likelihood of sets of trials, a surface each and the sizes in common."""

    def __init__(
        self,
        sets: Sequence[Reduced],
        highest: Orders,
        *,
        broad: float = 3.0,
        decay: float = 3.0,
        usual_shares: tuple[float, ...] = (0.1, 0.1, 0.03, 0.01, 0.01, 0.01, 0.1),
    ) -> None:
        squares = [
            (np.sum(own.z**2) + own.rest.sum()) / own.total.sum() for own in sets
        ]
        level = max(float(np.sqrt(max(squares))), 1e-300)
        rest = sum(own.rest.sum() for own in sets)
        free = sum(np.maximum(own.slices - own.z.shape[1], 0.0).sum() for own in sets)
        noise = max(float(np.sqrt(rest / free)) if free > 0 else 0.0, 1e-6 * level)
        self.sets, self.highest, self.broad = sets, highest, broad * level
        self.usual = np.array([*(level * np.array(usual_shares)), noise, decay, decay])
        self.spread = np.array([SPREAD] * (len(usual_shares) + 1) + [DECAY_SPREAD] * 2)

    def sizes(self, logs: Array) -> Sizes:
        """Sizes from the logarithms (10,) of what they are times the usual ones."""
        return Sizes(*np.append(self.usual * np.exp(logs), self.broad).tolist())

    def __call__(self, logs: Array) -> tuple[float, Array]:
        """Twice the negative logarithm, but for a constant, and its gradient (10,)."""
        sizes = self.sizes(logs)
        cost, gradient = (
            float(np.sum((logs / self.spread) ** 2)),
            2.0 * logs / self.spread**2,
        )
        for own in self.sets:
            prior = sizes.prior(own.scaling, own.size, self.highest)
            normal = Normal.of(own, sizes, self.highest.velocity)
            mean, covariance, log_size = normal.posterior(prior.ravel())
            beyond = float(np.sum(own.slices - own.z.shape[1]))
            rest = float(own.rest.sum()) / sizes.noise**2
            more = normal.log_size + normal.power + log_size - float(mean @ normal.b)
            more += 2.0 * beyond * np.log(sizes.noise) + rest
            square = (np.diag(covariance) + mean**2).reshape(prior.shape)
            share = np.where(
                prior > 0, 1.0 - square / np.where(prior > 0, prior, 1.0) ** 2, 0.0
            )
            share[own.size :] = 0.0
            slope = np.empty(len(self.usual))
            slope[:3] = share[1:, 0].sum(), share[0, 2:].sum(), share[1:, 1:].sum()
            slope[3:8] = self._of_errors(own, sizes, normal, mean, covariance)
            slope[7] += beyond - rest
            share[0, :2] = 0.0  # of broad ones, whose variances do not fall
            degrees = own.scaling.over_position.degrees(
                own.scaling.over_position.order(own.size)
            )
            over_position = np.log(np.maximum(degrees, 1.0)) @ share[: own.size].sum(
                axis=1
            )
            order = np.log(np.maximum(np.arange(share.shape[1]), 1.0))
            slope[8] = -0.5 * (sizes.over_position * over_position)
            slope[9] = -0.5 * (
                sizes.over_speed * (share[: own.size].sum(axis=0) @ order)
            )
            cost, gradient = cost + more, gradient + 2.0 * slope
        return cost, gradient

    def strongest(
        self, near: Sizes | None = None, *, limit: float = 5.0
    ) -> tuple[Sizes, float]:
        """The sizes of the largest marginal likelihood, from those `near`; twice its logarithm."""
        start, furthest, logs = np.zeros(len(self.usual)), limit * self.spread, None
        if near is not None:
            start = np.log(np.array(astuple(near)[:-1]) / self.usual).clip(
                -furthest, furthest
            )
            logs = self._polished(start)
        if logs is None:
            bounds = [(-far, far) for far in furthest.tolist()]
            about: Array = minimize(
                self, start, jac=True, method="L-BFGS-B", bounds=bounds
            ).x
            logs = self._polished(about)
            logs = about if logs is None else logs
        return self.sizes(logs), -self(logs)[0]

    def _polished(self, logs: Array, *, reach: float = 0.3) -> Array | None:
        """The maximum, by Newton's method: the likelihood is flat about it.

        None beyond `reach`.
        """
        slope, difference = self(logs)[1], 1e-4
        steps = difference * np.eye(len(logs))
        curvature = np.stack(
            [(self(logs + step)[1] - slope) / difference for step in steps]
        )
        curvature = 0.5 * (curvature + curvature.T)
        if np.linalg.eigvalsh(curvature)[0] <= 0.0:
            return None
        for _ in range(20):
            step = np.linalg.solve(curvature, slope)
            if np.abs(step).max() > reach:
                return None
            logs, before = logs - step, slope
            if np.abs(step).max() < 1e-10:
                break
            slope = self(logs)[1]
            bent, change = curvature @ step, before - slope
            if change @ step > 0.0:  # the secant of BFGS; rounding has none
                curvature += np.outer(change, change) / (change @ step)
                curvature -= np.outer(bent, bent) / (step @ bent)
        return logs

    def _of_errors(
        self, own: Reduced, sizes: Sizes, normal: Normal, mean: Array, covariance: Array
    ) -> Array:
        """Derivatives (5,) by half the logarithms of trial ... noise, but for the rest."""
        phi = normal.phi
        p, r = own.z.shape[1], phi.shape[1]
        left = own.z - (own.R @ (phi @ mean.reshape(p, r).T)[:, :, None])[:, :, 0]
        by_speed = (
            covariance.reshape(p, r, p, r).transpose(1, 3, 0, 2).reshape(r * r, p * p)
        )
        variance = (_products(phi) @ by_speed).reshape(-1, p, p)
        white = (normal.inverse @ left[:, :, None])[:, :, 0]
        pulled = (own.R.transpose(0, 2, 1) @ white[:, :, None])[:, :, 0] ** 2
        pulled += np.sum((normal.S @ variance) * normal.S, axis=2)
        by_term = np.diagonal(normal.S, axis1=1, axis2=2) - pulled
        weighed = normal.inverse @ own.R
        by_noise = np.trace(normal.inverse, axis1=1, axis2=2).sum() - np.sum(white**2)
        by_noise -= np.sum((weighed @ variance) * weighed)
        return np.append(
            np.sum(by_term * normal.own, axis=(1, 2)), sizes.noise**2 * by_noise
        )


def _products(phi: Array) -> Array:
    """Products (T, r^2) of every two functions (T, r)."""
    return (phi[:, :, None] * phi[:, None, :]).reshape(len(phi), -1)
