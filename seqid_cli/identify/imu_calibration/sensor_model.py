"""The readings of a mounted IMU as a function of its constants and of the arm's motion.

Symbols: `x` (N, 15) is a link's motion in its own frame: f (3) specific force of its origin, H (9)
with f + H r the specific force at r, w (3) its angular velocity. Accelerometer k of the array has
the gain g_k, the unit axis s_k and the place r_k in the IMU's frame, R the mounting, l the lever:

    y_k = g_k (R s_k)'(f + H (l + R r_k)) + b_k,        gyro:  y_k = g_k (R s_k)'w + b_k.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.motion.imu.array import layout
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array

FEW = 6  # accelerometers below which the widths stay as they begin


@dataclass(frozen=True)
class Widths:
    """Standard deviations of the priors on gains, tilts (rad) and bias changes, per channel."""

    gain: Array
    tilt: Array
    drift: Array


def first_widths(
    count: int, *, gain: float = 0.02, tilt: float = 0.01, drift: float = 0.02
) -> Widths:
    """Widths to begin with."""
    return Widths(*(np.full(count, width) for width in (gain, tilt, drift)))


def prior_of(widths: Widths, *, lever: float = 1.0, delay: float = 0.3, bias: float = 3.0) -> Array:
    """Prior standard deviations (p,) of the constants; m, s, and m/s^2 or rad/s."""
    wide = np.full(len(widths.gain), bias), widths.gain, np.repeat(widths.tilt, 2)
    return np.concatenate([[np.pi] * 3, [lever] * 3, [delay], *wide])


def values_of(c: "Constants") -> Array:
    """Constants as a vector (p,), the rotation's part zero."""
    return np.concatenate([np.zeros(3), c.lever, [c.delay], c.bias, c.log_gain, c.tilt.ravel()])


def own_precision(segment: Segment, widths: Widths) -> Array:
    """Precision of the priors on a segment's bias changes and offsets."""
    return np.concatenate([widths.drift, segment.offset_sigma]) ** -2.0


def gauge_information(imu: Imu, count: int, p: int, *, hold: float = 1e-6) -> Array:
    """Hold the accelerometers' common turn, to so many rad, where only the mounting shows it."""
    if layout(imu).acceleration:
        return np.zeros((p, p))
    axes, _, k = channels_of(imu)
    across = tangents(axes[:k])
    rows = np.zeros((3, p))
    for a in range(2):
        turns = np.cross(axes[:k], across[:, a])
        rows[:, 7 + 2 * count + a : 7 + 2 * count + 2 * k : 2] = turns.T / k
    return rows.T @ rows / hold**2


def next_width(
    values: Array, left_open: Array, width: Array, *, least: float = 1e-4, most_change: float = 5.0
) -> float:
    """Next standard deviation of a prior that `values` come from (MacKay's fixed point)."""
    known = np.maximum(1.0 - left_open / width**2, 0.0)
    found = float(np.sqrt(np.sum(values**2) / max(float(np.sum(known)), 1.0)))
    largest = float(np.max(width))
    return float(np.clip(found, max(least, largest / most_change), largest * most_change))


MOTION = 15  # f, H, w


@dataclass(frozen=True)
class Constants:
    """Everything that the calibration finds; C channels, accelerometers first, then the gyro.

    `tilt` (C, 2) rad turns each axis about two directions across it.
    """

    R: Array
    lever: Array
    delay: float
    bias: Array
    log_gain: Array
    tilt: Array

    def moved(self, step: Array) -> "Constants":
        """Constants after a step of `names_of` order: turn, lever, delay, bias, gain, tilt."""
        c = len(self.bias)
        turn, rest = step[:3], step[7:]
        return Constants(
            R=Rotation.from_rotvec(turn).as_matrix() @ self.R,
            lever=self.lever + step[3:6],
            delay=self.delay + float(step[6]),
            bias=self.bias + rest[:c],
            log_gain=self.log_gain + rest[c : 2 * c],
            tilt=self.tilt + rest[2 * c :].reshape(c, 2),
        )


def channels_of(imu: Imu) -> tuple[Array, Array, int]:
    """Nominal axes (C, 3), places (C, 3) and the number of accelerometers."""
    axes, places = imu.axes.reshape(-1, 3), imu.positions.reshape(-1, 3)
    if not imu.gyro:
        return axes, places, len(axes)
    return np.vstack([axes, np.eye(3)]), np.vstack([places, np.zeros((3, 3))]), len(axes)


def first_constants(imu: Imu) -> Constants:
    """Nominal constants, mounted at the link's own frame."""
    count = len(channels_of(imu)[0])
    none = np.zeros(count)
    return Constants(np.eye(3), np.zeros(3), 0.0, none, none, np.zeros((count, 2)))


