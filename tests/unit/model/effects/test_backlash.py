"""The gap of a gear with play, from the motor's own angle and torque."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.backlash import Backlash
from seqid_cli.model.effects.joint_elasticity import JointElasticity
from seqid_cli.model.effects.scene import Scene
from tests.unit.model.effects.measured import best_fitted, fitted, left_over
from tests.unit.model.effects.scenes import scene_of, wander
from tests.unit.model.effects.two_mass import Gear, run, scene


def rms_before(scenes: list[Scene]) -> float:
    return float(
        np.sqrt(np.mean(np.concatenate([left_over(s)[s.motion.usable] for s in scenes]) ** 2))
    )


@pytest.mark.parametrize("cutoff_hz", [10.0, 20.0])
@pytest.mark.parametrize("gap", [1e-3, pytest.param(4e-3, marks=pytest.mark.slow)])
def test_the_gap_comes_back(gap: float, cutoff_hz: float) -> None:
    """One column takes more than nine tenths of what play does; an elastic gear does not."""
    logs = [run(Gear(5e4, 20.0, gap), seed=seed) for seed in range(2)]
    scenes = [scene(log, cutoff_hz=cutoff_hz) for log in logs]
    _, c, rms = best_fitted(Backlash(), scenes, 0)
    before = rms_before(scenes)
    assert c[0] == pytest.approx(gap, rel=0.2)
    assert rms < 0.3 * before
    elastic = JointElasticity()
    rival = min(fitted(elastic, scenes, 0, s)[1] for s in elastic.grid(scenes, 0, []))
    assert rival > 2.0 * rms


def test_a_gap_that_its_shape_contradicts_is_not_believed() -> None:
    scenes = [scene_of(wander(8.0))]
    settings = {"trial_gap": 1e-3}
    assert Backlash().plausible(scenes, 0, settings, np.array([1.2e-3]))
    assert not Backlash().plausible(scenes, 0, settings, np.array([1e-4]))
    assert not Backlash().plausible(scenes, 0, settings, np.array([1e-2]))
