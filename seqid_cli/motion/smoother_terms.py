"""Pieces of the motion smoother: splines and the readings of IMUs along a chain.

The trajectory of a joint is a cubic spline, its jerk constant between knots. In interval k the
position, velocity and acceleration depend on the coefficients k to k + 3 alone, so states
(q, dq, ddq) driven by white jerk take one unknown per knot. Symbols: `z` joint axes, `p` their
origins, `w`, `dw` angular rates, `a` acceleration minus gravity, all seen from the base with the
components first and the samples last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot.kinematics import cross, joint_transforms
from seqid_cli.robot.types import Chain, Imu

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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

    def add(self, weights: Array, gradient: Array) -> None:
        """Add information (4, 4, M or 1, n) and gradients (4, M, n)."""
        m = self.intervals
        for a in range(4):
            self.gradient[a : a + m] += gradient[a]
            for b in range(a + 1):
                self.own[a - b, b : b + m] += weights[a, b]

    def by_joint(self) -> Array:
        """Lower band (4, nK) of joints one after the other, where nothing couples them."""
        return self.own.transpose(0, 2, 1).reshape(4, -1)

    def banded(self, blocks: Array | None) -> Array:
        """Lower band as `cholesky_banded` wants it, with `blocks` (4, n, n, K) that couple."""
        n = self.own.shape[2]
        band = np.zeros((4 * n, self.own[0].size))
        for d in range(4):
            band[d * n] = self.own[d].ravel()
            if blocks is None:
                continue
            for i in range(n):
                for j in range(i + 1 if d == 0 else n):
                    band[d * n + i - j, j::n] += blocks[d, i, j]
        return band


@dataclass(frozen=True)
class Jerk:
    """White jerk of all joints: `size` (n,) rad/s^3 between knots, `correlation` (n, n).

    A jolt of one joint jolts the others through the arm's inertia: jerks come together.
    """

    size: Array
    correlation: Array

    @property
    def precision(self) -> Array:
        """Inverse covariance (n, n)."""
        covariance = self.correlation * np.outer(self.size, self.size)
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def couple_jerks(band: Array, precision: Array, intervals: int) -> None:
    """Add what the jerks' precision between joints says to a lower band of all coefficients."""
    n = len(precision)
    if not precision.any():
        return
    for d in range(4):
        for i in range(n):
            for j in range(i if d == 0 else n):
                if i == j:
                    continue
                row = band[d * n + i - j, j::n]
                for b in range(4 - d):
                    row[b : b + intervals] += JERK[b + d] * JERK[b] * precision[i, j]


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


def chain_state(chain: Chain, gravity: Array, q: Array, dq: Array, ddq: Array) -> ChainState:
    """Move along the chain in the base frame; q, dq, ddq are (n, N)."""
    turns, offsets = joint_transforms(chain, q)
    n, count = q.shape
    parts = {
        name: np.empty((3, n, count)) for name in ("p", "z", "wb", "dwb", "ab", "w", "dw", "a")
    }
    R_all = np.empty((n, 3, 3, count))
    R = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, count))
    p, w, dw = (np.zeros((3, count)) for _ in range(3))
    a = np.repeat(-gravity[:, None], count, axis=1)
    for i in range(n):
        d = np.einsum("abn,bn->an", R, offsets[i])
        a = a + cross(dw, d) + cross(w, cross(w, d))
        p = p + d
        R = np.einsum("abn,bcn->acn", R, turns[i])
        z = np.einsum("abn,b->an", R, chain.axis[i])
        for name, value in zip(("wb", "dwb", "ab"), (w, dw, a), strict=True):
            parts[name][:, i] = value
        if chain.prismatic[i]:
            a = a + 2.0 * cross(w, z) * dq[i] + z * ddq[i]
        else:
            dw = dw + cross(w, z) * dq[i] + z * ddq[i]
            w = w + z * dq[i]
        for name, value in zip(("p", "z", "w", "dw", "a"), (p, z, w, dw, a), strict=True):
            parts[name][:, i] = value
        R_all[i] = R
    x = parts
    return ChainState(R_all, x["p"], x["z"], x["wb"], x["dwb"], x["ab"], x["w"], x["dw"], x["a"])


@dataclass(frozen=True)
class Rows:
    """Jacobians of an IMU's readings: (N, K, 3, n) in q, dq, ddq, (N, K, 6) in its mounting.

    The mounting is the IMU's place on the link (3) m and a small turn (3) rad about its own axes.
    Biases add to the readings one by one.
    """

    by_motion: Array
    by_mounting: Array

    @property
    def by_constants(self) -> Array:
        """In biases, place and turn, (N, K, K + 6)."""
        count, channels, _ = self.by_mounting.shape
        ones = np.broadcast_to(np.eye(channels), (count, channels, channels))
        return np.concatenate([ones, self.by_mounting], axis=2)


