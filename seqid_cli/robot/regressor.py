"""Joint torques linear in the standard parameters (Eq. 3), batched over samples.

Per link, phi = (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz): mass [kg], first moment
[kg m], inertia about the link frame's origin [kg m^2]. With w, dw and a of `kinematics`
(a: origin minus gravity) the force on a link and the moment about its origin are

    f = m a + H c,             H = skew(dw) + skew(w) skew(w),   c = (mx, my, mz)
    n = c x a + I dw + w x I w = c x a + K (Ixx, Ixy, Iyy, Ixz, Iyz, Izz),

and joint j <= i feels z_j . n + l_j . f, where (z_j, l_j) is its screw carried forward
into the frame of link i: the angular velocity and the velocity of the link's origin per
unit rate. Only joint-link pairs with j <= i are formed. Inside, samples are the last
axis: of the (N, n, p) results each column is contiguous in memory (``Y.transpose(1, 2,
0)`` is C-ordered). States `q`, `dq`, `ddq` (N, n) are in rad, rad/s, rad/s^2 (m where
prismatic), `gravity` (3,) in m/s^2 in the base frame.
"""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot.kinematics import cross, fill_motion_matrix, link_motion, skew
from seqid_cli.robot.types import Array, Chain

PER_LINK = 10
Kinds = NDArray[np.intp]
Columns = Sequence[int] | None  # of the regressor; None is all
Coupling = Literal["diagonal", "gyroscopic"]
_BLOCK = 4096  # samples at a time: numpy call overhead against cache


def torque_regressor(
    chain: Chain,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    *,
    columns: Columns = None,
) -> Array:
    """Compute the regressor Y of the rigid-body joint torque: tau = Y phi (Eq. 3, without rotors).

    `columns`: the ones to compute of the 10 n, ascending. Returns (N, n, 10 n or
    len(columns)): link-major, in Pinocchio's order, N m (N where prismatic) per unit.
    """
    kept = columns_by_link(chain.n, columns)
    Y = np.empty((chain.n, sum(len(kinds) for kinds in kept), len(q)))
    stop = 0
    for i, kinds in enumerate(kept):
        start, stop = stop, stop + len(kinds)
        Y[i + 1 :, start:stop] = 0.0  # joints behind a link do not feel it
    for _ in link_blocks(chain, gravity, q, dq, ddq, kept, out=Y):
        pass
    return Y.transpose(2, 0, 1)


def link_blocks(
    chain: Chain,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    kept: Sequence[Kinds],
    *,
    out: Array | None = None,
) -> Iterator[tuple[int, slice, Array]]:
    """Compute the regressor of `torque_regressor` piece by piece, to be regrouped.

    `kept`: per link the numbers of its columns to compute, ascending (see
    `columns_by_link`). `out` (n, p, N): where all columns go, link after link; without
    it each array is filled anew for the next. Yields: link i, the samples, and the
    torques of joints 0..i.
    """
    largest = max((i + 1) * len(kinds) for i, kinds in enumerate(kept))
    room = np.empty(largest * min(_BLOCK, len(q)) if out is None else 0)
    starts = np.cumsum([0, *(len(kinds) for kinds in kept)])
    walk = _Walk(chain, min(_BLOCK, len(q)))
    for start in range(0, len(q), _BLOCK):
        rows = slice(start, min(start + _BLOCK, len(q)))
        state = (np.ascontiguousarray(x[rows].T) for x in (q, dq, ddq))
        for i, link in enumerate(walk.links(gravity, *state)):
            if out is None:
                shape = (i + 1, len(kept[i]), rows.stop - start)
                block = room[: int(np.prod(shape))].reshape(shape)
            else:
                block = out[: i + 1, starts[i] : starts[i + 1], rows]
            _fill_link(
                block, kept[i], link, chain.axis[i], prismatic=chain.prismatic[i]
            )
            yield i, rows, block


def gravity_regressor(chain: Chain, gravity: Array, q: Array) -> Array:
    """Compute the regressor (N, n, 10 n) of gravity alone (Eq. 18); inertia columns are zero."""
    still = np.zeros_like(q)
    return torque_regressor(chain, gravity, q, still, still)


