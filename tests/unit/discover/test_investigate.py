"""Events that may be no more than the error of an effect's shape."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.investigate import of_law, of_shape
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.survey.events import Interval
from tests.unit.discover.arms import arm_scenes, candidate, model_of

PUSH = Interval(scene=0, start=5.0, end=5.3, joints=(1,), score=9.0)


@pytest.fixture(scope="module")
def model() -> Model:
    model = model_of(arm_scenes(logs=2))
    model.add([candidate("spring", 1, cubic=0.0)])
    return model


def is_of_shape(model: Model, left: float, before: float, after: float) -> bool:
    """Whether a push of `left` noise units is the shape of an effect that steps in its middle."""
    t = model.ground.stage.scenes[0].motion.t
    inside = (t >= PUSH.start) & (t <= PUSH.end)
    residual, effects = np.zeros((2, len(t), 2))
    residual[inside, 1] = left
    effects[:, 1] = np.where(t < 5.15, before, after)
    sigma, scene = model.noise.sigma[:2], model.ground.stage.scenes[0]
    return of_shape(model, PUSH, scene, residual * sigma, effects * sigma)


def test_a_push_beside_a_small_effect_is_an_event(model: Model) -> None:
    assert not is_of_shape(model, 8.0, 3.0, 3.0)
    assert not is_of_shape(model, 8.0, 0.0, 0.0)


def test_where_an_effect_changes_sign_its_shape_may_be_off_by_all_of_it(model: Model) -> None:
    assert not is_of_shape(model, 8.0, 10.0, 10.0)
    assert is_of_shape(model, 8.0, -10.0, 10.0)
    assert not is_of_shape(model, 30.0, -10.0, 10.0)


def test_a_little_beside_all_of_the_models_torque_is_the_error_of_a_law(model: Model) -> None:
    scene = model.ground.stage.scenes[0]
    swing = np.ptp(scene.modelled[(scene.motion.t > 4.5) & (scene.motion.t < 5.8), 1])
    for share, expected in ((0.01, True), (0.04, False)):
        residual = np.full_like(scene.motion.q, share * swing)
        assert of_law(PUSH, scene, residual) == expected
