"""Kinematics of a serial chain, batched over samples.

Symbols: R_AB rotates from B to A; `R`, `p`, `z` of `forward` are seen from the base.
`w` and `dw` are a link's angular velocity and acceleration, `a` the linear acceleration
of its frame's origin minus gravity, all three in the link's own frame. A link is called
by the joint that moves it, from 0; the base is -1. n is the number of joints, N the
number of samples. Inside, samples are the last axis (contiguous); at the boundary the
first.
"""

from collections.abc import Collection, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from seqid_cli.robot.types import Array, Chain, Robot

ANGLE_NOISE = 1e-5  # rad; "1.5708" in a file means a quarter turn (it is 3.7e-6 off)


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) of the cross product: ``skew(v) @ x == cross(v, x)``."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_about(axis: Array, angle: float) -> Array:
    """Return the matrix (3, 3) that turns by `angle` [rad] about a unit axis (3,).

    By the formula of Rodrigues.
    """
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def turned_by(turn: Array) -> Array:
    """Return the matrix (3, 3) that turns by |`turn`| [rad] about the vector (3,)."""
    angle = float(np.linalg.norm(turn))
    return rotation_about(turn / angle, angle) if angle > 0.0 else np.eye(3)


def one_turn(first: Array, then: Array) -> Array:
    """Return the one turn (3,) [rad] that does what two turns one by one do.

    By the product of their quaternions.
    """
    real, imaginary = _quaternion(first)
    then_real, then_imaginary = _quaternion(then)
    both_real = then_real * real - then_imaginary @ imaginary
    both_imaginary = (
        then_real * imaginary
        + real * then_imaginary
        + np.cross(then_imaginary, imaginary)
    )
    if both_real < 0.0:  # the same turn the shorter way
        both_real = -both_real
        both_imaginary = -both_imaginary
    sine = float(np.linalg.norm(both_imaginary))
    per_sine = 2.0 * np.arctan2(sine, both_real) / sine if sine > 0.0 else 2.0
    return np.asarray(per_sine * both_imaginary)


def _quaternion(turn: Array) -> tuple[float, Array]:
    """Return the real part and the imaginary ones (3,) of a turn (3,) [rad]."""
    angle = float(np.linalg.norm(turn))
    # The sine of half the angle over the angle.
    share = 0.5 * float(np.sinc(0.5 * angle / np.pi))
    return float(np.cos(0.5 * angle)), np.asarray(share * turn)


def tidy_rotation(R: Array) -> Array:
    """Make entries of a rotation (3, 3) within `ANGLE_NOISE` of 0 and +-1 exact.

    Rounded quarter turns would otherwise count as geometry: axes parallel but for 4e-6
    rad give base parameters that no experiment can see.
    """
    nearest = np.round(R)
    snapped = np.where(np.abs(R - nearest) < ANGLE_NOISE, nearest, R)
    if np.array_equal(snapped, nearest):
        return np.asarray(snapped + 0.0)
    # What is no quarter turn is made orthogonal again.
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
    """Build the chain of a modified DH table (Eq. 27).

    Parameters
    ----------
    rows : sequence of (float, float, float, float)
        alpha, a, d and theta0 of each joint [rad, m]: RotX(alpha) TransX(a)
        RotZ(theta0 + q) TransZ(d). Joint axes are z of their frames.
    sliding : collection of int
        Joints (0-based) that keep their angle theta0 and move by q along z.
    """
    x, z = np.eye(3)[[0, 2]]
    rotations = []
    positions = []
    for alpha, a, d, theta0 in rows:
        tilt = rotation_about(x, alpha)
        rotations.append(tidy_rotation(tilt @ rotation_about(z, theta0)))
        positions.append(tidy_position(a * x + d * tidy_rotation(tilt)[:, 2]))
    return Chain(
        rotation=np.array(rotations),
        position=np.array(positions),
        axis=np.tile(z, (len(rows), 1)),
        prismatic=np.isin(np.arange(len(rows)), list(sliding)),
    )


