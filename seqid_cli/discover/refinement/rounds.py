"""Refinement: add what a model lacks, as long as left-out blocks of time are predicted better.

An investigation of the training logs names the effects that the model lacks, each beside all
others, by how much better it predicts blocks that were left out (see `select`). They are taken one
after the other, first what a base that leaves the file explains least. Model and effects are fitted
anew, under two accounts where the file is of other logs: that the effect was there all along, or
that it came after the file was identified (see `reidentify`). The errors on all logs, those of the
earlier stages among them, tell which. An effect that does not help the model fitted anew, or by
which other joints lose more than its own gain, is refused, with that reason.

Held-out logs play no part in any of this: `refine` is not given them. What they say of the result
is in `confirm`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.evidence import evidence_of
from seqid_cli.discover.investigate import Investigation, investigate, investigate_beside
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import LEAST_GAIN, Gain, doubt, gain, likelier
from seqid_cli.discover.refinement.loop import Account, Loop, candidates_of_model, with_effects
from seqid_cli.discover.refinement.material import Key, Material, Refitted, key_of
from seqid_cli.discover.rivals import rivals_of
from seqid_cli.discover.scenes import with_own_cutoffs
from seqid_cli.discover.select.naming import named, reality
from seqid_cli.discover.select.results import Options, Taken
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.survey.events import Interval
from seqid_cli.discover.survey.usable import usable_logs
from seqid_cli.identify.prediction.predict import slides_from
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.working import step

ALL_ALONG = "was there all along"
LATE = "came after the file was identified"
PROBABLE = 0.5  # probability of being there from which an effect is added
TRIED = Options(improvement=LEAST_GAIN)  # what is tried need not be worth a finding


@dataclass(frozen=True)
class Refinement:
    """What was decided, before any held-out log is opened.

    `steps` are the model as it came in and that after each effect that was added, the last one the
    result; `without` is what the first effect had to be better than: the model as it came in, or
    the same identified anew. `material` is what they were fitted to, `came` the stages at first.
    """

    material: Material
    came: Stages
    rounds: tuple[RefinementRound, ...]
    steps: tuple[Refitted, ...]
    without: Refitted
    notes: tuple[str, ...] = ()

    @property
    def stages(self) -> Stages:
        """The refined model."""
        return with_effects(self.steps[-1], self.material.robot)


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
    logs, stages = material.now(start), start.stages
    found = investigate(logs, robot, stages, options, least=0.0, selection=TRIED)
    smooth = options.with_unexplained and bool(found.found.smooth)
    if not (found.found.effects or smooth):
        return Refinement(material, file.stages, (), (start,), start, notes)
    loop = Loop(_heard(material, found), [start], start)
    found = _add_effects(loop, found)
    if options.with_unexplained:
        _add_smooth(loop, found)
    rounds, steps = tuple(loop.rounds), tuple(loop.steps)
    return Refinement(material, file.stages, rounds, steps, loop.without, notes)


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


def _add_effects(loop: Loop, found: Investigation) -> Investigation:
    """Try the effects that are found, the largest evidence first; return what is found at last.

    What the stages had taken in of one that is added looks like a second effect, until they are
    identified without it: then the rest are judged anew. Before what is small, more is looked for.
    """
    refused, rest, looked = list[Candidate](), [*map(_what, found.found.effects)], True
    several = len(rest) > 1 or loop.material.options.with_unexplained
    while loop.added < loop.material.options.max_effects:
        known = [*candidates_of_model(loop.model.effects), *refused]
        left = [x for x in found.found.effects if not _among(_what(x), known)]
        if not left:
            break
        taken = max(left, key=lambda taken: taken.evidence)
        step("trying effects", loop.added, loop.added + max(len(left), len(rest)))
        rest = [other for other in rest if not other.is_same_as(_what(taken))]
        stages = loop.model.stages
        accepted = _try(loop, found, taken)
        if not accepted:
            refused.append(_what(taken))
        if several and (loop.model.stages is not stages or (len(left) == 1 and not looked)):
            model, material = loop.model, loop.material
            found, looked = investigate_beside(
                found,
                material.now(model),
                material.robot,
                model.stages,
                material.options,
                candidates=rest,
                selection=TRIED,
            )
            rest = [*map(_what, found.found.effects)] if looked else rest
    return found


def _what(taken: Taken) -> Candidate:
    what = taken.term.what
    assert isinstance(what, Candidate)
    return what


def _among(one: Candidate, others: Sequence[Candidate]) -> bool:
    return any(one.is_same_as(other) for other in others)


def quiet(logs: Sequence[Recording], events: Sequence[Interval]) -> tuple[Recording, ...]:
    """The logs with the events that were found in them marked as not to be used."""
    valid = [log.valid.copy() for log in logs]
    for event in events:
        t = logs[event.scene].t - logs[event.scene].t[0]
        valid[event.scene] &= (t < event.start) | (t > event.end)
    return tuple(replace(log, valid=own) for log, own in zip(logs, valid, strict=True))


@dataclass(frozen=True)
class Outcome:
    """What the model fitted anew with one effect more says of it, at the effect's joints."""

    change: Gain  # of the squared error
    doubt: float  # probability that nothing is gained
    likely: float  # probability of being there, by that change
    losing: tuple[int, ...]  # joints that lose more than all others gain

    @property
    def gains(self) -> bool:
        """Whether it gains enough, and not by chance."""
        return self.change.value >= LEAST_GAIN and self.doubt <= Options.doubt

    @property
    def accepted(self) -> bool:
        """Whether it is worth it."""
        return self.gains and self.likely > PROBABLE and not self.losing


