"""Where the IMU calibration begins: directions of joint axes, clock offset, mounting.

Directions of joint axes as an IMU and as the encoders see them (Eq. 29-38): while one
joint rotates and the others stand still, the direction of an IMU's angular acceleration
is that joint's axis (Eq. 29, 32), and the encoders give it in the frame of the link
that carries the IMU (Eq. 33). k such pairs give the rotation R b_k = m_k (Eq. 34-37) by
weighted least squares over proper rotations; Eq. 38 followed by the projection onto
rotations is the same where the axes span space, and unlike Eq. 38 this also works where
they span only a plane. The paper rotates joint 1; every joint before the IMU serves as
well.

Without a guess: each reading is a linear function of the link's specific force f and of
H (see `sensor_model`), with twelve coefficients and a bias, whatever the mounting. The
least-squares misfit over clocks finds that of each log (see `imu.clock`). The
same sums, 13 by 13, hold all that a mounting can be judged by, so that many starts cost
little.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from seqid_cli.imu.array import read_angular
from seqid_cli.imu.calibration.segments import Segment
from seqid_cli.imu.calibration.sensor_model import Constants, nominal_axes
from seqid_cli.imu.clock import (
    Clock,
    ClockScan,
    Sums,
    added,
    left_at,
    rates_of,
    scan_of,
    search,
    share_left,
    solved,
    sums_at,
)
from seqid_cli.imu.link_velocity import axes_in_link
from seqid_cli.imu.sensor import Mounting, link_state
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, shrink
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import AxisReference
from seqid_cli.robot.kinematics import turned_by
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A joint axis in the IMU's and in its link's frame, known to `sigma` rad."""

    imu: Array
    link: Array
    sigma: float
    joint: str
    reference: AxisReference


def axis_pairs(
    recording: Recording, robot: Robot, imu: Imu, motion: Motion, *, min_s: float = 0.2
) -> tuple[list[Pair], float]:
    """Return the axes of joints that rotate alone in one log, and the IMU's noise.

    Returns
    -------
    pairs : list of Pair
        Axis of each joint that rotates by itself for at least `min_s` s.
    density : float
        Noise density of the IMU's angular acceleration [rad/s^2/sqrt(Hz)].
    """
    accelerometers = recording.accelerometers[imu.name]
    gyro = recording.gyros.get(imu.name)
    rate_hz = recording.rate_hz
    lowpass = Lowpass(motion.lowpass.cutoff_hz, rate_hz)
    unfiltered = Lowpass(1e9, rate_hz)
    reading = read_angular(imu, accelerometers, gyro, lowpass, recording.valid)
    raw = read_angular(imu, accelerometers, gyro, unfiltered, recording.valid)
    noise = np.sqrt(np.mean(white_noise(raw.dw) ** 2))
    density = float(noise * np.sqrt(2 / rate_hz))

    alone = motion.usable & (motion.moving.sum(axis=1) == 1)
    still = shrink(~np.any(motion.moving, axis=1), 2 * motion.lowpass.settling)
    offset = reading.dw[still].mean(axis=0) if still.sum() > 20 else np.zeros(3)
    pairs = []
    for j in range(imu.after_joint + 1):
        moves_alone = alone & motion.moving[:, j]
        is_long = moves_alone.sum() > min_s * motion.rate_hz
        if not is_long or robot.chain.prismatic[j]:
            continue
        pair = _axis_pair(
            robot, imu, motion, j, moves_alone, reading.dw - offset, reading.products
        )
        if pair is not None:
            pairs.append(pair)
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
    """Return the axis of one joint of one log (Eq. 29/32 and 33), or None.

    None means that the encoder shows less than an RMS of `min_acceleration` rad/s^2, or
    that the IMU does not see the joint. Its gain is then below `clear_sigma` standard
    errors, and the direction is one of noise.
    """
    a = dw[own]
    encoder = motion.ddq[own, j]
    direction = a.T @ encoder
    if (
        np.linalg.norm(direction) < 1e-9
        or np.sqrt(np.mean(encoder**2)) < min_acceleration
    ):
        return None
    direction = direction / np.linalg.norm(direction)
    # The IMU's own acceleration along the axis is less noisy than the encoder's: refine
    # with it.
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
    axis = axes_in_link(
        robot, motion.q[own][:: max(1, own.sum() // 200)], imu.after_joint
    )[:, j]
    mean = axis.mean(axis=0)
    strongest = float(along[np.argmax(np.abs(along))])
    # of w about the axis
    square = np.einsum("nij,i,j->n", products[own], direction, direction)
    fastest = float(np.max(np.sqrt(np.maximum(square, 0.0))))
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
    return Pair(
        imu=direction,
        link=link,
        sigma=max(sigma, 1e-5),
        joint=robot.joint_names[j],
        reference=reference,
    )


def fit_rotation(pairs: list[Pair]) -> Array:
    """Return the rotation R (3, 3) from the IMU to its link by pairs of directions.

    R minimises sum |R b - m|^2 / sigma^2 over proper rotations (Eq. 38, Wahba's
    problem).
    """
    from scipy.spatial.transform import Rotation

    B = np.array([pair.imu for pair in pairs])
    M = np.array([pair.link for pair in pairs])
    if np.linalg.matrix_rank(B, tol=1e-2) == 1:  # one axis alone: by the smallest angle
        return np.asarray(Rotation.align_vectors(M[0], B[0])[0].as_matrix())
    U, _, Vt = np.linalg.svd((M.T * np.array([p.sigma for p in pairs]) ** -2.0) @ B)
    return np.asarray(
        U @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))]) @ Vt
    )


