"""The model moved to what a search has found."""

from __future__ import annotations

import numpy as np

from seqid_cli.discover.base import base_of
from seqid_cli.discover.relinearise import moved, relinearised
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from tests.discover.arms import arm_scenes, search_in

GROWN = 0.3  # share by which every rigid-body torque is larger than the model says


def heavier(scene: Scene) -> np.ndarray:
    return GROWN * scene.rigid


def test_a_search_in_logs_of_the_model_has_not_moved() -> None:
    assert moved(search_in(arm_scenes())) < 0.05


def test_the_moved_model_is_what_was_measured() -> None:
    search = search_in(arm_scenes(heavier))
    assert GROWN - 0.05 < moved(search) < GROWN + 0.1
    before = search.stage.scenes[0].rigid
    stage, base = relinearised(search)
    np.testing.assert_allclose(
        stage.scenes[0].rigid, (1 + GROWN) * before, atol=0.05 * np.abs(before).max()
    )
    np.testing.assert_array_equal(base.start, search.base.start)


def test_residuals_are_those_of_the_moved_model() -> None:
    """Oracle: the base computed afresh from the moved scenes."""
    stage, base = relinearised(search_in(arm_scenes(heavier)))
    fresh = base_of(stage.rows, Stages())
    for y, wanted in zip(base.y, fresh.y, strict=True):
        np.testing.assert_allclose(y, wanted, atol=1e-4 * np.abs(wanted).max())
    for one, other in zip(base.whole, fresh.whole, strict=True):
        scale = np.abs(other.residual).max()
        np.testing.assert_allclose(one.residual, other.residual, atol=1e-4 * scale)
