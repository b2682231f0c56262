"""Stiffness from a motor and a link that a spring joins."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.joint_elasticity import JointElasticity
from tests.unit.model.effects.measured import best_fitted, left_over
from tests.unit.model.effects.scenes import scene_of, wander
from tests.unit.model.effects.two_mass import Gear, Log, run, scene

STIFFNESS = 4000.0  # resonance with the motor held: 11 Hz


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    return [run(Gear(STIFFNESS, 2.0), seed=seed) for seed in range(2)]


@pytest.mark.parametrize("cutoff_hz", [5.0, 20.0])
@pytest.mark.parametrize("side", ["motor", "link"])
def test_the_stiffness_comes_back(logs: list[Log], cutoff_hz: float, side: str) -> None:
    """Also with the resonance inside the band; and the grid tells where the encoder sits."""
    effect = JointElasticity()
    scenes = [scene(log, cutoff_hz=cutoff_hz, side=side) for log in logs]
    settings, c, rms = best_fitted(effect, scenes, 0)
    before = np.sqrt(np.mean(np.concatenate([left_over(s)[s.motion.usable] for s in scenes]) ** 2))
    value = effect.values(scenes[0].robot, 0, settings, c, np.array([[1e-14]]))[0]
    assert settings["encoder_side"] == (side == "link")
    assert value.value == pytest.approx(STIFFNESS, rel=0.06)
    assert value.std_error == pytest.approx(1e-7 * value.value**2)
    assert rms < 0.4 * before


def test_a_compliance_that_its_shape_contradicts_is_not_believed() -> None:
    effect, scenes = JointElasticity(), [scene_of(wander(10.0))]
    soft = next(iter(effect.grid(scenes, 0, [])))
    assert effect.plausible(scenes, 0, soft, np.array([1.0 / soft["trial_stiffness"]]))
    assert not effect.plausible(scenes, 0, soft, np.array([0.1 / soft["trial_stiffness"]]))
    assert not effect.plausible(scenes, 0, soft, np.array([-1.0 / soft["trial_stiffness"]]))
