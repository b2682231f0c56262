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
# By the number of dimensions over which accelerometers spread that do not see all.
REMEDIES = (
    "all of them sit at one point: spread them",
    "they sit on a line: place some off it",
    "they sit on a plane: place some off it",
    "turn some of the sensing axes",
)


@dataclass(frozen=True)
class AngularReading:
    """What an IMU says of its turning, in its frame.

    Attributes
    ----------
    dw : Array
        (N, 3) rad/s^2.
    products : Array
        w w' (N, 3, 3) rad^2/s^2, zero if not seen.
    w : Array, optional
        (N, 3) rad/s of a gyro.
    """

    dw: Array
    products: Array
    w: Array | None = None


@dataclass(frozen=True)
class ArrayLayout:
    """What the accelerometers of an IMU can see, before any data.

    Attributes
    ----------
    rank : int
        Number of the unknowns that they determine.
    condition : float
        Of these unknowns.
    errors : Array
        (12,) of f, dw, products for 1 m/s^2 of white noise; infinite if not seen.
    """

    rank: int
    condition: float
    errors: Array

    @property
    def acceleration(self) -> bool:
        """True if the angular acceleration is seen."""
        return bool(np.isfinite(self.errors[3:6]).all())

    @property
    def products(self) -> bool:
        """True if all products of the angular velocity are seen."""
        return bool(np.isfinite(self.errors[6:]).all())


def array_matrix(imu: Imu) -> Array:
    """Return the readings as a linear map (K, 12) of f, dw and the products of w."""
    s = imu.axes
    r = imu.positions
    squares = s * r - np.sum(s * r, axis=1)[:, None]
    # The products xy, xz, yz.
    first = [0, 0, 1]
    second = [1, 2, 2]
    mixed = s[:, first] * r[:, second] + s[:, second] * r[:, first]
    return np.hstack([s, np.cross(r, s), squares, mixed])


def layout(imu: Imu, *, min_resolution: float = 1 - 1e-6) -> ArrayLayout:
    """Judge a layout before any data.

    An unknown is seen where readings resolve `min_resolution` or more of it.
    """
    A, scale = _scaled(array_matrix(imu))
    _, singular, Vt = np.linalg.svd(A)
    determined = singular > 1e-6 * singular[0]
    directions = Vt[: len(singular)][determined]

    amplified = directions / singular[determined, None]
    variance = np.sum(amplified**2, axis=0) / scale**2
    resolution = np.sum(directions**2, axis=0)
    return ArrayLayout(
        rank=int(determined.sum()),
        condition=float(singular[0] / singular[determined][-1]),
        errors=np.where(resolution > min_resolution, np.sqrt(variance), np.inf),
    )


def layout_statements(imu: Imu, *, poor_condition: float = 1000.0) -> list[str]:
    """Say what accelerometers and gyro of an IMU cannot see, and what would mend it."""
    judged = layout(imu)
    count = len(imu.axes)
    hidden = np.isinf(judged.errors)
    if imu.gyro:
        hidden[3:] = False

    statements = []
    hidden_groups = np.split(hidden, [3, 6])
    for (group, names), is_hidden in zip(GROUPS.items(), hidden_groups, strict=True):
        if is_hidden.all():
            statements.append(f"{group} cannot be told from the rest")
        elif is_hidden.any():
            unseen = np.array(names)[is_hidden].tolist()
            statements.append(f"not told from the rest: {', '.join(unseen)}")
    if statements and count > judged.rank:
        statements.append(
            f"{count - judged.rank} of its {count} accelerometers repeat what others"
            " say"
        )

    if hidden[3:].any():
        if count < 12:
            statements.append(
                f"{count} accelerometers are fewer than the 12 that see everything"
            )
        else:
            centred = imu.positions - imu.positions.mean(axis=0)
            n_dimensions = np.linalg.matrix_rank(centred, tol=1e-9)
            statements.append(REMEDIES[n_dimensions])
    elif judged.condition > poor_condition and not imu.gyro:
        statements.append(
            "its accelerometers are too close or too alike (condition"
            f" {judged.condition:.3g})"
        )
    return statements


def _scaled(A: Array) -> tuple[Array, Array]:
    """Return columns of unit size, and their sizes."""
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0] = 1.0
    return A / scale, scale


def calibrated(
    imu: Imu, calibration: ImuCalibration, accelerations: Array, gyro: Array | None
) -> tuple[Imu, Array, Array | None]:
    """Take a calibration's biases and gains off the readings.

    What is not determined is left as the robot file has it. The clock offset stays in.

    Parameters
    ----------
    imu : Imu
        As the robot file has it.
    calibration : ImuCalibration
    accelerations : Array
        (N, K) m/s^2.
    gyro : Array, optional
        (N, 3) rad/s.

    Returns
    -------
    tuple of Imu, Array and Array or None
        The IMU with calibrated axes, accelerations and gyro.
    """
    bias = entries(calibration.accelerometer_bias, len(imu.axes), 0.0)
    scale = entries(calibration.accelerometer_scale, len(imu.axes), 1.0)
    axes = imu.axes
    if calibration.accelerometer_axes:
        axes = np.array(calibration.accelerometer_axes)
    if gyro is not None:
        gyro = gyro - entries(calibration.gyro_bias, 3, 0.0)
        gyro = gyro / entries(calibration.gyro_scale, 3, 1.0)
        if calibration.gyro_axes:
            gyro = gyro @ np.linalg.inv(np.array(calibration.gyro_axes)).T
    return replace(imu, axes=axes), (accelerations - bias) / scale, gyro


def entries(values: Sequence[float | None], count: int, default: float) -> Array:
    """Return the entries (count,) of a calibration; the default where it has none."""
    if len(values) != count:
        return np.full(count, default)
    filled = [default if value is None else value for value in values]
    return np.array(filled, dtype=np.float64)


def read_angular(
    imu: Imu, accelerations: Array, gyro: Array | None, lowpass: Lowpass, valid: Mask
) -> AngularReading:
    """Read the angular motion of an IMU, by its gyro or else by its accelerometers.

    Parameters
    ----------
    imu : Imu
    accelerations : Array
        (N, K) m/s^2.
    gyro : Array, optional
        (N, 3) rad/s.
    lowpass : Lowpass
        Is applied once.
    valid : Mask
        (N,), false in gaps.
    """
    if gyro is not None:
        w = lowpass(gyro, valid)
        dw, _ = differentiate(w, lowpass.rate_hz, valid)
        return AngularReading(dw=dw, products=w[:, :, None] * w[:, None, :], w=w)

    unknowns = lowpass(accelerations, valid) @ array_inverse(imu).T
    # Where xx, yy, zz, xy, xz, yz stand in w w'.
    place = [[6, 9, 10], [9, 7, 11], [10, 11, 8]]
    are_seen = float(layout(imu).products)
    return AngularReading(dw=unknowns[:, 3:6], products=unknowns[:, place] * are_seen)


def array_inverse(imu: Imu) -> Array:
    """Return the map (12, K) from readings to f, dw and products of w.

    What is not seen comes out least in size.
    """
    A, scale = _scaled(array_matrix(imu))
    return np.asarray(np.linalg.pinv(A, rcond=1e-6) / scale[:, None])
