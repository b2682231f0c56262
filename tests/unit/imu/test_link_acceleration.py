"""Accelerations from IMUs and encoders on a simulated arm, where the truth is known."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.imu.link_acceleration import _link_reading, best_motion
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage
from seqid_cli.typing import Array
from tests.plants.arms.rigs import two_joint
from tests.plants.fused import Case, stage_of
from tests.plants.mechanics.rigid import link_motion
from tests.plants.motions.experiments import inertia_trials
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.simulate import simulate


@pytest.fixture(scope="module")
def scene() -> Case:
    """The planar rig with its coarse encoders, three seconds at 250 Hz; perfect
    calibrations.
    """
    plant = two_joint()
    rng = np.random.default_rng
    trial = inertia_trials(plant, [np.array([0.0, 0.5])], rng(0), seconds=3.0)[0]
    log = simulate(plant, trial.reference, 0, every=4)
    robot = robot_of("two_joint", plant)
    recording = recording_of(plant, "log", log)
    return Case(
        plant, robot, recording, stage_of(plant, rng(0), 0.0), log.truth.ddq, log
    )


def encoder(scene: Case) -> Motion:
    return estimate_motion(scene.recording, scene.robot, MotionOptions())


def by_imus(scene: Case) -> Motion:
    return best_motion(
        scene.recording, scene.robot, scene.stage, encoder(scene), source="imu"
    )


def error(scene: Case, motion: Motion) -> Array:
    off = (motion.ddq - motion.lowpass(scene.truth))[motion.usable]
    return np.asarray(np.sqrt(np.mean(off**2, axis=0)))


def test_imus_alone_say_their_error(scene: Case) -> None:
    """Noise, and what calibrations usually leave; biases of a radian per second squared
    do not.
    """
    motion = by_imus(scene)
    by_encoders = encoder(scene)
    assert (motion.source, motion.imus, motion.warnings) == (
        "imu",
        ("imu_a", "imu_b"),
        (),
    )
    off = error(scene, motion)
    stated = motion.acceleration_error
    assert (off < 0.4 * error(scene, by_encoders)).all()
    assert ((off < stated) & (stated < 4 * off)).all()
    np.testing.assert_array_equal(motion.encoder_error, by_encoders.acceleration_error)


@pytest.mark.parametrize("hz", [8.0, 20.0])
def test_velocities_are_the_imus_and_as_well_known_as_said(
    scene: Case, hz: float
) -> None:
    """Eq. 31 of joint 1, Eq. 41 of joint 2; positions stay the encoders'."""
    by_encoders = estimate_motion(scene.recording, scene.robot, MotionOptions(hz))
    improved = best_motion(
        scene.recording, scene.robot, scene.stage, by_encoders, source="imu"
    )
    true, _ = differentiate(by_encoders.lowpass(scene.log.truth.q), by_encoders.rate_hz)

    def velocity_error(motion: Motion) -> Array:
        return np.asarray(
            np.sqrt(np.mean((motion.dq - true)[motion.usable] ** 2, axis=0))
        )

    np.testing.assert_array_equal(improved.q, by_encoders.q)
    assert (velocity_error(improved) < 0.95 * velocity_error(by_encoders)).all()
    assert (velocity_error(improved) < 1.5 * improved.velocity_error).all()


def test_a_gyro_gives_velocities_and_an_array_that_sees_no_products_none(
    scene: Case,
) -> None:
    """A gyro's noise of 0.005 rad/s against encoders of 600 counts; Eq. 31 without its
    sign.
    """
    rng = np.random.default_rng(4)
    by_encoders = encoder(scene)
    true, _ = differentiate(by_encoders.lowpass(scene.log.truth.q), by_encoders.rate_hz)
    robot = scene.robot
    gyros = {}
    imus = []
    for imu in scene.plant.imus:
        motion = link_motion(scene.plant.arm, imu.after, *scene.log.truth[:3])
        rates = motion.omega @ imu.rotation
        gyros[imu.name] = rates + 0.02 + 0.005 * rng.standard_normal(rates.shape)
    for imu in robot.imus:
        imus.append(replace(imu, positions=np.zeros_like(imu.positions)))
    recording = replace(scene.recording, gyros=gyros)
    with_gyros = replace(
        scene, recording=recording, robot=replace(robot, imus=tuple(imus))
    )
    improved = by_imus(with_gyros)
    off = np.sqrt(np.mean((improved.dq - true)[improved.usable] ** 2, axis=0))
    alone = np.sqrt(np.mean((by_encoders.dq - true)[by_encoders.usable] ** 2, axis=0))
    assert (off < 0.6 * alone).all()
    assert (off < 1.5 * improved.velocity_error).all()
    blind = _link_reading(
        scene.robot, imus[0], scene.stage.imus["imu_a"], scene.recording, by_encoders
    )
    assert blind.turning is None


@pytest.mark.parametrize("factor", [-1.0, 0.0])
def test_flipped_or_dead_imus_alone_are_named(scene: Case, factor: float) -> None:
    bad = {k: factor * v for k, v in scene.recording.accelerometers.items()}
    damaged = replace(scene, recording=replace(scene.recording, accelerometers=bad))
    with pytest.raises(
        InputError, match=r"imu_a is left out.*imu_b is left out"
    ) as caught:
        by_imus(damaged)
    assert "--motion encoder" in caught.value.hint
    assert caught.value.where == "log"


def test_what_calibration_found_is_taken_off(scene: Case) -> None:
    """Biases, gains and a clock 20 ms late; the clock alone would ruin an IMU."""
    rng = np.random.default_rng(3)
    late = round(0.02 * scene.recording.rate_hz)
    readings = {}
    calibrations = {}
    for name, values in scene.recording.accelerometers.items():
        bias = rng.normal(0, 0.3, 12)
        gain = rng.normal(1, 0.02, 12)
        readings[name] = np.roll(values, late, axis=0) * gain + bias
        calibrations[name] = msgspec.structs.replace(
            scene.stage.imus[name],
            time_offset_s=0.02,
            accelerometer_bias=bias.tolist(),
            accelerometer_scale=gain.tolist(),
        )
    recording = replace(scene.recording, accelerometers=readings)
    plain = by_imus(scene)
    mended = by_imus(
        replace(scene, recording=recording, stage=ImuStage(imus=calibrations))
    )
    np.testing.assert_allclose(error(scene, mended), error(scene, plain), rtol=0.02)
    assert mended.imus == plain.imus


def test_a_clock_that_begins_otherwise_in_each_log_is_found_in_this_one(
    scene: Case,
) -> None:
    """It is 50 ms later than expected and gains 4 ms/s."""
    late = 0.05
    rate = 4e-3
    t = scene.recording.t
    readings = {}
    calibrations = {}
    for name, values in scene.recording.accelerometers.items():
        felt = (t - late) / (1.0 + rate)
        columns = [np.interp(felt, t, channel) for channel in values.T]
        readings[name] = np.column_stack(columns)
        calibrations[name] = msgspec.structs.replace(
            scene.stage.imus[name],
            time_offset_s=0.0,
            time_offset_std_error_s=0.03,
            time_rate=3.8e-3,
            time_rate_std_error=2e-4,
        )
    recording = replace(scene.recording, accelerometers=readings)
    plain = by_imus(scene)
    drifting = replace(scene, recording=recording, stage=ImuStage(imus=calibrations))
    mended = by_imus(drifting)
    assert mended.imus == plain.imus
    assert (error(scene, mended) < 1.5 * error(scene, plain)).all()
