"""A locked joint that hunts between the counts of a coarse encoder, before an IMU on its link."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli import identify
from seqid_cli.identify.imu_calibration.segments import Segment, segments_of
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuCalibration
from seqid_cli.robot.file import load_robot
from tests.studies.coverage.cases import case_of, draw, record

CASE = case_of("planar", 10039)  # joint 2 hunts in some swings of joint 1
STILL, HUNTING = "joint_1_posture_4.parquet", "joint_1_posture_3.parquet"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("hunting")
    drawn = draw(CASE)
    swings = [trial for trial in drawn.trials if trial.stage == "imu"]
    record(CASE, replace(drawn, trials=swings), out)
    return out


@pytest.fixture(scope="module")
def calibration(folder: Path) -> ImuCalibration:
    stages = identify.imu_calib(str(folder / "imu"), folder / "robot.toml").stages
    return stages.imu.imus["imu_b"]


def segment(folder: Path, name: str) -> Segment:
    robot = load_robot(folder / "robot.toml")
    recording = read_recording(folder / "imu" / name, robot)
    motion = estimate_motion(recording, robot, MotionOptions())
    (found,) = segments_of(recording, robot, robot.imus[1], motion, log=0, cutoff_hz=20.0)
    return found


@pytest.mark.slow
def test_a_joint_that_hunts_is_an_unknown_and_one_that_stands_is_locked(folder: Path) -> None:
    assert segment(folder, HUNTING).moving == (0, 1)
    assert segment(folder, STILL).moving == (0,)
    assert segment(folder, STILL).locked == (1,)


@pytest.mark.slow
def test_lever_scales_and_the_error_of_accelerations_hold(calibration: ImuCalibration) -> None:
    """With joint 2 taken for locked the scales are 0.1 % off.

    Perfect sensors: acceleration by the whole array goes with its lever about the joint.
    """
    lever = np.array(calibration.lever[:2], dtype=float)
    errors = np.array(calibration.lever_std_errors[:2], dtype=float)
    (true,) = (imu.lever[:2] for imu in draw(CASE).plant.imus if imu.name == "imu_b")
    assert np.all(np.abs(lever - true) < 3.0 * errors)
    scales = np.array(calibration.accelerometer_scale, dtype=float)
    assert np.abs(scales - 1.0).max() < 5e-4
    by_lever = float(np.hypot(*(lever * errors)) / np.sum(lever**2))
    assert 0.4 * by_lever < calibration.acceleration_std_error < 1.2 * by_lever
