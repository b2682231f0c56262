"""Accelerations from IMUs and encoders on a simulated arm, where the truth is known."""

from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import Motion, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array
from tests.plants.arms.rigs import two_joint
from tests.plants.fused import stage_of
from tests.plants.motions.experiments import inertia_trials
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.simulate import simulate


@dataclass(frozen=True)
class Scene:
    """A log of two joints moving together, calibrations, and the true accelerations."""

    recording: Recording
    robot: Robot
    stage: ImuStage
    motion: Motion
    true: Array

    def best(
        self, source: str, readings: dict[str, Array] | None = None, stage: ImuStage | None = None
    ) -> Motion:
        """Run with the IMUs' readings or calibrations replaced."""
        given = readings or self.recording.accelerometers
        recording = replace(self.recording, accelerometers=given)
        return best_motion(recording, self.robot, stage or self.stage, self.motion, source=source)

    def error(self, motion: Motion) -> Array:
        """RMS error (n,) of the accelerations, rad/s^2."""
        off = (motion.ddq - self.true)[motion.usable]
        return np.asarray(np.sqrt(np.mean(off**2, axis=0)))


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The planar rig with its coarse encoders, three seconds at 250 Hz."""
    plant, rng = two_joint(), np.random.default_rng
    trial = inertia_trials(plant, [np.array([0.0, 0.5])], rng(0), seconds=3.0)[0]
    log = simulate(plant, trial.reference, 0, every=4)
    robot, recording = robot_of("two_joint", plant), recording_of(plant, "log", log)
    motion = estimate_motion(recording, robot, MotionOptions())
    stage = stage_of(plant, rng(0), off_deg=0.0)
    return Scene(recording, robot, stage, motion, motion.lowpass(log.truth.ddq))


@pytest.mark.parametrize("source", ["encoder", "imu", "fused", "auto"])
def test_the_source_and_its_imus_are_named_and_their_error_is_said(
    scene: Scene, source: str
) -> None:
    """The arrays' biases, worth a radian per second squared, do not get through."""
    best = scene.best(source)
    assert best.source == ("fused" if source == "auto" else source)
    assert best.imus == (() if source == "encoder" else ("imu_a", "imu_b"))
    assert best.warnings == ()
    if source == "imu":  # noise, and what calibrations usually leave; these are perfect
        assert (scene.error(best) < 0.4 * scene.error(scene.motion)).all()
        assert (scene.error(best) < best.acceleration_error).all()
        assert (best.acceleration_error < 4 * scene.error(best)).all()
        np.testing.assert_array_equal(best.encoder_error, scene.motion.acceleration_error)


@pytest.mark.parametrize("factor", [-1.0, 0.0])
def test_flipped_or_dead_imus_alone_are_an_error_that_names_them(
    scene: Scene, factor: float
) -> None:
    bad = {k: factor * v for k, v in scene.recording.accelerometers.items()}
    with pytest.raises(InputError, match=r"imu_a is left out.*imu_b is left out") as caught:
        scene.best("imu", bad)
    assert "--motion encoder" in caught.value.hint
    assert caught.value.where == "log"


def test_what_calibration_found_is_taken_off(scene: Scene) -> None:
    """Biases, gains and a clock 20 ms late; the last alone would make an IMU useless."""
    rng, late = np.random.default_rng(3), round(0.02 * scene.recording.rate_hz)
    readings, found = {}, {}
    for name, values in scene.recording.accelerometers.items():
        bias, gain = rng.normal(0, 0.3, 12), rng.normal(1, 0.02, 12)
        readings[name] = np.roll(values, late, axis=0) * gain + bias
        found[name] = msgspec.structs.replace(
            scene.stage.imus[name],
            time_offset_s=0.02,
            accelerometer_bias=bias.tolist(),
            accelerometer_scale=gain.tolist(),
        )
    plain, mended = scene.best("imu"), scene.best("imu", readings, ImuStage(imus=found))
    np.testing.assert_allclose(scene.error(mended), scene.error(plain), rtol=0.02)
    assert mended.imus == plain.imus