def _try(loop: Loop, found: Investigation, taken: Taken) -> bool:
    """Fit the model with one effect more; keep it if that helps."""
    account, outcome = _account(loop, found, taken)
    reason = _reason(loop.material.robot.joint_names, _what(taken), account, outcome)
    told = _round(loop, found, taken, accepted=outcome.accepted, reason=reason)
    if outcome.accepted:
        loop.accept(told, account)
    else:
        loop.rounds.append(told)
    return outcome.accepted


def _account(loop: Loop, found: Investigation, taken: Taken) -> tuple[Account, Outcome]:
    """Whether an effect was there all along, or came late, and what the model with it does.

    What is in the logs that the file was identified from was there all along. Else the account
    holds that explains the logs of all stages better; where the file's logs are not at hand, that
    which the base speaks for at the effect's joints. An effect that is refused as a late one is not
    asked about if it is no finding, or if nothing speaks for the other account: that costs every
    stage again.
    """
    candidate, late = _what(taken), loop.model.late
    known = candidates_of_model(loop.model.effects)
    after = Account(loop, (*known, candidate.plain), late | {candidate.key}, kept=True)
    early = Account(loop, (*known, candidate), late, kept=False)
    hold, n = found.model.hold, found.ground.n
    loose = max(hold.rigid, *(hold.of(c % n) for c in taken.term.channels)) > 1.0
    freed = bool(candidate.absorbed) or loose  # the base had to leave the file there
    if loop.material.known or (freed and not loop.logs_before):
        return early, _outcome(loop, early, taken)
    outcome = _outcome(loop, after, taken)
    finding = taken.one.predicted.share > Options.improvement
    asked = outcome.accepted or (finding and (freed or _has_company(loop, found, taken)))
    if not (loop.logs_before and asked):
        return after, outcome
    early = replace(early, rival=after)
    account = after if likelier(after.everywhere, early.everywhere) else early
    return account, _outcome(loop, account, taken)


def _has_company(loop: Loop, found: Investigation, taken: Taken) -> bool:
    """Whether a term that the model has not made up for the file at an effect's joints."""
    known = [*candidates_of_model(loop.model.effects), _what(taken)]
    others = [x for x in found.found.taken if x.term.smooth or not _among(_what(x), known)]
    return any(x.term.channels & taken.term.channels for x in others)


def _outcome(loop: Loop, account: Account, taken: Taken) -> Outcome:
    before, after, n = loop.error_of(account.without), account.error, loop.material.robot.n
    own = joints_below(taken.term.channels, n)
    change = gain(before, after, own)
    each = [gain(before, after, [j]) for j in range(n)]
    better = gain(before, after, range(n)).value > 0.0
    losing = () if better else tuple(j for j, g in enumerate(each) if g.loses)
    likely = reality(max(change.value, taken.share), taken.evidence)
    return Outcome(change, doubt(before, after, own), likely, losing)


def _predicted(taken: Taken) -> Gain:
    """Share of the squared error on blocks that were left out, which the selection went by."""
    told = taken.one.predicted
    return Gain(told.share, *told.interval)


def _round(
    loop: Loop, found: Investigation, taken: Taken, *, accepted: bool, reason: str
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


def _reason(names: Sequence[str], candidate: Candidate, account: Account, outcome: Outcome) -> str:
    """Why an effect was refused, or when one that was added came."""
    if outcome.accepted:
        return LATE if candidate.key in account.late else ALL_ALONG
    if candidate.effect.wide and abs(outcome.change.value) < LEAST_GAIN:
        return "lies above the low-pass, where the model is not judged"
    if outcome.gains and outcome.likely <= PROBABLE:
        return "is less likely than not"
    if outcome.gains:
        lost = ", ".join(names[j] for j in outcome.losing)
        return f"the model identified anew with it predicts {lost} worse"
    return "the model identified anew with it is not certainly better"


def _add_smooth(loop: Loop, found: Investigation) -> None:
    """Add smooth terms of no known cause where they predict left-out blocks."""
    for taken in found.found.smooth:
        sure = _predicted(taken).certain
        reason = "" if sure else "does not certainly predict left-out blocks better"
        loop.rounds.append(_round(loop, found, taken, accepted=sure, reason=reason))
        if sure:
            what, model = taken.term.what, loop.model
            assert isinstance(what, SmoothFunction)
            term = what.term(taken.one.gained.coefficients)
            loop.steps.append(replace(model, effects=(*model.effects, term)))
