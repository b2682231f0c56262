"""Step 1 of the friction surface: each motion as a polynomial of position (Eq. 8).

A motion is what trials of one speed, direction and posture have in common: what a trial
has for itself, as from the gear's teeth, the next one of the same motion has as well.
Repeated trials make the noise smaller, and tell nothing new of anything else: their
slices are taken together.

With A (K, p) the functions of position at the slices of one motion, W their weights and
y the friction there, ||W^1/2 (A c - y)||^2 = ||R c - z||^2 + rest. R, z and rest hold
as much of the surface as the slices do, so speeds and orders can be left out without
going back to them. Two columns more have what is left of speeding up and of slowing
down at the ends of a trial, exp(-s / `EDGE_S`), s the time from the end. The last four
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

from seqid_cli.distributions import normal_quantile
from seqid_cli.identify.options import MAX_POSITION_ORDER
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.typing import Array, Mask

EDGES = 2  # ends of a trial
# Errors that all trials have in common: inertia, where others gave way, delay,
# temperature.
SHARED = 4
# Places of the last two behind the functions of position.
LATE = EDGES + 2
WARM = EDGES + 3
EXTRA = EDGES + SHARED  # columns beside those of position
# Share of a trial's largest weight from which a slice counts as measured.
MEASURED_WEIGHT = 0.1
MAX_VELOCITY_ORDER = 11
# Bins of positions over which medians are taken before there is a surface.
MEDIAN_BINS = 24
# No scatter below this share of the usual friction is believed.
MIN_SCATTER = 1e-9
# Tukey's weight is zero beyond so many scales: 95 % efficient for normal errors.
MAX_RATIO = 4.685
# Rows below this share of a trial's factor are rounding.
EMPTY_SHARE = 1e-12
EDGE_S = 0.05  # s, over which an unsteady speed fades from the ends of a trial


@dataclass(frozen=True)
class Orders:
    """Orders m over position and l over speed."""

    position: int
    velocity: int


@dataclass(frozen=True, kw_only=True)
class SpeedData:
    """One trial, by K slices.

    `speed` rad/s and `direction` (1 or -1) are of the joint, `posture` numbers the
    configurations of the others, `q` (K,) rad are its positions, `friction` (K,) N m
    its friction in the direction of motion. `weight` (K,) are samples, `edges` (K, 2)
    how near, in time, slices are to the begin and to the end. `push`, `doubt`, `late`
    and `warm` (K,) N m are what friction is wrong by for one standard error of the
    inertia, of how far other joints gave way, of the torque's delay, and of friction's
    change per kelvin.
    """

    speed: float
    direction: int
    q: Array
    friction: Array
    weight: Array
    edges: Array
    push: Array
    doubt: Array
    late: Array
    warm: Array
    posture: int = 0

    @property
    def belongs(self) -> Mask:
        """Slices (K,) that count as measured."""
        return np.asarray(self.weight > MEASURED_WEIGHT * self.weight.max(initial=0.0))


def around_medians(data: list[SpeedData]) -> list[Array]:
    """Return distances (K,) N m of slices from medians over positions and trials."""
    around_trial = [item.friction - np.median(item.friction) for item in data]
    q = np.concatenate([item.q for item in data])
    edges = np.linspace(q.min(), q.max(), MEDIAN_BINS + 1)
    bin_number = np.searchsorted(edges[1:-1], q, side="right")
    centres = 0.5 * (edges[1:] + edges[:-1])
    filled = np.unique(bin_number)
    friction_around = np.concatenate(around_trial)
    median = [np.median(friction_around[bin_number == number]) for number in filled]
    distances = []
    for item, friction in zip(data, around_trial, strict=True):
        over_position = np.interp(item.q, centres[filled], median)
        distance = friction - over_position
        distances.append(distance - np.median(distance))
    return distances


def weighted(data: list[SpeedData], distances: list[Array]) -> list[SpeedData]:
    """Weight slices by the noise of their trial, and little where they do not belong.

    Parameters
    ----------
    data : list of SpeedData
        Trials.
    distances : list of (K,) arrays
        Distances of their slices from the surface [N m].
    """
    level = float(np.median([np.median(np.abs(item.friction)) for item in data]))
    deviations = [
        np.median(np.abs(x - np.median(x))) / normal_quantile(0.75) for x in distances
    ]
    scales = np.maximum(deviations, max(MIN_SCATTER * level, 1e-300))
    samples = np.array([float(np.median(item.weight)) for item in data])
    variances = scales**2 * samples
    noise_weights = np.minimum(float(np.median(variances)) / variances, 1.0)

    result = []
    for item, distance, scale, noise_weight in zip(
        data, distances, scales, noise_weights, strict=True
    ):
        ratio = distance / (MAX_RATIO * scale)
        tukey = np.clip(1.0 - ratio**2, 0.0, None) ** 2
        result.append(replace(item, weight=item.weight * noise_weight * tukey))
    return result


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """Trials after step 1: T motions, p functions of position and six more columns.

    `speeds` (T,) rad/s and `u` (T,) scaled are of the motions; `R` (T, p + 6, p + 6)
    and `z` (T, p + 6) their factors, `residual_squares` (T,) the squares that no such
    function takes. `total` (T,) are sums of weights, `slices` (T,) how many slices
    there are.
    """

    scaling: Scaling
    speeds: Array
    u: Array
    R: Array
    z: Array
    residual_squares: Array
    total: Array
    slices: Array

    @property
    def size(self) -> int:
        """Functions of position, p."""
        return int(self.z.shape[1]) - EXTRA

    @property
    def highest_position_order(self) -> int:
        """Order of these functions."""
        return self.scaling.over_position.order(self.size)

    @property
    def levels(self) -> Array:
        """Scaled speeds, each once, slowest first."""
        return np.unique(self.u)

    def over_speed(self, order: int) -> Array:
        """Return Chebyshev values (T, order + 1) at the motions' speeds."""
        return np.asarray(chebvander(self.u, order), dtype=np.float64)

    def subset(self, chosen: Mask) -> "Reduced":
        """Return some of the motions, by a mask (T,)."""
        return Reduced(
            scaling=self.scaling,
            speeds=self.speeds[chosen],
            u=self.u[chosen],
            R=self.R[chosen],
            z=self.z[chosen],
            residual_squares=self.residual_squares[chosen],
            total=self.total[chosen],
            slices=self.slices[chosen],
        )


