"""The constants of an IMU, their priors, and the derivatives of the readings in them.

Each channel has a gain, a bias and a unit axis, which is turned a little from the
nominal one; the array has a mounting R, a lever and a clock (see `imu.sensor`
and `imu.clock`). The clock's offset and rate change a little from log to log. A
gyro may be later than the accelerometers: the filters of the two inside one chip delay
them differently.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.imu.array import layout
from seqid_cli.imu.clock import Clock
from seqid_cli.imu.sensor import Mounting, constant_slopes
from seqid_cli.imu.sensor import Places as SensorPlaces
from seqid_cli.robot.kinematics import turned_by
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array, Index

FEW = 6  # accelerometers below which the widths stay as they begin


@dataclass(frozen=True)
class Widths:
    """Standard deviations of the priors whose widths come from the data.

    They are those of gains, of tilts [rad] and of changes of a bias, (C,) each, that of
    the clock's rate (1,) [s/s], and those of its offset [s] and rate from log to log,
    (2,).
    """

    gain: Array
    tilt: Array
    drift: Array
    rate: Array
    clock: Array


@dataclass(frozen=True)
class Places(SensorPlaces):
    """Where the constants of an IMU with C channels stand among all p.

    Those of `imu.sensor` come first, each channel's axis by its gain and its tilts, and
    the gyro's delay. Two of each log follow: by how much the offset and the rate of the
    clock are larger in it.
    """

    @property
    def gain(self) -> slice:
        """The places of the gains (C,)."""
        return slice(self.head, self.head + self.channels)

    @property
    def tilt(self) -> slice:
        """The places of the tilts (2 C,)."""
        first = self.head + self.channels
        return slice(first, first + 2 * self.channels)

    @property
    def gyro_delay(self) -> int:
        """The place of the gyro's delay."""
        return self.head + 3 * self.channels

    @property
    def shared(self) -> int:
        """The number of constants that all logs share."""
        return self.gyro_delay + 1

    def of_log(self, k: int) -> Index:
        """Return the places (shared + 2,) of the constants that log k knows."""
        own = self.shared + 2 * k
        return np.concatenate([np.arange(self.shared), [own, own + 1]])


def first_widths(
    c: int,
    logs: int,
    *,
    gain: float = 0.02,
    tilt: float = 0.01,
    drift: float = 0.02,
    rate: float = 0.01,
    offset_apart_s: float = 0.02,
    rate_apart: float = 1e-3,
    single: float = 1e-3,
) -> Widths:
    """Return the first widths of the priors, for `c` channels and some logs.

    A single log does not tell its own clock from that of all: its changes are held to a
    share `single` of the widths.
    """
    share = 1.0 if logs > 1 else single
    return Widths(
        gain=np.full(c, gain),
        tilt=np.full(c, tilt),
        drift=np.full(c, drift),
        rate=np.array([rate]),
        clock=share * np.array([offset_apart_s, rate_apart]),
    )


def prior_of(
    widths: Widths,
    logs: int,
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
    logs : int
        Number of logs.
    lever, delay, bias, gyro_delay : float
        Standard deviations of the lever [m], of the clock's offset [s], of biases
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
            widths.rate,
            np.full(len(widths.gain), bias),
            widths.gain,
            np.repeat(widths.tilt, 2),
            [gyro_delay],
            np.tile(widths.clock, logs),
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
        Offset of the IMU's clock to the encoders as a log begins, on average [s].
    bias : array (C,)
        Biases [m/s^2 or rad/s].
    log_gain : array (C,)
        Logarithms of the gains.
    tilt : array (C, 2)
        Turns of the axes from the nominal ones [rad].
    gyro_delay : float
        Delay of the gyro behind the accelerometers [s].
    rate : float
        By which the IMU's clock gains on the encoders', on average [s/s].
    logs : tuple of int
        Numbers of the L logs.
    clock_changes : array (L, 2)
        By how much offset [s] and rate [s/s] are larger in each log.
    """

    R: Array
    lever: Array
    delay: float
    bias: Array
    log_gain: Array
    tilt: Array
    gyro_delay: float = 0.0
    rate: float = 0.0
    logs: tuple[int, ...]
    clock_changes: Array

    @property
    def places(self) -> Places:
        """Where each constant stands in `values`."""
        return Places(len(self.bias))

    def places_of(self, log: int) -> Index:
        """Return the places of the constants that readings of a log depend on."""
        return self.places.of_log(self.logs.index(log))

    def clock(self, log: int) -> Clock:
        """Return the clock of a log, by its number."""
        offset_s, rate = self.clock_changes[self.logs.index(log)].tolist()
        return Clock(self.delay + offset_s, self.rate + rate)

    @property
    def values(self) -> Array:
        """The constants as a vector (p,) in the order of `Places`, the turn zero."""
        turn = np.zeros(3)
        return np.concatenate(
            [
                turn,
                self.lever,
                [self.delay, self.rate],
                self.bias,
                self.log_gain,
                self.tilt.ravel(),
                [self.gyro_delay],
                self.clock_changes.ravel(),
            ]
        )

    @property
    def count(self) -> int:
        """Number of constants, p."""
        return len(self.values)

    def moved(self, step: Array) -> "Constants":
        """Return the constants after a step (p,)."""
        at = self.places
        return Constants(
            R=turned_by(step[at.turn]) @ self.R,
            lever=self.lever + step[at.lever],
            delay=self.delay + float(step[at.delay]),
            bias=self.bias + step[at.bias],
            log_gain=self.log_gain + step[at.gain],
            tilt=self.tilt + step[at.tilt].reshape(-1, 2),
            gyro_delay=self.gyro_delay + float(step[at.gyro_delay]),
            rate=self.rate + float(step[at.rate]),
            logs=self.logs,
            clock_changes=self.clock_changes + step[at.shared :].reshape(-1, 2),
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
    first = Places(len(nominal_axes(imu))).tilt.start
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


def design(
    imu: Imu, constants: Constants, x: Array, dy: Array, t: Array, rate: float = 0.0
) -> Array:
    """Return the derivatives of readings in the constants that one log knows.

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
    t : array (N,)
        Seconds since the log began.
    rate : float
        Of the log's clock [s/s].

    Returns
    -------
    array (N, C, shared + 2)
        Derivatives, in the order of `Places.of_log`.
    """
    place = mounted(imu, constants)
    slopes = constant_slopes(place, x, dy, t, rate)
    across = _tangents(nominal_axes(imu)) @ constants.R.T
    at = constants.places
    G = np.zeros((*dy.shape, at.shared + 2))
    gyros = slice(len(imu.axes), None)
    G[:, :, : at.head] = slopes.head
    G[:, :, at.shared] = slopes.by_offset
    G[:, :, at.shared + 1] = slopes.by_rate
    G[:, gyros, at.gyro_delay] = slopes.by_offset[:, gyros]

    # A channel's reading depends on its own axis alone.
    channel = np.arange(place.channels)
    by_gain = np.sum(slopes.by_axis * (place.axes @ place.R.T), axis=2)
    G[:, channel, at.gain.start + channel] = by_gain
    sideways = np.exp(constants.log_gain)[:, None] * np.einsum(
        "nci,cai->nca", slopes.by_axis, across
    )
    for a in range(2):
        G[:, channel, at.tilt.start + 2 * channel + a] = sideways[:, :, a]
    return G
