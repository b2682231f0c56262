"""Step 1 of the friction surface: each trial reduced to a polynomial of position (Eq. 8).

With A (K, p) the functions of position at the slices of one trial, W their weights and
y the friction there, ||W^1/2 (A c - y)||^2 = ||R c - z||^2 + rest. R, z and rest hold
as much of the surface as the slices do, so speeds and orders can be left out without
going back to them. Two columns more have what is left of speeding up and of slowing
down at the ends of a trial, exp(-s / `edge_s`), s the time from the end. The last four
have the torque that one standard error of the joint's inertia makes of its
acceleration, that of how far held joints gave way, that of the delay of the torque
(gravity is read off where the joint is no more, which turns with the direction as
friction does), and that of the joint's temperature; their coefficients are the same in
all trials.

A joint is still speeding up, or slows already, in the first and last slices of some
trials: their torque is not friction alone. Slices are judged by Tukey's biweight (J. W.
Tukey, in Beaton and Tukey, Technometrics 16(2), 1974) of their distance from the
surface, in units of the median distance in their trial. Before there is a surface,
medians stand in: of each trial over its positions, of each position over the trials.
What all trials have at one position is friction.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.stats import binned_statistic, median_abs_deviation

from seqid_cli.model.friction_basis import Scaling
from seqid_cli.typing import Array, Mask

EDGES = 2  # ends of a trial
# Errors that all trials have in common: inertia, where others gave way, delay,
# temperature.
SHARED = 4
# places of the last two behind the functions of position
LATE, WARM = EDGES + 2, EDGES + 3
EXTRA = EDGES + SHARED  # columns beside those of position
COUNTS = 0.1  # of a trial's largest weight, from which a slice counts as one
MAX_POSITION_ORDER, MAX_VELOCITY_ORDER = 10, 11


@dataclass(frozen=True)
class Orders:
    """Orders m over position and l over speed."""

    position: int
    velocity: int


@dataclass(frozen=True)
class SpeedData:
    """One trial, by K slices."""

    speed: float
    direction: int
    q: Array  # (K,) rad
    friction: Array  # (K,) N m
    weight: Array  # (K,) samples
    edges: Array  # (K, 2) how near, in time, they are to the begin and to the end
    # (K,) N m that friction is wrong by if the inertia is by one standard error
    push: Array
    doubt: Array  # (K,) N m likewise if it is how far other joints gave way
    late: Array  # (K,) N m likewise if the torque is late by one standard deviation
    # (K,) N m likewise if friction falls by one standard deviation per kelvin
    warm: Array

    @property
    def belongs(self) -> Mask:
        """Slices (K,) that count as measured."""
        return np.asarray(self.weight > COUNTS * self.weight.max(initial=0.0))


def around_medians(data: list[SpeedData], *, bins: int = 24) -> list[Array]:
    """Distances (K,) N m of slices from medians over positions and over trials."""
    middles = [item.friction - np.median(item.friction) for item in data]
    q, values = np.concatenate([item.q for item in data]), np.concatenate(middles)
    middle, edges, _ = binned_statistic(q, values, "median", bins)
    centres, known = 0.5 * (edges[1:] + edges[:-1]), np.isfinite(middle)
    off = [
        own - np.interp(item.q, centres[known], middle[known])
        for item, own in zip(data, middles, strict=True)
    ]
    return [each - np.median(each) for each in off]


def weighted(
    data: list[SpeedData],
    off: list[Array],
    *,
    min_scatter: float = 1e-9,
    max_ratio: float = 4.685,
) -> list[SpeedData]:
    """Weight slices that are `off` (K,) N m: by noise, and little where they do not belong."""
    # No scatter below `min_scatter` of the usual friction is believed. Tukey's weight
    # is zero beyond `max_ratio` scales: 95 % efficient for normal errors.
    level = float(np.median([np.median(np.abs(item.friction)) for item in data]))
    found = [median_abs_deviation(own, scale="normal") for own in off]
    scales = np.maximum(found, max(min_scatter * level, 1e-300))
    variances = scales**2 * np.array([float(np.median(item.weight)) for item in data])
    shares = np.minimum(float(np.median(variances)) / variances, 1.0)
    tukey = [
        np.clip(1.0 - (own / (max_ratio * scale)) ** 2, 0.0, None) ** 2
        for own, scale in zip(off, scales, strict=True)
    ]
    return [
        replace(item, weight=item.weight * share * own)
        for item, share, own in zip(data, shares, tukey, strict=True)
    ]


@dataclass(frozen=True)
class Reduced:
    """Trials after step 1: T of them, p functions of position and six columns more each."""

    scaling: Scaling
    speeds: Array  # (T,) rad/s
    u: Array  # (T,) scaled
    R: Array  # (T, p + 6, p + 6)
    z: Array  # (T, p + 6)
    rest: Array  # (T,) squares that no such function takes
    total: Array  # (T,) sums of weights
    slices: Array  # (T,) how many

    @property
    def size(self) -> int:
        """Functions of position, p."""
        return int(self.z.shape[1]) - EXTRA

    @property
    def levels(self) -> Array:
        """Scaled speeds, each once, slowest first."""
        return np.unique(self.u)

    def over_speed(self, order: int) -> Array:
        """Chebyshev values (T, order + 1) at the trials' speeds."""
        return np.asarray(chebvander(self.u, order), dtype=np.float64)

    def subset(self, kept: Mask) -> "Reduced":
        """Some of the trials."""
        parts = (
            self.speeds,
            self.u,
            self.R,
            self.z,
            self.rest,
            self.total,
            self.slices,
        )
        return Reduced(self.scaling, *(part[kept] for part in parts))


def reduce_trials(
    data: list[SpeedData], scaling: Scaling, *, empty_share: float = 1e-12
) -> Reduced:
    """Reduce every trial to its R factor (Eq. 8); rows below `empty_share` of it are rounding."""
    parts = []
    for item in data:
        over_position = scaling.over_position.values(item.q, MAX_POSITION_ORDER)
        shared = [item.push, item.doubt, item.late, item.warm]
        columns = [over_position, item.edges, *shared, item.friction]
        rows = np.column_stack(columns) * np.sqrt(item.weight)[:, None]
        size = rows.shape[1] - 1
        # filled up with rows of zeros
        few = np.zeros((max(size + 1 - len(rows), 0), size + 1))
        factor: Array = np.asarray(
            np.linalg.qr(np.vstack([rows, few]), mode="r"), dtype=np.float64
        )
        R, z = factor[:size, :size], factor[:size, size]
        empty = np.linalg.norm(R, axis=1) <= empty_share * np.linalg.norm(R)
        rest = float(factor[size, size] ** 2 + np.sum(z[empty] ** 2))
        total, slices = float(item.weight.sum()), float(np.count_nonzero(item.belongs))
        parts.append((R, np.where(empty, 0.0, z), rest, total, slices))
    speeds = np.array([item.speed for item in data])
    return Reduced(
        scaling, speeds, scaling.u(speeds), *map(np.array, zip(*parts, strict=True))
    )


def edges_of(t: Array, seconds: float, *, edge_s: float = 0.05) -> Array:
    """How near slices at times t (K,), each so many seconds long, are to both ends (K, 2)."""
    begin, end = t[0] - seconds / 2.0, t[-1] + seconds / 2.0
    return np.asarray(np.exp(-np.stack([t - begin, end - t], axis=1) / edge_s))
