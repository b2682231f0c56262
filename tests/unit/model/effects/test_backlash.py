"""The gap of a gear with play, from the motor's own angle and torque."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.backlash import Backlash, play
from seqid_cli.model.effects.joint_elasticity import JointElasticity
from seqid_cli.model.effects.scene import Scene
from tests.unit.model.effects.measured import best_fitted, fitted, left_over
from tests.unit.model.effects.scenes import motion_of, scene_of, wander
from tests.unit.model.effects.two_mass import Gear, run, scene


def rms_before(scenes: list[Scene]) -> float:
    return float(
        np.sqrt(np.mean(np.concatenate([left_over(s)[s.motion.usable] for s in scenes]) ** 2))
    )


@pytest.mark.parametrize("cutoff_hz", [10.0, 20.0])
@pytest.mark.parametrize("gap", [1e-3, 4e-3])
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


def test_a_gear_without_play_has_none() -> None:
    scenes = [scene(run(Gear(2e5, 60.0)), cutoff_hz=20.0)]
    for settings in Backlash().grid(scenes, 0, [left_over(s) for s in scenes]):
        assert abs(fitted(Backlash(), scenes, 0, settings)[0][0]) < 1e-4


def test_a_flight_takes_as_long_as_its_load_needs() -> None:
    """Under a load that grows evenly from zero: (6 M b / load rate)^(1/3)."""
    rate_hz, load_rate, inertia, gap = 2000.0, 30.0, 0.5, 3e-3
    motion = motion_of(np.zeros((2000, 1)), rate_hz=rate_hz)
    load = load_rate * (motion.t - 0.40012)
    lead = play(load, np.full(2000, inertia), motion, gap)
    flight = np.flatnonzero(np.abs(lead) < 0.5 * gap - 1e-9) / rate_hz
    expected = (6 * inertia * gap / load_rate) ** (1 / 3)
    assert flight[-1] - 0.40012 == pytest.approx(expected, abs=1.0 / rate_hz)
    assert flight[0] >= 0.4
    assert lead[0] == -0.5 * gap
    assert lead[-1] == 0.5 * gap


def test_a_link_that_turns_back_lands_where_it_left() -> None:
    motion = motion_of(np.zeros((2000, 1)), rate_hz=2000.0)
    load = 5.0 - 5.2 * np.exp(-(((motion.t - 0.5) / 0.01) ** 2))
    lead = play(load, np.full(2000, 0.5), motion, 0.02)
    assert lead.min() < 0.01
    assert lead[-1] == 0.01


def test_a_load_of_one_sign_shows_no_play() -> None:
    seen = scene_of(wander(8.0))
    load = np.abs(seen.load[:, 0]) + 1.0
    lead = play(load, np.ones(seen.samples), seen.motion, 1e-3)
    np.testing.assert_array_equal(lead, 5e-4)


def test_a_gap_that_its_shape_contradicts_is_not_believed() -> None:
    scenes = [scene_of(wander(8.0))]
    settings = {"trial_gap": 1e-3}
    assert Backlash().plausible(scenes, 0, settings, np.array([1.2e-3]))
    assert not Backlash().plausible(scenes, 0, settings, np.array([1e-4]))
    assert not Backlash().plausible(scenes, 0, settings, np.array([1e-2]))
