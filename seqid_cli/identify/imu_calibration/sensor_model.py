"""The constants of an IMU that the calibration finds, their priors, and what the readings owe them.

Each channel has a gain, a bias and a unit axis, which is turned a little from the
nominal one; the array has a mounting R, a lever and a clock (see `motion.imu.sensor`).
A gyro may be later than the accelerometers: the filters of the two inside one chip
delay them differently.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.motion.imu.array import layout
from seqid_cli.motion.imu.sensor import Mounting
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array

FEW = 6  # accelerometers below which the widths stay as they begin


@dataclass(frozen=True)
class Widths:
    """Standard deviations (C,) of the priors on gains, tilts (rad) and bias changes."""

    gain: Array
    tilt: Array
    drift: Array


def first_widths(
    c: int, *, gain: float = 0.02, tilt: float = 0.01, drift: float = 0.02
) -> Widths:
    """Widths to begin with, of `c` channels."""
    return Widths(*(np.full(c, width) for width in (gain, tilt, drift)))


def prior_of(
    widths: Widths,
    *,
    lever: float = 1.0,
    delay: float = 0.3,
    bias: float = 3.0,
    gyro_delay: float = 2e-3,
) -> Array:
    """Prior standard deviations (p,) of the constants; m, s, and m/s^2 or rad/s."""
    # Digital filters of gyros and accelerometers in one chip differ by up to some 2 ms.
    wide = np.full(len(widths.gain), bias), widths.gain, np.repeat(widths.tilt, 2)
    return np.concatenate([[np.pi] * 3, [lever] * 3, [delay], *wide, [gyro_delay]])


def next_width(
    values: Array,
    left_open: Array,
    width: Array,
    *,
    least: float = 1e-4,
    most_change: float = 5.0,
) -> float:
    """Next standard deviation of a prior that `values` come from (MacKay's fixed point)."""
    known = np.maximum(1.0 - left_open / width**2, 0.0)
    found = float(np.sqrt(np.sum(values**2) / max(float(np.sum(known)), 1.0)))
    largest = float(np.max(width))
    return float(
        np.clip(found, max(least, largest / most_change), largest * most_change)
    )


@dataclass(frozen=True)
class Constants:
    """What the calibration finds of C channels, the gyro's last.

    `tilt` (C, 2) rad is that of each axis; `gyro_delay` s is by how much the gyro is
    later than the accelerometers.
    """

    R: Array
    lever: Array
    delay: float
    bias: Array
    log_gain: Array
    tilt: Array
    gyro_delay: float = 0.0

    @property
    def values(self) -> Array:
        """As a vector (p,), the turn zero: turn, lever, delay, bias, gain, tilt, gyro's delay."""
        rest = self.bias, self.log_gain, self.tilt.ravel(), [self.gyro_delay]
        return np.concatenate([np.zeros(3), self.lever, [self.delay], *rest])

    @property
    def count(self) -> int:
        """Number of constants, p."""
        return len(self.values)

    def moved(self, step: Array) -> "Constants":
        """Constants after a step (p,)."""
        bias, gain, tilt = np.split(step[7:-1], np.array([1, 2]) * len(self.bias))
        return Constants(
            R=Rotation.from_rotvec(step[:3]).as_matrix() @ self.R,
            lever=self.lever + step[3:6],
            delay=self.delay + float(step[6]),
            bias=self.bias + bias,
            log_gain=self.log_gain + gain,
            tilt=self.tilt + tilt.reshape(-1, 2),
            gyro_delay=self.gyro_delay + float(step[-1]),
        )


def nominal_axes(imu: Imu) -> Array:
    """Axes (C, 3) of all channels."""
    axes = imu.axes.reshape(-1, 3)
    return np.vstack([axes, np.eye(3)]) if imu.gyro else axes


def gauge_information(imu: Imu, p: int, *, hold: float = 1e-6) -> Array:
    """Hold the accelerometers' common turn, to so many rad, where only the mounting shows it."""
    if layout(imu).acceleration:
        return np.zeros((p, p))
    axes, first = imu.axes.reshape(-1, 3), 7 + 2 * len(nominal_axes(imu))
    rows = np.zeros((3, p))
    for a in range(2):
        turns = np.cross(axes, _tangents(axes)[:, a])
        rows[:, first + a : first + 2 * len(axes) : 2] = turns.T / len(axes)
    return rows.T @ rows / hold**2


def _tangents(axes: Array) -> Array:
    """Two unit directions (C, 2, 3) across each axis."""
    helper = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first)], axis=1)


def tilted(axes: Array, tilt: Array) -> Array:
    """Unit axes (C, 3) after small tilts (C, 2)."""
    moved = axes + np.einsum("ca,cai->ci", tilt, _tangents(axes))
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def mounted(imu: Imu, constants: Constants) -> Mounting:
    """An IMU at these constants; its biases come on top."""
    axes = np.exp(constants.log_gain)[:, None] * tilted(
        nominal_axes(imu), constants.tilt
    )
    positions = imu.positions.reshape(-1, 3)
    return Mounting(imu.after_joint, positions, axes, constants.R, constants.lever)


def design(imu: Imu, constants: Constants, x: Array, dy: Array) -> Array:
    """Derivatives (N, C, 8 + 4 C) of readings in the constants; `dy` (N, C) their rate [1/s]."""
    # A delayed stamp is a later reading: the measured value at t + delay is compared
    # with the prediction at t, so the derivative in the delay is that of the reading,
    # with its sign turned.
    place, c = mounted(imu, constants), dy.shape[1]
    seen, pull, turn = place.by_place(x)
    across = _tangents(nominal_axes(imu)) @ constants.R.T
    G = np.zeros((*dy.shape, constants.count))
    gyros = slice(len(imu.axes), None)
    G[:, gyros, -1] = -dy[:, gyros]
    G[:, :, :3], G[:, :, 3:6], G[:, :, 6] = turn, pull, -dy
    own = np.arange(c)
    G[:, own, 7 + own] = 1.0
    G[:, own, 7 + c + own] = np.sum(seen * (place.axes @ place.R.T), axis=2)
    sideways = np.exp(constants.log_gain)[:, None] * np.einsum(
        "nci,cai->nca", seen, across
    )
    for a in range(2):
        G[:, own, 7 + 2 * c + 2 * own + a] = sideways[:, :, a]
    return G
