"""Coulomb and viscous friction nearest to a friction surface: model files hold no more."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.results.export import ExportedFriction

_POSITIONS, _SPEEDS = 41, 60


def simple_friction(surface: FrictionSurface) -> ExportedFriction:
    """Fit coulomb sign(v) + viscous v to a surface, uniformly over its positions and speeds.

    Neither is negative. The offset is the mean part that does not flip with the direction, which
    the two cannot say.
    """
    low, high = surface.scaling.speed
    low = min(max(low, SLIDES * surface.sign_width), high)
    speeds = np.linspace(low, high, _SPEEDS)
    positions = np.linspace(*surface.scaling.position, _POSITIONS)
    q, v = (x.ravel() for x in np.meshgrid(positions, np.concatenate([-speeds, speeds])))
    tau = surface.torque(q, v)
    columns = np.column_stack([np.sign(v), v])
    fitted, _ = nnls(columns, tau)
    misfit = tau - columns @ fitted
    return ExportedFriction(
        coulomb=float(fitted[0]),
        viscous=float(fitted[1]),
        offset=float(tau.mean()),
        rms_misfit=float(np.sqrt(np.mean(misfit**2))),
        rms=float(np.sqrt(np.mean(tau**2))),
        speed_range=[float(low), float(high)],
    )
