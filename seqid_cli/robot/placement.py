"""Constant rotations, and placements without the rounding of files."""

from __future__ import annotations

import numpy as np

from .types import Array

ANGLE_NOISE = 1e-5  # rad; "1.5708" in a file means a quarter turn (it is 3.7e-6 off)
LENGTH_NOISE = 1e-6  # m; below what any arm is built to


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) of the cross product: ``skew(v) @ x == cross(v, x)``.

    Parameters
    ----------
    v : (3,) array
    """
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


def tidy_position(p: Array) -> Array:
    """Zero the components of a position (3,) [m] below `LENGTH_NOISE`."""
    return np.where(np.abs(p) < LENGTH_NOISE, 0.0, p)


def tidy_axis(axis: Array) -> Array:
    """Normalise `axis` (3,), its components within `ANGLE_NOISE` of 0 made exact."""
    unit = axis / np.linalg.norm(axis)
    unit = np.where(np.abs(unit) < ANGLE_NOISE, 0.0, unit)
    return np.asarray(unit / np.linalg.norm(unit))
