"""Refinement: add what a model lacks while left-out blocks are predicted better.

The effects that an investigation names are tried one after the other, each at all
joints at which it is found, and fitted anew together with the model (see `reidentify`).
One that does not help the model fitted anew, or by which other joints lose more than
its own gain, is refused, with that reason. Held-out logs play no part in this: what
they say of the result is in `confirm`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.evidence import evidence_of, rivals_of, tried_at
from seqid_cli.discover.investigate import (
    Investigation,
    investigate,
    investigate_beside,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.across_logs import (
    AcrossLogs,
    NamesAcrossLogs,
    ResultAcrossLogs,
    across_logs,
)
from seqid_cli.discover.refinement.held_out import Gain, doubt, gain, likelier
from seqid_cli.discover.refinement.loop import (
    ALL_ALONG,
    LATE,
    CandidateModel,
    Decision,
    NextName,
    Refinement,
    Refusal,
    Step,
    effect_of,
    with_smooth_term,
)
from seqid_cli.discover.refinement.reidentify import RefinementData, Refitted
from seqid_cli.discover.scenes import usable_logs, with_own_cutoffs
from seqid_cli.discover.select.naming import named
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import Key, TermResult
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.survey.events import Interval
from seqid_cli.effects.fitted import fitted_effects
from seqid_cli.effects.units import UNEXPLAINED
from seqid_cli.identify.prediction.predict import slides_from
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import EffectOfPlace, ParameterFile, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.working import step

NOT_PROMISED = (
    "no gain on another log is promised of {effects}: the logs to fit that show it are"
    " too few for that, or too unlike; only the held-out logs can confirm it"
)


def refine(
    training: Sequence[Recording],
    robot: Robot,
    file: ParameterFile,
    *,
    earlier: Mapping[str, Sequence[Recording]],
    incomplete: frozenset[str] = frozenset(),
    options: DiscoverOptions,
) -> Refinement:
    """Add effects to a model, each decided on left-out blocks of the logs.

    Parameters
    ----------
    training : sequence of Recording
        Logs to fit.
    robot : Robot
        The arm.
    file : ParameterFile
        The model as it comes in.
    earlier : mapping of str to sequence of Recording
        Logs that its stages were identified from, by stage, where they are at hand.
    incomplete : frozenset of str
        Stages of which not all logs are at hand.
    options : DiscoverOptions
        Where motion comes from, and what is added.

    Raises
    ------
    InputError
        A log carries neither torque nor current.
    """
    training, notes = usable_logs(training, robot, settings=options.settings.echo)
    options = on_the_same_samples(options, file.stages, robot)
    motion = with_own_cutoffs(
        training, robot, file.stages, options.motion, options.settings.evidence
    )
    options = replace(options, motion=motion)
    material = RefinementData(
        training=tuple(training),
        earlier=earlier,
        robot=robot,
        options=options,
        incomplete=incomplete,
    )

    file_effects = fitted_effects(file.stages, robot, unexplained=True)
    stages = msgspec.structs.replace(file.stages, effects=None)
    incoming_model = Refitted(stages, tuple(file_effects))
    loop = Refinement(
        material=material,
        incoming_stages=file.stages,
        incoming_model=incoming_model,
        notes=notes,
    )

    investigation = investigate(
        material.now(incoming_model), robot, file.stages, options, least=0.0
    )
    investigation.forget_search()
    if investigation.selection.terms:
        loop.material = _material_to_fit(material, investigation, incoming_model)
        investigation = _add_effects(loop, investigation)
        if options.with_unexplained:
            _add_smooth(loop, investigation)
    for joint, name in enumerate(robot.joint_names):
        loop.tried[name] = tried_at(investigation, robot, joint)
    loop.notes = (*loop.notes, *_not_promised_note(loop))
    return loop


def _not_promised_note(loop: Refinement) -> tuple[str, ...]:
    """Say of which effects the logs to fit do not tell what another log will gain."""
    places = [
        f"{entry.effect} at {entry.joint or 'the whole arm'}"
        for step_of_loop in loop.steps
        for entry in step_of_loop.rounds
        if not entry.promised
    ]
    if not places:
        return ()
    return (NOT_PROMISED.format(effects=", ".join(places)),)


def _material_to_fit(
    material: RefinementData, investigation: Investigation, incoming_model: Refitted
) -> RefinementData:
    """Return what the model is fitted to.

    It is without events, and by encoders alone if no log needs more. Rows and columns
    of the investigation are those of the first fit, where nothing was taken out.
    """
    options = material.options
    uses_encoders_alone = all(
        scene.motion.source == "encoder" for scene in investigation.ground.stage.scenes
    )
    if options.motion.source == "needed" and uses_encoders_alone:
        options = replace(options, motion=replace(options.motion, source="encoder"))

    training = material.training
    if investigation.events:
        training = quiet(training, investigation.events)
    to_fit = replace(material, training=training, options=options)
    # The logs were investigated without the effects that the file has.
    is_as_logged = not (incoming_model.effects or investigation.events)
    if is_as_logged and investigation.has_all_rows:
        to_fit.keep(incoming_model, investigation.ground)
    return to_fit


def on_the_same_samples(
    options: DiscoverOptions, stages: Stages, robot: Robot
) -> DiscoverOptions:
    """Return options by which all models are judged on the same samples.

    Where joints slide, and where their friction counts as identified, is said by these
    stages: those that are identified anew may have seen more or less.

    Parameters
    ----------
    options : DiscoverOptions
        As they are.
    stages : Stages
        Those whose friction decides.
    robot : Robot
        The arm.
    """
    model = TorqueModel.from_stages(stages, robot)
    motion = replace(
        options.motion,
        slides_from=tuple(slides_from(model, options.motion).tolist()),
        identified_ranges=model.identified_ranges,
    )
    return replace(options, motion=motion)


def _add_effects(loop: Refinement, investigation: Investigation) -> Investigation:
    """Try the effects that are found, the largest evidence first.

    The same effect at several joints is one hypothesis and one round. A finding whose
    name is refused goes by the next name that explains half as much, until none is
    left; so does a smooth function, which is no name. What the stages had taken in of
    one that is added looks like a second effect, until they are identified without it:
    then the rest are judged anew. Before what is small, more is looked for, and so it
    is where a search ended because it may take no more terms. What lies above the
    low-pass at one setting is not tried at another.

    Returns
    -------
    Investigation
        The last one.
    """
    findings = _Findings(loop, investigation)
    new_results = findings.untried()
    waiting = _waiting(investigation, new_results)
    is_complete = True
    while new_results:
        if loop.stopped:
            new_effects = [effect_of(result) for result in new_results]
            loop.untried = [
                EffectOfPlace(
                    effect=effect.effect.name,
                    joint=loop.material.robot.name_of(effect.joint),
                )
                for effect in _each_once([*new_effects, *waiting])
            ]
            break

        n_left = max(len(new_results), len(waiting))
        step("trying effects", loop.added, loop.added + n_left)
        hypothesis = _one_hypothesis(new_results)
        stages_before = loop.model.stages
        decision = _decided(loop, investigation, hypothesis)
        findings.judge(hypothesis, decision)
        _write(loop, investigation, decision, findings)
        next_results = findings.untried()

        # What is tried waits no more, nor what it stood for; the next name does.
        replaced = [
            result.instead_of.what
            for result in hypothesis
            if isinstance(result.instead_of.what, Candidate)
        ]
        settled = [*findings.tried, *replaced]
        waiting = [
            *(effect for effect in waiting if not _is_among(effect, settled)),
            *(
                effect_of(result)
                for result in next_results
                if not _is_among(effect_of(result), waiting)
            ),
        ]

        # More is looked for where the stages have changed, or the search had ended
        # before its time.
        n_terms = len(investigation.model.terms)
        is_full = (
            bool(decision.candidate_model.effects) and n_terms >= Options.max_terms
        )
        if loop.model.stages is not stages_before or (
            not next_results and (is_full or not is_complete)
        ):
            investigation, is_complete = investigate_beside(
                investigation,
                loop.material.now(loop.model),
                loop.material.robot,
                loop.stages,
                loop.material.options,
                candidates=waiting,
            )
            investigation.forget_search()
            findings = _Findings(loop, investigation, after=findings)
            next_results = findings.untried()
            if is_complete:
                waiting = _waiting(investigation, next_results)
        new_results = next_results
    return investigation


def _waiting(
    investigation: Investigation, results: Sequence[ResultAcrossLogs]
) -> list[Candidate]:
    """Return the effects of a selection, and those that stand for its terms."""
    found = [*investigation.selection.effects, *results]
    return _each_once([effect_of(result) for result in found])


class _Findings:
    """What an investigation finds, each by the first of its names that is not refused.

    Parameters
    ----------
    loop : Refinement
        The refinement as it stands.
    investigation : Investigation
        The investigation.
    after : _Findings, optional
        Those of the investigation before: what was tried then is not tried again.

    Attributes
    ----------
    tried : list of Candidate
        What was tried, added or refused.
    """

    def __init__(
        self,
        loop: Refinement,
        investigation: Investigation,
        *,
        after: _Findings | None = None,
    ) -> None:
        self._loop = loop
        self._names = [
            NamesAcrossLogs(result, investigation.logs, loop.material.selection_options)
            for result in investigation.selection.terms
        ]
        self.tried: list[Candidate] = after.tried if after else []
        # What lies above the low-pass at one setting, whatever the other settings.
        self._unjudged_keys: set[Key] = after._unjudged_keys if after else set()

    def untried(self) -> list[ResultAcrossLogs]:
        """Return what is found, and is neither in the model nor refused.

        Of a finding whose name is refused it is the next name.
        """
        likeliest = [names.likeliest(self._is_refused) for names in self._names]
        model_effects = self._loop.model.candidates
        return [
            result
            for result in likeliest
            if result is not None and not _is_among(effect_of(result), model_effects)
        ]

    def judge(self, hypothesis: Sequence[ResultAcrossLogs], decision: Decision) -> None:
        """Remember what was tried, and what cannot be judged at any setting."""
        self.tried += [effect_of(result) for result in hypothesis]
        for refusal in decision.refused:
            judgement = refusal.judgement
            if judgement and judgement.is_unjudged and not judgement.gains:
                self._unjudged_keys.add(effect_of(refusal.result).key)

    def refused_before(self, result: TermResult) -> list[str]:
        """Return the names of a finding that were refused before this one."""
        if not isinstance(result, ResultAcrossLogs):
            return []
        rivals = [rival.term.what for rival in result.rivals]
        effects = [what for what in rivals if isinstance(what, Candidate)]
        own = effect_of(result)
        names = [
            effect.effect.name
            for effect in self.tried
            if effect.joint == own.joint
            and self._is_refused(effect)
            and _is_among(effect, effects)
            and not effect.is_same_as(own)
        ]
        return list(dict.fromkeys(names))

    def next_names(self, result: TermResult, reason: str) -> list[NextName]:
        """Return what to go on with in the place of a finding, in its order.

        Parameters
        ----------
        result : TermResult
            The finding by the name that is added.
        reason : str
            When it came.
        """
        assert isinstance(result, ResultAcrossLogs)
        loop = self._loop
        robot = loop.material.robot
        scenes = loop.material.ground(loop.model).stage.scenes
        is_late = reason == LATE
        next_names = []
        for names in self._names:
            if names.result.term is not result.instead_of:
                continue
            for scored in names.following(result, self._is_refused):
                term = scored.term
                effect = term.what
                assert isinstance(effect, Candidate)
                is_shown = effect.effect.shows(scenes, effect.joint, effect.settings)
                if not is_shown or effect.effect.lacking(robot, effect.joint):
                    continue
                across = names.across(scored)
                entry = RefinementRound(
                    effect=term.name,
                    joint=robot.name_of(term.joint),
                    acts_on=[
                        robot.joint_names[joint]
                        for joint in joints_below(term.channels, robot.n)
                    ],
                    reason=reason,
                    training_gain=scored.score.share,
                    training_interval=list(scored.score.interval),
                )
                if is_late:
                    effect = replace(effect, absorbed="", late=True)
                next_names.append(
                    NextName(entry=_with_logs(entry, across), effect=effect)
                )
        return next_names

    def _is_refused(self, effect: Candidate) -> bool:
        is_in_model = _is_among(effect, self._loop.model.candidates)
        was_tried = _is_among(effect, self.tried)
        return effect.key in self._unjudged_keys or (was_tried and not is_in_model)


def _is_among(effect: Candidate, candidates: Sequence[Candidate]) -> bool:
    """Return whether an effect is the same as one of candidates."""
    return any(effect.is_same_as(candidate) for candidate in candidates)


def _one_hypothesis(
    results: Sequence[ResultAcrossLogs],
) -> tuple[ResultAcrossLogs, ...]:
    """Return the effect of the largest evidence, at all joints at which it is found.

    It is there once at each. One of the whole arm stands by itself.
    """
    ranked = sorted(results, key=lambda result: -result.evidence)
    first = ranked[0]
    if first.term.joint is None:
        return (first,)

    at_joint: dict[int, ResultAcrossLogs] = {}
    for result in ranked:
        term = result.term
        if term.name == first.term.name and term.joint is not None:
            at_joint.setdefault(term.joint, result)
    return tuple(at_joint.values())


def _each_once(effects: Sequence[Candidate]) -> list[Candidate]:
    """Return effects without those that are the same as one before."""
    different: list[Candidate] = []
    for effect in effects:
        if not _is_among(effect, different):
            different.append(effect)
    return different


def _write(
    loop: Refinement,
    investigation: Investigation,
    decision: Decision,
    findings: _Findings,
) -> None:
    """Write down what a round has added and what it has refused."""

    def told(result: TermResult, reason: str, number: int | None) -> RefinementRound:
        entry = _round(loop, investigation, result, number=number, reason=reason)
        names = findings.refused_before(result)
        return msgspec.structs.replace(entry, after_refusal_of=names)

    added = decision.candidate_model
    if added.effects:
        reason = LATE if added.keeps_stages else ALL_ALONG
        number = loop.added + 1
        entries = [told(result, reason, number) for result in added.results]
        beside: list[Refitted] = []
        if len(added.effects) > 1:
            beside = [without.model for without in added.without_each]
        loop.steps.append(
            Step(
                rounds=tuple(entries),
                effects=added.effects,
                keeps_stages=added.keeps_stages,
                model=added.model,
                beside=tuple(beside),
                next_names=tuple(
                    findings.next_names(result, reason) for result in added.results
                ),
            )
        )
    for refusal in decision.refused:
        loop.refused.append(told(refusal.result, refusal.reason, None))


def quiet(
    logs: Sequence[Recording], events: Sequence[Interval]
) -> tuple[Recording, ...]:
    """Return the logs with the events that were found in them marked as not valid."""
    valid = [log.valid.copy() for log in logs]
    for event in events:
        log = logs[event.scene]
        t = log.t - log.t[0]
        valid[event.scene] &= (t < event.start) | (t > event.end)
    return tuple(
        replace(log, valid=of_log) for log, of_log in zip(logs, valid, strict=True)
    )


def _decided(
    loop: Refinement,
    investigation: Investigation,
    hypothesis: tuple[ResultAcrossLogs, ...],
) -> Decision:
    """Decide which effects are added, and when they came.

    What whole logs that were left out disprove is not tried.
    """
    min_gain = loop.material.selection_options.improvement
    refused = []
    proven = []
    for result in hypothesis:
        if result.across.is_disproved(min_gain):
            refused.append(Refusal.across_logs(result))
        else:
            proven.append(result)
    if not proven:
        nothing = CandidateModel(loop=loop, results=(), effects=(), keeps_stages=True)
        return Decision(candidate_model=nothing, refused=tuple(refused))
    decision = _decided_when(loop, investigation, tuple(proven))
    return replace(decision, refused=(*refused, *decision.refused))


def _decided_when(
    loop: Refinement,
    investigation: Investigation,
    hypothesis: tuple[ResultAcrossLogs, ...],
) -> Decision:
    """Decide when effects came, and which of them are added.

    What is in the file's own logs was there all along. Else the account holds that
    explains the logs of all stages better; without these the one that the base speaks
    for, if its model is better, and else the other. Every stage again is costly, and
    not asked for where nothing speaks for it.
    """
    effects = tuple(effect_of(result) for result in hypothesis)
    all_along_model = CandidateModel(
        loop=loop, results=hypothesis, effects=effects, keeps_stages=False
    )
    # Beside a file that has absorbed nothing of them.
    late_model = CandidateModel(
        loop=loop,
        results=hypothesis,
        effects=tuple(replace(effect, absorbed="", late=True) for effect in effects),
        keeps_stages=True,
    )

    # Whether the base had to leave the file there.
    channels = frozenset[int]().union(*(result.term.channels for result in hypothesis))
    is_absorbed = any(effect.absorbed for effect in effects)
    base_left_file = is_absorbed or _base_is_loose(investigation, channels)
    if loop.material.known:
        return Decision.of(all_along_model)
    if base_left_file and not loop.logs_before:
        all_along = Decision.of(all_along_model)
        if all_along.candidate_model.effects:
            return all_along
        # A few seconds let a base look loose that is not.

    late = Decision.of(late_model)
    if not loop.logs_before:
        return late
    speaks_for_all_along = (
        late.candidate_model.effects
        or base_left_file
        or _others_make_up(loop, investigation, effects, channels)
    )
    if not speaks_for_all_along:
        return late

    if len(late.candidate_model.effects) == len(effects):
        # Whether the other account is worth it needs every stage once more without its
        # effects: it is not asked of one that explains the logs less well.
        late_fit = late.candidate_model.model
        if likelier(
            loop.error_everywhere(late_fit),
            loop.error_everywhere(all_along_model.model),
        ):
            return late

    all_along = Decision.of(all_along_model)
    if late.candidate_model.effects and all_along.candidate_model.effects:
        late_fit = late.candidate_model.model
        all_along_fit = all_along.candidate_model.model
    else:
        # Nothing to compare: the errors of both with all effects of the hypothesis
        # decide.
        late_fit = late_model.model
        all_along_fit = all_along_model.model
    is_late = likelier(
        loop.error_everywhere(late_fit), loop.error_everywhere(all_along_fit)
    )
    return late if is_late else all_along


def _base_is_loose(investigation: Investigation, channels: frozenset[int]) -> bool:
    """Return whether the evidence holds the base loosely at some channels' joints."""
    hold = investigation.model.hold
    n = investigation.ground.n
    return max(hold.rigid, *(hold.of(channel % n) for channel in channels)) > 1.0