def rotor_regressor(
    chain: Chain, q: Array, dq: Array, ddq: Array, gear_ratio: Array, coupling: Coupling
) -> Array:
    """Compute the joint torque per unit motor-side rotor inertia [kg m^2] of each joint.

    "diagonal": rotor i loads its own joint only, by N_i^2 ddq_i (Eq. 2). "gyroscopic":
    rotor i rides on link i-1 and turns about axis i at N_i dq_i relative to it, so that
    link feels the moment N_i (ddq_i z_i + dq_i w x z_i), and joint i also N_i z_i . dw.
    Its inertia as a dead mass belongs to the link. Rotors of prismatic joints have the
    diagonal term only. `gear_ratio` (n,): motor turns per joint turn, signed [rad/m
    where prismatic]. Returns (N, n, n): torque of joint j per rotor inertia i at [:, j,
    i].
    """
    n = chain.n
    Y = np.zeros((n, n, len(q)))
    for i in range(n):
        Y[i, i] = gear_ratio[i] ** 2 * ddq[:, i]
    if coupling == "gyroscopic":
        state = (np.ascontiguousarray(x.T) for x in (q, dq, ddq))
        walk = _Walk(chain, len(q))
        for i, link in enumerate(walk.links(np.zeros(3), *state), start=1):
            if i == n or chain.prismatic[i]:
                continue
            z = (chain.rotation[i] @ chain.axis[i])[:, None]
            moment = z * ddq[:, i] + cross(link.w, z) * dq[:, i]
            Y[:i, i] = gear_ratio[i] * np.einsum("kjn,kn->jn", link.screws[0], moment)
            Y[i, i] += gear_ratio[i] * (z * link.dw).sum(axis=0)
    return Y.transpose(2, 0, 1)


def inverse_dynamics(
    chain: Chain, gravity: Array, phi: Array, q: Array, dq: Array, ddq: Array
) -> Array:
    """Compute the joint torque (N, n) [N m; N where prismatic] by recursive Newton-Euler.

    `q`, `dq`, `ddq` (N, n), `gravity` (3,): as in the module's head. `phi` (n, 10):
    standard parameters, physical or not (Pinocchio's order, inertia about the link
    frame's origin).
    """
    motion = link_motion(chain, gravity, q.T, dq.T, ddq.T)
    force, moment = np.zeros((2, 3, len(q)))
    tau = np.empty((chain.n, len(q)))
    for i in reversed(range(chain.n)):
        w, dw, a = motion.w[i], motion.dw[i], motion.a[i]
        mass, c = phi[i, 0], phi[i, 1:4, None]
        xx, xy, yy, xz, yz, zz = phi[i, 4:]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        force = force + (mass * a + cross(dw, c) + cross(w, cross(w, c)))
        moment = moment + (cross(c, a) + inertia @ dw + cross(w, inertia @ w))
        tau[i] = chain.axis[i] @ (force if chain.prismatic[i] else moment)
        force = np.einsum("abn,bn->an", motion.R[i], force)
        moment = np.einsum("abn,bn->an", motion.R[i], moment) + cross(
            motion.p[i], force
        )
    return np.ascontiguousarray(tau.T)


