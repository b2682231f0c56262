"""Bases of a friction surface over position and speed, continued beyond their range.

Over position there are two kinds. A polynomial in Chebyshev's form knows one range. A
Fourier series knows every angle, so it serves joints that turn more than once. Over
speed there are Chebyshev polynomials of |v| or of its logarithm.

Beyond a range the basis itself is continued, so that whatever is made of it stays
linear in the coefficients of the surface. With f_0 the mean over position and d the
distance from the range, a polynomial falls back to that mean as a random field of
Gaussian correlation would on average:

    f(q) = f_0 + rho (f(edge) - f_0),   rho = exp(-d^2 / (2 delta^2)),

delta being `FADE` of the range.

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
        """Compute T_0 to T_order (N, order + 1), which fade to their means outside."""
        x = scaled(q, self.low, self.high)
        values = np.asarray(chebvander(x, order), dtype=np.float64)
        faded = 1.0 - self._correlation(q)
        beyond = np.flatnonzero(faded)
        if beyond.size:
            to_mean = self.mean(order) - values[beyond]
            values[beyond] += faded[beyond, None] * to_mean
        return values

    def degrees(self, order: int) -> Array:
        """Return 0 to `order`: how fast each function varies."""
        return np.arange(order + 1.0)

    def mean(self, order: int) -> Array:
        """Return the mean of T_j over [-1, 1]: 1 / (1 - j^2), and 0 for odd j."""
        j = np.arange(order + 1.0)
        is_even = j % 2 == 0.0
        divisor = np.where(j == 1.0, 1.0, 1.0 - j**2)  # not zero
        return np.where(is_even, 1.0 / divisor, 0.0)

    def novelty(self, q: Array) -> Array:
        """Return (N, 2): sqrt(1 - rho^2) below and above the range, 0 inside."""
        novelty = np.sqrt(1.0 - self._correlation(q) ** 2)
        below = np.where(q < self.low, novelty, 0.0)
        above = np.where(q > self.high, novelty, 0.0)
        return np.stack([below, above], axis=1)

    def outside(self, q: Array, *, outside_position: float = 0.02) -> Mask:
        """Return where positions left the range by a share of `outside_position`."""
        return self._distance(q) > outside_position * (self.high - self.low)

    def share(self, q: Array) -> Array:
        """Return the share of the range, held at its ends."""
        return 0.5 * (scaled(q, self.low, self.high) + 1.0)

    def at(self, share: Array) -> Array:
        """Return positions from shares."""
        return self.low + share * (self.high - self.low)

    def _distance(self, q: Array) -> Array:
        """Return the distance d (N,) from the range; 0 inside."""
        return np.maximum(np.maximum(self.low - q, q - self.high), 0.0)

    def _correlation(self, q: Array) -> Array:
        """Return the correlation rho (N,) with the edge of the range; 1 inside."""
        if self.high <= self.low:
            return np.ones_like(q)
        delta = FADE * (self.high - self.low)
        return np.asarray(np.exp(-0.5 * (self._distance(q) / delta) ** 2))


@dataclass(frozen=True)
class Fourier:
    """1, cos q, sin q, cos 2q, ...: friction that repeats with every turn."""

    def size(self, order: int) -> int:
        """Return the number of functions: the mean and two per harmonic."""
        return 2 * order + 1

    def order(self, size: int) -> int:
        """Return the highest harmonic."""
        return size // 2

    def values(self, q: Array, order: int) -> Array:
        """Return the functions (N, 2 order + 1) at any position."""
        angle = np.outer(q, np.arange(1, order + 1))
        values = np.ones((len(q), 2 * order + 1))
        values[:, 1::2] = np.cos(angle)
        values[:, 2::2] = np.sin(angle)
        return values

    def degrees(self, order: int) -> Array:
        """Return twice the harmonic: T_2k has k waves over its range, as harmonic k."""
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


# An order is the highest degree of a polynomial, or the highest harmonic of a series.
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
        """Compute the products of both bases, continued beyond the ranges.

        Parameters
        ----------
        q, v : Array
            Positions and velocities (N,); of a velocity only the size counts.
        position_order, velocity_order : int
            m and l.

        Returns
        -------
        Array
            (N, size (l + 1)), the speed's functions fastest.
        """
        over_position = self.over_position.values(q, position_order)
        over_speed = chebvander(self.u(v), velocity_order)
        products = tensor(over_position, np.asarray(over_speed, dtype=np.float64))

        # Beyond the fastest speed the line goes on from the value there.
        excess = self.faster(v)
        beyond = np.flatnonzero(excess)
        if beyond.size:
            slope = self.slope(position_order, velocity_order)
            products[beyond] += excess[beyond, None] * slope
        return products

    def faster(self, v: Array) -> Array:
        """Return by how much speeds (N,) exceed the fastest identified one, rad/s."""
        return np.maximum(np.abs(v) - self.speed[1], 0.0)

    def slower(self, v: Array) -> Array:
        """Return by what share speeds (N,) are below the slowest identified one."""
        if self.speed[0] <= 0.0:
            return np.zeros_like(v)
        return np.maximum(1.0 - np.abs(v) / self.speed[0], 0.0)

    def slope(self, position_order: int, velocity_order: int) -> Array:
        """Return the weights of the coefficients in the viscous slope beyond."""
        mean = self.over_position.mean(position_order)
        return np.outer(mean, _slope_over_speed(self, velocity_order)).ravel()

    def slope_speeds(self, *, slope_from: float = 0.5, points: int = 33) -> Array:
        """Return the speeds rad/s that the line beyond the fastest is fitted over."""
        slow, fast = self.speed
        return np.linspace(max(slow, slope_from * fast), fast, points)

    def outside(
        self, q: Array, v: Array, *, sign_width: float, outside_speed: float = 0.02
    ) -> Mask:
        """Return where (N,) position or speed left the identified range.

        Rest is no such place: below `sign_width` friction follows no law.
        """
        speed = np.abs(v)
        too_fast = speed > (1.0 + outside_speed) * self.speed[1]
        too_slow = speed < (1.0 - outside_speed) * self.speed[0]
        slides = speed > sign_width
        return self.over_position.outside(q) | too_fast | (too_slow & slides)


@lru_cache(maxsize=256)
def _slope_over_speed(scaling: Scaling, order: int) -> Array:
    """Return least-squares slopes (order + 1,) of T_0 to T_order over the line."""
    speeds = scaling.slope_speeds()
    centred = speeds - speeds.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return np.zeros(order + 1)
    slope: Array = centred @ chebvander(scaling.u(speeds), order) / power
    slope.flags.writeable = False  # it is shared by all callers
    return slope


def tensor(over_position: Array, over_speed: Array) -> Array:
    """Return products (N, a b) of functions (N, a) and (N, b), the second fastest."""
    product = over_position[:, :, None] * over_speed[:, None, :]
    return np.asarray(product.reshape(len(over_position), -1))


def scaled(value: Array, low: float, high: float) -> Array:
    """Return values (N,) scaled from [low, high] to [-1, 1] and held there."""
    if high <= low:
        return np.zeros_like(value)
    return np.clip((2 * value - low - high) / (high - low), -1.0, 1.0)
