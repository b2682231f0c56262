"""Events: pushes are found where they were; what recurs, or may be the error of a law,
is none.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover import pushes
from seqid_cli.discover.pushes import of_law
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.settings import EventSettings, EvidenceSettings
from seqid_cli.discover.survey.events import (
    Interval,
    Windows,
    find_events,
    joined_pieces,
    scores,
    with_edges,
)
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import (
    NOISE,
    arm_scenes,
    candidate,
    coloured,
    model_of,
    related_scenes,
)

GATE = EventSettings().min_sigma
TOLD = EvidenceSettings().min_confidence
Extra = Callable[[int, Scene], Array]  # in units of the noise's RMS


def found(rows: Rows, seed: int, *extra: Extra) -> list[Interval]:
    """Events in coloured noise of unit size and what is added to it."""
    rng, values = np.random.default_rng(seed), []
    for number, scene in enumerate(rows.scenes):
        more = sum((one(number, scene) for one in extra), np.zeros_like(scene.motion.q))
        noise = coloured(scene, rng) / np.array(NOISE)
        values.append(noise + scene.motion.filtered(more, times=2))
    return find_events(
        rows, [rows.of(j, [x[:, j] for x in values]) for j in range(rows.n)]
    )


def push(
    scene_number: int, start: float, length: float, height: float, joints: list[int]
) -> Extra:
    def extra(number: int, scene: Scene) -> Array:
        since = (scene.motion.t - start) / length
        inside = (since > 0.0) & (since < 1.0) & (number == scene_number)
        shape = height * np.sin(np.pi * np.where(inside, since, 0.0)) ** 0.5
        return np.outer(shape, np.isin([0, 1], joints))

    return extra


@pytest.fixture(scope="module")
def many_rows() -> list[Rows]:
    return [rows_of(related_scenes(seed, logs=3, seconds=16.0)) for seed in range(4)]


@pytest.mark.slow
def test_clean_noise_has_no_event_in_200_runs(many_rows: list[Rows]) -> None:
    assert not any(found(many_rows[k % 4], k) for k in range(200))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "height", "joints"),
    [
        (0.2, 5.0, [0, 1]),
        (0.4, 4.0, [0, 1]),
        (0.6, 3.0, [0, 1]),
        (0.4, 5.0, [1]),
        (0.6, 4.0, [0]),
    ],
)
def test_a_push_is_found_where_it_was(
    many_rows: list[Rows], length: float, height: float, joints: list[int]
) -> None:
    rng, overlaps = np.random.default_rng(7), []
    for k in range(8):
        start, number = float(rng.uniform(2.0, 13.0)), int(rng.integers(3))
        end = start + length
        for event in found(
            many_rows[k % 4], 500 + k, push(number, start, length, height, joints)
        ):
            common = min(event.end, end) - max(event.start, start)
            assert event.scene == number
            assert common > 0.0
            assert set(event.joints) <= set(joints)
            overlaps.append(common / (max(event.end, end) - min(event.start, start)))
    assert len(overlaps) >= 5
    assert np.median(overlaps) > 0.6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "height", "joints"),
    [(1.5, 8.0, [0, 1]), (3.0, 12.0, [1]), (5.0, 12.0, [0, 1]), (8.0, 20.0, [0])],
)
def test_a_push_of_seconds_is_one_event_with_its_edges(
    many_rows: list[Rows], length: float, height: float, joints: list[int]
) -> None:
    """It fills more of a log than robust sizes bear."""
    rng = np.random.default_rng(8)
    for k in range(4):
        start, number = float(rng.uniform(2.0, 5.0)), int(rng.integers(3))
        events = found(
            many_rows[k], 700 + k, push(number, start, length, height, joints)
        )
        (event,) = events
        assert event.scene == number
        assert set(event.joints) <= set(joints)
        assert abs(event.start - start) < 0.3
        assert abs(event.end - start - length) < 0.3


def test_a_joint_that_slides_for_moments_only_is_one_of_a_push(
    many_rows: list[Rows],
) -> None:
    """None of its windows tells anything, but what is left of it does."""
    masks = []
    for number, scene in enumerate(many_rows[0].scenes):
        t = scene.motion.t - scene.motion.t[0]
        rests = (number == 1) & (t > 5.0) & (t < 9.0) & (t % 0.3 > 0.06)
        masks.append(np.outer(rests, [True, False]))
    rows = many_rows[0].without(masks)
    (event,) = found(rows, 700, push(1, 6.0, 2.0, 20.0, [0, 1]))
    assert event.joints == (0, 1)


def impacts(scene: Scene) -> Array:
    load = np.sign(scene.load[:, 1])
    x = np.zeros(scene.samples)
    for at in np.flatnonzero(np.diff(load)):
        x[at : at + 12] += 12.0 * load[at + 1]
    return x


RECURRING = {
    "stribeck": lambda s: 6.0 * np.exp(-np.abs(s.motion.dq[:, 1]) / 0.1) * s.sign[:, 1],
    "ripple": lambda s: 6.0 * np.sin(2 * s.gear[1] * s.motion.q[:, 1]),
    "impacts": impacts,
    "narrow": lambda s: 6.0 * np.exp(-(((s.motion.q[:, 1] - 0.3) / 0.1) ** 2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("law", RECURRING.values(), ids=RECURRING)
def test_what_recurs_is_no_event(
    many_rows: list[Rows], law: Callable[[Scene], Array]
) -> None:
    for seed, rows in enumerate(many_rows):
        events = found(rows, seed, lambda _, scene: np.outer(law(scene), [0.0, 1.0]))
        assert all(one.certainty(GATE) < TOLD for one in events)


def test_pushes_all_the_time_are_not_events(many_rows: list[Rows]) -> None:
    every = [push(1, float(start), 0.4, 8.0, [0, 1]) for start in range(1, 15)]
    assert found(many_rows[0], 3, *every) == []


PUSH = Interval(scene=0, start=5.0, end=5.3, joints=(1,), score=9.0)


@pytest.fixture(scope="module")
def model() -> Model:
    model = model_of(arm_scenes(logs=2))
    model.add([candidate("spring", 1, cubic=0.0)])
    return model


@pytest.mark.parametrize(("score", "share"), [(GATE, 0.01), (GATE, 0.1), (50.0, 0.01)])
def test_a_little_beside_all_of_the_models_torque_is_the_error_of_a_law(
    model: Model, score: float, share: float
) -> None:
    scene = model.ground.stage.scenes[0]
    swing = np.ptp(scene.modelled[(scene.motion.t > 4.5) & (scene.motion.t < 5.8), 1])
    residual = np.full_like(scene.motion.q, share * swing)
    expected = share == 0.01 and score == GATE
    assert of_law(replace(PUSH, score=score), scene, residual) == expected


@pytest.mark.parametrize(("until", "events"), [(0.0, [PUSH]), (5.3, [])])
def test_a_push_is_no_event_where_effects_may_have_any_torque(
    model: Model, monkeypatch: pytest.MonkeyPatch, until: float, events: list[Interval]
) -> None:
    monkeypatch.setattr(pushes, "find_events", lambda *_: [PUSH])
    monkeypatch.setattr(pushes, "with_edges", lambda event, *_: event)
    monkeypatch.setattr(pushes, "of_law", lambda *_: False)
    sticks = [
        (s.motion.t > 4.9) & (s.motion.t < until) for s in model.ground.stage.scenes
    ]
    guess = [np.outer(one, [False, True]) for one in sticks]
    assert pushes.events_of(model, guess) == events


@pytest.mark.parametrize(
    ("times", "expected"), [(0.9, False), (-0.1, True), (4.0, True)]
)
def test_terms_that_add_more_than_the_file_leaves_make_an_event(
    model: Model, monkeypatch: pytest.MonkeyPatch, times: float, expected: bool
) -> None:
    left = [whole.residual for whole in model.ground.base.scene_bases]
    monkeypatch.setattr(model, "left", lambda: [times * one for one in left])
    assert pushes.not_of_terms([PUSH], model) == ([] if expected else [PUSH])


@pytest.mark.parametrize(("shift", "expected"), [(0.0, True), (2.0, False)])
def test_a_stop_where_a_joint_is_nowhere_else_is_no_event(
    model: Model, shift: float, expected: bool
) -> None:
    scenes = list(model.ground.stage.scenes)
    motion = scenes[0].motion
    q = motion.q.copy()
    q[PUSH.inside(scenes[0]), 1] += shift * np.ptp(q[:, 1])
    scenes[0] = replace(scenes[0], motion=replace(motion, q=q))
    residual = np.ones_like(q)
    is_event = pushes.is_in_reach_of_others(PUSH, [PUSH], scenes, residual)
    assert is_event == expected


@pytest.mark.parametrize(("begins", "expected"), [(False, True), (True, False)])
def test_a_push_that_moves_the_arm_far_off_is_as_large_on_the_way(
    model: Model, begins: bool, expected: bool
) -> None:
    """A law of the end of the way `begins` where the joint is nowhere else."""
    scenes = list(model.ground.stage.scenes)
    motion = scenes[0].motion
    inside = PUSH.inside(scenes[0])
    far = inside & (np.cumsum(inside) > 0.4 * inside.sum())
    q = motion.q.copy()
    q[far, 1] += 2.0 * np.ptp(q[:, 1])
    scenes[0] = replace(scenes[0], motion=replace(motion, q=q))
    residual = np.ones_like(q)
    if begins:
        residual[~far] = 0.0
    is_event = pushes.is_in_reach_of_others(PUSH, [PUSH], scenes, residual)
    assert is_event == expected


def rows_at_few_speeds(model: Model, share: float) -> Rows:
    """Rows of joints that slide all the time, of which a share counts."""
    rows = model.ground.stage.rows
    scene = replace(rows.scenes[0])
    scene.__dict__["slides"] = np.ones_like(scene.slides)
    counts = np.random.default_rng(1).random(rows.used[0].shape) < share
    return replace(
        rows, scenes=(scene, *rows.scenes[1:]), used=(counts, *rows.used[1:])
    )


@pytest.mark.parametrize(("start", "end"), [(5.3, 5.38), (5.35, 5.9), (4.8, 5.2)])
def test_edges_are_where_a_push_begins_and_ends(
    model: Model, start: float, end: float
) -> None:
    """Windows tell of a push where friction is known: a piece of it, or more."""
    rows = rows_at_few_speeds(model, 0.4)
    scene = rows.scenes[0]
    sigma = np.full(rows.n, 0.1)
    residual = sigma * np.random.default_rng(0).normal(size=scene.slides.shape)
    pushed = (scene.motion.t > 5.0) & (scene.motion.t < 5.5)
    residual[pushed, 1] += 1.0
    event = replace(PUSH, start=start, end=end)
    found = with_edges(event, rows, residual, sigma)
    assert found.start == pytest.approx(5.0, abs=0.02)
    assert found.end == pytest.approx(5.5, abs=0.02)


def test_windows_tell_the_edges_where_most_samples_count(model: Model) -> None:
    rows = rows_at_few_speeds(model, 0.9)
    residual = np.ones_like(rows.scenes[0].motion.q)
    assert with_edges(PUSH, rows, residual, np.full(rows.n, 0.1)) == PUSH


def test_an_event_that_its_joints_do_not_show_keeps_its_edges(model: Model) -> None:
    rows = rows_at_few_speeds(model, 0.0)
    rows.scenes[0].__dict__["slides"] = np.zeros_like(rows.scenes[0].slides)
    residual = np.ones_like(rows.scenes[0].motion.q)
    assert with_edges(PUSH, rows, residual, np.full(rows.n, 0.1)) == PUSH


@pytest.mark.parametrize(("between", "joins"), [(0.1, False), (0.9, True)])
def test_pieces_of_one_push_are_one(model: Model, between: float, joins: bool) -> None:
    """`between` is the share of the pieces' size that is left between them."""
    rows = rows_at_few_speeds(model, 1.0)
    residual = np.ones_like(rows.scenes[0].motion.q)
    t = rows.scenes[0].motion.t
    residual[(t > 5.3) & (t < 5.8)] = between
    pieces = [PUSH, replace(PUSH, start=5.8, end=6.0)]
    whole = replace(PUSH, end=6.0)
    joined = joined_pieces(pieces, rows.scenes, [residual, residual], 20.0)
    assert joined == ([whole] if joins else pieces)
    assert joined_pieces(pieces, rows.scenes, [residual, residual], 0.5) == pieces


