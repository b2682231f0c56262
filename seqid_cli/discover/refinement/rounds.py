"""Refinement: add what a model lacks, as long as left-out blocks of time are predicted better.

The effects that an investigation names are tried one after the other, and fitted anew together
with the model (see `reidentify`). One that does not help the model fitted anew, or by which other
joints lose more than its own gain, is refused, with that reason. Held-out logs play no part in
this: what they say of the result is in `confirm`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.evidence import evidence_of, rivals_of
from seqid_cli.discover.investigate import Investigation, investigate, investigate_beside
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import Gain, likelier
from seqid_cli.discover.refinement.loop import LATE, Account, Refinement, effect_of
from seqid_cli.discover.refinement.reidentify import Material, Refitted, key_of
from seqid_cli.discover.scenes import usable_logs, with_own_cutoffs
from seqid_cli.discover.select.naming import named
from seqid_cli.discover.select.results import Key, Taken
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.survey.events import Interval
from seqid_cli.identify.prediction.predict import slides_from
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.effects.smooth import SmoothTerm
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

    `file`: the model as it comes in. `earlier`: logs that its stages were identified from, by
    stage, where they are at hand. Raises InputError: a log carries neither torque nor current.
    """
    training, notes = usable_logs(training, robot)
    options = on_the_same_samples(options, file.stages, robot)
    motion = with_own_cutoffs(training, robot, file.stages, options.motion)
    options = replace(options, motion=motion)
    material = Material(tuple(training), earlier, robot, options)
    known = fitted_effects(file.stages, robot, unexplained=True)
    bare = msgspec.structs.replace(file.stages, effects=None)
    start = Refitted(bare, tuple(known), _late(file, known, robot))
    loop = Refinement(material, file.stages, [start], start, notes=notes)
    found = investigate(material.now(start), robot, bare, options, least=0.0)
    if found.found.effects or (options.with_unexplained and found.found.smooth):
        loop.material = _heard(material, found)
        found = _add_effects(loop, found)
        if options.with_unexplained:
            _add_smooth(loop, found)
    return loop


def _heard(material: Material, found: Investigation) -> Material:
    """What the model is fitted to: without events, and by encoders alone if no log needs more."""
    options, scenes = material.options, found.ground.stage.scenes
    if options.motion.source == "needed" and all(s.motion.source == "encoder" for s in scenes):
        options = replace(options, motion=replace(options.motion, source="encoder"))
    training = quiet(material.training, found.events) if found.events else material.training
    return replace(material, training=training, options=options)


def on_the_same_samples(options: DiscoverOptions, stages: Stages, robot: Robot) -> DiscoverOptions:
    """Options by which all models are judged where joints slide by the friction of these stages."""
    slowest = slides_from(TorqueModel.from_stages(stages, robot), options.motion)
    return replace(options, motion=replace(options.motion, slides_from=tuple(slowest.tolist())))


def _late(file: ParameterFile, known: Sequence[Fitted], robot: Robot) -> frozenset[Key]:
    """Effects of the file that an earlier refinement found to have come late."""
    rounds = file.closed_loop.rounds if file.closed_loop is not None else []
    names = {(r.effect, r.joint) for r in rounds if r.reason == LATE}
    keys = (key for key in map(key_of, known) if key is not None)
    return frozenset(key for key in keys if (key[0], robot.name_of(key[1])) in names)


def _add_effects(loop: Refinement, found: Investigation) -> Investigation:
    """Try the effects that are found, the largest evidence first; return what is found at last.

    What the stages had taken in of one that is added looks like a second effect, until they are
    identified without it: then the rest are judged anew. Before what is small, more is looked for.
    What lies above the low-pass at one setting is not tried at another.
    """
    refused, above = list[Candidate](), set[Key]()
    rest, looked = [*map(effect_of, found.found.effects)], True
    several = len(rest) > 1 or loop.material.options.with_unexplained
    while loop.added < loop.material.options.max_effects:
        known = [*loop.model.candidates, *refused]
        tried = [x for x in found.found.effects if effect_of(x).key not in above]
        left = [x for x in tried if not any(map(effect_of(x).is_same_as, known))]
        if not left:
            break
        taken = max(left, key=lambda taken: taken.evidence)
        step("trying effects", loop.added, loop.added + max(len(left), len(rest)))
        rest = [other for other in rest if not other.is_same_as(effect_of(taken))]
        stages = loop.model.stages
        account = _account(loop, found, taken)
        told = _round(loop, found, taken, accepted=account.accepted, reason=account.reason)
        loop.rounds.append(told)
        if account.accepted:
            loop.without = loop.without if loop.added else account.without
            loop.steps.append(account.model)
        else:
            refused.append(effect_of(taken))
            if account.unjudged:
                above.add(effect_of(taken).key)
        if several and (loop.model.stages is not stages or (len(left) == 1 and not looked)):
            model, material = loop.model, loop.material
            asked = material.now(model), material.robot, model.stages, material.options
            found, looked = investigate_beside(found, *asked, candidates=rest)
            rest = [*map(effect_of, found.found.effects)] if looked else rest
    return found


