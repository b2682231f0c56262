"""What encoders and IMUs say of each other: errors that no noise model of either knows.

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
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.imu.sensor import link_slopes, link_state
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.smoother.chunk import Mounted
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
        usable : Mask
            Samples (N,) that count.
        """
        snap = differentiate(ddq, lowpass.rate_hz)[1]
        bent = (snap @ self.per_snap.T)[usable]
        return np.asarray(np.mean(bent**2, axis=0))


def beyond_motion(
    robot: Robot, t: Array, motion: tuple[Array, Array, Array], imus: list[Mounted]
) -> Array:
    """Return the accelerations that IMUs show beyond a motion, by least squares per sample.

    Parameters
    ----------
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
    samples, joints = motion[0].shape
    found = np.zeros((samples, joints))
    readings = [_on_encoders_clock(x, t) for x in imus]
    means = [np.zeros(x.place.channels) for x in imus]

    # A bias that has changed since the calibration is no acceleration: means are taken
    # off first.
    for removing_means in (True, False):
        for start in range(0, samples, PIECE):
            own = slice(start, min(start + PIECE, samples))
            states = np.stack([values[own].T for values in motion])
            normal = np.zeros((own.stop - start, joints, joints))
            right = np.zeros((own.stop - start, joints))
            for x, (values, live), mean in zip(imus, readings, means, strict=True):
                state = link_state(robot, x.place.link, states)
                off = values[own] - (state @ x.place.matrix.T + x.bias)
                seen = live[own].astype(float)
                if removing_means:
                    mean += np.sum(off * seen, axis=0) / np.maximum(live.sum(axis=0), 1)
                    continue
                slopes = link_slopes(robot, x.place.link, states)
                by_ddq = x.place.by_motion(state, slopes)[:, :, 2]
                weighted = by_ddq * (seen / x.noise**2)[:, :, None]
                head = slice(x.joints)
                normal[:, head, head] += weighted.transpose(0, 2, 1) @ by_ddq
                right[:, head] += np.einsum("nki,nk->ni", weighted, off - mean)
            if not removing_means:
                found[own] = _solved(normal, right)
    return found


def _on_encoders_clock(x: Mounted, t: Array) -> tuple[Array, Mask]:
    """Readings (N, K) as they were at the encoders' samples, and which count."""
    if not x.delay:
        return x.raw, x.live
    values = [np.interp(t + x.delay, t, column) for column in x.raw.T]
    live = [
        np.interp(t + x.delay, t, column.astype(float)) > 0.999 for column in x.live.T
    ]
    return np.column_stack(values), np.column_stack(live)


def _solved(normal: Array, right: Array, *, hold: float = 1e-3) -> Array:
    """Solve for accelerations (N, n); `hold` (rad/s^2)^-2 keeps what no IMU sees at zero."""
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
    """
    per_snap = np.zeros((apart.shape[1],) * 2)
    used = np.flatnonzero(encoder.usable)
    moving = np.flatnonzero(encoder.moving.any(axis=0))
    count = int(len(used) / (BLOCK_S * encoder.rate_hz))
    if count < fewest_blocks or not len(moving):
        return Compliance(per_snap)

    jerk, snap = (
        values[used] for values in differentiate(ddq[:, moving], encoder.rate_hz)
    )
    of_imus = np.hstack([ddq[used][:, moving], jerk])
    columns = np.hstack([of_imus, snap])
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    blocks = np.array_split(np.arange(len(used)), count)
    for j in moving:
        values = apart[used, j]
        weights = _weights_beside_jolts(columns / size, values)
        bent = _left_by_others(columns / size, values, weights, blocks)
        rigid = _left_by_others(
            (columns / size)[:, : of_imus.shape[1]], values, weights, blocks
        )
        gain = rigid - bent
        t_value = gain.mean() / max(gain.std(ddof=1) / np.sqrt(count), 1e-300)
        if t_value > stdtrit(count - 1, 1.0 - false_alarms):
            found = _weighted(columns / size, values, weights) / size
            per_snap[j, moving] = found[of_imus.shape[1] :]
    return Compliance(per_snap)


def _weighted(columns: Array, values: Array, weights: Array) -> Array:
    """Weighted least squares (p,)."""
    root = np.sqrt(weights)
    return np.asarray(
        np.linalg.lstsq(columns * root[:, None], values * root, rcond=1e-10)[0]
    )


def _weights_beside_jolts(columns: Array, values: Array, *, rounds: int = 5) -> Array:
    """Weights (N,) of a Cauchy distribution: jolts between two samples last a few samples."""
    weights = np.ones(len(values))
    for _ in range(rounds):
        off = values - columns @ _weighted(columns, values, weights)
        spread = max(float(gaussian_spread(off)), 1e-300)
        weights = 1.0 / (1.0 + (off / spread) ** 2)
    return weights


def _left_by_others(
    columns: Array, values: Array, weights: Array, blocks: list[Index]
) -> Array:
    """Weighted mean square (B,) that each block leaves when all others predict it."""
    own = [
        (columns[b].T * weights[b]) @ np.column_stack([columns, values])[b]
        for b in blocks
    ]
    total = np.sum(own, axis=0)
    left = []
    for block, matrix in zip(blocks, own, strict=True):
        others = total - matrix
        found = np.linalg.lstsq(others[:, :-1], others[:, -1], rcond=1e-10)[0]
        off = values[block] - columns[block] @ found
        left.append(float(np.sum(weights[block] * off**2) / np.sum(weights[block])))
    return np.array(left)


def beyond_noise(
    apart: Array, encoder: Motion, *, max_noise_ratio: float = 1.5
) -> Array:
    """Return the power (n,) by which a motion contradicts the encoders beyond their noise.

    Parameters
    ----------
    apart : Array
        That motion's acceleration minus the encoders', (N, n) rad/s^2, both below the
        encoders' cut-off. A better motion differs from them by their noise and less.
    max_noise_ratio : float
        Share of the encoders' noise power that may be missed: quantisation is not
        white.
    """
    noise = encoder.cutoff.acceleration_noise**2
    power = np.mean(apart[encoder.usable] ** 2, axis=0)
    return np.asarray(np.where(power > max_noise_ratio * noise, power - noise, 0.0))
