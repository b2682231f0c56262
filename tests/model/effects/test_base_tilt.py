"""A base that leans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.model.effects.base_tilt import BaseTilt, tilt_axes
from tests.model.effects.measured import fitted
from tests.model.effects.scenes import scene_of, wander


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
    c, rms = fitted(BaseTilt(), [seen], None, {})
    assert c == pytest.approx(lean, rel=0.05)
    assert rms < 0.05 * float(np.sqrt(np.mean(extra**2)))


@pytest.mark.parametrize("gravity", [[0.0, 0.0, -9.81], [9.81, 0.0, 0.0], [1.0, -5.0, 3.0]])
def test_axes_are_square_to_gravity(gravity: list[float]) -> None:
    first, second = tilt_axes(np.array(gravity))
    frame = np.array([first, second, -np.array(gravity) / np.linalg.norm(gravity)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_upright_they_are_x_and_y() -> None:
    np.testing.assert_allclose(tilt_axes(np.array([0.0, 0.0, -9.81])), np.eye(3)[:2], atol=1e-15)
