"""Events: pushes are found where they were; what recurs, or may be the error of a law, is none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover import investigate
from seqid_cli.discover.investigate import of_law
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.naming import TOLD
from seqid_cli.discover.survey.events import GATE, Interval, find_events
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.model.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import (
    NOISE,
    arm_scenes,
    candidate,
    coloured,
    model_of,
    related_scenes,
)

Extra = Callable[[int, Scene], Array]  # in units of the noise's RMS


def scaled_residual(rows: Rows, seed: int, extra: Extra | None = None) -> list[Array]:
    rng = np.random.default_rng(seed)
    values = []
    for number, scene in enumerate(rows.scenes):
        x = coloured(scene, rng) / np.array(NOISE)
        if extra is not None:
            x = x + scene.motion.filtered(extra(number, scene), times=2)
        values.append(x)
    return [rows.of(j, [x[:, j] for x in values]) for j in range(rows.n)]


def push(scene_number: int, start: float, length: float, height: float, joints: list[int]) -> Extra:
    def extra(number: int, scene: Scene) -> Array:
        x = np.zeros((scene.samples, scene.robot.n))
        t = scene.motion.t
        inside = (t > start) & (t < start + length) & (number == scene_number)
        for j in joints:
            x[inside, j] = height * np.sin(np.pi * (t[inside] - start) / length) ** 0.5
        return x

    return extra


def at_second(law: Callable[[Scene], Array]) -> Extra:
    def extra(number: int, scene: Scene) -> Array:
        x = np.zeros((scene.samples, scene.robot.n))
        x[:, 1] = law(scene)
        return x

    return extra


@pytest.fixture(scope="module")
def many_rows() -> list[Rows]:
    return [rows_of(related_scenes(seed, logs=3, seconds=16.0)) for seed in range(4)]


@pytest.mark.slow
def test_clean_noise_has_no_event_in_200_runs(many_rows: list[Rows]) -> None:
    found = [
        find_events(many_rows[k % 4], scaled_residual(many_rows[k % 4], k)) for k in range(200)
    ]
    assert not any(found)


@pytest.mark.parametrize(
    ("length", "height", "joints"),
    [(0.2, 5.0, [0, 1]), (0.4, 4.0, [0, 1]), (0.6, 3.0, [0, 1]), (0.4, 5.0, [1]), (0.6, 4.0, [0])],
)
def test_a_push_is_found_where_it_was(
    many_rows: list[Rows], length: float, height: float, joints: list[int]
) -> None:
    rng = np.random.default_rng(7)
    hits, overlaps, wrong, right_joints = 0, [], 0, 0
    for k in range(8):
        rows = many_rows[k % 4]
        start, number = float(rng.uniform(2.0, 13.0)), int(rng.integers(3))
        extra = push(number, start, length, height, joints)
        for event in find_events(rows, scaled_residual(rows, 500 + k, extra)):
            end = start + length
            common = min(event.end, end) - max(event.start, start)
            if event.scene != number or common <= 0:
                wrong += 1
                continue
            hits += 1
            overlaps.append(common / (max(event.end, end) - min(event.start, start)))
            right_joints += set(event.joints) <= set(joints)
    assert hits >= 5
    assert hits == right_joints
    assert wrong == 0
    assert np.median(overlaps) > 0.6


def stribeck(scene: Scene) -> Array:
    return 6.0 * np.exp(-np.abs(scene.motion.dq[:, 1]) / 0.1) * scene.sign[:, 1]


def ripple(scene: Scene) -> Array:
    return 6.0 * np.sin(2 * scene.gear[1] * scene.motion.q[:, 1])


def impacts(scene: Scene) -> Array:
    load = np.sign(scene.load[:, 1])
    x = np.zeros(scene.samples)
    for at in np.flatnonzero(np.diff(load)):
        x[at : at + 12] += 12.0 * load[at + 1]
    return x


def narrow(scene: Scene) -> Array:
    return 6.0 * np.exp(-(((scene.motion.q[:, 1] - 0.3) / 0.1) ** 2))


@pytest.mark.parametrize("law", [stribeck, ripple, impacts, narrow])
def test_what_recurs_is_no_event(many_rows: list[Rows], law: Callable[[Scene], Array]) -> None:
    for seed, rows in enumerate(many_rows):
        found = find_events(rows, scaled_residual(rows, seed, at_second(law)))
        assert all(one.certainty < TOLD for one in found)


def test_pushes_all_the_time_are_not_events(many_rows: list[Rows]) -> None:
    rows = many_rows[0]

    def extra(number: int, scene: Scene) -> Array:
        every = [push(1, float(s), 0.4, 8.0, [0, 1])(number, scene) for s in range(1, 15)]
        return np.sum(every, axis=0)

    assert find_events(rows, scaled_residual(rows, 3, extra)) == []


def test_a_push_that_shows_in_pieces_is_one(many_rows: list[Rows]) -> None:
    rows = many_rows[0]
    starts = (6.0, 6.5, 7.0, 7.5)

    def extra(number: int, scene: Scene) -> Array:
        every = [push(1, start, 0.15, 20.0, [0, 1])(number, scene) for start in starts]
        return np.sum(every, axis=0)

    found = find_events(rows, scaled_residual(rows, 3, extra))
    assert found
    assert all(one.end > 6.0 and one.start < 7.7 for one in found)


PUSH = Interval(scene=0, start=5.0, end=5.3, joints=(1,), score=9.0)


@pytest.fixture(scope="module")
def model() -> Model:
    model = model_of(arm_scenes(logs=2))
    model.add([candidate("spring", 1, cubic=0.0)])
    return model


def test_a_little_beside_all_of_the_models_torque_is_the_error_of_a_law(model: Model) -> None:
    scene = model.ground.stage.scenes[0]
    swing = np.ptp(scene.modelled[(scene.motion.t > 4.5) & (scene.motion.t < 5.8), 1])
    for score, share, expected in ((GATE, 0.02, True), (GATE, 0.04, False), (50.0, 0.01, False)):
        residual = np.full_like(scene.motion.q, share * swing)
        assert of_law(replace(PUSH, score=score), scene, residual) == expected


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
