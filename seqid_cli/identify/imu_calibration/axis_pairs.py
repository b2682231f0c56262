"""Directions of joint axes as an IMU and as the encoders see them (Eq. 29-38).

While one joint rotates and the others stand still, the direction of an IMU's angular acceleration
is that joint's axis (Eq. 29, 32), and the encoders give it in the frame of the link that
carries the IMU (Eq. 33). k such pairs give the rotation R b_k = m_k (Eq. 34-37) by weighted least
squares over proper rotations; Eq. 38 followed by the projection onto rotations is the same where
the axes span space, and unlike Eq. 38 this also works where they span only a plane. The paper
rotates joint 1; every joint before the IMU serves as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    reference: tuple[int, AxisReference] | None = None


@dataclass(frozen=True)
class Trials:
    """Directions of one IMU's axes in one log; `density` rad/s^2/sqrt(Hz) of its acceleration."""

    pairs: list[Pair]
    density: float


def axis_trials(recording: Recording, robot: Robot, imu: Imu, motion: Motion) -> Trials:
    """Directions that one log shows: the axis of each joint that rotates by itself."""
    values = recording.accelerometers[imu.name]
    gyro = recording.gyros.get(imu.name)
    lowpass = Lowpass(motion.lowpass.cutoff_hz, recording.rate_hz)
    reading = read_angular(imu, values, gyro, lowpass, recording.valid)
    raw = read_angular(imu, values, gyro, Lowpass(1e9, recording.rate_hz), recording.valid)
    alone = motion.usable & (motion.moving.sum(axis=1) == 1)
    still = shrink(~np.any(motion.moving, axis=1), 2 * motion.lowpass.settling)
    offset = reading.dw[still].mean(axis=0) if still.sum() > 20 else np.zeros(3)
    density = float(np.sqrt(np.mean(white_noise(raw.dw) ** 2)) * np.sqrt(2 / recording.rate_hz))
    pairs = []
    for j in range(imu.after_joint + 1):
        own = alone & motion.moving[:, j]
        if own.sum() > 0.2 * motion.rate_hz and not robot.chain.prismatic[j]:
            pair = _axis_pair(robot, imu, motion, j, own, reading.dw - offset, reading.products)
            pairs += [pair] if pair else []
    return Trials(pairs, density)


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
) -> Pair | None:
    """Eq. 29/32 and 33 for one joint of one log, with the references of Eq. 30 and 31.

    None where its acceleration (RMS) is below `min_acceleration` rad/s^2.
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
    left = encoder - gain * along
    gain_error = float(np.sqrt(np.mean(left**2) * memory / power))
    axis = axes_in_link(robot, motion.q[own][:: max(1, own.sum() // 200)], imu.after_joint)[:, j]
    mean = axis.mean(axis=0)
    reference = _reference(direction, gain, gain_error, along, motion.dq[own, j], products[own])
    return Pair(direction, mean / np.linalg.norm(mean), max(sigma, 1e-5), (j, reference))


def _reference(
    direction: Array, gain: float, gain_error: float, along: Array, dq: Array, products: Array
) -> AxisReference:
    """Reference motion of Eq. 30 and 31 at the strongest acceleration and the highest speed."""
    strongest = float(along[np.argmax(np.abs(along))])
    fastest = float(np.max(speed_about(products, direction)))
    return AxisReference(
        axis=direction.tolist(),
        acceleration=gain * strongest,
        angular_acceleration=(strongest * direction).tolist(),
        velocity=float(np.max(np.abs(dq))),
        angular_velocity=(fastest * direction).tolist(),
        gain=gain,
        gain_std_error=gain_error,
    )


def fit_rotation(pairs: list[Pair]) -> Array:
    """Proper rotation R (3, 3) least in sum |R b - m|^2 / sigma^2 (Eq. 38, Wahba's problem)."""
    B = np.array([p.imu for p in pairs]).T
    M = np.array([p.link for p in pairs]).T
    weight = np.array([p.sigma for p in pairs]) ** -2.0
    U, _, Vt = np.linalg.svd((M * weight) @ B.T)
    proper = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))])
    R: Array = U @ proper @ Vt
    if np.linalg.matrix_rank(B, tol=1e-2) == 1:
        return shortest_rotation(B[:, 0], M[:, 0])
    return R


def shortest_rotation(b: Array, m: Array) -> Array:
    """Rotation that turns b into m by the smallest angle, where only one axis is known."""
    v, c = np.cross(b, m), float(b @ m)
    if c < -1 + 1e-12:
        across = np.cross(b, [1.0, 0.0, 0.0] if abs(b[0]) < 0.9 else [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        half: Array = 2 * np.outer(across, across) - np.eye(3)
        return half
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    R: Array = np.eye(3) + K + K @ K / (1 + c)
    return R


def condition_of(pairs: list[Pair]) -> float:
    """Condition of the directions B of Eq. 37; 0 where they do not span space."""
    s = np.linalg.svd(np.array([p.imu for p in pairs]), compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == 3 and s[-1] > 1e-3 * s[0] else 0.0


def best_references(pairs: list[Pair], names: tuple[str, ...]) -> dict[str, AxisReference]:
    """The most certain reference of Eq. 30 and 31 for each joint."""
    references: dict[str, AxisReference] = {}
    for pair in pairs:
        if pair.reference:
            j, reference = pair.reference
            best = references.get(names[j])
            if best is None or reference.gain_std_error < best.gain_std_error:
                references[names[j]] = reference
    return references
