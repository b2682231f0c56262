"""The smoother against a dense nonlinear least-squares problem, written down here once
more.

It follows docs/explanation/fused_motion.md: splines by scipy's B-splines, every reading
at its own time, all unknowns in one vector, their slopes by differences. The size of
the jerk and the noise are given, and an encoder's weights are those at the solution.
Knots lie further apart than the smoother's cells, so that it shares no Jacobians
either.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from seqid_cli.imu.bordered import halved
from seqid_cli.imu.sensor import Mounting, link_state
from seqid_cli.imu.smoother.chunk import CELL_S, Chunk, Jerk, Mounted, encoder_view
from seqid_cli.imu.smoother.imus import mounted_imus, read
from seqid_cli.imu.smoother.solve import Solution, encoder_motion, renewed
from seqid_cli.imu.smoother.system import linearised
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array
from tests.plants.arms.rigs import two_joint
from tests.plants.robots.lab import robot_of
from tests.plants.robots.made import made_recording
from tests.plants.sensors import quantise

pytestmark = pytest.mark.slow

DT = 0.02  # s, between samples and between knots
SAMPLES = 60
GRAVITY = np.array([2.0, -1.0, -9.5])
NOISE = 0.05  # m/s^2
LATE = {"imu_a": 0.0073, "imu_b": -0.0116}  # s, by which an IMU's stamps are late
EDGE_SHARE = 0.03  # of a count, by which the edges' places are off
JERK = Jerk(
    size=np.array([60.0, 90.0]),
    correlation=np.array([[1.0, -0.4], [-0.4, 1.0]]),
    relative=1.0 + 0.5 * np.sin(np.arange(2 * SAMPLES).reshape(SAMPLES, 2) / 7.0),
)
TOLERANCE = 1e-6  # of the stated error


def true_motion(t: Array) -> Array:
    w = np.array([3.1, 4.3])
    a = np.array([0.9, 0.7])
    angle = np.outer(t, w) + np.array([0.3, -1.1])
    return np.stack(
        [a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)]
    )


def readings(
    robot: Robot, place: Mounting, motion: Array, turn: Array | None = None
) -> Array:
    """Readings (N, K) without bias of an IMU by q, dq, ddq (3, N, 2), turned a little
    (3,).
    """
    turned = (
        Rotation.from_rotvec(np.zeros(3) if turn is None else turn).as_matrix()
        @ place.R
    )
    state = link_state(robot, place.link, motion.swapaxes(1, 2))
    return np.asarray(state @ replace(place, R=turned).matrix.T)


def scene(step: float) -> Chunk:
    """1.2 s of two joints with two accelerometer arrays, calibrated a little wrong."""
    rng = np.random.default_rng(5)
    plant = two_joint()
    plant = replace(plant, arm=replace(plant.arm, gravity=GRAVITY))
    robot = robot_of("two", plant)
    t = DT * np.arange(SAMPLES)

    accelerometers = {}
    calibrations = {}
    for imu in plant.imus:
        place = Mounting(
            link=imu.after,
            positions=imu.positions,
            axes=imu.axes,
            R=imu.rotation,
            lever=imu.lever,
        )
        clean = readings(robot, place, true_motion(t - LATE[imu.name]))
        bias = 0.1 * rng.standard_normal(12)
        accelerometers[imu.name] = (
            clean + bias + NOISE * rng.standard_normal(clean.shape)
        )
        off = Rotation.from_rotvec(np.radians(0.1) * rng.standard_normal(3)).as_matrix()
        calibrations[imu.name] = ImuCalibration(
            rotation=(imu.rotation @ off).tolist(),
            std_error_deg=0.1,
            time_offset_s=0.004,
            time_offset_std_error_s=0.01,
            lever=(imu.lever + 0.003 * rng.standard_normal(3)).tolist(),
            lever_std_errors=[0.003] * 3,
            noise_density=0.05,
        )

    noise = 0.0 if step else 1e-4
    q = true_motion(t)[0] + noise * rng.standard_normal((SAMPLES, 2))
    recording = made_recording(
        quantise(q, step), rate_hz=1.0 / DT, accelerometers=accelerometers
    )
    mounted = mounted_imus(recording, robot, ImuStage(imus=calibrations))
    imus = tuple(read(x, recording, slice(None)) for x in mounted)
    views = tuple(encoder_view(recording.q[:, j], step) for j in range(2))
    return Chunk(robot=robot, views=views, dt=DT, every=1, imus=imus)


def smoothed(step: float) -> Solution:
    """The smoother's own equations and solver, until nothing changes."""
    chunk = scene(step).gathered()
    assert chunk.cell == 1, CELL_S
    c, _ = encoder_motion(chunk, JERK.size)
    for _ in range(40):
        solution = renewed(chunk, c, JERK, linearised(chunk, c), "place")
        change = float(np.abs(solution.c - c).max())
        chunk = solution.chunk.gathered()
        c = solution.c
        if change < 1e-13:
            break
    assert change < 1e-13
    # The factor is of the state before the last step, which did not move any more.
    return replace(solution, chunk=chunk, c=c)


