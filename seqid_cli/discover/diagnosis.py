"""Diagnosis: what the model lacks on these logs, with the evidence.

Every effect that the selection arrives at is compared with all others that touch its
joints and with smooth functions of everything that was measured (see `select.naming`):
what these explain better is not understood, and is said to be so.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.contact import contact_point
from seqid_cli.discover.evidence import (
    evidence_of,
    left_over,
    pushed,
    rivals_of,
    taken_up_at,
    tried_at,
)
from seqid_cli.discover.investigate import (
    Investigation,
    event_confidences,
    event_energies,
    investigate,
)
from seqid_cli.discover.lines import clear_lines, is_line
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
from seqid_cli.discover.select.naming import NameConfidence, named
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import ScoredTerm, TermResult
from seqid_cli.discover.select.rows import doubt_of, joints_below
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.verdict import (
    VERDICT_OF_STATE,
    JointState,
    changed_values,
    joint_states,
    verdict_of,
)
from seqid_cli.effects.apply import without_effects
from seqid_cli.effects.effect import Effect
from seqid_cli.effects.fitted import fitted_effects
from seqid_cli.effects.registry import CATALOGUE, catalogue_of
from seqid_cli.effects.units import Value
from seqid_cli.logs.recording import Recording
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.results import diagnosis
from seqid_cli.params.schema import UNDETERMINED_STD_ERROR, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.typing import Array

# of a coefficient's variance beforehand, from which the logs tell nothing of it
UNTOLD_SHARE = 0.9
# share of the squared error, from which a function says what the rest depends on: of
# what takes less there are many functions that take as much
GOOD_PART = 1.0 / 3.0


def diagnose(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: DiscoverOptions,
) -> diagnosis.DiagnosisFile:
    """Find what a model lacks.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs with torque or current.
    robot : Robot
        The arm.
    stages : Stages
        The model. Effects that it has are taken off the torque first.
    options : DiscoverOptions
        Where motion comes from.

    Raises
    ------
    InputError
        A log has no torque, or the torque of all is an echo of the command.
    """
    motion = options.motion
    known_effects = fitted_effects(stages, robot, unexplained=True)
    usable, notes = usable_logs(recordings, robot, settings=options.settings.echo)
    logs = [
        without_effects(
            log,
            robot,
            stages,
            known_effects,
            motion=motion.motion,
            source=motion.source,
        )
        for log in usable
    ]
    evidence = options.settings.evidence
    motion = with_own_cutoffs(logs, robot, stages, motion, evidence)
    options = replace(options, motion=motion)
    document = described(investigate(logs, robot, stages, options), robot)
    document.notes = [*notes, *document.notes, *deflection_notes(stages, robot)]
    return document


def described(investigation: Investigation, robot: Robot) -> diagnosis.DiagnosisFile:
    """Turn a selection and events into findings, unexplained parts and a verdict."""
    investigation, nameless_results = _without_nameless(investigation)
    findings = [
        _finding(investigation, robot, result)
        for result in investigation.selection.effects
    ]
    lines = clear_lines(investigation, robot)
    findings += lines
    line_joints = {line.joint for line in lines}
    nameless_results = [
        result
        for result in nameless_results
        if not (
            is_line(result.term) and robot.name_of(result.term.joint) in line_joints
        )
    ]
    if investigation.events:
        findings.append(_contact(investigation, robot))
        investigation = investigation.without_told_events()
    findings.sort(key=lambda each: (-round(each.confidence, 2), -each.explains))

    ordinary = expected(investigation)
    with_detail = investigation.floor.with_detail(detail_of(investigation))
    investigation = replace(investigation, floor=with_detail)
    most_of_noise = np.maximum(
        investigation.floor.high, diagnosis.MORE_THAN_NOISE * ordinary
    )
    nameless = _nameless_by_joint(investigation, nameless_results, most_of_noise)
    states = joint_states(
        investigation, ordinary, investigation.floor.high, nameless=nameless
    )
    unexplained = _largest_functions(investigation, robot)
    with_function = {part.joint for part in unexplained}
    unexplained += [
        _nameless(investigation, robot, joint, result)
        for joint, result in nameless.items()
        if robot.joint_names[joint] not in with_function
    ]

    # Joints that leave too much though nothing is told there.
    excess = excess_residuals(investigation, ordinary)
    for joint, state in enumerate(states):
        if state == "unexplained" and joint not in excess:
            rms_left = investigation.file_rms[joint]
            excess[joint] = float(rms_left / max(ordinary[joint], 1e-12))
    for joint, times in excess.items():
        is_explained = joint in investigation.explained_joints or joint in nameless
        if not is_explained and states[joint] != "too_short":
            unexplained.append(_excess(investigation, robot, joint, times))

    changed = changed_values(investigation, robot, states)
    named_joints = {
        *(part.joint for part in unexplained),
        *(values.joint for values in changed),
    }
    return diagnosis.DiagnosisFile(
        **head(diagnosis.DIAGNOSIS_SCHEMA, now()),
        robot=robot_id(robot),
        inputs=[],
        parameters=[],
        stages=[],
        verdict=verdict_of(findings, unexplained, states),
        findings=findings,
        unexplained=unexplained,
        changed=changed,
        joints=_joints(investigation, robot, states),
        events=_events(investigation, robot),
        hidden=_hidden(investigation, robot),
        notes=notes_of(investigation, robot, ordinary, excess, named_joints),
    )


def _without_nameless(
    investigation: Investigation,
) -> tuple[Investigation, list[TermResult]]:
    """Take out of what is told the effects whose names are too unsure.

    They stay in the model, for the sake of the other terms.

    Returns
    -------
    Investigation
        Without them.
    list of TermResult
        The effects, the largest share of the squared error first.
    """
    min_confidence = investigation.settings.evidence.min_confidence
    told: list[TermResult] = []
    nameless: list[TermResult] = []
    for result in investigation.selection.terms:
        is_sure = (
            result.term.smooth
            or _name_of(investigation, result).confidence >= min_confidence
        )
        (told if is_sure else nameless).append(result)
    selection = replace(investigation.selection, terms=tuple(told))
    nameless.sort(key=lambda result: -result.scored.score.share)
    return replace(investigation, selection=selection), nameless


def _nameless_by_joint(
    investigation: Investigation, results: Sequence[TermResult], most_of_noise: Array
) -> dict[int, TermResult]:
    """Return nameless effects by the joint that shows them most, one a joint.

    Only those count without which more than noise (n,) N m is left there.
    """
    by_joint: dict[int, TermResult] = {}
    for result in results:
        rms_without = {
            joint: rms(result.left_without[joint])
            for joint in joints_below(result.term.channels, investigation.ground.n)
        }
        too_much = {
            joint: left / max(most_of_noise[joint], 1e-12)
            for joint, left in rms_without.items()
            if left > most_of_noise[joint]
        }
        if too_much:
            joint = max(too_much, key=lambda each: too_much[each])
            by_joint.setdefault(joint, result)
    return by_joint


def _name_of(investigation: Investigation, result: TermResult) -> NameConfidence:
    """Return how sure an effect is, beside what the finished model leaves."""
    joints = joints_below(result.term.channels, investigation.ground.n)
    floor = np.maximum(expected(investigation)[joints], 1e-12)
    floors_left = investigation.model.rms()[joints] / floor
    return named(result, floors_left=float(np.max(floors_left, initial=1.0)))


def _largest_functions(
    investigation: Investigation, robot: Robot
) -> list[diagnosis.UnexplainedPart]:
    """Return the largest smooth function of each joint, the largest share first."""
    parts = [
        _unexplained(investigation, robot, result)
        for result in investigation.selection.smooth
    ]
    by_share = sorted(parts, key=lambda part: part.share)
    largest = {part.joint: part for part in by_share}  # the last one of a joint stays
    return sorted(largest.values(), key=lambda part: -part.share)


def _events(investigation: Investigation, robot: Robot) -> list[diagnosis.EventEntry]:
    """Return the events, in seconds of their logs."""
    entries = []
    for event in investigation.events:
        log = investigation.logs[event.scene]
        entries.append(
            diagnosis.EventEntry(
                log=str(log.path),
                start=log.offset + event.start,
                end=log.offset + event.end,
                joints=[robot.joint_names[joint] for joint in event.joints],
                contact=contact_point(investigation, robot, event),
            )
        )
    return entries


def _hidden(investigation: Investigation, robot: Robot) -> list[diagnosis.HiddenEntry]:
    """Return the effects that the base nearly absorbs on these motions."""
    min_visible = investigation.settings.evidence.min_visible
    visible_shares = investigation.selection.visible_shares
    by_share = sorted(visible_shares.items(), key=lambda pair: pair[1])
    return [
        diagnosis.HiddenEntry(effect=name, joint=robot.name_of(joint), visible=share)
        for (name, joint), share in by_share
        if share < min_visible
    ]


def _contact(investigation: Investigation, robot: Robot) -> diagnosis.FindingEntry:
    """Return the finding that stands for all events, as sure as the surest of them."""
    effect = CATALOGUE["external_contact"]
    events = investigation.events
    in_events = sum(event_energies(investigation).of_events)
    in_terms = sum(
        max(result.scored.score.total, 0.0) for result in investigation.selection.terms
    )
    confidence = max(event_confidences(investigation))
    return diagnosis.FindingEntry(
        effect=effect.name,
        joint=None,
        confidence=confidence,
        name_confidence=confidence,
        explains=float(in_events / max(in_events + in_terms, 1e-300)),
        confusable_with=[],
        separate_by=effect.separate_by,
        gain=0.0,
        note=f"{len(events)} interval(s), left out of the search",
        evidence=pushed(investigation, robot),
    )


def _finding(
    investigation: Investigation, robot: Robot, result: TermResult
) -> diagnosis.FindingEntry:
    """Describe one effect that was taken."""
    candidate = result.term.what
    model = result.model
    assert isinstance(candidate, Candidate)
    effect = candidate.effect
    joints = joints_below(result.term.channels, investigation.ground.n)
    rms_before = np.array([rms(result.left_without[joint]) for joint in joints])
    rms_after = model.rms()[joints]
    floor = investigation.floor.rms[joints]
    name = _name_of(investigation, result)

    # Share of the variance above the noise floor that goes; all where no more is left.
    scale = np.maximum(rms_after, 1e-12)
    above_floor = float(np.sum((rms_before**2 - floor**2) / scale**2))
    removed = float(np.sum((rms_before**2 - rms_after**2) / scale**2))

    coefficients, covariance = size_of(investigation, result)
    values = effect.reported(
        robot, candidate.joint, candidate.settings, coefficients, covariance
    )
    return diagnosis.FindingEntry(
        effect=effect.name,
        joint=robot.name_of(candidate.joint),
        confidence=name.confidence,
        name_confidence=name.by_itself,
        explains=float(np.clip(removed / max(above_floor, 1e-300), 0.0, 1.0)),
        confusable_with=list(name.others),
        separate_by=separate_by(effect, name.others, robot, candidate.joint),
        gain=result.scored.score.share,
        parameters=[_parameter(value) for value in values],
        settings=dict(candidate.settings),
        note=effect.lacking(robot, candidate.joint),
        log_gain=result.scored.score.total,
        evidence=evidence_of(investigation, robot, result),
        rivals=rivals_of(robot, result, name.others),
    )


def _parameter(value: Value) -> diagnosis.EffectParameter:
    """Return a physical parameter; null where the logs do not determine it."""
    is_determined = (
        np.isfinite(value.std_error) and value.std_error < UNDETERMINED_STD_ERROR
    )
    return diagnosis.EffectParameter(
        name=value.name,
        value=value.value if is_determined else None,
        std_error=value.std_error if is_determined else None,
        unit=value.unit,
    )


def size_of(investigation: Investigation, result: TermResult) -> tuple[Array, Array]:
    """Return coefficients (k,) of an effect, and their covariance (k, k).

    A change of the file's values is judged in place of what hides it. What these other
    terms make of its size, beyond how unsure it is beside them, is an error of it as
    well.
    """
    term = result.term
    coefficients = result.model.coefficients(term)
    covariance = result.model.covariance(term)

    # What the rows tell nothing of is as unsure as it was beforehand: it is not
    # determined.
    prior_variance = 1.0 / np.diag(term.part.precision)[: len(coefficients)]
    is_undetermined = result.model.variances(term) > UNTOLD_SHARE * prior_variance
    covariance[is_undetermined, is_undetermined] = UNDETERMINED_STD_ERROR**2

    finished = investigation.model
    if result.model is finished or term not in finished.terms:
        return coefficients, covariance
    difference = finished.coefficients(term) - coefficients
    variance = np.diag(finished.covariance(term))
    excess = np.maximum(difference**2 - variance, 0.0)
    return coefficients, covariance + np.diag(excess)


def separate_by(
    effect: Effect, rival_names: Sequence[str], robot: Robot, joint: int | None
) -> str:
    """Say what to record, and which command plans it against the first rival.

    Parameters
    ----------
    effect : Effect
        The effect that was found.
    rival_names : sequence of str
        Names that these logs cannot rule out.
    robot : Robot
        The arm.
    joint : int or None
        Where the effect is.
    """
    can_be_planned = {
        name
        for name, other in catalogue_of(robot).items()
        if other.by_motion and (joint is not None or other.arm or other.shared)
    }
    rivals = [name for name in rival_names if name in can_be_planned]
    if not rivals or not effect.by_motion:
        return effect.separate_by
    where = "" if joint is None else f" --joint {robot.joint_names[joint]}"
    between = f"--between {effect.name},{rivals[0]}{where}"
    command = f"seqid plan discriminate {between}, with these logs as --have, plans it"
    return f"{effect.separate_by}; {command}"


def _unexplained(
    investigation: Investigation, robot: Robot, result: TermResult
) -> diagnosis.UnexplainedPart:
    """Describe a smooth function that was taken."""
    function = result.term.what
    assert isinstance(function, SmoothFunction)
    score = result.scored.score
    effects = [rival for rival in result.rivals if not rival.term.smooth]
    closest = None
    if effects:
        share = effects[0].score.total / max(score.total, 1e-300)
        closest = diagnosis.ClosestEffect(
            effect=effects[0].term.name, share=float(np.clip(share, 0.0, 1.0))
        )
    functions = [
        result.scored,
        *(rival for rival in result.rivals if _is_function_at(rival, function.joint)),
    ]
    return diagnosis.UnexplainedPart(
        joint=robot.joint_names[function.joint],
        depends_on=_quantities(functions),
        share=float(np.clip(score.share, 0.0, 1.0)),
        closest=closest,
        log_gain=score.total,
        evidence=evidence_of(investigation, robot, result),
        rivals=rivals_of(robot, result),
    )


def _nameless(
    investigation: Investigation, robot: Robot, joint: int, result: TermResult
) -> diagnosis.UnexplainedPart:
    """Describe what is missing at a joint, where no name for it is sure enough."""
    score = result.scored.score
    functions = [rival for rival in result.rivals if _is_function_at(rival, joint)]
    largest = max(rival.score.total for rival in result.rivals)
    return diagnosis.UnexplainedPart(
        joint=robot.joint_names[joint],
        depends_on=_quantities(functions),
        share=float(np.clip(score.share, 0.0, 1.0)),
        closest=diagnosis.ClosestEffect(
            effect=result.term.name,
            share=float(np.clip(score.total / max(largest, 1e-300), 0.0, 1.0)),
        ),
        log_gain=score.total,
        evidence=evidence_of(investigation, robot, result),
        rivals=rivals_of(robot, result, _name_of(investigation, result).others),
    )


def _excess(
    investigation: Investigation, robot: Robot, joint: int, times: float
) -> diagnosis.UnexplainedPart:
    """Describe what is left at a joint by the smooth term that it is most like, if any.

    It is `times` what a right model leaves.
    """
    part = diagnosis.UnexplainedPart(
        joint=robot.joint_names[joint],
        depends_on=[],
        share=1.0 - times**-2,
        closest=_closest_untaken(investigation, joint),
    )
    function = telling_function(_functions_of_the_rest(investigation, joint))
    if function is not None:
        part.depends_on = list(function.quantities)
        part.evidence = left_over(investigation, robot, function)
    return part


def _functions_of_the_rest(
    investigation: Investigation, joint: int, *, most: int = 5
) -> list[ScoredTerm]:
    """Return the smooth functions of what is left at a joint, the largest gain first.

    Only the `most` of the largest evidence are scored, and those of time.
    """
    ground = investigation.ground
    linear = investigation.model.linear
    terms = [*ground.smooth_terms(joint), *ground.smooth_terms(joint, products=True)]
    fits = linear.fits([term.part for term in terms])
    fitted = [
        (term, fit)
        for term, fit in zip(terms, fits, strict=True)
        if fit.log_bayes_factor > 0.0
    ]
    fitted.sort(key=lambda pair: -pair[1].log_bayes_factor)
    of_time = [pair for pair in fitted[most:] if _is_of_time(pair[0])]
    shortlist = [*fitted[:most], *of_time]
    scores = linear.scores([term.part for term, _ in shortlist])
    scored = [
        ScoredTerm(term=term, fit=fit, score=score)
        for (term, fit), score in zip(shortlist, scores, strict=True)
    ]
    return sorted(scored, key=lambda each: -each.score.total)


def _is_function_at(scored: ScoredTerm, joint: int) -> bool:
    """Return whether a term is a smooth function at a joint."""
    function = scored.term.what
    return isinstance(function, SmoothFunction) and function.joint == joint


def _is_of_time(term: Term) -> bool:
    """Return whether a term is a smooth function of time alone."""
    return isinstance(term.what, SmoothFunction) and term.what.quantities == ("time",)


def telling_function(functions: Sequence[ScoredTerm]) -> SmoothFunction | None:
    """Return the function by which one says what the rest depends on, or None.

    It is the best one, if it takes a good part of the squared error. Else it is one of
    time, if none surely does better.

    Parameters
    ----------
    functions : sequence of ScoredTerm
        Smooth functions of one joint.
    """
    if not functions:
        return None
    best = max(functions, key=lambda each: each.score.total)
    telling = [best] if best.score.share >= GOOD_PART else []
    for other in functions:
        lag = best.score.part_gains - other.score.part_gains
        if _is_of_time(other.term) and doubt_of(lag) > Options.alpha:
            telling.append(other)
    if not telling:
        return None
    function = telling[0].term.what
    assert isinstance(function, SmoothFunction)
    return function


def _quantities(functions: Sequence[ScoredTerm]) -> list[str]:
    """Return what is not explained depends on, by smooth functions of one joint."""
    function = telling_function(functions)
    return [] if function is None else list(function.quantities)


def _closest_untaken(
    investigation: Investigation, joint: int
) -> diagnosis.ClosestEffect | None:
    """Return the effect of the largest gain at a joint that was not taken, if any."""
    n = investigation.ground.n
    gaining = [
        scored
        for scored in investigation.selection.untaken
        if joint in joints_below(scored.term.channels, n) and scored.score.total > 0.0
    ]
    for scored in gaining:  # the largest gain first
        if not scored.term.smooth:
            share = scored.score.total / gaining[0].score.total
            return diagnosis.ClosestEffect(effect=scored.term.name, share=share)
    return None


def _joints(
    investigation: Investigation, robot: Robot, states: Sequence[JointState]
) -> dict[str, diagnosis.ResidualEntry]:
    """Return the residual of each joint.

    Without a sample there is nothing to compute numbers from.
    """
    rows = investigation.ground.stage.rows
    floor = investigation.floor
    is_white = white(rows, investigation.model.left())
    with_effect = {
        channel % rows.n
        for result in investigation.selection.effects
        for channel in result.term.channels
    }
    rms_explained = investigation.model.rms()
    entries = {}
    for joint, name in enumerate(robot.joint_names):
        samples = investigation.file_residual.samples[joint]
        has_floor = samples > 0 and floor.rms[joint] > 0.0
        tried = tried_at(investigation, robot, joint)
        # Where noise alone is left a loosened base has taken up nothing that matters.
        if states[joint] not in ("noise", "unseen"):
            tried += taken_up_at(investigation, robot, joint)
        verdict = VERDICT_OF_STATE[states[joint]]
        if verdict == "effect_found" and joint not in with_effect:
            verdict = "unexplained"  # by a function alone
        entries[name] = diagnosis.ResidualEntry(
            rmse=float(investigation.file_rms[joint]) if samples else None,
            noise_floor=float(floor.rms[joint]) if has_floor else None,
            noise_floor_interval=list(floor.interval(joint)) if has_floor else [],
            white=bool(is_white[joint]),
            rmse_explained=float(rms_explained[joint]) if rows.count(joint) else None,
            samples=samples,
            verdict=verdict,
            tried=tried,
        )
    return entries
