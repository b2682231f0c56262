"""Events that may be no more than the error of a law."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover import investigate
from seqid_cli.discover.investigate import of_law
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.survey.events import Interval
from tests.unit.discover.arms import arm_scenes, candidate, model_of

PUSH = Interval(scene=0, start=5.0, end=5.3, joints=(1,), score=9.0)


@pytest.fixture(scope="module")
def model() -> Model:
    model = model_of(arm_scenes(logs=2))
    model.add([candidate("spring", 1, cubic=0.0)])
    return model


def test_a_little_beside_all_of_the_models_torque_is_the_error_of_a_law(model: Model) -> None:
    scene = model.ground.stage.scenes[0]
    swing = np.ptp(scene.modelled[(scene.motion.t > 4.5) & (scene.motion.t < 5.8), 1])
    for share, expected in ((0.01, True), (0.04, False)):
        residual = np.full_like(scene.motion.q, share * swing)
        assert of_law(PUSH, scene, residual) == expected


def test_a_push_where_an_effect_may_have_any_torque_is_no_event(
    model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(investigate, "find_events", lambda *_: [PUSH])
    monkeypatch.setattr(investigate, "of_law", lambda *_: False)
    scenes = model.ground.stage.scenes
    for end, expected in ((5.1, [PUSH]), (5.25, [])):  # of the push from 5 to 5.3 s
        sticks = [(s.motion.t > 4.9) & (s.motion.t < end) for s in scenes]
        guess = [np.column_stack([np.zeros_like(one), one]) for one in sticks]
        assert investigate.events_of(model, guess) == expected


def test_what_terms_make_where_the_file_leaves_less_is_no_event(
    model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(investigate, "find_events", lambda *_: [PUSH])
    monkeypatch.setattr(investigate, "of_law", lambda *_: False)
    left = [whole.residual for whole in model.ground.base.whole]
    guess = [np.zeros_like(one, dtype=bool) for one in left]
    for times, expected in ((1.9, [PUSH]), (2.1, [])):
        monkeypatch.setattr(model, "left", lambda times=times: [times * one for one in left])
        assert investigate.events_of(model, guess) == expected
