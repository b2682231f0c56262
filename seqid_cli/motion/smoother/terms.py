"""Pieces of the motion smoother: splines and the readings of IMUs along a chain.

The trajectory of a joint is a cubic spline, its jerk constant between knots. In interval k the
position, velocity and acceleration depend on the coefficients k to k + 3 alone, so states
(q, dq, ddq) driven by white jerk take one unknown per knot. Symbols: `z` joint axes, `p` their
origins, `w`, `dw` angular rates, `a` acceleration minus gravity, all seen from the base with the
components first and the samples last.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.robot.kinematics import cross, fill_motion_matrix, link_motion
from seqid_cli.robot.types import Chain
from seqid_cli.typing import Array

JERK = np.array([-1.0, 3.0, -3.0, 1.0])


def spline_weights(u: Array, spacing: float) -> Array:
    """Weights (len(u), 3, 4) of four coefficients in q, dq, ddq at `u` in [0, 1) of an interval."""
    one, none = np.ones_like(u), np.zeros_like(u)
    q = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
    dq = [-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + one, u**2]
    ddq = [1 - u, 3 * u - 2, 1 - 3 * u, u + none]
    weights = [np.array(q) / 6, np.array(dq) / 2 / spacing, np.array(ddq) / spacing**2]
    return np.array(weights).transpose(2, 0, 1)


class Band:
    """Sums information of intervals: row k + d, column k, of each joint with itself."""

    def __init__(self, intervals: int, n: int) -> None:
        self.own = np.zeros((4, intervals + 3, n))
        self.gradient = np.zeros((intervals + 3, n))
        self.intervals = intervals

    def add(self, rows: Array, weights: Array, pulls: Array) -> None:
        """Add measurements that are sums by `rows` (S, 4) of each interval's coefficients.

        `weights` (S, M or 1, n) are their information, `pulls` (S, M, n) weighted residuals.
        """
        m = self.intervals
        for a in range(4):
            self.gradient[a : a + m] += np.tensordot(rows[:, a], pulls, 1)
            for b in range(a + 1):
                both = rows[:, a] * rows[:, b]
                if both.any():
                    self.own[a - b, b : b + m] += np.tensordot(both, weights, 1)

    def by_joint(self) -> Array:
        """Lower band (4, nK) of joints one after the other, where nothing couples them."""
        return self.own.transpose(0, 2, 1).reshape(4, -1)

    def added_to(self, band: Array) -> Array:
        """Add to a lower band (K, n, 4n) of all joints, which is returned.

        Entry r of coefficient (k, j) is in row kn + j + r: so LAPACK wants it in memory.
        """
        n = band.shape[1]
        for d in range(4):
            band[:, :, d * n] += self.own[d]
        return band


@dataclass(frozen=True)
class Jerk:
    """White jerk of all joints: `size` (n,) rad/s^3 between knots, `correlation` (n, n).

    A jolt of one joint jolts the others through the arm's inertia: jerks come together. `relative`
    (M, n) is how much larger than usual they are in each interval: friction jolts a joint that
    turns back, and an arm that rests has none.
    """

    size: Array
    correlation: Array
    relative: Array

    @property
    def precision(self) -> Array:
        """Inverse covariance (n, n) of the usual jerk."""
        covariance = self.correlation * np.outer(self.size, self.size)
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def couple_jerks(band: Array, precision: Array, relative: Array, *, stretch: int = 512) -> None:
    """Add what the jerks' precision between joints says to a lower band (K, n, 4n)."""
    if not precision.any():
        return
    inverse = 1.0 / relative
    for start in range(0, len(inverse), stretch):
        own = inverse[start : start + stretch]
        couplings = own[:, :, None] * own[:, None] * precision
        _add_couplings(band[start : start + len(own) + 3], couplings)


def _add_couplings(band: Array, couplings: Array) -> None:
    """Add precisions (M, n, n) of jerks to the lower band (M + 3, n, 4n) of their coefficients."""
    m, n, _ = couplings.shape
    for d in range(4):
        share = np.zeros((m + 3, n, n))
        for b in range(4 - d):
            share[b : b + m] += (JERK[b + d] * JERK[b]) * couplings
        for j in range(n):
            first = 0 if d else j
            band[:, j, d * n + first - j : (d + 1) * n - j] += share[:, j, first:]


@dataclass(frozen=True)
class ChainState:
    """Every joint's axis and origin, and the motion of the link before and after it."""

    R: Array  # (n, 3, 3, N)
    p: Array  # (3, n, N), as all below
    z: Array
    w_before: Array
    dw_before: Array
    a_before: Array  # of the link before, at the joint
    w: Array
    dw: Array
    a: Array


