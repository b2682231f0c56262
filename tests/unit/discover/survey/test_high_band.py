"""Above the cut-off: ripples and lines that the low-pass would hide."""

import numpy as np
import pytest

from seqid_cli.discover.select.rows import ColumnGroup
from seqid_cli.discover.survey.high_band import high_band
from seqid_cli.discover.survey.rows import rows_of
from tests.unit.discover.arms import arm_scenes, at_joint, measuring, selected

LINE_HZ, LINE = 50.0, 0.4  # Hz, N m
ORDER, RIPPLE = 3.0, 0.25  # cycles per motor turn, N m
JOINT = 1


def test_a_line_above_the_cutoff_is_found() -> None:
    line = at_joint(JOINT, lambda s: LINE * np.sin(2 * np.pi * LINE_HZ * s.time + 0.7))
    found = selected(arm_scenes(line), ["periodic_disturbance"])
    (taken,) = found.terms
    assert taken.term.joint == JOINT
    assert taken.term.what.settings["frequency"] == pytest.approx(LINE_HZ, abs=2e-3)
    assert np.hypot(*taken.scored.fit.coefficients) == pytest.approx(LINE, rel=0.05)
    before, after = (
        sum(w @ r**2 for w, r in zip(found.model.noise.weight, left, strict=True))
        for left in (taken.left_without, found.model.linear.left_out)
    )
    assert taken.scored.score.share == pytest.approx(1.0 - after / before, abs=0.15)


def test_a_ripple_is_found_below_and_above_the_cutoff() -> None:
    """At slow speeds it lies in the band, at fast ones above; one order and size for
    both.
    """
    ripple = at_joint(
        JOINT, lambda s: RIPPLE * np.cos(ORDER * s.gear[JOINT] * s.motion.q[:, JOINT])
    )
    found = selected(arm_scenes(ripple), ["torque_ripple"])
    (taken,) = found.terms
    term, beside = taken.term, found.model.beside(taken.term)
    assert term.joint == JOINT
    assert term.what.settings["order"] == pytest.approx(ORDER, abs=1e-2)
    assert term.what.settings["law"] == 0.0
    assert taken.scored.fit.coefficients == pytest.approx([0.0, RIPPLE], abs=0.03)
    for high in (False, True):
        columns = {j: X for j, X in term.part.columns.items() if (j > 1) == high}
        (gained,) = beside.fits(
            [ColumnGroup(columns=columns, precision=term.part.precision)]
        )
        assert gained.coefficients[1] == pytest.approx(RIPPLE, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_white_noise_has_no_line(seed: int) -> None:
    names = ["periodic_disturbance", "torque_ripple"]
    assert selected(arm_scenes(seed=seed), names).terms == ()


def test_a_stop_from_full_speed_is_no_row_above_the_cutoff() -> None:
    """A jolt in the measured torque, with what the low-pass makes of it around, is left
    out.
    """
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
