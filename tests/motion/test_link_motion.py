"""Accelerations from IMUs and encoders on a simulated arm, where the truth is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.errors import UsageError
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.link_motion import axes_in_link, best_motion
from seqid_cli.motion.motion import Motion, decimated, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.kinematics import link_angular_motion
from seqid_cli.robot.types import Robot
from tests.plants.experiments import inertia_trials
from tests.plants.rigs import two_joint
from tests.plants.simulate import simulate
from tests.robot.robots import random_model
from tests.study.lab import recording_of, robot_of

Array = NDArray[np.float64]

DENSITY = 0.05  # rad/s^2/sqrt(Hz), of accelerometers with 0.03 m/s^2 of noise 0.05 m apart


@dataclass(frozen=True)
class Scene:
    """A log of two joints moving together, calibrations, and the true accelerations."""

    recording: Recording
    robot: Robot
    stage: ImuStage
    motion: Motion
    true: Array

    def error(self, motion: Motion) -> Array:
        """RMS error (n,) of the accelerations, rad/s^2."""
        off = (motion.ddq - self.true)[motion.usable]
        return np.asarray(np.sqrt(np.mean(off**2, axis=0)))

    def best(self, changed: Mapping[str, Array] | None = None, *, source: str = "auto") -> Motion:
        """Run with some IMUs' readings replaced."""
        readings: Mapping[str, Array] = self.recording.accelerometers | dict(changed or {})
        recording = replace(self.recording, accelerometers=dict(readings))
        return best_motion(recording, self.robot, self.stage, self.motion, source=source)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The planar rig with its coarse encoders, three seconds at 250 Hz."""
    plant = two_joint()
    posture = np.array([0.0, 0.5])
    trial = inertia_trials(plant, [posture], np.random.default_rng(0), seconds=3.0)[0]
    log = simulate(plant, trial.reference, 0, every=4)
    stage = ImuStage(
        imus={
            imu.name: ImuCalibration(
                rotation=imu.rotation.tolist(), std_error_deg=0.1, noise_density=DENSITY
            )
            for imu in plant.imus
        }
    )
    robot, recording = robot_of("two_joint", plant), recording_of(plant, "log", log)
    motion = estimate_motion(recording, robot, MotionOptions())
    return Scene(recording, robot, stage, motion, motion.lowpass(log.truth.ddq))


def test_encoder_and_imus_together_beat_each_alone(scene: Scene) -> None:
    """The arrays' biases, worth a radian per second squared, do not get through."""
    both = scene.error(scene.best())
    encoder = scene.error(scene.best(source="encoder"))
    imu = scene.error(scene.best(source="imu"))
    assert (both < 0.4 * encoder).all()
    assert (both < 1.02 * imu).all()


def test_the_source_is_named(scene: Scene) -> None:
    assert scene.best().source == "encoder+imu_a+imu_b"
    assert scene.best(source="imu").source == "imu_a+imu_b"
    assert scene.best(source="encoder").source == "encoder"


def test_only_the_accelerations_change(scene: Scene) -> None:
    best = scene.best()
    np.testing.assert_array_equal(best.q, scene.motion.q)
    np.testing.assert_array_equal(best.dq, scene.motion.dq)
    assert best.ddq.shape == scene.motion.ddq.shape


def test_a_log_without_accelerometers_keeps_the_encoder(scene: Scene) -> None:
    bare = replace(scene.recording, accelerometers={})
    got = best_motion(bare, scene.robot, scene.stage, scene.motion, source="auto")
    assert got is scene.motion


@pytest.mark.parametrize("stage", [None, ImuStage(imus={})])
def test_without_calibration_the_encoder_stays(scene: Scene, stage: ImuStage | None) -> None:
    got = best_motion(scene.recording, scene.robot, stage, scene.motion, source="auto")
    assert got is scene.motion
    with pytest.raises(UsageError, match="no calibrated, healthy IMU"):
        best_motion(scene.recording, scene.robot, stage, scene.motion, source="imu")


@pytest.mark.parametrize("name", ["imu_a", "imu_b"])
def test_an_imu_with_its_sign_flipped_is_ignored(scene: Scene, name: str) -> None:
    flipped = {name: -scene.recording.accelerometers[name]}
    other = {"imu_a": "imu_b", "imu_b": "imu_a"}[name]
    got = scene.best(flipped)
    assert got.source == f"encoder+{other}"
    assert (scene.error(got) < 1.02 * scene.error(scene.motion)).all()


def test_dead_imus_are_ignored(scene: Scene) -> None:
    dead = {k: np.zeros_like(v) for k, v in scene.recording.accelerometers.items()}
    assert scene.best(dead) is scene.motion


def test_both_flipped_leave_the_encoder(scene: Scene) -> None:
    flipped = {name: -values for name, values in scene.recording.accelerometers.items()}
    assert scene.best(flipped) is scene.motion
    with pytest.raises(UsageError, match="healthy"):
        scene.best(flipped, source="imu")


def test_an_imu_mounted_otherwise_than_calibrated_is_ignored(scene: Scene) -> None:
    turned = {
        name: ImuCalibration(rotation=np.diag([1.0, -1.0, -1.0]).tolist(), std_error_deg=0.1)
        for name in scene.stage.imus
    }
    stage = ImuStage(imus=turned)
    got = best_motion(scene.recording, scene.robot, stage, scene.motion, source="auto")
    assert got is scene.motion


def test_constant_biases_of_the_accelerometers_do_not_matter(scene: Scene) -> None:
    bias = np.random.default_rng(1).normal(0, 0.1, 12)
    shifted = {name: values + bias for name, values in scene.recording.accelerometers.items()}
    np.testing.assert_allclose(scene.best(shifted).ddq, scene.best().ddq, atol=0.03)


def test_a_decimated_motion_gets_the_same_accelerations(scene: Scene) -> None:
    short = decimated(scene.motion)
    factor = round(scene.motion.rate_hz / short.rate_hz)
    assert factor > 1
    got = best_motion(scene.recording, scene.robot, scene.stage, short, source="auto")
    np.testing.assert_allclose(got.ddq, scene.best().ddq[::factor], atol=0.05)


def test_an_unknown_source_is_refused(scene: Scene) -> None:
    with pytest.raises(UsageError, match="'gps' is not one of auto, encoder, imu"):
        scene.best(source="gps")


def test_axes_in_the_link_map_rates_to_its_turning() -> None:
    """w of a link is the sum of its joints' axes times their rates, prismatic joints aside."""
    rng = np.random.default_rng(2)
    chain = random_model(rng, [False, True, False, False])[1]
    q, dq, zero = rng.normal(size=(20, 4)), rng.normal(size=(20, 4)), np.zeros((20, 4))
    robot = Robot("test", (), chain, np.zeros(3), "", __file__)  # type: ignore[arg-type]
    for link in range(4):
        axes = axes_in_link(robot, q, link)
        w = np.einsum("nj,njk->nk", dq[:, : link + 1], axes)
        expected = link_angular_motion(chain, q, dq, zero, link).w
        np.testing.assert_allclose(w, expected, atol=1e-12)