def _head(chain: Chain, count: int) -> Chain:
    """The first joints alone."""
    own = slice(count)
    return Chain(chain.rotation[own], chain.position[own], chain.axis[own], chain.prismatic[own])


def chain_state(chain: Chain, gravity: Array, q: Array, dq: Array, ddq: Array) -> ChainState:
    """Move along the first m joints of a chain in the base frame; q, dq, ddq are (m, N)."""
    own = link_motion(_head(chain, len(q)), gravity, q, dq, ddq)
    R, p, a_before = np.empty_like(own.R), np.zeros_like(own.p), np.empty_like(own.p)
    turned, start = np.broadcast_to(np.eye(3)[:, :, None], R[0].shape), np.zeros(p[0].shape)
    at = start - gravity[:, None]  # of the link before, at the joint, in that link's frame
    for i in range(len(q)):
        if i:
            at = own.a[i - 1] + np.einsum("abn,bn->an", own.H[i - 1], own.p[i])
        a_before[i] = np.einsum("abn,bn->an", turned, at)
        start = p[i] = start + np.einsum("abn,bn->an", turned, own.p[i])
        turned = R[i] = np.einsum("abn,bcn->acn", turned, own.R[i])
    w, dw, a = (np.einsum("iabn,ibn->ain", R, v) for v in (own.w, own.dw, own.a))
    w_before, dw_before = (np.pad(v, ((0, 0), (1, 0), (0, 0)))[:, :-1] for v in (w, dw))
    z = np.einsum("iabn,ib->ain", R, chain.axis[: len(q)])
    first = np.moveaxis(np.stack([p, a_before]), 2, 1)
    return ChainState(R, first[0], z, w_before, dw_before, first[1], w, dw, a)


@dataclass(frozen=True)
class Mounting:
    """An IMU on its link, as it is believed to be.

    `axes` (K, 3) are the sensing axes in its frame, as long as the accelerometers' gains;
    `gyro` (3, 3) turns its angular velocity into the gyro's readings; None without one.
    """

    link: int
    positions: Array  # (K, 3) m
    axes: Array
    R: Array  # (3, 3), link from IMU
    lever: Array  # (3,) m, of the IMU's origin in the link's frame
    gyro: Array | None = None

    @property
    def channels(self) -> int:
        """Number of readings."""
        return len(self.axes) + (0 if self.gyro is None else 3)


@dataclass(frozen=True)
class Rows:
    """Jacobians of an IMU's readings: (N, K, 3, m) in q, dq, ddq of the joints before it.

    `by_mounting` (N, K, 6) is in its place on the link [m] and a small turn [rad] about its own
    axes, `by_gain` (N, K, 3) in each channel's own axis. Biases add to the readings one by one.
    """

    by_motion: Array
    by_mounting: Array
    by_gain: Array

    def by_constants(self, rate: Array, gains: bool) -> Array:
        """In biases, place, turn, clock offset and, if asked, gains: (N, K, g).

        `rate` (N, 3, m) are the time derivatives of q, dq, ddq.
        """
        count, channels, _ = self.by_mounting.shape
        ones = np.broadcast_to(np.eye(channels), (count, channels, channels))
        late = -np.einsum("nkdm,ndm->nk", self.by_motion, rate)
        parts = [ones, self.by_mounting, late[:, :, None]]
        if gains:
            own = np.zeros((count, channels, channels, 3))
            own[:, np.arange(channels), np.arange(channels)] = self.by_gain
            parts.append(own.reshape(count, channels, -1))
        return np.concatenate(parts, axis=2)


def felt(state: ChainState, x: Mounting) -> Array:
    """Specific force, angular acceleration and velocity (3, 3, N) at an IMU, along its own axes."""
    R = np.einsum("abn,bc->can", state.R[x.link], x.R)
    reach = np.einsum("abn,b->an", state.R[x.link], x.lever)
    w, dw = state.w[:, x.link], state.dw[:, x.link]
    f = state.a[:, x.link] + cross(dw, reach) + cross(w, cross(w, reach))
    return np.stack([np.einsum("can,an->cn", R, v) for v in (f, dw, w)])


def felt_by(chain: Chain, gravity: Array, motion: Array, x: Mounting) -> Array:
    """What `felt` says, (3, 3, N), by the motion (3, m, N) of the joints before an IMU alone."""
    head = link_motion(_head(chain, motion.shape[1]), gravity, *motion)
    force = head.a[-1] + np.einsum("abn,b->an", head.H[-1], x.lever)
    own = np.stack([force, head.dw[-1], head.w[-1]])
    return np.asarray(np.tensordot(x.R, own, (0, 1)).transpose(1, 0, 2))


