"""The smoother against a dense nonlinear least-squares solution of the same problem by scipy.

The problem is written down here once more, from what docs/fused_motion.md says: splines by scipy's
B-splines, two links in a plane by hand, every reading at its own time, all unknowns in one vector.
The size of the jerk and the noise are given, and an encoder's weights are those at the solution.
Knots lie further apart than the smoother's cells, so that it shares no Jacobians either.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from seqid_cli.motion.smoother import solve as smoother_solve
from seqid_cli.motion.smoother.chunk import CELL_S, Chunk, Jerk, Mounted, encoder_view
from seqid_cli.motion.smoother.imus import mounted_imus, read
from seqid_cli.motion.smoother.solve import Solution, encoder_motion, halved, renewed
from seqid_cli.motion.smoother.system import linearised
from seqid_cli.params.schema import ImuCalibration, ImuStage
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
STEPS = {"fine": 0.0, "coarse": 2 * np.pi / 1000}
JERK = Jerk(
    size=np.array([60.0, 90.0]),
    correlation=np.array([[1.0, -0.4], [-0.4, 1.0]]),
    relative=1.0 + 0.5 * np.sin(np.arange(2 * SAMPLES).reshape(SAMPLES, 2) / 7.0),
)
TOLERANCE = 1e-6  # of the stated error
POLISH = 5


def true_motion(t: Array) -> Array:
    """q, dq, ddq (3, N, 2) of a smooth motion."""
    w, a = np.array([3.1, 4.3]), np.array([0.9, 0.7])
    angle = np.outer(t, w) + np.array([0.3, -1.1])
    return np.stack([a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)])


def link_felt(link: int, motion: Array, length: float) -> tuple[Array, Array, Array]:
    """Acceleration minus gravity of a link's origin, dw and w, (N, 3), along the link's axes."""
    q, dq, ddq = motion
    turned = np.cumsum(q, axis=1)[:, link]
    w, dw = np.zeros((2, len(q), 3))
    w[:, 2], dw[:, 2] = np.cumsum(dq, axis=1)[:, link], np.cumsum(ddq, axis=1)[:, link]
    a = np.tile(-GRAVITY, (len(q), 1))
    if link == 1:
        c, s = np.cos(q[:, 0]), np.sin(q[:, 0])
        a[:, 0] += length * (-s * ddq[:, 0] - c * dq[:, 0] ** 2)
        a[:, 1] += length * (c * ddq[:, 0] - s * dq[:, 0] ** 2)
    c, s = np.cos(turned), np.sin(turned)
    along = np.column_stack([c * a[:, 0] + s * a[:, 1], -s * a[:, 0] + c * a[:, 1], a[:, 2]])
    return along, dw, w


@dataclass(frozen=True)
class Sensors:
    """An IMU as the robot file and a calibration have it."""

    link: int
    positions: Array
    axes: Array
    R: Array

    def read(self, motion: Array, length: float, lever: Array, turn: Array) -> Array:
        """Readings (N, K) without bias."""
        a, dw, w = link_felt(self.link, motion, length)
        R = self.R @ Rotation.from_rotvec(turn).as_matrix()
        points = lever + self.positions @ R.T
        force = a[:, None] + np.cross(dw[:, None], points)
        force = force + np.cross(w[:, None], np.cross(w[:, None], points))
        return np.asarray(np.einsum("nkc,kc->nk", force, self.axes @ R.T))


@dataclass(frozen=True)
class Scene:
    """A chunk of the smoother, and what the dense problem needs beside it."""

    chunk: Chunk
    length: float
    step: float

    def sensors(self, x: Mounted) -> Sensors:
        return Sensors(x.place.link, x.place.positions, x.place.axes, x.place.R)


@cache
def scene(encoder: str) -> Scene:
    """1.2 s of two joints with two accelerometer arrays, calibrated a little wrong."""
    rng = np.random.default_rng(5)
    plant = two_joint()
    plant = replace(plant, arm=replace(plant.arm, gravity=GRAVITY))
    robot, length = robot_of("two", plant), float(plant.arm.dh[1, 1])
    t = DT * np.arange(SAMPLES)
    accelerometers, calibrations = {}, {}
    for imu in plant.imus:
        own = Sensors(imu.after, imu.positions, imu.axes, imu.rotation)
        motion = true_motion(t - LATE[imu.name])
        clean = own.read(motion, length, imu.lever, np.zeros(3))
        bias = 0.1 * rng.standard_normal(12)
        accelerometers[imu.name] = clean + bias + NOISE * rng.standard_normal(clean.shape)
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
    step = STEPS[encoder]
    q = true_motion(t)[0] + (0.0 if step else 1e-4) * rng.standard_normal((SAMPLES, 2))
    recording = made_recording(quantise(q, step), rate_hz=1.0 / DT, accelerometers=accelerometers)
    known = mounted_imus(recording, robot, ImuStage(imus=calibrations))
    imus = tuple(read(x, recording, slice(None)) for x in known)
    views = tuple(encoder_view(recording.q[:, j], step) for j in range(2))
    return Scene(Chunk(robot, views, DT, 1, imus), length, step)


@cache
def smoothed(encoder: str) -> Solution:
    """The smoother's own equations and solver, until nothing changes."""
    chunk = scene(encoder).chunk.gathered()
    assert chunk.cell == 1, CELL_S
    c, _ = encoder_motion(chunk, JERK.size)
    for _ in range(40):
        solution = renewed(chunk, c, JERK, linearised(chunk, c), "place")
        step = float(np.abs(solution.c - c).max())
        chunk, c = solution.chunk.gathered(), solution.c
        if step < 1e-13:
            break
    assert step < 1e-13
    # The factor is of the state before the last step, which did not move any more.
    return replace(solution, chunk=chunk, c=c)


