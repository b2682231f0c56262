"""Kinematics of a serial chain, batched over samples; chains of DH parameters or of a file.

Symbols: R_AB rotates from B to A; `R`, `p`, `z` of `forward` are seen from the base.
`w` and `dw` are a link's angular velocity and acceleration, `a` the linear acceleration
of its frame's origin minus gravity, all three in the link's own frame. A link is called
by the joint that moves it, from 0; the base is -1. Inside, samples are the last axis
(contiguous); at the boundary the first.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from seqid_cli.robot.types import Array, Chain, Robot

ANGLE_NOISE = 1e-5  # rad; "1.5708" in a file means a quarter turn (it is 3.7e-6 off)


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) of the cross product: ``skew(v) @ x == cross(v, x)``."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_about(axis: Array, angle: float) -> Array:
    """Rotate by `angle` [rad] about the unit vector `axis` (3,): matrix (3, 3) (Rodrigues)."""
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def tidy_rotation(R: Array) -> Array:
    """Make entries of a rotation (3, 3) within `ANGLE_NOISE` of 0 and +-1 exact."""
    # Rounded quarter turns would otherwise count as geometry: axes parallel but for
    # 4e-6 rad give base parameters that no experiment can see.
    nearest = np.round(R)
    snapped = np.where(np.abs(R - nearest) < ANGLE_NOISE, nearest, R)
    if np.array_equal(snapped, nearest):
        return np.asarray(snapped + 0.0)
    U, _, Vt = np.linalg.svd(snapped)
    R = U @ Vt
    return np.asarray(np.where(np.abs(R) < 1e-15, 0.0, R))


def tidy_position(p: Array, *, noise: float = 1e-6) -> Array:
    """Zero the components of a position (3,) [m] below `noise`."""
    return np.where(np.abs(p) < noise, 0.0, p)


def tidy_axis(axis: Array) -> Array:
    """Normalise `axis` (3,), its components within `ANGLE_NOISE` of 0 made exact."""
    unit = axis / np.linalg.norm(axis)
    unit = np.where(np.abs(unit) < ANGLE_NOISE, 0.0, unit)
    return np.asarray(unit / np.linalg.norm(unit))


def chain_from_dh(
    rows: Sequence[Sequence[float]], sliding: Collection[int] = ()
) -> Chain:
    """Build the chain of a modified DH table; joint axes are z of their frames (Eq. 27).

    `rows`: alpha, a, d and theta0 of each joint, rad and m: RotX(alpha) TransX(a)
    RotZ(theta0 + q) TransZ(d). Joints in `sliding` (0-based) keep their angle theta0
    and move by q along z.
    """
    x, z = np.eye(3)[[0, 2]]
    rotations, positions = [], []
    for alpha, a, d, theta0 in rows:
        tilt = rotation_about(x, alpha)
        rotations.append(tidy_rotation(tilt @ rotation_about(z, theta0)))
        positions.append(tidy_position(a * x + d * tidy_rotation(tilt)[:, 2]))
    axes, prismatic = (
        np.tile(z, (len(rows), 1)),
        np.isin(np.arange(len(rows)), list(sliding)),
    )
    return Chain(np.array(rotations), np.array(positions), axes, prismatic)


class Frames(NamedTuple):
    """Link frames: `R` (N, n, 3, 3) base from link, origins `p` (N, n, 3) m, axes `z` (N, n, 3)."""

    R: Array
    p: Array
    z: Array


class LinkMotion(NamedTuple):
    """All links' motion, samples last: the forward pass of Newton-Euler."""

    R: Array  # (n, 3, 3, N) parent from link
    p: Array  # (n, 3, N) m, origin in the parent
    w: Array  # (n, 3, N) rad/s, as all that follows in the link's own frame
    dw: Array  # (n, 3, N) rad/s^2
    a: Array  # (n, 3, N) m/s^2, origin minus gravity
    # (n, 3, 3, N) skew(dw) + skew(w) skew(w): a point at r has acceleration a + H r
    H: Array


def cross(u: Array, v: Array) -> Array:
    """Take the cross product along the first axis (3, ...), with broadcasting."""
    x, y = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2]
    return np.stack((x, y, u[0] * v[1] - u[1] * v[0]))


