"""Rows: which samples count, how they are filtered, and how they are split."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from seqid_cli.discover.survey.reversals import reversals_of
from seqid_cli.discover.survey.rows import (
    FOLDS,
    TOGETHER,
    Rows,
    extrapolated,
    rows_of,
)
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.friction import SLIDES
from seqid_cli.model.torque import sliding
from seqid_cli.motion.filters.differentiation import runs
from tests import Array
from tests.plants.robots.two_joint import COULOMB, friction_surface
from tests.unit.discover.arms import arm_scenes, at_joint
from tests.unit.model.effects.scenes import RATE_HZ, scene_of, wander


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return arm_scenes(logs=3)


@pytest.fixture(scope="module")
def rows(scenes: list[Scene]) -> Rows:
    return rows_of(scenes)


@pytest.mark.parametrize("passes", [1, 2])
def test_rows_are_filtered_as_the_motion_is(scenes: list[Scene], rows: Rows, passes: int) -> None:
    rng = np.random.default_rng(4)
    for number, scene in enumerate(scenes):
        steps = np.sign(rng.normal(size=(scene.samples, TOGETHER + 3)))
        expected = scene.motion.filtered(steps, times=passes)[rows.picked[number]]
        found = rows.filtered(number, steps, passes)
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_only_samples_at_which_a_joint_slides_count(scenes: list[Scene], rows: Rows) -> None:
    for scene, at, used in zip(scenes, rows.picked, rows.used, strict=True):
        np.testing.assert_array_equal(used, sliding(scene.motion, SLIDES * scene.sign_width)[at])
        assert 0.5 < used.mean() < 1.0
        assert not np.any(used[~scene.motion.usable[at]])


def test_folds_are_contiguous_and_cover_every_log(rows: Rows) -> None:
    first = 0
    for block in rows.block:
        np.testing.assert_array_equal(np.unique(block), np.arange(first, block[-1] + 1))
        first = block[-1] + 1
        assert len(np.unique(rows.fold[block])) >= 2
    assert first == len(rows.fold)
    assert set(np.diff(rows.fold)) <= {0, 1}
    assert abs(rows.fold[-1] + 1 - FOLDS) <= len(rows.block)
    # No fold reaches over the end of a log.
    ends = [rows.fold[block[[0, -1]]] for block in rows.block]
    assert all(after[0] == before[1] + 1 for before, after in pairwise(ends))


def test_very_long_logs_are_thinned_by_whole_blocks(
    scenes: list[Scene], rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("seqid_cli.discover.survey.rows.MOST_ROWS", 1200)
    few = rows_of(scenes)
    for whole, thin, own in zip(rows.block, few.block, few.picked, strict=True):
        assert set(thin) < set(whole)
        for block in np.unique(thin):
            assert np.sum(thin == block) == np.sum(whole == block)
        assert len(own) == len(thin)
    assert sum(map(len, few.picked)) < 0.6 * sum(map(len, rows.picked))


def test_a_single_move_of_a_joint_does_not_count() -> None:
    q = wander(30.0, seed=2)
    settled = int(1.5 * RATE_HZ)
    q[settled:, 1] = q[settled, 1]
    alone = rows_of([scene_of(q)])
    both = rows_of([scene_of(wander(30.0, seed=1)), scene_of(q, log=1)])
    only = rows_of([scene_of(np.column_stack([q[:, 1], q[:, 1]]))])
    assert not alone.used[0][:, 1].any()
    assert alone.used[0][:, 0].any()
    assert only.used[0][:, 1].any()  # there is nothing else to look at
    assert not both.used[1][:, 1].any()
    assert both.used[1][:, 0].any()
    assert both.used[0][:, 1].any()


def test_speeds_beyond_a_friction_curve_do_not_count() -> None:
    """Coulomb and viscous friction go on beyond; a curve of higher order is only held there."""
    scene = scene_of(wander(12.0))
    top = float(np.abs(scene.motion.dq[:, 0]).max())
    fast = np.abs(scene.motion.dq[:, 0]) > 0.6 * top
    for orders, counted in ((2, False), (1, True)):
        curve = friction_surface(2.0, 0.5, top=0.55 * top, order=orders, variance=1e-6)
        model = replace(scene.model, surfaces=(curve, scene.model.surfaces[1]))
        (beyond,) = extrapolated([replace(scene, model=model)])
        assert beyond[fast, 0].any() != counted
        assert beyond[fast, 0].all() != counted
        assert not beyond[:, 1].any()


def test_a_log_that_stays_beyond_a_friction_curve_does_not_count_beside_others() -> None:
    """Where one log alone is there, the curve is all there is."""
    usual = scene_of(wander(12.0))
    v = usual.motion.dq[:, 0]
    top = 1.1 * float(np.abs(v).max())
    curve = friction_surface(2.0, 0.5, top=top, order=2, variance=1e-6)
    model = replace(usual.model, surfaces=(curve, usual.model.surfaces[1]))
    usual = replace(usual, model=model)
    fast = replace(usual, motion=replace(usual.motion, dq=9.0 * usual.motion.dq))
    beside = extrapolated([usual, usual, fast])
    assert beside[2][:, 0].mean() > 0.6
    assert not beside[2][:, 1].any()
    assert not beside[0].any()
    assert not extrapolated([fast])[0].any()


JOINT = 0
LATE, TAKES = 0.05, 0.6  # friction at a reversal, of the time for which it may stick
LITTLE = (0.01, 0.01)  # N m, of noise


def sticking(scene: Scene) -> Array:
    """Return what friction (N,) N m lacks of a joint that sticks a while where it turns back."""
    rng = np.random.default_rng(scene.log)
    t, v = scene.motion.t, scene.motion.dq[:, JOINT]
    lacks = np.zeros(len(t))
    for start, stop in runs(~scene.slides[:, JOINT], len(t)):
        for at in start + np.flatnonzero(v[start : stop - 1] * v[start + 1 : stop] < 0):
            since = t[start:stop] - t[at] - (t[1] - t[0]) * v[at] / (v[at] - v[at + 1])
            slow = t[stop - 1] - t[start]
            ramp = np.clip(2.0 * (since / slow - LATE * rng.normal()) / TAKES, -1.0, 1.0)
            change = COULOMB[JOINT] * np.sign(v[at + 1])
            lacks[start:stop] += change * (ramp - np.sign(since))
    return lacks


def torque_of(scenes: list[Scene], rows: Rows) -> tuple[Array, Array]:
    """Return what the model leaves (M,) N m: as it is, and whitened."""
    left = []
    for scene in scenes:
        left.append((scene.motion.tau - scene.modelled_filtered)[:, JOINT])
    return rows.of(JOINT, left), rows.torque(JOINT, left)


def size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_sticking_is_left_to_nobody() -> None:
    clean = arm_scenes(noise=LITTLE)
    rough = arm_scenes(at_joint(JOINT, sticking), noise=LITTLE)
    rows = rows_of(clean)
    noise = np.random.default_rng(0).normal(size=rows.count(JOINT))
    without, sticks = torque_of(clean, rows), torque_of(rough, rows)
    as_it_is, whitened = (size(b - a) for a, b in zip(without, sticks, strict=True))
    assert as_it_is > 0.05
    assert whitened < 0.5 * as_it_is
    assert size(rows.whitened(JOINT, noise)) > 0.9 * size(noise)


def test_what_is_large_beside_a_reversal_is_still_seen() -> None:
    """A torque that rises with speed has its rows away from reversals."""
    scenes = arm_scenes()
    rows = rows_of(scenes)
    drag = [s.motion.filtered(s.motion.dq * np.abs(s.motion.dq))[:, JOINT] for s in scenes]
    assert size(rows.torque(JOINT, drag)) > 0.95 * size(rows.of(JOINT, drag))


@pytest.mark.parametrize("mirrored", [False, True])
def test_rests_at_either_end_of_a_log_are_uncertain(*, mirrored: bool) -> None:
    scenes = arm_scenes(logs=1)
    rows = rows_of(scenes)
    used = rows.used[0][:, JOINT].copy()
    order = used[::-1] if mirrored else used
    edge = int(np.flatnonzero(order)[0])
    found = reversals_of(scenes[0], rows.picked[0], used, JOINT)
    number = int(used.sum()) - 1 if mirrored else 0
    felt = any(t.first <= number < t.first + len(t.directions) for t in found)
    assert felt == (edge > 0)