class Dense:
    """Residuals of everything, over their standard deviations, in one vector of unknowns.

    Unknowns: coefficients, then of each IMU its biases, place, turn and clock. `speed` (N, n) and
    at the edges sets the encoders' weights; `used` says which readings lie on the splines.
    """

    def __init__(self, scene: Scene, found: Solution) -> None:
        self.scene, self.found = scene, found
        self.count = SAMPLES + 3
        self.knots = DT * (np.arange(self.count + 4) - 3)
        self.t = DT * np.arange(SAMPLES)
        self.used = {x.name: self._used(x) for x in found.chunk.imus}

    def _used(self, x: Mounted) -> NDArray[np.bool_]:
        taken = self.t - x.delay
        return (taken >= 0) & (taken < SAMPLES * DT)

    def splines(self, c: Array, t: Array) -> Array:
        """q, dq, ddq (3, len(t), 2)."""
        spline = BSpline(self.knots, c, 3)
        return np.stack([spline(t, nu=order) for order in range(3)])

    def start(self) -> Array:
        """Coefficients that follow the encoders; the constants of the calibration."""
        q = np.column_stack([view.q for view in self.scene.chunk.views])
        rows = BSpline.design_matrix(self.t, self.knots, 3).toarray()
        c = np.linalg.lstsq(rows, q, rcond=None)[0]
        constants = [np.zeros(x.place.channels + 7) for x in self.scene.chunk.imus]
        return np.concatenate([c.ravel(), *constants])

    def __call__(self, unknown: Array) -> Array:
        c = unknown[: 2 * self.count].reshape(-1, 2)
        parts = [*self.jerks(c), *self.encoders(c)]
        start = c.size
        for x in self.scene.chunk.imus:
            own = unknown[start : start + x.place.channels + 7]
            start += len(own)
            parts += self.imu(x, c, own)
        return np.concatenate([np.ravel(p) for p in parts])

    def jerks(self, c: Array) -> list[Array]:
        """White jerk, correlated between the joints."""
        jerk = BSpline(self.knots, c, 3).derivative(3)(self.t + 0.5 * DT) / JERK.relative
        covariance = JERK.correlation * np.outer(JERK.size, JERK.size)
        return [np.linalg.solve(np.linalg.cholesky(covariance), jerk.T)]

    def encoders(self, c: Array) -> list[Array]:
        """Codes: known to a count's width, once while they last; edges: to where they lie."""
        at_samples, at_edges = self.splines(c, self.t), self.splines(c, self.t + 0.5 * DT)
        speed = np.abs(self.splines(self.found.c, self.t)[1]) * DT
        step, parts = self.scene.step, []
        for j, view in enumerate(self.scene.chunk.views):
            if step == 0.0:
                parts.append((at_samples[0, :, j] - view.q) / np.sqrt(view.white))
                continue
            code = np.round(view.q / step)
            first = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1, [SAMPLES]])
            lasts = np.repeat(np.diff(first), np.diff(first))
            fast = speed[:, j] >= step
            variance = step**2 / 12 * np.where(fast, 1, lasts)
            parts.append((at_samples[0, :, j] - view.q) / np.sqrt(variance))
            edge = np.append(np.abs(np.diff(code)) == 1, False) & ~fast
            place = 0.5 * (view.q + np.append(view.q[1:], 0.0))
            error = np.sqrt(speed[:, j] ** 2 / 12 + (EDGE_SHARE * step) ** 2)
            parts.append(((at_edges[0, :, j] - place) / error)[edge])
        return parts

    def imu(self, x: Mounted, c: Array, own: Array) -> list[Array]:
        """Readings at their own times, and the prior of the constants."""
        bias, lever, turn, late = np.split(own, [12, 15, 18])
        used = self.used[x.name]
        motion = self.splines(c, self.t[used] - x.delay - late[0])
        sensors = self.scene.sensors(x)
        told = sensors.read(motion, self.scene.length, x.place.lever + lever, turn) + x.bias + bias
        prior = np.sqrt(np.diag(x.precision)[: len(own)]) * (own + x.away[: len(own)])
        return [(x.raw[used] - told) / x.noise, prior]