def quiet(logs: Sequence[Recording], events: Sequence[Interval]) -> tuple[Recording, ...]:
    """The logs with the events that were found in them marked as not to be used."""
    valid = [log.valid.copy() for log in logs]
    for event in events:
        t = logs[event.scene].t - logs[event.scene].t[0]
        valid[event.scene] &= (t < event.start) | (t > event.end)
    return tuple(replace(log, valid=own) for log, own in zip(logs, valid, strict=True))


def _account(loop: Refinement, found: Investigation, taken: Taken) -> Account:
    """Whether an effect was there all along, or came late, and what the model with it does.

    What is in the file's own logs was there all along. Else the account holds that explains the
    logs of all stages better; without these the one that the base speaks for. Every stage again
    is costly, and not asked for where nothing speaks for it.
    """
    candidate, late = effect_of(taken), loop.model.late
    known = loop.model.candidates
    plain = replace(candidate, absorbed="")  # beside a file that has absorbed nothing of it
    after = Account(loop, taken, (*known, plain), late | {candidate.key}, kept=True)
    early = Account(loop, taken, (*known, candidate), late, kept=False)
    hold, n = found.model.hold, found.ground.n
    loose = max(hold.rigid, *(hold.of(c % n) for c in taken.term.channels)) > 1.0
    freed = bool(candidate.absorbed) or loose  # the base had to leave the file there
    if loop.material.known or (freed and not loop.logs_before):
        return early
    had = [*known, candidate]  # what the model has not may have made up for the file there
    near = [x for x in found.found.taken if x.term.channels & taken.term.channels]
    made_up = any(x.term.smooth or not any(map(effect_of(x).is_same_as, had)) for x in near)
    if not (loop.logs_before and (after.accepted or freed or made_up)):
        return after
    lately, along = (loop.error_everywhere(one.model) for one in (after, early))
    return after if likelier(lately, along) else early


def _predicted(taken: Taken) -> Gain:
    """Share of the squared error on blocks that were left out, which the selection went by."""
    return Gain(taken.one.predicted.share, *taken.one.predicted.interval)


def _round(
    loop: Refinement, found: Investigation, taken: Taken, *, accepted: bool, reason: str
) -> RefinementRound:
    """What was tried, and what the decision rests on."""
    robot, term, change = loop.material.robot, taken.term, _predicted(taken)
    return RefinementRound(
        effect="unexplained" if term.smooth else term.name,
        joint=robot.name_of(term.joint),
        accepted=accepted,
        training_gain=change.value,
        training_interval=change.limits,
        reason=reason,
        evidence=evidence_of(found, robot, taken),
        rivals=rivals_of(robot, taken, () if term.smooth else named(taken).others),
    )


def _add_smooth(loop: Refinement, found: Investigation) -> None:
    """Add smooth terms of no known cause where they predict left-out blocks."""
    for taken in found.found.smooth:
        sure = _predicted(taken).certain
        reason = "" if sure else "does not certainly predict left-out blocks better"
        loop.rounds.append(_round(loop, found, taken, accepted=sure, reason=reason))
        if sure:
            what, model = taken.term.what, loop.model
            assert isinstance(what, SmoothFunction)
            c = what.mixing @ taken.one.gained.coefficients
            term = SmoothTerm(what.joint, what.quantities, what.axes, what.factor, c)
            loop.steps.append(replace(model, effects=(*model.effects, term)))
