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
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot.kinematics import cross, fill_motion_matrix, skew
from seqid_cli.robot.types import Array, Chain

PER_LINK = 10
Kinds = NDArray[np.intp]  # numbers of a link's columns, 0 to 9
Columns = Sequence[int] | None  # of the regressor; None is all
Coupling = Literal["diagonal", "gyroscopic"]
_BLOCK = 4096  # samples at a time: numpy call overhead against cache
_RECURSION_BLOCK = 2048  # the same where the motion of one link alone is held


def torque_regressor(
    chain: Chain,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    *,
    columns: Columns = None,
) -> Array:
    """Compute the regressor Y of the rigid-body torque, tau = Y phi (Eq. 3).

    Rotors are left out.

    Parameters
    ----------
    gravity : ndarray, (3,)
        In the base frame [m/s^2].
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations [rad; m where prismatic].
    columns : sequence of int, optional
        The ones to compute of the 10 n, ascending.

    Returns
    -------
    ndarray, (N, n, 10 n or len(columns))
        Link-major, in Pinocchio's order, N m (N where prismatic) per unit.
    """
    kinds_by_link = columns_by_link(chain.n, columns)
    Y = np.empty((chain.n, sum(map(len, kinds_by_link)), len(q)))
    start = 0
    for i, kinds in enumerate(kinds_by_link):
        stop = start + len(kinds)
        Y[i + 1 :, start:stop] = 0.0  # joints behind a link do not feel it
        start = stop
    for _ in link_blocks(chain, gravity, q, dq, ddq, kinds_by_link, out=Y):
        pass  # each block is written to Y
    return Y.transpose(2, 0, 1)


def link_blocks(
    chain: Chain,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    kinds_by_link: Sequence[Kinds],
    *,
    out: Array | None = None,
) -> Iterator[tuple[int, slice, Array]]:
    """Compute the regressor of `torque_regressor` piece by piece, to be regrouped.

    Parameters
    ----------
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations [rad; m where prismatic].
    kinds_by_link : sequence of ndarray of int
        For each link the numbers of its columns to compute, ascending; see
        `columns_by_link`.
    out : ndarray, (n, p, N), optional
        Where all columns go, link after link.

    Yields
    ------
    int
        The link i.
    slice
        The samples, M of them.
    ndarray, (i + 1, columns of the link, M)
        Torques of joints 0..i per unit. Without `out` the array is filled anew for the
        next piece.
    """
    block_length = min(_BLOCK, len(q))
    largest = max((i + 1) * len(kinds) for i, kinds in enumerate(kinds_by_link))
    buffer = np.empty(largest * block_length if out is None else 0)
    starts = np.cumsum([0, *map(len, kinds_by_link)])
    walk = _Walk(chain, block_length)
    for start in range(0, len(q), _BLOCK):
        samples = slice(start, min(start + _BLOCK, len(q)))
        state = (np.ascontiguousarray(x[samples].T) for x in (q, dq, ddq))
        for i, link in enumerate(walk.links(gravity, *state)):
            kinds = kinds_by_link[i]
            if out is None:
                shape = (i + 1, len(kinds), samples.stop - start)
                block = buffer[: int(np.prod(shape))].reshape(shape)
            else:
                block = out[: i + 1, starts[i] : starts[i + 1], samples]
            _fill_link(block, kinds, link, chain.axis[i], prismatic=chain.prismatic[i])
            yield i, samples, block


def gravity_regressor(chain: Chain, gravity: Array, q: Array) -> Array:
    """Compute the regressor (N, n, 10 n) of gravity alone (Eq. 18).

    Its inertia columns are zero. `q` is (N, n), `gravity` (3,) [m/s^2].
    """
    at_rest = np.zeros_like(q)
    return torque_regressor(chain, gravity, q, at_rest, at_rest)


