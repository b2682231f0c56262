"""The readings of an IMU on a link, by the joints' motion and by its mounting.

Symbols: `x` (N, 15) is a link's motion in its own frame: f (3) specific force of its
origin, H (9) with f + H r the specific force at r, w (3) its angular velocity. With u
the sensing axes in that frame, as long as the channels' gains, and p the
accelerometers' places,

    accelerometers:  y = u'(f + H p),        gyro:  y = u'w.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seqid_cli.robot.kinematics import cross, link_motion
from seqid_cli.robot.types import Chain, Robot
from seqid_cli.typing import Array

MOTION = 15  # f, H, w


@dataclass(frozen=True)
class Mounting:
    """An IMU of k accelerometers on its link, C channels with those of its gyro.

    Attributes
    ----------
    link : int
    positions : Array
        (k, 3) m, of the accelerometers in the IMU's frame.
    axes : Array
        (C, 3), sensing axes of all channels in the IMU's frame, as long as their gains;
        accelerometers first.
    R : Array
        (3, 3), from the IMU's frame to the link's.
    lever : Array
        (3,) m, the IMU's origin in the link's frame.
    """

    link: int
    positions: Array
    axes: Array
    R: Array
    lever: Array

    @property
    def channels(self) -> int:
        """Number of readings, C."""
        return len(self.axes)

    @property
    def _sensing_axes(self) -> Array:
        """U (C, 3), in the link's frame."""
        return self.axes @ self.R.T

    @property
    def _places(self) -> Array:
        """P (k, 3) m, in the link's frame."""
        return self.lever + self.positions @ self.R.T

    @property
    def matrix(self) -> Array:
        """Readings (C, 15) per the link's motion x."""
        u = self._sensing_axes
        p = self._places
        k = len(p)
        A = np.zeros((len(u), MOTION))
        A[:k, :3] = u[:k]
        A[:k, 3:12] = (u[:k, :, None] * p[:, None, :]).reshape(k, 9)
        A[k:, 12:] = u[k:]
        return A

    def by_motion(self, x: Array, slopes: Array) -> Array:
        """Compute the derivatives of the readings by the joints' motion.

        Parameters
        ----------
        x : Array
            Motion (N, 15) of the link.
        slopes : Array
            (N, 9, 3 m), as `link_slopes` returns them.

        Returns
        -------
        Array
            (N, C, 3, m), by q, dq, ddq of m joints.
        """
        u = self._sensing_axes
        p = self._places
        k = len(p)
        w = x[:, 12:]

        # u'(w x (w x p)) is w'(u p') w - u'p w'w: a quadratic form, whose slope by w is
        # Q w.
        outer = u[:k, :, None] * p[:, None, :]
        Q = outer + outer.transpose(0, 2, 1)
        Q -= 2 * np.einsum("kaa->k", outer)[:, None, None] * np.eye(3)

        # Readings by f, dw and w of the link.
        rows = np.zeros((len(x), len(u), 9))
        rows[:, :k, :3] = u[:k]
        rows[:, :k, 3:6] = np.cross(p, u[:k])
        rows[:, :k, 6:] = np.einsum("kab,nb->nka", Q, w)
        rows[:, k:, 6:] = u[k:]
        by_joints = (rows @ slopes).reshape(*rows.shape[:2], -1, 3)
        return by_joints.swapaxes(2, 3)

    def by_place(self, x: Array) -> tuple[Array, Array, Array]:
        """Compute the derivatives (N, C, 3) of the readings by the mounting.

        They are by each channel's own axis, by the lever [m] and by a turn of the IMU
        [rad], all in the link's frame; x (N, 15) is the link's motion.
        """
        u = self._sensing_axes
        k = len(self.positions)
        from_origin = np.zeros_like(u)
        from_origin[:k] = self.positions @ self.R.T
        f = x[:, :3]
        H = x[:, 3:12].reshape(-1, 3, 3)
        w = x[:, 12:]

        # The vector that each channel reads a component of: that is the slope by its
        # axis.
        by_axis = np.repeat(w[:, None], len(u), axis=1)
        places = self.lever + from_origin[:k]
        by_axis[:, :k] = f[:, None] + places @ H.transpose(0, 2, 1)

        by_lever = np.zeros_like(by_axis)
        by_lever[:, :k] = u[:k] @ H
        by_turn = np.cross(u, by_axis) + np.cross(from_origin, by_lever)
        return by_axis, by_lever, by_turn


@dataclass(frozen=True)
class Places:
    """Where the constants of an IMU with L channels stand in a vector of them.

    They are a turn [rad] and the lever [m] in the link's frame, offset [s] and rate
    [s/s] of the clock, and the biases (L). What is of the channels' axes comes behind.
    """

    channels: int

    turn = slice(0, 3)
    lever = slice(3, 6)
    delay = 6
    rate = 7
    clock = slice(6, 8)

    @property
    def bias(self) -> slice:
        """The places of the biases (L,)."""
        return slice(8, 8 + self.channels)

    @property
    def head(self) -> int:
        """The number of these constants."""
        return 8 + self.channels


