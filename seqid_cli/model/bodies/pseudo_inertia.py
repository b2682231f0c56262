"""Pseudo-inertia matrices: when inertial parameters belong to a body that can exist.

With m the mass, h = m c the first moment and I the inertia about the frame's origin,
the matrix

    J = [S  h]        S = 1/2 tr(I) 1 - I
        [h' m],

the second moment of the mass density in homogeneous coordinates, is positive definite
exactly if some density of positive mass has these parameters (Wensing, Kim, Slotine,
"Linear matrix inequalities for physically consistent inertial parameter
identification", RA-L 2018). It moves with a frame as J_A = T_AB J_B T_AB'.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from seqid_cli.robot.types import Array


def pseudo_inertia(phi: Array) -> Array:
    """Return J (..., 4, 4) of standard parameters (..., 10) in Pinocchio's order."""
    m, mx, my, mz, xx, xy, yy, xz, yz, zz = np.moveaxis(
        np.asarray(phi, dtype=float), -1, 0
    )
    half = 0.5 * (xx + yy + zz)
    rows = [
        [half - xx, -xy, -xz, mx],
        [-xy, half - yy, -yz, my],
        [-xz, -yz, half - zz, mz],
        [mx, my, mz, m],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def standard_of(J: Array) -> Array:
    """Return the standard parameters (..., 10) of J (..., 4, 4)."""
    S = J[..., :3, :3]
    h = J[..., :3, 3]
    m = J[..., 3, 3]
    trace = np.trace(S, axis1=-2, axis2=-1)
    inertia = [
        trace - S[..., 0, 0],
        -S[..., 0, 1],
        trace - S[..., 1, 1],
        -S[..., 0, 2],
        -S[..., 1, 2],
        trace - S[..., 2, 2],
    ]
    return np.stack([m, *np.moveaxis(h, -1, 0), *inertia], axis=-1)


@dataclass(frozen=True)
class Body:
    """A body as model files write it.

    Attributes
    ----------
    mass : float
        kg.
    center : Array
        Centre of mass (3,) m in the link's frame.
    inertia : Array
        (3, 3) kg m^2 about the centre of mass, in the axes of the link's frame.
    """

    mass: float
    center: Array
    inertia: Array

    @classmethod
    def of(cls, phi: Array) -> Self:
        """Convert standard parameters (10,) of a positive mass."""
        J = pseudo_inertia(phi)
        mass = float(J[3, 3])
        center = J[:3, 3] / mass
        S = J[:3, :3] - mass * np.outer(center, center)
        inertia = np.trace(S) * np.eye(3) - S
        radius = np.sqrt(np.trace(J[:3, :3]) / mass)
        return cls(
            mass=mass,
            center=_tidy(center, radius),
            inertia=_tidy(inertia, np.trace(inertia)),
        )


def _tidy(values: Array, size: float, *, nothing: float = 1e-15) -> Array:
    """Return values with zeros where only rounding is left of a body's size."""
    return np.where(np.abs(values) > nothing * size, values, 0.0)
