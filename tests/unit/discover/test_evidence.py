"""Evidence of findings: residuals over what an effect goes with, and why rivals were not taken."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from seqid_cli.discover.diagnosis import described
from seqid_cli.discover.investigate import investigate
from seqid_cli.discover.select.rows import ALIKE
from seqid_cli.params.evidence_schema import EvidenceEntry
from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry
from tests.unit.discover.test_diagnose import OPTIONS, clean, given, plain

pytestmark = pytest.mark.slow

ELBOW = 1


@lru_cache(maxsize=4)
def planted(effect: str, joint: int = ELBOW) -> DiagnosisFile:
    return given((effect, joint, 1.0)).diagnosed()


def only(found: DiagnosisFile) -> tuple[FindingEntry, EvidenceEntry]:
    (finding,) = found.findings
    assert finding.evidence is not None
    return finding, finding.evidence


def flat(shown: EvidenceEntry) -> None:
    """Assert that nothing is left over the quantity: means within spreads, far below before."""
    after, before = np.array(shown.after), np.array(shown.before)
    assert np.all(np.abs(after) < np.array(shown.after_spread))
    assert np.std(after) < 0.1 * np.std(before)


def test_losses_under_load_are_shown_over_the_load() -> None:
    finding, shown = only(planted("load_dependent_friction"))
    assert (shown.joint, shown.quantity, shown.of) == ("elbow", "load", "elbow")
    assert shown.sided
    assert 20 <= len(shown.x) == len(shown.before) <= 60
    assert np.median(shown.count) >= 0.02 * sum(shown.count)
    assert np.all(np.diff(shown.x) >= 0.0)
    slope = np.polyfit(shown.x, shown.before, 1)[0]
    value = next(v for v in finding.parameters if v.name == "load_coefficient")
    assert np.corrcoef(shown.x, shown.before)[0, 1] > 0.95
    assert 0.5 < slope / value.value < 1.05  # some of it friction's own terms can take up
    flat(shown)
    plain(shown)
    joint = planted("load_dependent_friction").joints["elbow"]
    assert sum(shown.count) == joint.samples
    squares = np.square(shown.after) + np.square(shown.after_spread)
    assert np.sqrt(np.average(squares, weights=shown.count)) == pytest.approx(
        joint.rmse_explained, rel=1e-3
    )


def test_rivals_say_why_they_were_not_taken() -> None:
    finding, _ = only(planted("load_dependent_friction"))
    why = {rival.effect: rival.why_not for rival in finding.rivals}
    assert "gear_efficiency" in finding.confusable_with
    assert why["gear_efficiency"].startswith("these logs cannot tell the two apart")
    assert why["torque_saturation"].startswith("explains ")
    assert why["torque_saturation"].endswith(" less")
    assert "needs 12 parameters, not 1," in why["some function of load x direction"]
    assert finding.effect not in why
    gains = [rival.log_gain for rival in finding.rivals]
    assert gains == sorted(gains, reverse=True)
    less = next(r for r in finding.rivals if r.effect == "torque_saturation")
    told = float(less.why_not.split()[1])
    assert abs(told - 100.0 * (1.0 - less.log_gain / finding.log_gain)) < 0.1


def test_a_ripple_is_shown_over_its_own_wave() -> None:
    _, shown = only(planted("torque_ripple", 0))
    assert shown.quantity == "wave"
    assert 0.0 <= min(shown.x) < max(shown.x) <= 1.0
    sine, before = np.sin(2 * np.pi * np.array(shown.x)), np.array(shown.before)
    error = np.array(shown.before_spread) / np.sqrt(np.array(shown.count) / ALIKE)
    off = before - (sine @ before) / (sine @ sine) * sine
    assert np.mean((off / error) ** 2) < 1.5 < 0.3 * np.mean((before / error) ** 2)
    flat(shown)


def test_a_push_is_shown_over_time_and_nothing_comes_off() -> None:
    honest = clean()
    log = honest.logs[0]
    at = log.t[len(log.t) // 2]
    push = np.outer(np.exp(-(((log.t - at) / 0.1) ** 2)), [4.0, 0.0])
    pushed = replace(honest, logs=(replace(log, tau=log.tau + push), *honest.logs[1:]))
    _, shown = only(pushed.diagnosed())
    assert (shown.joint, shown.quantity) == ("shoulder", "time")
    assert (shown.after, shown.after_spread) == ([], [])
    assert abs(shown.x[int(np.argmax(shown.before))] - at) < 0.1
    assert max(shown.before) > 10.0 * abs(shown.before[0])


def test_what_is_left_is_shown_though_nothing_is_taken() -> None:
    logs = given(("backlash", ELBOW, 1.0))
    whole = investigate(logs.logs, logs.robot, logs.stages, OPTIONS)
    whole.model.terms.clear()
    whole.model.settle()
    found = described(replace(whole, found=replace(whole.found, taken=())), logs.robot)
    assert found.verdict == "unexplained"
    rest = next(one for one in found.unexplained if one.joint == "elbow")
    shown = rest.evidence
    assert shown.joint == "elbow"
    assert (shown.after, rest.rivals) == ([], [])
    elbow = found.joints["elbow"]
    spread = np.hypot(shown.before, shown.before_spread)
    assert np.sqrt(np.mean(spread**2)) > 2.0 * elbow.noise_floor


def test_what_was_tried_on_a_clean_arm_falls_short_of_what_is_asked() -> None:
    found = clean().diagnosed()
    every = [rival for joint in found.joints.values() for rival in joint.tried]
    assert every
    for rival in every:
        assert rival.why_not.endswith(("asked at least", "allowed at most", "than nothing does")), (
            rival
        )
