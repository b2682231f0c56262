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

from seqid_cli.imu.array import layout, read_angular
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.kinematics import forward, link_angular_motion
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array

NO_LOWPASS_HZ = 1e9


@dataclass(frozen=True, kw_only=True)
class Turning:
    """What one IMU says of its link's angular velocity, in the link's frame.

    Attributes
    ----------
    link : int
    rates : Array, optional
        (N, 3) rad/s of a gyro.
    products : Array
        (N, 3, 3) rad^2/s^2, of an array if there is no gyro. Neither went through a
        low-pass.
    noise : float
        Standard deviation of either below the motion's cut-off.
    """

    link: int
    rates: Array | None
    products: Array
    noise: float


@dataclass(frozen=True, kw_only=True)
class JointVelocities:
    """Velocities (N, n) rad/s below the cut-off, and their standard deviation (n,)."""

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
    """Return what an IMU says of its link's angular velocity; None if nothing.

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
    sees = layout(imu)
    if gyro is None and not sees.products:
        return None
    no_lowpass = Lowpass(NO_LOWPASS_HZ, motion.rate_hz)
    reading = read_angular(imu, accelerations, gyro, no_lowpass, motion.valid)

    # Of white noise per sample, what lies below the cut-off.
    band = np.sqrt(min(2.0 * motion.lowpass.cutoff_hz / motion.rate_hz, 1.0))
    if gyro is None:
        per_reading = float(np.sqrt(np.mean(sees.errors[6:] ** 2)))
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
    """Return joint velocities by all IMUs (Eq. 31 and 41), or else the encoders'.

    Parameters
    ----------
    motion : Motion
        By the encoders, at the log's own rate; its velocity gives the signs.
    turning : list of Turning
        One of each IMU that sees its link's angular velocity; none leaves the
        encoders'.
    """
    hz = motion.lowpass.cutoff_hz
    density = motion.cutoff.noise_density
    encoder_noise = np.sqrt(density * (2 * np.pi) ** 2 * hz**3 / 3)
    moving = np.flatnonzero(motion.moving.any(axis=0))
    if not turning or not len(moving):
        return JointVelocities(dq=motion.dq, error=encoder_noise)

    # The encoders' part of the normal equations. Both sources come before the low-pass,
    # so that it acts once on either.
    encoder, _ = differentiate(recording.q, motion.rate_hz, motion.valid)
    information = np.maximum(encoder_noise[moving], 1e-12) ** -2.0
    count = len(moving)
    normal = np.zeros((motion.samples, count, count))
    normal[:, range(count), range(count)] = information
    right = information * encoder[:, moving]

    # The IMUs' part: w_m = sum of z_i dq_i.
    still = np.zeros_like(motion.q)
    for of_imu in turning:
        link = of_imu.link
        w_e = link_angular_motion(robot.chain, motion.q, motion.dq, still, link)[0]
        w, weight = _angular_velocity(of_imu, w_e, motion)
        moves_link = moving <= link
        axes = axes_in_link(robot, motion.q, link)[:, moving[moves_link]]
        J = np.zeros((motion.samples, 3, count))
        J[:, :, moves_link] = axes.swapaxes(1, 2)
        weighted = np.einsum("nji,njk->nik", J, weight)
        normal += weighted @ J
        right += np.einsum("nik,nk->ni", weighted, w)

    solved = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    unfiltered = np.where(motion.valid[:, None], solved, 0.0)
    dq = motion.dq.copy()
    dq[:, moving] = motion.lowpass(unfiltered, motion.valid)
    variance = np.linalg.inv(normal)[motion.usable].mean(axis=0).diagonal()
    error = encoder_noise.copy()
    error[moving] = np.sqrt(variance)
    return JointVelocities(dq=dq, error=error)


def _angular_velocity(
    of_imu: Turning, w_e: Array, motion: Motion
) -> tuple[Array, Array]:
    """Estimate a link's angular velocity by its IMU, before any low-pass.

    `w_e` (N, 3) rad/s, by the encoders and low-passed, has the sign. Returns w (N, 3)
    rad/s and its information (N, 3, 3).
    """
    if of_imu.rates is not None:
        bias = (of_imu.rates - w_e)[motion.usable].mean(axis=0)
        weight = np.broadcast_to(np.eye(3) / of_imu.noise**2, (len(w_e), 3, 3))
        return of_imu.rates - bias, weight

    # d of the module's text, from w w' - w_e w_e' = w_e d' + d w_e'.
    difference = of_imu.products - w_e[:, :, None] * w_e[:, None, :]
    difference = difference - difference[motion.usable].mean(axis=0)
    square = np.maximum(np.sum(w_e**2, axis=1), 1e-12)
    by_w_e = np.einsum("nij,nj->ni", difference, w_e)
    along = 0.5 * np.sum(by_w_e * w_e, axis=1) / square
    d = (by_w_e - w_e * along[:, None]) / square[:, None]

    # Along w_e the square is known, 2 |w_e| d; across it a product, |w_e| d.
    direction = w_e / np.sqrt(square)[:, None]
    shape = np.eye(3) + 3.0 * direction[:, :, None] * direction[:, None, :]
    return w_e + d, shape * (square / of_imu.noise**2)[:, None, None]


def axes_in_link(robot: Robot, q: Array, link: int) -> Array:
    """Return the joint axes up to a link, in the frame of that link.

    Parameters
    ----------
    robot : Robot
    q : Array
        Positions (N, n) rad.
    link : int

    Returns
    -------
    Array
        (N, link + 1, 3); zero where prismatic.
    """
    frames = forward(robot.chain, q)
    axes: Array = np.einsum("nji,nkj->nki", frames.R[:, link], frames.z[:, : link + 1])
    axes[:, robot.chain.prismatic[: link + 1]] = 0.0
    return axes
