"""The friction surface (Eq. 7-10) on a scaled, orthogonal basis.

With x the position and u the speed |v|, each scaled to [-1, 1] over the identified range and held
at its ends, the friction torque of one joint is

    tau_f(q, v) = s(v) sum_jr d[j, r] T_j(x) T_r(u),      s(v) = tanh(v / v_s),

T_k being Chebyshev polynomials: raw monomials of orders (10, 11) are not usable in floating point.
Where friction depends on direction it has two surfaces f_+ and f_-, one per direction, and

    tau_f = s(v) (f_+ + f_-) / 2 + (f_+ - f_-) / 2:

the part that does not flip with the direction, an offset, stays at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from seqid_cli.params.schema import FrictionJoint

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELLS = 33  # per axis, at which a surface's standard error is looked at
VAGUE = 0.05  # of the friction, from which its standard error leaves it open
SLIDES = 5.0  # sign widths, from which a joint certainly slides: all but 1e-4 of the sign is there
UNUSUAL = 4.0  # times the surface's median standard error, that it must be as well


@dataclass(frozen=True)
class Scaling:
    """Position and speed ranges that the basis is scaled to; outside them the surface is held.

    A `line`, as Coulomb and viscous friction make over speed, is a law: it goes on beyond the
    fastest speed.
    """

    position: tuple[float, float]  # rad
    speed: tuple[float, float]  # rad/s
    logarithmic: bool = False
    line: bool = False

    def x(self, q: Array) -> Array:
        """Scaled position, clipped to [-1, 1]."""
        return _scaled(q, *self.position)

    def u(self, v: Array) -> Array:
        """Scaled speed, clipped to [-1, 1]; of a line from -1 on."""
        if self.line and self.speed[1] > self.speed[0]:
            return 2.0 * (np.abs(v) - self.speed[0]) / (self.speed[1] - self.speed[0]) - 1.0
        speed = np.clip(np.abs(v), *self.speed)
        if self.logarithmic:
            return _scaled(np.log(speed), np.log(self.speed[0]), np.log(self.speed[1]))
        return _scaled(speed, *self.speed)

    def outside(self, q: Array, v: Array, *, sign_width: float) -> Mask:
        """Samples where the surface is held because position or speed left the identified range."""
        margin = 0.02 * (self.position[1] - self.position[0])
        far = (q < self.position[0] - margin) | (q > self.position[1] + margin)
        fast = np.abs(v) > 1.02 * self.speed[1]
        slow = (np.abs(v) < 0.98 * self.speed[0]) & (np.abs(v) > sign_width)
        return far | fast | slow


def _scaled(value: Array, low: float, high: float) -> Array:
    if high <= low:
        return np.zeros_like(value)
    return np.clip((2 * value - low - high) / (high - low), -1.0, 1.0)


@dataclass(frozen=True)
class FrictionSurface:
    """Friction of one joint, ready to evaluate.

    `positive`, `negative` (m + 1, l + 1) N m for either direction; `covariance` of their entries,
    row-major, stacked where `directional`.
    """

    scaling: Scaling
    sign_width: float
    positive: Array
    negative: Array
    covariance: Array
    directional: bool

    @classmethod
    def from_stage(cls, joint: FrictionJoint) -> FrictionSurface:
        """Build from the parameter file."""
        low, high = joint.position_range
        slow, fast = joint.speed_range
        return cls(
            scaling=Scaling(
                (low, high), (slow, fast), joint.speed_scale == "log", line=bool(joint.parameters)
            ),
            sign_width=joint.sign_width,
            positive=np.array(joint.positive),
            negative=np.array(joint.negative),
            covariance=np.array(joint.covariance),
            directional=joint.directional,
        )

    def columns(self, q: Array, v: Array) -> Array:
        """Derivatives (N, k) of the torque by the entries that `covariance` is of."""
        basis = tensor_basis(
            self.scaling.x(q), self.scaling.u(v), *(k - 1 for k in self.positive.shape)
        )
        sign = np.tanh(v / self.sign_width)[:, None]
        if not self.directional:
            return basis * sign
        return np.hstack([basis * (sign + 1) / 2, basis * (sign - 1) / 2])

    def torque(self, q: Array, v: Array) -> Array:
        """Friction torque (N,) N m at positions q (N,) and velocities v (N,)."""
        if self.directional:
            coefficients = np.concatenate([self.positive.ravel(), self.negative.ravel()])
            both: Array = self.columns(q, v) @ coefficients
            return both
        orders = (k - 1 for k in self.positive.shape)
        basis = tensor_basis(self.scaling.x(q), self.scaling.u(v), *orders)
        torque: Array = np.tanh(v / self.sign_width) * (basis @ self.positive.ravel())
        return torque

    def at_rest(self, q: Array) -> tuple[Array, Array]:
        """Smallest and largest torque (N,) N m that friction can hold at rest."""
        v = np.full(len(q), max(self.scaling.speed[0], SLIDES * self.sign_width))
        low, high = self.torque(q, -v), self.torque(q, v)
        return np.minimum(low, high), np.maximum(low, high)

    def outside(self, q: Array, v: Array) -> Mask:
        """Samples (N,) at which the surface is held at the edge of what was identified."""
        return self.scaling.outside(q, v, sign_width=self.sign_width)

    def vague(self, q: Array, v: Array) -> Mask:
        """Samples (N,) at which the surface's own standard error is a clear share of it, and large.

        Inside the ranges that the trials have reached, but in none of them at this speed here.
        """
        scaled = (self.scaling.x(q), np.minimum(self.scaling.u(v), 1.0))
        row, column = (np.rint(0.5 * (z + 1.0) * (CELLS - 1)).astype(np.intp) for z in scaled)
        mask: Mask = self._vague[row, column] & (np.abs(v) > self.sign_width)
        return mask

    @cached_property
    def _vague(self) -> Mask:
        """The same on a grid (CELLS, CELLS) over scaled position and speed."""
        x, u = (z.ravel() for z in np.meshgrid(*2 * [np.linspace(-1.0, 1.0, CELLS)], indexing="ij"))
        basis = tensor_basis(x, u, *(k - 1 for k in self.positive.shape))
        size = self.positive.size
        found = np.zeros(len(x), dtype=bool)
        for number, values in enumerate((self.positive, self.negative)):
            own = slice(number * size, (number + 1) * size) if self.directional else slice(size)
            variance = np.einsum("nk,kl,nl->n", basis, self.covariance[own, own], basis)
            usual = float(np.median(variance))
            clear = variance > (VAGUE * (basis @ values.ravel())) ** 2
            found |= clear & (variance > UNUSUAL**2 * usual)
        return found.reshape(CELLS, CELLS)


def tensor_basis(x: Array, u: Array, position_order: int, velocity_order: int) -> Array:
    """Products T_j(x) T_r(u) (N, (m + 1) (l + 1)), r fastest."""
    product = chebvander(x, position_order)[:, :, None] * chebvander(u, velocity_order)[:, None, :]
    flat: Array = product.reshape(len(x), -1)
    return flat


def friction_torque(surfaces: list[FrictionSurface | None], q: Array, dq: Array) -> Array:
    """Friction torque (N, n) N m; zero for a joint whose friction is not known."""
    columns = [
        np.zeros(len(q)) if surface is None else surface.torque(q[:, j], dq[:, j])
        for j, surface in enumerate(surfaces)
    ]
    return np.stack(columns, axis=1)
