"""Fitting the friction surface: Eq. 8 at every speed, Eq. 10 over the speeds, orders by Eq. 11.

Step 1 reduces the data of one speed and direction to the R factor of its position polynomial,
||A c - y||^2 = ||R c - z||^2 + rest, with A (K, M + 1) the Chebyshev values of order M. Step 2
fits the velocity polynomial of every coefficient, c = D phi(u), with each speed weighted by what
its data know:

    min_D sum_k ||R_k D phi(u_k) - z_k||^2.

Both steps together are the least squares of the whole surface, so nothing is lost by the reduction,
a speed or order can be left out without going back to the data. High orders swing between the
speeds (Runge). A penalty of s (j^2 + r^2)^2 on the square of coefficient d_jr, with the s that
predicts left-out speeds best, keeps orders like the paper's (10, 11) usable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from seqid_cli.model.friction_basis import Scaling

Array = NDArray[np.float64]

MAX_POSITION_ORDER, MAX_VELOCITY_ORDER = 10, 11


@lru_cache(maxsize=4096)
def _over_speed(u: float, order: int) -> Array:
    """Chebyshev values (order + 1,) at a scaled speed; asked for again and again."""
    values: Array = chebvander(np.array([u]), order)[0]
    values.flags.writeable = False
    return values


@dataclass(frozen=True)
class Orders:
    """Orders m and l, the strength of the penalty, and the left-out RMS error (N m) they reach."""

    position: int
    velocity: int
    smoothing: float = 0.0
    held_out_rmse: float = np.inf


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
        c = D @ _over_speed(self.u, D.shape[1] - 1)
        left = self.R[:, : len(c)] @ c - self.z
        return float(left @ left) + self.rest


def reduce_speed(data: SpeedData, scaling: Scaling) -> Reduced:
    """Step 1: the R factor of the position polynomial of one speed (Eq. 8)."""
    root: Array = np.sqrt(data.weight)
    A = scaling.over_position.values(data.q, MAX_POSITION_ORDER) * root[:, None]
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


def fit_surface(reduced: list[Reduced], m: int, l: int, smoothing: float = 0.0) -> Array:
    """Step 2: coefficients D (m + 1, l + 1) from the reduced speeds (Eq. 9-10)."""
    rows, right = _stacked(reduced, m, l, smoothing)
    solution = np.linalg.lstsq(rows, right, rcond=1e-11)[0]
    D: Array = np.asarray(solution, dtype=np.float64).reshape(m + 1, l + 1)
    return D


def information(reduced: list[Reduced], m: int, l: int, smoothing: float = 0.0) -> Array:
    """Normal matrix of step 2, ((m + 1)(l + 1))^2."""
    rows, _ = _stacked(reduced, m, l, smoothing)
    normal: Array = rows.T @ rows
    return normal


def _stacked(reduced: list[Reduced], m: int, l: int, smoothing: float) -> tuple[Array, Array]:
    phi = [_over_speed(item.u, l) for item in reduced]
    rows = [
        (item.R[:, : m + 1, None] * p[None, None, :]).reshape(len(item.z), -1)
        for item, p in zip(reduced, phi, strict=True)
    ]
    right = [item.z for item in reduced]
    if smoothing > 0.0:
        penalty = np.sqrt(_penalty(reduced, m, l, smoothing))
        rows.append(np.diag(penalty))
        right.append(np.zeros(len(penalty)))
    return np.vstack(rows), np.concatenate(right)


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


def left_out_errors(data: list[SpeedData], reduced: list[Reduced], orders: Orders) -> LeftOutErrors:
    """Evaluate Eq. 11 at every inner speed with a fit that has not seen it."""
    errors, frictions, noises = [], [], []
    for u, D in _leaving_out(reduced, orders):
        phi = _over_speed(u, orders.velocity)
        for item, step1 in zip(data, reduced, strict=True):
            if step1.u == u:
                over_position = step1.scaling.over_position.values(item.q, orders.position)
                fitted = over_position @ (D @ phi)
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


def _leaving_out(reduced: list[Reduced], orders: Orders) -> list[tuple[float, Array]]:
    """Each inner speed u with the surface fitted to the others.

    The slowest and the fastest speed are never left out: the surface does not extrapolate. With
    three speeds or fewer nothing can be left out, and the fit to all of them stands in.
    """
    speeds = sorted({item.u for item in reduced})
    how = (orders.position, orders.velocity, orders.smoothing)
    if len(speeds) <= 3:
        D = fit_surface(reduced, *how)
        return [(u, D) for u in speeds]
    if orders.smoothing == 0.0:
        return [
            (u, fit_surface([item for item in reduced if item.u != u], *how)) for u in speeds[1:-1]
        ]
    return _LeaveOut.of(reduced, orders).surfaces(orders.smoothing)


@dataclass(frozen=True)
class _LeaveOut:
    """Normal equations of all data and of each inner speed; the penalty makes them well posed."""

    shape: tuple[int, int]
    N: Array
    b: Array
    parts: dict[float, tuple[Array, Array]]
    penalty: Array

    @classmethod
    def of(cls, reduced: list[Reduced], orders: Orders) -> _LeaveOut:
        m, l = orders.position, orders.velocity
        inner = sorted({item.u for item in reduced})[1:-1]
        parts = {u: _normal([item for item in reduced if item.u == u], m, l) for u in inner}
        N, b = _normal(reduced, m, l)
        return cls((m + 1, l + 1), N, b, parts, _penalty(reduced, m, l, 1.0))

    def surfaces(self, smoothing: float) -> list[tuple[float, Array]]:
        N = self.N + np.diag(smoothing * self.penalty)
        return [
            (u, np.asarray(np.linalg.solve(N - part[0], self.b - part[1])).reshape(self.shape))
            for u, part in self.parts.items()
        ]


def _normal(reduced: list[Reduced], m: int, l: int) -> tuple[Array, Array]:
    """Normal matrix and right side of step 2, from Kronecker products."""
    size = (m + 1) * (l + 1)
    N, b = np.zeros((size, size)), np.zeros(size)
    for item in reduced:
        phi = _over_speed(item.u, l)
        R = item.R[:, : m + 1]
        N += np.kron(R.T @ R, np.outer(phi, phi))
        b += np.kron(R.T @ item.z, phi)
    return N, b


def _penalty(reduced: list[Reduced], m: int, l: int, smoothing: float) -> Array:
    """Penalty on the square of every coefficient, row-major."""
    total = sum(item.total for item in reduced)
    degree = np.arange(m + 1.0)[:, None] ** 2 + np.arange(l + 1.0)[None, :] ** 2
    penalty: Array = smoothing * total * degree.ravel() ** 2
    return penalty


def left_out_rms(reduced: list[Reduced], orders: Orders) -> float:
    """RMS friction error, N m, of slices at speeds that the fit has not seen."""
    return _rms(reduced, _leaving_out(reduced, orders))


def _rms(reduced: list[Reduced], surfaces: list[tuple[float, Array]]) -> float:
    error, weight = 0.0, 0.0
    for u, D in surfaces:
        for item in reduced:
            if item.u == u:
                error += item.misfit(D)
                weight += item.total
    return float(np.sqrt(error / max(weight, 1e-300)))


def choose_orders(
    reduced: list[Reduced],
    *,
    position: int | None,
    velocity: int | None,
    accept: Callable[[Orders], bool] | None,
    thorough: bool = True,
) -> Orders:
    """Choose m, l and the penalty by how well speeds that were left out are predicted (Eq. 11).

    Parameters
    ----------
    reduced : list of Reduced
        One entry per speed and direction.
    position, velocity : int, optional
        Orders that the user fixes.
    accept : callable, optional
        Whether orders are good enough to stop at; with it the smallest such orders are chosen.
    thorough : bool
        False for a first look with low orders and no penalty.

    Returns
    -------
    Orders
        High orders under a penalty, unless low ones are clearly better, or `accept` takes them.
    """
    levels = len({item.u for item in reduced})
    highest = Orders(
        MAX_POSITION_ORDER if position is None else position,
        min(MAX_VELOCITY_ORDER, max(levels - 1, 0)) if velocity is None else velocity,
    )
    lowest = Orders(position or 0, min(1, highest.velocity) if velocity is None else velocity)
    raised = _raised(reduced, _judged(reduced, lowest), highest, accept)
    if not thorough or (accept is not None and accept(raised)):
        return raised
    smooth = _smoothed(reduced, highest)
    low = _smoothed(reduced, raised)
    return low if low.held_out_rmse < CLEARLY_BETTER * smooth.held_out_rmse else smooth


def _raised(
    reduced: list[Reduced], best: Orders, highest: Orders, accept: Callable[[Orders], bool] | None
) -> Orders:
    """Raise m and l step by step while the left-out error falls."""
    while accept is None or not accept(best):
        steps = [
            Orders(best.position + up_m, best.velocity + up_l)
            for up_m in range(4)
            for up_l in range(3)
            if up_m + up_l
            and best.position + up_m <= highest.position
            and best.velocity + up_l <= highest.velocity
        ]
        if not steps:
            break
        better = max((_judged(reduced, step) for step in steps), key=lambda o: _gain(best, o))
        if better.held_out_rmse > LEAST_GAIN * best.held_out_rmse:
            break
        best = better
    return best


def _smoothed(reduced: list[Reduced], orders: Orders) -> Orders:
    """Orders with the penalty that predicts left-out speeds best."""
    plain = _judged(reduced, orders)
    if len({item.u for item in reduced}) <= 3:
        return plain
    left_out = _LeaveOut.of(reduced, orders)
    trials = [
        replace(orders, smoothing=s, held_out_rmse=_rms(reduced, left_out.surfaces(s)))
        for s in STRENGTHS
    ]
    return min([plain, *trials], key=lambda trial: trial.held_out_rmse)


def _judged(reduced: list[Reduced], orders: Orders) -> Orders:
    return replace(orders, held_out_rmse=left_out_rms(reduced, orders))


STRENGTHS = tuple(10.0 ** (k / 2) for k in range(-18, -5))
LEAST_GAIN = 0.995
CLEARLY_BETTER = 0.85


def _gain(now: Orders, then: Orders) -> float:
    """Gain in the left-out error per coefficient added: a large step must earn its size."""
    added = (then.position + 1) * (then.velocity + 1) - (now.position + 1) * (now.velocity + 1)
    gain = np.log(max(now.held_out_rmse, 1e-300) / max(then.held_out_rmse, 1e-300))
    return float(gain / np.sqrt(added)) if gain > 0 else float(gain)
