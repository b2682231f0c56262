"""Modified Denavit-Hartenberg parameters to a chain (Craig's convention, paper Eq. 27)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .placement import rotation_about, tidy_position, tidy_rotation
from .types import Chain

_X = np.array([1.0, 0.0, 0.0])
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class DhRow:
    """One joint: RotX(alpha) TransX(a) RotZ(theta0 + q) TransZ(d), rad and m.

    A prismatic joint keeps its angle `theta0` and moves by q along z.
    """

    alpha: float
    a: float
    d: float
    theta0: float
    prismatic: bool = False


def chain_from_dh(rows: Sequence[DhRow]) -> Chain:
    """Build the chain of a modified DH table; joint axes are z of their frames (Eq. 27)."""
    rotations, positions = [], []
    for row in rows:
        tilt = rotation_about(_X, row.alpha)
        rotations.append(tidy_rotation(tilt @ rotation_about(_Z, row.theta0)))
        positions.append(tidy_position(row.a * _X + row.d * tidy_rotation(tilt)[:, 2]))
    return Chain(
        rotation=np.array(rotations),
        position=np.array(positions),
        axis=np.tile(_Z, (len(rows), 1)),
        prismatic=np.array([row.prismatic for row in rows]),
    )
