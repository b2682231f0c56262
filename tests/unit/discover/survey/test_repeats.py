"""Which motion comes again, and how much of what is left does."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.select.noise import Moments
from seqid_cli.discover.survey.repeats import BLOCK_S, FEWEST_BLOCKS, blocks_of
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.scene import Scene
from seqid_cli.typing import Index
from tests import Array
from tests.unit.effects.scenes import RATE_HZ, scene_of, wander

PERIOD_S = 7.3


def series(seconds: float, *, begin_s: float = 0.0, seed: int = 0) -> Array:
    """Two joints that go as Fourier series of one period, from some time on."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (np.arange(seconds * RATE_HZ) / RATE_HZ + begin_s) / PERIOD_S
    order = np.arange(1, 5)
    size = rng.uniform(0.3, 1.0, (2, 4)) / order
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 4))
    waves = np.sin(order * angle[:, None, None] + phase)
    return np.asarray(np.sum(size * waves, axis=-1))


def phase_of(begin_s: float, scene: Scene) -> Array:
    """Return which share of the period has gone at each sample."""
    return np.asarray(np.mod((scene.motion.t + begin_s) / PERIOD_S, 1.0))


def spread_of_groups(
    scenes: list[Scene], phases: list[Array], groups: list[Index]
) -> float:
    """Return the largest part of the period that a group of blocks extends over."""
    phase = np.concatenate(phases)
    group = np.concatenate(groups)
    widths = []
    for number in np.unique(group):
        angle = 2.0 * np.pi * phase[group == number]
        middle = np.angle(np.mean(np.exp(1j * angle)))
        off = np.angle(np.exp(1j * (angle - middle))) / (2.0 * np.pi)
        widths.append(float(np.ptp(off)))
    return max(widths)


def test_blocks_of_a_series_are_groups_by_its_phase() -> None:
    scene = scene_of(series(40.0))
    (blocks,) = blocks_of([scene])
    n_groups = len(np.unique(blocks.group))
    assert n_groups == FEWEST_BLOCKS
    group = blocks.group[blocks.number]
    width = spread_of_groups([scene], [phase_of(0.0, scene)], [group])
    assert width == pytest.approx(1.0 / n_groups, abs=0.02)


def test_another_log_of_the_same_series_has_the_same_groups() -> None:
    """Both are too short to show the period by themselves."""
    begins_s = (0.0, 2.9, 5.1)
    scenes = [
        scene_of(series(8.5, begin_s=begin_s), log=number)
        for number, begin_s in enumerate(begins_s)
    ]
    groups = [blocks.group[blocks.number] for blocks in blocks_of(scenes)]
    for other in groups[1:]:
        assert len(np.intersect1d(groups[0], other)) >= 3
    phases = [
        phase_of(begin_s, scene)
        for begin_s, scene in zip(begins_s, scenes, strict=True)
    ]
    # From the first log on, without a period: what is a period later is another part.
    assert spread_of_groups(scenes, phases, groups) < 2.0 * BLOCK_S / PERIOD_S


def test_a_motion_that_never_comes_again_has_a_group_for_every_block() -> None:
    scenes = [scene_of(wander(20.0, seed=seed), log=seed) for seed in (0, 1)]
    first, second = blocks_of(scenes)
    groups = np.concatenate([first.group, second.group])
    np.testing.assert_array_equal(groups, np.arange(len(groups)))
    assert len(first.group) == round(20.0 / BLOCK_S)
    moments = np.concatenate([first.moment, second.moment])
    assert len(np.unique(moments)) == len(moments)


def test_the_same_move_elsewhere_is_another_motion() -> None:
    """Gravity is another one there."""
    q = wander(20.0, seed=3)
    elsewhere = q + np.array([1.5, 0.0])
    first, second = blocks_of([scene_of(q), scene_of(elsewhere, log=1)])
    assert not np.intersect1d(first.group, second.group).size


def test_a_joint_that_does_something_else_makes_another_motion() -> None:
    q = series(30.0)
    q[:, 1] = wander(30.0, seed=4)[: len(q), 1]
    (blocks,) = blocks_of([scene_of(q)])
    assert len(np.unique(blocks.group)) == len(blocks.group)


def test_rows_of_a_series_are_in_several_folds() -> None:
    rows = rows_of([scene_of(series(40.0))])
    folds = np.unique(rows.fold)
    assert len(folds) >= 3
    for fold in folds:
        assert len(np.unique(rows.group[rows.fold == fold])) >= 1
    assert all(rows.count(joint) > 100 for joint in range(2))
    # A group is in one fold.
    of_group = {
        int(group): set(rows.fold[rows.group == group].tolist())
        for group in np.unique(rows.group)
    }
    assert all(len(folds) == 1 for folds in of_group.values())


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_the_share_that_comes_again_is_told(share: float) -> None:
    """Twelve times 400 moments; so much of the variance is the same each time."""
    rng = np.random.default_rng(5)
    times, moments = 12, 400
    again = np.tile(rng.standard_normal(moments), times)
    new = rng.standard_normal(times * moments)
    r = np.sqrt(share) * again + np.sqrt(1.0 - share) * new
    number = np.tile(np.arange(moments), times)
    told = Moments.of(number, np.zeros_like(number)).share_again(r)
    assert told == pytest.approx(share, abs=0.03)


def test_of_moments_that_are_there_once_nothing_comes_again() -> None:
    r = np.random.default_rng(6).standard_normal(300)
    number = np.arange(300)
    moments = Moments.of(number, np.zeros_like(number))
    assert moments.share_again(r) == 0.0
    assert not moments.times_in_log.any()


def test_moments_of_two_logs_count_for_each_log_by_itself() -> None:
    """The first moment is there twice in one log and once in the other."""
    moments = Moments.of(np.array([7, 9, 7, 7, 11]), np.array([0, 0, 0, 1, 1]))
    np.testing.assert_array_equal(moments.times, [3, 1, 1])
    of_rows = moments.times_in_log[moments.in_log]
    np.testing.assert_allclose(of_rows, [1.5, 0.0, 1.5, 3.0, 0.0])


def test_scenes_that_rest_have_groups_of_their_own() -> None:
    q = np.zeros((int(10.0 * RATE_HZ), 2))
    scene = scene_of(q)
    (blocks,) = blocks_of([replace(scene)])
    assert len(np.unique(blocks.group)) == len(blocks.group)
