"""Angular motion of a link from an array of accelerometers (Sec. 3) or an ordinary IMU.

An accelerometer at r with sensing axis s, on a body whose frame origin has the specific
force f and which turns with w, reads

    a = s'(f + dw x r + w x (w x r)),

which is linear in f (3), dw (3) and the products of w (6): xx, yy, zz, xy, xz, yz.
Twelve well-placed accelerometers determine all of them; the products give w up to its
sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.params.schema import ImuCalibration
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array, Mask

GROUPS = {
    "the specific force": [f"specific force along {a}" for a in "xyz"],
    "the angular acceleration": [f"angular acceleration about {a}" for a in "xyz"],
    "the products of the angular velocity": [
        f"angular velocity product {a}" for a in ("xx", "yy", "zz", "xy", "xz", "yz")
    ],
}
# By the number of dimensions over which accelerometers spread that do not see
# everything.
REMEDIES = (
    "all of them sit at one point: spread them",
    "they sit on a line: place some off it",
    "they sit on a plane: place some off it",
    "turn some of the sensing axes",
)


@dataclass(frozen=True)
class AngularReading:
    """What an IMU says of its turning, in its frame.

    `dw` (N, 3) rad/s^2 and w w' (N, 3, 3) rad^2/s^2, zero if not seen; `w` (N, 3) rad/s
    of a gyro.
    """

    dw: Array
    products: Array
    w: Array | None = None


@dataclass(frozen=True)
class ArrayLayout:
    """What the accelerometers of an IMU can see, before any data."""

    rank: int
    condition: float  # of the unknowns that they determine
    # (12,) of f, dw, products for 1 m/s^2 of white noise; infinite if not seen
    errors: Array

    @property
    def acceleration(self) -> bool:
        """Whether the angular acceleration is seen."""
        return bool(np.isfinite(self.errors[3:6]).all())

    @property
    def products(self) -> bool:
        """Whether all products of the angular velocity are seen."""
        return bool(np.isfinite(self.errors[6:]).all())


def array_matrix(imu: Imu) -> Array:
    """Readings as a linear map (K, 12) of f, dw and the products of w."""
    s, r = imu.axes, imu.positions
    squares = s * r - np.sum(s * r, axis=1)[:, None]
    a, b = [0, 0, 1], [1, 2, 2]
    return np.hstack(
        [s, np.cross(r, s), squares, s[:, a] * r[:, b] + s[:, b] * r[:, a]]
    )


def layout(imu: Imu, *, min_resolution: float = 1 - 1e-6) -> ArrayLayout:
    """Judge a layout; an unknown is seen where readings resolve `min_resolution` or more of it."""
    A, scale = _scaled(array_matrix(imu))
    _, s, Vt = np.linalg.svd(A)
    kept = s > 1e-6 * s[0]
    own = Vt[: len(s)][kept]
    variance = np.sum((own / s[kept, None]) ** 2, axis=0) / scale**2
    errors = np.where(
        np.sum(own**2, axis=0) > min_resolution, np.sqrt(variance), np.inf
    )
    return ArrayLayout(int(kept.sum()), float(s[0] / s[kept][-1]), errors)


def layout_statements(imu: Imu, *, poor_condition: float = 1000.0) -> list[str]:
    """Say what a layout of accelerometers, and its gyro, cannot see, and what would mend it."""
    found, said, count = layout(imu), [], len(imu.axes)
    hidden = np.isinf(found.errors)
    if imu.gyro:
        hidden[3:] = False
    for (what, names), own in zip(
        GROUPS.items(), np.split(hidden, [3, 6]), strict=True
    ):
        if own.all():
            said.append(f"{what} cannot be told from the rest")
        elif own.any():
            unseen = [name for name, h in zip(names, own, strict=True) if h]
            said.append(f"not told from the rest: {', '.join(unseen)}")
    if said and count > found.rank:
        said.append(
            f"{count - found.rank} of its {count} accelerometers repeat what others say"
        )
    if hidden[3:].any():
        centred = imu.positions - imu.positions.mean(axis=0)
        remedy = REMEDIES[np.linalg.matrix_rank(centred, tol=1e-9)]
        few = f"{count} accelerometers are fewer than the 12 that see everything"
        said.append(few if count < 12 else remedy)
    elif found.condition > poor_condition and not imu.gyro:
        near = "its accelerometers are too close or too alike"
        said.append(f"{near} (condition {found.condition:.3g})")
    return said


def _scaled(A: Array) -> tuple[Array, Array]:
    """Columns of unit size, and their sizes."""
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0] = 1.0
    return A / scale, scale


def calibrated(
    imu: Imu, calibration: ImuCalibration, accelerations: Array, gyro: Array | None
) -> tuple[Imu, Array, Array | None]:
    """Take a calibration's biases and gains off the readings, and its axes into the layout."""
    # What is not determined is left as the robot file has it. The clock offset stays
    # in.
    bias = entries(calibration.accelerometer_bias, len(imu.axes), 0.0)
    scale = entries(calibration.accelerometer_scale, len(imu.axes), 1.0)
    axes = (
        np.array(calibration.accelerometer_axes)
        if calibration.accelerometer_axes
        else imu.axes
    )
    if gyro is not None:
        gyro = gyro - entries(calibration.gyro_bias, 3, 0.0)
        gyro = gyro / entries(calibration.gyro_scale, 3, 1.0)
        if calibration.gyro_axes:
            gyro = gyro @ np.linalg.inv(np.array(calibration.gyro_axes)).T
    return replace(imu, axes=axes), (accelerations - bias) / scale, gyro


def entries(values: Sequence[float | None], count: int, default: float) -> Array:
    """Entries (count,) of a calibration; the default where it has none."""
    if len(values) != count:
        return np.full(count, default)
    return np.array([default if v is None else v for v in values], dtype=np.float64)


def read_angular(
    imu: Imu, accelerations: Array, gyro: Array | None, lowpass: Lowpass, valid: Mask
) -> AngularReading:
    """Angular acceleration, products of angular velocity, by the gyro (N, 3) rad/s or the array."""
    # Low-passed once; `accelerations` (N, K) m/s^2, `valid` (N,) false in gaps.
    if gyro is not None:
        w = lowpass(gyro, valid)
        dw, _ = differentiate(w, lowpass.rate_hz, valid)
        return AngularReading(dw, w[:, :, None] * w[:, None, :], w)
    unknowns = lowpass(accelerations, valid) @ array_inverse(imu).T
    pairs = [[6, 9, 10], [9, 7, 11], [10, 11, 8]]
    return AngularReading(
        unknowns[:, 3:6], unknowns[:, pairs] * float(layout(imu).products)
    )


def array_inverse(imu: Imu) -> Array:
    """Map (12, K) from readings to f, dw and products of w; least in size if not seen."""
    A, scale = _scaled(array_matrix(imu))
    return np.asarray(np.linalg.pinv(A, rcond=1e-6) / scale[:, None])
