"""What one stretch of a log holds: encoder codes, IMUs, and its motion as cubic splines.

The trajectory of a joint is a cubic spline, its jerk constant between knots. In
interval k the position, velocity and acceleration depend on the coefficients k to k + 3
alone, so states (q, dq, ddq) driven by white jerk take one unknown per knot.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial.polynomial import polyder, polyval

from seqid_cli.motion.imu.sensor import Mounting
from seqid_cli.robot.types import Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Index, Mask

# Cubic B-splines on an interval by powers of u in [0, 1), times 6; the third
# derivative.
SPLINES = np.array([[1.0, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]])
JERK = SPLINES[3]


def spline_weights(u: Array, spacing: float) -> Array:
    """Weights (len(u), 3, 4) of four coefficients in q, dq, ddq at `u` in [0, 1) of an interval."""
    weights = [polyval(u, polyder(SPLINES, d)) / 6 / spacing**d for d in range(3)]
    return np.array(weights).transpose(2, 0, 1)


@dataclass(frozen=True)
class Jerk:
    """White jerk of all joints; an arm's inertia passes jolts on, so that jerks come together."""

    size: Array  # (n,) rad/s^3 between knots
    correlation: Array  # (n, n)
    # (M, n) how much larger than usual it is in each interval: friction jolts a joint
    # that turns back, and an arm that rests has none.
    relative: Array

    @property
    def precision(self) -> Array:
        """Inverse covariance (n, n) of the usual jerk."""
        covariance = self.correlation * np.outer(self.size, self.size)
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


