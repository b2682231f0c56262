"""The basis of a friction surface over position and speed, continued beyond its range.

Over position there are families to choose from (`position_families`), over speed there
are Chebyshev polynomials of |v| or of its logarithm. Beyond a range the basis itself is
continued, so that whatever is made of it stays linear in the coefficients of the
surface.

Beyond the fastest speed v_1 friction goes on as Coulomb plus viscous friction: a line
whose slope is the least-squares slope of the position mean over the upper part of the
speeds. Below the slowest speed the value at the slowest holds.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.position_families import Chebyshev, PositionFamily, scaled
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class Scaling:
    """Position and speed ranges that the basis is made for, and of what kind it is."""

    position: tuple[float, float]  # rad; m where prismatic
    speed: tuple[float, float]  # rad/s; m/s where prismatic
    logarithmic: bool = False
    family: type[PositionFamily] = Chebyshev

    @property
    def over_position(self) -> PositionFamily:
        """The functions of position."""
        return self.family(*self.position)

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

    def sums(self, q: Array, v: Array, entries: Array) -> Array:
        """Sum the products of both bases, continued beyond the ranges, times entries.

        It is what `basis` gives times the entries, without making it.

        Parameters
        ----------
        q, v : Array
            Positions and velocities (N,); of a velocity only the size counts.
        entries : Array
            (size, l + 1, m), of m surfaces.

        Returns
        -------
        Array
            (N, m).
        """
        size, speeds, surfaces = entries.shape
        position_order = self.over_position.order(size)
        over_position = self.over_position.values(q, position_order)
        over_speed = chebvander(self.u(v), speeds - 1)
        by_speed = over_position @ entries.reshape(size, speeds * surfaces)
        by_speed = by_speed.reshape(len(q), speeds, surfaces)
        sums = np.einsum("nlm,nl->nm", by_speed, over_speed)

        # Beyond the fastest speed the line goes on from the value there.
        excess = self.faster(v)
        beyond = np.flatnonzero(excess)
        if beyond.size:
            slope = self.slope(position_order, speeds - 1)
            of_surfaces = slope @ entries.reshape(size * speeds, surfaces)
            sums[beyond] += excess[beyond, None] * of_surfaces
        return np.asarray(sums)

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
