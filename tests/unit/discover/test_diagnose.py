"""Diagnosis from end to end on simulated logs of the two-joint arm."""

import re
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from seqid_cli.discover import verdict
from seqid_cli.discover.candidates import CandidateColumns
from seqid_cli.discover.diagnosis import described, diagnose
from seqid_cli.discover.investigate import (
    EventEnergies,
    Investigation,
    event_confidences,
    investigate,
)
from seqid_cli.discover.noise.floor import NoiseFloor
from seqid_cli.discover.notes import (
    detail_of,
    excess_residuals,
    expected,
    file_notes,
    outside_notes,
    slow_notes,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.select.model import SelectionProblem
from seqid_cli.discover.select.naming import NameConfidence
from seqid_cli.discover.select.rows import ALIKE
from seqid_cli.discover.settings import DiscoverSettings, EvidenceSettings
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.logs.recording import Recording
from seqid_cli.params.evidence_schema import EvidenceEntry
from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests.plants.cases import Case, declared_plant, injections, motions
from tests.plants.effects.friction import clear
from tests.plants.motions.trials import run_drill
from tests.plants.robots.identified import simultaneous
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.robots.two_joint import friction_surface

pytestmark = pytest.mark.slow

OPTIONS = DiscoverOptions()
RIG, SECONDS, SEED = "vertical_two_joint", 11.0, 1
HUMP = ("stribeck", 1, 1.0)


@dataclass(frozen=True)
class Given:
    logs: tuple[Recording, ...]
    robot: Robot
    stages: Stages

    def diagnosed(self) -> DiagnosisFile:
        """Diagnose all logs; JSON holds the document as it is, nothing is both found
        and hidden.
        """
        found = diagnose(self.logs, self.robot, self.stages, options=OPTIONS)
        assert (
            msgspec.json.decode(msgspec.json.encode(found), type=DiagnosisFile) == found
        )
        named = {(f.effect, f.joint) for f in found.findings}
        assert not named & {(h.effect, h.joint) for h in found.hidden}
        return found


@cache
def given(*effects: tuple[str, int, float]) -> Given:
    """Logs of the arm with effects that its robot file does not say, and the fit to
    them.
    """
    case = Case(RIG, SEED, effects, seconds=SECONDS)
    declared = declared_plant(case)
    plant = injections(case)[-1].plant if effects else declared
    chosen = [drill for drill in motions(case) if not drill.held_out]
    logs = tuple(
        recording_of(
            declared, drill.name, run_drill(plant, drill, 1000 * SEED + number)
        )
        for number, drill in enumerate(chosen)
    )
    robot = robot_of(RIG, declared)
    return Given(logs, robot, simultaneous(logs, robot))


@cache
def told(*effects: tuple[str, int, float]) -> tuple[DiagnosisFile, Investigation]:
    """What `diagnose` says, and what it has found before it says it."""
    kept: list[Investigation] = []

    def keeping(*given: object) -> Investigation:
        kept.append(investigate(*given))  # type: ignore[arg-type]
        return kept[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("seqid_cli.discover.diagnosis.investigate", keeping)
        found = given(*effects).diagnosed()
    return found, kept[-1]


def diagnosis(*effects: tuple[str, int, float]) -> DiagnosisFile:
    return told(*effects)[0]


def investigated(*effects: tuple[str, int, float]) -> Investigation:
    return told(*effects)[1]


def only(found: DiagnosisFile) -> tuple[FindingEntry, EvidenceEntry]:
    (finding,) = found.findings
    assert finding.evidence is not None
    return finding, finding.evidence


def flat(shown: EvidenceEntry) -> None:
    """Assert that nothing is left over the quantity: means within spreads, far below
    before.
    """
    after, before = np.array(shown.after), np.array(shown.before)
    assert np.all(np.abs(after) < np.array(shown.after_spread))
    assert np.std(after) < 0.1 * np.std(before)


def test_an_effect_is_found_at_its_joint_with_its_parameters() -> None:
    found, honest = diagnosis(HUMP), diagnosis()
    assert found.verdict == "effect_found"
    first, _ = only(found)
    assert (first.effect, first.joint) == ("stribeck", "elbow")
    assert min(first.confidence, first.explains) > 0.8
    assert first.gain > 0.5
    assert first.effect not in first.confusable_with
    assert "constant speeds" in first.separate_by
    plant = declared_plant(Case(RIG, SEED, (HUMP,)))
    (value,) = first.parameters
    assert (value.name, value.unit) == ("stribeck_torque", "N m")
    assert value.value == pytest.approx(clear(plant, 1, 1.0), rel=0.15)
    speed = 0.06 * plant.velocity_limits[1]
    assert first.settings["stribeck_speed"] == pytest.approx(speed, rel=0.25)
    assert first.settings["exponent"] == 2.0
    assert list(found.joints) == ["shoulder", "elbow"]
    (shoulder, elbow), before = found.joints.values(), honest.joints
    assert elbow.noise_floor < elbow.rmse_explained < 0.5 * elbow.rmse
    assert elbow.rmse_explained == pytest.approx(
        before["elbow"].rmse_explained, rel=0.5
    )
    assert elbow.samples > 500
    assert shoulder.rmse == pytest.approx(before["shoulder"].rmse, rel=0.2)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_diagnosis() -> None:
    short = replace(given(), logs=given().logs[:2])
    first, second = (
        msgspec.structs.replace(short.diagnosed(), created="") for _ in range(2)
    )
    assert first == second


def test_nothing_is_missing_where_nothing_is() -> None:
    found = diagnosis()
    said = (found.verdict, found.findings, found.unexplained, found.events)
    assert said == ("nothing_missing", [], [], [])
    assert found.hidden
    assert {h.effect for h in found.hidden} <= set(CATALOGUE)
    assert all(0.0 <= h.visible < 0.2 for h in found.hidden)
    tried = [rival.why_not for joint in found.joints.values() for rival in joint.tried]
    assert tried
    endings = ("asked at least", "allowed at most", "than nothing does")
    assert all(why.endswith(endings) for why in tried), tried


def test_what_no_effect_explains_is_said_to_depend_on_what_it_does() -> None:
    found = diagnosis(("outside.bump", 1, 1.0))
    assert found.verdict in {"unexplained", "effect_found"}
    rest = found.unexplained[0]
    assert (rest.joint, rest.depends_on[0]) == ("elbow", "position")
    assert rest.share > 0.3
    shown = rest.evidence
    assert (shown.joint, shown.of, shown.quantity) == ("elbow", "elbow", "position")
    assert np.ptp(shown.after) < 0.3 * np.ptp(shown.before)
    assert rest.closest.effect in {rival.effect for rival in rest.rivals}
    assert all(f.confidence < 0.7 for f in found.findings)


def test_a_push_is_an_event_and_shown_over_time_and_nothing_comes_off() -> None:
    log, *others = given().logs  # joints never rest in it
    at = log.t[len(log.t) // 2]
    push = np.outer(np.exp(-(((log.t - at) / 0.1) ** 2)), [4.0, 1.5])
    logs = (replace(log, tau=log.tau + push), *others)
    found = replace(given(), logs=logs).diagnosed()
    (event,) = found.events
    assert event.log == str(log.path)
    assert event.start < at < event.end < event.start + 2.0
    contact, shown = only(found)
    assert (contact.effect, contact.joint) == ("external_contact", None)
    assert contact.confidence > 0.5
    assert (shown.joint, shown.quantity) == ("shoulder", "time")
    assert (shown.after, shown.after_spread) == ([], [])
    assert abs(shown.x[int(np.argmax(shown.before))] - at) < 0.1
    assert max(shown.before) > 10.0 * abs(shown.before[0])


@cache
def held_push() -> Given:
    """Logs in one of which somebody leans on the arm for four seconds."""
    log, *others = given().logs
    inside = (log.t - log.t[0] > 3.5) & (log.t - log.t[0] < 7.5)
    push = np.outer(inside * (1.0 + 0.3 * np.sin(log.t)), [3.0, 1.2])
    return replace(given(), logs=(replace(log, tau=log.tau + push), *others))


def test_a_push_of_seconds_is_told_with_its_edges() -> None:
    found = held_push().diagnosed()
    (event,) = found.events
    assert event.joints == ["shoulder", "elbow"]
    assert event.start == pytest.approx(3.5, abs=0.3)
    assert event.end == pytest.approx(7.5, abs=0.3)
    contact, _ = only(found)
    assert contact.effect == "external_contact"
    assert contact.confidence > 0.9
    assert found.unexplained == []


def test_an_event_beside_a_larger_law_that_is_not_understood_is_not_sure() -> None:
    case = held_push()
    found = investigate(case.logs, case.robot, case.stages, OPTIONS)
    (sure,) = event_confidences(found)
    assert sure > 0.9

    residual = [100.0 * r for r in found.model.linear.left_out]
    function = SimpleNamespace(
        term=SimpleNamespace(smooth=True, channels=frozenset({0, 1})),
        left_without=residual,
    )
    beside = replace(found, selection=replace(found.selection, terms=[function]))
    (unsure,) = event_confidences(beside)
    assert unsure == pytest.approx(0.5 * sure, rel=0.2)
    assert unsure < OPTIONS.settings.evidence.min_confidence


def test_pieces_of_a_push_do_not_speak_against_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = held_push()
    found = investigate(case.logs, case.robot, case.stages, OPTIONS)
    (push,) = found.events
    middle = 0.5 * (push.start + push.end)
    pieces = (replace(push, end=middle - 0.2), replace(push, start=middle + 0.2))
    left = np.array([1.0, 1.0])
    none = np.zeros(2)
    monkeypatch.setattr(
        "seqid_cli.discover.investigate.event_energies",
        lambda told: EventEnergies(
            of_events=[6.0 / len(told.events)] * len(told.events),
            left=left,
            of_functions=none,
        ),
    )
    (whole,) = event_confidences(found)
    of_pieces = event_confidences(replace(found, events=pieces))
    assert of_pieces == pytest.approx([whole, whole], rel=1e-3)


def test_samples_of_events_that_are_not_told_go_back_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = held_push()
    unsure = [0.5]
    monkeypatch.setattr(
        "seqid_cli.discover.investigate.event_confidences",
        lambda found: unsure * len(found.events),
    )
    found = investigate(case.logs, case.robot, case.stages, OPTIONS)
    assert found.events == ()
    rows = found.ground.stage.rows
    assert [rows.count(joint) for joint in range(2)] == found.file_residual.samples
    said = described(found, case.robot)
    assert said.verdict != "nothing_missing"
    assert said.findings == [] or said.unexplained


def test_what_has_no_sure_name_is_unexplained_and_its_name_is_the_closest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unsure = NameConfidence(confidence=0.69, by_itself=0.4)
    monkeypatch.setattr("seqid_cli.discover.diagnosis.named", lambda *_, **__: unsure)
    said = described(investigated(HUMP), given(HUMP).robot)
    assert (said.verdict, said.findings) == ("unexplained", [])
    (part,) = said.unexplained
    assert (part.joint, part.closest.effect) == ("elbow", "stribeck")
    assert "velocity" in part.depends_on
    assert said.joints["elbow"].verdict == "unexplained"


def test_losses_are_shown_over_the_load_and_rivals_say_why_they_were_not_taken() -> (
    None
):
    found = diagnosis(("load_dependent_friction", 1, 1.0))
    finding, shown = only(found)
    assert (shown.joint, shown.quantity, shown.of, shown.sided) == (
        "elbow",
        "load",
        "elbow",
        True,
    )
    assert 20 <= len(shown.x) == len(shown.before) <= 60
    assert np.median(shown.count) >= 0.02 * sum(shown.count)
    assert np.all(np.diff(shown.x) >= 0.0)
    slope = np.polyfit(shown.x, shown.before, 1)[0]
    value = next(v for v in finding.parameters if v.name == "load_coefficient")
    assert np.corrcoef(shown.x, shown.before)[0, 1] > 0.95
    # some of it friction's own terms can take up
    assert 0.5 < slope / value.value < 1.05
    flat(shown)
    joint = found.joints["elbow"]
    assert sum(shown.count) == joint.samples
    squares = np.square(shown.after) + np.square(shown.after_spread)
    left = np.sqrt(np.average(squares, weights=shown.count))
    assert left == pytest.approx(joint.rmse_explained, rel=1e-3)

    why = {rival.effect: rival.why_not for rival in finding.rivals}
    assert "gear_efficiency" in finding.confusable_with
    assert why["gear_efficiency"].startswith("these logs cannot tell the two apart")
    assert "needs 12 parameters, not 1," in why["some function of load x direction"]
    assert finding.effect not in why
    gains = [rival.log_gain for rival in finding.rivals]
    assert gains == sorted(gains, reverse=True)
    told = re.fullmatch(r"explains (\S+) .* less", why["torque_saturation"])
    less = next(r.log_gain for r in finding.rivals if r.effect == "torque_saturation")
    assert float(told[1]) == pytest.approx(
        100.0 * (1.0 - less / finding.log_gain), abs=0.1
    )


def test_a_ripple_is_shown_over_its_own_wave() -> None:
    _, shown = only(diagnosis(("torque_ripple", 0, 1.0)))
    assert shown.quantity == "wave"
    assert 0.0 <= min(shown.x) < max(shown.x) <= 1.0
    sine, before = np.sin(2 * np.pi * np.array(shown.x)), np.array(shown.before)
    error = np.array(shown.before_spread) / np.sqrt(np.array(shown.count) / ALIKE)
    off = before - (sine @ before) / (sine @ sine) * sine
    assert np.mean((off / error) ** 2) < 1.5 < 0.3 * np.mean((before / error) ** 2)
    flat(shown)


@cache
def biased_short() -> DiagnosisFile:
    """A constant torque in logs of 18 s together: too short to see whether it lasts."""
    case = given(("torque_bias", 0, 1.0))
    few = tuple(part(log, 2.0, 8.0) for log in case.logs[:3])
    return Given(few, case.robot, simultaneous(few, case.robot)).diagnosed()


def part(log: Recording, start: float, end: float, every: int = 1) -> Recording:
    """A stretch of a log, of every so many samples."""
    at = slice(round(start * log.rate_hz), round(end * log.rate_hz), every)
    return replace(
        log,
        t=log.t[at] - log.t[at][0],
        **{name: getattr(log, name)[at] for name in ("q", "tau", "valid")},
        start=log.start + start,
        health=replace(log.health, rate_hz=log.rate_hz / every),
        temperature=None,
    )


def test_a_bias_that_the_file_has_taken_in_is_told_beside_what_it_looks_like() -> None:
    (first,) = biased_short().findings
    assert first.joint == "shoulder"
    assert {first.effect, *first.confusable_with} >= {"torque_bias", "spring"}
    assert first.name_confidence < 0.8 < first.confidence


def test_less_than_a_sample_between_torque_and_position_is_a_note() -> None:
    case = given()
    slow = tuple(part(log, 0.0, SECONDS, every=5) for log in case.logs)
    stages, notes = simultaneous(slow, case.robot), []
    for samples in (0.0, 0.4):  # of the second joint's torque
        logs = []
        for log in slow:
            at = np.arange(len(log.t), dtype=np.float64)
            late = np.interp(at - samples, at, log.tau[:, 1])
            logs.append(replace(log, tau=np.column_stack([log.tau[:, 0], late])))
        found = Given(tuple(logs), case.robot, stages).diagnosed()
        notes.append([note for note in found.notes if "late" in note])
    none, (note,) = notes
    assert none == []
    told = re.search(r"joint elbow: torque is (\S+) ms late", note)
    assert 3.0 < float(told[1]) < 6.0  # this arm's own is up to a millisecond


def test_what_is_told_is_a_setting() -> None:
    case = given(HUMP)
    usual = diagnosis(HUMP)
    evidence = EvidenceSettings(negligible_share=0.9, min_visible=1.0)
    options = replace(OPTIONS, settings=DiscoverSettings(evidence=evidence))
    blind = diagnose(case.logs, case.robot, case.stages, options=options)
    assert usual.findings
    assert not blind.findings
    assert len(blind.hidden) > len(usual.hidden)


def test_more_than_noise_is_said_and_shown_though_nothing_is_taken() -> None:
    """A hump that no effect is allowed to explain."""
    found = investigated(HUMP)
    assert excess_residuals(found, expected(found)) == {}
    model = copy(found.model)
    model.terms = []
    model.settle()
    bare = replace(found, selection=replace(found.selection, model=model, terms=()))
    said = described(bare, given(HUMP).robot)
    assert said.verdict == "unexplained"
    rest = next(one for one in said.unexplained if one.joint == "elbow")
    assert rest.depends_on
    assert (rest.evidence.joint, rest.evidence.after, rest.rivals) == ("elbow", [], [])
    assert any("elbow" in note and "account for" in note for note in said.notes)
    spread = np.hypot(rest.evidence.before, rest.evidence.before_spread)
    assert np.sqrt(np.mean(spread**2)) > 2.0 * said.joints["elbow"].noise_floor
    unknown = replace(found.floor, high=np.full(2, np.inf))  # as of too short logs
    assert excess_residuals(replace(bare, floor=unknown), expected(bare)) == {}


def test_a_floor_above_what_is_left_stands_and_is_called_doubtful() -> None:
    found, robot = investigated(), given().robot
    assert not any("doubtful" in note for note in described(found, robot).notes)
    above = np.array([0.5, 3.0]) * found.model.rms() / found.floor.low
    floor = NoiseFloor(
        *(above * x for x in (found.floor.rms, found.floor.low, found.floor.high))
    )
    said = described(replace(found, floor=floor), robot)
    (note,) = [note for note in said.notes if "doubtful" in note]
    assert note.startswith("joint elbow: ")
    with_detail = floor.with_detail(detail_of(found)).rms[1]
    assert said.joints["elbow"].noise_floor == pytest.approx(with_detail)
    assert said.joints["elbow"].rmse_explained < with_detail


def test_a_file_whose_values_do_not_hold_is_said_to_be_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the form of the model nothing is missing; and where it fits no better, noise
    is slow.
    """
    found, robot = investigated(), given().robot
    ordinary = expected(found)
    assert file_notes(found, robot, ordinary, ()) == ()
    (slow,) = file_notes(found, robot, ordinary * np.array([0.2, 1.0]), ())
    assert re.search("shoulder.*go with the motion", slow)

    shoulder, elbow = found.file_residual.residual
    # Of blocks that were left out the file is still the true one.
    monkeypatch.setattr(verdict, "predicted_worse", lambda *_: False)
    off = replace(
        found,
        file_residual=replace(found.file_residual, residual=(shoulder, 10.0 * elbow)),
    )
    said = described(off, robot)
    (changed,) = said.changed
    assert (said.verdict, changed.joint, changed.since) == (
        "values_changed",
        "elbow",
        None,
    )
    assert changed.rmse == pytest.approx(10.0 * found.file_rms[1])
    with_detail = found.floor.with_detail(detail_of(found)).rms[1]
    assert changed.floors == pytest.approx(changed.rmse / with_detail)
    assert changed.rmse_refitted == pytest.approx(found.model.rms()[1])
    assert said.joints["elbow"].rmse == changed.rmse
    assert not any("go with the motion" in note for note in said.notes)


def on(found: Investigation, ground: SelectionProblem) -> Investigation:
    """The same with its fitted model in other scenes, or beside another file."""
    model = copy(found.model)
    model.ground = ground
    return replace(found, selection=replace(found.selection, model=model))


def beyond_friction(
    found: Investigation, times: float, *, is_slower: bool = False
) -> Investigation:
    """Say that friction of the elbow was identified in half its range of speed alone.

    Beyond it, or below it with `is_slower`, the file leaves `times` what it does.
    """
    ground = found.ground
    rows, scene = ground.stage.rows, ground.stage.scenes[0]
    top = float(np.max([np.abs(s.motion.dq[:, 1]).max() for s in rows.scenes]))
    curve = friction_surface(1.0, 0.5, top=0.5 * top, order=2, variance=1e-6)
    if is_slower:
        scaling = replace(curve.scaling, speed=(0.5 * top, top))
        curve = replace(curve, scaling=scaling)
    model = replace(scene.model, surfaces=(scene.model.surfaces[0], curve))
    scenes = tuple(replace(s, model=model) for s in rows.scenes)
    whole = []
    for scene, part in zip(scenes, ground.base.scene_bases, strict=True):
        is_fast = np.abs(scene.motion.dq[:, 1:]) > 0.5 * top
        factor = np.where(is_fast != is_slower, times, 1.0)
        whole.append(replace(part, residual=part.residual * factor))
    stage = CandidateColumns(replace(rows, scenes=scenes))
    return on(
        found,
        replace(
            ground, stage=stage, base=replace(ground.base, scene_bases=tuple(whole))
        ),
    )


def test_what_is_left_beyond_the_identified_friction_is_said() -> None:
    found, robot = investigated(), given().robot
    ordinary = expected(found)
    for usual in (found, beyond_friction(found, 1.0)):
        assert outside_notes(usual, robot, ordinary) == ()
    (note,) = outside_notes(beyond_friction(found, 20.0), robot, ordinary)
    assert note.startswith("joint elbow: ")
    assert "friction was not identified" in note


def test_what_is_left_below_the_slowest_trial_is_said() -> None:
    found, robot = investigated(), given().robot
    ordinary = expected(found)
    for usual in (found, beyond_friction(found, 1.0, is_slower=True)):
        assert slow_notes(usual, robot, ordinary) == ()
    slow = beyond_friction(found, 20.0, is_slower=True)
    (note,) = slow_notes(slow, robot, ordinary)
    assert note.startswith("joint elbow: ")
    assert "identify friction with slower trials" in note
