"""What goes with the motion against noise that goes on whatever the arm does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.dependence import dependence
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.stationary import beyond_chance, goes_with_motion
from seqid_cli.model.effects.scene import Scene
from tests.discover.arms import Extra, arm_scenes, search_in
from tests.plants.sensors import noise

Array = NDArray[np.float64]

JOINT = 1


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return arm_scenes()


def slow_noise(scenes: Sequence[Scene], seed: int) -> list[Array]:
    """First-order noise (N, 2) N m that lasts 0.3 s, where joints slide."""
    rng = np.random.default_rng(seed)
    found = []
    for scene in scenes:
        keep = np.exp(-1.0 / (0.3 * scene.motion.rate_hz))
        drawn = np.zeros(scene.motion.q.shape)
        for k in range(1, len(drawn)):
            drawn[k] = keep * drawn[k - 1] + rng.normal(size=2)
        found.append(np.where(scene.slides, drawn, 0.0))
    return found


def told_of(scenes: Sequence[Scene], residual: Sequence[Array]) -> bool:
    """Whether a residual (N, 2) N m of each scene goes with the motion."""
    rows = rows_of(scenes)
    return goes_with_motion(rows, rows.of(JOINT, [r[:, JOINT] for r in residual]), JOINT)


def test_coloured_noise_does_not(scenes: list[Scene]) -> None:
    told = [told_of(scenes, slow_noise(scenes, seed)) for seed in range(10)]
    assert sum(told) == 0


@pytest.mark.parametrize("law", ["speed", "far out", "acceleration"])
def test_what_grows_with_the_motion_does(scenes: list[Scene], law: str) -> None:
    """However much it changes sign: it has no mean that any function could follow."""
    residual = []
    for scene, drawn in zip(scenes, slow_noise(scenes, 3), strict=True):
        motion = scene.motion
        size = {
            "speed": motion.dq,
            "far out": motion.q - np.median(motion.q, axis=0),
            "acceleration": motion.ddq,
        }[law]
        residual.append(drawn * np.abs(size))
    assert told_of(scenes, residual)


def test_of_too_little_it_may(scenes: list[Scene]) -> None:
    few = [np.where(np.arange(len(r))[:, None] < 40, r, 0.0) for r in slow_noise(scenes, 1)]
    assert told_of(scenes, few)


def beyond(extra: Extra, seed: int) -> bool:
    search = search_in(arm_scenes(extra, seed=seed))
    found = dependence(search.system(), JOINT, least_gain=0.0, most=1)
    return beyond_chance(search, found)


def test_a_smooth_function_of_coloured_noise_is_chance() -> None:
    """Some function of something follows slow noise; one of as much as any noise shows is none."""
    rng = np.random.default_rng(8)

    def flicker(scene: Scene) -> Array:
        motion = scene.motion
        size = np.array([0.0, 0.6])
        return noise(rng, len(motion.q), size, coloured=0.9, rate_hz=motion.rate_hz)

    assert sum(beyond(flicker, seed) for seed in range(4)) <= 1


def test_a_smooth_function_of_the_state_is_not() -> None:
    def bent(scene: Scene) -> Array:
        result = np.zeros_like(scene.motion.q)
        result[:, JOINT] = 0.05 * np.cos(4.0 * scene.motion.q[:, JOINT])
        return result

    assert beyond(bent, 0)
