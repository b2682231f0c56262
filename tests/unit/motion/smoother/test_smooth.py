"""The smoother on simulated rigs, against their truth and against the bound of its own model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.imu.sensor import Mounting, link_slopes, link_state
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.smoother.chunk import Chunk
from seqid_cli.motion.smoother.encoder import encoder_view
from seqid_cli.motion.smoother.imus import mounted_imus, read
from seqid_cli.motion.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.motion.smoother.solve import probed_covariance, solved
from seqid_cli.motion.smoother.system import linearised, normal_equations
from seqid_cli.motion.smoother.terms import Jerk
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array
from tests.plants.arms.rigs import one_joint, six_joint, two_joint
from tests.plants.motions.experiments import inertia_trials, validation_trials
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.robots.small import random_model
from tests.plants.simulate import Log, Plant, simulate

pytestmark = pytest.mark.slow

SETTLED = slice(200, -200)
RIGS = ("one", "one_400", "two", pytest.param("six", marks=pytest.mark.slow))


@dataclass(frozen=True)
class Scene:
    """A rig, its log at 1 kHz and what the smoother makes of it."""

    plant: Plant
    log: Log
    robot: Robot
    recording: Recording
    stage: ImuStage

    @property
    def true(self) -> Array:
        """q, dq, ddq (N, n, 3)."""
        truth = self.log.truth
        return np.stack([truth.q, truth.dq, truth.ddq], axis=2)

    def error(self, got: Smoothed) -> Array:
        """RMS errors (n, 3) of q, dq, ddq."""
        off = np.stack([got.q, got.dq, got.ddq], axis=2) - self.true
        return rms(off)


def rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values[SETTLED] ** 2, axis=0)))


def stage_of(plant: Plant) -> ImuStage:
    found = {
        imu.name: ImuCalibration(
            rotation=imu.rotation.tolist(), std_error_deg=0.1, noise_density=0.05
        )
        for imu in plant.imus
    }
    return ImuStage(imus=found)


@cache
def scene(name: str) -> Scene:
    """Three seconds of one or two joints at their limits, or of all six."""
    rng = np.random.default_rng(0)
    if name == "six":
        plant = six_joint()
        motion = validation_trials(plant, rng, runs=1, seconds=3.0)[0].reference
    else:
        make = one_joint if name.startswith("one") else two_joint
        plant = make(quadrature_factor=4 if name.endswith("400") else 1)
        posture = np.array([0.0, 0.5])[: plant.arm.n]
        motion = inertia_trials(plant, [posture], rng, seconds=3.0)[0].reference
    log = simulate(plant, motion, 0)
    return Scene(plant, log, robot_of(name, plant), recording_of(plant, name, log), stage_of(plant))


@cache
def smoothed(name: str) -> Smoothed:
    s = scene(name)
    return smoothed_motion(s.recording, s.robot, s.stage)


@cache
def differentiated(name: str) -> Array:
    """Errors (n,) of differentiated encoders, each joint with the cut-off that suits it best."""
    s = scene(name)
    errors = []
    for hz in np.geomspace(2.0, 120.0, 30):
        q = Lowpass(float(hz), s.recording.rate_hz)(s.recording.q)
        errors.append(rms(differentiate(q, s.recording.rate_hz)[1] - s.log.truth.ddq))
    return np.asarray(np.min(errors, axis=0))


def from_imus(name: str) -> Array:
    """Errors (n,) of the IMUs sample by sample, with the best of several cut-offs."""
    s = scene(name)
    errors = []
    for hz in (10.0, 30.0, 90.0, 200.0, 400.0):
        motion = estimate_motion(s.recording, s.robot, MotionOptions(cutoff_hz=hz))
        got = best_motion(s.recording, s.robot, s.stage, motion, source="imu")
        errors.append(rms(got.ddq - s.log.truth.ddq))
    return np.asarray(np.min(errors, axis=0))


@pytest.mark.parametrize(("name", "share"), [("one", 0.05), ("one_400", 0.05), ("two", 0.06)])
def test_coarse_encoders_with_arrays_beat_differentiation_tenfold(name: str, share: float) -> None:
    assert (scene(name).error(smoothed(name))[:, 2] < share * differentiated(name)).all()


@pytest.mark.parametrize("name", RIGS)
def test_both_sources_together_beat_each(name: str) -> None:
    error = scene(name).error(smoothed(name))[:, 2]
    assert (error < 0.75 * differentiated(name)).all()
    assert (error < 0.75 * from_imus(name)).all()


def true_chunk(s: Scene) -> tuple[Chunk, Array, Jerk]:
    """The smoother's own model about the truth, with the true noise, mounting and jerk."""
    views = [encoder_view(s.recording.q[:, j], s.plant.encoder_step[j]) for j in range(s.robot.n)]
    imus = mounted_imus(s.recording, s.robot, s.stage)
    placed = [
        replace(
            read(x, s.recording, slice(None)),
            place=replace(x.place, lever=a.lever, R=a.rotation),
            noise=np.full(len(x.noise), np.hypot(a.noise, a.resolution / np.sqrt(12))),
        )
        for x, a in zip(imus, s.plant.imus, strict=True)
    ]
    dt = 1.0 / s.recording.rate_hz
    chunk = Chunk(s.robot, tuple(views), dt, 1, tuple(placed)).gathered()
    truth = s.log.truth
    c = truth.q - chunk.dt**2 * truth.ddq / 6
    found = np.diff(truth.ddq, axis=0) / chunk.dt
    second = found.T @ found / len(found)
    size = np.sqrt(np.diag(second))
    jerk = Jerk(size, second / np.outer(size, size), np.ones_like(truth.q))
    return chunk, np.vstack([c[:1], c, c[-1:], c[-1:]]), jerk