class Frames(NamedTuple):
    """Frames of all links, seen from the base."""

    R: Array  # (N, n, 3, 3) base from link
    p: Array  # (N, n, 3) m, origins
    z: Array  # (N, n, 3) joint axes


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
    product = np.empty((3, *np.broadcast(u[0], v[0]).shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(u[j], v[k], out=product[i])
        product[i] -= u[k] * v[j]
    return product


class _JointConstants(NamedTuple):
    """What the places of a chain's joints are made of, whatever their positions."""

    # (n, 9, 3): matrices (3, 3) of 1, cos q and sin q, whose sum is the rotation
    matrices: Array
    slides: Array  # (n, 3) m per m of a joint that slides, in the parent's frame
    skews: Array  # (n, 3, 3) of the axes, in their own frames


@lru_cache(maxsize=16)
def _joint_constants(chain: Chain) -> _JointConstants:
    """Work out once what `joint_transforms` needs for every log."""
    # Rodrigues' formula with the axis e, R = C (e e' + cos q (1 - e e') + sin q [e x]),
    # as one product of constant matrices with 1, cos q and sin q. R is C if it slides.
    turns = np.where(chain.prismatic, 0.0, 1.0)[:, None, None]
    along = chain.axis[:, :, None] * chain.axis[:, None, :]
    skews = np.stack([skew(axis) for axis in chain.axis])
    constant = chain.rotation @ (turns * along + (1.0 - turns) * np.eye(3))
    cosine = chain.rotation @ (turns * (np.eye(3) - along))
    sine = chain.rotation @ (turns * skews)
    matrices = np.stack((constant, cosine, sine), axis=-1).reshape(chain.n, 9, 3)
    axis_in_parent = np.einsum("nab,nb->na", chain.rotation, chain.axis)
    slides = (1.0 - turns[:, 0]) * axis_in_parent
    return _JointConstants(matrices=matrices, slides=slides, skews=skews)


def joint_transforms(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Place each joint's frame in its parent's (Eq. 27).

    Parameters
    ----------
    q : ndarray, (n, N)
        Joint positions [rad; m where prismatic].

    Returns
    -------
    R : ndarray, (n, 3, 3, N)
        Parent from joint.
    p : ndarray, (n, 3, N)
        Origins in the parent's frame [m].
    """
    constants = _joint_constants(chain)
    factors = np.stack((np.ones_like(q), np.cos(q), np.sin(q)), axis=1)
    R = (constants.matrices @ factors).reshape(chain.n, 3, 3, -1)
    p = chain.position[:, :, None] + constants.slides[:, :, None] * q[:, None, :]
    return R, p


def link_motion(
    chain: Chain, gravity: Array, q: Array, dq: Array, ddq: Array
) -> LinkMotion:
    """Propagate motion from the base, which is at rest, to all links.

    Parameters
    ----------
    gravity : ndarray, (3,)
        In the base frame [m/s^2].
    q, dq, ddq : ndarray, (n, N)
        Joint positions, velocities, accelerations [rad; m where prismatic].
    """
    R, p = joint_transforms(chain, q)
    skews = _joint_constants(chain).skews
    w = np.empty_like(p)
    dw = np.empty_like(p)
    a = np.empty_like(p)
    H = np.empty(R.shape)
    for i in range(chain.n):
        # w, dw, a of the parent, the base or the link before, at the joint's origin.
        parent = np.zeros((3, *p[i].shape))
        if i:
            parent[0] = w[i - 1]
            parent[1] = dw[i - 1]
            np.einsum("abn,bn->an", H[i - 1], p[i], out=parent[2])
            parent[2] += a[i - 1]
        else:
            parent[2] -= gravity[:, None]

        # The same in the link's frame: R transposed times each.
        in_link = parent[:, 0, None] * R[i, 0]
        in_link += parent[:, 1, None] * R[i, 1]
        in_link += parent[:, 2, None] * R[i, 2]
        w[i], dw[i], a[i] = in_link

        # What the joint itself adds.
        axis = chain.axis[i][:, None]
        w_cross_axis_dq = (-skews[i] @ w[i]) * dq[i]
        if chain.prismatic[i]:
            a[i] += axis * ddq[i] + 2.0 * w_cross_axis_dq
        else:
            dw[i] += axis * ddq[i] + w_cross_axis_dq
            w[i] += axis * dq[i]
        fill_motion_matrix(H[i], w[i], dw[i])
    return LinkMotion(R=R, p=p, w=w, dw=dw, a=a, H=H)


def fill_motion_matrix(H: Array, w: Array, dw: Array) -> None:
    """Fill H (3, 3, N) with skew(dw) + skew(w) skew(w)."""
    xx, yy, zz = w * w
    H[0, 0] = -(yy + zz)
    H[1, 1] = -(xx + zz)
    H[2, 2] = -(xx + yy)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product = w[i] * w[j]
        np.subtract(product, dw[k], out=H[i, j])
        np.add(product, dw[k], out=H[j, i])


def forward(chain: Chain, q: Array) -> Frames:
    """Compute the frames of all links seen from the base.

    `q` (N, n): joint positions [rad; m where prismatic].
    """
    R_local, p_local = (np.moveaxis(x, -1, 0) for x in joint_transforms(chain, q.T))
    R = np.empty(R_local.shape)
    p = np.empty(p_local.shape)
    R[:, 0] = R_local[:, 0]
    p[:, 0] = p_local[:, 0]
    for i in range(1, chain.n):
        R[:, i] = R[:, i - 1] @ R_local[:, i]
        p[:, i] = p[:, i - 1] + np.einsum("nab,nb->na", R[:, i - 1], p_local[:, i])
    return Frames(R=R, p=p, z=np.einsum("niab,ib->nia", R, chain.axis))


def gravity_columns(robot: Robot, joint: int, configuration: Array, q: Array) -> Array:
    """Compute the columns of Eq. 13: gravity of one joint, the others locked.

    Parameters
    ----------
    joint : int
        The joint that moves, from 0.
    configuration : ndarray, (n,)
        Positions of the joints before it [rad].
    q : ndarray, (K,)
        Positions of the joint [rad].

    Returns
    -------
    ndarray, (K, 2)
        Vectors a [m/s^2]. (K, 1) for a prismatic joint, whose gravity force is mass
        times gravity along the axis; (K, 0) where no gravity is across the axis.
    """
    at_zero = configuration.copy()
    at_zero[joint] = 0.0
    g = forward(robot.chain, at_zero[None]).R[0, joint].T @ robot.gravity
    axis = robot.chain.axis[joint]
    if robot.chain.prismatic[joint]:
        along_axis = float(g @ axis)
        if abs(along_axis) <= 1e-6:
            return np.empty((len(q), 0))
        return np.full((len(q), 1), -along_axis)

    e_x, e_y = plane_across(axis)
    g_x = float(g @ e_x)
    g_y = float(g @ e_y)
    if np.hypot(g_x, g_y) < 1e-6:
        return np.empty((len(q), 0))
    sin = np.sin(q)
    cos = np.cos(q)
    return np.column_stack([g_x * sin - g_y * cos, g_x * cos + g_y * sin])


def plane_across(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors across a joint axis: x and y where the axis is z."""
    # From a coordinate axis that is not nearly the joint's.
    start = np.array([1.0, 0.0, 0.0])
    if abs(axis[0]) >= 0.9:
        start = np.array([0.0, 1.0, 0.0])
    e_x = start - axis * (axis @ start)
    e_x /= np.linalg.norm(e_x)
    return e_x, np.cross(axis, e_x)


def link_angular_motion(
    chain: Chain, q: Array, dq: Array, ddq: Array, link: int
) -> tuple[Array, Array]:
    """Compute the angular motion of a link in its own frame (Eq. 39).

    Parameters
    ----------
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations.
    link : int
        The link, by the joint that moves it, from 0.

    Returns
    -------
    w, dw : ndarray, (N, 3)
        Angular velocity [rad/s] and acceleration [rad/s^2].
    """
    motion = link_motion(chain, np.zeros(3), q.T, dq.T, ddq.T)
    return motion.w[link].T.copy(), motion.dw[link].T.copy()
