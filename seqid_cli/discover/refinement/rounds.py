"""Refinement: add what a model lacks, as long as left-out blocks of time are predicted better.

An investigation of the training logs names the effects that the model lacks, each beside all others
(see `select`). They are tried one after the other, the largest gain first: model and effects are
fitted anew under two accounts, that the effect was there all along, or that it came after the file
was identified (see `reidentify`). Both are fitted without some blocks of the training logs, which
they then predict. These blocks decide which account holds, and whether the effect is added at all.
An effect that helps one joint at the expense of another is refused, with that reason.

Held-out logs play no part in any of this: `refine` is not given them. What they say of the result
is in `confirm`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.evidence import evidence_of
from seqid_cli.discover.investigate import Investigation, investigate
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import LEAST_GAIN, Gain, gain, gain_of
from seqid_cli.discover.refinement.left_out import FOLDS, STRETCH_S, Folds
from seqid_cli.discover.refinement.loop import Account, Loop, candidates_of_model, with_effects
from seqid_cli.discover.refinement.material import Key, Material, Refitted, key_of
from seqid_cli.discover.rivals import rivals_of
from seqid_cli.discover.select.naming import named
from seqid_cli.discover.select.results import Options, Taken
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.survey.events import Interval
from seqid_cli.discover.survey.usable import usable_logs
from seqid_cli.identify.prediction.predict import slides_from
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, FittedTerm, fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.schema import ParameterFile, RefinementRound, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.working import step

ALL_ALONG = "was there all along"
LATE = "came after the file was identified"
# Of its squared error a joint may lose where others gain: so much, or a share of what these gain.
TOLERATED, EXCHANGE = 0.05, 0.2


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

    Parameters
    ----------
    training : sequence of Recording
        Logs to fit.
    robot : Robot
    file : ParameterFile
        The model as it comes in.
    earlier : mapping of stage name to recordings
        Logs that the file's stages were identified from, where they are at hand.
    options : DiscoverOptions

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    """
    training, notes = usable_logs(training, robot)
    options = on_the_same_samples(options, file.stages, robot)
    material = Material(tuple(training), earlier, robot, options)
    known = fitted_effects(file.stages, robot, unexplained=True)
    bare = msgspec.structs.replace(file.stages, effects=None)
    start = Refitted(bare, tuple(known), _late(file, known, robot))
    if Folds.of(training).count < 2:
        said = (*notes, _too_short(training))
        return Refinement(material, file.stages, (), (start,), start, said)
    found = _investigated(material, start)
    smooth = options.with_unexplained and bool(found.found.smooth)
    if not (found.found.effects or smooth):
        return Refinement(material, file.stages, (), (start,), start, notes)
    heard = replace(material, training=quiet(training, found.events)) if found.events else material
    loop = Loop.begin(heard, start)
    _add_effects(loop, found)
    if options.with_unexplained:
        _add_smooth(loop, _investigated(material, loop.model) if loop.added else found)
    rounds, steps = tuple(loop.rounds), tuple(loop.steps)
    return Refinement(material, file.stages, rounds, steps, loop.without, notes)


def on_the_same_samples(options: DiscoverOptions, stages: Stages, robot: Robot) -> DiscoverOptions:
    """Options by which all models are judged where joints slide by the friction of these stages."""
    slowest = slides_from(TorqueModel.from_stages(stages, robot), options.motion)
    return replace(options, motion=replace(options.motion, slides_from=tuple(slowest.tolist())))


def _too_short(training: Sequence[Recording]) -> str:
    length = sum(float(log.t[-1] - log.t[0]) for log in training)
    return (
        f"the logs to fit are too short to leave blocks of them out ({length:.0f} s in all): "
        f"nothing could be decided, so nothing was added; {FOLDS * STRETCH_S:.0f} s or more of one "
        "log, or several logs, are needed"
    )


def _late(file: ParameterFile, known: Sequence[Fitted], robot: Robot) -> frozenset[Key]:
    """Effects of the file that an earlier refinement found to have come late."""
    rounds = file.closed_loop.rounds if file.closed_loop is not None else []
    names = {(r.effect, r.joint) for r in rounds if r.reason == LATE}
    keys = [key for key in map(key_of, known) if key is not None]
    return frozenset(
        key
        for key in keys
        if (key[0], None if key[1] is None else robot.joint_names[key[1]]) in names
    )


def _investigated(material: Material, model: Refitted) -> Investigation:
    """Find what the model, with its effects, may lack: candidates that are tried, not reported."""
    logs, stages, tried = material.now(model), model.stages, Options(improvement=LEAST_GAIN)
    return investigate(logs, material.robot, stages, material.options, least=0.0, selection=tried)


def _add_effects(loop: Loop, found: Investigation) -> None:
    """Try each effect that was found, and keep those that left-out blocks agree with."""
    ordered = sorted(found.found.effects, key=lambda taken: -taken.one.predicted.total)
    for number, taken in enumerate(ordered):
        what = taken.term.what
        step("trying effects on left-out blocks", number, len(ordered))
        assert isinstance(what, Candidate)
        if loop.added < loop.material.options.max_effects and not _had(loop, what):
            _try(loop, what, found, taken)


def _had(loop: Loop, candidate: Candidate) -> bool:
    """Whether the model has the very effect; a joint may have several ripples and lines."""
    if candidate.effect.wide:
        return False
    kinds = [s.name for s in candidate.effect.settings if not s.continuous]
    return any(
        known.key == candidate.key
        and all(known.settings[kind] == candidate.settings[kind] for kind in kinds)
        for known in candidates_of_model(loop.model.effects)
    )


