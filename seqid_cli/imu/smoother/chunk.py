"""What a stretch of a log holds: encoder codes, IMUs, and its motion as cubic splines.

The trajectory of a joint is a cubic spline, its jerk constant between knots. In
interval k the position, velocity and acceleration depend on the coefficients k to k + 3
alone, so states (q, dq, ddq) driven by white jerk take one unknown per knot.

Letters of the smoother, in all of its files:

    N, n    samples of the stretch, joints
    M       intervals between knots, of `every` samples each
    K       coefficients of each joint, M + 3
    c       coefficients (K, n) rad
    L       channels of an IMU: its accelerometers, then its gyro
    g       constants of an IMU (see `Mounted`)
    C       cells: intervals in a row that share their Jacobians
    m       joints that move an IMU, those up to its link
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial.polynomial import polyder, polyval

from seqid_cli.imu.sensor import Mounting, Places
from seqid_cli.robot.types import Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Index, Mask

# Cubic B-splines on an interval by powers of u in [0, 1), times 6; the third
# derivative.
SPLINES = np.array([[1.0, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]])
JERK = SPLINES[3]


def spline_weights(u: Array, spacing: float) -> Array:
    """Return the weights of an interval's four coefficients in its motion.

    Parameters
    ----------
    u : Array
        (S,), places in [0, 1) of the interval.
    spacing : float
        Its length [s].

    Returns
    -------
    Array
        (S, 3, 4), in q, dq, ddq.
    """
    derivatives = [
        polyval(u, polyder(SPLINES, order)) / 6 / spacing**order for order in range(3)
    ]
    return np.array(derivatives).transpose(2, 0, 1)


@dataclass(frozen=True)
class Jerk:
    """White jerk of all joints.

    An arm's inertia passes jolts on, so that jerks come together.

    Attributes
    ----------
    size : Array
        (n,) rad/s^3, usual jerk between knots.
    correlation : Array
        (n, n) between joints.
    relative : Array
        (M, n), how much larger than usual it is in each interval: friction jolts a
        joint that turns back, and an arm that rests has none.
    """

    size: Array
    correlation: Array
    relative: Array

    @property
    def precision(self) -> Array:
        """Inverse covariance (n, n) of the usual jerk."""
        covariance = self.correlation * np.outer(self.size, self.size)
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class EncoderView:
    """What a joint's encoder codes say.

    Attributes
    ----------
    q : Array
        (N,) rad.
    step : float
        rad, 0 where not quantised.
    white : float
        Variance of the noise [rad^2].
    edge : Array
        (N,), position of the edge that is crossed before the next sample, else NaN.
    dwell : Array
        (N,), samples that the code lasted.
    known : Mask
        (N,), whether the sample holds a position.
    stride : int
        One of so many places was sampled.
    edge_offset : float
        Places by which an edge lies behind the one that it is written at.
    """

    q: Array
    step: float
    white: float
    edge: Array
    dwell: Array
    known: Mask
    stride: int = 1
    edge_offset: float = 0.5

    def refined(self, stride: int) -> "EncoderView":
        """Return the view with `stride` places per sample; edges lie between them.

        Midway between two samples is a place where `stride` is even, else midway
        between two places.
        """
        middle = stride // 2
        edge = np.full(len(self.q) * stride, np.nan)
        edge[middle::stride] = self.edge
        known = np.zeros(len(edge), dtype=bool)
        known[::stride] = self.known
        return replace(
            self,
            q=np.repeat(self.q, stride),
            edge=edge,
            dwell=np.repeat(self.dwell, stride),
            known=known,
            stride=stride,
            edge_offset=0.5 * stride - middle,
        )

    def weights(
        self,
        speed: Array,
        dt: float,
        *,
        edge: float = 0.03,
        smallest_variance: float = 1e-16,
    ) -> tuple[Array, Array]:
        """Return the weights of samples and of edges.

        Parameters
        ----------
        speed : Array
            (N,) rad/s of the joint.
        dt : float
            Time between places [s].
        edge : float
            Error of an edge's place, in counts.
        smallest_variance : float
            Of a position that is not quantised [rad^2].

        Returns
        -------
        tuple of Array
            Both (N,) 1/rad^2, the edges `edge_offset` places behind theirs.
        """
        # A joint that crosses an edge was there within one sample: its position is
        # known to speed * dt / sqrt 12, which beats step / sqrt 12 below one count per
        # sample. While a code lasts its samples say the same again and again; together
        # they count once.
        rounding = self.step**2 / 12
        if not self.step or not np.isfinite(self.edge).any():
            variance = max(self.white + rounding, smallest_variance)
            weights = self.known / variance
            lasting = self.dwell if self.step else 1.0
            return weights / lasting, np.zeros(len(self.q))

        moved = np.abs(speed) * dt * self.stride
        is_fast = moved >= self.step
        is_crossing = np.isfinite(self.edge) & ~is_fast
        edge_variance = moved**2 / 12 + (edge * self.step) ** 2 + self.white
        sample_variance = rounding * np.where(is_fast, 1.0, self.dwell) + self.white
        return 1.0 / sample_variance * self.known, is_crossing / edge_variance


def bridged(q: Array, known: Mask) -> Array:
    """Return positions (N,) with straight lines where not known; zero if none is."""
    at = np.flatnonzero(known)
    if not len(at):
        return np.zeros(len(q))
    return np.asarray(np.interp(np.arange(len(q)), at, q[at]))


def encoder_view(
    q: Array, step: float, valid: Mask | None = None, *, noisy: float = 0.3
) -> EncoderView:
    """Read codes and edges off one joint's positions.

    Parameters
    ----------
    q : Array
        (N,) rad; what is not finite is not known.
    step : float
        The encoder's step [rad], 0 where positions are not quantised.
    valid : Mask, optional
        (N,), false where a position is not to be believed.
    noisy : float
        Share of code changes that are undone at once, from which on noise hides the
        edges.
    """
    known: Mask = np.isfinite(q) if valid is None else np.isfinite(q) & valid
    if not known.all():
        q = bridged(q, known)
    no_edges = np.full(len(q), np.nan)
    once = np.ones(len(q))
    white = float(white_noise(q[:, None], known)[0]) ** 2
    if step <= 0:
        return EncoderView(
            q=q, step=0.0, white=white, edge=no_edges, dwell=once, known=known
        )

    change = np.diff(np.round(q / step))
    both_known = known[1:] & known[:-1]
    at = np.flatnonzero((change != 0) & both_known)
    taken_back = (np.diff(at) <= 3) & (change[at[1:]] * change[at[:-1]] < 0)
    if len(at) > 20 and float(np.mean(taken_back)) > noisy:
        return EncoderView(
            q=q, step=step, white=white, edge=no_edges, dwell=once, known=known
        )

    # Of a change by one count the edge lies between the two codes.
    edge = no_edges.copy()
    single = at[np.abs(change[at]) == 1]
    edge[single] = 0.5 * (q[single] + q[single + 1])

    changes = np.flatnonzero((change != 0) | ~both_known) + 1
    lasting = np.diff(np.concatenate(([0], changes, [len(q)])))
    dwell = np.repeat(lasting, lasting).astype(float)
    return EncoderView(q=q, step=step, white=0.0, edge=edge, dwell=dwell, known=known)


CELL_S = 0.016  # within which an arm hardly turns


@dataclass(frozen=True, kw_only=True)
class Mounted:
    """An IMU in one stretch: its readings as they came, as the knots gather them.

    Its g constants are those of `imu.sensor.Places`: a small turn, the place on the
    link, the clock's offset and rate and the biases; then the channels' axes (3 L).

    Attributes
    ----------
    name : str
    place : Mounting
    raw, live : Array, Mask
        (N, L), readings at the samples, and which of them count.
    noise : Array
        (L,) of single readings.
    bias : Array
        (L,).
    delay, rate : float
        What happens t s of the encoders' clock after the log began has the stamp t +
        `delay` + `rate` (t - `middle_s`).
    middle_s : float
        Middle of the stretch, s since the log began.
    away : Array
        (g,), from where the prior had the constants.
    precision : Array
        (g, g) of the prior.
    y, seen : Array, Mask
        (M, L), readings averaged over knot intervals, and which of them count.
    fraction : Array
        (M,), of a sample, by which the gathered readings of an interval came later.
    every : int
        Samples that were averaged.
    gyro_delay : float
        s, by which the gyro is later than the accelerometers.
    """

    name: str
    place: Mounting
    raw: Array
    live: Mask
    noise: Array
    bias: Array
    delay: float
    rate: float
    middle_s: float
    away: Array
    precision: Array
    y: Array
    seen: Mask
    fraction: Array
    every: int = 1
    gyro_delay: float = 0.0

    @property
    def places(self) -> Places:
        """Where each constant stands."""
        return Places(self.place.channels)

    @property
    def joints(self) -> int:
        """Number of joints that move it, m."""
        return self.place.link + 1

    @property
    def there(self) -> Mask:
        """Intervals (M,) in which any channel was seen."""
        return np.asarray(self.seen.any(axis=1))

    @property
    def spread(self) -> Array:
        """Noise (L,) of the gathered readings."""
        return np.asarray(self.noise / np.sqrt(self.every))


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """What one stretch of a log holds.

    Attributes
    ----------
    robot : Robot
    views : tuple of EncoderView
        Of every joint.
    dt : float
        Time between samples [s].
    every : int
        Samples per knot.
    imus : tuple of Mounted
    """

    robot: Robot
    views: tuple[EncoderView, ...]
    dt: float
    every: int
    imus: tuple[Mounted, ...]

    @property
    def joints(self) -> int:
        """Number of joints, n."""
        return len(self.views)

    @property
    def samples(self) -> int:
        """Number of samples, N."""
        return len(self.views[0].q)

    @property
    def stride(self) -> int:
        """One of how many places was sampled."""
        return self.views[0].stride

    @property
    def intervals(self) -> int:
        """Number of knot intervals that hold the samples, M."""
        return -(-self.samples // self.every)

    @property
    def spacing(self) -> float:
        """Time between knots, s."""
        return self.every * self.dt

    @property
    def knots(self) -> Array:
        """Weights (every, 3, 4) of the coefficients at an interval's samples."""
        return spline_weights(np.arange(self.every) / self.every, self.spacing)

    def mean_knots(self, fraction: Array) -> Array:
        """Return the weights (S, 3, 4) of the mean motion of intervals.

        It is averaged over the samples, `fraction` (S,) of a sample later.
        """
        u = (np.arange(self.every) + fraction[:, None]) / self.every
        weights = spline_weights(u.ravel(), self.spacing)
        weights = weights.reshape(len(fraction), self.every, 3, 4)
        return np.asarray(weights.mean(axis=1))

    @property
    def from_middle(self) -> Array:
        """Time (M,) s of each interval's begin after the middle of the stretch."""
        middle = 0.5 * self.samples * self.dt
        begins = self.spacing * np.arange(self.intervals, dtype=np.float64)
        return np.asarray(begins - middle)

    @property
    def cell(self) -> int:
        """Intervals that share their Jacobians: those change slowly."""
        return max(1, int(CELL_S / self.spacing))

    @property
    def cells(self) -> Index:
        """First interval of each cell."""
        return np.arange(0, self.intervals, self.cell)

    def gathered(self) -> "Chunk":
        """Return the same with all readings in the intervals in which they were taken.

        The clocks of the IMUs say which those are.
        """
        imus = tuple(self._gathered(x) for x in self.imus)
        return replace(self, imus=imus)

    def _gathered(self, x: Mounted) -> Mounted:
        """Return an IMU with its readings in the intervals in which they were taken."""
        # A cell shares its Jacobians, so that all its readings are as many places late.
        middle = 0.5 * self.samples
        place = np.arange(self.intervals * self.every)
        cell = self.cell * self.every
        amid_cell = (place // cell + 0.5) * cell - middle
        late = x.delay / self.dt + x.rate * amid_cell
        stamp = place + np.ceil(late - 1e-9).astype(np.intp)

        number, between = np.divmod(stamp, self.stride)
        inside = (number >= 0) & (number < len(x.raw)) & (between == 0)
        inside &= place < self.samples
        number = np.clip(number, 0, len(x.raw) - 1)
        y = np.where(inside[:, None], x.raw[number], 0.0)
        seen: Mask = inside[:, None] & x.live[number]
        instant = (stamp - middle - x.delay / self.dt) / (1.0 + x.rate) + middle
        fraction = instant - place
        if self.every > 1:
            channels = x.raw.shape[1]
            y = y.reshape(-1, self.every, channels).mean(axis=1)
            seen = np.asarray(seen.reshape(-1, self.every, channels).all(axis=1))
            fraction = fraction.reshape(-1, self.every).mean(axis=1)
        return replace(x, y=y, seen=seen, fraction=fraction, every=self.every)


def motion_at(chunk: Chunk, c: Array) -> Array:
    """Return q, dq, ddq (N, 3, n) at the samples."""
    weights = chunk.knots.reshape(-1, 4)
    x = sampled(c, weights).reshape(chunk.every, 3, -1, chunk.joints)
    in_order = x.transpose(2, 0, 1, 3).reshape(-1, 3, chunk.joints)
    return in_order[: chunk.samples]


def sampled(c: Array, weights: Array) -> Array:
    """Return values (S, M, n) in all intervals by weights (S, 4) of coefficients."""
    return np.tensordot(weights, sliding_window_view(c, 4, axis=0), (1, 2))


def mean_motion(
    chunk: Chunk,
    c: Array,
    fraction: Array | None = None,
    at: Index | None = None,
) -> Array:
    """Return q, dq, ddq averaged over the samples of intervals.

    Parameters
    ----------
    chunk : Chunk
    c : Array
        (K, n).
    fraction : Array, optional
        (M,), of a sample, by which the motion is taken later.
    at : Index, optional
        Intervals that are asked for; all M by default.

    Returns
    -------
    Array
        (3, n, M).
    """
    near = sliding_window_view(c, 4, axis=0)
    if fraction is None:
        fraction = np.zeros(len(near))
    if at is not None:
        near = near[at]
        fraction = fraction[at]
    motion = chunk.mean_knots(fraction) @ near.transpose(0, 2, 1)
    return np.ascontiguousarray(motion.transpose(1, 2, 0))


def jerk_of(c: Array, spacing: float) -> Array:
    """Return the jerk (M, n) rad/s^3 in every interval."""
    return np.diff(c, 3, axis=0) / spacing**3


def resampled(chunk: Chunk, c: Array, other: Chunk) -> Array:
    """Return coefficients of the same cubics on another chunk's knots."""
    h = other.spacing
    t = (np.arange(other.intervals + 3) - 1) * h / chunk.spacing
    k = np.clip(t.astype(int), 0, chunk.intervals - 1)
    weights = spline_weights(t - k, chunk.spacing)
    # A coefficient is the position at its knot less h^2 / 6 of the acceleration there.
    at_knots = weights[:, 0] - h**2 / 6 * weights[:, 2]
    near = sliding_window_view(c, 4, axis=0)[k]
    return np.asarray(np.einsum("ka,kna->kn", at_knots, near))
