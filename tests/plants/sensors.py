"""What the instruments make of the true motion: counts, noisy amperes, accelerometer arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.plants.rigid import LinkMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AccelerometerArray:
    """K single-axis accelerometers on the link after joint `after` (0-based).

    `positions` (K, 3) m and `axes` (K, 3) in the array's own frame, which sits at `lever` (3,) m
    in the link frame, turned by `rotation` (3, 3) = R_link_from_imu. Noise, bias and resolution in
    m/s^2.
    """

    name: str
    after: int
    positions: Array
    axes: Array
    rotation: Array
    lever: Array
    noise: float = 0.03
    bias: float = 0.0
    resolution: float = 2.0**-7

    def ideal(self, motion: LinkMotion) -> Array:
        """Specific force along each axis, (N, K) m/s^2."""
        points = self.lever + self.positions @ self.rotation.T
        axes = self.axes @ self.rotation.T
        omega, alpha = motion.omega[:, None, :], motion.alpha[:, None, :]
        force = motion.force[:, None, :] + np.cross(alpha, points)
        force = force + np.cross(omega, np.cross(omega, points))
        return np.asarray(np.einsum("nkj,kj->nk", force, axes))

    def read(self, motion: LinkMotion, rng: np.random.Generator) -> Array:
        """Return readings with bias, white noise and resolution, (N, K) m/s^2."""
        ideal = self.ideal(motion)
        bias = self.bias * rng.standard_normal(ideal.shape[1])
        noisy = ideal + bias + self.noise * rng.standard_normal(ideal.shape)
        return quantise(noisy, self.resolution)


def tetrahedral_array(size: float) -> tuple[Array, Array]:
    """Positions and axes (12, 3) of four triads: at the origin and `size` m along each axis."""
    corners = size * np.vstack([np.zeros(3), np.eye(3)])
    return np.repeat(corners, 3, axis=0), np.tile(np.eye(3), (4, 1))


def quantise(values: Array, step: Array | float) -> Array:
    """Round to whole steps; a step of zero leaves the value alone."""
    steps = np.asarray(step)
    if steps.min() > 0:
        return np.asarray(np.round(values / steps) * steps)
    unit = np.where(steps > 0, step, 1.0)
    return np.where(steps > 0, np.round(values / unit) * unit, values)


def noise(
    rng: np.random.Generator, samples: int, std: Array, *, coloured: float, rate_hz: float
) -> Array:
    """White noise, a share `coloured` of whose variance is spread as 1/f, (samples, n).

    The coloured part is a sum of first-order processes whose corners are a decade apart.
    """
    white = np.sqrt(1.0 - coloured) * rng.standard_normal((samples, len(std)))
    if coloured == 0.0:
        return np.asarray(white * std)
    corners = 10.0 ** np.arange(-1, np.log10(rate_hz / 8.0))
    total = np.zeros_like(white)
    for corner in corners:
        pole = float(np.exp(-2.0 * np.pi * corner / rate_hz))
        total += _first_order(rng.standard_normal(white.shape), pole)
    return np.asarray((white + np.sqrt(coloured / len(corners)) * total) * std)


def _first_order(drive: Array, pole: float) -> Array:
    """Unit-variance first-order process driven by white noise."""
    scaled = np.sqrt(1.0 - pole**2) * drive
    scaled[0] = drive[0]
    return np.asarray(lfilter([1.0], [1.0, -pole], scaled, axis=0))
