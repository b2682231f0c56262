"""Errors of an accepted effect's shape: events that are no more than that, and shapes of others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover import investigate
from seqid_cli.discover.events import Interval
from seqid_cli.discover.gates import Gates
from seqid_cli.discover.greedy import searched
from seqid_cli.discover.investigate import Searched, _about_itself, _outside, of_shape
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.search import Search
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from tests.discover.arms import arm_scenes, candidate, search_in

Array = NDArray[np.float64]

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


def bent(scene: Scene) -> Array:
    """A wide hump over the second joint's position: a cubic in a rough way."""
    hump = 4.0 * np.exp(-(((scene.motion.q[:, 1] - 0.4) / 0.7) ** 2))
    return np.stack([np.zeros(scene.samples), hump], axis=1)


def sprung(scene: Scene) -> Array:
    q = scene.motion.q[:, 1]
    return np.stack([np.zeros(scene.samples), -3.0 * q - 2.0 * q**3], axis=1)


@pytest.mark.parametrize("extra", [bent, sprung])
def test_a_name_is_not_kept_for_what_has_another_shape(extra: Callable[[Scene], Array]) -> None:
    search = search_in(arm_scenes(extra))
    searched(search, [CATALOGUE["spring"]], Gates().passes, most=1)
    assert [t.candidate.key for t in search.accepted] == [("spring", 1)]
    assert search.rms()[1] < 0.5 * search.bare[1]
    told = [(d.joint, d.quantities) for d in _outside(search, Gates())]
    assert told == ([(1, ("position",))] if extra is bent else [])


def ended_with(name: str, **settings: float) -> Searched:
    """A search among springs of joint 1 that has ended with some effect there."""
    search = search_in(arm_scenes(sprung))
    tried = search.stage.try_all(search.system(), [candidate(name, 1, **settings)])
    search.add(tried[0])
    return Searched(search, ())


@pytest.mark.parametrize("better", [True, False])
def test_a_moved_model_that_leaves_more_is_not_gone_on_with(
    monkeypatch: pytest.MonkeyPatch, better: bool
) -> None:
    right, wrong = ended_with("spring", cubic=1.0), ended_with("asymmetric_friction")
    first, again = (wrong, right) if better else (right, wrong)
    monkeypatch.setattr(investigate, "_search", lambda *_: again)
    monkeypatch.setattr(investigate, "moved", lambda _: 1.0)
    assert _about_itself(first, Gates(), DiscoverOptions()) is right
