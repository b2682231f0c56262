"""Friction of a parameter file as arrays, for plots and programs of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from seqid_cli.params.document import friction_of
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from seqid_cli.typing import Array, Mask


@dataclass(frozen=True, kw_only=True)
class FrictionValues:
    """Friction of a joint at places and speeds, each array of their common shape.

    `torque` and its `std_error` are in N m, in N for a joint that slides. `outside`
    is true where no trial was: there Coulomb and viscous friction goes on.
    """

    torque: Array
    std_error: Array
    outside: Mask


def friction_values(
    parameters: ParameterFile, joint: str, position: ArrayLike, velocity: ArrayLike
) -> FrictionValues:
    """Evaluate the identified friction of a joint.

    Parameters
    ----------
    parameters : ParameterFile
        With the stage friction. Effects that refinement added are no part of it.
    joint : str
    position, velocity : array_like
        Position [rad or m] and velocity [rad/s or m/s], of shapes that fit together.

    Returns
    -------
    FrictionValues

    Raises
    ------
    UsageError
        No friction of this joint is in the file.
    """
    import numpy as np

    from seqid_cli.model.friction import FrictionSurface

    surface = FrictionSurface.from_stage(friction_of(parameters, joint))
    q, v = np.broadcast_arrays(
        np.asarray(position, dtype=float), np.asarray(velocity, dtype=float)
    )
    flat_q, flat_v = q.ravel(), v.ravel()
    return FrictionValues(
        torque=surface.torque(flat_q, flat_v).reshape(q.shape),
        std_error=surface.stated_error(flat_q, flat_v).reshape(q.shape),
        outside=surface.outside(flat_q, flat_v).reshape(q.shape),
    )