Tables = list[tuple[Segment, Array]]  # with f, H, w and one of its nodes (N, 16)
Clocks = dict[int, Clock]  # by the number of the log


def starting_constants(
    segments: list[Segment], robot: Robot, imu: Imu, guess: Array
) -> Constants:
    """Return the constants to begin with; `guess` (3, 3) is one of the starts."""
    from scipy.spatial.transform import Rotation

    tables = [(segment, _table(segment, robot, imu)) for segment in segments]
    clocks, sums = _clocks(tables)
    # The 24 ways in which a box may be screwed on are starts as well.
    sides = [("y", 90 * a) for a in range(4)] + [("z", 90), ("z", -90)]
    first = [Rotation.from_euler(*side, degrees=True) for side in sides]
    second = [Rotation.from_euler("x", 90 * b, degrees=True) for b in range(4)]
    turns = [(a * b).as_matrix() for a in first for b in second]
    tried = [_mounting(imu, sums, R) for R in (guess, *turns)]
    best = min(tried, key=lambda start: start.cost)

    of_logs = np.array([(clock.offset_s, clock.rate) for clock in clocks.values()])
    average = np.median(of_logs, axis=0)
    axes = nominal_axes(imu)
    return Constants(
        R=best.mounting.R,
        lever=best.mounting.lever,
        delay=float(average[0]),
        rate=float(average[1]),
        bias=best.bias,
        log_gain=np.zeros(len(axes)),
        tilt=np.zeros((len(axes), 2)),
        logs=tuple(clocks),
        clock_changes=of_logs - average,
    )


def _clocks(
    tables: Tables,
    *,
    largest_s: float = 0.5,
    coarse_s: float = 0.016,
    better: float = 0.7,
    rounds: int = 2,
) -> tuple[Clocks, Sums]:
    """Return the clock of least misfit of each log, and the sums of all at these.

    All logs have one clock, the encoders' own, unless others explain the readings
    better: they must leave less than the share `better` of the misfit.
    """
    fine = max(segment.spacing for segment, _ in tables)
    coarse = fine * max(1, round(coarse_s / fine))
    by_log: dict[int, Tables] = {}
    for segment, x in tables:
        by_log.setdefault(segment.log, []).append((segment, x))
    shortest = min(
        sum(segment.samples * segment.spacing for segment, _ in of_log)
        for of_log in by_log.values()
    )
    reach = int(min(largest_s, shortest / 4) / coarse)
    shifts = np.arange(-reach, reach + 1, dtype=np.float64) * coarse
    size = _sizes(tables)
    scans = {
        log: _scan(of_log, size, Clock(), shifts) for log, of_log in by_log.items()
    }

    # One clock for all logs.
    together = list(scans.values())
    rates = rates_of(together)
    likeliest = search(together, rates)
    common = Clock()
    if likeliest.cost < better * left_at(together, common):
        common = likeliest.clock
    clocks = dict.fromkeys(scans, common)

    # One mounting for all logs, by which each may have a clock of its own.
    for _ in range(rounds):
        sums = added([sums_at(scan, clocks[log]) for log, scan in scans.items()])
        theta = solved(sums)
        for log, scan in scans.items():
            likeliest = search([scan], rates, partial(_share_left, theta))
            is_better = likeliest.cost < better * left_at([scan], common, theta)
            clocks[log] = likeliest.clock if is_better else common

    # All clocks to a node, by the same step.
    steps = round(coarse / fine)
    small = np.arange(-steps, steps + 1, dtype=np.float64) * fine
    finer = [_scan(of_log, size, clocks[log], small) for log, of_log in by_log.items()]
    step = search(finer, np.zeros(1)).clock
    clocks = {
        log: replace(clock, offset_s=clock.offset_s + step.offset_s)
        for log, clock in clocks.items()
    }
    sums = added([sums_at(scan, step) for scan in finer])
    return clocks, Sums(xx=sums.xx, xy=sums.xy * size, yy=sums.yy * size**2)


