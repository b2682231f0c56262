"""Joint torques linear in the standard parameters (Eq. 3), batched over samples.

Per link, phi = (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz): mass [kg], first moment [kg m],
inertia about the link frame's origin [kg m^2]. With w, dw and a of `kinematics` (a: origin minus
gravity) the force on a link and the moment about its origin are

    f = m a + H c,             H = skew(dw) + skew(w) skew(w),   c = (mx, my, mz)
    n = c x a + I dw + w x I w = c x a + K (Ixx, Ixy, Iyy, Ixz, Iyz, Izz),

and joint j <= i feels z_j . n + l_j . f, where (z_j, l_j) is its screw carried forward into the
frame of link i: the angular velocity and the velocity of the link's origin per unit rate. Only
joint-link pairs with j <= i are formed. Inside, samples are the last axis: of the (N, n, p) results
each column is contiguous in memory (``Y.transpose(1, 2, 0)`` is C-ordered).
"""

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot.kinematics import LinkMotion, cross, link_motion
from seqid_cli.robot.types import Array, Chain

PER_LINK = 10
Kinds = NDArray[np.intp]
Coupling = Literal["diagonal", "gyroscopic"]
_BLOCK = 1024  # samples at a time: numpy call overhead against cache


def torque_regressor(
    chain: Chain,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    *,
    columns: Sequence[int] | None = None,
) -> Array:
    """Compute the regressor Y of the rigid-body joint torque: tau = Y phi (Eq. 3, without rotors).

    Parameters
    ----------
    chain : Chain
    gravity : (3,) array [m/s^2], base frame
    q, dq, ddq : (N, n) arrays [rad, rad/s, rad/s^2; m where prismatic]
    columns : sequence of int, optional
        Compute only these of the 10 n columns, given in ascending order.

    Returns
    -------
    (N, n, 10 n) array, or (N, n, len(columns))
        Link-major columns in Pinocchio's parameter order, N m (N where prismatic) per unit.
    """
    kept = columns_by_link(chain.n, columns)
    ends = np.cumsum([0, *(len(kinds) for kinds in kept)])
    Y = np.zeros((chain.n, ends[-1], len(q)))
    for i, rows, block in link_blocks(chain, gravity, q, dq, ddq, kept):
        Y[: i + 1, ends[i] : ends[i + 1], rows] = block
    return Y.transpose(2, 0, 1)


def link_blocks(
    chain: Chain, gravity: Array, q: Array, dq: Array, ddq: Array, kept: Sequence[Kinds]
) -> Iterator[tuple[int, slice, Array]]:
    """Compute the regressor of `torque_regressor` piece by piece, to be regrouped.

    `gravity` (3,) [m/s^2], base frame. `q`, `dq`, `ddq` (N, n) [rad, rad/s, rad/s^2; m where
    prismatic]. `kept`: per link the numbers of its columns to compute, ascending (see
    `columns_by_link`). Yields: link i, the samples, and the torques of joints 0..i.
    """
    for start in range(0, len(q), _BLOCK):
        rows = slice(start, min(start + _BLOCK, len(q)))
        state = (np.ascontiguousarray(x[rows].T) for x in (q, dq, ddq))
        motion = link_motion(chain, gravity, *state)
        for i, screws in enumerate(_screws(chain, motion)):
            if len(kept[i]):
                yield i, rows, _block(kept[i], screws, motion.w[i], motion.a[i], motion.H[i])


def gravity_regressor(chain: Chain, gravity: Array, q: Array) -> Array:
    """Compute the regressor (N, n, 10 n) of gravity alone (Eq. 18); inertia columns are zero.

    `gravity` (3,) [m/s^2], base frame. `q` (N, n) [rad; m where prismatic].
    """
    still = np.zeros_like(q)
    return torque_regressor(chain, gravity, q, still, still)


def rotor_regressor(
    chain: Chain, q: Array, dq: Array, ddq: Array, gear_ratio: Array, coupling: Coupling
) -> Array:
    """Compute the joint torque per unit motor-side rotor inertia [kg m^2] of each joint.

    "diagonal": rotor i loads its own joint only, by N_i^2 ddq_i (Eq. 2). "gyroscopic": rotor i
    rides on link i-1 and turns about axis i at N_i dq_i relative to it, so that link feels the
    moment N_i (ddq_i z_i + dq_i w x z_i), and joint i also N_i z_i . dw. Its inertia as a dead mass
    belongs to the link. Rotors of prismatic joints have the diagonal term only. `q`, `dq`, `ddq`
    (N, n) [rad, rad/s, rad/s^2; m where prismatic]. `gear_ratio` (n,): motor turns per joint turn,
    signed [rad/m where prismatic]. `coupling` {"diagonal", "gyroscopic"}. Returns (N, n, n): torque
    of joint j per rotor inertia i at [:, j, i].
    """
    n = chain.n
    Y = np.zeros((n, n, len(q)))
    for i in range(n):
        Y[i, i] = gear_ratio[i] ** 2 * ddq[:, i]
    if coupling == "gyroscopic":
        motion = link_motion(chain, np.zeros(3), q.T, dq.T, ddq.T)
        for i, screws in enumerate(_screws(chain, motion), start=1):
            if i == n or chain.prismatic[i]:
                continue
            z = (chain.rotation[i] @ chain.axis[i])[:, None]
            moment = z * ddq[:, i] + cross(motion.w[i - 1], z) * dq[:, i]
            Y[:i, i] = gear_ratio[i] * np.einsum("kjn,kn->jn", screws[0], moment)
            Y[i, i] += gear_ratio[i] * (z * motion.dw[i - 1]).sum(axis=0)
    return Y.transpose(2, 0, 1)