def reduce_trials(data: list[SpeedData], scaling: Scaling) -> Reduced:
    """Reduce every motion to its R factor (Eq. 8)."""
    factors: list[Array] = []
    right_sides: list[Array] = []
    residual_squares: list[float] = []
    motions = _motions(data)
    for trials in motions:
        rows = np.vstack([_rows(item, scaling) for item in trials])
        size = rows.shape[1] - 1
        # Rows of zeros make a factor of few slices as large as any.
        missing = np.zeros((max(size + 1 - len(rows), 0), size + 1))
        factor = np.asarray(
            np.linalg.qr(np.vstack([rows, missing]), mode="r"), dtype=np.float64
        )
        R = factor[:size, :size]
        z = factor[:size, size]
        empty = np.linalg.norm(R, axis=1) <= EMPTY_SHARE * np.linalg.norm(R)
        factors.append(R)
        right_sides.append(np.where(empty, 0.0, z))
        residual_squares.append(float(factor[size, size] ** 2 + np.sum(z[empty] ** 2)))
    speeds = np.array([trials[0].speed for trials in motions])
    return Reduced(
        scaling=scaling,
        speeds=speeds,
        u=scaling.u(speeds),
        R=np.array(factors),
        z=np.array(right_sides),
        residual_squares=np.array(residual_squares),
        total=np.array(
            [sum(float(item.weight.sum()) for item in trials) for trials in motions]
        ),
        slices=np.array(
            [
                sum(float(np.count_nonzero(item.belongs)) for item in trials)
                for trials in motions
            ]
        ),
    )


def _motions(data: list[SpeedData]) -> list[list[SpeedData]]:
    """Return the trials of each motion."""
    motions: dict[tuple[float, int, int], list[SpeedData]] = {}
    for item in data:
        motion = (item.speed, item.direction, item.posture)
        motions.setdefault(motion, []).append(item)
    return list(motions.values())


def _rows(item: SpeedData, scaling: Scaling) -> Array:
    """Return the weighted columns (K, p + 7) of a trial, its friction the last."""
    over_position = scaling.over_position.values(item.q, MAX_POSITION_ORDER)
    shared = [item.push, item.doubt, item.late, item.warm]
    columns = [over_position, item.edges, *shared, item.friction]
    return np.column_stack(columns) * np.sqrt(item.weight)[:, None]


def edges_of(t: Array, seconds: float) -> Array:
    """Return the nearness (K, 2) of slices at times t (K,) s to both ends.

    Each slice lasts `seconds`.
    """
    begin = t[0] - seconds / 2.0
    end = t[-1] + seconds / 2.0
    distances = np.stack([t - begin, end - t], axis=1)
    return np.asarray(np.exp(-distances / EDGE_S))