def tangents(axes: Array) -> Array:
    """Two unit directions (C, 2, 3) across each axis."""
    helper = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first)], axis=1)


def tilted(axes: Array, tilt: Array) -> Array:
    """Unit axes (C, 3) after small tilts (C, 2)."""
    moved = axes + np.einsum("ca,cai->ci", tilt, tangents(axes))
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def link_state(robot: Robot, link: int, q: Array, dq: Array, ddq: Array) -> Array:
    """Motion (N, 15) of a link from the joints' (N, n)."""
    motion = link_motion(robot.chain, robot.gravity, q.T, dq.T, ddq.T)
    H = motion.H[link].reshape(9, -1)
    return np.ascontiguousarray(np.vstack([motion.a[link], H, motion.w[link]]).T)


def link_state_slopes(
    robot: Robot, link: int, motion: tuple[Array, Array, Array], joints: tuple[int, ...], kind: int
) -> Array:
    """Derivatives (N, 15, m) of a link's motion in q, dq or ddq (`kind` 0, 1, 2) of some joints.

    By central differences: exact in dq and ddq, in which the motion is quadratic and linear.
    """
    slopes = np.empty((len(motion[0]), MOTION, len(joints)))
    h = (1e-5, 1.0, 1.0)[kind]
    for column, j in enumerate(joints):
        sides = []
        for sign in (1.0, -1.0):
            x = list(motion)
            x[kind] = x[kind].copy()
            x[kind][:, j] += sign * h
            sides.append(link_state(robot, link, *x))
        slopes[:, :, column] = (sides[0] - sides[1]) / (2 * h)
    return slopes


@dataclass(frozen=True)
class Channels:
    """Channels at given constants: axes (C, 3) and places (C, 3) in the link's frame."""

    axes: Array
    reach: Array  # R r, of the IMU's origin
    lever: Array
    gain: Array
    bias: Array
    accelerometers: int
    across: Array  # (C, 2, 3)

    @property
    def matrix(self) -> Array:
        """Readings without bias as a linear map (C, 15) of a link's motion."""
        places = self.lever + self.reach[: self.accelerometers]
        return self.gain[:, None] * matrix_of(self.axes, places)


def matrix_of(axes: Array, places: Array) -> Array:
    """Readings (C, 15) of a link's motion along axes (C, 3), accelerometers at places (k, 3)."""
    k = len(places)
    A = np.zeros((len(axes), MOTION))
    A[:k, :3], A[k:, 12:] = axes[:k], axes[k:]
    A[:k, 3:12] = (axes[:k, :, None] * places[:, None, :]).reshape(k, 9)
    return A


def mounted(imu: Imu, constants: Constants) -> Channels:
    """Channels of an IMU at these constants."""
    axes, places, count = channels_of(imu)
    R = constants.R
    return Channels(
        axes=tilted(axes, constants.tilt) @ R.T,
        reach=places @ R.T,
        lever=constants.lever,
        gain=np.exp(constants.log_gain),
        bias=constants.bias,
        accelerometers=count,
        across=np.einsum("ij,caj->cai", R, tangents(axes)),
    )


def predicted(channels: Channels, x: Array) -> Array:
    """Readings (N, C)."""
    return np.asarray(x @ channels.matrix.T + channels.bias)


def design(channels: Channels, x: Array, dy: Array) -> Array:
    """Derivatives (N, C, 7 + 4 C) of the readings in the constants; `dy` (N, C) their rate [1/s].

    A delayed stamp is a later reading: the measured value at t + delay is compared with the
    prediction at t, so the derivative in the delay is that of the reading, with its sign turned.
    """
    n, c = len(x), len(channels.axes)
    k = channels.accelerometers
    f, H, w = x[:, :3], x[:, 3:12].reshape(n, 3, 3), x[:, 12:]
    u, g = channels.axes, channels.gain
    seen = np.broadcast_to(w[:, None], (n, c, 3)).copy()
    seen[:, :k] = f[:, None] + (channels.lever + channels.reach[:k]) @ H.transpose(0, 2, 1)
    pull = np.zeros((n, c, 3))
    pull[:, :k] = u[:k] @ H  # H'u
    G = np.zeros((n, c, 7 + 4 * c))
    G[:, :, :3] = np.cross(u, seen) + np.cross(channels.reach, pull)
    G[:, :, 3:6] = pull
    G[:, :, :6] *= g[:, None]
    G[:, :, 6] = -dy
    own = np.arange(c)
    G[:, own, 7 + own] = 1.0
    G[:, own, 7 + c + own] = g * np.einsum("nci,ci->nc", seen, u)
    sideways = g[:, None] * np.einsum("nci,cai->nca", seen, channels.across)
    for a in range(2):
        G[:, own, 7 + 2 * c + 2 * own + a] = sideways[:, :, a]
    return G
