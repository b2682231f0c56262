"""Diagnosis from end to end on simulated logs of the two-joint arm."""

import json
import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache

import msgspec
import numpy as np
import pytest

from seqid_cli.discover.candidates import Stage
from seqid_cli.discover.diagnosis import described, diagnose
from seqid_cli.discover.investigate import Investigation, investigate
from seqid_cli.discover.noise.floor import NoiseFloor
from seqid_cli.discover.notes import excess_residuals, expected, file_notes, outside_notes
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.select.model import Ground
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.cases import Case, declared_plant, injections, motions
from tests.plants.friction.laws import Extra, Stribeck
from tests.plants.motions.trials import run_drill
from tests.plants.robots.identified import simultaneous
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.robots.two_joint import friction_surface

pytestmark = pytest.mark.slow


OPTIONS = DiscoverOptions()
SECONDS = 11.0
RIG = "vertical_two_joint"


@dataclass(frozen=True)
class Given:
    """What a diagnosis starts from."""

    logs: tuple[Recording, ...]
    robot: Robot
    stages: Stages

    def diagnosed(self, options: DiscoverOptions = OPTIONS) -> DiagnosisFile:
        """Diagnose all logs."""
        return diagnose(self.logs, self.robot, self.stages, options=options)


def given(*effects: tuple[str, int, float], seed: int = 1, seconds: float = SECONDS) -> Given:
    """Logs of the arm with effects that its robot file does not say, and the fit to them."""
    case = Case(RIG, seed, effects, seconds=seconds)
    declared = declared_plant(case)
    plant = injections(case)[-1].plant if effects else declared
    chosen = [drill for drill in motions(case) if not drill.held_out]
    logs = tuple(
        recording_of(declared, drill.name, run_drill(plant, drill, 1000 * seed + number))
        for number, drill in enumerate(chosen)
    )
    robot = robot_of(RIG, declared)
    return Given(logs, robot, simultaneous(logs, robot))


@lru_cache(maxsize=4)
def clean() -> Given:
    return given()


@lru_cache(maxsize=4)
def clean_diagnosis() -> DiagnosisFile:
    return clean().diagnosed()


@lru_cache(maxsize=4)
def humped() -> Given:
    return given(("stribeck", 1, 1.0))


@lru_cache(maxsize=4)
def humped_diagnosis() -> DiagnosisFile:
    return humped().diagnosed()


def plain(value: object, where: str = "diagnosis") -> None:
    """Assert that JSON can hold a value as it is, without numpy's types."""
    if isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            plain(getattr(value, name), f"{where}.{name}")
    elif isinstance(value, Mapping):
        for key, item in value.items():
            assert type(key) is str, where
            plain(item, f"{where}[{key}]")
    elif isinstance(value, Sequence) and not isinstance(value, str):
        assert type(value) in {tuple, list}, where
        for number, item in enumerate(value):
            plain(item, f"{where}[{number}]")
    else:
        assert value is None or type(value) in {str, int, float, bool}, f"{where}: {type(value)}"
        json.dumps(value, allow_nan=False)


def test_an_effect_is_found_at_its_joint() -> None:
    found = humped_diagnosis()
    assert found.verdict == "effect_found"
    first = found.findings[0]
    assert (first.effect, first.joint) == ("stribeck", "elbow")
    assert first.confidence > 0.8
    assert first.explains > 0.8
    assert first.gain > 0.5
    assert first.effect not in first.confusable_with
    assert "constant speeds" in first.separate_by
    assert not [f for f in found.findings if f.joint == "shoulder"]


def test_its_parameters_are_those_that_were_put_in() -> None:
    (first,) = [f for f in humped_diagnosis().findings if f.effect == "stribeck"]
    law = injections(Case(RIG, 1, (("stribeck", 1, 1.0),)))[-1].plant.friction
    assert isinstance(law, Extra)
    assert isinstance(law.curve, Stribeck)
    (value,) = first.parameters
    assert (value.name, value.unit) == ("stribeck_torque", "N m")
    assert value.value == pytest.approx(law.curve.level, rel=0.15)
    assert first.settings["stribeck_speed"] == pytest.approx(law.curve.speed, rel=0.25)
    assert first.settings["exponent"] == 2.0


def test_residuals_before_after_and_floor() -> None:
    found, honest = humped_diagnosis(), clean_diagnosis()
    assert list(found.joints) == ["shoulder", "elbow"]
    elbow = found.joints["elbow"]
    assert elbow.noise_floor < elbow.rmse_explained < 0.5 * elbow.rmse
    assert elbow.rmse_explained == pytest.approx(honest.joints["elbow"].rmse_explained, rel=0.5)
    assert elbow.samples > 500
    shoulder, before = found.joints["shoulder"], honest.joints["shoulder"]
    assert shoulder.rmse == pytest.approx(before.rmse, rel=0.2)


