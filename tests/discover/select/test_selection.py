"""What the selection takes, what it leaves, and which name it gives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Candidate, Stage
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.select.investigation import named_of
from seqid_cli.discover.select.selection import Ground, Options, Selected, select
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from tests.discover.arms import Extra, arm_scenes, at_joint

Array = NDArray[np.float64]

SOME = ("stribeck", "spring", "quadratic_drag", "torque_bias", "load_dependent_friction")
DRAG = 0.3  # N m s^2/rad^2
HUMP, SPEED = 1.2, 0.3  # N m, rad/s
RIPPLE = 0.5  # N m


def drag(scene: Scene) -> Array:
    v = scene.motion.dq[:, 0]
    return np.asarray(DRAG * v * np.abs(v))


def stribeck(scene: Scene) -> Array:
    ratio = scene.motion.dq[:, 1] / SPEED
    return np.asarray(HUMP * np.exp(-(ratio**2)) * scene.sign[:, 1])


def both(scene: Scene) -> Array:
    return np.stack([drag(scene), stribeck(scene)], axis=1)


def waves(scene: Scene) -> Array:
    """No effect of the catalogue: a brake that drags at some positions."""
    return np.asarray(RIPPLE * np.cos(4.0 * scene.motion.q[:, 0]) * scene.motion.dq[:, 0] ** 2)


def selected(
    extra: Extra | None, names: Sequence[str] = SOME, options: Options | None = None
) -> Selected:
    rows = rows_of(arm_scenes(extra))
    catalogue = [CATALOGUE[name] for name in names]
    stage, base = Stage(rows), base_of(rows, Stages())
    return select(Ground.of(stage, base, options or Options(), catalogue))


def keys(found: Selected) -> list[tuple[str, int | None]]:
    return [one.term.key for one in found.terms]


@pytest.fixture(scope="module")
def pair() -> Selected:
    return selected(both)


def test_nothing_is_taken_where_the_model_is_right() -> None:
    assert keys(selected(None)) == []


def test_both_effects_are_taken_at_their_joints(pair: Selected) -> None:
    assert sorted(keys(pair), key=str) == [("quadratic_drag", 0), ("stribeck", 1)]


def test_settings_and_coefficients_are_the_true_ones(pair: Selected) -> None:
    found = {one.term.name: one for one in pair.terms}
    what = found["stribeck"].term.what
    assert isinstance(what, Candidate)
    assert what.settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.1)
    value, error = (
        found["quadratic_drag"].gained.coefficients[0],
        np.sqrt(found["quadratic_drag"].gained.covariance[0, 0]),
    )
    assert abs(value - DRAG) < 4.0 * error < 0.1 * DRAG


def test_names_are_sure_where_no_rival_comes_near(pair: Selected) -> None:
    for one, rivals in zip(pair.terms, pair.rivals, strict=True):
        named = named_of(one, rivals)
        assert named.confidence > 0.95
        assert named.by_itself > 0.95


def test_what_no_effect_explains_is_a_smooth_function() -> None:
    (one,) = selected(at_joint(0, waves)).terms[:1]
    assert one.term.smooth
    assert one.term.joint == 0


def test_an_effect_without_its_name_in_the_list_is_no_other_effect() -> None:
    found = selected(at_joint(1, stribeck), ("spring", "torque_bias"))
    assert all(one.term.smooth for one in found.terms)
    assert found.terms


def test_no_improvement_is_enough_if_more_is_asked() -> None:
    assert keys(selected(both, options=Options(improvement=0.999))) == []