def rotor_regressor(
    chain: Chain, q: Array, dq: Array, ddq: Array, gear_ratio: Array, coupling: Coupling
) -> Array:
    """Compute the joint torques per unit of motor-side rotor inertia [kg m^2].

    Parameters
    ----------
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations [rad; m where prismatic].
    gear_ratio : ndarray, (n,)
        Motor turns N_i per joint turn, signed [rad/m where prismatic].
    coupling : {"diagonal", "gyroscopic"}
        "diagonal": rotor i loads its own joint only, by N_i^2 ddq_i (Eq. 2).
        "gyroscopic": rotor i rides on link i-1 and turns about axis i at N_i dq_i
        relative to it, so that link feels the moment N_i (ddq_i z_i + dq_i w x z_i),
        and joint i also N_i z_i . dw. Its inertia as a dead mass belongs to the link.
        Rotors of prismatic joints have the diagonal term only.

    Returns
    -------
    ndarray, (N, n, n)
        Torque of joint j per rotor inertia i at [:, j, i].
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
    """Compute the joint torque by recursive Newton-Euler.

    Parameters
    ----------
    gravity : ndarray, (3,)
        In the base frame [m/s^2].
    phi : ndarray, (n, 10)
        Standard parameters, physical or not (Pinocchio's order, inertia about the link
        frame's origin).
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations [rad; m where prismatic].

    Returns
    -------
    ndarray, (N, n)
        Torques [N m; N where prismatic].
    """
    tau = np.empty((chain.n, len(q)))
    recursion = _Recursion(chain, phi, min(_RECURSION_BLOCK, len(q)))
    for start in range(0, len(q), _RECURSION_BLOCK):
        samples = slice(start, min(start + _RECURSION_BLOCK, len(q)))
        state = (np.ascontiguousarray(x[samples].T) for x in (q, dq, ddq))
        recursion.fill(tau[:, samples], gravity, *state)
    return np.ascontiguousarray(tau.T)


# Products of the components of w, as the rows of a motion have them.
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class _Recursion:
    """Newton-Euler of links with known parameters, in the same arrays every time.

    Rows of a link's motion are w, dw, a and the six products of w. In these the load of
    a link is linear, and so is what the next joint is carried along with: each takes
    one product with a constant matrix.
    """

    def __init__(self, chain: Chain, phi: Array, samples: int) -> None:
        self.chain = chain
        self.carriers = _recursion_carriers(chain)
        self.to_load = np.tensordot(phi, _unit_loads(), axes=1)
        self.rows = np.empty((15, samples))
        self.loads = np.empty((chain.n, 6, samples))

    def fill(self, tau: Array, gravity: Array, q: Array, dq: Array, ddq: Array) -> None:
        """Fill the torques (n, M) of states (n, M), as many M as there is room for.

        `gravity` (3,) [m/s^2] is in the base frame.
        """
        samples = q.shape[1]
        rows = self.rows[:, :samples]
        loads = self.loads[:, :, :samples]
        cosine = np.cos(q)
        sine = np.sin(q)
        rows[:] = 0.0
        rows[6:9] = -gravity[:, None]  # the base, as the link before
        for i, (to_joint, _) in enumerate(self.carriers):
            motion = (to_joint @ rows).reshape(3, 3, samples)
            axis = self.chain.axis[i]
            if self.chain.prismatic[i]:
                _slide_motion(motion, axis, q[i], dq[i], ddq[i])
            else:
                _turn_back(motion, axis, cosine[i], sine[i])
                _spin(motion, axis, dq[i], ddq[i])
            rows[:9] = motion.reshape(9, samples)
            w = motion[0]
            np.multiply(w, w, out=rows[9:12])
            np.multiply(w[0], w[1:], out=rows[12:14])
            np.multiply(w[1], w[2], out=rows[14])
            np.matmul(self.to_load[i], rows, out=loads[i])

        # From the last link on, each carries those behind it.
        for i in reversed(range(self.chain.n)):
            load = loads[i]
            axis = self.chain.axis[i]
            force = load[:3]
            moment = load[3:]
            tau[i] = axis @ (force if self.chain.prismatic[i] else moment)
            if i == 0:
                return
            if self.chain.prismatic[i]:
                moment += (skew(axis) @ force) * q[i]
            else:
                both = load.reshape(2, 3, samples)
                _turn_back(both, axis, cosine[i], -sine[i])
            _, to_parent = self.carriers[i]
            loads[i - 1] += to_parent @ load


@lru_cache(maxsize=16)
def _recursion_carriers(chain: Chain) -> list[tuple[Array, Array]]:
    """Return what carries motion and loads across each joint at zero.

    Matrices (9, 15) carry a motion to the frame fixed in the link before, turned by C
    and placed at p; matrices (6, 6) carry force and moment back from it.
    """
    carriers = []
    for C, p in zip(chain.rotation, chain.position, strict=True):
        to_joint = np.zeros((9, 15))
        to_joint[:3, :3] = C.T
        to_joint[3:6, 3:6] = C.T
        to_joint[6:, 3:6] = -C.T @ skew(p)  # dw x p
        to_joint[6:, 6:9] = C.T
        to_joint[6:, 9:] = C.T @ _of_products(_turning(p))

        to_parent = np.zeros((6, 6))
        to_parent[:3, :3] = C
        to_parent[3:, 3:] = C
        to_parent[3:, :3] = skew(p) @ C
        carriers.append((to_joint, to_parent))
    return carriers


@lru_cache(maxsize=1)
def _unit_loads() -> Array:
    """Return the matrices (10, 6, 15) of `_load_matrix` per unit of each parameter."""
    return np.stack([_load_matrix(unit) for unit in np.eye(PER_LINK)])


def _load_matrix(phi: Array) -> Array:
    """Return the matrix (6, 15) from a link's motion to its force and moment.

    `phi` (10,) are the link's standard parameters.
    """
    c = phi[1:4]
    xx, xy, yy, xz, yz, zz = phi[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    matrix = np.zeros((6, 15))
    matrix[:3, 3:6] = -skew(c)  # dw x c
    matrix[:3, 6:9] = phi[0] * np.eye(3)
    matrix[:3, 9:] = _of_products(_turning(c))
    matrix[3:, 3:6] = inertia
    matrix[3:, 6:9] = skew(c)  # c x a
    # w x I w
    units = np.eye(3)
    skews = np.stack([skew(unit) for unit in units], axis=1)
    matrix[3:, 9:] = _of_products(skews @ inertia)
    return matrix


def _turning(r: Array) -> Array:
    """Return T (3, 3, 3), by which T_abd w_b w_d is w x (w x r)."""
    identity = np.eye(3)
    return identity[:, :, None] * r - r[:, None, None] * identity


def _of_products(T: Array) -> Array:
    """Return the matrix (3, 6) from the products of w to T_abd w_b w_d."""
    columns = [T[:, b, d] if b == d else T[:, b, d] + T[:, d, b] for b, d in _PAIRS]
    return np.stack(columns, axis=1)


def columns_by_link(n: int, columns: Columns) -> list[Kinds]:
    """Split columns of the regressor, in ascending order, into those of each link."""
    numbers = np.arange(PER_LINK * n)
    if columns is not None:
        numbers = np.asarray(columns, dtype=np.intp)
    return [numbers[numbers // PER_LINK == i] % PER_LINK for i in range(n)]


class _Link(NamedTuple):
    """Load of a link, in its frame, samples last.

    The next link but one uses the arrays again.
    """

    w: Array  # (3, N) rad/s
    dw: Array  # (3, N) rad/s^2
    # (2, 3, 4, N): m and c of z . (c x a) = (a x z) . c, and of l . (m a + H c)
    load: Array
    screws: Array  # (2, 3, i + 1, N) of joints 0..i: z, then l


# Rows of `_Walk.rows`: w and dw lie between both halves of the load, so that they and
# the second half, (a, H), are one piece (w, dw, a | H).
_W = slice(12, 15)
_DW = slice(15, 18)
_MOTION = slice(12, 30)


class _Walk:
    """Walks along a chain, so many samples at a time, in the same arrays every time."""

    def __init__(self, chain: Chain, samples: int) -> None:
        self.chain = chain
        # Matrices (9, 18) that carry (w, dw, a | H), (6, 6) that carry (z, l) to a
        # frame fixed in the link before, turned by C and placed at p.
        self.carriers: list[tuple[Array, Array]] = []
        for C, p in zip(chain.rotation, chain.position, strict=True):
            to_motion = np.zeros((9, 18))
            to_motion[:3, :3] = C.T
            to_motion[3:6, 3:6] = C.T
            # a + H p, from the rows (a, H) of `load`
            point = np.hstack([np.ones(1), p])
            to_motion[6:, 6:] = C.T @ np.kron(np.eye(3), point)
            to_screws = np.zeros((6, 6))
            to_screws[:3, :3] = C.T
            to_screws[3:, 3:] = C.T
            to_screws[3:, :3] = -C.T @ skew(p)
            self.carriers.append((to_motion, to_screws))

        # Of this link and the one before, in turns. For one product with a constant
        # matrix to carry all to the next link: 12 rows of the load's z, w, dw, 12 of
        # its l, and 6 unused. Zeros, because mass and own component of the moment in z
        # . (c x a) are never written.
        self.rows = np.zeros((2, 36, samples))
        self.screws = np.empty((2, 6, chain.n * samples))

    def links(self, gravity: Array, q: Array, dq: Array, ddq: Array) -> Iterator[_Link]:
        """Carry motion and screws from link to link.

        `q`, `dq`, `ddq` are (n, M), M up to the samples of the walk.
        """
        samples = q.shape[1]
        rows = self.rows[:, :, :samples]
        screws = self.screws
        rows[1, _MOTION] = 0.0
        rows[1, 18:30:4] = -gravity[:, None]  # the base, as the link before
        for i, (to_motion, to_screws) in enumerate(self.carriers):
            axis = self.chain.axis[i]
            is_prismatic = self.chain.prismatic[i]
            new = i % 2
            old = 1 - new

            # Motion and screws of the link before, seen from where this joint is zero.
            motion = (to_motion @ rows[old, _MOTION]).reshape(3, 3, samples)
            carried = screws[new, :, : i * samples]
            np.matmul(to_screws, screws[old, :, : i * samples], out=carried)
            screws_before = carried.reshape(2, 3, i, samples)

            # Views of what this link is to have: its rows, its load, all its screws.
            link_rows = rows[new]
            load = link_rows.reshape(2, 18, -1)[:, :12].reshape(2, 3, 4, -1)
            link_screws = screws[new, :, : (i + 1) * samples]
            link_screws = link_screws.reshape(2, 3, i + 1, samples)

            move = _slide if is_prismatic else _turn
            move(motion, screws_before, axis, q[i], dq[i], ddq[i])
            link_rows[12:18] = motion[:2].reshape(6, samples)
            _fill_load(load, motion[2], link_rows[_W], link_rows[_DW])

            # The joint's own screw: about its axis, or along it.
            link_screws[:, :, i] = 0.0
            link_screws[int(is_prismatic), :, i] = axis[:, None]
            yield _Link(link_rows[_W], link_rows[_DW], load, link_screws)


def _fill_load(load: Array, a: Array, w: Array, dw: Array) -> None:
    """Fill the load (2, 3, 4, N) of a link for m and c by its a, w, dw (3, N)."""
    about_axis, along_axis = load
    np.copyto(along_axis[:, 0], a)
    fill_motion_matrix(along_axis[:, 1:], w, dw)
    # -skew(a), for (a x z) . c
    about_axis[1, 1] = -a[2]
    about_axis[2, 1] = a[1]
    about_axis[0, 2] = a[2]
    about_axis[2, 2] = -a[0]
    about_axis[0, 3] = -a[1]
    about_axis[1, 3] = a[0]


def _turn(
    motion: Array, screws: Array, axis: Array, q: Array, dq: Array, ddq: Array
) -> None:
    """Take w, dw, a (3, 3, N) and screws (2, 3, i, N) along a joint that turns."""
    cosine = np.cos(q)
    sine = np.sin(q)
    _turn_back(motion, axis, cosine, sine)
    _turn_back(screws, axis, cosine, sine)
    _spin(motion, axis, dq, ddq)


def _spin(motion: Array, axis: Array, dq: Array, ddq: Array) -> None:
    """Add to w, dw (3, 3, N), with a, what a joint itself turns."""
    w, dw, _ = motion
    dw += (-skew(axis) @ w) * dq  # w x axis dq
    for k in np.flatnonzero(axis):
        dw[k] += axis[k] * ddq
        w[k] += axis[k] * dq


def _turn_back(vectors: Array, axis: Array, cosine: Array, sine: Array) -> None:
    """See vectors (g, 3, ..., N) from a frame turned about an axis."""
    components = np.flatnonzero(axis)
    # Most axes are coordinates: then two components change, in place.
    if len(components) == 1:
        k = components[0]
        u = vectors[:, k - 2]
        v = vectors[:, k - 1]
        signed_sine = sine * axis[k]
        from_u = signed_sine * u
        from_v = signed_sine * v
        u *= cosine
        u += from_v
        v *= cosine
        v -= from_u
        return
    axis_column = axis.reshape((1, 3) + (1,) * (vectors.ndim - 2))
    along = np.einsum("a,ga...->g...", axis, vectors)[:, None] * axis_column
    across = np.einsum("ab,gb...->ga...", skew(axis), vectors)
    vectors[:] = cosine * (vectors - along) + along - sine * across


def _slide(
    motion: Array, screws: Array, axis: Array, q: Array, dq: Array, ddq: Array
) -> None:
    """Take w, dw, a (3, 3, N) and screws (2, 3, i, N) along a joint that slides."""
    _slide_motion(motion, axis, q, dq, ddq)
    screws[1] += np.einsum("ab,bjn->ajn", -skew(axis), screws[0]) * q


def _slide_motion(motion: Array, axis: Array, q: Array, dq: Array, ddq: Array) -> None:
    """Take w, dw, a (3, 3, N) along a joint that slides."""
    w, dw, a = motion
    cross_axis = -skew(axis)  # times x: x cross axis
    w_cross_axis = cross_axis @ w
    a += (
        (cross_axis @ dw) * q
        + cross(w, w_cross_axis * q)
        + axis[:, None] * ddq
        + 2.0 * w_cross_axis * dq
    )


def _fill_link(
    block: Array, kinds: Kinds, link: _Link, axis: Array, *, prismatic: bool
) -> None:
    """Fill the columns of a link for its joint and all before.

    Parameters
    ----------
    block : ndarray, (i + 1, len(kinds), N)
        Torques of joints 0..i per unit, to be filled.
    kinds : ndarray of int
        Numbers of the link's columns.
    """
    i = len(block) - 1
    # Mass and first moment by the load.
    n_load = int(np.count_nonzero(kinds < 4))
    if n_load:
        load = link.load if n_load == 4 else link.load[:, :, kinds[:n_load]]
        for j in range(i):  # joint by joint: the sum stays in cache
            screw = link.screws[:, :, j]
            np.einsum("skn,skcn->cn", screw, load, out=block[j, :n_load])
        _along(axis, load[int(prismatic)], block[i, :n_load])

    # Inertia by the moment alone: a joint that slides does not feel it.
    if n_load < len(kinds):
        K = _inertia_matrix(link.w, link.load[1, :, 1:])
        if len(kinds) - n_load < 6:
            K = K[:, kinds[n_load:] - 4]
        for j in range(i):
            z = link.screws[0, :, j]
            np.einsum("kn,kcn->cn", z, K, out=block[j, n_load:])
        _along(0.0 * axis if prismatic else axis, K, block[i, n_load:])


def _along(axis: Array, rows: Array, out: Array) -> None:
    """Sum axis (3,) times rows (3, c, N) into out (c, N)."""
    # Most axes have one component.
    components = np.flatnonzero(axis)
    if not len(components):
        out[:] = 0.0
        return
    first = components[0]
    np.multiply(rows[first], axis[first], out=out)
    for k in components[1:]:
        out += axis[k] * rows[k]


def _inertia_matrix(w: Array, H: Array) -> Array:
    """Build K (3, 6, N) with K (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) = I dw + w x I w.

    Its entries are those of H, and products of w.
    """
    K = np.empty((3, 6, w.shape[-1]))
    xy = w[0] * w[1]
    xz = w[0] * w[2]
    yz = w[1] * w[2]

    K[0, 0] = H[2, 1] - yz
    K[0, 1] = -H[2, 0]
    K[0, 2] = -yz
    K[0, 3] = H[1, 0]
    K[0, 4] = H[1, 1] - H[2, 2]
    K[0, 5] = yz

    K[1, 0] = xz
    K[1, 1] = H[2, 1]
    K[1, 2] = H[0, 2] - xz
    K[1, 3] = H[2, 2] - H[0, 0]
    K[1, 4] = -H[0, 1]
    K[1, 5] = -xz

    K[2, 0] = -xy
    K[2, 1] = H[0, 0] - H[1, 1]
    K[2, 2] = xy
    K[2, 3] = -H[1, 2]
    K[2, 4] = H[0, 2]
    K[2, 5] = H[1, 0] - xy
    return K