def solved_dense(dense: Dense) -> Array:
    """All unknowns by scipy, then Gauss-Newton until its steps are rounding."""
    x = np.asarray(least_squares(dense, dense.start(), x_scale="jac").x)
    for _ in range(POLISH):
        x = x - np.linalg.lstsq(jacobian(dense, x), dense(x), rcond=None)[0]
    return x


def jacobian(dense: Dense, x: Array) -> Array:
    """Central differences (M, N) of the residuals."""
    size = 1e-6 * np.maximum(np.abs(x), 1.0)
    columns = [
        (dense(x + h * e) - dense(x - h * e)) / (2 * h)
        for h, e in zip(size, np.eye(len(x)), strict=True)
    ]
    return np.column_stack(columns)


def constants_of(x: Mounted, before: Mounted) -> Array:
    """By how much the smoother has moved an IMU's constants: bias, place, turn, clock."""
    turn = Rotation.from_matrix(before.place.R.T @ x.place.R).as_rotvec()
    return np.concatenate(
        [x.bias - before.bias, x.place.lever - before.place.lever, turn, [x.delay - before.delay]]
    )


def covariance_at(dense: Dense, found: Solution) -> Array:
    """Inverse information of all unknowns about the smoother's own solution."""
    about = Dense(replace(dense.scene, chunk=found.chunk), found)
    unknown = np.concatenate([found.c.ravel(), np.zeros(2 * 19)])
    J = jacobian(about, unknown)
    scale = np.linalg.norm(J, axis=0)
    _, R = np.linalg.qr(J / scale)
    half = np.linalg.inv(R) / scale[:, None]
    return np.asarray(half @ half.T)


@pytest.mark.parametrize("encoder", list(STEPS))
def test_motion_and_constants_are_those_of_the_dense_solution(encoder: str) -> None:
    own = scene(encoder)
    found = smoothed(encoder)
    dense = Dense(own, found)
    x = solved_dense(dense)
    error = np.sqrt(np.diag(covariance_at(dense, found)))
    pairs = zip(found.chunk.imus, own.chunk.imus, strict=True)
    smoother = np.concatenate([found.c.ravel(), *(constants_of(a, b) for a, b in pairs)])
    off = np.abs(smoother - x) / error
    assert off.max() < TOLERANCE


@pytest.mark.parametrize("encoder", list(STEPS))
def test_stated_errors_are_those_of_the_dense_solution(encoder: str) -> None:
    own = scene(encoder)
    found = smoothed(encoder)
    covariance = covariance_at(Dense(own, found), found)
    count = found.c.size
    unit = np.eye(count)
    mine = found.inverse(unit)
    scale = np.sqrt(np.diag(covariance))
    off = np.abs(mine - covariance[:count, :count]) / np.outer(scale, scale)[:count, :count]
    constants = np.linalg.inv(found.schur)
    theirs = covariance[count:, count:]
    off_c = np.abs(constants - theirs) / np.outer(scale[count:], scale[count:])
    assert off.max() < TOLERANCE
    assert off_c.max() < TOLERANCE


def test_nothing_to_solve_for_is_kept_from_lapack(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where constants move the motion in no direction, `dtbtrs` would corrupt memory."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("LAPACK was asked for no columns")

    monkeypatch.setattr(smoother_solve, "dtbtrs", refuse)
    for transposed in (False, True):
        assert halved(np.ones((4, 50)), np.zeros((50, 0)), transposed=transposed).shape == (50, 0)
