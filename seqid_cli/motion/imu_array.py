"""Angular motion of a link from an array of accelerometers (Sec. 3) or an ordinary IMU.

An accelerometer at r with sensing axis s, on a body whose frame origin has the specific force f
and which turns with w, reads

    a = s'(f + dw x r + w x (w x r)),

which is linear in f (3), dw (3) and the products of w (6): xx, yy, zz, xy, xz, yz. Twelve
well-placed accelerometers determine all of them; the products give w up to its sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.motion.filtering import Lowpass, differentiate
from seqid_cli.robot.types import Imu

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DETERMINED = 1 - 1e-6


@dataclass(frozen=True)
class AngularReading:
    """What an IMU says, in its own frame.

    `dw` (N, 3) rad/s^2; `products` (N, 3, 3) rad^2/s^2 is w w'; `force` (N, 3) m/s^2;
    `speed_known` is
    False where the layout does not show the products (then `products` is zero).
    """

    dw: Array
    products: Array
    force: Array
    speed_known: bool


@dataclass(frozen=True)
class ArrayLayout:
    """What a layout can see: `condition` of the unknowns it determines, by group."""

    condition: float
    acceleration: bool
    products: bool


def array_matrix(imu: Imu) -> Array:
    """Readings as a linear map (K, 12) of f, dw and the products of w."""
    s, r = imu.axes, imu.positions
    along = np.sum(s * r, axis=1)
    squares = s * r - along[:, None]
    mixed = np.column_stack(
        [
            s[:, 0] * r[:, 1] + s[:, 1] * r[:, 0],
            s[:, 0] * r[:, 2] + s[:, 2] * r[:, 0],
            s[:, 1] * r[:, 2] + s[:, 2] * r[:, 1],
        ]
    )
    return np.hstack([s, np.cross(r, s), squares, mixed])


def layout(imu: Imu) -> ArrayLayout:
    """Judge a layout before any data: which unknowns it determines, and how well."""
    A = array_matrix(imu)
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0] = 1.0
    _, s, Vt = np.linalg.svd(A / scale)
    kept = s > 1e-6 * s[0]
    resolution = np.sum(Vt[: len(s)][kept] ** 2, axis=0)
    seen = resolution > DETERMINED
    return ArrayLayout(float(s[0] / s[kept][-1]), bool(seen[3:6].all()), bool(seen[6:].all()))


def read_angular(
    imu: Imu, accelerations: Array, gyro: Array | None, lowpass: Lowpass, valid: Mask
) -> AngularReading:
    """Solve the array for angular acceleration and products of angular velocity.

    Parameters
    ----------
    imu : Imu
        Layout in the IMU's own frame.
    accelerations : (N, K) array
        Readings [m/s^2].
    gyro : (N, 3) array, optional
        Angular velocity [rad/s]; used instead of the array where it is there.
    lowpass : Lowpass
        Filter of the motion; applied once.
    valid : (N,) bool array
        False in gaps.

    Returns
    -------
    AngularReading
    """
    filtered = lowpass(accelerations, valid)
    if gyro is not None:
        w = lowpass(gyro, valid)
        dw, _ = differentiate(w, lowpass.rate_hz, valid)
        force = filtered @ np.linalg.pinv(imu.axes).T
        return AngularReading(dw, w[:, :, None] * w[:, None, :], force, True)
    A = array_matrix(imu)
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv(A / scale, rcond=1e-6) / scale[:, None]
    unknowns = filtered @ inverse.T
    known = layout(imu).products
    products = _symmetric(unknowns[:, 6:]) if known else np.zeros((len(filtered), 3, 3))
    return AngularReading(unknowns[:, 3:6], products, unknowns[:, :3], known)


def _symmetric(p: Array) -> Array:
    rows = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
    matrix: Array = p[:, rows]
    return matrix


def speed_about(products: Array, axis: Array) -> Array:
    """Magnitude (N,) rad/s of the angular velocity about a known axis, from w w'."""
    speed: Array = np.sqrt(np.maximum(np.einsum("nij,i,j->n", products, axis, axis), 0.0))
    return speed


def angular_velocity(products: Array, reference: Array) -> Array:
    """Angular velocity (N, 3) rad/s from w w', its sign taken from a rough reference (N, 3).

    The main direction of w w' and the root of its size; where the reference says nothing the sign
    of the sample before is kept, as the paper proposes below Eq. 42.
    """
    value, vector = np.linalg.eigh(products)
    w: Array = vector[:, :, 2] * np.sqrt(np.maximum(value[:, 2], 0.0))[:, None]
    agree = np.sum(w * reference, axis=1)
    sign = np.sign(agree)
    known = np.flatnonzero(sign)
    if len(known):
        last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), known[0]))
        flips = sign[last]
        w = w * flips[:, None]
    return w
