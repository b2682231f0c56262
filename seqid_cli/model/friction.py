"""The friction surface (Eq. 7-10) on a scaled, orthogonal basis.

With B_j functions of position, T_r Chebyshev polynomials of the scaled speed u, the
friction torque of one joint is

    tau_f(q, v) = s(v) f(q, |v|),   f = sum_jr d[j, r] B_j(q) T_r(u),   s(v) = tanh(v / v_s).

Raw monomials of orders (10, 11) are not usable in floating point. Where friction
depends on direction it has two surfaces f_+ and f_-, one per direction, and

    tau_f = s(v) (f_+ + f_-) / 2 + (f_+ - f_-) / 2:

the part that does not flip with the direction, an offset, stays at rest.

Outside the identified range the basis is continued (see `friction_basis`). What is not
known there has coefficients of its own, `extension`, four to each direction: below and
above the positions, beyond the fastest speed, below the slowest. Their values are zero,
but for a viscous slope that would be negative: friction does not fall with the speed
for ever, and the third one takes it away. Their variances make the error grow outside:
by the spread of friction over position, by the doubt about the slope, by what friction
changes near the slowest speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from numpy.polynomial.chebyshev import chebval
from scipy.linalg import block_diag

from seqid_cli.model.friction_basis import FADE, Scaling
from seqid_cli.params.schema import FrictionJoint
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Mask

CELLS = 33  # per axis, at which a surface's standard error is looked at
VAGUE = 0.05  # of the friction, from which its standard error leaves it open
# sign widths, from which a joint certainly slides: all but 1e-4 of the sign is there
SLIDES = 5.0
UNUSUAL = 4.0  # times the surface's median standard error, that it must be as well
# independent patches of position in a range
PATCHES = 1.0 / (np.sqrt(2.0 * np.pi) * FADE)
# The mean of few patches is uncertain itself, and the spread about it too small.
NEW_GROUND = float(np.sqrt((PATCHES + 1.0) / (PATCHES - 1.0)))
# the coefficients of the extension of one direction
BELOW, ABOVE, FASTER, SLOWER = range(4)
EXTENSION_SIZE = 4  # their number


class FrictionLaw(Protocol):
    """Friction of one joint as a prediction needs it, whoever states it."""

    @property
    def sign_width(self) -> float:
        """Speed [rad/s; m/s where prismatic] over which the torque changes its sign."""
        ...

    @property
    def per_kelvin(self) -> float:
        """Share by which friction changes per kelvin."""
        ...

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque (N,) N m at positions and velocities (N,)."""
        ...

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) that temperatures make of friction."""
        ...


@dataclass(frozen=True)
class FrictionSurface:
    """Friction of one joint, ready to evaluate.

    `positive`, `negative` (size, l + 1) N m for either direction; `entry_covariance` of
    their entries, row-major, stacked where `directional`; `temperature` degC, `speeds`
    (K,) rad/s and `postures` (n,) rad of the arm at which it was identified. Friction
    changes by a share of `per_kelvin` above that temperature. `even_terms`: what is
    alike both ways is an offset and asymmetries.
    """

    scaling: Scaling
    sign_width: float
    positive: Array
    negative: Array
    entry_covariance: Array
    directional: bool
    temperature: float | None = None
    torque_constant_error: float = 0.0
    speeds: Array = field(default_factory=lambda: np.zeros(0))
    postures: tuple[list[float], ...] = ()
    per_kelvin: float = 0.0
    even_terms: bool = False

    @classmethod
    def from_stage(cls, joint: FrictionJoint) -> Self:
        """Build from the parameter file."""
        (low, high), (slow, fast) = joint.position_range, joint.speed_range
        log, periodic = joint.speed_scale == "log", joint.position_basis == "fourier"
        return cls(
            scaling=Scaling((low, high), (slow, fast), log, periodic),
            sign_width=joint.sign_width,
            positive=np.array(joint.positive),
            negative=np.array(joint.negative),
            entry_covariance=np.array(joint.covariance),
            directional=joint.directional,
            temperature=joint.temperature,
            torque_constant_error=joint.torque_constant_error,
            speeds=np.array([level.speed for level in joint.speeds]),
            postures=tuple(trial.configuration for trial in joint.gravity),
            per_kelvin=sum(t.value for t in joint.nuisances if t.name == "thermal"),
            even_terms=bool(joint.nuisance_covariance),
        )

    def kelvin(self, celsius: Array) -> Array:
        """Return temperatures (N,) above that of the surface, 0 where one is not known."""
        if self.temperature is None:
            return np.zeros(len(celsius))
        return np.where(np.isfinite(celsius), celsius - self.temperature, 0.0)

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) that temperatures make of the surface's friction."""
        return np.asarray(1.0 + self.per_kelvin * self.kelvin(celsius))

    def coulomb(self, q: Array) -> Array:
        """Return twice the Coulomb friction (N,) N m at positions q (N,), the mean of both ways."""
        slow = np.full_like(q, self.scaling.speed[0])
        return np.asarray(self.torque(q, slow) - self.torque(q, -slow))

    def mean_coulomb(self, places: int) -> float:
        """Return the mean of the same over so many places of the identified positions."""
        return float(np.mean(self.coulomb(np.linspace(*self.scaling.position, places))))

    @property
    def orders(self) -> tuple[int, int]:
        """Orders m and l."""
        size, speeds = self.positive.shape
        return self.scaling.over_position.order(size), speeds - 1

    @property
    def entries(self) -> int:
        """Number of entries of the surface, the first of `coefficients`; `extension` follows."""
        return self.positive.size * len(self._sides)

    @cached_property
    def coefficients(self) -> Array:
        """Entries of the surface, one direction after the other, and of its extension (k,)."""
        return np.concatenate(
            [*(side.ravel() for side in self._sides), self.extension.ravel()]
        )

    @cached_property
    def extension(self) -> Array:
        """Coefficients (directions, 4) outside the identified range: N m, slope N m s/rad."""
        found = np.zeros((len(self._sides), 4))
        found[:, FASTER] = np.maximum(-self.slopes, 0.0)
        return found

    @cached_property
    def covariance(self) -> Array:
        """Covariance (k, k) of `coefficients`; as in the file if that one has another size."""
        size = self.entries
        if self.entry_covariance.shape != (size, size):
            return self.entry_covariance
        errors = np.concatenate(list(map(self._errors_of, self._sides, self.slopes)))
        return np.asarray(block_diag(self.entry_covariance, np.diag(errors**2)))

    def columns(self, q: Array, v: Array) -> Array:
        """Derivatives (N, k) of the torque by `coefficients`, in which it is linear."""
        basis = self.scaling.basis(q, v, *self.orders)
        extension = self._extension(q, v)
        sign = np.tanh(v / self.sign_width)[:, None]
        if not self.directional:
            return np.hstack([basis * sign, extension * sign])
        # how much of either direction's surface counts, times two
        ways = sign + 1.0, sign - 1.0
        return np.hstack(
            [part * way / 2 for part in (basis, extension) for way in ways]
        )

    def torque(self, q: Array, v: Array) -> Array:
        """Friction torque (N,) N m at positions q (N,) and velocities v (N,)."""
        result = np.empty(len(q))
        for part in tiles(len(q)):
            at = q[part], v[part]
            if self.directional:
                result[part] = self.columns(*at) @ self.coefficients
                continue
            level = self.scaling.basis(*at, *self.orders) @ self.positive.ravel()
            if self.extension.any():
                level = level + self._extension(*at) @ self.extension[0]
            result[part] = np.tanh(v[part] / self.sign_width) * level
        return result

    def odd_torque(self, q: Array, v: Array) -> Array:
        """Friction torque (N,) N m that turns with the direction of motion."""
        if not self.directional:
            return self.torque(q, v)
        return np.asarray((self.torque(q, v) - self.torque(q, -v)) / 2.0)

    def of_size(self, entries: Array) -> Self:
        """Return a surface of other entries whose torque is the same for both directions."""
        covariance = np.zeros((2 * entries.size, 2 * entries.size))
        return replace(
            self,
            positive=entries,
            negative=-entries,
            entry_covariance=covariance,
            directional=True,
        )

    def error_columns(self, q: Array, v: Array) -> Array:
        """Derivatives (N, k) of the torque by `coefficients`, but for terms of the drive.

        What is alike both ways is an offset and asymmetries with errors of their own,
        where the surface was identified with them: the errors of its coefficients are
        then those of its odd part.
        """
        if not self.even_terms:
            return self.columns(q, v)
        return np.asarray((self.columns(q, v) - self.columns(q, -v)) / 2.0)

    def std_error(self, q: Array, v: Array) -> Array:
        """Standard error (N,) N m of `torque`; zero where the file gives no covariance."""
        X = self.columns(q, v)
        if self.covariance.shape != (X.shape[1], X.shape[1]):
            return np.zeros(len(q))
        variance = np.einsum("nk,kl,nl->n", X, self.covariance, X, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def stated_error(self, q: Array, v: Array) -> Array:
        """Standard error (N,) N m of the physical torque: with that of the torque constant."""
        common = self.torque_constant_error * self.torque(q, v)
        return np.asarray(np.hypot(self.std_error(q, v), common))

    def at_rest(self, q: Array) -> tuple[Array, Array]:
        """Smallest and largest torque (N,) N m that friction can hold at rest."""
        v = np.full(len(q), max(self.scaling.speed[0], SLIDES * self.sign_width))
        low, high = self.torque(q, -v), self.torque(q, v)
        return np.minimum(low, high), np.maximum(low, high)

    def outside(self, q: Array, v: Array) -> Mask:
        """Samples (N,) at which the surface goes on beyond what was identified."""
        return self.scaling.outside(q, v, sign_width=self.sign_width)

    def vague(self, q: Array, v: Array) -> Mask:
        """Samples (N,) at which the surface's own standard error is a clear share of it, and large.

        Inside the ranges that the trials have reached, but in none of them at this
        speed here.
        """
        shares = (self.scaling.over_position.share(q), 0.5 * (self.scaling.u(v) + 1.0))
        row, column = (np.rint(share * (CELLS - 1)).astype(np.intp) for share in shares)
        return np.asarray(self._vague[row, column] & (np.abs(v) > self.sign_width))

    @cached_property
    def _vague(self) -> Mask:
        """The same on a grid (CELLS, CELLS) over position and scaled speed."""
        basis, size = self._grid, self.positive.size
        found = np.zeros(len(basis), dtype=bool)
        for number, values in enumerate(self._sides):
            own = slice(number * size, (number + 1) * size)
            variance = np.einsum(
                "nk,kl,nl->n", basis, self.entry_covariance[own, own], basis
            )
            clear = variance > (VAGUE * (basis @ values.ravel())) ** 2
            found |= clear & (variance > UNUSUAL**2 * np.median(variance))
        return found.reshape(CELLS, CELLS)

    @cached_property
    def _grid(self) -> Array:
        """Basis (CELLS^2, size (l + 1)) over position and scaled speed, speed fastest."""
        share, (slow, fast) = np.linspace(0.0, 1.0, CELLS), self.scaling.speed
        speeds = np.linspace(slow, fast, CELLS)
        if self.scaling.logarithmic:
            speeds = np.exp(np.linspace(np.log(slow), np.log(fast), CELLS))
        q, v = np.meshgrid(self.scaling.over_position.at(share), speeds, indexing="ij")
        return self.scaling.basis(q.ravel(), v.ravel(), *self.orders)

    @property
    def _sides(self) -> tuple[Array, ...]:
        return (self.positive, self.negative) if self.directional else (self.positive,)

    @cached_property
    def slopes(self) -> Array:
        """Viscous slope of each direction's surface, N m s/rad, of either sign."""
        return np.array(
            [self.scaling.slope(*self.orders) @ side.ravel() for side in self._sides]
        )

    def _extension(self, q: Array, v: Array) -> Array:
        """Columns (N, 4) of the extension of one direction, without its sign."""
        speeds = np.stack([self.scaling.faster(v), self.scaling.slower(v)], axis=1)
        return np.hstack([self.scaling.over_position.novelty(q), speeds])

    def _errors_of(
        self, side: Array, slope: float, *, slope_doubt: float = 0.3
    ) -> Array:
        """Standard errors (4,) of the extension of one direction's surface of a viscous slope."""
        # Spread over position, twice; doubt about the slope; change near the slowest
        # speed.
        level = (self._grid @ side.ravel()).reshape(CELLS, CELLS)
        spread = NEW_GROUND * float(np.sqrt(np.mean((level - level.mean(axis=0)) ** 2)))
        over_speed = self.scaling.over_position.mean(self.orders[0]) @ side
        line = self.scaling.slope_speeds()
        width = float(np.ptp(line))
        bend = float(np.std(chebval(self.scaling.u(line), over_speed) - slope * line))
        doubt = float(np.hypot(slope_doubt * slope, bend / width)) if width else 0.0
        slow, fast = self.scaling.speed
        near = np.array([slow, min(np.e * slow, fast)])
        change = float(np.ptp(chebval(self.scaling.u(near), over_speed)))
        return np.array([spread, spread, doubt, change])


def friction_torque(laws: Sequence[FrictionLaw | None], q: Array, dq: Array) -> Array:
    """Friction torque (N, n) N m; zero for a joint whose friction is not known."""
    torque = np.zeros(q.shape)
    for j, law in enumerate(laws):
        if law is not None:
            torque[:, j] = law.torque(q[:, j], dq[:, j])
    return torque
