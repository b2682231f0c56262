"""Coulomb and viscous friction nearest to a friction surface: model files hold no more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from seqid_cli.model.friction import SLIDES, FrictionSurface

_POSITIONS, _SPEEDS = 41, 60


@dataclass(frozen=True)
class SimpleFriction:
    """tau_f = coulomb sign(v) + viscous v, fitted over `speeds` [rad/s] in both directions.

    `coulomb` N m, `viscous` N m s/rad, neither negative. `misfit` is the RMS difference to the
    surface, `size` the RMS of the surface itself, `offset` the mean part that does not flip with
    the direction, which the two cannot say; all N m.
    """

    coulomb: float
    viscous: float
    offset: float
    misfit: float
    size: float
    speeds: tuple[float, float]


def simple_friction(surface: FrictionSurface) -> SimpleFriction:
    """Fit Coulomb and viscous friction to a surface, uniformly over its positions and speeds."""
    low, high = surface.scaling.speed
    low = min(max(low, SLIDES * surface.sign_width), high)
    speeds = np.linspace(low, high, _SPEEDS)
    positions = np.linspace(*surface.scaling.position, _POSITIONS)
    q, v = (x.ravel() for x in np.meshgrid(positions, np.concatenate([-speeds, speeds])))
    tau = surface.torque(q, v)
    columns = np.column_stack([np.sign(v), v])
    fitted, _ = nnls(columns, tau)
    misfit = tau - columns @ fitted
    return SimpleFriction(
        coulomb=float(fitted[0]),
        viscous=float(fitted[1]),
        offset=float(tau.mean()),
        misfit=float(np.sqrt(np.mean(misfit**2))),
        size=float(np.sqrt(np.mean(tau**2))),
        speeds=(float(low), float(high)),
    )