def _others_make_up(
    loop: Refinement,
    investigation: Investigation,
    effects: Sequence[Candidate],
    channels: frozenset[int],
) -> bool:
    """Return whether terms that the model lacks may make up for the file there."""
    model_effects = [*loop.model.candidates, *effects]
    for result in investigation.selection.terms:
        if not result.term.channels & channels:
            continue
        if result.term.smooth or not _is_among(effect_of(result), model_effects):
            return True
    return False


def _training_gain(result: TermResult) -> Gain:
    """Return the gain on left-out blocks that the selection went by."""
    score = result.scored.score
    low, high = score.interval
    return Gain(value=score.share, low=low, high=high)


def _round(
    loop: Refinement,
    investigation: Investigation,
    result: TermResult,
    *,
    number: int | None = None,
    reason: str,
) -> RefinementRound:
    """Return what was tried and what the decision rests on; no number: refused."""
    robot = loop.material.robot
    term = result.term
    change = _training_gain(result)
    likely_names = () if term.smooth else named(result).others
    entry = RefinementRound(
        effect=UNEXPLAINED if term.smooth else term.name,
        joint=robot.name_of(term.joint),
        acts_on=[
            robot.joint_names[joint] for joint in joints_below(term.channels, robot.n)
        ],
        round=number,
        accepted=number is not None,
        training_gain=change.value,
        training_interval=change.limits,
        reason=reason,
        evidence=evidence_of(investigation, robot, result),
        rivals=rivals_of(robot, result, likely_names),
    )
    if isinstance(result, ResultAcrossLogs):
        return _with_logs(entry, result.across)
    return entry


