"""Eq. 29-38: rotations from pairs of directions, and what they leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from seqid_cli.errors import UsageError
from seqid_cli.identify.imu_calibration.calibrate import calibrate_imus
from seqid_cli.identify.imu_calibration.initial_guess import Pair, fit_rotation
from seqid_cli.motion.options import MotionOptions
from tests.plants.arms.rigs import one_joint
from tests.plants.motions.experiments import Trial, swing
from tests.plants.motions.trajectories import hold, join
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.robots.sample import Rig
from tests.plants.simulate import Plant, simulate

Array = NDArray[np.float64]


def unit(rng: np.random.Generator, count: int) -> Array:
    v = rng.standard_normal((count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def pairs_of(R: Array, link: Array, rng: np.random.Generator, sigma: Array) -> list[Pair]:
    """Directions in the link's frame and, with noise across them, in the IMU's."""
    result = []
    for m, s in zip(link, sigma, strict=True):
        noisy = R.T @ m + s * rng.standard_normal(3)
        result.append(Pair(noisy / np.linalg.norm(noisy), m, float(s)))
    return result


def degrees_between(A: Array, B: Array) -> float:
    return float(np.degrees(np.linalg.norm(Rotation.from_matrix(A @ B.T).as_rotvec())))


@pytest.mark.parametrize("count", [2, 5])
def test_the_rotation_minimises_the_weighted_sum_of_squares(count: int) -> None:
    rng = np.random.default_rng(1)
    R = Rotation.random(random_state=1).as_matrix()
    sigma = np.array([0.02, 0.1, 0.03, 0.3, 0.05])[:count]
    pairs = pairs_of(R, unit(rng, count), rng, sigma)

    def cost(candidate: Array) -> float:
        return sum(float(np.sum((candidate @ p.imu - p.link) ** 2)) / p.sigma**2 for p in pairs)

    best = fit_rotation(pairs)
    assert np.linalg.det(best) == pytest.approx(1.0)
    for _ in range(50):
        turned = Rotation.from_rotvec(1e-3 * rng.standard_normal(3)).as_matrix() @ best
        assert cost(turned) > cost(best)


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


def test_axes_that_an_imu_does_not_see_are_no_pairs(two_joint: Rig) -> None:
    """One of the arm's logs with an IMU that records noise alone: it says nothing of axes."""
    *seen, blind = two_joint.logs("imu")
    still = blind.accelerometers["imu_b"].mean(axis=0)
    noise = 0.1 * np.random.default_rng(0).standard_normal((len(blind.t), len(still)))
    logs = [*seen, replace(blind, accelerometers={"imu_b": still + noise})]
    stage = calibrate_imus(logs, two_joint.robot, options=MotionOptions())
    calibration = stage.imus["imu_b"]
    assert calibration.configurations == len(seen)
    assert "joint_2" not in calibration.references
    assert calibration.axis_rmse_deg < 1.0
