"""The bases of a friction surface over position and speed, and how they go on beyond their range.

Over position there are two kinds. A polynomial in Chebyshev's form knows one range. A
Fourier series knows every angle, so it serves joints that turn more than once. Over
speed there are Chebyshev polynomials of |v| or of its logarithm.

Beyond a range the basis itself is continued, so that whatever is made of it stays
linear in the coefficients of the surface. With f_0 the mean over position and d the
distance from the range, a polynomial falls back to that mean as a random field of
Gaussian correlation would on average:

    f(q) = f_0 + rho (f(edge) - f_0),   rho = exp(-d^2 / (2 delta^2)),   delta = `FADE` * range.

Beyond the fastest speed v_1 friction goes on as Coulomb plus viscous friction: a line
whose slope is the least-squares slope of the position mean over the upper part of the
speeds. Below the slowest speed the value at the slowest holds.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.typing import Array, Mask

FADE = 0.1  # of the position range: the distance over which a surface forgets its edge


@dataclass(frozen=True)
class Polynomial:
    """Chebyshev polynomials over [low, high] rad (m where prismatic)."""

    low: float
    high: float

    def size(self, order: int) -> int:
        """Return the number of polynomials."""
        return order + 1

    def order(self, size: int) -> int:
        """Return the highest degree."""
        return size - 1

    def values(self, q: Array, order: int) -> Array:
        """Return T_0 ...

        T_order (N, order + 1); beyond the range they fade to their means.
        """
        found = np.asarray(
            chebvander(scaled(q, self.low, self.high), order), dtype=np.float64
        )
        gone = 1.0 - self._kept(q)
        far = np.flatnonzero(gone)
        if far.size:
            found[far] += gone[far, None] * (self.mean(order) - found[far])
        return found

    def degrees(self, order: int) -> Array:
        """Return 0 ... order: how fast each function varies."""
        return np.arange(order + 1.0)

    def mean(self, order: int) -> Array:
        """Return the integrals of T_j over [-1, 1] by 2: 1 / (1 - j^2), and 0 for odd j."""
        j = np.arange(order + 1.0)
        return np.where(j % 2 == 0.0, 1.0 / np.where(j == 1.0, 1.0, 1.0 - j**2), 0.0)

    def novelty(self, q: Array) -> Array:
        """Return (N, 2): sqrt(1 - rho^2) below and above the range, 0 inside."""
        new = np.sqrt(1.0 - self._kept(q) ** 2)
        return np.stack(
            [np.where(q < self.low, new, 0.0), np.where(q > self.high, new, 0.0)], 1
        )

    def outside(self, q: Array, *, outside_position: float = 0.02) -> Mask:
        """Return where positions left the range by more than `outside_position` of it."""
        return self._distance(q) > outside_position * (self.high - self.low)

    def share(self, q: Array) -> Array:
        """Return the share of the range, held at its ends."""
        return 0.5 * (scaled(q, self.low, self.high) + 1.0)

    def at(self, share: Array) -> Array:
        """Return positions from shares."""
        return self.low + share * (self.high - self.low)

    def _distance(self, q: Array) -> Array:
        return np.maximum(np.maximum(self.low - q, q - self.high), 0.0)

    def _kept(self, q: Array) -> Array:
        """Correlation rho (N,) with the edge of the range; 1 inside."""
        if self.high <= self.low:
            return np.ones_like(q)
        return np.asarray(
            np.exp(-0.5 * (self._distance(q) / (FADE * (self.high - self.low))) ** 2)
        )


@dataclass(frozen=True)
class Fourier:
    """1, cos q, sin q, cos 2q, ...: friction that repeats with every turn of the joint."""

    def size(self, order: int) -> int:
        """Return the number of functions: the mean and two per harmonic."""
        return 2 * order + 1

    def order(self, size: int) -> int:
        """Return the highest harmonic."""
        return size // 2

    def values(self, q: Array, order: int) -> Array:
        """Return the functions (N, 2 order + 1) at any position."""
        angle = np.outer(q, np.arange(1, order + 1))
        found = np.ones((len(q), 2 * order + 1))
        found[:, 1::2], found[:, 2::2] = np.cos(angle), np.sin(angle)
        return found

    def degrees(self, order: int) -> Array:
        """Return twice the harmonic: T_2k has k waves over its range, as harmonic k over a turn."""
        return np.asarray(2.0 * np.ceil(np.arange(2 * order + 1) / 2.0))

    def mean(self, order: int) -> Array:
        """Return 1 for the constant, 0 for the waves."""
        return np.asarray(np.eye(1, 2 * order + 1)[0])

    def novelty(self, q: Array) -> Array:
        """Return zeros: every angle is known."""
        return np.zeros((len(q), 2))

    def outside(self, q: Array) -> Mask:
        """Return False: every angle is known."""
        return np.zeros(len(q), dtype=np.bool_)

    def share(self, q: Array) -> Array:
        """Return the share of a turn."""
        return np.mod(q / (2.0 * np.pi), 1.0)

    def at(self, share: Array) -> Array:
        """Return angles from shares of a turn."""
        return 2.0 * np.pi * share


# An order is the highest degree of a polynomial, the highest harmonic of a Fourier
# series.
PositionBasis = Polynomial | Fourier


@dataclass(frozen=True)
class Scaling:
    """Position and speed ranges that the basis is made for, and of what kind it is."""

    position: tuple[float, float]  # rad; m where prismatic
    speed: tuple[float, float]  # rad/s; m/s where prismatic
    logarithmic: bool = False
    periodic: bool = False

    @property
    def over_position(self) -> PositionBasis:
        """The functions of position."""
        return Fourier() if self.periodic else Polynomial(*self.position)

    def u(self, v: Array) -> Array:
        """Return the scaled speed (N,), held in [-1, 1]."""
        speed = np.clip(np.abs(v), *self.speed)
        if self.logarithmic:
            return scaled(np.log(speed), np.log(self.speed[0]), np.log(self.speed[1]))
        return scaled(speed, *self.speed)

    def basis(
        self, q: Array, v: Array, position_order: int, velocity_order: int
    ) -> Array:
        """Return products (N, size (l + 1)) of both bases at q, v (N,), r fastest, beyond as well.

        Orders are m and l; of v only the size counts.
        """
        X = self.over_position.values(q, position_order)
        found = tensor(
            X, np.asarray(chebvander(self.u(v), velocity_order), dtype=np.float64)
        )
        faster = self.faster(v)
        fast = np.flatnonzero(faster)
        if fast.size:
            found[fast] += faster[fast, None] * self.slope(
                position_order, velocity_order
            )
        return found

    def faster(self, v: Array) -> Array:
        """Return by how much speeds (N,) are above the fastest identified one, rad/s."""
        return np.maximum(np.abs(v) - self.speed[1], 0.0)

    def slower(self, v: Array) -> Array:
        """Return by what share speeds (N,) are below the slowest identified one."""
        if self.speed[0] <= 0.0:
            return np.zeros_like(v)
        return np.maximum(1.0 - np.abs(v) / self.speed[0], 0.0)

    def slope(self, position_order: int, velocity_order: int) -> Array:
        """Return the weights of the coefficients in the viscous slope beyond, N m s/rad."""
        mean = self.over_position.mean(position_order)
        return np.outer(mean, _slope_over_speed(self, velocity_order)).ravel()

    def slope_speeds(self, *, slope_from: float = 0.5, points: int = 33) -> Array:
        """Return the speeds over which the line beyond the fastest speed is fitted, rad/s."""
        slow, fast = self.speed
        return np.linspace(max(slow, slope_from * fast), fast, points)

    def outside(
        self, q: Array, v: Array, *, sign_width: float, outside_speed: float = 0.02
    ) -> Mask:
        """Return where position or speed left the identified range; rest has no friction law."""
        fast = np.abs(v) > (1.0 + outside_speed) * self.speed[1]
        slow = (np.abs(v) < (1.0 - outside_speed) * self.speed[0]) & (
            np.abs(v) > sign_width
        )
        return self.over_position.outside(q) | fast | slow


@lru_cache(maxsize=256)
def _slope_over_speed(scaling: Scaling, order: int) -> Array:
    """Least-squares slope of T_0 ...

    T_order (order + 1,) over the speeds of the line.
    """
    speeds = scaling.slope_speeds()
    off = speeds - speeds.mean()
    power = float(off @ off)
    if power == 0.0:
        return np.zeros(order + 1)
    slope: Array = off @ chebvander(scaling.u(speeds), order) / power
    slope.flags.writeable = False
    return slope


def tensor(over_position: Array, over_speed: Array) -> Array:
    """Return the products (N, a b) of functions (N, a) and (N, b), the second fastest."""
    product = over_position[:, :, None] * over_speed[:, None, :]
    return np.asarray(product.reshape(len(over_position), -1))


def scaled(value: Array, low: float, high: float) -> Array:
    """Return values (N,) scaled from [low, high] to [-1, 1] and held there."""
    if high <= low:
        return np.zeros_like(value)
    return np.clip((2 * value - low - high) / (high - low), -1.0, 1.0)