def test_nothing_is_missing_where_nothing_is() -> None:
    found = clean_diagnosis()
    assert found.verdict == "nothing_missing"
    assert (found.findings, found.unexplained, found.events) == ([], [], [])
    assert {h.effect for h in found.hidden} <= set(CATALOGUE)
    assert all(0.0 <= h.visible < 0.2 for h in found.hidden)


def test_what_no_effect_explains_is_said_to_depend_on_what_it_does() -> None:
    found = given(("outside.bump", 1, 1.0)).diagnosed()
    assert found.verdict in {"unexplained", "effect_found"}
    rest = found.unexplained[0]
    assert rest.joint == "elbow"
    assert rest.depends_on[0] == "position"
    assert rest.share > 0.3
    shown = rest.evidence
    assert (shown.joint, shown.of, shown.quantity) == ("elbow", "elbow", "position")
    assert np.ptp(shown.after) < 0.3 * np.ptp(shown.before)
    assert rest.closest.effect in {rival.effect for rival in rest.rivals}
    assert all(f.confidence < 0.7 for f in found.findings)
    plain(found)


def test_the_same_seed_gives_the_same_diagnosis() -> None:
    short = replace(clean(), logs=clean().logs[:2])
    first, second = (msgspec.structs.replace(short.diagnosed(), created="") for _ in range(2))
    assert first == second


