"""Rows: which samples count, how they are filtered, and how they are split."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.survey.rows import (
    Rows,
    extrapolated,
    rows_of,
)
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import runs
from tests import Array
from tests.plants.robots.two_joint import COULOMB, friction_surface
from tests.unit.discover.arms import arm_scenes, at_joint
from tests.unit.effects.scenes import RATE_HZ, scene_of, wander


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return arm_scenes(logs=3)


@pytest.fixture(scope="module")
def rows(scenes: list[Scene]) -> Rows:
    return rows_of(scenes)


def test_very_long_logs_are_thinned_by_whole_blocks(
    scenes: list[Scene], rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("seqid_cli.discover.survey.rows.MOST_ROWS", 1200)
    few = rows_of(scenes)
    for whole, thin, own in zip(rows.block, few.block, few.samples, strict=True):
        np.testing.assert_array_equal(thin, whole[np.isin(whole, thin)])
        assert len(own) == len(thin)
    assert sum(map(len, few.samples)) < 0.6 * sum(map(len, rows.samples))


def test_a_single_move_of_a_joint_does_not_count() -> None:
    q = wander(30.0, seed=2)
    settled = int(1.5 * RATE_HZ)
    q[settled:, 1] = q[settled, 1]
    alone, only, both = (
        [used.any(axis=0).tolist() for used in rows_of(scenes).used]
        for scenes in (
            [scene_of(q)],
            [scene_of(q[:, [1, 1]])],  # nothing of it can be left out and predicted
            [scene_of(wander(30.0, seed=1)), scene_of(q, log=1)],
        )
    )
    assert alone == [[True, False]]
    assert only == [[False, False]]
    assert both == [[True, True], [True, False]]


def known_up_to(top: float, scene: Scene, order: int) -> Scene:
    """The scene with friction of the first joint from a curve that ends at a speed."""
    curve = friction_surface(2.0, 0.5, top=top, order=order, variance=1e-6)
    return replace(
        scene, model=replace(scene.model, surfaces=(curve, scene.model.surfaces[1]))
    )


def test_speeds_beyond_a_friction_curve_do_not_count() -> None:
    """Coulomb and viscous friction go on beyond; a curve of higher order is only held
    there.
    """
    scene = scene_of(wander(12.0))
    speed = np.abs(scene.motion.dq[:, 0])
    for order in (1, 2):
        (beyond,) = extrapolated([known_up_to(0.55 * float(speed.max()), scene, order)])
        assert np.all(beyond[speed > 0.6 * speed.max(), 0] == (order > 1))
        assert not beyond[:, 1].any()


def test_a_log_that_stays_beyond_a_friction_curve_does_not_count_beside_others() -> (
    None
):
    """Where one log alone is there, the curve is all there is."""
    usual = scene_of(wander(12.0))
    usual = known_up_to(1.1 * float(np.abs(usual.motion.dq[:, 0]).max()), usual, 2)
    fast = replace(usual, motion=replace(usual.motion, dq=9.0 * usual.motion.dq))
    beside = extrapolated([usual, usual, fast])
    assert beside[2][:, 0].mean() > 0.6
    assert not beside[2][:, 1].any()
    assert not beside[0].any()
    assert not extrapolated([fast])[0].any()


JOINT = 0
LATE, TAKES = 0.05, 0.6  # friction at a reversal, of the time for which it may stick


def sticking(scene: Scene) -> Array:
    """Return what friction (N,) N m lacks of a joint that sticks a while where it turns
    back.
    """
    rng = np.random.default_rng(scene.log)
    t, v = scene.motion.t, scene.motion.dq[:, JOINT]
    lacks = np.zeros(len(t))
    for start, stop in runs(~scene.slides[:, JOINT], len(t)):
        for at in start + np.flatnonzero(v[start : stop - 1] * v[start + 1 : stop] < 0):
            since = t[start:stop] - t[at] - (t[1] - t[0]) * v[at] / (v[at] - v[at + 1])
            slow = t[stop - 1] - t[start]
            ramp = np.clip(
                2.0 * (since / slow - LATE * rng.normal()) / TAKES, -1.0, 1.0
            )
            change = COULOMB[JOINT] * np.sign(v[at + 1])
            lacks[start:stop] += change * (ramp - np.sign(since))
    return lacks


def size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_sticking_is_left_to_nobody() -> None:
    """As it is it shows; whitened it counts little, and noise as before."""
    clean, rough = (
        arm_scenes(x, noise=(0.01, 0.01)) for x in (None, at_joint(JOINT, sticking))
    )
    rows = rows_of(clean)
    sticks = [
        (b.motion.tau - a.motion.tau)[:, JOINT]
        for a, b in zip(clean, rough, strict=True)
    ]
    assert size(rows.of(JOINT, sticks)) > 0.05
    assert size(rows.torque(JOINT, sticks)) < 0.5 * size(rows.of(JOINT, sticks))
    noise = np.random.default_rng(0).normal(size=rows.count(JOINT))
    assert size(rows.whitened(JOINT, noise)) > 0.9 * size(noise)


def test_what_is_large_beside_a_reversal_is_still_seen(
    scenes: list[Scene], rows: Rows
) -> None:
    """A torque that rises with speed has its rows away from reversals."""
    drag = [
        s.motion.filtered(s.motion.dq * np.abs(s.motion.dq))[:, JOINT] for s in scenes
    ]
    assert size(rows.torque(JOINT, drag)) > 0.95 * size(rows.of(JOINT, drag))
