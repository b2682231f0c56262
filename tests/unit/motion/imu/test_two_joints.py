"""Eq. 29-31 and 39-42 on exact kinematics of an arm with arbitrary axes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.imu.link_acceleration import LinkReading, _solve
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.kinematics import AngularMotion, forward, link_angular_motion
from seqid_cli.robot.types import Chain, Imu, Joint, Robot
from seqid_cli.typing import Array
from tests.plants.robots.made import made_motion
from tests.plants.robots.small import random_model
from tests.unit.motion.imu.two_joints import (
    joint_acceleration,
    second_joint_acceleration,
    second_joint_velocity,
)

M, L, SAMPLES = 1, 4, 80


@dataclass(frozen=True)
class Scene:
    """Joints M and L of five move; the IMUs ride on the links after them."""

    robot: Robot
    q: Array
    dq: Array
    ddq: Array
    at_m: AngularMotion
    at_l: AngularMotion
    R_lm: Array

    @property
    def axis_m(self) -> Array:
        return np.asarray(self.robot.chain.axis[M])

    @property
    def axis_l(self) -> Array:
        return np.asarray(self.robot.chain.axis[L])


def robot_of(chain: Chain) -> Robot:
    joints = tuple(Joint(f"joint_{k + 1}") for k in range(chain.n))
    return Robot("test", joints, chain, np.array([0.0, 0.0, -9.81]), "", Path("robot.toml"))


@pytest.fixture(params=range(4))
def scene(request: pytest.FixtureRequest) -> Scene:
    """Random chain, posture and motion."""
    rng = np.random.default_rng(request.param)
    chain = random_model(rng, [False] * 5)[1]
    q = np.tile(rng.uniform(-2, 2, 5), (SAMPLES, 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for j in (M, L):
        q[:, j] = rng.uniform(-2, 2, SAMPLES)
        dq[:, j] = 3 * rng.standard_normal(SAMPLES)
        ddq[:, j] = 20 * rng.standard_normal(SAMPLES)
    motions = [link_angular_motion(chain, q, dq, ddq, link) for link in (M, L)]
    R = forward(chain, q).R
    R_lm = R[:, L].transpose(0, 2, 1) @ R[:, M]  # Eq. 27-28
    return Scene(robot_of(chain), q, dq, ddq, motions[0], motions[1], R_lm)


def motion_of(scene: Scene) -> Motion:
    """The encoders' view: true positions and velocities, accelerations far off."""
    moving = np.zeros_like(scene.q, dtype=bool)
    moving[:, [M, L]] = True
    n = scene.robot.n
    cutoff = Cutoff(10.0, np.full(n, 1e-3), 0.0, True, np.full(n, 1e-9))
    lowpass = Lowpass(10.0, 100.0)
    return made_motion(scene.q, scene.dq, scene.ddq + 5.0, lowpass, moving=moving, cutoff=cutoff)


def test_the_general_solution_contains_eq_30_and_42(scene: Scene) -> None:
    """Least squares over both IMUs gives the paper's two accelerations on consistent readings."""
    imu = Imu("imu", 0, np.zeros((12, 3)), np.zeros((12, 3)))
    found = [
        LinkReading(replace(imu, after_joint=link), motion.dw, 1e-6)
        for link, motion in ((M, scene.at_m), (L, scene.at_l))
    ]
    moving = np.array([M, L])
    got, _ = _solve(scene.robot, motion_of(scene), moving, found)
    velocity = second_joint_velocity(scene.R_lm, scene.at_m.w, scene.at_l.w, scene.axis_l)
    eq_42 = second_joint_acceleration(
        scene.R_lm, scene.at_m.w, scene.at_m.dw, scene.at_l.dw, velocity, scene.axis_l
    )
    eq_30 = joint_acceleration(scene.at_m.dw, scene.axis_m, 1.0)
    np.testing.assert_allclose(got[:, L], eq_42, atol=1e-6)
    np.testing.assert_allclose(got[:, M], eq_30, atol=1e-6)
    still = [j for j in range(scene.robot.n) if j not in (M, L)]
    assert not got[:, still].any()


def test_a_joint_that_no_imu_sees_keeps_the_encoder(scene: Scene) -> None:
    imu = Imu("imu_a", M, np.zeros((12, 3)), np.zeros((12, 3)))
    motion = motion_of(scene)
    found = [LinkReading(imu, scene.at_m.dw, 1e-6)]
    got, error = _solve(scene.robot, motion, np.array([M, L]), found)
    np.testing.assert_allclose(got[:, L], motion.ddq[:, L], atol=1e-9)
    assert error[L] == motion.cutoff.acceleration_noise[L]
    assert error[M] == pytest.approx(1e-6, rel=1e-3)
    np.testing.assert_allclose(got[:, M], scene.ddq[:, M], atol=1e-6)


def test_the_weights_are_those_of_the_noises(scene: Scene) -> None:
    """Two IMUs on one link that disagree: the answer is their inverse-variance mean."""
    imu = Imu("imu_a", M, np.zeros((12, 3)), np.zeros((12, 3)))
    noises, factors = (2.0, 0.5), (1.0, 1.2)
    alone = replace(motion_of(scene), dq=np.where(np.arange(5) == M, scene.dq, 0.0))
    found = [LinkReading(imu, f * scene.at_m.dw, n) for f, n in zip(factors, noises, strict=True)]
    got, error = _solve(scene.robot, alone, np.array([M]), found)
    weight = np.array(noises) ** -2.0
    expected = weight @ np.array(factors) / weight.sum() * scene.ddq[:, M]
    np.testing.assert_allclose(got[:, M], expected, atol=1e-5 * np.abs(expected).max())
    assert error[M] == pytest.approx(weight.sum() ** -0.5, rel=1e-4)
