"""What the instruments make of the true motion: counts, noisy amperes, accelerometer
arrays.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from tests import Array
from tests.plants.mechanics.rigid import LinkMotion


@dataclass(frozen=True)
class Faults:
    """What a real sensor adds to noise and a constant bias; standard deviations unless
    said.
    """

    # of what belongs to the instrument; the rest is drawn anew in each log
    seed: int = 0
    bias: float = 0.0
    drift: float = 0.0  # of the bias in a second: m/s^2/sqrt(s) or rad/s/sqrt(s)
    turn_on: float = 0.0  # of the bias from log to log
    scale: float = 0.0  # of the gain
    tilt: float = 0.0  # rad, of each axis about each direction across it
    delay: float = 0.0  # s, by which the IMU's stamps are late against the encoders'
    rate: float = 0.0  # s/s, by which they get later
    spikes: float = 0.0  # share of samples that are wild
    limit: float = np.inf  # where the channels saturate

    def gains(self, count: int) -> Array:
        return 1.0 + self.scale * self._rng(1).standard_normal(count)

    def axes(self, nominal: Array) -> Array:
        """Unit axes as they are, (K, 3)."""
        off = self.tilt * self._rng(2).standard_normal(nominal.shape)
        moved = nominal + (off - np.sum(off * nominal, axis=1, keepdims=True) * nominal)
        return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))

    def biases(self, count: int) -> Array:
        """Bias of each channel on average, (count,)."""
        return self.bias * self._rng(3).standard_normal(count)

    def _rng(self, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, purpose])

    def read(
        self,
        ideal: Array,
        white: float,
        step: float,
        rate_hz: float,
        rng: np.random.Generator,
    ) -> Array:
        """Readings (N, K) of channels that feel `ideal`,
        already along their own axes.
        """
        n, count = ideal.shape
        steps = self.drift / np.sqrt(rate_hz) * rng.standard_normal((n, count))
        offset = self.biases(count) + self.turn_on * rng.standard_normal(count)
        late = delayed(ideal, self.delay, rate_hz, self.rate)
        values = self.gains(count) * late + offset
        values = (
            values + np.cumsum(steps, axis=0) + white * rng.standard_normal((n, count))
        )
        wild = rng.random((n, count)) < self.spikes
        size = 50.0 * max(white, 0.02) * rng.standard_normal((n, count))
        return quantise(np.clip(values + wild * size, -self.limit, self.limit), step)


def delayed(values: Array, delay: float, rate_hz: float, rate: float = 0.0) -> Array:
    """Values (N, K) with the stamps of a clock that is `delay` s late and gains `rate`.

    What happens at t has the stamp t + delay + rate t; the first row lasts before it.
    """
    if delay == 0.0 and rate == 0.0:
        return values
    t = np.arange(len(values)) / rate_hz
    felt = (t - delay) / (1.0 + rate)
    return np.asarray(CubicSpline(t, values)(np.clip(felt, t[0], t[-1])))


@dataclass(frozen=True)
class AccelerometerArray:
    """K single-axis accelerometers on the link after joint `after` (0-based)."""

    name: str
    after: int
    positions: Array  # (K, 3) m, in the array's own frame
    axes: Array  # (K, 3)
    rotation: Array  # (3, 3), R_link_from_imu
    lever: Array  # (3,) m, of the array's frame in the link's
    noise: float = 0.03  # m/s^2, as bias and resolution
    bias: float = 0.0
    resolution: float = 2.0**-7
    faults: Faults | None = None
    gyro_noise: float | None = None  # rad/s; None: no gyro
    gyro_faults: Faults = field(default_factory=Faults)
    gyro_resolution: float = 2.0**-12

    def ideal(self, motion: LinkMotion) -> Array:
        """Specific force along each axis, (N, K) m/s^2."""
        own = self.axes if self.faults is None else self.faults.axes(self.axes)
        points, axes = (
            self.lever + self.positions @ self.rotation.T,
            own @ self.rotation.T,
        )
        omega, alpha = motion.omega[:, None, :], motion.alpha[:, None, :]
        force = motion.force[:, None, :] + np.cross(alpha, points)
        force = force + np.cross(omega, np.cross(omega, points))
        return np.asarray(np.einsum("nkj,kj->nk", force, axes))

    def read(
        self, motion: LinkMotion, rng: np.random.Generator, rate_hz: float = 1000.0
    ) -> Array:
        ideal = self.ideal(motion)
        if self.faults is not None:
            return self.faults.read(ideal, self.noise, self.resolution, rate_hz, rng)
        bias = self.bias * rng.standard_normal(ideal.shape[1])
        noisy = ideal + bias + self.noise * rng.standard_normal(ideal.shape)
        return quantise(noisy, self.resolution)

    def read_gyro(
        self, motion: LinkMotion, rng: np.random.Generator, rate_hz: float
    ) -> Array | None:
        """Angular velocity in the IMU's frame as its gyro reads it, (N, 3) rad/s."""
        if self.gyro_noise is None:
            return None
        ideal = motion.omega @ (self.gyro_faults.axes(np.eye(3)) @ self.rotation.T).T
        return self.gyro_faults.read(
            ideal, self.gyro_noise, self.gyro_resolution, rate_hz, rng
        )


def tetrahedral_array(size: float) -> tuple[Array, Array]:
    """Positions and axes (12, 3) of four triads: at the origin and `size` m along each
    axis.
    """
    corners = size * np.vstack([np.zeros(3), np.eye(3)])
    return np.repeat(corners, 3, axis=0), np.tile(np.eye(3), (4, 1))


def quantise(values: Array, step: Array | float) -> Array:
    """Round to whole steps; a step of zero leaves the value alone."""
    steps = np.atleast_1d(step)
    if min(steps.tolist()) > 0:
        return np.asarray(np.rint(values / steps) * steps)
    unit = np.where(steps > 0, step, 1.0)
    return np.where(steps > 0, np.round(values / unit) * unit, values)


def noise(
    rng: np.random.Generator,
    samples: int,
    std: Array,
    *,
    coloured: float,
    rate_hz: float,
) -> Array:
    """White noise, a share `coloured` of whose variance is spread as 1/f,
    (samples, n).
    """
    white = np.sqrt(1.0 - coloured) * rng.standard_normal((samples, len(std)))
    if coloured == 0.0:
        return np.asarray(white * std)
    corners = 10.0 ** np.arange(-1, np.log10(rate_hz / 8.0))
    total = np.zeros_like(white)
    for pole in np.exp(-2.0 * np.pi * corners / rate_hz).tolist():
        drive = rng.standard_normal(white.shape)
        drive[1:] *= np.sqrt(1.0 - pole**2)
        total += lfilter([1.0], [1.0, -pole], drive, axis=0)
    return np.asarray((white + np.sqrt(coloured / len(corners)) * total) * std)
