from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.noise.encoder import Noiseless
from seqid_cli.discover.noise.floor import rms
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import sliding
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from tests.plants.experiments import span_of
from tests.plants.friction import SurfaceFriction
from tests.plants.rigs import plain, two_joint
from tests.plants.robots.sample import sample_robot
from tests.plants.simulate import simulate
from tests.plants.trajectories import fourier
from tests.unit.discover.drawn_logs import recording

pytestmark = pytest.mark.slow

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
        robot = sample_robot("two_joint")
        return scenes_of(self.logs, robot, self.stages, options=InertiaOptions())

    @cached_property
    def residual(self) -> list[Array]:
        left = []
        for scene in self.scenes:
            assert scene.motion.tau is not None
            left.append(scene.motion.tau - scene.modelled_filtered)
        return left


@pytest.fixture(scope="module")
def fit() -> Fit:
    logs = simulated()
    robot = sample_robot("two_joint")
    friction, inertia = identify_simultaneous(logs, robot, options=MotionOptions())
    return Fit(logs, Stages(friction=friction, inertia=inertia))


def low_passed(log: Recording, scene: Scene, values: Array) -> Array:
    lowpass = Lowpass(scene.motion.lowpass.cutoff_hz, log.rate_hz)
    return lowpass(lowpass(values))[:: round(log.rate_hz / scene.motion.rate_hz)]


def no_event(scene: Scene) -> NDArray[np.bool_]:
    return np.zeros(scene.samples, dtype=bool)


def test_what_the_refitted_base_adds_is_in_the_torque(fit: Fit) -> None:
    log, scene = fit.logs[0], fit.scenes[0]
    nothing = np.zeros_like(scene.motion.q)
    smooth = 0.1 * scene.motion.filtered(np.cos(scene.motion.q), times=2)
    without = Noiseless(log, scene, nothing, no_event(scene))
    extra = Noiseless(log, scene, smooth, no_event(scene)).torque - without.torque
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
    clean = Noiseless(log, still, np.zeros_like(scene.motion.q), no_event(scene))
    middle = (scene.samples * 5 // 12) * round(log.rate_hz / scene.motion.rate_hz)
    np.testing.assert_allclose(clean.torque[middle, 0], log.tau[middle, 0], rtol=1e-12)
    assert clean.torque[middle, 1] != log.tau[middle, 1]
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
    clean = Noiseless(hit, still, np.zeros_like(scene.motion.q), event).torque
    assert np.max(np.abs(clean - log.tau)[310 * factor : 330 * factor]) < 25.0
    np.testing.assert_allclose(clean[: 250 * factor], log.tau[: 250 * factor], atol=1e-12)


def test_noise_free_clean_torque_is_the_model_where_joints_slide(fit: Fit) -> None:
    log, scene = fit.logs[0], fit.scenes[0]
    nothing = np.zeros_like(scene.motion.q)
    clean = Noiseless(log, scene, nothing, no_event(scene))
    off = low_passed(log, scene, clean.torque) - scene.modelled_filtered
    slides = sliding(scene.motion, 20.0 * scene.sign_width)
    for j in range(JOINTS):
        assert rms(off[slides[:, j], j]) < rms(fit.residual[0][slides[:, j], j])