@dataclass(frozen=True)
class EncoderView:
    """What a joint's encoder codes say."""

    q: Array
    step: float  # rad, 0 where not quantised
    white: float  # rad^2, noise
    edge: Array  # (N,) position of the edge crossed before the next sample, else NaN
    dwell: Array  # (N,) samples that the code lasted
    known: Mask  # (N,) whether it holds a position
    stride: int = 1  # one of so many places was sampled

    def refined(self, stride: int) -> "EncoderView":
        """The same with `stride` places per sample; edges lie between samples."""
        edge = np.full(len(self.q) * stride, np.nan)
        edge[(stride - 1) // 2 :: stride] = self.edge
        known = np.zeros(len(edge), dtype=bool)
        known[::stride] = self.known
        q, dwell = np.repeat(self.q, stride), np.repeat(self.dwell, stride)
        return replace(self, q=q, edge=edge, dwell=dwell, known=known, stride=stride)

    def weights(
        self,
        speed: Array,
        dt: float,
        *,
        edge: float = 0.03,
        smallest_variance: float = 1e-16,
    ) -> tuple[Array, Array]:
        """Weights, 1/rad^2, of samples and of the edges half a sample after them."""
        # A joint that crosses an edge was there within one sample: its position is
        # known to speed * dt / sqrt 12, which beats step / sqrt 12 below one count per
        # sample. While a code lasts its samples say the same again and again; together
        # they count once.
        uniform = self.step**2 / 12
        if not self.step or not np.isfinite(self.edge).any():
            known = self.known / max(self.white + uniform, smallest_variance)
            return known / (self.dwell if self.step else 1.0), np.zeros(len(self.q))
        moved = np.abs(speed) * dt * self.stride
        fast = moved >= self.step
        crossing = np.isfinite(self.edge) & ~fast
        edges = crossing / (moved**2 / 12 + (edge * self.step) ** 2 + self.white)
        samples = 1.0 / (uniform * np.where(fast, 1.0, self.dwell) + self.white)
        return samples * self.known, edges


def bridged(q: Array, known: Mask) -> Array:
    """Positions (N,) with straight lines where they are not known; zero if none is."""
    at = np.flatnonzero(known)
    if not len(at):
        return np.zeros(len(q))
    return np.asarray(np.interp(np.arange(len(q)), at, q[at]))


def encoder_view(
    q: Array, step: float, valid: Mask | None = None, *, noisy: float = 0.3
) -> EncoderView:
    """Read codes and edges off one joint's positions (N,) [rad], where they are finite."""
    known: Mask = np.isfinite(q) if valid is None else np.isfinite(q) & valid
    if not known.all():
        q = bridged(q, known)
    nowhere, once = np.full(len(q), np.nan), np.ones(len(q))
    white = float(white_noise(q[:, None], known)[0]) ** 2
    if step <= 0:
        return EncoderView(q, 0.0, white, nowhere, once, known)
    change = np.diff(np.round(q / step))
    between = known[1:] & known[:-1]
    at = np.flatnonzero((change != 0) & between)
    back = (np.diff(at) <= 3) & (change[at[1:]] * change[at[:-1]] < 0)
    if len(at) > 20 and float(np.mean(back)) > noisy:
        return EncoderView(q, step, white, nowhere, once, known)
    edge = nowhere.copy()
    single = at[np.abs(change[at]) == 1]
    edge[single] = 0.5 * (q[single] + q[single + 1])
    bounds = np.concatenate(
        ([0], np.flatnonzero((change != 0) | ~between) + 1, [len(q)])
    )
    lasting = np.diff(bounds)
    return EncoderView(
        q, step, 0.0, edge, np.repeat(lasting, lasting).astype(float), known
    )


CELL_S = 0.016  # within which an arm hardly turns


@dataclass(frozen=True)
class Mounted:
    """An IMU in one stretch: its readings as they came, as the knots gather them, its constants.

    The constants are the channels' biases (K), the place on the link (3) m, a small
    turn (3) rad, the clock's offset (1) s and the channels' axes (3 K).
    """

    name: str
    place: Mounting
    raw: Array  # (N, K) at the samples
    live: Mask  # (N, K)
    noise: Array  # (K,) of single readings
    bias: Array  # (K,)
    # a reading stamped t was taken at t - `delay` s on the encoders' clock
    delay: float
    away: Array  # (g,) from where the prior had the constants
    precision: Array  # (g, g) of the prior
    y: Array  # (M, K) averaged over knot intervals
    seen: Mask  # (M, K)
    fraction: float = 0.0  # of a sample, by which the gathered readings came later
    every: int = 1
    gyro_delay: float = 0.0  # s, by which the gyro is later than the accelerometers

    @property
    def joints(self) -> int:
        """Number of joints that move it."""
        return self.place.link + 1

    @property
    def there(self) -> Mask:
        """Whether (M,) any channel was seen."""
        return np.asarray(self.seen.any(axis=1))

    @property
    def spread(self) -> Array:
        """Noise (K,) of the gathered readings."""
        return np.asarray(self.noise / np.sqrt(self.every))


@dataclass(frozen=True)
class Chunk:
    """What one stretch of a log holds; `every` samples per knot."""

    robot: Robot
    views: tuple[EncoderView, ...]
    dt: float
    every: int
    imus: tuple[Mounted, ...]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.views)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.views[0].q)

    @property
    def stride(self) -> int:
        """One of how many places was sampled."""
        return self.views[0].stride

    @property
    def intervals(self) -> int:
        """Number of knot intervals that hold them."""
        return -(-self.samples // self.every)

    @property
    def spacing(self) -> float:
        """Time between knots, s."""
        return self.every * self.dt

    @property
    def knots(self) -> Array:
        """Weights (every, 3, 4) of the coefficients at an interval's samples."""
        return spline_weights(np.arange(self.every) / self.every, self.spacing)

    def mean_knots(self, fraction: float) -> Array:
        """Weights (3, 4) of an interval's mean motion, `fraction` of a sample later."""
        u = (np.arange(self.every) + fraction) / self.every
        return np.asarray(spline_weights(u, self.spacing).mean(axis=0))

    @property
    def cell(self) -> int:
        """Intervals that share their Jacobians: those change slowly."""
        return max(1, int(CELL_S / self.spacing))

    @property
    def cells(self) -> Index:
        """First interval of each cell."""
        return np.arange(0, self.intervals, self.cell)

    def gathered(self) -> "Chunk":
        """The same with all readings in the intervals in which they were taken, by their clocks."""
        imus = []
        for x in self.imus:
            shift = int(np.ceil(x.delay / self.dt - 1e-9))
            at = np.arange(len(x.raw)) * self.stride - shift
            inside = (at >= 0) & (at < self.samples)
            shape = self.intervals * self.every, x.raw.shape[1]
            y, seen = np.zeros(shape), np.zeros(shape, dtype=bool)
            y[at[inside]], seen[at[inside]] = x.raw[inside], x.live[inside]
            if self.every > 1:
                y = y.reshape(-1, self.every, shape[1]).mean(axis=1)
                seen = np.asarray(seen.reshape(-1, self.every, shape[1]).all(axis=1))
            fraction = shift - x.delay / self.dt
            imus.append(replace(x, y=y, seen=seen, fraction=fraction, every=self.every))
        return replace(self, imus=tuple(imus))


def motion_at(chunk: Chunk, c: Array) -> Array:
    """q, dq, ddq (N, 3, n) at the samples."""
    x = sampled(c, chunk.knots.reshape(-1, 4)).reshape(chunk.every, 3, -1, chunk.joints)
    return x.transpose(2, 0, 1, 3).reshape(-1, 3, chunk.joints)[: chunk.samples]


def sampled(c: Array, weights: Array) -> Array:
    """Values (S, M, n) in every interval by weights (S, 4) of its coefficients."""
    return np.tensordot(weights, sliding_window_view(c, 4, axis=0), (1, 2))


def mean_motion(
    chunk: Chunk, c: Array, fraction: float = 0.0, at: Index | None = None
) -> Array:
    """q, dq, ddq (3, n, M) averaged over the samples of every interval, or of those `at` alone."""
    near = sliding_window_view(c, 4, axis=0)
    motion = np.tensordot(
        chunk.mean_knots(fraction), near if at is None else near[at], (1, 2)
    )
    return np.ascontiguousarray(motion.transpose(0, 2, 1))


def jerk_of(c: Array, spacing: float) -> Array:
    """Jerk (M, n) rad/s^3 in every interval."""
    return np.diff(c, 3, axis=0) / spacing**3


def resampled(chunk: Chunk, c: Array, other: Chunk) -> Array:
    """Coefficients of the same cubics on another chunk's knots."""
    h = other.spacing
    t = (np.arange(other.intervals + 3) - 1) * h / chunk.spacing
    k = np.clip(t.astype(int), 0, chunk.intervals - 1)
    weights = spline_weights(t - k, chunk.spacing)
    at = weights[:, 0] - h**2 / 6 * weights[:, 2]
    return np.asarray(np.einsum("ka,kna->kn", at, sliding_window_view(c, 4, axis=0)[k]))