@pytest.mark.parametrize("name", RIGS)
def test_errors_stay_near_the_cramer_rao_bound(name: str) -> None:
    """The bound knows noise, mounting, and how large and alike the joints' jerks are as a whole.

    Where jerks are larger for a while, as when friction turns over, the smoother comes below it.
    """
    chunk, c, jerk = true_chunk(scene(name))
    normal = normal_equations(chunk, c, jerk, linearised(chunk, c), constants="place")
    solution = replace(solved(chunk, c, jerk, normal), constants="place")
    covariance = probed_covariance(solution, solution)[1]
    bound = np.sqrt(np.mean(covariance[:, :, 2, 2], axis=0))
    error = scene(name).error(smoothed(name))[:, 2]
    assert (error < 1.3 * bound).all()


@pytest.mark.parametrize("name", RIGS)
def test_the_covariance_is_the_one_seen(name: str) -> None:
    s, got = scene(name), smoothed(name)
    off = np.stack([got.q, got.dq, got.ddq], axis=2) - s.true
    deviation = np.sqrt(np.einsum("njdd->njd", got.covariance))
    ratio = rms(off / deviation)
    assert (ratio > 0.5).all()
    assert (ratio < 1.8).all()
    assert (np.linalg.eigvalsh(got.covariance[SETTLED, :, 1:, 1:]) > 0).all()


@pytest.mark.parametrize("name", RIGS)
def test_the_place_of_each_imu_is_found(name: str) -> None:
    s, got = scene(name), smoothed(name)
    assert tuple(got.mounted) == tuple(imu.name for imu in s.plant.imus)
    for imu in s.plant.imus:
        # Turning about z alone does not show how far along z an IMU sits.
        known = slice(0, 3 if name == "six" else 2)
        np.testing.assert_allclose(
            got.mounted[imu.name].place.lever[known], imu.lever[known], atol=2e-3
        )


@pytest.mark.parametrize("name", RIGS)
def test_without_imus_it_is_as_good_as_the_best_differentiation(name: str) -> None:
    s = scene(name)
    got = smoothed_motion(s.recording, s.robot, None)
    assert tuple(got.mounted) == ()
    assert (s.error(got)[:, 2] < 1.1 * differentiated(name)).all()
    deviation = np.sqrt(got.covariance[:, :, 2, 2])
    assert (rms((got.ddq - s.log.truth.ddq) / deviation) < 2.5).all()


def test_a_gap_is_bridged() -> None:
    s = scene("one")
    valid = s.recording.valid.copy()
    valid[1000:1100] = False
    q = s.recording.q.copy()
    q[1000:1100] = 7.0
    got = smoothed_motion(replace(s.recording, valid=valid, q=q), s.robot, s.stage)
    assert s.error(smoothed("one"))[0, 2] < 0.5
    off = np.abs(got.ddq - s.log.truth.ddq)[:, 0]
    assert np.sqrt(np.mean(off[200:950] ** 2)) < 0.3
    assert np.sqrt(np.mean(off[1150:-200] ** 2)) < 0.3
    deviation = np.sqrt(got.covariance[:, 0, 0, 0])
    assert np.isfinite(deviation).all()


