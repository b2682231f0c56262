"""Slow candidates against the slow part of torque noise."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from seqid_cli.discover.stretches import chance, slowness
from seqid_cli.model.effects.scene import Scene
from tests.discover.arms import arm_scenes, at_joint, candidate, search_in

LOGS, SIZE, JOINT = 5, 0.4, 1  # N m
SESSION_S = 200.0
LEAST = 1e-3


def chance_of_drift(offsets: np.ndarray, rate: float = 0.0) -> float:
    """Return the chance stated for a drift where each log has its own offset, and a ramp."""

    def torque(scene: Scene) -> np.ndarray:
        return offsets[scene.log] + rate * scene.time

    scenes = arm_scenes(at_joint(JOINT, torque), logs=LOGS, seconds=12.0)
    search = search_in(scenes)
    (columns,) = search.stage.columns([candidate("drift", JOINT, duration=SESSION_S)])
    return chance(search.system(), columns)


def test_a_ramp_is_no_chance() -> None:
    assert chance_of_drift(np.zeros(LOGS), rate=SIZE / SESSION_S) < LEAST


def test_offsets_that_each_log_draws_are_seldom_a_drift() -> None:
    """Were samples counted instead of stretches, every one of them would be."""
    rng = np.random.default_rng(3)
    found = [chance_of_drift(SIZE * rng.normal(size=LOGS)) for _ in range(12)]
    assert sum(p < LEAST for p in found) == 0
    assert np.median(found) > 0.01


def test_one_stretch_says_nothing() -> None:
    scenes = arm_scenes(at_joint(JOINT, lambda scene: SIZE * scene.time), logs=1, seconds=12.0)
    search = search_in(scenes)
    (columns,) = search.stage.columns([candidate("drift", JOINT, duration=SESSION_S)])
    assert chance(search.system(), columns) == 1.0


def slowness_of(name: str, **settings: float) -> float:
    """Slowness of an effect that is there, beside Coulomb and viscous friction."""

    def torque(scene: Scene) -> np.ndarray:
        v = scene.motion.dq[:, JOINT]
        return 0.1 * np.abs(np.sign(v)) + SIZE * np.sign(v) * np.exp(-((v / 0.3) ** 2))

    search = search_in(arm_scenes(at_joint(JOINT, torque), logs=LOGS, seconds=12.0))
    (columns,) = search.stage.columns([candidate(name, JOINT, **settings)])
    return slowness(search.system(), columns)


def test_an_asymmetry_of_friction_is_as_slow_as_an_offset_and_a_hump_is_not() -> None:
    assert slowness_of("torque_bias") > 0.6
    assert slowness_of("asymmetric_friction") > 0.6
    assert slowness_of("stribeck", stribeck_speed=0.3, exponent=2.0) < 0.1


def chance_of_stribeck(flicker: float, size: float) -> float:
    """Chance stated for a Stribeck curve of some size in noise that lasts 0.4 s."""
    rng = np.random.default_rng(5)

    def torque(scene: Scene) -> np.ndarray:
        keep = np.exp(-1.0 / (0.4 * scene.motion.rate_hz))
        slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(size=scene.samples))
        v = scene.motion.dq[:, JOINT]
        return flicker * slow + size * np.sign(v) * np.exp(-((v / 0.3) ** 2))

    search = search_in(arm_scenes(at_joint(JOINT, torque), logs=LOGS, seconds=12.0))
    found = candidate("stribeck", JOINT, stribeck_speed=0.3, exponent=2.0)
    (columns,) = search.stage.columns([found])
    return chance(search.system(), columns, slow=False)


def test_short_stretches_tell_quick_effects_in_coloured_noise() -> None:
    assert chance_of_stribeck(SIZE, 0.0) > LEAST
    assert chance_of_stribeck(SIZE, 4.0 * SIZE) < 1e-5
