"""IMU calibration (Sec. 3, Eq. 29-38): how each IMU is mounted on its link.

While one joint rotates and the others stand still, the direction of an IMU's angular acceleration
is that joint's axis (Eq. 29, 32). The encoders say what the axis is in the frame of the link that
carries the IMU (Eq. 33), so k such trials give pairs of directions, R b_k = m_k (Eq. 34-37). R is
their weighted least squares over proper rotations; Eq. 38 followed by the projection onto
rotations is the same where the axes span space, and unlike Eq. 38 this also works where they span
only a plane. The paper rotates joint 1; every joint before the IMU serves as well. Where all axes
are parallel the direction of gravity at rest is used too, and where that does not help either, the
angle about the axis is reported as not determined.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filtering import Lowpass, shrink
from seqid_cli.motion.imu_array import layout, read_angular, speed_about
from seqid_cli.motion.link_motion import axes_in_link
from seqid_cli.motion.motion import Motion, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import AxisReference, ImuCalibration, ImuStage, Stages, Verdict
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Imu, Robot

Array = NDArray[np.float64]

POOR_DEG = 0.5
UNDETERMINED_DEG = 5.0
FORCE_BIAS = 0.1  # m/s^2, how far an accelerometer's zero may be off when gravity is used
WEAKEST = 0.1  # rad/s^2 below which an acceleration says nothing


@dataclass(frozen=True)
class Pair:
    """One direction seen by the IMU and in its link's frame, with its standard deviation (rad)."""

    imu: Array
    link: Array
    sigma: float
    reference: tuple[int, AxisReference] | None = None


@dataclass(frozen=True)
class Trials:
    """What the logs say about one IMU."""

    pairs: list[Pair]
    gravity: list[Pair]
    density: float


def calibrate_imus(
    recordings: Iterable[Recording], robot: Robot, stages: Stages | None, *, options: MotionOptions
) -> ImuStage:
    """Find the mounting rotation of every IMU of the robot file.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs in which one joint rotates back and forth with acceleration, the others locked in
        several configurations.
    robot : Robot
        With its IMUs.
    stages : Stages, optional
        Not needed; accepted so that the parameter file can be carried on.
    options : MotionOptions
        Cut-off.

    Returns
    -------
    ImuStage
        Rotation from IMU to link, standard errors in degrees about the link's axes, references of
        Eq. 29-31, and what these logs do not determine.

    Raises
    ------
    UsageError
        If the robot file has no IMU.
    QualityError
        If no log rotates a single joint before any IMU.
    """
    if not robot.imus:
        raise UsageError(
            "the robot file has no [[imu]]", hint="describe the IMU in it", where=str(robot.source)
        )
    found: dict[str, list[Trials]] = {imu.name: [] for imu in robot.imus}
    cutoffs = []
    for recording in recordings:
        motion = estimate_motion(recording, robot, options)
        cutoffs.append(motion.cutoff.hz)
        for imu in robot.imus:
            if imu.name in recording.accelerometers:
                found[imu.name].append(_trials(recording, robot, imu, motion))
    if not any(trials.pairs for group in found.values() for trials in group):
        raise QualityError(
            "no log rotates one single joint before an IMU with its accelerometers recorded",
            hint="rotate the first joint back and forth with the others locked in several postures",
        )
    return _stage(robot, found, float(np.median(cutoffs)))


def _stage(robot: Robot, found: dict[str, list[Trials]], cutoff_hz: float) -> ImuStage:
    imus, verdicts, notes = {}, [], []
    for imu in robot.imus:
        pairs = [p for trials in found[imu.name] for p in trials.pairs]
        gravity = [p for trials in found[imu.name] for p in trials.gravity]
        if not layout(imu).acceleration and not imu.gyro:
            reason = "this layout of accelerometers does not determine angular acceleration"
            verdicts.append(Verdict(joint=imu.name, good=False, reason=reason))
            continue
        if not pairs:
            reason = "no log rotates a single joint before this IMU"
            verdicts.append(Verdict(joint=imu.name, good=False, reason=reason))
            continue
        density = float(np.median([t.density for t in found[imu.name] if t.pairs]))
        calibration = _calibrate(robot, imu, pairs, gravity, density)
        imus[imu.name] = calibration
        notes += [f"{imu.name}: {text}" for text in calibration.not_determined]
        verdicts.append(_verdict(robot, imu, calibration))
    return ImuStage(imus=imus, cutoff_hz=cutoff_hz, verdicts=verdicts, notes=notes)


def _verdict(robot: Robot, imu: Imu, calibration: ImuCalibration) -> Verdict:
    worst = calibration.std_error_deg
    reason = f"mounting known to {worst:.3g} degrees from {calibration.configurations} trials"
    missing = bool(calibration.not_determined)
    if missing:
        reason += "; " + "; ".join(calibration.not_determined)
        if _planar(robot, imu.after_joint):
            reason += ", and does not matter: every joint before the IMU turns about that axis"
            missing = False
    good = worst < POOR_DEG and not missing
    return Verdict(joint=imu.name, good=good, reason=reason)


def _planar(robot: Robot, link: int) -> bool:
    """Whether all joints up to a link turn about parallel axes, whatever their angles."""
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (8, robot.n))
    axes = axes_in_link(robot, q, link)[:, ~robot.chain.prismatic[: link + 1]]
    return bool(np.all(np.abs(axes @ robot.chain.axis[link]) > 1 - 1e-9))