class Dense:
    """All residuals, over their standard deviations, by coefficients and each IMU's
    constants.
    """

    def __init__(self, solution: Solution, step: float) -> None:
        self.found = solution
        self.chunk = solution.chunk
        self.step = step
        self.knots = DT * (np.arange(SAMPLES + 7) - 3)
        self.t = DT * np.arange(SAMPLES)

    def splines(self, c: Array, t: Array) -> Array:
        spline = BSpline(self.knots, c, 3)
        return np.stack([spline(t, nu=order) for order in range(3)])

    def __call__(self, unknown: Array) -> Array:
        head, *constants = np.split(unknown, [-40, -20])
        c = head.reshape(-1, 2)
        parts = [*self.jerks(c), *self.encoders(c)]
        for x, constants_of_imu in zip(self.chunk.imus, constants, strict=True):
            parts += self.imu(x, c, constants_of_imu)
        return np.concatenate([np.ravel(p) for p in parts])

    def jerks(self, c: Array) -> list[Array]:
        jerk = (
            BSpline(self.knots, c, 3).derivative(3)(self.t + 0.5 * DT) / JERK.relative
        )
        covariance = JERK.correlation * np.outer(JERK.size, JERK.size)
        return [np.linalg.solve(np.linalg.cholesky(covariance), jerk.T)]

    def encoders(self, c: Array) -> list[Array]:
        """Codes: known to a count's width, once while they last; edges: to where they
        lie.
        """
        at_samples = self.splines(c, self.t)
        at_edges = self.splines(c, self.t + 0.5 * DT)
        speed = np.abs(self.splines(self.found.c, self.t)[1]) * DT
        step = self.step
        parts = []
        for j, view in enumerate(self.chunk.views):
            if step == 0.0:
                parts.append((at_samples[0, :, j] - view.q) / np.sqrt(view.white))
                continue

            # A code is known to a count's width, once while it lasts.
            code = np.round(view.q / step)
            fast = speed[:, j] >= step
            first = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1, [SAMPLES]])
            lasts = np.repeat(np.diff(first), np.diff(first))
            variance = step**2 / 12 * np.where(fast, 1, lasts)
            parts.append((at_samples[0, :, j] - view.q) / np.sqrt(variance))

            # An edge is known to where it lies, and to the way within a sample.
            edge = np.append(np.abs(np.diff(code)) == 1, False) & ~fast
            place = 0.5 * (view.q + np.append(view.q[1:], 0.0))
            error = np.sqrt(speed[:, j] ** 2 / 12 + (EDGE_SHARE * step) ** 2)
            parts.append(((at_edges[0, :, j] - place) / error)[edge])
        return parts

    def imu(self, x: Mounted, c: Array, constants_of_imu: Array) -> list[Array]:
        """Readings at their own times, and the prior of the constants."""
        turn, lever, late, gained, bias = np.split(constants_of_imu, [3, 6, 7, 8])
        middle = 0.5 * SAMPLES * DT
        from_middle = self.t - middle
        taken = middle + (from_middle - x.delay) / (1.0 + x.rate)
        used = (taken >= 0) & (taken < SAMPLES * DT)
        moved = (from_middle - x.delay - late[0]) / (1.0 + x.rate + gained[0])
        motion = self.splines(c, middle + moved[used])
        place = replace(x.place, lever=x.place.lever + lever)
        expected = readings(self.chunk.robot, place, motion, turn) + x.bias + bias
        count = len(constants_of_imu)
        root = np.linalg.cholesky(x.precision[:count, :count]).T
        prior = root @ (constants_of_imu + x.away[:count])
        return [(x.raw[used] - expected) / x.noise, prior]


def jacobian(dense: Dense, x: Array) -> Array:
    changes = 1e-6 * np.diag(np.maximum(np.abs(x), 1.0))
    return np.column_stack(
        [(dense(x + h) - dense(x - h)) / (2 * h.sum()) for h in changes]
    )


@pytest.mark.parametrize("step", [0.0, 2 * np.pi / 1000], ids=["fine", "coarse"])
def test_solution_and_stated_errors_are_those_of_the_dense_one(step: float) -> None:
    """One step of Gauss-Newton on the dense problem changes nothing."""
    solution = smoothed(step)
    count = solution.c.size
    dense = Dense(solution, step)
    unknown = np.concatenate([solution.c.ravel(), np.zeros(2 * 20)])
    J = jacobian(dense, unknown)
    scale = np.linalg.norm(J, axis=0)
    Q, R = np.linalg.qr(J / scale)
    half = np.linalg.inv(R) / scale[:, None]
    covariance = half @ half.T
    error = np.sqrt(np.diag(covariance))
    assert (np.abs(half @ Q.T @ dense(unknown)) / error).max() < TOLERANCE
    stated = (solution.inverse(np.eye(count)), np.linalg.inv(solution.schur))
    for mine, part in zip(stated, (slice(count), slice(count, None)), strict=True):
        off = np.abs(mine - covariance[part, part]) / np.outer(error[part], error[part])
        assert off.max() < TOLERANCE


def test_nothing_to_solve_for_is_kept_from_lapack(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If constants move the motion in no direction, `dtbtrs` would corrupt memory."""
    monkeypatch.setattr("scipy.linalg.lapack.dtbtrs", None)
    for transposed in (False, True):
        assert halved(
            np.ones((4, 50)), np.zeros((50, 0)), transposed=transposed
        ).shape == (50, 0)