def readings(x: Mounting, own: Array) -> Array:
    """Accelerometers (N, K) of an array that feels `own` (3, 3, N), then its gyro."""
    f, dw, w = own
    s, r = x.axes, x.positions
    value = s @ f + np.cross(r, s) @ dw + (s @ w) * (r @ w)
    value -= np.sum(s * r, axis=1)[:, None] * np.sum(w * w, axis=0)
    return value.T if x.gyro is None else np.vstack([value, x.gyro @ w]).T


def imu_rows(chain: Chain, state: ChainState, dq: Array, x: Mounting) -> Rows:
    """Derivatives of an IMU's accelerometers, and of its gyro.

    `dq` (m, N) [rad/s].
    """
    link = x.link
    own = felt(state, x).transpose(2, 0, 1)
    R = state.R[link].transpose(2, 0, 1) @ x.R
    point = state.p[:, link] + np.einsum("abn,b->an", state.R[link], x.lever)
    columns = np.moveaxis(_columns(chain, state, dq, link, point), 3, 0)
    turned = (R.transpose(0, 2, 1)[:, None] @ columns).reshape(len(R), 9, -1)
    rows = _reading_matrix(x, own[:, 2]).reshape(len(R), -1, 9)
    by_motion = (rows @ turned).reshape(*rows.shape[:2], 3, link + 1)
    mounting = np.zeros((len(R), 3, 3, 6))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        mounting[:, :, a, 3 + b], mounting[:, :, a, 3 + c] = -own[:, :, c], own[:, :, b]
    H = np.empty((3, 3, len(R)))
    fill_motion_matrix(H, state.w[:, link], state.dw[:, link])
    H = H.transpose(2, 0, 1)
    mounting[:, 0, :, :3] = R.transpose(0, 2, 1) @ H @ (R @ x.R.T)
    return Rows(by_motion, rows @ mounting.reshape(len(R), 9, 6), _sensed(x, own))


def _sensed(x: Mounting, own: Array) -> Array:
    """What each channel's axis is multiplied with, (N, K, 3): force at its place, or w."""
    f, dw, w = (own[:, i, None] for i in range(3))
    force = f + np.cross(dw, x.positions) + np.cross(w, np.cross(w, x.positions))
    if x.gyro is None:
        return np.asarray(force)
    return np.concatenate([force, np.repeat(w, 3, axis=1)], axis=1)


def _reading_matrix(x: Mounting, w: Array) -> Array:
    """Gradient (N, K, 3, 3) of readings in f, dw and w, in the IMU's frame; w is (N, 3)."""
    s, r = x.axes, x.positions
    outer = s[:, :, None] * r[:, None, :]
    Q = outer + outer.transpose(0, 2, 1)
    Q -= 2 * np.einsum("kaa->k", outer)[:, None, None] * np.eye(3)
    rows = np.zeros((len(w), x.channels, 3, 3))
    rows[:, : len(s), 0] = s
    rows[:, : len(s), 1] = np.cross(r, s)
    rows[:, : len(s), 2] = np.einsum("kab,nb->nka", Q, w)
    if x.gyro is not None:
        rows[:, len(s) :, 2] = x.gyro
    return rows


def _columns(chain: Chain, state: ChainState, dq: Array, link: int, point: Array) -> Array:
    """Derivatives of f, dw, w at a point of a link in q, dq, ddq: (3, 3, 3 * (link + 1), N)."""
    # A joint's angle turns what its own link inherits backwards; everything beyond rides on it.
    m = link + 1
    z, w_before, w_own = state.z[:, :m], state.w_before[:, :m], state.w[:, :m]
    slides = chain.prismatic[:m, None]
    r = point[:, None] - state.p[:, :m]
    speed = np.where(slides, z, cross(z, r)) * dq[:m]
    beyond = np.cumsum(speed[:, ::-1], axis=1)[:, ::-1] - speed
    rest = state.w[:, link][:, None] - w_own
    turn = cross(w_before, z)
    none = np.zeros_like(z)
    kinds = (
        (turn, cross(state.dw_before[:, :m], z) + cross(turn, z) * dq[:m],
         cross(state.a_before[:, :m], z)),
        (z, turn, none),
        (none, z, none),
    )  # fmt: skip
    sliding = (cross(state.dw[:, :m], z) + cross(w_own, cross(w_own, z)), 2 * cross(w_own, z), z)
    out = np.zeros((3, 3, 3, m, z.shape[-1]))
    for kind, (by_w, by_dw, by_a) in enumerate(kinds):
        force = by_a + cross(by_dw, r)
        force += cross(by_w, cross(w_own, r) + 2 * beyond) + cross(w_own, cross(by_w, r))
        out[0, :, kind] = np.where(slides, sliding[kind], force)
        out[1, :, kind] = np.where(slides, 0.0, by_dw + cross(by_w, rest))
        out[2, :, kind] = np.where(slides, 0.0, by_w)
    return out.reshape(3, 3, 3 * m, -1)
