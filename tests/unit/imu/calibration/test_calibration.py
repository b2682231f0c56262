"""Mountings and faults of real sensors: found with their errors, or said to be open."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.errors import UsageError
from seqid_cli.identify.imu_calibration import calibrate_imus
from seqid_cli.imu.array import calibrated as without_faults
from seqid_cli.imu.calibration.segments import cleaned
from seqid_cli.motion.options import MotionOptions
from tests.plants import instruments as plants
from tests.plants.arms.rigs import one_joint
from tests.plants.instruments import (
    COARSE,
    FINE,
    GYRO,
    Case,
    instruments,
    scene_of,
    scored,
)
from tests.plants.motions.experiments import swing
from tests.plants.motions.trajectories import hold, join
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.robots.sample import sample_rig
from tests.plants.simulate import simulate


@pytest.mark.slow
@pytest.mark.parametrize("case", [COARSE, FINE], ids=lambda case: case.label)
def test_errors_of_a_faulty_array_are_those_reported(case: Case) -> None:
    """Four instruments: mounting, offset, gains and biases, all within their standard
    errors.
    """
    seen = [score for seed in range(4) for score in plants.scores((case, seed))]
    for name in ("z_turn", "z_delay", "z_gain", "z_bias"):
        z = np.concatenate([getattr(score, name) for score in seen])
        assert np.sqrt(np.mean(z**2)) < 2.0, name
        assert np.abs(z).max() < 5.0, name
    assert max(score.turn_deg for score in seen) < 0.5
    assert max(score.delay_error for score in seen) < 3e-4
    assert all(score.outliers > 0 for score in seen)
    assert all((score.holdout or 9.0) < 1.2 for score in seen)


@pytest.mark.slow
def test_a_gyro_is_calibrated_with_its_triad() -> None:
    """Its readings are those of a better instrument, in a frame turned by the common
    tilt.
    """
    scene = scene_of(GYRO)
    imu, nominal = instruments(scene, 0)[1], scene.robot.imus[1]
    calibration = plants.calibrated(scene, 0).imus["imu_b"]
    truth = imu.gyro_faults
    for values, errors, true in (
        (calibration.gyro_bias, calibration.gyro_bias_std_errors, truth.biases(3)),
        (calibration.gyro_scale, calibration.gyro_scale_std_errors, truth.gains(3)),
    ):
        assert np.all(np.abs(np.array(values) - true) < 4 * np.array(errors))
    assert calibration.time_offset_s == pytest.approx(0.002, abs=2e-4)
    assert np.abs(scored(imu, calibration).z_turn).max() < 4.0
    f = 10.0 * np.random.default_rng(0).standard_normal((200, 3))
    readings = imu.faults.gains(3) * (
        f @ imu.faults.axes(imu.axes).T
    ) + imu.faults.biases(3)
    better, mended, _ = without_faults(nominal, calibration, readings, None)
    turned = f @ imu.rotation.T @ plants.true_mounting(imu)
    before, after = readings - turned @ nominal.axes.T, mended - turned @ better.axes.T
    assert np.sqrt(np.mean(after**2)) < 0.2 * np.sqrt(np.mean(before**2))


@pytest.mark.slow
def test_a_triad_without_a_gyro_is_calibrated_by_gravity_and_the_encoders() -> None:
    own = scene_of(FINE)
    logs = [
        replace(log, accelerometers={"imu_a": log.accelerometers["imu_a"][:, :3]})
        for log in plants.recordings(own, 1)
    ]
    imu = own.robot.imus[0]
    triad = replace(imu, positions=imu.positions[:3], axes=imu.axes[:3])
    stage = calibrate_imus(
        logs, replace(own.robot, imus=(triad,)), options=MotionOptions()
    )
    assert "does not see angular acceleration" in stage.verdicts[0].reason
    instrument = instruments(own, 1)[0]
    single = replace(instrument, positions=np.zeros((3, 3)), axes=instrument.axes[:3])
    assert np.abs(scored(single, stage.imus["imu_a"]).z_turn).max() < 4.0


def test_spikes_and_saturation_are_bridged_and_jolts_are_not_spikes() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(2000) / 250.0
    clean = 5 * np.sin(6 * t)[:, None] + 0.03 * rng.standard_normal((2000, 3))
    values = clean.copy()
    values[500, 0] += 3.0
    values[1200, 1] = np.nan
    values[:, 2] = np.clip(values[:, 2], -4.0, 4.0)
    bridged, bad = cleaned(values, np.ones(2000, dtype=bool))
    assert bad[[500, 1200], [0, 1]].all()
    assert bad[:, 0].sum() < 5
    assert np.abs(bridged - clean)[:, :2].max() < 0.3
    flat = np.abs(clean[:, 2]) > 4.05
    assert bad[flat, 2].mean() > 0.95
    assert bad[np.abs(clean[:, 2]) < 3.9, 2].mean() < 0.01


@pytest.mark.slow
def test_gravity_at_rest_closes_the_angle_about_a_single_tilted_axis() -> None:
    """The paper's single joint swings, with rests that are long enough to see
    gravity.
    """
    plant, parts = one_joint(), []
    for angle in (-0.8, 0.9):
        motion = swing(plant, np.array([angle]), 0, 2, share=0.4, rate_hz=1000.0)
        parts += [
            hold(motion.q[0], 1.2, 1000.0),
            motion,
            hold(motion.q[-1], 1.2, 1000.0),
        ]
    log = recording_of(plant, "rested", simulate(plant, join(parts), 0, every=4))
    stage = calibrate_imus([log], robot_of("one", plant), options=MotionOptions())
    found = stage.imus["imu_a"]
    assert found.not_determined == ["the lever along the link's z is not determined"]
    off = Rotation.from_matrix(np.array(found.rotation) @ plant.imus[0].rotation.T)
    assert np.degrees(off.magnitude()) < 0.1


def test_without_an_imu_in_the_robot_file_there_is_nothing_to_calibrate() -> None:
    plant = replace(one_joint(), imus=())
    with pytest.raises(UsageError, match=r"no \[\[imu\]\]"):
        calibrate_imus([], robot_of("one", plant), options=MotionOptions())


@pytest.mark.slow
def test_axes_that_an_imu_does_not_see_are_no_pairs() -> None:
    """One of the arm's logs with an IMU that records noise alone: it says nothing of
    axes.
    """
    two_joint = sample_rig("two_joint")
    *seen, blind = two_joint.logs("imu")
    still = blind.accelerometers["imu_b"].mean(axis=0)
    noise = 0.1 * np.random.default_rng(0).standard_normal((len(blind.t), len(still)))
    logs = [*seen, replace(blind, accelerometers={"imu_b": still + noise})]
    (imu,) = (imu for imu in two_joint.robot.imus if imu.name == "imu_b")
    robot = replace(two_joint.robot, imus=(imu,))
    stage = calibrate_imus(logs, robot, options=MotionOptions())
    calibration = stage.imus["imu_b"]
    assert calibration.configurations == len(seen)
    assert "joint_2" not in calibration.references
    assert calibration.axis_rmse_deg < 1.0
