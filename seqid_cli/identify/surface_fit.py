"""Fitting the friction surface: Eq. 8 at every speed, Eq. 10 over the speeds, orders by Eq. 11.

Step 1 reduces the data of one speed and direction to the R factor of its position polynomial,
||A c - y||^2 = ||R c - z||^2 + rest, with A (K, M + 1) the Chebyshev values of order M. Step 2
fits the velocity polynomial of every coefficient, c = D phi(u), with each speed weighted by what
its data know:

    min_D sum_k ||R_k D phi(u_k) - z_k||^2.

Both steps together are the least squares of the whole surface, so nothing is lost by the reduction,
and a speed or an order can be left out without going back to the data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from seqid_cli.model.friction import Scaling

Array = NDArray[np.float64]

MAX_POSITION_ORDER, MAX_VELOCITY_ORDER = 10, 11


@dataclass(frozen=True)
class SpeedData:
    """One speed and direction: slice positions (K,) rad, friction (K,) N m, weights (K,)."""

    speed: float
    direction: int
    q: Array
    friction: Array
    weight: Array


@dataclass(frozen=True)
class Reduced:
    """One speed and direction after step 1."""

    u: float
    R: Array  # (M + 1, M + 1)
    z: Array  # (M + 1,)
    rest: float
    total: float  # sum of weights
    scaling: Scaling

    def misfit(self, D: Array) -> float:
        """Weighted squares left by surface coefficients D (m + 1, l + 1)."""
        c = D @ chebvander(np.array([self.u]), D.shape[1] - 1)[0]
        left = self.R[:, : len(c)] @ c - self.z
        return float(left @ left) + self.rest


def reduce_speed(data: SpeedData, scaling: Scaling) -> Reduced:
    """Step 1: the R factor of the position polynomial of one speed (Eq. 8)."""
    root: Array = np.sqrt(data.weight)
    A = chebvander(scaling.x(data.q), MAX_POSITION_ORDER) * root[:, None]
    Q, factor = np.linalg.qr(A)
    R: Array = np.asarray(factor, dtype=np.float64)
    y: Array = root * data.friction
    z: Array = np.asarray(Q.T @ y, dtype=np.float64)
    size = MAX_POSITION_ORDER + 1
    if R.shape[0] < size:
        R = np.vstack([R, np.zeros((size - R.shape[0], size))])
        z = np.concatenate([z, np.zeros(size - len(z))])
    u = float(scaling.u(np.array([data.speed]))[0])
    return Reduced(u, R, z, max(float(y @ y - z @ z), 0.0), float(data.weight.sum()), scaling)


def fit_surface(reduced: list[Reduced], m: int, l: int) -> Array:
    """Step 2: coefficients D (m + 1, l + 1) from the reduced speeds (Eq. 9-10)."""
    rows, right = _stacked(reduced, m, l)
    solution = np.linalg.lstsq(rows, right, rcond=1e-11)[0]
    D: Array = np.asarray(solution, dtype=np.float64).reshape(m + 1, l + 1)
    return D


def information(reduced: list[Reduced], m: int, l: int) -> Array:
    """Normal matrix of step 2, ((m + 1)(l + 1))^2."""
    rows, _ = _stacked(reduced, m, l)
    normal: Array = rows.T @ rows
    return normal


def _stacked(reduced: list[Reduced], m: int, l: int) -> tuple[Array, Array]:
    phi = [chebvander(np.array([item.u]), l)[0] for item in reduced]
    rows = [
        (item.R[:, : m + 1, None] * p[None, None, :]).reshape(len(item.z), -1)
        for item, p in zip(reduced, phi, strict=True)
    ]
    return np.vstack(rows), np.concatenate([item.z for item in reduced])


@dataclass(frozen=True)
class LeftOutErrors:
    """Eq. 11 on data left out, beyond what the noise of the averages explains.

    `relative` is the largest error over the friction where the friction is not near zero,
    `absolute` the largest error [N m], `crossing` the largest error where friction is near zero,
    over its RMS.
    """

    relative: float
    absolute: float
    crossing: float
    rmse: float

    def meets(self, beta: float) -> bool:
        """Whether the criterion holds."""
        return max(self.relative, self.crossing) <= beta


GROUP = 4  # slices averaged for the criterion
NEAR_ZERO = 0.2  # of the RMS friction, below which the criterion is absolute


def left_out_errors(data: list[SpeedData], reduced: list[Reduced], m: int, l: int) -> LeftOutErrors:
    """Evaluate Eq. 11 at every inner speed with a fit that has not seen it."""
    errors, frictions, noises = [], [], []
    for u, D in _leaving_out(reduced, m, l):
        phi = chebvander(np.array([u]), l)[0]
        for item, step1 in zip(data, reduced, strict=True):
            if step1.u == u:
                fitted = chebvander(step1.scaling.x(item.q), m) @ (D @ phi)
                error, friction, noise = _grouped(item, fitted)
                errors.append(error)
                frictions.append(friction)
                noises.append(noise)
    error, friction = np.concatenate(errors), np.concatenate(frictions)
    beyond = np.maximum(np.abs(error) - 2 * np.concatenate(noises), 0.0)
    rms = float(np.sqrt(np.mean(friction**2)))
    large = np.abs(friction) > NEAR_ZERO * rms
    return LeftOutErrors(
        relative=float((beyond[large] / np.abs(friction[large])).max(initial=0.0)),
        absolute=float(np.abs(error).max()),
        crossing=float(beyond[~large].max(initial=0.0)) / max(rms, 1e-300),
        rmse=float(np.sqrt(np.mean(error**2))),
    )


def _grouped(item: SpeedData, fitted: Array) -> tuple[Array, Array, Array]:
    """Errors and friction averaged over groups of slices, and the noise of such an average."""
    count = max(len(item.q) // GROUP, 1)
    parts = np.array_split(np.arange(len(item.q)), count)
    off = item.friction - fitted
    noise = np.std(np.diff(off)) / np.sqrt(2 * GROUP) if len(off) > 2 else 0.0
    error = np.array([off[part].mean() for part in parts])
    friction = np.array([item.friction[part].mean() for part in parts])
    return error, friction, np.full(count, noise)


def _leaving_out(reduced: list[Reduced], m: int, l: int) -> list[tuple[float, Array]]:
    """Each inner speed u with the surface fitted to the others.

    The slowest and the fastest speed are never left out: the surface does not extrapolate. With
    three speeds or fewer nothing can be left out, and the fit to all of them stands in.
    """
    speeds = sorted({item.u for item in reduced})
    if len(speeds) <= 3:
        D = fit_surface(reduced, m, l)
        return [(u, D) for u in speeds]
    return [(u, fit_surface([item for item in reduced if item.u != u], m, l)) for u in speeds[1:-1]]


def left_out_rms(reduced: list[Reduced], m: int, l: int) -> float:
    """RMS friction error, N m, of slices at speeds that the fit has not seen."""
    error, weight = 0.0, 0.0
    for u, D in _leaving_out(reduced, m, l):
        for item in reduced:
            if item.u == u:
                error += item.misfit(D)
                weight += item.total
    return float(np.sqrt(error / max(weight, 1e-300)))


@dataclass(frozen=True)
class Orders:
    """Chosen orders and the left-out RMS error (N m) that they reach."""

    position: int
    velocity: int
    held_out_rmse: float


def choose_orders(
    reduced: list[Reduced],
    *,
    position: int | None,
    velocity: int | None,
    accept: Callable[[int, int], bool],
) -> Orders:
    """Raise m and l while speeds that were left out are predicted better (Eq. 11 on held-out data).

    Parameters
    ----------
    reduced : list of Reduced
        One entry per speed and direction.
    position, velocity : int, optional
        Orders that the user fixes.
    accept : callable
        Whether orders (m, l) are good enough to stop at.

    Returns
    -------
    Orders
        Where the left-out error stops falling, or the first that `accept` takes.
    """
    levels = len({item.u for item in reduced})
    top_l = min(MAX_VELOCITY_ORDER, max(levels - 2, 0)) if velocity is None else velocity
    top_m = MAX_POSITION_ORDER if position is None else position
    m = position or 0
    l = min(1, top_l) if velocity is None else velocity
    best = Orders(m, l, left_out_rms(reduced, m, l))
    while not accept(best.position, best.velocity):
        raised = [
            (best.position + up_m, best.velocity + up_l)
            for up_m in range(4)
            for up_l in range(3)
            if up_m + up_l and best.position + up_m <= top_m and best.velocity + up_l <= top_l
        ]
        if not raised:
            break
        trials = [Orders(m, l, left_out_rms(reduced, m, l)) for m, l in raised]
        better = max(trials, key=lambda trial: _gain(best, trial))
        if better.held_out_rmse > LEAST_GAIN * best.held_out_rmse:
            break
        best = better
    return best


LEAST_GAIN = 0.995


def _gain(now: Orders, then: Orders) -> float:
    """Gain in the left-out error per coefficient added: a large step must earn its size."""
    added = (then.position + 1) * (then.velocity + 1) - (now.position + 1) * (now.velocity + 1)
    gain = np.log(max(now.held_out_rmse, 1e-300) / max(then.held_out_rmse, 1e-300))
    return float(gain / np.sqrt(added)) if gain > 0 else float(gain)
