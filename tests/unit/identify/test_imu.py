"""Eq. 29-38: rotations from pairs of directions, and what they leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from seqid_cli.errors import UsageError
from seqid_cli.identify.imu_calibration.calibrate import calibrate_imus
from seqid_cli.motion.options import MotionOptions
from tests.plants.experiments import Trial, swing
from tests.plants.rigs import one_joint
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.simulate import Plant, simulate
from tests.plants.trajectories import hold, join

Array = NDArray[np.float64]


def degrees_between(A: Array, B: Array) -> float:
    return float(np.degrees(np.linalg.norm(Rotation.from_matrix(A @ B.T).as_rotvec())))


def rested(plant: Plant) -> Trial:
    """The paper's single joint swings, with rests that are long enough to see gravity."""
    rest, angles = [], (-0.8, 0.9)
    for angle in angles:
        motion = swing(plant, np.array([angle]), 0, 2, share=0.4, rate_hz=1000.0)
        rest += [hold(motion.q[0], 1.2, 1000.0), motion, hold(motion.q[-1], 1.2, 1000.0)]
    return Trial("imu", "rested", join(rest), imus=True)


def test_gravity_at_rest_closes_the_angle_about_a_single_tilted_axis() -> None:
    plant = one_joint()
    log = simulate(plant, rested(plant).reference, 0, every=4)
    stage = calibrate_imus(
        [recording_of(plant, "rested", log)], robot_of("one", plant), options=MotionOptions()
    )
    found = stage.imus["imu_a"]
    assert found.not_determined == ["the lever along the link's z is not determined"]
    assert degrees_between(np.array(found.rotation), plant.imus[0].rotation) < 0.1


def test_without_an_imu_in_the_robot_file_there_is_nothing_to_calibrate() -> None:
    plant = replace(one_joint(), imus=())
    with pytest.raises(UsageError, match=r"no \[\[imu\]\]"):
        calibrate_imus([], robot_of("one", plant), options=MotionOptions())
