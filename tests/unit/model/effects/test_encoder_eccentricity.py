"""An encoder that is wrong once per motor turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.encoder_eccentricity import EncoderEccentricity
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from tests.plants.robots.two_joint import GEAR
from tests.unit.model.effects.measured import best_fitted, left_over
from tests.unit.model.effects.scenes import RATE_HZ, motion_of, scene_of, wander

SIN, COS = 1.2e-4, -0.9e-4  # rad at the joint: 6 and 4.5 mrad at the motor
AMPLITUDE = 0.3  # rad: slow enough for a ripple per motor turn to pass the low-pass


def misread(order: float, seed: int, amplitude: float = AMPLITUDE) -> Scene:
    """Torque of the true motion, positions of the second joint with the error."""
    q = wander(24.0, seed=seed, rate_hz=4 * RATE_HZ, rests=(), amplitude=amplitude, top_hz=0.3)
    dq, ddq = differentiate(q, 4 * RATE_HZ)
    plain = scene_of(q[::4])
    tau = plain.model.rigid(q, dq, ddq) + plain.model.friction(q, dq)
    p = order * GEAR[1] * q[:, 1]
    read = q + np.stack([np.zeros_like(p), SIN * np.sin(p) + COS * np.cos(p)], axis=1)
    return replace(plain, motion=motion_of(read[::4], tau=tau[::4]))


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_error_and_order_come_back(order: float) -> None:
    scenes = [misread(order, seed) for seed in (3, 4)]
    settings, c, rms = best_fitted(EncoderEccentricity(), scenes, 1)
    before = np.sqrt(
        np.mean([np.mean(left_over(scene)[scene.motion.usable] ** 2) for scene in scenes])
    )
    assert settings == {"order": order}
    assert c == pytest.approx([SIN, COS], rel=0.15)
    assert rms < 0.5 * before
    covariance = 1e-12 * np.eye(2)
    values = EncoderEccentricity().values(scenes[0].robot, 1, settings, c, covariance)
    assert values[0].value == pytest.approx(np.hypot(SIN, COS), rel=0.15)
    assert values[1].value == pytest.approx(np.arctan2(COS, SIN), abs=0.1)
    assert values[0].std_error == pytest.approx(1e-6)