def _with_logs(entry: RefinementRound, across: AcrossLogs) -> RefinementRound:
    """Return what was tried with what whole logs say of it, if there are several."""
    if len(across.names) < 2:
        return entry
    return msgspec.structs.replace(
        entry,
        whole_logs_gain=across.gain.value,
        whole_logs_interval=across.of_another_log.limits,
        gain_by_log=across.of_each,
        promised=across.is_promised,
    )


def _add_smooth(loop: Refinement, investigation: Investigation) -> None:
    """Add smooth terms of no known cause where they predict left-out blocks."""
    options = loop.material.selection_options
    for smooth in investigation.selection.smooth:
        result = across_logs(smooth, investigation.logs, options)
        if loop.stopped:
            joint = loop.material.robot.name_of(result.term.joint)
            loop.untried.append(EffectOfPlace(effect=UNEXPLAINED, joint=joint))
            continue
        if result.across.is_disproved(options.improvement):
            reason = Refusal.across_logs(result).reason
            loop.refused.append(_round(loop, investigation, result, reason=reason))
            continue
        if not _training_gain(result).certain:
            reason = "does not certainly predict left-out blocks better"
            loop.refused.append(_round(loop, investigation, result, reason=reason))
            continue

        # Beside a base that moves it counted on what the base has moved by.
        function = result.term.what
        assert isinstance(function, SmoothFunction)
        model = with_smooth_term(loop.material, loop.model, function)
        error_before = loop.error_of(loop.model)
        error_after = loop.error_of(model)
        joints = joints_below(result.term.channels, loop.material.robot.n)
        change = gain(error_before, error_after, joints)
        chance_probability = doubt(error_before, error_after, joints)
        if change.value < options.improvement or chance_probability > options.alpha:
            reason = "the model as it stands is not certainly better with it"
            loop.refused.append(_round(loop, investigation, result, reason=reason))
            continue

        entry = _round(loop, investigation, result, number=loop.added + 1, reason="")
        loop.steps.append(
            Step(rounds=(entry,), smooth=function, keeps_stages=True, model=model)
        )
