"""Joint velocities from the angular velocities of links (Eq. 31 and 41).

A link m turns with w_m = sum_{i <= m} z_i dq_i, z_i the joint axes in its frame. With
one moving joint the components of w_m over those of the axis are its velocity (Eq. 31);
with two, the second one's is what the first leaves of the second IMU's (Eq. 41). All
IMUs together, each sample is a small least squares, of which both are cases.

A gyro reads w. An array of accelerometers reads the products w w', so w up to its sign.
The encoders' differentiated position w_e has the sign, and the root is taken about it:
with w w' - w_e w_e' = w_e d' + d w_e', w = w_e + d. That is linear in the readings, so
their noise does not rectify into a bias. Products of slow turning say nothing of w: d
has the products' noise over |w_e|. There the encoders' own velocity, which is never
without weight, takes over.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.imu.array import layout, read_angular
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.kinematics import forward, link_angular_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array

NO_LOWPASS_HZ = 1e9


@dataclass(frozen=True, kw_only=True)
class Turning:
    """What one IMU says of its link's angular velocity, in the link's frame, sample by sample.

    `rates` (N, 3) rad/s of a gyro, or `products` (N, 3, 3) rad^2/s^2 of an array;
    `noise` is the standard deviation of either below the motion's cut-off. Neither went
    through a low-pass.
    """

    link: int
    rates: Array | None
    products: Array
    noise: float


@dataclass(frozen=True, kw_only=True)
class JointVelocities:
    """Velocities (N, n) rad/s below the motion's cut-off, and their standard deviation (n,)."""

    dq: Array
    error: Array


def turning_of(
    imu: Imu,
    rotation: Array,
    accelerations: Array,
    gyro: Array | None,
    motion: Motion,
    *,
    axis_error: float,
) -> Turning | None:
    """Return what an IMU says of its link's angular velocity, or None where it does not see it.

    Parameters
    ----------
    imu : Imu
        With the sensing axes as calibrated.
    rotation : Array
        (3, 3), from the IMU's frame to the link's.
    accelerations, gyro : Array
        (N, K) m/s^2 and (N, 3) rad/s on the encoders' clock, biases and gains taken
        off.
    axis_error : float
        Share of the angular velocity by which axes and gains may be off.
    """
    seen = layout(imu)
    if gyro is None and not seen.products:
        return None
    raw = Lowpass(NO_LOWPASS_HZ, motion.rate_hz)
    reading = read_angular(imu, accelerations, gyro, raw, motion.valid)

    # Of white noise per sample, what lies below the cut-off.
    band = np.sqrt(min(2.0 * motion.lowpass.cutoff_hz / motion.rate_hz, 1.0))
    if gyro is None:
        per_reading = float(np.sqrt(np.mean(seen.errors[6:] ** 2)))
        white = per_reading * float(np.sqrt(np.mean(white_noise(accelerations) ** 2)))
        size = float(np.sqrt(np.mean(np.sum(reading.products**2, axis=(1, 2)))))
    else:
        white = float(np.sqrt(np.mean(white_noise(gyro) ** 2)))
        size = float(np.sqrt(np.mean(np.sum(gyro**2, axis=1))))
    rates = None if reading.w is None else reading.w @ rotation.T
    products = rotation @ reading.products @ rotation.T
    noise = float(np.hypot(white * band, axis_error * size))
    return Turning(
        link=imu.after_joint, rates=rates, products=products, noise=max(noise, 1e-9)
    )


def joint_velocities(
    recording: Recording, robot: Robot, motion: Motion, turning: list[Turning]
) -> JointVelocities:
    """Return joint velocities by all IMUs (Eq. 31 and 41), the encoders' where none says better.

    Parameters
    ----------
    motion : Motion
        By the encoders, at the log's own rate; its velocity gives the signs.
    turning : list of Turning
        One of each IMU that sees its link's angular velocity; none leaves the
        encoders'.
    """
    hz, density = motion.lowpass.cutoff_hz, motion.cutoff.noise_density
    encoder_noise = np.sqrt(density * (2 * np.pi) ** 2 * hz**3 / 3)
    moving = np.flatnonzero(motion.moving.any(axis=0))
    if not turning or not len(moving):
        return JointVelocities(dq=motion.dq, error=encoder_noise)

    # Both sources before the low-pass, so that it acts once on either.
    encoder, _ = differentiate(recording.q, motion.rate_hz, motion.valid)
    information = np.maximum(encoder_noise[moving], 1e-12) ** -2.0
    count = len(moving)
    normal = np.zeros((motion.samples, count, count))
    normal[:, range(count), range(count)] = information
    right = information * encoder[:, moving]
    still = np.zeros_like(motion.q)
    for one in turning:
        w_e = link_angular_motion(robot.chain, motion.q, motion.dq, still, one.link)[0]
        w, weight = _angular_velocity(one, w_e, motion)
        J = np.zeros((motion.samples, 3, count))
        before = moving <= one.link
        axes = axes_in_link(robot, motion.q, one.link)[:, moving[before]]
        J[:, :, before] = axes.swapaxes(1, 2)
        weighted = np.einsum("nji,njk->nik", J, weight)
        normal += weighted @ J
        right += np.einsum("nik,nk->ni", weighted, w)
    raw = np.where(
        motion.valid[:, None], np.linalg.solve(normal, right[:, :, None])[:, :, 0], 0.0
    )

    dq, error = motion.dq.copy(), encoder_noise.copy()
    dq[:, moving] = motion.lowpass(raw, motion.valid)
    variance = np.linalg.inv(normal)[motion.usable].mean(axis=0).diagonal()
    error[moving] = np.sqrt(variance)
    return JointVelocities(dq=dq, error=error)


def _angular_velocity(one: Turning, w_e: Array, motion: Motion) -> tuple[Array, Array]:
    """Angular velocity (N, 3) rad/s of a link before any low-pass, and its information (N, 3, 3).

    `w_e` (N, 3) rad/s, by the encoders and low-passed, has the sign.
    """
    if one.rates is not None:
        off = one.rates - w_e
        bias = off[motion.usable].mean(axis=0)
        weight = np.broadcast_to(np.eye(3) / one.noise**2, (len(w_e), 3, 3))
        return one.rates - bias, weight

    off = one.products - w_e[:, :, None] * w_e[:, None, :]
    off = off - off[motion.usable].mean(axis=0)
    square = np.maximum(np.sum(w_e**2, axis=1), 1e-12)
    across = np.einsum("nij,nj->ni", off, w_e)
    along = 0.5 * np.sum(across * w_e, axis=1) / square
    change = (across - w_e * along[:, None]) / square[:, None]

    # Along w_e the square is known, 2 |w_e| d; across it a product, |w_e| d.
    direction = w_e / np.sqrt(square)[:, None]
    shape = np.eye(3) + 3.0 * direction[:, :, None] * direction[:, None, :]
    return w_e + change, shape * (square / one.noise**2)[:, None, None]


def axes_in_link(robot: Robot, q: Array, link: int) -> Array:
    """Axes (N, link + 1, 3) of joints 0..link in the frame of `link`; zero where prismatic."""
    frames = forward(robot.chain, q)
    axes: Array = np.einsum("nji,nkj->nki", frames.R[:, link], frames.z[:, : link + 1])
    axes[:, robot.chain.prismatic[: link + 1]] = 0.0
    return axes
