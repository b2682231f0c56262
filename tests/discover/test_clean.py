from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.clean import CleanLog, clean_recordings
from seqid_cli.discover.floor import rms
from seqid_cli.discover.rows import Rows, rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.system import Block, System
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.stribeck import Stribeck
from seqid_cli.model.friction import SLIDES
from seqid_cli.model.torque import sliding
from seqid_cli.motion.cutoff import encoder_step
from seqid_cli.motion.filtering import Lowpass, differentiate
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.file import load_robot
from tests.discover.drawn_logs import recording
from tests.identify.rigs import SAMPLE_LOGS
from tests.plants.experiments import span_of
from tests.plants.friction import SurfaceFriction
from tests.plants.rigs import plain, two_joint
from tests.plants.simulate import simulate
from tests.plants.trajectories import fourier

Array = NDArray[np.float64]

SECONDS, LOGS, EVERY, JOINTS = 30.0, 2, 2, 2


def simulated() -> list[Recording]:
    """Two logs of the two-joint rig with Coulomb and viscous friction, 500 Hz."""
    plant = two_joint()
    assert isinstance(plant.friction, SurfaceFriction)
    plant = replace(plant, friction=plain(plant.friction))
    low, high = np.array([span_of(plant, j) for j in range(JOINTS)]).T
    rng = np.random.default_rng(5)
    logs = []
    for seed in range(LOGS):
        reference = fourier(
            rng,
            low,
            high,
            0.9 * plant.velocity_limits,
            0.9 * plant.acceleration_limits,
            seconds=SECONDS,
            harmonics=24,
            rate_hz=1000.0,
        )
        log = simulate(plant, reference, seed, every=EVERY, imus=False)
        torque = log.current * plant.torque_per_ampere
        logs.append(recording(log.q, torque, 1000.0 / EVERY, name=f"log_{seed}"))
    return logs


@dataclass(frozen=True)
class Fit:
    """Logs, and the base refitted to them."""

    logs: list[Recording]
    stages: Stages

    @cached_property
    def scenes(self) -> list[Scene]:
        robot = load_robot(SAMPLE_LOGS / "two_joint" / "robot.toml")
        return scenes_of(self.logs, robot, self.stages, options=InertiaOptions())

    @cached_property
    def rows(self) -> Rows:
        return rows_of(self.scenes)

    @cached_property
    def system(self) -> System:
        base = base_of(self.rows, self.stages)
        blocks = [Block(dict(enumerate(base.rigid)), np.zeros((0, base.basis.size)))]
        for j in range(JOINTS):
            columns = np.column_stack([base.friction[j], base.timing[j]])
            blocks.append(Block({j: columns}, np.zeros((0, columns.shape[1]))))
        return System(self.rows, base.y, [np.full(len(y), 3e-3) for y in base.y], blocks)

    @property
    def rms(self) -> Array:
        return np.array([rms(r) for r in self.system.residual()])

    @cached_property
    def deviation(self) -> list[Array]:
        base, theta = base_of(self.rows, self.stages), self.system.theta
        rigid, *own = (theta[where] for where in self.system.where)
        added = base.deviation(rigid, [c[:-1] for c in own])
        late = np.array([c[-1] for c in own])
        return [
            d + late * differentiate(s.modelled_filtered, s.motion.rate_hz)[0]
            for d, s in zip(added, self.scenes, strict=True)
        ]

    @cached_property
    def residual(self) -> list[Array]:
        left = []
        for scene, deviation in zip(self.scenes, self.deviation, strict=True):
            assert scene.motion.tau is not None
            r = scene.motion.tau - scene.modelled_filtered - deviation
            left.append(np.where(sliding(scene.motion, SLIDES * scene.sign_width), r, 0.0))
        return left

    def stribeck(self, joint: int) -> float:
        """Largest gain of a Stribeck hump."""
        effect = Stribeck()
        grid = effect.grid(self.scenes, joint, self.residual)
        columns = [[effect.columns(s, joint, x) for s in self.scenes] for x in grid]
        tried = self.system.tried([self.rows.columns(c, 2) for c in columns])
        return max(trial.relative for trial in tried)


@pytest.fixture(scope="module")
def fit() -> Fit:
    logs = simulated()
    robot = load_robot(SAMPLE_LOGS / "two_joint" / "robot.toml")
    friction, inertia = identify_simultaneous(logs, robot, options=MotionOptions())
    return Fit(logs, Stages(friction=friction, inertia=inertia))


def drawn(fit: Fit, seed: int) -> Fit:
    rng = np.random.default_rng(seed)
    again = clean_recordings(fit.logs, fit.scenes, fit.residual, fit.deviation, rng)
    return Fit(again, fit.stages)


def low_passed(log: Recording, scene: Scene, values: Array) -> Array:
    lowpass = Lowpass(scene.motion.lowpass.cutoff_hz, log.rate_hz)
    return lowpass(lowpass(values))[:: round(log.rate_hz / scene.motion.rate_hz)]


def test_clean_logs_leave_a_residual_of_the_measured_size(fit: Fit) -> None:
    ratio = np.array([drawn(fit, seed).rms / fit.rms for seed in range(4)])
    assert np.all(np.abs(np.log(ratio.mean(axis=0))) < np.log(1.25))
    assert np.ptp(ratio) > 0.005