def joint_transforms(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Place each joint's frame in its parent's: R (n, 3, 3, N) and p (n, 3, N) [m], Eq. 27.

    `q` (n, N) [rad; m where prismatic].
    """
    turning = np.where(chain.prismatic, 0.0, 1.0)[:, None, None]
    along = chain.axis[:, :, None] * chain.axis[:, None, :]
    still = chain.rotation @ (turning * along + (1.0 - turning) * np.eye(3))
    cosine = chain.rotation @ (turning * (np.eye(3) - along))
    sine = chain.rotation @ (turning * np.stack([skew(axis) for axis in chain.axis]))
    parts = np.stack((still, cosine, sine), axis=-1).reshape(chain.n, 9, 3)
    turns = np.stack((np.ones_like(q), np.cos(q), np.sin(q)), axis=1)
    R = (parts @ turns).reshape(chain.n, 3, 3, -1)
    slide = (1.0 - turning[:, 0]) * np.einsum("nab,nb->na", chain.rotation, chain.axis)
    return R, chain.position[:, :, None] + slide[:, :, None] * q[:, None, :]


def link_motion(
    chain: Chain, gravity: Array, q: Array, dq: Array, ddq: Array
) -> LinkMotion:
    """Propagate motion to all links, base at rest; q, dq, ddq (n, N), `gravity` (3,) [m/s^2]."""
    R, p = joint_transforms(chain, q)
    w, dw, a = (np.empty_like(p) for _ in range(3))
    H = np.empty(R.shape)
    for i in range(chain.n):
        # w, dw, a of the base, then of the link before
        parent = np.zeros((3, *p[i].shape))
        if i:
            parent[0], parent[1] = w[i - 1], dw[i - 1]
            np.einsum("abn,bn->an", H[i - 1], p[i], out=parent[2])
            parent[2] += a[i - 1]
        else:
            parent[2] -= gravity[:, None]
        turned_back = parent[:, 0, None] * R[i, 0]
        turned_back += parent[:, 1, None] * R[i, 1]
        turned_back += parent[:, 2, None] * R[i, 2]
        w[i], dw[i], a[i] = turned_back
        axis = chain.axis[i][:, None]
        turned = (-skew(chain.axis[i]) @ w[i]) * dq[i]  # w x axis dq
        if chain.prismatic[i]:
            a[i] += axis * ddq[i] + 2.0 * turned
        else:
            dw[i] += axis * ddq[i] + turned
            w[i] += axis * dq[i]
        fill_motion_matrix(H[i], w[i], dw[i])
    return LinkMotion(R=R, p=p, w=w, dw=dw, a=a, H=H)


def fill_motion_matrix(H: Array, w: Array, dw: Array) -> None:
    """Fill H (3, 3, N) with skew(dw) + skew(w) skew(w)."""
    xx, yy, zz = w * w
    H[0, 0], H[1, 1], H[2, 2] = -(yy + zz), -(xx + zz), -(xx + yy)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product = w[i] * w[j]
        np.subtract(product, dw[k], out=H[i, j])
        np.add(product, dw[k], out=H[j, i])


def forward(chain: Chain, q: Array) -> Frames:
    """Compute the frames of all links seen from the base, at q (N, n) [rad; m where prismatic]."""
    R_local, p_local = (np.moveaxis(x, -1, 0) for x in joint_transforms(chain, q.T))
    R, p = np.empty(R_local.shape), np.empty(p_local.shape)
    R[:, 0], p[:, 0] = R_local[:, 0], p_local[:, 0]
    for i in range(1, chain.n):
        R[:, i] = R[:, i - 1] @ R_local[:, i]
        p[:, i] = p[:, i - 1] + np.einsum("nab,nb->na", R[:, i - 1], p_local[:, i])
    return Frames(R=R, p=p, z=np.einsum("niab,ib->nia", R, chain.axis))


def gravity_columns(robot: Robot, joint: int, configuration: Array, q: Array) -> Array:
    """Vector a (K, 2) m/s^2 of Eq. 13 at positions q (K,) of one joint, the others locked.

    `configuration` (n,): positions of the joints before it [rad]. (K, 1) for a
    prismatic joint, whose gravity force is mass times gravity along the axis; (K, 0)
    where none is across the axis.
    """
    zero = configuration.copy()
    zero[joint] = 0.0
    g = forward(robot.chain, zero[None]).R[0, joint].T @ robot.gravity
    axis = robot.chain.axis[joint]
    if robot.chain.prismatic[joint]:
        column = np.full((len(q), 1), -float(g @ axis))
        return column if abs(g @ axis) > 1e-6 else column[:, :0]
    e_x, e_y = plane_across(axis)
    g_x, g_y = float(g @ e_x), float(g @ e_y)
    if np.hypot(g_x, g_y) < 1e-6:
        return np.empty((len(q), 0))
    sin, cos = np.sin(q), np.cos(q)
    return np.column_stack([g_x * sin - g_y * cos, g_x * cos + g_y * sin])


def plane_across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors across a joint axis; x and y of the frame where the axis is z."""
    start = (
        np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    )
    e_x = start - axis * (axis @ start)
    e_x /= np.linalg.norm(e_x)
    return e_x, np.cross(axis, e_x)


def link_angular_motion(
    chain: Chain, q: Array, dq: Array, ddq: Array, link: int
) -> tuple[Array, Array]:
    """Compute w, dw (N, 3) [rad/s, rad/s^2] of `link` in its frame (Eq. 39); q, dq, ddq (N, n)."""
    motion = link_motion(chain, np.zeros(3), q.T, dq.T, ddq.T)
    return motion.w[link].T.copy(), motion.dw[link].T.copy()
