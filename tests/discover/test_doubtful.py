"""Accepted effects that do not hold from one stretch of time to the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.doubtful import PLAIN, take_back_doubtful
from seqid_cli.discover.search import Search
from seqid_cli.model.effects.scene import Scene
from tests.discover.arms import arm_scenes, at_joint, candidate, search_in

Array = NDArray[np.float64]

HUMP = {"stribeck_speed": 0.3, "exponent": 2.0}


def with_hump(*others: str) -> tuple[Search, Array]:
    """Return a search that has accepted the hump of joint 1 that is there, and the noise floor."""

    def torque(scene: Scene) -> Array:
        v = scene.motion.dq[:, 1]
        return np.asarray(2.0 * np.sign(v) * np.exp(-((v / 0.3) ** 2)))

    search = search_in(arm_scenes(at_joint(1, torque)))
    for wanted in (candidate("stribeck", 1, **HUMP), *(candidate(name, 1) for name in others)):
        search.add(search.stage.try_all(search.system(), [wanted])[0])
    return search, search.noise[:2].copy()


def left_of(search: Search, floor: Array) -> Sequence[str]:
    take_back_doubtful(search, floor)
    return [t.candidate.effect.name for t in search.accepted]


@pytest.fixture(autouse=True)
def nothing_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Search, "holds", lambda *_: False)


def test_what_plainly_is_missing_keeps_its_name() -> None:
    search, floor = with_hump()
    assert search.bare[1] > 2 * PLAIN * floor[1]
    assert left_of(search, floor) == ["stribeck"]


def test_what_is_hardly_more_than_noise_is_chance() -> None:
    search, floor = with_hump()
    assert left_of(search, floor * search.bare[1] / floor[1]) == []


def test_what_goes_on_alike_whatever_the_arm_does_is_chance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("seqid_cli.discover.doubtful.goes_with_motion", lambda *_: False)
    assert left_of(*with_hump()) == []


def test_a_second_effect_is_no_more_certain_for_the_first() -> None:
    assert left_of(*with_hump("asymmetric_friction")) == ["stribeck"]
