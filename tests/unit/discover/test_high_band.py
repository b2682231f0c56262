"""Above the cut-off: ripples and lines that the low-pass would hide."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.candidates import Candidate, candidates_of
from seqid_cli.discover.select.results import Selected
from seqid_cli.discover.select.rows import Part
from seqid_cli.discover.select.selection import select
from seqid_cli.discover.survey.high_band import both_bands, full_residual, high_band
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from tests.unit.discover.arms import Extra, arm_scenes, at_joint, ground_of, measuring
from tests.unit.model.effects.scenes import CUTOFF_HZ

Array = NDArray[np.float64]

LINE_HZ, LINE = 50.0, 0.4  # Hz, N m
ORDER, RIPPLE = 3.0, 0.25  # cycles per motor turn, N m
JOINT = 1


def line(scene: Scene) -> Array:
    return LINE * np.sin(2 * np.pi * LINE_HZ * scene.time + 0.7)


def ripple(scene: Scene) -> Array:
    return RIPPLE * np.cos(ORDER * scene.gear[JOINT] * scene.motion.q[:, JOINT])


def found_of(extra: Extra | None, *names: str, seed: int = 0) -> Selected:
    ground = ground_of(arm_scenes(extra, seed=seed))
    return select(ground, None, [CATALOGUE[name] for name in names]).told()


def test_a_line_above_the_cutoff_is_found() -> None:
    found = found_of(at_joint(JOINT, line), "periodic_disturbance")
    (taken,) = found.taken
    what = taken.term.what
    assert isinstance(what, Candidate)
    assert what.joint == JOINT
    assert what.settings["frequency"] == pytest.approx(LINE_HZ, abs=2e-3)
    amplitude = np.hypot(*taken.one.gained.coefficients)
    assert float(amplitude) == pytest.approx(LINE, rel=0.05)
    weight, after = found.model.noise.weight, found.model.linear.left_out
    left = [
        sum(float(w @ r**2) for w, r in zip(weight, x, strict=True)) for x in (taken.left, after)
    ]
    assert taken.one.predicted.share == pytest.approx(1.0 - left[1] / left[0], abs=0.15)


def test_a_ripple_is_found_below_and_above_the_cutoff() -> None:
    """At slow speeds it lies in the band, at fast ones above; one order and size for both."""
    found = found_of(at_joint(JOINT, ripple), "torque_ripple")
    (taken,) = found.taken
    what = taken.term.what
    assert isinstance(what, Candidate)
    assert what.joint == JOINT
    assert what.settings["order"] == pytest.approx(ORDER, abs=1e-2)
    assert what.settings["law"] == 0.0
    a, b = taken.one.gained.coefficients
    assert (a, b) == (pytest.approx(0.0, abs=0.03), pytest.approx(RIPPLE, abs=0.03))
    beside = found.model.beside(taken.term)
    for some in (
        {j for j in taken.term.channels if j < 2},
        {j for j in taken.term.channels if j > 1},
    ):
        columns = {j: taken.term.part.columns[j] for j in some}
        (gained,) = beside.gained([Part(columns, taken.term.part.precision)])
        assert gained.coefficients[1] == pytest.approx(RIPPLE, rel=0.25)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_white_noise_has_no_line(seed: int) -> None:
    assert found_of(None, "periodic_disturbance", "torque_ripple", seed=seed).taken == ()


def test_a_stop_from_full_speed_is_no_row_above_the_cutoff() -> None:
    """A jolt in the measured torque, with what the low-pass makes of it around, is left out."""
    (scene,) = arm_scenes(logs=1)
    assert scene.measured is not None
    usual = high_band(rows_of([scene]))
    counted = np.flatnonzero(usual.used[0][:, JOINT])
    at = int(counted[len(counted) // 2])
    jolted = scene.measured.copy()
    jolted[at : at + 10, JOINT] += 200.0
    left = high_band(rows_of([measuring(scene, jolted)]))
    assert not left.used[0][at - 10 : at + 20, JOINT].any()
    assert left.used[0][:, JOINT].sum() > 0.8 * usual.used[0][:, JOINT].sum()
    assert np.abs(left.y[JOINT]).max() < 5.0


def test_bands_add_up_to_the_columns() -> None:
    scenes = arm_scenes(logs=2, seconds=8.0)
    rows = rows_of(scenes)
    high = high_band(rows)
    per_scene = [{JOINT: scene.motion.dq[:, :1] ** 2} for scene in scenes]
    found = both_bands(rows, high, per_scene)
    assert set(found) == {JOINT, rows.n + JOINT}
    low = [
        scene.motion.filtered(x[JOINT], times=2) for scene, x in zip(scenes, per_scene, strict=True)
    ]
    rest = [x[JOINT] - y for x, y in zip(per_scene, low, strict=True)]
    np.testing.assert_allclose(found[JOINT], rows.torque(JOINT, low), atol=1e-9)
    np.testing.assert_allclose(found[rows.n + JOINT], high.of(JOINT, rest), atol=1e-9)


def test_a_log_below_the_cutoff_counts_beside_logs_above_it() -> None:
    """Each log says for itself whether a column shows in its rows below the cut-off."""
    slow, fast = arm_scenes(logs=2, seconds=8.0)
    rows = rows_of([slow, fast])
    phase = 2 * np.pi * LINE_HZ
    columns = [np.sin(0.02 * phase * slow.time)[:, None], 9.0 * np.sin(phase * fast.time)[:, None]]
    found = both_bands(rows, high_band(rows), [{JOINT: X} for X in columns])
    low = [slow.motion.filtered(columns[0], times=2), np.zeros_like(columns[1])]
    np.testing.assert_allclose(found[JOINT], rows.torque(JOINT, low), atol=1e-9)
    assert np.abs(found[JOINT]).max() > 0.5


def test_what_is_measured_above_the_cutoff() -> None:
    """A line there is all of it; one far below the cut-off is none."""
    scenes = arm_scenes(at_joint(JOINT, line), logs=1)
    rows = rows_of(scenes)
    high = high_band(rows)
    phase = 2 * np.pi * LINE_HZ * scenes[0].time
    waves = high.of(JOINT, [np.stack([np.sin(phase), np.cos(phase)], axis=1)])
    c = np.linalg.lstsq(waves, high.y[JOINT], rcond=None)[0]
    assert float(np.hypot(*c)) == pytest.approx(LINE, rel=0.1)
    assert np.std(high.y[0]) == pytest.approx(0.3, rel=0.15)  # the noise, and steps of friction
    assert high.weight[JOINT] == pytest.approx(np.sqrt(len(high.y[JOINT]) / rows.count(JOINT)))
    assert len(high.block[JOINT]) == len(high.y[JOINT])


def test_rows_above_the_cutoff_are_those_of_the_kept_blocks() -> None:
    scenes = arm_scenes(logs=1)
    events = [np.zeros(scenes[0].samples, dtype=bool)]
    rows = rows_of(scenes)
    high = high_band(rows)
    picked = np.flatnonzero(high.used[0][:, 0])
    own = np.searchsorted(rows.picked[0], picked, side="right") - 1
    np.testing.assert_array_equal(high.block[0], rows.block[0][own])
    assert not high.used[0][~scenes[0].motion.usable].any()
    assert events[0].shape == (scenes[0].samples,)


def test_the_residual_that_wide_effects_see() -> None:
    scenes = arm_scenes(at_joint(JOINT, line), logs=1)
    left = np.full((scenes[0].samples, 2), 0.1)
    full = full_residual(scenes[0], left)
    usable = scenes[0].motion.usable
    assert np.all(full[~usable] == 0.0)
    slow = scenes[0].motion.filtered(full, times=2)
    middle = slice(500, -500)
    np.testing.assert_allclose(np.median(slow[middle], axis=0), 0.1, atol=0.01)
    assert np.std(full[usable, JOINT]) > 0.9 * LINE / np.sqrt(2)
    assert LINE_HZ > 2 * CUTOFF_HZ


def test_wide_candidates_are_looked_for_at_the_logs_own_rate() -> None:
    scenes = arm_scenes(at_joint(JOINT, line))
    left = [np.zeros_like(scene.motion.q) for scene in scenes]
    found = list(candidates_of(scenes, [CATALOGUE["periodic_disturbance"]], left))
    lines = {c.settings["frequency"] for c in found if c.joint == JOINT}
    assert any(abs(f - LINE_HZ) < 2e-3 for f in lines)
    near = candidates_of(scenes, [CATALOGUE["periodic_disturbance"]], left, near=[0])
    assert all(c.joint == 0 for c in near)