def test_clean_logs_show_no_hump_that_measured_ones_do_not(fit: Fit) -> None:
    for j in range(JOINTS):
        clean = max(drawn(fit, seed).stribeck(j) for seed in range(2))
        assert -0.05 < clean < 0.1
        assert fit.stribeck(j) < clean + 0.05


def test_cutoff_and_encoder_step_come_out_again(fit: Fit) -> None:
    again = drawn(fit, 1)
    before = [s.motion.cutoff.hz for s in fit.scenes]
    np.testing.assert_allclose([s.motion.cutoff.hz for s in again.scenes], before, rtol=0.15)
    for old, new in zip(fit.logs, again.logs, strict=True):
        np.testing.assert_allclose(encoder_step(new.q), encoder_step(old.q), rtol=1e-6)
        assert np.max(np.abs(new.q - old.q)) < 3 * np.max(encoder_step(old.q))


def test_the_seed_decides(fit: Fit) -> None:
    one, same, other = (drawn(fit, seed).logs[0] for seed in (1, 1, 2))
    assert one.tau is not None
    assert same.tau is not None
    assert other.tau is not None
    np.testing.assert_array_equal(one.tau, same.tau)
    np.testing.assert_array_equal(one.q, same.q)
    assert np.std(one.tau - other.tau) > 0.5 * np.std(one.tau[1:] - one.tau[:-1])
    assert not np.array_equal(one.q, other.q)


def no_event(scene: Scene) -> NDArray[np.bool_]:
    return np.zeros(scene.samples, dtype=bool)


def test_torque_noise_above_the_band_has_the_measured_size(fit: Fit) -> None:
    again = drawn(fit, 3)
    for old, new in zip(fit.logs, again.logs, strict=True):
        assert old.tau is not None
        assert new.tau is not None
        sizes = [np.median(np.abs(np.diff(tau, 4, axis=0)), axis=0) for tau in (old.tau, new.tau)]
        np.testing.assert_allclose(sizes[1], sizes[0], rtol=0.15)


def test_what_the_refitted_base_adds_is_in_the_torque(fit: Fit) -> None:
    log, scene, nothing = fit.logs[0], fit.scenes[0], np.zeros_like(fit.residual[0])
    smooth = 0.1 * scene.motion.filtered(np.cos(scene.motion.q), times=2)
    without = CleanLog(log, scene, nothing, nothing, no_event(scene))
    extra = CleanLog(log, scene, nothing, smooth, no_event(scene)).torque - without.torque
    found = low_passed(log, scene, extra) - smooth
    slides = sliding(scene.motion, 10.0 * scene.sign_width)
    # It is not added where torque is the measured one, which reaches a little further.
    assert rms(found[slides]) < 0.15 * np.std(smooth)


def test_where_nothing_slides_torque_is_the_measured_one(fit: Fit) -> None:
    log, scene = fit.logs[0], fit.scenes[0]
    assert log.tau is not None
    still = replace(scene, motion=replace(scene.motion, moving=scene.motion.moving.copy()))
    pause = slice(scene.samples // 3, scene.samples // 2)
    still.motion.moving[pause, 0] = False
    clean = CleanLog(log, still, fit.residual[0], fit.deviation[0], no_event(scene))
    middle = (scene.samples * 5 // 12) * round(log.rate_hz / scene.motion.rate_hz)
    again = clean.draw(np.random.default_rng(0))
    assert again.tau is not None
    np.testing.assert_allclose(again.tau[middle, 0], log.tau[middle, 0], rtol=1e-12)
    assert again.tau[middle, 1] != log.tau[middle, 1]
    assert np.all(clean.resting[[middle], 0] == 1.0)
    # No step where measured and modelled torque meet.
    assert np.max(np.abs(np.diff(clean.resting, axis=0))) < 0.1


def test_a_push_is_not_clean_even_at_rest(fit: Fit) -> None:
    log, scene = fit.logs[0], fit.scenes[0]
    assert log.tau is not None
    still = replace(scene, motion=replace(scene.motion, moving=np.zeros_like(scene.motion.moving)))
    factor = round(log.rate_hz / scene.motion.rate_hz)
    pushed, event = log.tau.copy(), no_event(scene)
    event[300:340] = True
    pushed[300 * factor : 340 * factor] += 50.0
    hit = replace(log, tau=pushed)
    clean = CleanLog(hit, still, fit.residual[0], fit.deviation[0], event).torque
    assert np.max(np.abs(clean - log.tau)[310 * factor : 330 * factor]) < 25.0
    np.testing.assert_allclose(clean[: 250 * factor], log.tau[: 250 * factor], atol=1e-12)


def test_noise_free_clean_torque_is_the_model_where_joints_slide(fit: Fit) -> None:
    log, scene, nothing = fit.logs[0], fit.scenes[0], np.zeros_like(fit.residual[0])
    clean = CleanLog(log, scene, nothing, nothing, no_event(scene))
    off = low_passed(log, scene, clean.torque) - scene.modelled_filtered
    slides = sliding(scene.motion, 20.0 * scene.sign_width)
    for j in range(JOINTS):
        assert rms(off[slides[:, j], j]) < fit.rms[j]