def _trials(recording: Recording, robot: Robot, imu: Imu, motion: Motion) -> Trials:
    """Directions that one log shows: the axis of each joint that rotates by itself, and gravity."""
    values = recording.accelerometers[imu.name]
    gyro = recording.gyros.get(imu.name)
    lowpass = Lowpass(motion.lowpass.cutoff_hz, recording.rate_hz)
    reading = read_angular(imu, values, gyro, lowpass, recording.valid)
    raw = read_angular(imu, values, gyro, Lowpass(1e9, recording.rate_hz), recording.valid)
    alone = motion.usable & (motion.moving.sum(axis=1) == 1)
    still = shrink(~np.any(motion.moving, axis=1), 2 * motion.lowpass.settling)
    offset = reading.dw[still].mean(axis=0) if still.sum() > 20 else np.zeros(3)
    # Fourth differences keep the noise (times sqrt 70) and drop the motion.
    white = np.median(np.abs(np.diff(raw.dw, 4, axis=0)), axis=0) / 0.6745 / np.sqrt(70.0)
    density = float(np.sqrt(np.mean(white**2)) * np.sqrt(2 / recording.rate_hz))
    pairs = []
    for j in range(imu.after_joint + 1):
        own = alone & motion.moving[:, j]
        if own.sum() > 0.2 * motion.rate_hz and not robot.chain.prismatic[j]:
            pair = _axis_pair(robot, imu, motion, j, own, reading.dw - offset, reading.products)
            pairs += [pair] if pair else []
    return Trials(pairs, _gravity_pairs(robot, imu, motion, reading.force, still), density)


def _axis_pair(
    robot: Robot,
    imu: Imu,
    motion: Motion,
    j: int,
    own: NDArray[np.bool_],
    dw: Array,
    products: Array,
) -> Pair | None:
    """Eq. 29/32 and 33 for one joint of one log, with the references of Eq. 30 and 31."""
    a, encoder = dw[own], motion.ddq[own, j]
    direction = a.T @ encoder
    if np.linalg.norm(direction) < 1e-9 or np.sqrt(np.mean(encoder**2)) < WEAKEST:
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


def _gravity_pairs(
    robot: Robot, imu: Imu, motion: Motion, force: Array, still: NDArray[np.bool_]
) -> list[Pair]:
    """Specific force at rest against gravity in the link's frame, averaged over one log's rests."""
    size = float(np.linalg.norm(robot.gravity))
    if size < 1e-6 or still.sum() < 0.1 * motion.rate_hz:
        return []
    q = motion.q[still]
    R = forward(robot.chain, q[:: max(1, len(q) // 300)]).R[:, imu.after_joint]
    up = -np.einsum("nji,j->ni", R, robot.gravity) / size
    seen = force[still][:: max(1, len(q) // 300)]
    norm = np.linalg.norm(seen, axis=1)
    if np.any(np.abs(norm - size) > 0.2 * size):
        return []
    chosen = np.unique(np.linspace(0, len(up) - 1, 4).astype(int))
    return [Pair(seen[i] / norm[i], up[i], FORCE_BIAS / size) for i in chosen]


def _calibrate(
    robot: Robot, imu: Imu, pairs: list[Pair], gravity: list[Pair], density: float
) -> ImuCalibration:
    """Weighted rotation over all pairs; gravity joins where the axes leave an angle open."""
    used = pairs
    covariance = rotation_covariance(pairs)
    if _worst_deg(covariance) > UNDETERMINED_DEG:
        used = pairs + gravity
        covariance = rotation_covariance(used)
    R = fit_rotation(used)
    off = np.array([np.linalg.norm(R @ p.imu - p.link) for p in pairs])
    # Trials that disagree more than their noise widen the errors; they never narrow them.
    expected = np.array([p.sigma for p in pairs])
    dof = max(2 * len(pairs) - 3, 1)
    widening = max(1.0, float(np.sum((off / expected) ** 2) / dof))
    covariance = covariance * widening
    errors = np.degrees(np.sqrt(np.minimum(np.diag(covariance), np.pi**2)))
    worst = _worst_deg(covariance)
    open_axes = []
    if worst > UNDETERMINED_DEG:
        value, vector = np.linalg.eigh(covariance)
        axis = ", ".join(f"{x:.2f}" for x in vector[:, -1])
        open_axes.append(f"the angle about the link's axis ({axis}) is not determined")
        worst = float(np.degrees(np.sqrt(value[1])))
    references: dict[str, AxisReference] = {}
    for pair in pairs:
        if pair.reference:
            j, reference = pair.reference
            name = robot.joint_names[j]
            best = references.get(name)
            if best is None or reference.gain_std_error < best.gain_std_error:
                references[name] = reference
    return ImuCalibration(
        rotation=R.tolist(),
        std_error_deg=worst,
        std_errors_deg=errors.tolist(),
        configurations=len(pairs),
        condition=_condition(used),
        references=references,
        not_determined=open_axes,
        axis_rmse_deg=float(np.degrees(np.sqrt(np.mean(off**2)))),
        noise_density=density,
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


def rotation_covariance(pairs: list[Pair]) -> Array:
    """Covariance (3, 3) rad^2 of small rotations about the link's axes; huge where unknown."""
    information = np.zeros((3, 3))
    for pair in pairs:
        information += (np.eye(3) - np.outer(pair.link, pair.link)) / pair.sigma**2
    value, vector = np.linalg.eigh(information)
    covariance: Array = (vector / np.maximum(value, 1e-3)) @ vector.T
    return covariance


def _worst_deg(covariance: Array) -> float:
    return float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))


def _condition(pairs: list[Pair]) -> float:
    """Condition of the directions B of Eq. 37; 0 where they do not span space."""
    s = np.linalg.svd(np.array([p.imu for p in pairs]), compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == 3 and s[-1] > 1e-3 * s[0] else 0.0
