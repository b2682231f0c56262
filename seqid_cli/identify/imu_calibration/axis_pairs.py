"""Directions of joint axes as an IMU and as the encoders see them (Eq. 29-38).

While one joint rotates and the others stand still, the direction of an IMU's angular acceleration
is that joint's axis (Eq. 29, 32), and the encoders give it in the frame of the link that
carries the IMU (Eq. 33). k such pairs give the rotation R b_k = m_k (Eq. 34-37) by weighted least
squares over proper rotations; Eq. 38 followed by the projection onto rotations is the same where
the axes span space, and unlike Eq. 38 this also works where they span only a plane. The paper
rotates joint 1; every joint before the IMU serves as well.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.motion.imu.array import read_angular, speed_about
from seqid_cli.motion.imu.link_acceleration import axes_in_link
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import AxisReference
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class Pair:
    """One direction seen by the IMU and in its link's frame, with its standard deviation (rad)."""

    imu: Array
    link: Array
    sigma: float
    joint: str = ""
    reference: AxisReference | None = None


def axis_pairs(
    recording: Recording, robot: Robot, imu: Imu, motion: Motion, *, min_s: float = 0.2
) -> tuple[list[Pair], float]:
    """Axes that one log shows: of each joint that rotates by itself for at least `min_s` s.

    The noise density of the IMU's angular acceleration, rad/s^2/sqrt(Hz), comes second.
    """
    given = imu, recording.accelerometers[imu.name], recording.gyros.get(imu.name)
    lowpass = Lowpass(motion.lowpass.cutoff_hz, recording.rate_hz)
    reading = read_angular(*given, lowpass, recording.valid)
    raw = read_angular(*given, Lowpass(1e9, recording.rate_hz), recording.valid)
    density = float(np.sqrt(np.mean(white_noise(raw.dw) ** 2)) * np.sqrt(2 / recording.rate_hz))
    alone = motion.usable & (motion.moving.sum(axis=1) == 1)
    still = shrink(~np.any(motion.moving, axis=1), 2 * motion.lowpass.settling)
    offset = reading.dw[still].mean(axis=0) if still.sum() > 20 else np.zeros(3)
    pairs = []
    for j in range(imu.after_joint + 1):
        own = alone & motion.moving[:, j]
        if own.sum() > min_s * motion.rate_hz and not robot.chain.prismatic[j]:
            pair = _axis_pair(robot, imu, motion, j, own, reading.dw - offset, reading.products)
            pairs += [pair] if pair else []
    return pairs, density


def _axis_pair(
    robot: Robot,
    imu: Imu,
    motion: Motion,
    j: int,
    own: Mask,
    dw: Array,
    products: Array,
    *,
    min_acceleration: float = 0.1,
    clear_sigma: float = 5.0,
) -> Pair | None:
    """Eq. 29/32 and 33 for one joint of one log.

    None where the encoder tells less than an RMS of `min_acceleration` rad/s^2, or where the IMU
    does not see it: the gain is less than `clear_sigma` standard errors, and the direction noise's.
    """
    a, encoder = dw[own], motion.ddq[own, j]
    direction = a.T @ encoder
    if np.linalg.norm(direction) < 1e-9 or np.sqrt(np.mean(encoder**2)) < min_acceleration:
        return None
    direction = direction / np.linalg.norm(direction)
    # The IMU's own acceleration along the axis is less noisy than the encoder's: refine with it.
    direction = a.T @ (a @ direction)
    direction = direction / np.linalg.norm(direction)
    along = a @ direction
    power = float(along @ along)
    across = a - along[:, None] * direction
    memory = max(1.0, motion.rate_hz / (2 * motion.lowpass.cutoff_hz))
    sigma = float(np.sqrt(np.mean(np.sum(across**2, axis=1)) / 2 * memory / power))
    gain = float(along @ encoder) / power
    gain_error = float(np.sqrt(np.mean((encoder - gain * along) ** 2) * memory / power))
    if gain < clear_sigma * gain_error:
        return None
    axis = axes_in_link(robot, motion.q[own][:: max(1, own.sum() // 200)], imu.after_joint)[:, j]
    mean = axis.mean(axis=0)
    strongest = float(along[np.argmax(np.abs(along))])
    fastest = float(np.max(speed_about(products[own], direction)))
    reference = AxisReference(  # Eq. 30 and 31
        axis=direction.tolist(),
        acceleration=gain * strongest,
        angular_acceleration=(strongest * direction).tolist(),
        velocity=float(np.max(np.abs(motion.dq[own, j]))),
        angular_velocity=(fastest * direction).tolist(),
        gain=gain,
        gain_std_error=gain_error,
    )
    link = mean / np.linalg.norm(mean)
    return Pair(direction, link, max(sigma, 1e-5), robot.joint_names[j], reference)


def fit_rotation(pairs: list[Pair]) -> Array:
    """Proper rotation R (3, 3) least in sum |R b - m|^2 / sigma^2 (Eq. 38, Wahba's problem).

    That by the smallest angle where all pairs are of one axis.
    """
    B, M = (np.array([getattr(p, side) for p in pairs]).T for side in ("imu", "link"))
    if np.linalg.matrix_rank(B, tol=1e-2) == 1:
        b, m = B[:, 0], M[:, 0]
        c = float(b @ m)
        if c < -1 + 1e-12:
            return np.asarray(Rotation.align_vectors(m, b)[0].as_matrix())
        K = np.cross(np.eye(3), np.cross(b, m))
        return np.asarray(np.eye(3) + K + K @ K / (1 + c))
    U, _, Vt = np.linalg.svd((M * np.array([p.sigma for p in pairs]) ** -2.0) @ B.T)
    proper = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))])
    return np.asarray(U @ proper @ Vt)
