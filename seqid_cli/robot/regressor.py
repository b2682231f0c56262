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
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot.kinematics import cross, fill_motion_matrix, skew
from seqid_cli.robot.types import Array, Chain

PER_LINK = 10
Kinds = NDArray[np.intp]
Coupling = Literal["diagonal", "gyroscopic"]
_BLOCK = 4096  # samples at a time: numpy call overhead against cache


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

    `gravity` (3,) [m/s^2], base frame. `q`, `dq`, `ddq` (N, n) [rad, rad/s, rad/s^2; m where
    prismatic]. `columns`: the ones to compute of the 10 n, ascending. Returns (N, n, 10 n or
    len(columns)): link-major, in Pinocchio's order, N m (N where prismatic) per unit.
    """
    kept = columns_by_link(chain.n, columns)
    Y = np.zeros((chain.n, sum(map(len, kept)), len(q)))
    starts = np.cumsum([0, *map(len, kept)])
    for i, rows, block in link_blocks(chain, gravity, q, dq, ddq, kept):
        Y[: i + 1, starts[i] : starts[i + 1], rows] = block
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
        for i, link in enumerate(_links(chain, gravity, *state)):
            yield i, rows, _block(kept[i], link, chain.axis[i], prismatic=chain.prismatic[i])


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
        state = (np.ascontiguousarray(x.T) for x in (q, dq, ddq))
        for i, link in enumerate(_links(chain, np.zeros(3), *state), start=1):
            if i == n or chain.prismatic[i]:
                continue
            z = (chain.rotation[i] @ chain.axis[i])[:, None]
            moment = z * ddq[:, i] + cross(link.motion[0], z) * dq[:, i]
            Y[:i, i] = gear_ratio[i] * np.einsum("kjn,kn->jn", link.screws[0], moment)
            Y[i, i] += gear_ratio[i] * (z * link.motion[1]).sum(axis=0)
    return Y.transpose(2, 0, 1)


def inverse_dynamics(
    chain: Chain, gravity: Array, phi: Array, q: Array, dq: Array, ddq: Array
) -> Array:
    """Compute the joint torque (N, n) [N m; N where prismatic] of known parameters.

    `gravity` (3,) [m/s^2], base frame. `phi` (n, 10): standard parameters, physical or not
    (Pinocchio's order, inertia about the link frame's origin). `q`, `dq`, `ddq` (N, n) [rad, rad/s,
    rad/s^2; m where prismatic].
    """
    tau = np.zeros((chain.n, len(q)))
    kept = [np.flatnonzero(own) for own in phi]
    for i, rows, block in link_blocks(chain, gravity, q, dq, ddq, kept):
        tau[: i + 1, rows] += np.einsum("jcn,c->jn", block, phi[i, kept[i]])
    return np.ascontiguousarray(tau.T)


def columns_by_link(n: int, columns: Sequence[int] | None) -> list[Kinds]:
    """Split columns of the regressor, in ascending order, into those of each link; None is all."""
    every = np.arange(PER_LINK * n) if columns is None else np.asarray(columns, dtype=np.intp)
    return [every[every // PER_LINK == i] % PER_LINK for i in range(n)]


class _Link(NamedTuple):
    """The load of a link, in its frame, samples last.

    `motion` (3, 3, N): w, dw and a. `load` (2, 3, 4, N) makes the force of mass and first moment: m
    and c of z . (c x a) = (a x z) . c, and of l . (m a + H c). `screws` (2, 3, i + 1, N) are those
    of joints 0..i: z, then l.
    """

    motion: Array
    load: Array
    screws: Array


def _links(chain: Chain, gravity: Array, q: Array, dq: Array, ddq: Array) -> Iterator[_Link]:
    """Carry motion and screws from link to link; q, dq, ddq (n, N)."""
    samples = q.shape[1]
    motion, H = np.zeros((3, 3, samples)), np.zeros((3, 3, samples))
    motion[2] -= gravity[:, None]
    screws = np.zeros((2, 3, 0, samples))
    parts = (chain.rotation, chain.position, chain.axis, chain.prismatic)
    for i, (C, p, axis, slides) in enumerate(zip(*parts, strict=True)):
        before, screws = screws, np.empty((2, 3, i + 1, samples))
        for k in range(3 if p.any() else 0):
            motion[2] += p[k] * H[:, k]
        motion = C.T @ motion
        carried = np.block([[C.T, np.zeros((3, 3))], [-C.T @ skew(p), C.T]])
        screws[:, :, :i] = (carried @ before.reshape(6, -1)).reshape(2, 3, i, samples)
        (_slide if slides else _turn)(motion, screws[:, :, :i], axis, q[i], dq[i], ddq[i])
        screws[:, :, i] = 0.0
        screws[int(slides), :, i] = axis[:, None]
        load = _load(motion)
        H = load[1, :, 1:]
        yield _Link(motion, load, screws)


def _turn(motion: Array, screws: Array, axis: Array, q: Array, dq: Array, ddq: Array) -> None:
    """Take w, dw, a (3, 3, N) and screws (2, 3, i, N) along with a joint that turns."""
    cosine, sine = np.cos(q), np.sin(q)
    _turn_back(motion, axis, cosine, sine)
    _turn_back(screws, axis, cosine, sine)
    w, dw, _ = motion
    dw += (-skew(axis) @ w) * dq  # w x axis dq
    for k in np.flatnonzero(axis):
        dw[k] += axis[k] * ddq
        w[k] += axis[k] * dq


def _turn_back(vectors: Array, axis: Array, cosine: Array, sine: Array) -> None:
    """See vectors (g, 3, ..., N) from a frame turned about an axis; most axes are coordinates."""
    used = np.flatnonzero(axis)
    if len(used) == 1:
        u, v = vectors[:, used[0] - 2], vectors[:, used[0] - 1]
        turned = sine * axis[used[0]]
        from_u, from_v = turned * u, turned * v
        u *= cosine
        u += from_v
        v *= cosine
        v -= from_u
        return
    along = np.einsum("a,ga...->g...", axis, vectors)[:, None] * axis.reshape(
        (1, 3) + (1,) * (vectors.ndim - 2)
    )
    across = np.einsum("ab,gb...->ga...", skew(axis), vectors)
    vectors[:] = cosine * (vectors - along) + along - sine * across


def _slide(motion: Array, screws: Array, axis: Array, q: Array, dq: Array, ddq: Array) -> None:
    """Take w, dw, a (3, 3, N) and screws (2, 3, i, N) along with a joint that slides."""
    w, dw, a = motion
    from_axis = -skew(axis)  # times x: x cross axis
    faster = from_axis @ w
    a += (from_axis @ dw) * q + cross(w, faster * q) + axis[:, None] * ddq + 2.0 * faster * dq
    screws[1] += np.einsum("ab,bjn->ajn", from_axis, screws[0]) * q


def _load(motion: Array) -> Array:
    """Build `load` of a link from its w, dw and a (3, 3, N)."""
    w, dw, a = motion
    load = np.zeros((2, 3, 4, a.shape[1]))
    turning, moving = load
    moving[:, 0] = a
    fill_motion_matrix(moving[:, 1:], w, dw)
    turning[1, 1], turning[2, 1] = -a[2], a[1]
    turning[0, 2], turning[2, 2] = a[2], -a[0]
    turning[0, 3], turning[1, 3] = -a[1], a[0]
    return load


def _block(kinds: Kinds, link: _Link, axis: Array, *, prismatic: bool) -> Array:
    """Make columns `kinds` of a link for its joint and all before: (i + 1, len(kinds), N)."""
    i, samples = link.screws.shape[2] - 1, link.screws.shape[3]
    block = np.empty((i + 1, len(kinds), samples))
    last = int(np.count_nonzero(kinds < 4))
    if last:
        load = link.load if last == 4 else link.load[:, :, kinds[:last]]
        for j in range(i):  # joint by joint: the sum stays in cache
            np.einsum("skn,skcn->cn", link.screws[:, :, j], load, out=block[j, :last])
        _along(axis, load[int(prismatic)], block[i, :last])
    if last < len(kinds):
        K = _inertia_matrix(link.motion[0], link.load[1, :, 1:])
        K = K if len(kinds) - last == 6 else K[:, kinds[last:] - 4]
        for j in range(i):
            np.einsum("kn,kcn->cn", link.screws[0, :, j], K, out=block[j, last:])
        _along(0.0 * axis if prismatic else axis, K, block[i, last:])
    return block


def _along(axis: Array, rows: Array, out: Array) -> None:
    """Sum axis (3,) times rows (3, c, N) into out (c, N); most axes have one component."""
    used = np.flatnonzero(axis)
    if not len(used):
        out[:] = 0.0
        return
    np.multiply(rows[used[0]], axis[used[0]], out=out)
    for k in used[1:]:
        out += axis[k] * rows[k]


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