class ConstantSlopes(NamedTuple):
    """Derivatives of readings by an IMU's constants.

    `head` (N, L, 8 + L) are in the order of `Places`. Those by the clock alone are
    `by_offset` and `by_rate` (N, L), those by each channel's own axis in the link's
    frame `by_axis` (N, L, 3).
    """

    head: Array
    by_offset: Array
    by_rate: Array
    by_axis: Array


def constant_slopes(
    place: Mounting, x: Array, dy: Array, t: Array, rate: float
) -> ConstantSlopes:
    """Compute the derivatives of readings by the constants of an IMU.

    Parameters
    ----------
    place : Mounting
    x : Array
        Motion (N, 15) of the link.
    dy : Array
        Rate (N, L) of the readings [their unit per s].
    t : Array
        (N,) s, from the instant at which the clock's offset is meant.
    rate : float
        Of the clock [s/s].
    """
    by_axis, by_lever, by_turn = place.by_place(x)
    # What is felt at t has the stamp t + offset + rate t. With a larger offset, a
    # reading was felt that much earlier.
    by_offset = -dy / (1.0 + rate)
    by_rate = by_offset * t[:, None]
    by_bias = np.broadcast_to(np.eye(place.channels), (*dy.shape, place.channels))
    parts = [by_turn, by_lever, by_offset[:, :, None], by_rate[:, :, None], by_bias]
    head = np.concatenate(parts, axis=2)
    return ConstantSlopes(head, by_offset, by_rate, by_axis)


def _head(chain: Chain, count: int) -> Chain:
    """Return the first joints of a chain alone."""
    first = slice(count)
    return Chain(
        rotation=chain.rotation[first],
        position=chain.position[first],
        axis=chain.axis[first],
        prismatic=chain.prismatic[first],
    )


def link_state(robot: Robot, link: int, motion: Array) -> Array:
    """Compute the motion x (N, 15) of a link by q, dq, ddq (3, n, N) of the joints."""
    q, dq, ddq = motion[:, : link + 1]
    links = link_motion(_head(robot.chain, link + 1), robot.gravity, q, dq, ddq)
    return np.vstack([links.a[-1], links.H[-1].reshape(9, -1), links.w[-1]]).T


def link_slopes(robot: Robot, link: int, motion: Array) -> Array:
    """Compute the derivatives of a link's f, dw, w by the joints' motion.

    They are carried on from link to link as the motion itself is (`link_motion`).

    Parameters
    ----------
    robot : Robot
    link : int
    motion : Array
        q, dq, ddq (3, n, N) of the joints.

    Returns
    -------
    Array
        (N, 9, 3 m), of m = link + 1 joints, one after the other q, dq, ddq of each.
    """
    head = _head(robot.chain, link + 1)
    q, dq, ddq = motion[:, : link + 1]
    links = link_motion(head, robot.gravity, q, dq, ddq)

    D = np.zeros((motion.shape[2], 9, 3 * head.n))
    for i, axis in enumerate(head.axis):
        z = axis[:, None]
        slides = head.prismatic[i]

        # Angular motion of the link before, in this link's frame.
        w = links.w[i]
        dw = links.dw[i]
        if not slides:
            w = w - z * dq[i]
        across = cross(w, z)
        if not slides:
            dw = dw - (z * ddq[i] + across * dq[i])

        # The slopes by the motion of the joints before.
        if i:
            step = np.zeros((len(D), 9, 9))
            R = links.R[i].transpose(2, 1, 0)
            p = links.p[i]
            w_before = links.w[i - 1]
            step[:, :3, :3] = R
            step[:, 3:6, 3:6] = R
            step[:, 6:, 6:] = R
            step[:, :3, 3:6] = -R @ _skew(p)
            turned = _skew(cross(w_before, p)) + _skew(w_before) @ _skew(p)
            step[:, :3, 6:] = -R @ turned
            # The joint's own rate turns with w: of a slide twice (Coriolis), in f.
            passed = _skew(z * dq[i]) @ R
            if slides:
                step[:, :3, 6:] -= 2 * passed
            else:
                step[:, 3:6, 6:] -= passed
            D[:, :, : 3 * i] = step @ D[:, :, : 3 * i]

        # The slopes of f, dw, w by the joint's own q, dq, ddq.
        new = np.zeros((3, 3, 3, len(D)))
        if slides:
            new[0, 0] = cross(dw, z) + cross(w, across)
            new[0, 1] = 2 * across
            new[0, 2] = z
        else:
            new[0, 0] = cross(links.a[i], z)
            new[1, 0] = cross(dw, z) + cross(across, z) * dq[i]
            new[1, 1] = across
            new[1, 2] = z
            new[2, 0] = across
            new[2, 1] = z
        D[:, :, 3 * i : 3 * i + 3] = new.transpose(3, 0, 2, 1).reshape(-1, 9, 3)
    return D


def _skew(v: Array) -> Array:
    """Return the matrices (N, 3, 3) of the cross product with v (3, N)."""
    x, y, z = v
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.array(rows).transpose(2, 0, 1)