def test_chunks_join_without_a_seam() -> None:
    s, whole = scene("one"), smoothed("one")
    got = smoothed_motion(s.recording, s.robot, s.stage, chunk_s=1.2)
    deviation = np.sqrt(whole.covariance[:, :, 2, 2])
    assert rms((got.ddq - whole.ddq) / deviation)[0] < 0.5
    assert np.abs(np.diff(got.q - whole.q, axis=0)).max() < 1e-4
    assert s.error(got)[0, 2] < 1.1 * s.error(whole)[0, 2]


def test_a_slower_log_is_smoothed_on_finer_knots() -> None:
    """Accelerations jump between samples; what a quarter of the readings tell is not lost."""
    s = scene("two")
    slow = replace(
        s.recording,
        t=s.recording.t[::4],
        q=s.recording.q[::4],
        valid=s.recording.valid[::4],
        health=replace(s.recording.health, rate_hz=250.0),
        accelerometers={name: x[::4] for name, x in s.recording.accelerometers.items()},
    )
    got = smoothed_motion(slow, s.robot, s.stage)
    off = (got.ddq - s.log.truth.ddq[::4])[50:-50]
    assert (np.sqrt(np.mean(off**2, axis=0)) < 1.6 * s.error(smoothed("two"))[:, 2]).all()
    deviation = np.sqrt(got.covariance[50:-50, :, 2, 2])
    ratio = np.sqrt(np.mean((off / deviation) ** 2, axis=0))
    assert (ratio > 0.5).all()
    assert (ratio < 1.8).all()


def test_readings_and_their_derivatives() -> None:
    """Readings are those of the package's kinematics; derivatives those of differences."""
    rng = np.random.default_rng(0)
    chain = random_model(rng, [False, True, False, False])[1]
    gravity, lever, link = np.array([0.3, -1.0, -9.7]), rng.normal(size=3), 2
    robot = replace(scene("two").robot, chain=chain, gravity=gravity)
    x, turn = rng.normal(size=(3, 4, 5)), Rotation.random(random_state=1)
    axes = np.vstack([rng.normal(size=(5, 3)), np.eye(3)])
    imu = Mounting(link, rng.normal(size=(5, 3)), axes, turn.as_matrix(), lever)

    def value(x: Array, lever: Array, turn: Rotation) -> Array:
        place = replace(imu, lever=lever, R=turn.as_matrix())
        return np.asarray(link_state(robot, link, x) @ place.matrix.T)

    motion = link_motion(chain, gravity, *x)
    R = turn.as_matrix()
    points = lever + imu.positions @ R.T
    force = motion.a[link][:, None] + np.einsum("abn,kb->akn", motion.H[link], points)
    expected = np.einsum("ka,akn->nk", axes[:5] @ R.T, force)
    got = value(x, lever, turn)
    np.testing.assert_allclose(got[:, :5], expected, atol=1e-10)
    np.testing.assert_allclose(got[:, 5:], motion.w[link].T @ R, atol=1e-10)

    state = link_state(robot, link, x)
    by_motion = imu.by_motion(state, link_slopes(robot, link, x))
    seen, by_lever, by_turn = imu.by_place(state)
    np.testing.assert_allclose(np.einsum("nka,ka->nk", seen @ R, axes), got, atol=1e-10)
    step = 1e-6
    for d in range(3):
        for j in range(3):
            change = np.zeros_like(x)
            change[d, j] = step
            slope = (value(x + change, lever, turn) - value(x - change, lever, turn)) / 2 / step
            np.testing.assert_allclose(by_motion[:, :, d, j], slope, atol=1e-6)
    for k, change in enumerate(step * np.eye(3)):
        slope = (value(x, lever + change, turn) - value(x, lever - change, turn)) / 2 / step
        np.testing.assert_allclose(by_lever[:, :, k], slope, atol=1e-6)
        ahead, back = (Rotation.from_rotvec(sign * change) * turn for sign in (1, -1))
        slope = (value(x, lever, ahead) - value(x, lever, back)) / 2 / step
        np.testing.assert_allclose(by_turn[:, :, k], slope, atol=1e-6)