def inverse_dynamics(
    chain: Chain, gravity: Array, phi: Array, q: Array, dq: Array, ddq: Array
) -> Array:
    """Compute the joint torque by recursive Newton-Euler, for any phi, physical or not.

    Parameters
    ----------
    chain : Chain
    gravity : (3,) array [m/s^2], base frame
    phi : (n, 10) array
        Standard parameters (Pinocchio's order, inertia about the link frame's origin).
    q, dq, ddq : (N, n) arrays [rad, rad/s, rad/s^2; m where prismatic]

    Returns
    -------
    (N, n) array [N m; N where prismatic]
    """
    motion = link_motion(chain, gravity, q.T, dq.T, ddq.T)
    force = np.zeros((3, len(q)))
    moment = np.zeros((3, len(q)))
    tau = np.empty((chain.n, len(q)))
    for i in reversed(range(chain.n)):
        own_force, own_moment = _load(phi[i], motion.w[i], motion.dw[i], motion.a[i])
        force, moment = force + own_force, moment + own_moment
        tau[i] = chain.axis[i] @ (force if chain.prismatic[i] else moment)
        force = np.einsum("abn,bn->an", motion.R[i], force)
        moment = np.einsum("abn,bn->an", motion.R[i], moment) + cross(motion.p[i], force)
    return np.ascontiguousarray(tau.T)


def _load(phi: Array, w: Array, dw: Array, a: Array) -> tuple[Array, Array]:
    """Compute force and moment about its origin that move one link, in its frame."""
    mass, c = phi[0], phi[1:4, None]
    xx, xy, yy, xz, yz, zz = phi[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    force = mass * a + cross(dw, c) + cross(w, cross(w, c))
    return force, cross(c, a) + inertia @ dw + cross(w, inertia @ w)


def columns_by_link(n: int, columns: Sequence[int] | None) -> list[Kinds]:
    """Split columns of the regressor, in ascending order, into those of each link; None is all."""
    every = np.arange(PER_LINK * n) if columns is None else np.asarray(columns, dtype=np.intp)
    return [every[every // PER_LINK == i] % PER_LINK for i in range(n)]


def _screws(chain: Chain, motion: LinkMotion) -> Iterator[Array]:
    """Screws (2, 3, i + 1, N) of joints 0..i, z and then l, in the frame of one link after another.

    The array is that of the link before, grown by one: use it before the next.
    """
    screws = np.zeros((2, 3, 0, motion.p.shape[-1]))
    for axis, slides, R, p in zip(chain.axis, chain.prismatic, motion.R, motion.p, strict=True):
        before, count = screws, screws.shape[2]
        before[1] += cross(before[0], p[:, None])
        screws = np.zeros((2, 3, count + 1, p.shape[-1]))
        np.einsum("abn,sajn->sbjn", R, before, out=screws[:, :, :count])
        screws[int(slides), :, count] = axis[:, None]
        yield screws


def _block(kinds: Kinds, screws: Array, w: Array, a: Array, H: Array) -> Array:
    """Columns `kinds` of a link for its joint and all before: (i + 1, len(kinds), N)."""
    joints, samples = screws.shape[2:]
    block, last = np.empty((joints, len(kinds), samples)), int(np.count_nonzero(kinds < 4))
    # Mass and first moment: m and c of z . (c x a) = (a x z) . c, and of l . (m a + H c).
    load = np.zeros((2, 3, 4, samples))
    load[0, 1, 1], load[0, 2, 1] = -a[2], a[1]
    load[0, 0, 2], load[0, 2, 2] = a[2], -a[0]
    load[0, 0, 3], load[0, 1, 3] = -a[1], a[0]
    load[1, :, 0], load[1, :, 1:] = a, H
    load, K = load[:, :, kinds[:last]], _inertia_matrix(w, H)[:, kinds[last:] - 4]
    for j in range(joints):  # joint by joint: the sum stays in cache
        np.einsum("skn,skcn->cn", screws[:, :, j], load, out=block[j, :last])
        np.einsum("kn,kcn->cn", screws[0, :, j], K, out=block[j, last:])
    return block


def _inertia_matrix(w: Array, H: Array) -> Array:
    """Build K (3, 6, N) with K (Ixx, ..., Izz) = I dw + w x I w, its entries those of H."""
    K = np.empty((3, 6, w.shape[-1]))
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    K[0, 0], K[0, 1], K[0, 2] = H[2, 1] - yz, -H[2, 0], -yz
    K[0, 3], K[0, 4], K[0, 5] = H[1, 0], H[1, 1] - H[2, 2], yz
    K[1, 0], K[1, 1], K[1, 2] = xz, H[2, 1], H[0, 2] - xz
    K[1, 3], K[1, 4], K[1, 5] = H[2, 2] - H[0, 0], -H[0, 1], -xz
    K[2, 0], K[2, 1], K[2, 2] = -xy, H[0, 0] - H[1, 1], xy
    K[2, 3], K[2, 4], K[2, 5] = -H[1, 2], H[0, 2], H[1, 0] - xy
    return K