def columns_by_link(n: int, columns: Columns) -> list[Kinds]:
    """Split columns of the regressor, in ascending order, into those of each link."""
    every = (
        np.arange(PER_LINK * n)
        if columns is None
        else np.asarray(columns, dtype=np.intp)
    )
    return [every[every // PER_LINK == i] % PER_LINK for i in range(n)]


class _Link(NamedTuple):
    """Load of a link, in its frame, samples last; the next link but one uses the arrays again."""

    w: Array
    dw: Array
    # (2, 3, 4, N): m and c of z . (c x a) = (a x z) . c, and of l . (m a + H c)
    load: Array
    screws: Array  # (2, 3, i + 1, N) of joints 0..i: z, then l


class _Walk:
    """Walks along a chain, so many samples at a time, in the same arrays every time."""

    def __init__(self, chain: Chain, samples: int) -> None:
        # Matrices (9, 18) that carry (w, dw, a | H), (6, 6) that carry (z, l) to a
        # frame fixed in the link before, turned by C and placed at p.
        self.chain, self.carriers = chain, list[tuple[Array, Array]]()
        for C, p in zip(chain.rotation, chain.position, strict=True):
            to_motion, to_screws = np.zeros((9, 18)), np.zeros((6, 6))
            to_motion[:3, :3] = to_motion[3:6, 3:6] = C.T
            # a + H p, from the rows (a, H) of `load`
            point = np.hstack([np.ones(1), p])
            to_motion[6:, 6:] = C.T @ np.kron(np.eye(3), point)
            to_screws[:3, :3] = to_screws[3:, 3:] = C.T
            to_screws[3:, :3] = -C.T @ skew(p)
            self.carriers.append((to_motion, to_screws))
        # Of this link and the one before: screws, and for one product with a constant
        # matrix to carry all to the next link, 12 rows of the load's z, w, dw, 12 of
        # its l, and 6 unused. Zeros, because mass and own component of the moment in z
        # . (c x a) are never written.
        self.rows, self.screws = (
            np.zeros((2, 36, samples)),
            np.empty((2, 6, chain.n * samples)),
        )

    def links(self, gravity: Array, q: Array, dq: Array, ddq: Array) -> Iterator[_Link]:
        """Carry motion and screws from link to link; q, dq, ddq (n, M), M not above N."""
        samples = q.shape[1]
        rows, screws = self.rows[:, :, :samples], self.screws
        rows[1, 12:30] = 0.0
        rows[1, 18:30:4] = -gravity[:, None]  # the base, as the link before
        for i, (to_motion, to_screws) in enumerate(self.carriers):
            axis, new, old = self.chain.axis[i], i % 2, 1 - i % 2
            motion = (to_motion @ rows[old, 12:30]).reshape(3, 3, samples)
            carried = screws[new, :, : i * samples]
            np.matmul(to_screws, screws[old, :, : i * samples], out=carried)
            before = carried.reshape(2, 3, i, samples)
            every = screws[new, :, : (i + 1) * samples].reshape(2, 3, i + 1, samples)
            own = rows[new]
            load = own.reshape(2, 18, -1)[:, :12].reshape(2, 3, 4, -1)
            move = _slide if self.chain.prismatic[i] else _turn
            move(motion, before, axis, q[i], dq[i], ddq[i])
            own[12:18] = motion[:2].reshape(6, samples)
            (turning, moving), a = load, motion[2]
            np.copyto(moving[:, 0], a)
            fill_motion_matrix(moving[:, 1:], own[12:15], own[15:18])
            turning[1, 1], turning[2, 1] = -a[2], a[1]
            turning[0, 2], turning[2, 2] = a[2], -a[0]
            turning[0, 3], turning[1, 3] = -a[1], a[0]
            every[:, :, i] = 0.0
            every[int(self.chain.prismatic[i]), :, i] = axis[:, None]
            yield _Link(own[12:15], own[15:18], load, every)


def _turn(
    motion: Array, screws: Array, axis: Array, q: Array, dq: Array, ddq: Array
) -> None:
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
    beside = axis.reshape((1, 3) + (1,) * (vectors.ndim - 2))
    along = np.einsum("a,ga...->g...", axis, vectors)[:, None] * beside
    across = np.einsum("ab,gb...->ga...", skew(axis), vectors)
    vectors[:] = cosine * (vectors - along) + along - sine * across


def _slide(
    motion: Array, screws: Array, axis: Array, q: Array, dq: Array, ddq: Array
) -> None:
    """Take w, dw, a (3, 3, N) and screws (2, 3, i, N) along with a joint that slides."""
    w, dw, a = motion
    from_axis = -skew(axis)  # times x: x cross axis
    faster = from_axis @ w
    a += (
        (from_axis @ dw) * q
        + cross(w, faster * q)
        + axis[:, None] * ddq
        + 2.0 * faster * dq
    )
    screws[1] += np.einsum("ab,bjn->ajn", from_axis, screws[0]) * q


def _fill_link(
    block: Array, kinds: Kinds, link: _Link, axis: Array, *, prismatic: bool
) -> None:
    """Fill the columns `kinds` of a link for its joint and all before: block (j, len(kinds), N)."""
    i = len(block) - 1
    last = int(np.count_nonzero(kinds < 4))
    if last:
        load = link.load if last == 4 else link.load[:, :, kinds[:last]]
        for j in range(i):  # joint by joint: the sum stays in cache
            np.einsum("skn,skcn->cn", link.screws[:, :, j], load, out=block[j, :last])
        _along(axis, load[int(prismatic)], block[i, :last])
    if last < len(kinds):
        K = _inertia_matrix(link.w, link.load[1, :, 1:])
        K = K if len(kinds) - last == 6 else K[:, kinds[last:] - 4]
        for j in range(i):
            np.einsum("kn,kcn->cn", link.screws[0, :, j], K, out=block[j, last:])
        _along(0.0 * axis if prismatic else axis, K, block[i, last:])


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
