"""The constants of an IMU, their priors, and the derivatives of the readings in them.

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
    """Return the first widths of the priors, for `c` channels."""
    return Widths(gain=np.full(c, gain), tilt=np.full(c, tilt), drift=np.full(c, drift))


def prior_of(
    widths: Widths,
    *,
    lever: float = 1.0,
    delay: float = 0.3,
    bias: float = 3.0,
    gyro_delay: float = 2e-3,
) -> Array:
    """Return the prior standard deviations of the constants.

    Parameters
    ----------
    widths : Widths
        Widths of C channels.
    lever, delay, bias, gyro_delay : float
        Standard deviations of the lever [m], of the clock offset [s], of biases
        [m/s^2 or rad/s] and of the gyro's delay [s]. The digital filters of gyros and
        accelerometers in one chip differ by up to some 2 ms.

    Returns
    -------
    array (p,)
        In the order of `Constants.values`.
    """
    return np.concatenate(
        [
            [np.pi] * 3,
            [lever] * 3,
            [delay],
            np.full(len(widths.gain), bias),
            widths.gain,
            np.repeat(widths.tilt, 2),
            [gyro_delay],
        ]
    )


def next_width(
    values: Array,
    left_open: Array,
    width: Array,
    *,
    least: float = 1e-4,
    most_change: float = 5.0,
) -> float:
    """Return the next width of a prior by MacKay's fixed point.

    Parameters
    ----------
    values : array
        Estimates that come from the prior.
    left_open : array
        Their variances.
    width : array
        Present standard deviation of the prior.
    least : float
        Smallest width.
    most_change : float
        Largest factor of change in one step.
    """
    # Each estimate counts by the share of the prior's variance that the data remove.
    determined = np.maximum(1.0 - left_open / width**2, 0.0)
    n_determined = max(float(np.sum(determined)), 1.0)
    next_std = float(np.sqrt(np.sum(values**2) / n_determined))

    largest = float(np.max(width))
    lower = max(least, largest / most_change)
    return float(np.clip(next_std, lower, largest * most_change))


@dataclass(frozen=True, kw_only=True)
class Constants:
    """Constants of an IMU with C channels, the gyro's last.

    Attributes
    ----------
    R : array (3, 3)
        Rotation from the IMU's frame to that of its link.
    lever : array (3,)
        Place of the IMU in the link's frame [m].
    delay : float
        Offset of the IMU's clock to the encoders [s].
    bias : array (C,)
        Biases [m/s^2 or rad/s].
    log_gain : array (C,)
        Logarithms of the gains.
    tilt : array (C, 2)
        Turns of the axes from the nominal ones [rad].
    gyro_delay : float
        Delay of the gyro behind the accelerometers [s].
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
        """The constants as a vector (p,): turn (zero here), lever, delay and so on.

        Then come biases, gains, tilts and the gyro's delay.
        """
        turn = np.zeros(3)
        return np.concatenate(
            [
                turn,
                self.lever,
                [self.delay],
                self.bias,
                self.log_gain,
                self.tilt.ravel(),
                [self.gyro_delay],
            ]
        )

    @property
    def count(self) -> int:
        """Number of constants, p."""
        return len(self.values)

    def moved(self, step: Array) -> "Constants":
        """Return the constants after a step (p,)."""
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
    """Return the nominal unit axes (C, 3) of all channels."""
    axes = imu.axes.reshape(-1, 3)
    return np.vstack([axes, np.eye(3)]) if imu.gyro else axes


def gauge_information(imu: Imu, p: int, *, hold: float = 1e-6) -> Array:
    """Return the information (p, p) that holds the common turn of the accelerometers.

    Without it a common tilt of all axes could stand in for the mounting. It is held to
    `hold` rad where the layout does not tell the two apart.
    """
    if layout(imu).acceleration:
        return np.zeros((p, p))
    axes = imu.axes.reshape(-1, 3)
    first = 7 + 2 * len(nominal_axes(imu))  # place of the first tilt
    rows = np.zeros((3, p))
    for a in range(2):
        turns = np.cross(axes, _tangents(axes)[:, a])
        rows[:, first + a : first + 2 * len(axes) : 2] = turns.T / len(axes)
    return rows.T @ rows / hold**2


def _tangents(axes: Array) -> Array:
    """Return two unit directions (C, 2, 3) across each axis."""
    helper = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first)], axis=1)


def tilted(axes: Array, tilt: Array) -> Array:
    """Return the unit axes (C, 3) after small tilts (C, 2) rad."""
    moved = axes + np.einsum("ca,cai->ci", tilt, _tangents(axes))
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def mounted(imu: Imu, constants: Constants) -> Mounting:
    """Return the mounting of an IMU at these constants, without biases."""
    axes = np.exp(constants.log_gain)[:, None] * tilted(
        nominal_axes(imu), constants.tilt
    )
    positions = imu.positions.reshape(-1, 3)
    return Mounting(imu.after_joint, positions, axes, constants.R, constants.lever)


def design(imu: Imu, constants: Constants, x: Array, dy: Array) -> Array:
    """Return the derivatives of readings in the constants.

    Parameters
    ----------
    imu : Imu
        The IMU.
    constants : Constants
        Point of the derivatives.
    x : array (N, 15)
        State of the link: specific force, the matrix H, angular velocity.
    dy : array (N, C)
        Rate of the readings [their unit per s].

    Returns
    -------
    array (N, C, p)
        Derivatives, p = 8 + 4 C.
    """
    place = mounted(imu, constants)
    c = dy.shape[1]
    seen, pull, turn = place.by_place(x)
    across = _tangents(nominal_axes(imu)) @ constants.R.T
    G = np.zeros((*dy.shape, constants.count))
    gyros = slice(len(imu.axes), None)
    G[:, :, :3] = turn
    G[:, :, 3:6] = pull
    # The reading at t + delay is compared with the prediction at t. The derivative in
    # the delay is therefore the rate of the reading with its sign turned.
    G[:, :, 6] = -dy
    G[:, gyros, -1] = -dy[:, gyros]

    channel = np.arange(c)
    G[:, channel, 7 + channel] = 1.0
    G[:, channel, 7 + c + channel] = np.sum(seen * (place.axes @ place.R.T), axis=2)
    sideways = np.exp(constants.log_gain)[:, None] * np.einsum(
        "nci,cai->nca", seen, across
    )
    for a in range(2):
        G[:, channel, 7 + 2 * c + 2 * channel + a] = sideways[:, :, a]
    return G
