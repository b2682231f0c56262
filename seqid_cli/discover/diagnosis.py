"""Diagnosis: what the model lacks on these logs, with the evidence.

Every effect that the selection arrives at is compared with all others that touch its
joints and with smooth functions of everything that was measured (see `select.naming`):
what these explain better is not understood, and is said to be so.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.evidence import (
    evidence_of,
    left_over,
    pushed,
    rivals_of,
    tried_at,
)
from seqid_cli.discover.investigate import Investigation, investigate
from seqid_cli.discover.noise.floor import rms
from seqid_cli.discover.noise.whiteness import white
from seqid_cli.discover.notes import (
    deflection_notes,
    detail_of,
    excess_residuals,
    expected,
    notes_of,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import usable_logs, with_own_cutoffs
from seqid_cli.discover.select.naming import TOLD, named
from seqid_cli.discover.select.results import TermResult
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.verdict import changed_values, joint_states, verdict_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import without_effects
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.effects.registry import CATALOGUE, catalogue_of
from seqid_cli.model.effects.units import UNTOLD, Value
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.results import diagnosis
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# of a coefficient's variance beforehand, from which the logs tell nothing of it
UNTOLD_SHARE = 0.9
HIDDEN = 0.2  # visible share below which an effect is said to be invisible


def diagnose(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: DiscoverOptions,
) -> diagnosis.DiagnosisFile:
    """Find what a model lacks; InputError: a log without torque, or the torque of all an echo."""
    motion = options.motion
    known = fitted_effects(stages, robot, unexplained=True)
    kept, notes = usable_logs(recordings, robot)
    logs = [
        without_effects(
            log, robot, stages, known, motion=motion.motion, source=motion.source
        )
        for log in kept
    ]
    options = replace(options, motion=with_own_cutoffs(logs, robot, stages, motion))
    found = described(investigate(logs, robot, stages, options), robot)
    found.notes = [*notes, *found.notes, *deflection_notes(stages, robot)]
    return found


def described(found: Investigation, robot: Robot) -> diagnosis.DiagnosisFile:
    """Turn a selection and events into findings, unexplained parts and a verdict."""
    sure = [
        taken for taken in found.selection.effects if named(taken).confidence >= TOLD
    ]
    findings = [_finding(found, robot, taken) for taken in sure]
    if found.events and (contact := _contact(found, robot)).confidence >= TOLD:
        findings.append(contact)
        found = found.without_told_events()
    findings.sort(key=lambda one: (-round(one.confidence, 2), -one.explains))

    functions = [_unexplained(found, robot, taken) for taken in found.selection.smooth]
    first = {
        part.joint: part for part in sorted(functions, key=lambda part: part.share)
    }
    # the largest of each joint
    rest = sorted(first.values(), key=lambda part: -part.share)
    ordinary = expected(found)
    found = replace(found, floor=found.floor.with_detail(detail_of(found)))
    states = joint_states(found, ordinary, found.floor.high)
    excess = excess_residuals(found, ordinary)
    for joint, state in enumerate(states):
        if state == "unexplained":
            excess.setdefault(
                joint, float(found.file_rms[joint] / max(ordinary[joint], 1e-12))
            )
    rest += [
        _excess(found, robot, joint, times)
        for joint, times in excess.items()
        if joint not in found.explained_joints and states[joint] != "too_short"
    ]
    changed = changed_values(found, robot, states)
    named_joints = {*(part.joint for part in rest), *(one.joint for one in changed)}
    visible = sorted(found.selection.visible_shares.items(), key=lambda x: x[1])
    return diagnosis.DiagnosisFile(
        **head(diagnosis.DIAGNOSIS_SCHEMA, now()),
        robot=robot_id(robot),
        inputs=[],
        parameters=[],
        stages=[],
        verdict=verdict_of(findings, rest, states),
        findings=findings,
        unexplained=rest,
        changed=changed,
        joints=_joints(found, robot),
        events=[
            diagnosis.EventEntry(
                log=str(log.path),
                start=log.offset + event.start,
                end=log.offset + event.end,
                joints=[robot.joint_names[j] for j in event.joints],
            )
            for event in found.events
            for log in [found.logs[event.scene]]
        ],
        hidden=[
            diagnosis.HiddenEntry(
                effect=name, joint=robot.name_of(joint), visible=share
            )
            for (name, joint), share in visible
            if share < HIDDEN
        ],
        notes=notes_of(found, robot, ordinary, excess, named_joints),
    )


def _contact(found: Investigation, robot: Robot) -> diagnosis.FindingEntry:
    """The finding that stands for all events.

    A push stands alone. Where much more than noise is left all along, the largest
    moment of it may be nothing else: it is no surer than its share in what is unknown
    at its joints.
    """
    effect, rows, left = (
        CATALOGUE["external_contact"],
        found.ground.stage.rows,
        found.model.left(),
    )
    floor = np.maximum(found.floor.rms, 1e-12)
    energies = [
        e.energy(rows.scenes[e.scene], left[e.scene] / floor) for e in found.events
    ]
    unknown = np.maximum((found.model.rms() / floor) ** 2 - 1.0, 0.0)
    beyond = unknown * [rows.count(j) for j in range(rows.n)]
    near = [sum(beyond[j] for j in event.joints) for event in found.events]
    apart = [e / max(e + rest, 1e-300) for e, rest in zip(energies, near, strict=True)]
    inside = sum(energies)
    gained = sum(max(taken.scored.score.total, 0.0) for taken in found.selection.terms)
    confidence = float(max(event.certainty for event in found.events) * max(apart))
    return diagnosis.FindingEntry(
        effect=effect.name,
        joint=None,
        confidence=confidence,
        name_confidence=confidence,
        explains=float(inside / max(inside + gained, 1e-300)),
        confusable_with=[],
        separate_by=effect.separate_by,
        gain=0.0,
        note=f"{len(found.events)} interval(s), left out of the search",
        evidence=pushed(found, robot),
    )


def _finding(
    found: Investigation, robot: Robot, taken: TermResult
) -> diagnosis.FindingEntry:
    """Describe one effect that was taken."""
    what, model = taken.term.what, taken.model
    assert isinstance(what, Candidate)
    effect, joints = what.effect, joints_below(taken.term.channels, found.ground.n)
    before = np.array([rms(taken.left_without[j]) for j in joints])
    after, floor = model.rms()[joints], found.floor.rms[joints]
    name = named(taken, float(np.max(after / np.maximum(floor, 1e-12), initial=1.0)))
    # Share of the variance above the noise floor that goes; all where no more is left.
    scale = np.maximum(after, 1e-12)
    above = float(np.sum((before**2 - floor**2) / scale**2))
    gone = float(np.sum((before**2 - after**2) / scale**2))
    coefficients, covariance = size_of(found, taken)
    values = effect.reported(robot, what.joint, what.settings, coefficients, covariance)
    return diagnosis.FindingEntry(
        effect=effect.name,
        joint=robot.name_of(what.joint),
        confidence=name.confidence,
        name_confidence=name.by_itself,
        explains=float(np.clip(gone / max(above, 1e-300), 0.0, 1.0)),
        confusable_with=list(name.others),
        separate_by=separate_by(effect, name.others, robot, what.joint),
        gain=taken.scored.score.share,
        parameters=[_parameter(value) for value in values],
        settings=dict(what.settings),
        note=effect.lacking(robot, what.joint),
        log_gain=taken.scored.score.total,
        evidence=evidence_of(found, robot, taken),
        rivals=rivals_of(robot, taken, name.others),
    )


def _parameter(value: Value) -> diagnosis.EffectParameter:
    """A physical parameter; null where the logs do not determine it."""
    known = np.isfinite(value.std_error) and value.std_error < UNTOLD
    return diagnosis.EffectParameter(
        name=value.name,
        value=value.value if known else None,
        std_error=value.std_error if known else None,
        unit=value.unit,
    )


def size_of(found: Investigation, taken: TermResult) -> tuple[Array, Array]:
    """Coefficients (k,) of an effect that was taken, and their covariance (k, k).

    A change of the file's values is judged in place of what hides it. What these other
    terms make of its size, beyond how unsure it is beside them, is an error of it as
    well.
    """
    coefficients = taken.model.coefficients(taken.term)
    covariance = taken.model.covariance(taken.term)

    # What the rows tell nothing of is as unsure as it was beforehand: it is not
    # determined.
    beforehand = 1.0 / np.diag(taken.term.part.precision)[: len(coefficients)]
    untold = taken.model.variances(taken.term) > UNTOLD_SHARE * beforehand
    covariance[untold, untold] = UNTOLD**2
    if taken.model is found.model or taken.term not in found.model.terms:
        return coefficients, covariance
    moved = found.model.coefficients(taken.term) - coefficients
    unsure = np.diag(found.model.covariance(taken.term))
    return coefficients, covariance + np.diag(np.maximum(moved**2 - unsure, 0.0))


def separate_by(
    effect: Effect, others: Sequence[str], robot: Robot, joint: int | None
) -> str:
    """What to record, and the command that plans it against the first rival where it can."""
    every = catalogue_of(robot).items()
    asked = [
        n for n, e in every if e.by_motion and (joint is not None or e.arm or e.shared)
    ]
    rivals = [name for name in others if name in asked]
    if not rivals or not effect.by_motion:
        return effect.separate_by
    where = "" if joint is None else f" --joint {robot.joint_names[joint]}"
    between = f"--between {effect.name},{rivals[0]}{where}"
    command = f"seqid plan discriminate {between}, with these logs as --have, plans it"
    return f"{effect.separate_by}; {command}"


def _unexplained(
    found: Investigation, robot: Robot, taken: TermResult
) -> diagnosis.UnexplainedPart:
    """Describe a smooth function that was taken."""
    what = taken.term.what
    assert isinstance(what, SmoothFunction)
    told, closest = taken.scored.score, None
    if effects := [rival for rival in taken.rivals if not rival.term.smooth]:
        share = np.clip(effects[0].score.total / max(told.total, 1e-300), 0.0, 1.0)
        closest = diagnosis.ClosestEffect(
            effect=effects[0].term.name, share=float(share)
        )
    return diagnosis.UnexplainedPart(
        joint=robot.joint_names[what.joint],
        depends_on=list(what.quantities),
        share=float(np.clip(told.share, 0.0, 1.0)),
        closest=closest,
        log_gain=told.total,
        evidence=evidence_of(found, robot, taken),
        rivals=rivals_of(robot, taken),
    )


def _excess(
    found: Investigation, robot: Robot, joint: int, times: float
) -> diagnosis.UnexplainedPart:
    """Describe what is left at a joint by the smooth term that it is most like, if by any."""
    name, share, ground = robot.joint_names[joint], 1.0 - times**-2, found.ground
    terms = [*ground.smooth_terms(joint), *ground.smooth_terms(joint, products=True)]
    gained = found.model.linear.fits([term.part for term in terms])
    best = max(
        zip(terms, gained, strict=True),
        key=lambda pair: pair[1].log_bayes_factor,
        default=None,
    )
    part = diagnosis.UnexplainedPart(joint=name, depends_on=[], share=share)
    if best is not None and best[1].log_bayes_factor > 0.0:
        what = best[0].what
        assert isinstance(what, SmoothFunction)
        part.depends_on, part.evidence = (
            list(what.quantities),
            left_over(found, robot, what),
        )
    return part


def _joints(found: Investigation, robot: Robot) -> dict[str, diagnosis.ResidualEntry]:
    """The residual of each joint; without a sample there is nothing to compute numbers from."""
    rows, floor, entries = found.ground.stage.rows, found.floor, {}
    whites, left = white(rows, found.model.left()), found.model.rms()
    for j, name in enumerate(robot.joint_names):
        samples = found.file_residual.samples[j]
        known = samples > 0 and floor.rms[j] > 0.0
        entries[name] = diagnosis.ResidualEntry(
            rmse=float(found.file_rms[j]) if samples else None,
            noise_floor=float(floor.rms[j]) if known else None,
            noise_floor_interval=list(floor.interval(j)) if known else [],
            white=bool(whites[j]),
            rmse_explained=float(left[j]) if rows.count(j) else None,
            samples=samples,
            tried=tried_at(found, robot, j),
        )
    return entries