def test_pieces_that_reach_into_each_other_are_one_push(model: Model) -> None:
    scenes = model.ground.stage.scenes
    residuals = [np.ones_like(scene.motion.q) for scene in scenes]
    residuals[0][(scenes[0].motion.t > 6.0) & (scenes[0].motion.t < 7.0)] = 0.0
    piece = replace(PUSH, start=4.0, end=6.0, joints=(0,), score=20.0)
    later = replace(PUSH, start=7.0, end=8.0)
    elsewhere = replace(PUSH, scene=1)
    whole = replace(PUSH, start=4.0, end=6.0, joints=(0, 1), score=20.0)
    pieces = [later, PUSH, elsewhere, piece]
    joined = joined_pieces(pieces, scenes, residuals, 20.0)
    assert joined == [whole, later, elsewhere]


def test_a_push_is_no_measure_of_the_few_windows_that_are_alike() -> None:
    """Another joint's load turns round at five moments, in one of them a push lasts
    for 0.4 s: a sixth of the windows of that class are the push's own.
    """
    rng = np.random.default_rng(0)
    centre = np.arange(0.1, 40.0, 0.04)
    moments = (6.0, 13.0, 20.0, 27.0, 34.0)
    nearest = np.min(np.abs(centre[:, None] - np.array(moments)), axis=1)
    turns = np.zeros((len(centre), 4), dtype=bool)
    turns[:, 3] = nearest < 0.3
    mean = rng.normal(size=(len(centre), 2))
    is_push = np.abs(centre - moments[2]) < 0.2
    mean[is_push, 0] += 100.0
    windows = Windows(
        length_s=0.15,
        scene=np.zeros(len(centre), dtype=np.intp),
        centre=centre,
        mean=mean,
        state=rng.normal(size=(len(centre), 8)),
        speed=np.ones((len(centre), 2)),
        reverses=turns,
        stretch=np.full(len(centre), -1),
    )
    z = scores(windows)[:, 0]
    assert np.all(z[is_push] > 5.0 * GATE)
    assert np.all(np.abs(z[~is_push]) < GATE)

    # What recurs wherever the load turns round is usual there.
    mean[nearest < 0.2, 0] += np.where(is_push, 0.0, 100.0)[nearest < 0.2]
    assert np.all(np.abs(scores(windows)) < GATE)
