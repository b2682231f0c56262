"""What encoders and IMUs say of each other: errors that no noise model knows.

An encoder sees the drive's side of a joint, an IMU the link's. Each is left out in turn
and predicted by the other; what noise does not explain is an error of one of them, and
nothing in the log says of which.

Where a joint bends with the compliance c, its link is behind the drive by c times the
load, which is mostly the arm's inertia, M ddq. The link's acceleration differs from the
drive's by

    d_j = sum_i s_ji d4q_i/dt4,      s_ji = -c_j M_ji,

d4q/dt4 the second derivative of the accelerations ("snap"). A gain, a mounting or a
clock of an IMU that is off differs by ddq and its first derivative instead, and jolts
that fall between two samples by nothing that the motion predicts. So `d` is predicted
block by block from the others, with and without snap: joints bend where snap predicts
blocks that it has not seen.

The letters are those of `chunk`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seqid_cli.distributions import student_quantile
from seqid_cli.imu.sensor import link_slopes, link_state
from seqid_cli.imu.smoother.chunk import Mounted
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.types import Robot
from seqid_cli.robust import gaussian_spread
from seqid_cli.typing import Array, Index, Mask

BLOCK_S = 0.5  # longer than the low-pass remembers, short enough for many in a log
PIECE = 4096  # samples whose Jacobians are held at once


@dataclass(frozen=True)
class Compliance:
    """By how much links bend behind the drives' encoders.

    `per_snap` (n, n) s^2: acceleration of link j beyond its drive per snap of joint i;
    rows of joints that do not bend for certain are zero.
    """

    per_snap: Array

    def power(self, ddq: Array, lowpass: Lowpass, usable: Mask) -> Array:
        """Return the mean square (n,) of what bends, below a low-pass.

        Parameters
        ----------
        ddq : Array
            Accelerations (N, n) rad/s^2 that went through `lowpass` once.
        lowpass : Lowpass
        usable : Mask
            Samples (N,) that count.
        """
        _, snap = differentiate(ddq, lowpass.rate_hz)
        bent = (snap @ self.per_snap.T)[usable]
        return np.asarray(np.mean(bent**2, axis=0))


class _Readings(NamedTuple):
    """Readings (N, L) of an IMU at the encoders' samples, and which of them count."""

    values: Array
    live: Mask


def beyond_motion(
    robot: Robot, t: Array, motion: tuple[Array, Array, Array], imus: list[Mounted]
) -> Array:
    """Return the accelerations that IMUs show beyond a motion, by least squares.

    Parameters
    ----------
    robot : Robot
    t : Array
        Times (N,) s of the samples.
    motion : tuple of Array
        q, dq, ddq (N, n) about which readings are linear.
    imus : list of Mounted
        With their raw readings of the whole log.

    Returns
    -------
    Array
        (N, n) rad/s^2; zero for joints beyond all IMUs.
    """
    n_samples, n_joints = motion[0].shape
    readings = [_on_encoders_clock(x, t) for x in imus]
    pieces = [
        slice(start, min(start + PIECE, n_samples))
        for start in range(0, n_samples, PIECE)
    ]

    # A bias that has changed since the calibration is no acceleration: means are taken
    # off first.
    means = [np.zeros(x.place.channels) for x in imus]
    for piece in pieces:
        states = np.stack([values[piece].T for values in motion])
        for x, of_imu, mean in zip(imus, readings, means, strict=True):
            state = link_state(robot, x.place.link, states)
            residual = _residual(x, state, of_imu.values[piece])
            counts = of_imu.live[piece].astype(float)
            n_live = np.maximum(of_imu.live.sum(axis=0), 1)
            mean += np.sum(residual * counts, axis=0) / n_live

    beyond = np.zeros((n_samples, n_joints))
    for piece in pieces:
        states = np.stack([values[piece].T for values in motion])
        length = piece.stop - piece.start
        normal = np.zeros((length, n_joints, n_joints))
        right = np.zeros((length, n_joints))
        for x, of_imu, mean in zip(imus, readings, means, strict=True):
            state = link_state(robot, x.place.link, states)
            residual = _residual(x, state, of_imu.values[piece])
            counts = of_imu.live[piece].astype(float)
            slopes = link_slopes(robot, x.place.link, states)
            by_ddq = x.place.by_motion(state, slopes)[:, :, 2]
            weighted = by_ddq * (counts / x.noise**2)[:, :, None]
            head = slice(x.joints)
            normal[:, head, head] += weighted.transpose(0, 2, 1) @ by_ddq
            right[:, head] += np.einsum("nki,nk->ni", weighted, residual - mean)
        beyond[piece] = _solved(normal, right)
    return beyond


def _residual(x: Mounted, state: Array, values: Array) -> Array:
    """Return readings (N, L) less what the motion of the link makes of them."""
    return np.asarray(values - (state @ x.place.matrix.T + x.bias))


def _on_encoders_clock(x: Mounted, t: Array) -> _Readings:
    """Return an IMU's readings as they were at the encoders' samples (N,) s."""
    if not (x.delay or x.rate):
        return _Readings(x.raw, x.live)
    later = t + x.delay + x.rate * (t - 0.5 * t[-1])
    values = [np.interp(later, t, channel) for channel in x.raw.T]
    live = [np.interp(later, t, counts.astype(float)) > 0.999 for counts in x.live.T]
    return _Readings(np.column_stack(values), np.column_stack(live))


