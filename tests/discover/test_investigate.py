"""Events beside accepted effects: which of them may be no more than the error of a shape."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.events import Interval
from seqid_cli.discover.investigate import of_shape
from seqid_cli.discover.search import Search
from tests.discover.arms import arm_scenes, search_in

PUSH = Interval(scene=0, start=5.0, end=5.3, joints=(1,), score=9.0)


@pytest.fixture(scope="module")
def search() -> Search:
    return search_in(arm_scenes(logs=2))


def is_of_shape(search: Search, left: float, before: float, after: float) -> bool:
    """Whether a push of `left` noise units is the shape of an effect that steps in its middle."""
    t = search.stage.scenes[0].motion.t
    inside = (t >= PUSH.start) & (t <= PUSH.end)
    residual, effects = np.zeros((2, len(t), 2))
    residual[inside, 1] = left
    effects[:, 1] = np.where(t < 5.15, before, after)
    return of_shape(search, PUSH, residual * search.noise[:2], effects * search.noise[:2])


def test_a_push_beside_a_small_effect_is_an_event(search: Search) -> None:
    assert not is_of_shape(search, 8.0, 3.0, 3.0)
    assert not is_of_shape(search, 8.0, 0.0, 0.0)


def test_a_little_that_is_left_of_a_large_effect_is_its_shape(search: Search) -> None:
    assert is_of_shape(search, 4.0, 10.0, 10.0)


def test_where_an_effect_changes_sign_its_shape_may_be_off_by_all_of_it(search: Search) -> None:
    assert not is_of_shape(search, 8.0, 10.0, 10.0)
    assert is_of_shape(search, 8.0, -10.0, 10.0)
    assert not is_of_shape(search, 30.0, -10.0, 10.0)
