"""Rows of links against their motors, for effects that turn one without the other.

Of every sample at which a joint's torque counts, the IMUs behind the joint have a row
for it: the component of what they read beyond the encoders (`effects.link_readings`)
that an acceleration of its link would make. With W the inverse noise of the readings,
A (C, n) their slopes by the accelerations of the joints, and W A = Q R,

    y = Q' W r,        X = Q' W (dh/dq x + dh/ddq' x' + dh/ddq x''),

x the angle of the link beyond its encoder per unit of an effect. Q is orthonormal: rows
have the noise of the readings and of the encoders, and nothing that joints could do is
lost. What errors of the calibration make, G c with c ~ N(0, P^-1), is taken off rows
and columns,

    y <- y - G (G'G + P)^-1 G'y.

In shapes, M_j is the number of rows of joint j, n that of joints, C that of the
channels of all IMUs, and g that of the calibrations' constants.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.discover.survey.rows import Rows
from seqid_cli.effects.link_readings import LinkReadings
from seqid_cli.effects.scene import Scene
from seqid_cli.imu.sensor import constant_slopes, link_slopes, link_state
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.robust import rms
from seqid_cli.typing import Array, Index

KIND = 3  # of channels: those of joints below and above the cut-off and drives precede
LOOSER = 2.0  # standard errors of a calibration that was made on a joint that bends
# RMS over the noise, from which a link does otherwise than its encoder says.
BENDS = 1.6
# Share of the largest slope by any joint, below which no IMU sees a joint.
UNSEEN = 1e-3


@dataclass(frozen=True, kw_only=True)
class _SceneLinks:
    """The IMUs of one log at its kept samples, M of them.

    Attributes
    ----------
    slopes : Array
        (M, C, 3, n), by q, dq, ddq of the joints, over the noise.
    components : Array
        Q' (M, n, C).
    y : Array
        (M, n).
    errors : Array
        Q' W G (M, n, g).
    """

    slopes: Array
    components: Array
    y: Array
    errors: Array


@dataclass(frozen=True, kw_only=True)
class LinkRows:
    """Rows of every joint with an IMU behind it.

    Attributes
    ----------
    rows : Rows
        Which samples count.
    y : tuple of (M_j,) arrays
        In standard deviations of the readings' noise; empty where no IMU sees the
        joint, and all of it where a log has no IMU.
    """

    rows: Rows
    y: tuple[Array, ...] = ()
    _by_scene: tuple[_SceneLinks, ...] = ()
    _errors: Array | None = None
    _gain: Array | None = None

    def of(self, joint: int) -> bool:
        """Return whether a joint has such rows."""
        return bool(self.y) and len(self.y[joint]) > 0

    def columns(self, joint: int, angles: Sequence[Array]) -> dict[int, Array]:
        """Return the columns of an effect on the rows of all joints that see it.

        Parameters
        ----------
        joint : int
            The joint that the effect turns.
        angles : sequence of (N, k) arrays
            By data set, the angle [rad; m where prismatic] of the link beyond its
            encoder per unit coefficient.

        Returns
        -------
        dict of int to (M_j, k) array
            By channel.
        """
        per_scene = []
        for scene, samples, links, x in zip(
            self.rows.scenes, self.rows.samples, self._by_scene, angles, strict=True
        ):
            motion = scene.motion
            dx, ddx = differentiate(x, motion.rate_hz, motion.valid)
            moved = np.stack([x[samples], dx[samples], ddx[samples]], axis=1)
            read = links.slopes[:, :, :, joint] @ moved
            per_scene.append(links.components @ read)
        by_joint = [
            self.rows.of_kept(j, [values[:, j] for values in per_scene])
            for j in range(self.rows.n)
        ]
        by_joint = [
            columns if self.of(j) else columns[:0] for j, columns in enumerate(by_joint)
        ]
        without_errors = self._without_errors(by_joint)
        return {
            KIND * self.rows.n + j: columns
            for j, columns in enumerate(without_errors)
            if len(columns)
        }

    def _without_errors(self, by_joint: Sequence[Array]) -> list[Array]:
        """Take off what errors of calibrations explain of rows (M_j, k) by joint."""
        assert self._errors is not None
        assert self._gain is not None
        stacked = np.concatenate(by_joint)
        stacked = stacked - self._errors @ (self._gain @ stacked)
        ends = np.cumsum([len(of_joint) for of_joint in by_joint])
        return np.split(stacked, ends[:-1])


def link_rows(rows: Rows) -> LinkRows:
    """Take the rows of links where all logs have the same calibrated IMUs."""
    nothing = LinkRows(rows=rows)
    readings = [scene.links for scene in rows.scenes]
    mounted = [tuple(imu.place.link for imu in of_log) for of_log in readings]
    if not mounted[0] or len(set(mounted)) > 1:
        return nothing

    by_scene = tuple(
        _scene_links(rows, scene, samples)
        for scene, samples in zip(rows.scenes, rows.samples, strict=True)
    )
    last_link = max(mounted[0])
    precision = np.concatenate([imu.precision for imu in readings[0]]) / LOOSER**2
    seen = [joint for joint in range(rows.n) if joint <= last_link]
    all_seen = _of_joints(rows, by_scene, seen, precision)

    # A link that does what its encoder says tells nothing but noise, of which that of
    # the encoder is in the columns as well: it would pass for a gear that is stiffer.
    bending = [joint for joint in seen if rms(all_seen.y[joint]) > BENDS]
    if not bending:
        return nothing
    return _of_joints(rows, by_scene, bending, precision)


def _of_joints(
    rows: Rows, by_scene: tuple[_SceneLinks, ...], joints: Sequence[int], P: Array
) -> LinkRows:
    """Take the rows of some joints, P (g,) being the precision of the constants."""
    y = []
    errors = []
    for joint in range(rows.n):
        of_joint = rows.of_kept(joint, [links.y[:, joint] for links in by_scene])
        with_errors = rows.of_kept(
            joint, [links.errors[:, joint] for links in by_scene]
        )
        n_rows = len(of_joint) if joint in joints else 0
        y.append(of_joint[:n_rows])
        errors.append(with_errors[:n_rows])

    G = np.concatenate(errors)
    gain: Array = np.asarray(np.linalg.solve(G.T @ G + np.diag(P), G.T))
    raw = LinkRows(rows=rows, y=tuple(y), _by_scene=by_scene, _errors=G, _gain=gain)
    cleaned = raw._without_errors([of_joint[:, None] for of_joint in y])
    return replace(raw, y=tuple(of_joint[:, 0] for of_joint in cleaned))


def _scene_links(rows: Rows, scene: Scene, samples: Index) -> _SceneLinks:
    """Compute slopes and components at the kept samples of a log."""
    robot = scene.robot
    imus = scene.links
    slopes = np.concatenate([_slopes(imu, robot.n, samples, rows) for imu in imus], 1)
    residual = np.concatenate([imu.residual[samples] / imu.noise for imu in imus], 1)
    of_imus = [_calibration_errors(imu, samples, rows) for imu in imus]

    # What the encoders' noise makes of the expected readings is noise as well.
    motion = scene.motion
    of_encoders = np.mean(slopes[:, :, 2] ** 2, axis=0) @ (
        motion.cutoff.acceleration_noise**2
    )
    larger = np.sqrt(1.0 + of_encoders)
    slopes = slopes / larger[:, None, None]
    residual = residual / larger

    components = _components(slopes[:, :, 2])

    # The constants of one IMU make nothing in the readings of another.
    errors = []
    first = 0
    for of_imu in of_imus:
        channels = slice(first, first + of_imu.shape[1])
        scaled = of_imu / larger[channels][:, None]
        errors.append(components[:, :, channels] @ scaled)
        first = channels.stop
    return _SceneLinks(
        slopes=slopes,
        components=components,
        y=np.einsum("mjc,mc->mj", components, residual),
        errors=np.concatenate(errors, axis=2),
    )


def _components(by_acceleration: Array) -> Array:
    """Return Q' (M, n, C) of slopes (M, C, n), zero for joints that no IMU sees.

    Joints behind an IMU do not move it. Of more joints than channels the first ones are
    seen.
    """
    n_channels, n = by_acceleration.shape[1:]
    lacking = max(n - n_channels, 0)
    padded = np.pad(by_acceleration, ((0, 0), (0, lacking), (0, 0)))
    Q, R = np.linalg.qr(padded)
    sizes = np.abs(np.einsum("mii->mi", R))
    is_seen = sizes > UNSEEN * sizes.max(axis=1, keepdims=True)
    components = np.where(is_seen[:, :, None], Q.swapaxes(1, 2), 0.0)
    return np.asarray(components[:, :, :n_channels])


def _slopes(imu: LinkReadings, n: int, samples: Index, rows: Rows) -> Array:
    """Return the slopes (M, C, 3, n) of readings by the joints' motion."""
    robot = rows.scenes[0].robot
    motion = imu.motion[:, :, samples]
    x = link_state(robot, imu.place.link, motion)
    by_motion = imu.place.by_motion(x, link_slopes(robot, imu.place.link, motion))
    k = len(imu.place.positions)

    # The derivative of an angular velocity goes with the acceleration as the velocity
    # goes with the rate.
    of_gyro = by_motion[:, k:].copy()
    by_motion[:, k:] = 0.0
    by_motion[:, k:, 2] = of_gyro[:, :, 1]
    slopes = np.zeros((*by_motion.shape[:3], n))
    slopes[..., : by_motion.shape[3]] = by_motion
    return np.asarray(slopes / imu.noise[:, None, None])


def _calibration_errors(imu: LinkReadings, samples: Index, rows: Rows) -> Array:
    """Return the slopes (M, C, g) of readings by the constants of a calibration."""
    robot = rows.scenes[0].robot
    place = imu.place
    k = len(place.positions)
    x = link_state(robot, place.link, imu.motion[:, :, samples])
    t = imu.from_middle[samples]
    rate = imu.rate[samples]
    by_constants = constant_slopes(place, x, rate, t, 0.0)

    # Readings of a gyro are linear in w: their derivatives are those of w'.
    turning = x.copy()
    turning[:, 12:] = imu.turning[samples]
    of_gyro = constant_slopes(place, turning, rate, t, 0.0)
    head = by_constants.head.copy()
    head[:, k:] = of_gyro.head[:, k:]
    by_axis = by_constants.by_axis.copy()
    by_axis[:, k:] = of_gyro.by_axis[:, k:]

    channels = place.channels
    axes = np.zeros((len(samples), channels, channels, 3))
    axes[:, range(channels), range(channels)] = by_axis
    errors = np.concatenate([head, axes.reshape(len(samples), channels, -1)], axis=2)
    return np.asarray(errors / imu.noise[:, None])
