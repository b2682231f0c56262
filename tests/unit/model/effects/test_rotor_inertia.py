"""Rotors heavier than the robot file says, and what their spin does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.rotor_inertia import RotorInertia
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import TorqueModel
from tests.plants.robots.two_joint import GEAR, ROTOR
from tests.unit.model.effects.measured import fitted
from tests.unit.model.effects.scenes import scene_of, wander

ERROR = 3e-5  # kg m^2


def measuring(scene: Scene, truth: TorqueModel) -> Scene:
    motion = scene.motion
    extra = truth.rigid(motion.q, motion.dq, motion.ddq) - scene.rigid
    assert motion.tau is not None
    return replace(scene, motion=replace(motion, tau=motion.tau + motion.filtered(extra)))


@pytest.mark.parametrize("joint", [0, 1])
def test_the_missing_inertia_comes_back(joint: int) -> None:
    scene = scene_of(wander(10.0))
    heavier = replace(scene.model, rotor=np.array(ROTOR) + ERROR * np.eye(2)[joint])
    c, rms = fitted(RotorInertia(), [measuring(scene, heavier)], joint, {"coupling": 0.0})
    assert c[0] == pytest.approx(ERROR, rel=1e-6)
    assert rms < 1e-9


def test_the_spin_of_a_carried_rotor_comes_back() -> None:
    """Angular momentum of the spin, differentiated numerically in the base frame."""
    scene = scene_of(wander(10.0))
    turning = replace(scene.model, rotor=np.array(ROTOR), coupling="gyroscopic")
    seen = measuring(scene, turning)
    c, rms = fitted(RotorInertia(), [seen], 1, {"coupling": 1.0})
    assert c[0] == pytest.approx(ROTOR[1], rel=1e-6)
    assert rms < 1e-9
    motion, chain = scene.motion, scene.robot.chain
    axis = chain.rotation[1] @ chain.axis[1]  # in link 1, which turns about the base's z
    cos, sin = np.cos(motion.q[:, 0]), np.sin(motion.q[:, 0])
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    turned = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]])
    momentum = GEAR[1] * motion.dq[:, 1] * np.einsum("abn,b->an", turned, axis)
    moment = np.gradient(momentum[2], 1.0 / motion.rate_hz)
    column = RotorInertia().columns(scene, 1, {"coupling": 1.0})[0][:, 0]
    np.testing.assert_allclose(column[50:-50], moment[50:-50], atol=0.01 * np.ptp(moment))