def felt(state: ChainState, link: int, R_imu: Array, lever: Array) -> Array:
    """Specific force, angular acceleration and velocity (3, 3, N) at an IMU, along its own axes."""
    R = np.einsum("abn,bc->can", state.R[link], R_imu)
    reach = np.einsum("abn,b->an", state.R[link], lever)
    w, dw = state.w[:, link], state.dw[:, link]
    f = state.a[:, link] + cross(dw, reach) + cross(w, cross(w, reach))
    return np.stack([np.einsum("can,an->cn", R, v) for v in (f, dw, w)])


def readings(imu: Imu, own: Array, *, gyro: bool) -> Array:
    """Accelerometers (N, K) of an array that feels `own` (3, 3, N), then its gyro."""
    f, dw, w = own
    s, r = imu.axes, imu.positions
    value = s @ f + np.cross(r, s) @ dw + (s @ w) * (r @ w)
    value -= np.sum(s * r, axis=1)[:, None] * np.sum(w * w, axis=0)
    return np.vstack([value, w]).T if gyro else value.T


def imu_rows(
    chain: Chain, state: ChainState, dq: Array, imu: Imu, R_imu: Array, lever: Array, *, gyro: bool
) -> Rows:
    """Derivatives of an IMU's accelerometers, and of its gyro.

    Parameters
    ----------
    chain : Chain
    state : ChainState
    dq : (n, N) array [rad/s]
    imu : Imu
    R_imu : (3, 3) array, link from IMU
    lever : (3,) array [m], of the IMU's origin in the link's frame
    gyro : bool
        Whether its three rows follow.
    """
    link, n = imu.after_joint, len(dq)
    own = felt(state, link, R_imu, lever).transpose(2, 0, 1)
    R = state.R[link].transpose(2, 0, 1) @ R_imu
    point = state.p[:, link] + np.einsum("abn,b->an", state.R[link], lever)
    columns = np.moveaxis(_columns(chain, state, dq, link, point), 3, 0)
    turned = (R.transpose(0, 2, 1)[:, None] @ columns).reshape(len(R), 9, -1)
    rows = _reading_matrix(imu, own[:, 2], gyro=gyro).reshape(len(R), -1, 9)
    by_motion = np.zeros((len(R), rows.shape[1], 3, n))
    by_motion[..., : link + 1] = (rows @ turned).reshape(*by_motion.shape[:3], link + 1)
    mounting = np.zeros((len(R), 3, 3, 6))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        mounting[:, :, a, 3 + b], mounting[:, :, a, 3 + c] = -own[:, :, c], own[:, :, b]
    H = _point_matrix(state.w[:, link], state.dw[:, link]).transpose(2, 0, 1)
    mounting[:, 0, :, :3] = R.transpose(0, 2, 1) @ H @ (R @ R_imu.T)
    return Rows(by_motion, rows @ mounting.reshape(len(R), 9, 6))


def _point_matrix(w: Array, dw: Array) -> Array:
    """skew(dw) + skew(w) skew(w), (3, 3, N)."""
    columns = []
    for unit in np.eye(3)[:, :, None]:
        columns.append(cross(dw, unit) + cross(w, cross(w, unit)))
    return np.stack(columns, axis=1)


def _reading_matrix(imu: Imu, w: Array, *, gyro: bool) -> Array:
    """Gradient (N, K, 3, 3) of readings in f, dw and w, in the IMU's frame; w is (N, 3)."""
    s, r = imu.axes, imu.positions
    outer = s[:, :, None] * r[:, None, :]
    Q = outer + outer.transpose(0, 2, 1)
    Q -= 2 * np.einsum("kaa->k", outer)[:, None, None] * np.eye(3)
    rows = np.zeros((len(w), len(s) + (3 if gyro else 0), 3, 3))
    rows[:, : len(s), 0] = s
    rows[:, : len(s), 1] = np.cross(r, s)
    rows[:, : len(s), 2] = np.einsum("kab,nb->nka", Q, w)
    if gyro:
        rows[:, len(s) :, 2] = np.eye(3)
    return rows


def _columns(chain: Chain, state: ChainState, dq: Array, link: int, point: Array) -> Array:
    """Derivatives of f, dw, w at a point of a link in q, dq, ddq: (3, 3, 3 * (link + 1), N).

    A joint's angle turns what its own link inherits backwards; everything beyond rides on it.
    """
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
    sliding = (
        cross(state.dw[:, :m], z) + cross(w_own, cross(w_own, z)),
        2 * cross(w_own, z),
        z,
    )
    out = np.zeros((3, 3, 3, m, z.shape[-1]))
    for kind, (by_w, by_dw, by_a) in enumerate(kinds):
        force = by_a + cross(by_dw, r)
        force += cross(by_w, cross(w_own, r) + 2 * beyond) + cross(w_own, cross(by_w, r))
        out[0, :, kind] = np.where(slides, sliding[kind], force)
        out[1, :, kind] = np.where(slides, 0.0, by_dw + cross(by_w, rest))
        out[2, :, kind] = np.where(slides, 0.0, by_w)
    return out.reshape(3, 3, 3 * m, -1)
