"""A base that leans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.model.effects.base_tilt import (
    BaseTilt,
    first_joint_upright,
    first_link_moments,
    tilt_axes,
)
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.model.effects.measured import fitted
from tests.unit.model.effects.scenes import scene_of, wander


def upright_robot() -> Robot:
    """The two-joint arm with gravity along its first axis."""
    robot = two_joint_robot()
    axis = robot.chain.rotation[0] @ robot.chain.axis[0]
    return replace(robot, gravity=-9.81 * axis)


def test_the_lean_comes_back() -> None:
    """A true rotation of gravity by two degrees, of which the columns are the first order."""
    scene = scene_of(wander(15.0))
    axes = np.array(tilt_axes(scene.robot.gravity))
    lean = np.array([0.03, -0.02])
    turned = Rotation.from_rotvec(lean @ axes).apply(scene.robot.gravity)
    robot = replace(scene.robot, gravity=turned)
    tilted = replace(scene.model, robot=robot)
    motion = scene.motion
    extra = tilted.rigid(motion.q, motion.dq, motion.ddq) - scene.rigid
    assert motion.tau is not None
    seen = replace(scene, motion=replace(motion, tau=motion.tau + motion.filtered(extra)))
    c, rms = fitted(BaseTilt(), [seen], None, {"upright": 0.0})
    assert c == pytest.approx(lean, rel=0.05)
    assert rms < 0.05 * float(np.sqrt(np.mean(extra**2)))


def test_the_first_links_moment_shows_once_its_axis_leans() -> None:
    """Oracle: the rigid body with that moment, with gravity turned, less the same upright."""
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 2))
    robot = upright_robot()
    assert first_joint_upright(robot)
    still, phi = np.zeros_like(q), np.zeros((2, 10))
    phi[0, 1:4] = [0.7, -0.4, 0.2]
    lean = 0.02 * tilt_axes(robot.gravity)[0]
    across = np.cross(lean, robot.gravity)
    torque = inverse_dynamics(robot.chain, across, phi, q, still, still)
    X = first_link_moments(robot, across, q)
    c, left = np.linalg.lstsq(X, torque[:, 0], rcond=None)[:2]
    assert left.sum() < 1e-20
    assert np.linalg.norm(c) > 0
    np.testing.assert_allclose(
        inverse_dynamics(robot.chain, robot.gravity, phi, q, still, still), 0.0, atol=1e-12
    )


def test_moments_without_a_tilt_are_none() -> None:
    """Of the first link alone they are any function of its angle."""
    scene = scene_of(wander(5.0), robot=upright_robot())
    settings = {"upright": 1.0}
    assert BaseTilt().plausible([scene], None, settings, np.array([0.02, 0.0, 0.3, 0.0]))
    assert not BaseTilt().plausible([scene], None, settings, np.array([1e-5, 0.0, 0.3, 0.0]))
