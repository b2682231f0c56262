"""Refinement: add what a model lacks, as long as left-out blocks of time are predicted better.

The effects that an investigation names are tried one after the other, each at all
joints at which it is found, and fitted anew together with the model (see `reidentify`).
One that does not help the model fitted anew, or by which other joints lose more than
its own gain, is refused, with that reason. Held-out logs play no part in this: what
they say of the result is in `confirm`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.evidence import evidence_of, rivals_of
from seqid_cli.discover.investigate import (
    Investigation,
    investigate,
    investigate_beside,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import Gain, likelier
from seqid_cli.discover.refinement.loop import (
    ALL_ALONG,
    LATE,
    CandidateModel,
    Decision,
    Refinement,
    Step,
    effect_of,
)
from seqid_cli.discover.refinement.reidentify import Material, Refitted, key_of
from seqid_cli.discover.scenes import usable_logs, with_own_cutoffs
from seqid_cli.discover.select.naming import named
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import Key, TermResult
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.survey.events import Interval
from seqid_cli.identify.prediction.predict import slides_from
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.working import step


def refine(
    training: Sequence[Recording],
    robot: Robot,
    file: ParameterFile,
    *,
    earlier: Mapping[str, Sequence[Recording]],
    options: DiscoverOptions,
) -> Refinement:
    """Add effects to a model, each decided on left-out blocks of the logs.

    `file`: the model as it comes in. `earlier`: logs that its stages were identified
    from, by stage, where they are at hand. Raises InputError: a log carries neither
    torque nor current.
    """
    training, notes = usable_logs(training, robot)
    options = on_the_same_samples(options, file.stages, robot)
    motion = with_own_cutoffs(training, robot, file.stages, options.motion)
    options = replace(options, motion=motion)
    material = Material(tuple(training), earlier, robot, options)
    known = fitted_effects(file.stages, robot, unexplained=True)
    bare = msgspec.structs.replace(file.stages, effects=None)
    start = Refitted(bare, tuple(known), _late(file, known, robot))
    loop = Refinement(
        material=material,
        incoming_stages=file.stages,
        incoming_model=start,
        notes=notes,
    )
    found = investigate(material.now(start), robot, bare, options, least=0.0)
    if found.selection.effects or (options.with_unexplained and found.selection.smooth):
        loop.material = _heard(material, found)
        found = _add_effects(loop, found)
        if options.with_unexplained:
            _add_smooth(loop, found)
    return loop


def _heard(material: Material, found: Investigation) -> Material:
    """What the model is fitted to: without events, and by encoders alone if no log needs more."""
    options, scenes = material.options, found.ground.stage.scenes
    if options.motion.source == "needed" and all(
        s.motion.source == "encoder" for s in scenes
    ):
        options = replace(options, motion=replace(options.motion, source="encoder"))
    training = (
        quiet(material.training, found.events) if found.events else material.training
    )
    return replace(material, training=training, options=options)


def on_the_same_samples(
    options: DiscoverOptions, stages: Stages, robot: Robot
) -> DiscoverOptions:
    """Options by which all models are judged where joints slide by the friction of these stages."""
    slowest = slides_from(TorqueModel.from_stages(stages, robot), options.motion)
    return replace(
        options, motion=replace(options.motion, slides_from=tuple(slowest.tolist()))
    )


def _late(file: ParameterFile, known: Sequence[Fitted], robot: Robot) -> frozenset[Key]:
    """Effects of the file that an earlier refinement found to have come late."""
    rounds = file.closed_loop.rounds if file.closed_loop is not None else []
    names = {(r.effect, r.joint) for r in rounds if r.reason == LATE}
    keys = (key for key in map(key_of, known) if key is not None)
    return frozenset(key for key in keys if (key[0], robot.name_of(key[1])) in names)


def _add_effects(loop: Refinement, found: Investigation) -> Investigation:
    """Try the effects that are found, the largest evidence first; return what is found at last.

    The same effect at several joints is one hypothesis and one round. What the stages
    had taken in of one that is added looks like a second effect, until they are
    identified without it: then the rest are judged anew. Before what is small, more is
    looked for, and so it is where a search ended because it may take no more terms.
    What lies above the low-pass at one setting is not tried at another.
    """
    tried, above = list[Candidate](), set[Key]()
    rest, looked = [*map(effect_of, found.selection.effects)], True
    while True:
        known = [*loop.model.candidates, *tried]
        effects = [x for x in found.selection.effects if effect_of(x).key not in above]
        left = [x for x in effects if not any(map(effect_of(x).is_same_as, known))]
        if not left:
            break
        if loop.stopped:
            loop.untried = _each_once([*map(effect_of, left), *rest])
            break

        step("trying effects", loop.added, loop.added + max(len(left), len(rest)))
        hypothesis = _one_hypothesis(left)
        tried += map(effect_of, hypothesis)
        rest = [other for other in rest if not any(map(other.is_same_as, tried))]
        stages = loop.model.stages
        decision = _decided(loop, found, hypothesis)
        for taken, judgement, _ in decision.refused:
            if judgement.unjudged and not judgement.gains:
                above.add(effect_of(taken).key)
        _write(loop, found, decision)

        full = (
            bool(decision.candidate_model.effects)
            and len(found.model.terms) >= Options.most
        )
        ended = len(left) == len(hypothesis) and (full or not looked)
        if loop.model.stages is not stages or ended:
            model, material = loop.model, loop.material
            asked = material.now(model), material.robot, model.stages, material.options
            found, looked = investigate_beside(found, *asked, candidates=rest)
            rest = [*map(effect_of, found.selection.effects)] if looked else rest
    return found


def _one_hypothesis(left: Sequence[TermResult]) -> tuple[TermResult, ...]:
    """Return the effect of the largest evidence, at all joints at which it is found, once at each.

    One of the whole arm stands by itself.
    """
    ranked = sorted(left, key=lambda taken: -taken.evidence)
    first = ranked[0]
    if first.term.joint is None:
        return (first,)

    at_joint: dict[int, TermResult] = {}
    for taken in ranked:
        if taken.term.name == first.term.name and taken.term.joint is not None:
            at_joint.setdefault(taken.term.joint, taken)
    return tuple(at_joint.values())


def _each_once(effects: Sequence[Candidate]) -> list[Candidate]:
    """Return effects without those that are the same as one before."""
    different: list[Candidate] = []
    for effect in effects:
        if not any(map(effect.is_same_as, different)):
            different.append(effect)
    return different


def _write(loop: Refinement, found: Investigation, decision: Decision) -> None:
    """Write down what a round has added and what it has refused."""
    candidate_model = decision.candidate_model
    if candidate_model.effects:
        reason = LATE if candidate_model.keeps_stages else ALL_ALONG
        number = loop.added + 1
        entries = [
            _round(loop, found, taken, number=number, reason=reason)
            for taken in candidate_model.results
        ]
        several = len(candidate_model.effects) > 1
        loop.steps.append(
            Step(
                rounds=tuple(entries),
                effects=candidate_model.effects,
                keeps_stages=candidate_model.keeps_stages,
                model=candidate_model.model,
                beside=(
                    tuple(other.model for other in candidate_model.without_each)
                    if several
                    else ()
                ),
            )
        )
    for taken, _, reason in decision.refused:
        loop.refused.append(_round(loop, found, taken, reason=reason))


def quiet(
    logs: Sequence[Recording], events: Sequence[Interval]
) -> tuple[Recording, ...]:
    """The logs with the events that were found in them marked as not to be used."""
    valid = [log.valid.copy() for log in logs]
    for event in events:
        t = logs[event.scene].t - logs[event.scene].t[0]
        valid[event.scene] &= (t < event.start) | (t > event.end)
    return tuple(replace(log, valid=own) for log, own in zip(logs, valid, strict=True))


def _decided(
    loop: Refinement, found: Investigation, hypothesis: tuple[TermResult, ...]
) -> Decision:
    """Decide whether effects were there all along, or came late, and which of them are added.

    What is in the file's own logs was there all along. Else the candidate model holds that
    explains the logs of all stages better; without these the one that the base speaks
    for. Every stage again is costly, and not asked for where nothing speaks for it.
    """
    candidates = tuple(map(effect_of, hypothesis))
    # Beside a file that has absorbed nothing of them.
    plain = tuple(replace(candidate, absorbed="") for candidate in candidates)
    after = CandidateModel(
        loop=loop, results=hypothesis, effects=plain, keeps_stages=True
    )
    early = CandidateModel(
        loop=loop, results=hypothesis, effects=candidates, keeps_stages=False
    )

    hold, n = found.model.hold, found.ground.n
    channels = frozenset[int]().union(*(taken.term.channels for taken in hypothesis))
    loose = max(hold.rigid, *(hold.of(c % n) for c in channels)) > 1.0
    # The base had to leave the file there.
    freed = any(candidate.absorbed for candidate in candidates) or loose
    if loop.material.known or (freed and not loop.logs_before):
        return Decision.of(early)

    had = [*loop.model.candidates, *candidates]
    # What the model has not may have made up for the file there.
    near = [x for x in found.selection.terms if x.term.channels & channels]
    made_up = any(
        x.term.smooth or not any(map(effect_of(x).is_same_as, had)) for x in near
    )
    late = Decision.of(after)
    if not (loop.logs_before and (late.candidate_model.effects or freed or made_up)):
        return late
    along = Decision.of(early)
    if not late.candidate_model.effects or not along.candidate_model.effects:
        # Nothing to compare: the errors of both with all effects of the hypothesis
        # decide.
        models = after.model, early.model
    else:
        models = late.candidate_model.model, along.candidate_model.model
    errors = (loop.error_everywhere(model) for model in models)
    return late if likelier(*errors) else along


def _predicted(taken: TermResult) -> Gain:
    """Share of the squared error on blocks that were left out, which the selection went by."""
    return Gain(taken.scored.score.share, *taken.scored.score.interval)


def _round(
    loop: Refinement,
    found: Investigation,
    taken: TermResult,
    *,
    number: int | None = None,
    reason: str,
) -> RefinementRound:
    """Return what was tried, and what the decision rests on; refused without a `number`."""
    robot, term, change = loop.material.robot, taken.term, _predicted(taken)
    return RefinementRound(
        effect="unexplained" if term.smooth else term.name,
        joint=robot.name_of(term.joint),
        round=number,
        accepted=number is not None,
        training_gain=change.value,
        training_interval=change.limits,
        reason=reason,
        evidence=evidence_of(found, robot, taken),
        rivals=rivals_of(robot, taken, () if term.smooth else named(taken).others),
    )


def _add_smooth(loop: Refinement, found: Investigation) -> None:
    """Add smooth terms of no known cause where they predict left-out blocks."""
    for taken in found.selection.smooth:
        if not _predicted(taken).certain:
            reason = "does not certainly predict left-out blocks better"
            loop.refused.append(_round(loop, found, taken, reason=reason))
            continue

        what, model = taken.term.what, loop.model
        assert isinstance(what, SmoothFunction)
        term = what.fitted(taken.scored.fit.coefficients[: what.size])
        loop.steps.append(
            Step(
                rounds=(_round(loop, found, taken, number=loop.added + 1, reason=""),),
                smooth=what,
                keeps_stages=True,
                model=replace(model, effects=(*model.effects, term)),
            )
        )
