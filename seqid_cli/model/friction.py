"""The friction surface (Eq. 7-10) on a scaled, orthogonal basis.

With B_j functions of position, T_r Chebyshev polynomials of the scaled speed u, the
friction torque of one joint is

    tau_f(q, v) = s(v) f(q, |v|),
    f = sum_jr d[j, r] B_j(q) T_r(u),   s(v) = tanh(v / v_s).

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

from seqid_cli.matrices import block_diagonal
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import FrictionJoint
from seqid_cli.position_families import FADE, family_named
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Mask

CELLS = 33  # per axis, at which a surface's standard error is looked at
VAGUE = 0.05  # share of the friction from which its standard error leaves it open
# Times the surface's median standard error that a vague one must be as well.
UNUSUAL = 4.0
# Sign widths from which a joint certainly slides: all but 1e-4 of the sign is there.
SLIDES = 5.0
# Independent patches of position in a range.
PATCHES = 1.0 / (np.sqrt(2.0 * np.pi) * FADE)
# The mean of few patches is uncertain itself, and the spread about it too small.
NEW_GROUND = float(np.sqrt((PATCHES + 1.0) / (PATCHES - 1.0)))
# The coefficients of the extension of one direction, and their number.
BELOW = 0
ABOVE = 1
FASTER = 2
SLOWER = 3
EXTENSION_SIZE = 4


@dataclass(frozen=True)
class IdentifiedRange:
    """Positions and speeds within which a joint's friction was identified.

    Attributes
    ----------
    scaling : Scaling
        It holds both ranges.
    sign_width : float
        Speed [rad/s; m/s where prismatic] below which friction follows no law.
    """

    scaling: Scaling
    sign_width: float

    def outside(self, q: Array, v: Array) -> Mask:
        """Return samples (N,) beyond the positions or the speeds."""
        return self.scaling.outside(q, v, sign_width=self.sign_width)


class FrictionLaw(Protocol):
    """Friction of one joint as a prediction needs it."""

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


@dataclass(frozen=True, kw_only=True)
class FrictionSurface:
    """Friction of one joint, ready to evaluate.

    Attributes
    ----------
    scaling : Scaling
        Identified ranges, and the basis over them.
    sign_width : float
        v_s [rad/s; m/s where prismatic].
    positive, negative : Array
        d of either direction, (size, l + 1) N m.
    entry_covariance : Array
        Of their entries, row-major, both directions stacked where `directional`.
    directional : bool
        Whether both directions have a surface of their own.
    temperature : float, optional
        At which it was identified [degC].
    torque_constant_error : float
        Relative standard error of the torque constant [-].
    law_error : float
        Standard error of the law itself [N m], which the same entries cannot mend.
    speeds : Array
        (K,) rad/s at which it was identified.
    postures : tuple of list of float
        Postures (n,) rad of the arm at which it was identified.
    per_kelvin : float
        Share by which friction changes per kelvin above `temperature`.
    even_terms : bool
        Whether it was identified with terms for what is the same both ways: an offset
        and asymmetries.
    """

    scaling: Scaling
    sign_width: float
    positive: Array
    negative: Array
    entry_covariance: Array
    directional: bool
    temperature: float | None = None
    torque_constant_error: float = 0.0
    law_error: float = 0.0
    speeds: Array = field(default_factory=lambda: np.zeros(0))
    postures: tuple[list[float], ...] = ()
    per_kelvin: float = 0.0
    even_terms: bool = False

    @classmethod
    def from_stage(cls, joint: FrictionJoint) -> Self:
        """Build from the parameter file.

        Entries of a surface that states no errors are taken as exact.
        """
        low, high = joint.position_range
        slow, fast = joint.speed_range
        family = family_named(joint.position_basis)
        assert family is not None  # files of other names are refused as they are read
        scaling = Scaling(
            position=(low, high),
            speed=(slow, fast),
            logarithmic=joint.speed_scale == "log",
            family=family,
        )
        thermal = [term.value for term in joint.nuisances if term.name == "thermal"]
        positive = np.array(joint.positive)
        n_entries = positive.size * (2 if joint.directional else 1)
        covariance = np.array(joint.covariance)
        if covariance.shape != (n_entries, n_entries):
            covariance = np.zeros((n_entries, n_entries))
        return cls(
            scaling=scaling,
            sign_width=joint.sign_width,
            positive=positive,
            negative=np.array(joint.negative),
            entry_covariance=covariance,
            directional=joint.directional,
            temperature=joint.temperature,
            torque_constant_error=joint.torque_constant_error,
            law_error=joint.law_error,
            speeds=np.array([level.speed for level in joint.speeds]),
            postures=tuple(trial.configuration for trial in joint.gravity),
            per_kelvin=sum(thermal),
            even_terms=bool(joint.nuisance_covariance),
        )

    def kelvin(self, celsius: Array) -> Array:
        """Return temperatures (N,) K above the surface's, 0 where one is not known."""
        if self.temperature is None:
            return np.zeros(len(celsius))
        return np.where(np.isfinite(celsius), celsius - self.temperature, 0.0)

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) that temperatures make of the surface's friction."""
        return np.asarray(1.0 + self.per_kelvin * self.kelvin(celsius))

    def coulomb(self, q: Array) -> Array:
        """Return twice the Coulomb friction (N,) N m at positions q (N,).

        It is the mean of both directions.
        """
        slow = np.full_like(q, self.scaling.speed[0])
        return np.asarray(self.torque(q, slow) - self.torque(q, -slow))

    def mean_coulomb(self, places: int) -> float:
        """Return the mean of `coulomb` over so many identified positions."""
        q = np.linspace(*self.scaling.position, places)
        return float(np.mean(self.coulomb(q)))

    @property
    def orders(self) -> tuple[int, int]:
        """Orders m and l."""
        size, speeds = self.positive.shape
        return self.scaling.over_position.order(size), speeds - 1

    @property
    def entries(self) -> int:
        """Number of the surface's entries, the first of `coefficients`."""
        return self.positive.size * len(self._sides)

    @property
    def below_slowest(self) -> list[int]:
        """Which of `coefficients` stand for friction below the slowest speed."""
        if self.scaling.speed[0] <= 0.0:
            return []
        sides = range(len(self._sides))
        return [self.entries + EXTENSION_SIZE * side + SLOWER for side in sides]

    @cached_property
    def coefficients(self) -> Array:
        """Entries of the surface, direction by direction, then its extension (k,)."""
        sides = [side.ravel() for side in self._sides]
        return np.concatenate([*sides, self.extension.ravel()])

    @cached_property
    def extension(self) -> Array:
        """Coefficients (directions, 4) outside the identified range.

        In N m; the one beyond the fastest speed is a slope, N m s/rad.
        """
        extension = np.zeros((len(self._sides), EXTENSION_SIZE))
        extension[:, FASTER] = np.maximum(-self.slopes, 0.0)
        return extension

    @cached_property
    def covariance(self) -> Array:
        """Covariance (k, k) of `coefficients`."""
        errors = np.concatenate(
            [
                self._errors_of(side, slope)
                for side, slope in zip(self._sides, self.slopes, strict=True)
            ]
        )
        return block_diagonal(self.entry_covariance, np.diag(errors**2))

    def columns(self, q: Array, v: Array) -> Array:
        """Compute the derivatives of the torque by `coefficients`.

        Parameters
        ----------
        q, v : Array
            Positions and velocities (N,) [rad, rad/s].

        Returns
        -------
        Array
            (N, k).
        """
        basis = self.scaling.basis(q, v, *self.orders)
        extension = self.outside_columns(q, v)
        sign = np.tanh(v / self.sign_width)[:, None]
        if not self.directional:
            return np.hstack([basis * sign, extension * sign])

        # How much of either direction's surface counts, times two.
        forward = sign + 1.0
        backward = sign - 1.0
        return np.hstack(
            [
                basis * forward / 2,
                basis * backward / 2,
                extension * forward / 2,
                extension * backward / 2,
            ]
        )

    def torque(self, q: Array, v: Array) -> Array:
        """Compute the friction torque.

        Parameters
        ----------
        q, v : Array
            Positions and velocities (N,) [rad, rad/s].

        Returns
        -------
        Array
            (N,) N m.
        """
        return self._alone.torque(q, v)[:, 0]

    @cached_property
    def _alone(self) -> "FrictionFamily":
        return FrictionFamily((self,))

    def odd_torque(self, q: Array, v: Array) -> Array:
        """Compute the friction torque (N,) N m that turns with the direction."""
        if not self.directional:
            return self.torque(q, v)
        return np.asarray((self.torque(q, v) - self.torque(q, -v)) / 2.0)

    def of_size(self, entries: Array) -> Self:
        """Return a surface of other entries whose torque is the same both ways."""
        covariance = np.zeros((2 * entries.size, 2 * entries.size))
        return replace(
            self,
            positive=entries,
            negative=-entries,
            entry_covariance=covariance,
            directional=True,
        )

    def error_columns(self, q: Array, v: Array) -> Array:
        """Compute the derivatives (N, k) that errors of `coefficients` go through.

        A surface that was identified with terms for what is the same both ways has the
        errors of those apart: the errors of its coefficients are then those of its odd
        part.
        """
        if not (self.even_terms and self.directional):
            return self.columns(q, v)
        # Basis and extension know the size of the speed alone: of `columns` there and
        # back the sign stays.
        half_sign = 0.5 * np.tanh(v / self.sign_width)[:, None]
        basis = half_sign * self.scaling.basis(q, v, *self.orders)
        extension = half_sign * self.outside_columns(q, v)
        return np.hstack([basis, basis, extension, extension])

    def std_error(self, q: Array, v: Array) -> Array:
        """Compute the standard error (N,) N m of `torque`."""
        X = self.columns(q, v)
        variance = np.einsum("nk,kl,nl->n", X, self.covariance, X, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def stated_error(self, q: Array, v: Array) -> Array:
        """Compute the standard error (N,) N m with those of torque constant and law."""
        of_torque_constant = self.torque_constant_error * self.torque(q, v)
        of_entries = np.hypot(self.std_error(q, v), of_torque_constant)
        return np.asarray(np.hypot(of_entries, self.law_error))

    def at_rest(self, q: Array) -> tuple[Array, Array]:
        """Compute the smallest and largest torque (N,) N m of friction at rest."""
        slowest = max(self.scaling.speed[0], SLIDES * self.sign_width)
        v = np.full(len(q), slowest)
        backward = self.torque(q, -v)
        forward = self.torque(q, v)
        return np.minimum(backward, forward), np.maximum(backward, forward)

    def outside(self, q: Array, v: Array) -> Mask:
        """Return samples (N,) beyond the identified range of positions and speeds."""
        return self.identified_range.outside(q, v)

    @property
    def identified_range(self) -> IdentifiedRange:
        """Positions and speeds within which it was identified."""
        return IdentifiedRange(self.scaling, self.sign_width)

    def vague(self, q: Array, v: Array) -> Mask:
        """Return samples (N,) whose standard error is a clear share of the surface.

        It must be large for this surface as well. Such samples lie inside the ranges
        that the trials have reached, but no trial had this speed at this position.
        """
        position_share = self.scaling.over_position.share(q)
        speed_share = 0.5 * (self.scaling.u(v) + 1.0)
        row = np.rint(position_share * (CELLS - 1)).astype(np.intp)
        column = np.rint(speed_share * (CELLS - 1)).astype(np.intp)
        return np.asarray(self._vague[row, column] & (np.abs(v) > self.sign_width))

    @cached_property
    def _vague(self) -> Mask:
        """Cells (CELLS, CELLS) over position and scaled speed that are vague."""
        basis = self._grid
        size = self.positive.size
        vague = np.zeros(len(basis), dtype=bool)
        for number, entries in enumerate(self._sides):
            of_side = slice(number * size, (number + 1) * size)
            covariance = self.entry_covariance[of_side, of_side]
            variance = np.einsum("nk,kl,nl->n", basis, covariance, basis)
            is_clear_share = variance > (VAGUE * (basis @ entries.ravel())) ** 2
            is_unusual = variance > UNUSUAL**2 * np.median(variance)
            vague |= is_clear_share & is_unusual
        return vague.reshape(CELLS, CELLS)

    @cached_property
    def _grid(self) -> Array:
        """Basis (CELLS^2, size (l + 1)) over a grid of position and scaled speed."""
        slow, fast = self.scaling.speed
        if self.scaling.logarithmic:
            speeds = np.exp(np.linspace(np.log(slow), np.log(fast), CELLS))
        else:
            speeds = np.linspace(slow, fast, CELLS)
        places = self.scaling.over_position.at(np.linspace(0.0, 1.0, CELLS))
        q, v = np.meshgrid(places, speeds, indexing="ij")
        return self.scaling.basis(q.ravel(), v.ravel(), *self.orders)

    @property
    def _sides(self) -> tuple[Array, ...]:
        return (self.positive, self.negative) if self.directional else (self.positive,)

    @cached_property
    def slopes(self) -> Array:
        """Viscous slope of each direction's surface, N m s/rad, of either sign."""
        weights = self.scaling.slope(*self.orders)
        return np.array([weights @ side.ravel() for side in self._sides])

    def outside_columns(self, q: Array, v: Array) -> Array:
        """Compute columns (N, 4) of one direction's `extension`, without its sign."""
        speeds = np.stack([self.scaling.faster(v), self.scaling.slower(v)], axis=1)
        return np.hstack([self.scaling.over_position.novelty(q), speeds])

    def _errors_of(
        self, side: Array, slope: float, *, slope_doubt: float = 0.3
    ) -> Array:
        """Return standard errors (4,) of the extension of one direction's surface.

        `slope` is the viscous slope of `side`, N m s/rad; it may be off by a share of
        `slope_doubt`.
        """
        # Beyond the positions: the spread of friction over position.
        level = (self._grid @ side.ravel()).reshape(CELLS, CELLS)
        spread = NEW_GROUND * float(np.sqrt(np.mean((level - level.mean(axis=0)) ** 2)))

        # Beyond the fastest speed: the doubt about the slope, and what the line misses.
        over_speed = self.scaling.over_position.mean(self.orders[0]) @ side
        line_speeds = self.scaling.slope_speeds()
        width = float(np.ptp(line_speeds))
        slope_error = 0.0
        if width:
            on_line = chebval(self.scaling.u(line_speeds), over_speed)
            bend = float(np.std(on_line - slope * line_speeds))
            slope_error = float(np.hypot(slope_doubt * slope, bend / width))

        # Below the slowest speed: what friction changes near it.
        slow, fast = self.scaling.speed
        near_slowest = np.array([slow, min(np.e * slow, fast)])
        change = float(np.ptp(chebval(self.scaling.u(near_slowest), over_speed)))
        return np.array([spread, spread, slope_error, change])


@dataclass(frozen=True)
class FrictionFamily:
    """Surfaces of one joint on one basis, which is evaluated once for all of them.

    Friction itself and what it changes by per unit of each term of its drive are such
    surfaces: of one scaling, size, sign width and temperature.
    """

    members: tuple[FrictionSurface, ...]

    @property
    def sign_width(self) -> float:
        """Speed [rad/s; m/s where prismatic] over which the torques change sign."""
        return self.members[0].sign_width

    @property
    def per_kelvin(self) -> float:
        """Share by which friction changes per kelvin."""
        return self.members[0].per_kelvin

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) that temperatures make of friction."""
        return self.members[0].warmed(celsius)

    def torque(self, q: Array, v: Array) -> Array:
        """Compute the torque of every member.

        Parameters
        ----------
        q, v : (N,) arrays
            Positions [rad] and velocities [rad/s].

        Returns
        -------
        (N, m) array
            N m per unit of what each of the m members is the size of.
        """
        torque = np.empty((len(q), len(self.members)))
        for part in tiles(len(q)):
            torque[part] = self._torque_of_part(q[part], v[part])
        return torque

    def _torque_of_part(self, q: Array, v: Array) -> Array:
        common = self.members[0]
        sums = common.scaling.sums(q, v, self._entries)
        forward = sums[:, : len(self.members)]
        if self._extends:
            outside = common.outside_columns(q, v)
            forward = forward + outside @ self._forward_extension
        sign = np.tanh(v / common.sign_width)[:, None]
        if not self._is_directional:
            return np.asarray(sign * forward)

        backward = sums[:, len(self.members) :]
        if self._extends:
            backward = backward + outside @ self._backward_extension
        flips = (forward + backward) / 2.0
        stays = (forward - backward) / 2.0
        return np.asarray(sign * flips + stays)

    @cached_property
    def _is_directional(self) -> bool:
        return any(member.directional for member in self.members)

    @cached_property
    def _extends(self) -> bool:
        return any(member.extension.any() for member in self.members)

    @cached_property
    def _entries(self) -> Array:
        """Entries (size, l + 1, m) of all members where velocities are positive.

        Where these differ by direction, those where velocities are negative follow
        them.
        """
        entries = [member.positive for member in self.members]
        if self._is_directional:
            entries += [
                member.negative if member.directional else member.positive
                for member in self.members
            ]
        return np.stack(entries, axis=-1)

    @cached_property
    def _forward_extension(self) -> Array:
        """Coefficients (4, m) of all members outside, where velocities are positive."""
        return np.column_stack([member.extension[0] for member in self.members])

    @cached_property
    def _backward_extension(self) -> Array:
        """Coefficients (4, m) of all members outside, where velocities are negative."""
        return np.column_stack([member.extension[-1] for member in self.members])


def friction_torque(
    laws: Sequence[FrictionLaw | FrictionFamily | None],
    q: Array,
    dq: Array,
    *,
    members: tuple[int, ...] = (),
) -> Array:
    """Compute friction torque (N, n) N m; zero for a joint without a law.

    Of families it has an axis more, (N, n, m), with m as the only one of `members`.
    """
    torque = np.zeros((*q.shape, *members))
    for j, law in enumerate(laws):
        if law is not None:
            torque[:, j] = law.torque(q[:, j], dq[:, j])
    return torque


def slowest_speeds(surfaces: Sequence[FrictionSurface | None]) -> Array:
    """Return speeds (n,) rad/s below which the sign of friction is uncertain."""
    return np.array([0.0 if s is None else SLIDES * s.sign_width for s in surfaces])