def quiet(logs: Sequence[Recording], events: Sequence[Interval]) -> tuple[Recording, ...]:
    """The logs with the events that were found in them marked as not to be used."""
    result = []
    for number, log in enumerate(logs):
        t, valid = log.t - log.t[0], log.valid.copy()
        for event in events:
            if event.scene == number:
                valid &= (t < event.start) | (t > event.end)
        result.append(replace(log, valid=valid))
    return tuple(result)


@dataclass(frozen=True)
class Outcome:
    """What the left-out blocks say of one effect more."""

    change: Gain  # at the joints of the effect
    whole: Gain
    losing: tuple[int, ...]  # joints that lose more than is tolerated

    @property
    def accepted(self) -> bool:
        """Whether they are predicted better."""
        return self.change.certain and self.whole.value > 0.0 and not self.losing


def _try(loop: Loop, candidate: Candidate, found: Investigation, taken: Taken) -> None:
    """Fit the models of the folds with one effect more; keep it if left-out blocks agree."""
    tried: list[tuple[Account, Outcome]] = []
    for account in map(loop.fitted, _accounts(loop, candidate)):
        tried.append((account, _outcome(loop, account, taken.term.channels)))
        if tried[-1][1].accepted:
            break
    account, outcome = tried[-1] if tried[-1][1].accepted else tried[0]
    told = _shown(loop, _told(loop, candidate, account, outcome), found, taken)
    if outcome.accepted:
        loop.accept(told, account)
    else:
        loop.rounds.append(told)


def _accounts(loop: Loop, candidate: Candidate) -> list[Account]:
    """The accounts of one effect more, the one first that explains the logs of all stages better.

    A first look decides which. What is in the logs that the file was identified from was there all
    along.
    """
    every, late = (*candidates_of_model(loop.model.effects), candidate), loop.model.late
    early = Account(every, late, kept=False)
    if loop.material.known:
        return [early]
    after = Account(every, late | {candidate.key}, kept=True)
    looks = [loop.fitted(account, folds=1) for account in (early, after)]
    before, then = map(loop.error_everywhere, looks)
    change = gain(before, then, range(loop.material.robot.n))
    return looks[::-1] if change.value > 0.0 else looks


def _outcome(loop: Loop, account: Account, channels: frozenset[int]) -> Outcome:
    before, after = loop.error_of(loop.best), loop.error_of(account)
    n = loop.material.robot.n
    change = gain(before, after, [j for j in channels if j < n])
    tolerated = max(TOLERATED, EXCHANGE * change.value)
    each = [gain(before, after, [j]) for j in range(n)]
    losing = tuple(j for j, g in enumerate(each) if g.loses and g.value < -tolerated)
    return Outcome(change, gain(before, after, range(n)), losing)


def _told(loop: Loop, candidate: Candidate, account: Account, outcome: Outcome) -> RefinementRound:
    names, change = loop.material.robot.joint_names, outcome.change
    return RefinementRound(
        effect=candidate.effect.name,
        joint=None if candidate.joint is None else names[candidate.joint],
        accepted=outcome.accepted,
        training_gain=change.value,
        training_interval=change.limits,
        reason=_reason(names, candidate, account, outcome),
    )


def _shown(
    loop: Loop, told: RefinementRound, found: Investigation, taken: Taken
) -> RefinementRound:
    """A round with what it rests on."""
    robot, alike = loop.material.robot, () if taken.term.smooth else named(taken).others
    shown = evidence_of(found, robot, taken)
    return msgspec.structs.replace(told, evidence=shown, rivals=rivals_of(robot, taken, alike))


def _reason(names: Sequence[str], candidate: Candidate, account: Account, outcome: Outcome) -> str:
    """Why an effect was refused, or when one that was added came."""
    change = outcome.change
    if outcome.accepted:
        return LATE if candidate.key in account.late else ALL_ALONG
    if candidate.effect.wide and abs(change.value) < LEAST_GAIN:
        return "lies above the low-pass, where the model is not judged"
    if outcome.losing and change.certain:
        lost = ", ".join(names[j] for j in outcome.losing)
        return f"predicts {lost} worse on left-out blocks"
    if not change.limits:
        return "the logs are too short to tell: a single block of time is left out"
    return "does not certainly predict left-out blocks better"


def _add_smooth(loop: Loop, found: Investigation) -> None:
    """Add smooth terms of no known cause where they predict left-out blocks."""
    for taken in found.found.smooth:
        told = _shown(loop, _told_smooth(loop, taken), found, taken)
        loop.rounds.append(told)
        if told.accepted:
            what, model = taken.term.what, loop.model
            assert isinstance(what, SmoothFunction)
            term = FittedTerm(what.term(taken.one.gained.coefficients))
            loop.steps.append(replace(model, effects=(*model.effects, term)))


def _told_smooth(loop: Loop, taken: Taken) -> RefinementRound:
    told, joint = taken.one.predicted, taken.term.joint
    assert joint is not None
    change = gain_of(told.rows + 2.0 * told.density, told.rows)
    return RefinementRound(
        effect="unexplained",
        joint=loop.material.robot.joint_names[joint],
        accepted=change.certain,
        training_gain=change.value,
        training_interval=change.limits,
        reason="" if change.certain else "does not certainly predict left-out blocks better",
    )
