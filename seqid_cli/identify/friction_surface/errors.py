"""How well a friction surface predicts speeds that were left out (Eq. 11).

Errors are of averages over `group_size` neighbouring slices that belong to their trial
(`surface_weights`): of inner speeds by a surface that was
fitted to the others, of the slowest and the fastest, beyond which nothing was seen, by the surface
itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.friction_surface.fit import SurfaceFit
from seqid_cli.identify.friction_surface.reduction import COUNTS, Orders, SpeedData
from seqid_cli.typing import Array

NOISES = 2.0  # of such an average, that count as none of the surface's error
NEAR_ZERO = 0.2  # of the RMS friction, below which the criterion is absolute


@dataclass(frozen=True)
class Errors:
    """Errors (E,) N m of averages at scaled speeds `u`, their friction and noise."""

    u: Array
    error: Array
    friction: Array
    noise: Array

    @property
    def missed(self) -> Array:
        """Errors (E,) beyond the noise of the averages."""
        return np.maximum(np.abs(self.error) - NOISES * self.noise, 0.0)

    @property
    def rms(self) -> float:
        """RMS error, N m."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def largest(self) -> float:
        """Largest error, N m."""
        return float(np.abs(self.error).max())

    @property
    def relative(self) -> float:
        """Largest error beyond noise over friction; over 0.2 of its RMS where it is near zero."""
        friction = np.maximum(np.abs(self.friction), NEAR_ZERO * np.sqrt(np.mean(self.friction**2)))
        return float((self.missed / np.maximum(friction, 1e-300)).max())

    def meets(self, beta: float) -> bool:
        """Whether Eq. 11 holds."""
        return self.relative <= beta

    def at(self, u: float) -> Errors:
        """Those of one speed."""
        own = self.u == u
        return Errors(self.u[own], self.error[own], self.friction[own], self.noise[own])


def joined(parts: Sequence[Errors]) -> Errors:
    """Errors of several surfaces."""
    names = ("u", "error", "friction", "noise")
    return Errors(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def fitted_errors(data: Sequence[SpeedData], fit: SurfaceFit, orders: Orders) -> Errors:
    """Errors of the surface that has seen everything."""
    D = fit.entries(orders)
    return joined([_errors(data, fit, orders, u, D) for u in fit.reduced.levels])


def left_out_errors(data: Sequence[SpeedData], fit: SurfaceFit, orders: Orders) -> Errors:
    """Errors at inner speeds that a surface has not seen, and of the surface at both ends.

    With three speeds or fewer nothing is left out.
    """
    levels = fit.reduced.levels
    unseen = dict(fit.leaving_out(orders)) if len(levels) > 3 else {}
    D = fit.entries(orders)
    return joined([_errors(data, fit, orders, u, unseen.get(float(u), D)) for u in levels])


def _errors(
    data: Sequence[SpeedData], fit: SurfaceFit, orders: Orders, u: float, D: Array
) -> Errors:
    """Errors at one speed of the surface with entries D."""
    phi = np.polynomial.chebyshev.chebvander(np.array([u]), orders.velocity)[0]
    over_position = fit.reduced.scaling.over_position
    own = [item for item, at in zip(data, fit.reduced.u, strict=True) if at == u]
    parts = [
        _grouped(item, over_position.values(item.q, orders.position) @ (D @ phi)) for item in own
    ]
    error, friction, noise = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Errors(np.full(len(error), u), error, friction, noise)


def _grouped(item: SpeedData, fitted: Array, *, group_size: int = 16) -> tuple[Array, Array, Array]:
    """Errors and friction averaged over groups of slices, and the noise of such an average."""
    belongs = np.flatnonzero(item.weight > COUNTS * item.weight.max())
    groups = np.array_split(belongs, max(len(belongs) // group_size, 1))
    off = item.friction - fitted
    steps = np.concatenate([np.diff(off[group]) for group in groups])
    scatter = float(np.sqrt(np.mean(steps**2) / 2.0)) if len(steps) else 0.0
    error = np.array([off[group].mean() for group in groups])
    friction = np.array([item.friction[group].mean() for group in groups])
    return error, friction, scatter / np.sqrt([float(len(group)) for group in groups])
