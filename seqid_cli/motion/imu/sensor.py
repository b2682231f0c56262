"""The readings of an IMU on a link, as a function of the joints' motion and of where it sits.

Symbols: `x` (N, 15) is a link's motion in its own frame: f (3) specific force of its
origin, H (9) with f + H r the specific force at r, w (3) its angular velocity. With u
the sensing axes in that frame, as long as the channels' gains, and p the
accelerometers' places,

    accelerometers:  y = u'(f + H p),        gyro:  y = u'w.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.robot.kinematics import cross, link_motion
from seqid_cli.robot.types import Chain, Robot
from seqid_cli.typing import Array

MOTION = 15  # f, H, w


@dataclass(frozen=True)
class Mounting:
    """An IMU on its link: accelerometers in its frame, then its gyro."""

    link: int
    positions: Array  # (k, 3) m
    axes: Array  # (C, 3) of all channels in its frame, as long as their gains
    R: Array  # (3, 3) from the IMU to the link
    lever: Array  # (3,) m, the IMU's origin in the link's frame

    @property
    def channels(self) -> int:
        """Number of readings."""
        return len(self.axes)

    @property
    def matrix(self) -> Array:
        """Readings (C, 15) of the link's motion."""
        u, k = self.axes @ self.R.T, len(self.positions)
        places = self.lever + self.positions @ self.R.T
        A = np.zeros((len(u), MOTION))
        A[:k, :3], A[k:, 12:] = u[:k], u[k:]
        A[:k, 3:12] = (u[:k, :, None] * places[:, None, :]).reshape(k, 9)
        return A

    def by_motion(self, x: Array, slopes: Array) -> Array:
        """Derivatives (N, C, 3, m) of readings in q, dq, ddq, by the link's `link_slopes`."""
        u, k = self.axes @ self.R.T, len(self.positions)
        places = self.lever + self.positions @ self.R.T
        outer = u[:k, :, None] * places[:, None, :]
        Q = outer + outer.transpose(0, 2, 1)
        Q -= 2 * np.einsum("kaa->k", outer)[:, None, None] * np.eye(3)
        rows = np.zeros((len(x), len(u), 9))
        rows[:, :k, :3], rows[:, :k, 3:6] = u[:k], np.cross(places, u[:k])
        rows[:, :k, 6:] = np.einsum("kab,nb->nka", Q, x[:, 12:])
        rows[:, k:, 6:] = u[k:]
        return (rows @ slopes).reshape(*rows.shape[:2], -1, 3).swapaxes(2, 3)

    def by_place(self, x: Array) -> tuple[Array, Array, Array]:
        """Derivatives (N, C, 3) in own axis, lever and a turn [rad], all in the link's frame."""
        u, k = self.axes @ self.R.T, len(self.positions)
        reach = np.zeros_like(u)
        reach[:k] = self.positions @ self.R.T
        H = x[:, 3:12].reshape(-1, 3, 3)
        seen = np.repeat(x[:, None, 12:], len(u), axis=1)
        seen[:, :k] = x[:, None, :3] + (self.lever + reach[:k]) @ H.transpose(0, 2, 1)
        pull = np.zeros_like(seen)
        pull[:, :k] = u[:k] @ H
        return seen, pull, np.cross(u, seen) + np.cross(reach, pull)


def _head(chain: Chain, count: int) -> Chain:
    """The first joints alone."""
    own = slice(count)
    return Chain(
        chain.rotation[own], chain.position[own], chain.axis[own], chain.prismatic[own]
    )


def link_state(robot: Robot, link: int, motion: Array) -> Array:
    """Motion (N, 15) of a link by q, dq, ddq (3, n, N) of the joints."""
    found = link_motion(
        _head(robot.chain, link + 1), robot.gravity, *motion[:, : link + 1]
    )
    return np.vstack([found.a[-1], found.H[-1].reshape(9, -1), found.w[-1]]).T


def link_slopes(robot: Robot, link: int, motion: Array) -> Array:
    """Derivatives (N, 9, 3 m) of a link's f, dw, w in q, dq, ddq (3, n, N), joint after joint."""
    # From link to link they are carried on as the motion itself is (`link_motion`).
    head = _head(robot.chain, link + 1)
    own = link_motion(head, robot.gravity, *motion[:, : link + 1])
    D = np.zeros((motion.shape[2], 9, 3 * head.n))
    for i, axis in enumerate(head.axis):
        z, speed, slides = axis[:, None], motion[1, i], head.prismatic[i]
        w = own.w[i] - (0.0 if slides else z * speed)  # of the link before, as below
        across = cross(w, z)
        dw = own.dw[i] - (0.0 if slides else z * motion[2, i] + across * speed)
        if i:
            step = np.zeros((len(D), 9, 9))
            R, p = own.R[i].transpose(2, 1, 0), own.p[i]
            step[:, :3, :3] = step[:, 3:6, 3:6] = step[:, 6:, 6:] = R
            step[:, :3, 3:6] = -R @ _skew(p)
            before = own.w[i - 1]
            step[:, :3, 6:] = -R @ (_skew(cross(before, p)) + _skew(before) @ _skew(p))
            passed = _skew(z * speed) @ R
            step[:, (0 if slides else 3) : (3 if slides else 6), 6:] -= (
                1 + slides
            ) * passed
            D[:, :, : 3 * i] = step @ D[:, :, : 3 * i]
        new = np.zeros((3, 3, 3, len(D)))  # of f, dw, w, in q, dq, ddq
        if slides:
            new[0] = cross(dw, z) + cross(w, across), 2 * across, z + 0 * w
        else:
            new[0, 0], new[2, 0] = cross(own.a[i], z), across
            new[1, 0], new[1, 1] = cross(dw, z) + cross(across, z) * speed, across
            new[1, 2] = new[2, 1] = z
        D[:, :, 3 * i : 3 * i + 3] = new.transpose(3, 0, 2, 1).reshape(-1, 9, 3)
    return D


def _skew(v: Array) -> Array:
    """Matrices (N, 3, 3) of the cross product with v (3, N)."""
    none = np.zeros_like(v[0])
    rows = ((none, -v[2], v[1]), (v[2], none, -v[0]), (-v[1], v[0], none))
    return np.array(rows).transpose(2, 0, 1)