def _share_left(theta: Array, sums: Sums, _: float) -> Array:
    """Return the share that one mounting leaves, whatever the rate."""
    return share_left(sums, theta)


def _sizes(tables: Tables) -> Array:
    """Return the standard deviation (C,) of the readings, which have several units."""
    values = np.concatenate([segment.readings.values for segment, _ in tables])
    return np.asarray(np.maximum(np.std(values, axis=0), 1e-6))


def _scan(tables: Tables, size: Array, clock: Clock, shifts: Array) -> ClockScan:
    """Sum the tables of one log for shifts (S,) s beyond a clock, readings by size."""
    readings = tables[0][0].readings
    origin_s = tables[0][0].origin_s
    period = readings.t[1] - readings.t[0]
    values = readings.values / size
    t = np.concatenate([segment.elapsed for segment, _ in tables])
    x = np.concatenate([x for _, x in tables])
    late = clock.at(t)

    def read(instants: Array) -> tuple[Array, Array]:
        """Return the readings (N, C) next to stamps, and whether they count (N,)."""
        stamps = instants + late - origin_s
        at = np.round((stamps - readings.t[0]) / period)
        inside = (at >= 0) & (at < len(readings.t))
        index = np.clip(at, 0, len(readings.t) - 1).astype(np.intp)
        counts = inside & readings.good[index].all(axis=1)
        return values[index], counts.astype(np.float64)

    return scan_of(t, x, read, shifts)


def _table(
    segment: Segment, robot: Robot, imu: Imu, *, lowest_hz: float = 3.0
) -> Array:
    """Return regressors (N, 16) from encoders alone, smooth enough to differentiate."""
    rate = 1.0 / segment.spacing
    hz = float(min(segment.cutoff_hz, max(lowest_hz, segment.encoder_hz)))
    q = Lowpass(hz, rate)(segment.motion[0].T)
    motion = np.stack([q, *differentiate(q, rate)]).transpose(0, 2, 1)
    motion[1:, [j for j in range(robot.n) if j not in segment.moving]] = 0.0
    x = link_state(robot, imu.after_joint, motion)
    return np.hstack([x, np.ones((len(x), 1))])


class _Start(NamedTuple):
    """A mounting to begin with, its cost, and the biases (C,) that follow from it."""

    cost: float
    mounting: Mounting
    bias: Array


def _mounting(imu: Imu, sums: Sums, R: Array, *, hold: float = 1e-3) -> _Start:
    """Return what a least-squares fit from one turn `R` (3, 3) ends with.

    The fit of turn and lever takes the sums alone, and biases follow. `hold` is the
    weight on the lever, in readings' noise per m.
    """
    from scipy.optimize import least_squares

    xx, xy, yy = sums
    samples = max(float(xx[-1, -1]), 1.0)
    x_mean = xx[-1, :-1] / samples
    y_mean = xy[-1] / samples
    value, vector = np.linalg.eigh(xx[:-1, :-1] / samples - np.outer(x_mean, x_mean))
    kept = value > 1e-10 * value[-1]
    root = (vector[:, kept] * np.sqrt(value[kept])).T  # x'x = root' root
    centred = xy[:-1] / samples - np.outer(x_mean, y_mean)
    target = (vector[:, kept] / np.sqrt(value[kept])).T @ centred
    size = np.sqrt(np.maximum(yy / samples - y_mean**2, 1e-6))

    axes = nominal_axes(imu)

    def placed(step: Array) -> Mounting:
        """Return the mounting after a turn and with a lever (6,)."""
        turned = turned_by(step[:3]) @ R
        return Mounting(
            imu.after_joint, imu.positions.reshape(-1, 3), axes, turned, step[3:]
        )

    def off(step: Array) -> Array:
        """Return the misfit of the readings, and the weight on the lever."""
        misfit = (root @ placed(step).matrix.T - target) / size
        return np.concatenate([misfit.ravel(), hold * step[3:]])

    result = least_squares(off, np.zeros(6), method="lm")
    mounting = placed(result.x)
    return _Start(
        cost=float(result.cost),
        mounting=mounting,
        bias=y_mean - mounting.matrix @ x_mean,
    )
