"""Above the cut-off: ripples and lines that the low-pass would hide."""

import numpy as np
import pytest

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.select.results import Selected
from seqid_cli.discover.select.rows import Part
from seqid_cli.discover.select.selection import select
from seqid_cli.discover.survey.high_band import both_bands, high_band
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import Extra, arm_scenes, at_joint, ground_of, measuring

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