def test_a_push_is_an_event() -> None:
    honest = clean()
    log = honest.logs[0]  # joints never rest in it
    at = log.t[len(log.t) // 2]
    push = np.exp(-(((log.t - at) / 0.1) ** 2))
    pushed = replace(log, tau=log.tau + np.outer(push, [4.0, 1.5]))
    found = replace(honest, logs=(pushed, *honest.logs[1:])).diagnosed()
    (event,) = found.events
    assert event.log == str(log.path)
    assert event.start < at < event.end < event.start + 2.0
    assert [f.effect for f in found.findings] == ["external_contact"]
    (contact,) = found.findings
    assert contact.joint is None
    assert contact.confidence > 0.5
    plain(found)


@pytest.mark.parametrize("diagnosis", [humped_diagnosis, clean_diagnosis])
def test_everything_is_plain_and_finite(diagnosis: object) -> None:
    assert callable(diagnosis)
    plain(diagnosis())


@lru_cache(maxsize=1)
def biased_short() -> DiagnosisFile:
    """A constant torque in logs of 18 s together: too short to see whether it lasts."""
    logs = given(("torque_bias", 0, 1.0))
    few = tuple(part(log, 2.0, 8.0) for log in logs.logs[:3])
    return Given(few, logs.robot, simultaneous(few, logs.robot)).diagnosed()


def part(log: Recording, start: float, end: float, every: int = 1) -> Recording:
    """A stretch of a log, of every so many samples."""
    at = slice(round(start * log.rate_hz), round(end * log.rate_hz), every)
    return replace(
        log,
        t=log.t[at] - log.t[at][0],
        q=log.q[at],
        tau=log.tau[at],
        valid=log.valid[at],
        start=log.start + start,
        health=replace(log.health, rate_hz=log.rate_hz / every),
        temperature=None,
    )


def test_a_bias_that_the_file_has_taken_in_is_told_beside_what_it_looks_like() -> None:
    (first,) = biased_short().findings
    assert first.joint == "shoulder"
    assert {first.effect, *first.confusable_with} >= {"torque_bias", "spring"}
    assert first.name_confidence < 0.8 < first.confidence


def test_what_is_found_is_not_said_to_be_hidden() -> None:
    for found in (humped_diagnosis(), biased_short()):
        names = {(f.effect, f.joint) for f in found.findings}
        assert found.hidden
        assert not names & {(h.effect, h.joint) for h in found.hidden}


def test_less_than_a_sample_between_torque_and_position_is_a_note() -> None:
    logs = given()
    slow = tuple(part(log, 0.0, SECONDS, every=5) for log in logs.logs)
    late = tuple(
        replace(log, tau=np.column_stack([log.tau[:, 0], delayed(log.tau[:, 1], 0.4)]))
        for log in slow
        if log.tau is not None
    )
    stages = simultaneous(slow, logs.robot)
    assert not [n for n in Given(slow, logs.robot, stages).diagnosed().notes if "late" in n]
    (note,) = [n for n in Given(late, logs.robot, stages).diagnosed().notes if "late" in n]
    told = re.search(r"joint elbow: torque is (\S+) ms late", note)
    assert 3.0 < float(told[1]) < 6.0  # this arm's own is up to a millisecond


def delayed(x: Array, samples: float) -> Array:
    """A signal as it was a part of a sample earlier."""
    at = np.arange(len(x), dtype=np.float64)
    return np.interp(at - samples, at, x)


def test_what_noise_does_not_account_for_is_never_nothing() -> None:
    """A hump that no effect is allowed to explain."""
    logs = humped()
    found = investigate(logs.logs, logs.robot, logs.stages, OPTIONS)
    assert excess_residuals(found, expected(found)) == {}
    (taken,) = found.found.taken
    found.model.terms.remove(taken.term)
    found.model.settle()
    bare = replace(found, found=replace(found.found, taken=()))
    said = described(bare, logs.robot)
    assert said.verdict == "unexplained"
    assert said.unexplained[0].joint == "elbow"
    assert said.unexplained[0].depends_on
    assert any("elbow" in note and "account for" in note for note in said.notes)
    unknown = replace(found.floor, high=np.full(logs.robot.n, np.inf))  # as of too short logs
    assert excess_residuals(replace(bare, floor=unknown), expected(bare)) == {}


def test_a_floor_above_what_is_left_stands_and_is_called_doubtful() -> None:
    logs = clean()
    found = investigate(logs.logs, logs.robot, logs.stages, OPTIONS)
    assert not any("doubtful" in note for note in described(found, logs.robot).notes)
    times = np.array([0.5, 3.0])
    parts = (found.floor.rms, found.floor.low, found.floor.high)
    low = found.model.rms() / found.floor.low
    floor = NoiseFloor(*(times * part * low for part in parts))
    said = described(replace(found, floor=floor), logs.robot)
    (note,) = [note for note in said.notes if "doubtful" in note]
    assert note.startswith("joint elbow: ")
    assert said.joints["elbow"].noise_floor == floor.rms[1] > said.joints["elbow"].rmse_explained


def test_a_file_whose_values_do_not_hold_is_said_to_be_so() -> None:
    """Of the form of the model nothing is missing; and where it fits no better, noise is slow."""
    logs = clean()
    found = investigate(logs.logs, logs.robot, logs.stages, OPTIONS)
    ordinary = expected(found)
    assert file_notes(found, logs.robot, ordinary, ()) == ()
    start = found.start * np.array([1.0, 10.0])
    off = on(found, replace(found.ground, base=replace(found.ground.base, start=start)))
    (note,) = file_notes(off, logs.robot, ordinary, ())
    assert "elbow" in note
    assert "identify" in note
    assert file_notes(off, logs.robot, ordinary, ("elbow",)) == ()
    (slow,) = file_notes(found, logs.robot, ordinary * np.array([0.2, 1.0]), ())
    assert "shoulder" in slow
    assert "go with the motion" in slow


def on(found: Investigation, ground: Ground) -> Investigation:
    """The same with its fitted model in other scenes, or beside another file."""
    model = copy(found.model)
    model.ground = ground
    return replace(found, found=replace(found.found, model=model))


def beyond_friction(found: Investigation, times: float) -> Investigation:
    """Say that friction of the elbow was identified in half its range of speed alone.

    Beyond it the file leaves `times` what it does.
    """
    ground = found.ground
    rows, scene = ground.stage.rows, ground.stage.scenes[0]
    top = float(np.max([np.abs(s.motion.dq[:, 1]).max() for s in rows.scenes]))
    curve = friction_surface(1.0, 0.5, top=0.5 * top, order=2, variance=1e-6)
    model = replace(scene.model, surfaces=(scene.model.surfaces[0], curve))
    scenes = tuple(replace(s, model=model) for s in rows.scenes)
    whole = []
    for scene, part in zip(scenes, ground.base.whole, strict=True):
        fast = np.abs(scene.motion.dq[:, 1:]) > 0.5 * top
        whole.append(replace(part, residual=part.residual * np.where(fast, times, 1.0)))
    stage = Stage(replace(rows, scenes=scenes))
    return on(found, replace(ground, stage=stage, base=replace(ground.base, whole=tuple(whole))))


def test_what_is_left_beyond_the_identified_friction_is_said() -> None:
    logs = clean()
    found = investigate(logs.logs, logs.robot, logs.stages, OPTIONS)
    ordinary = expected(found)
    assert outside_notes(found, logs.robot, ordinary) == ()
    assert outside_notes(beyond_friction(found, 1.0), logs.robot, ordinary) == ()
    (note,) = outside_notes(beyond_friction(found, 20.0), logs.robot, ordinary)
    assert note.startswith("joint elbow: ")
    assert "friction was not identified" in note