def _solved(normal: Array, right: Array, *, hold: float = 1e-3) -> Array:
    """Solve for accelerations (N, n); `hold` (rad/s^2)^-2 keeps unseen ones at 0."""
    joints = np.arange(normal.shape[1])
    held = normal.copy()
    held[:, joints, joints] += hold
    return np.asarray(np.linalg.solve(held, right[:, :, None])[:, :, 0])


def compliance_of(
    apart: Array,
    ddq: Array,
    encoder: Motion,
    *,
    false_alarms: float = 0.001,
    fewest_blocks: int = 6,
) -> Compliance:
    """Find which links bend, by predicting blocks of the difference from all others.

    Parameters
    ----------
    apart : Array
        Link's acceleration minus drive's, (N, n) rad/s^2, low-passed once.
    ddq : Array
        The best acceleration known, (N, n) rad/s^2, low-passed alike.
    encoder : Motion
        Says which samples are usable, and which joints move.
    false_alarms : float
        Share of stiff joints that are taken to bend: the level of a t test of the mean
        gain.
    fewest_blocks : int
        With fewer no link is taken to bend.
    """
    per_snap = np.zeros((apart.shape[1],) * 2)
    used = np.flatnonzero(encoder.usable)
    moving = np.flatnonzero(encoder.moving.any(axis=0))
    count = int(len(used) / (BLOCK_S * encoder.rate_hz))
    if count < fewest_blocks or not len(moving):
        return Compliance(per_snap)

    # What an IMU's gain, mounting or clock would leave, and the snap behind it.
    jerk, snap = differentiate(ddq[:, moving], encoder.rate_hz)
    of_imus = np.hstack([ddq[used][:, moving], jerk[used]])
    columns = np.hstack([of_imus, snap[used]])
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    scaled = columns / size
    n_rigid = of_imus.shape[1]

    blocks = np.array_split(np.arange(len(used)), count)
    for j in moving:
        values = apart[used, j]
        weights = _weights_beside_jolts(scaled, values)
        if_bent = _left_by_others(scaled, values, weights, blocks)
        if_rigid = _left_by_others(scaled[:, :n_rigid], values, weights, blocks)
        gain = if_rigid - if_bent
        std_error = max(gain.std(ddof=1) / np.sqrt(count), 1e-300)
        if gain.mean() / std_error > student_quantile(count - 1, 1.0 - false_alarms):
            coefficients = _weighted(scaled, values, weights) / size
            per_snap[j, moving] = coefficients[n_rigid:]
    return Compliance(per_snap)


def _weighted(columns: Array, values: Array, weights: Array) -> Array:
    """Solve a weighted least squares (p,)."""
    root = np.sqrt(weights)
    weighted = columns * root[:, None]
    solution = np.linalg.lstsq(weighted, values * root, rcond=1e-10)[0]
    return np.asarray(solution)


def _weights_beside_jolts(columns: Array, values: Array, *, rounds: int = 5) -> Array:
    """Return weights (N,) of a Cauchy distribution: jolts last a few samples."""
    weights = np.ones(len(values))
    for _ in range(rounds):
        residual = values - columns @ _weighted(columns, values, weights)
        spread = max(float(gaussian_spread(residual)), 1e-300)
        weights = 1.0 / (1.0 + (residual / spread) ** 2)
    return weights


def _left_by_others(
    columns: Array, values: Array, weights: Array, blocks: list[Index]
) -> Array:
    """Return what each block leaves when all others predict it.

    It is a weighted mean square (B,).
    """
    # Normal equations add up over blocks: those of the others are the total less one.
    extended = np.column_stack([columns, values])
    of_blocks = [(columns[b].T * weights[b]) @ extended[b] for b in blocks]
    total = np.sum(of_blocks, axis=0)

    squares = []
    for block, of_block in zip(blocks, of_blocks, strict=True):
        of_others = total - of_block
        solution = np.linalg.lstsq(of_others[:, :-1], of_others[:, -1], rcond=1e-10)[0]
        residual = values[block] - columns[block] @ solution
        weight = weights[block]
        squares.append(float(np.sum(weight * residual**2) / np.sum(weight)))
    return np.array(squares)


def beyond_noise(
    apart: Array, encoder: Motion, *, max_noise_ratio: float = 1.5
) -> Array:
    """Return the power (n,) by which a motion contradicts the encoders beyond noise.

    Parameters
    ----------
    apart : Array
        That motion's acceleration minus the encoders', (N, n) rad/s^2, both below the
        encoders' cut-off. A better motion differs from them by their noise and less.
    encoder : Motion
    max_noise_ratio : float
        Share of the encoders' noise power that may be missed: quantisation is not
        white.
    """
    noise = encoder.cutoff.acceleration_noise**2
    power = np.mean(apart[encoder.usable] ** 2, axis=0)
    return np.asarray(np.where(power > max_noise_ratio * noise, power - noise, 0.0))
