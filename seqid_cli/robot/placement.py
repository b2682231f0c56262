"""Constant rotations, placements without the rounding of files, and chains of DH parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.robot.types import Array, Chain

ANGLE_NOISE = 1e-5  # rad; "1.5708" in a file means a quarter turn (it is 3.7e-6 off)


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) of the cross product: ``skew(v) @ x == cross(v, x)``."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_about(axis: Array, angle: float) -> Array:
    """Rotate by `angle` [rad] about the unit vector `axis` (3,): matrix (3, 3) (Rodrigues)."""
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def tidy_rotation(R: Array) -> Array:
    """Make entries of a rotation (3, 3) within `ANGLE_NOISE` of 0 and +-1 exact.

    Rounded quarter turns would otherwise count as geometry: axes parallel but for 4e-6 rad give
    base parameters that no experiment can see.
    """
    nearest = np.round(R)
    snapped = np.where(np.abs(R - nearest) < ANGLE_NOISE, nearest, R)
    if np.array_equal(snapped, nearest):
        return np.asarray(snapped + 0.0)
    U, _, Vt = np.linalg.svd(snapped)
    R = U @ Vt
    return np.asarray(np.where(np.abs(R) < 1e-15, 0.0, R))


def tidy_position(p: Array, *, noise: float = 1e-6) -> Array:
    """Zero the components of a position (3,) [m] below `noise`."""
    return np.where(np.abs(p) < noise, 0.0, p)


def tidy_axis(axis: Array) -> Array:
    """Normalise `axis` (3,), its components within `ANGLE_NOISE` of 0 made exact."""
    unit = axis / np.linalg.norm(axis)
    unit = np.where(np.abs(unit) < ANGLE_NOISE, 0.0, unit)
    return np.asarray(unit / np.linalg.norm(unit))


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
    x, z = np.eye(3)[[0, 2]]
    rotations, positions = [], []
    for row in rows:
        tilt = rotation_about(x, row.alpha)
        rotations.append(tidy_rotation(tilt @ rotation_about(z, row.theta0)))
        positions.append(tidy_position(row.a * x + row.d * tidy_rotation(tilt)[:, 2]))
    return Chain(
        rotation=np.array(rotations),
        position=np.array(positions),
        axis=np.tile(z, (len(rows), 1)),
        prismatic=np.array([row.prismatic for row in rows]),
    )
