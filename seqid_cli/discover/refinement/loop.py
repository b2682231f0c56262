"""The state of a refinement: the model as it grows, and what one effect more does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import structs

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement import held_out
from seqid_cli.discover.refinement.across_logs import ResultAcrossLogs
from seqid_cli.discover.refinement.held_out import BlockErrors, Gain, doubt, gain
from seqid_cli.discover.refinement.reidentify import (
    RefinementData,
    Refitted,
    fitted_smooth,
    identity,
    refitted,
    unique,
)
from seqid_cli.discover.select.naming import reality
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import TermResult
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.effects.fitted import FittedEffect, as_stage
from seqid_cli.logs.recording import Recording
from seqid_cli.params.evidence_schema import RefinementRound, RivalEntry
from seqid_cli.params.schema import EffectOfPlace, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent

FEWEST_OF_BODY = 2  # joints that a body at the flange, or a leaning base, must move
ALL_ALONG = "was there all along"
LATE = "came after the file was identified"
NOT_BETTER = "the model identified anew with it is not certainly better"


@dataclass(frozen=True, eq=False, kw_only=True)
class NextName:
    """An effect to go on with if held-out logs refuse one that explains the same.

    It was chosen before any held-out log is opened.

    Attributes
    ----------
    entry : RefinementRound
        What the logs to fit say of it.
    effect : Candidate
        The effect.
    """

    entry: RefinementRound
    effect: Candidate


@dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """What one round has added, and the model with it.

    A round adds one effect, at one joint or at several; or a smooth term.

    Attributes
    ----------
    rounds : tuple of RefinementRound
        What is told of each effect, in the order of `effects`.
    effects : tuple of Candidate
        The effects.
    smooth : SmoothFunction, optional
        The smooth term.
    keeps_stages : bool
        The stages stayed as they were in the fit.
    model : Refitted
        The model with the round.
    beside : tuple of Refitted
        Of several effects, in the same order, the model with the others of the round
        alone.
    next_names : tuple of sequence of NextName
        By effect, what is to be tried in its place if it is not confirmed.
    refused_names : tuple of str
        Other names of what it explains, that the held-out logs have refused.
    """

    rounds: tuple[RefinementRound, ...]
    effects: tuple[Candidate, ...] = ()
    smooth: SmoothFunction | None = None
    keeps_stages: bool
    model: Refitted
    beside: tuple[Refitted, ...] = ()
    next_names: tuple[Sequence[NextName], ...] = ()
    refused_names: tuple[str, ...] = ()

    @property
    def models(self) -> tuple[Refitted, ...]:
        """The model with the round, and those without one of its effects."""
        return (self.model, *self.beside)

    def without(self, removed: RefinementRound) -> Step | None:
        """Return the step without one of its effects; None if none is left.

        Its models are as they were: `again` fits the step to what is left.
        """
        staying = [
            number for number, entry in enumerate(self.rounds) if entry is not removed
        ]
        if not staying:
            return None

        return replace(
            self,
            rounds=tuple(self.rounds[number] for number in staying),
            effects=tuple(self.effects[number] for number in staying),
            next_names=tuple(self.next_names[number] for number in staying)
            if self.next_names
            else (),
        )

    def in_place_of(self, removed: RefinementRound) -> PlaceToFill | None:
        """Return what goes on in the place of one of its effects; None of a smooth."""
        if self.smooth is not None or not self.next_names:
            return None
        number = next(
            number for number, entry in enumerate(self.rounds) if entry is removed
        )
        return PlaceToFill(
            names=tuple(self.next_names[number]),
            keeps_stages=self.keeps_stages,
            refused_names=(*self.refused_names, removed.effect),
        )

    def again(self, material: RefinementData, model_before: Refitted) -> Step:
        """Return the step fitted again to the training logs, on top of another model.

        Parameters
        ----------
        material : RefinementData
            The logs.
        model_before : Refitted
            The model.
        """
        if self.smooth is not None:
            model = with_smooth_term(material, model_before, self.smooth)
            return replace(self, model=model)

        def fitted(effects: Sequence[Candidate]) -> Refitted:
            return refitted(
                material,
                model_before,
                (*model_before.candidates, *effects),
                kept=self.keeps_stages,
            )

        model = fitted(self.effects)
        beside = []
        if len(self.effects) > 1:
            for removed in self.effects:
                staying = [effect for effect in self.effects if effect is not removed]
                beside.append(fitted(staying))
        return replace(self, model=model, beside=tuple(beside))


@dataclass(frozen=True, kw_only=True)
class PlaceToFill:
    """A place at which the held-out logs have refused an effect.

    Attributes
    ----------
    names : tuple of NextName
        What else it may be, in the order in which it is tried.
    keeps_stages : bool
        The stages stay as they are in the fit.
    refused_names : tuple of str
        What the held-out logs have refused there.
    """

    names: tuple[NextName, ...]
    keeps_stages: bool
    refused_names: tuple[str, ...]


class NextStep(NamedTuple):
    """What goes on in a place, and what the logs to fit refuse there.

    Attributes
    ----------
    step : Step or None
        None where no name is left.
    refused : list of RefinementRound
        Names that are not worth it beside the model as it stands.
    """

    step: Step | None
    refused: list[RefinementRound]


@dataclass(kw_only=True)
class Refinement:
    """What is decided before any held-out log is opened.

    The first effect had to be better than the model as it came in, or the same
    identified anew.

    Attributes
    ----------
    material : RefinementData
        What models are fitted to.
    incoming_stages : Stages
        The file as it came in.
    incoming_model : Refitted
        The same as a model with effects.
    steps : list of Step
        What was added, round by round.
    refused : list of RefinementRound
        What was tried and not added.
    untried : list of EffectOfPlace
        What was found when the limit of rounds had been reached.
    tried : dict of str to list of RivalEntry
        By joint, what was looked at last beside all that was found there.
    notes : tuple of str
        What is to be said of the logs.
    """

    material: RefinementData
    incoming_stages: Stages
    incoming_model: Refitted
    steps: list[Step] = field(default_factory=list)
    refused: list[RefinementRound] = field(default_factory=list)
    untried: list[EffectOfPlace] = field(default_factory=list)
    tried: dict[str, list[RivalEntry]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    _training_errors: dict[Refitted, BlockErrors] = field(default_factory=dict)
    _earlier_errors: dict[Refitted | int, BlockErrors] = field(default_factory=dict)

    @property
    def model(self) -> Refitted:
        """The model as it stands."""
        return self.steps[-1].model if self.steps else self.incoming_model

    @property
    def stages(self) -> Stages:
        """The refined model."""
        return with_effects(self.model, self.material.robot)

    @property
    def added(self) -> int:
        """Number of rounds that have added something."""
        return len(self.steps)

    @property
    def stopped(self) -> bool:
        """Whether the limit of rounds has been reached."""
        limit = self.material.options.max_effects
        return limit is not None and self.added >= limit

    @cached_property
    def anew(self) -> Refitted:
        """The file identified anew with the training logs.

        What that gains is no effect's.
        """
        model = self.incoming_model
        return refitted(self.material, model, model.candidates, kept=False)

    def without(self, steps: Sequence[Step]) -> Refitted:
        """Return what the first of some steps has to be better than."""
        if not steps or steps[0].keeps_stages:
            return self.incoming_model
        return self.anew

    def fitted_again(self, steps: Sequence[Step], later: Sequence[Step]) -> list[Step]:
        """Return steps, and later ones fitted again to the training logs on top.

        Parameters
        ----------
        steps : sequence of Step
            What stays as it is.
        later : sequence of Step
            What came after.
        """
        path = list(steps)
        for step in later:
            model_before = path[-1].model if path else self.incoming_model
            path.append(step.again(self.material, model_before))
        return path

    def going_on(self, steps: Sequence[Step], place: PlaceToFill) -> NextStep:
        """Return a step by the next name of what held-out logs have refused.

        The logs to fit must be fitted better with it, as in every round.

        Parameters
        ----------
        steps : sequence of Step
            What stays.
        place : PlaceToFill
            The place.
        """
        model_before = steps[-1].model if steps else self.incoming_model
        options = self.material.selection_options
        names = self.material.robot.joint_names
        refused: list[RefinementRound] = []
        for number, name in enumerate(place.names):
            in_model = model_before.candidates
            if any(name.effect.is_same_as(effect) for effect in in_model):
                continue
            model = refitted(
                self.material,
                model_before,
                (*in_model, name.effect),
                kept=place.keeps_stages,
            )
            entry = structs.replace(
                name.entry,
                round=self.added + 1,
                after_refusal_of=[*place.refused_names],
            )
            step = Step(
                rounds=(entry,),
                effects=(name.effect,),
                keeps_stages=place.keeps_stages,
                model=model,
                next_names=(place.names[number + 1 :],),
                refused_names=place.refused_names,
            )
            without = model_before if steps else self.without([step])
            error_before = self.error_of(without)
            error_after = self.error_of(model)
            joints = [names.index(joint) for joint in entry.acts_on]
            change = gain(error_before, error_after, joints)
            chance_probability = doubt(error_before, error_after, joints)
            is_enough = change.value >= options.improvement
            if is_enough and chance_probability <= options.alpha:
                return NextStep(step, refused)
            refused.append(
                structs.replace(entry, round=None, accepted=False, reason=NOT_BETTER)
            )
        return NextStep(None, refused)

    def error_of(self, model: Refitted) -> BlockErrors:
        """Return squared errors of a model on the logs that are fitted."""
        if model not in self._training_errors:
            self._training_errors[model] = self._error(self.material.training, model)
        return self._training_errors[model]

    def error_everywhere(self, model: Refitted) -> BlockErrors:
        """Return squared errors of a model on all logs.

        In the logs of earlier stages what came late was not there.
        """
        lasting = tuple(model.lasting)
        # Without effects it is the stages that count: many models share them.
        key: Refitted | int = model if lasting else id(model.stages)
        if key not in self._earlier_errors:
            without_late = replace(model, effects=lasting)
            self._earlier_errors[key] = self._error(self.logs_before, without_late)
        return held_out.joined([self.error_of(model), self._earlier_errors[key]])

    @cached_property
    def logs_before(self) -> list[Recording]:
        """Logs of earlier stages with torque that are not fitted, each once."""
        fitted = {identity(log) for log in self.material.training}
        earlier = [log for logs in self.material.earlier.values() for log in logs]
        return [
            log
            for log in unique(earlier)
            if identity(log) not in fitted and log.tau is not None
        ]

    def _error(self, logs: Sequence[Recording], model: Refitted) -> BlockErrors:
        robot = self.material.robot
        return held_out.held_out_error(
            logs,
            robot,
            with_effects(model, robot),
            options=self.material.options.motion,
        )


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What the training logs say of one effect of a round, beside all others.

    Attributes
    ----------
    change : Gain
        At its joints, on the logs that are fitted.
    min_gain : float
        The least that counts.
    chance_probability : float
        Probability that nothing is gained there.
    is_likely : bool
        Whether it is likelier there than not, by what is gained, or proven.
    is_determined : bool
        Whether its coefficients are larger than their errors.
    is_shown : bool
        Whether the logs go through it often enough, and a body moves several joints.
    lacking : str
        Why its parameters do not follow from its coefficients; empty if they do.
    is_unjudged : bool
        Whether it may be there, but above the low-pass, where no model is judged.
    """

    change: Gain
    min_gain: float
    chance_probability: float
    is_likely: bool
    is_determined: bool
    is_shown: bool
    lacking: str
    is_unjudged: bool

    @property
    def gains(self) -> bool:
        """Whether it gains as much as a finding does, and not by chance."""
        is_enough = self.change.value >= self.min_gain
        return is_enough and self.chance_probability <= Options.alpha

    @property
    def fault(self) -> str:
        """Why it is not worth it; empty if it is."""
        if self.is_unjudged and not self.gains:
            return "lies above the low-pass, where the model is not judged"
        if not self.gains:
            return NOT_BETTER
        if not self.is_likely:
            return "is less likely than not"
        if not self.is_shown:
            return "these logs show too little of it"
        if self.lacking:
            return f"is not determined by these logs: {self.lacking}"
        if not self.is_determined:
            return "its coefficients are smaller than their errors"
        return ""


@dataclass(frozen=True, eq=False, kw_only=True)
class CandidateModel:
    """A model with the effects of one round more, and when these came.

    The effects of a round are one hypothesis, an effect at one joint or at several.

    Attributes
    ----------
    loop : Refinement
        The refinement as it stands.
    results : tuple of TermResult
        What was selected.
    effects : tuple of Candidate
        The same as it is to be fitted.
    keeps_stages : bool
        The stages are right as they are, and the effects came after the file was
        identified.
    """

    loop: Refinement
    results: tuple[TermResult, ...]
    effects: tuple[Candidate, ...]
    keeps_stages: bool

    @cached_property
    def model(self) -> Refitted:
        """The model fitted to all logs."""
        model_before = self.loop.model
        return refitted(
            self.loop.material,
            model_before,
            (*model_before.candidates, *self.effects),
            kept=self.keeps_stages,
        )

    @cached_property
    def without(self) -> Refitted:
        """The model as it stands; before the first effect by the recipe of this one."""
        if self.keeps_stages or self.loop.added:
            return self.loop.model
        return self.loop.anew

    @cached_property
    def without_each(self) -> tuple[CandidateModel, ...]:
        """The candidate models without each of the effects, one at a time."""
        models = []
        for removed in range(len(self.effects)):
            staying = [k for k in range(len(self.effects)) if k != removed]
            models.append(
                replace(
                    self,
                    results=tuple(self.results[k] for k in staying),
                    effects=tuple(self.effects[k] for k in staying),
                )
            )
        return tuple(models)

    def with_simpler(self, number: int) -> CandidateModel | None:
        """Return the model with an effect in a form of fewer coefficients, if any."""
        effect = self.effects[number]
        settings = effect.effect.simpler(effect.settings)
        if settings is None:
            return None
        effects = list(self.effects)
        effects[number] = replace(effect, settings=settings)
        return replace(self, effects=tuple(effects))

    @cached_property
    def judgements(self) -> tuple[Judgement, ...]:
        """What the training logs say of each effect, all others of the model beside."""
        return tuple(self._judged(number) for number in range(len(self.effects)))

    def _judged(self, number: int) -> Judgement:
        """Compare the model with one that is fitted without the effect."""
        has_others = len(self.effects) > 1
        without = self.without_each[number].model if has_others else self.without
        error_before = self.loop.error_of(without)
        error_after = self.loop.error_of(self.model)

        result = self.results[number]
        joints = joints_below(result.term.channels, self.loop.material.robot.n)
        change = gain(error_before, error_after, joints)
        probability = reality(max(change.value, result.share), result.evidence)
        # What whole logs that were left out prove needs no odds of what is usual.
        is_proven = isinstance(result, ResultAcrossLogs) and result.across.is_proven(
            self.loop.material.selection_options.improvement
        )
        robot = self.loop.material.robot
        effect = self.effects[number]
        scenes = self.loop.material.ground(self.loop.model).stage.scenes
        is_shown = effect.effect.shows(scenes, effect.joint, effect.settings)
        if effect.effect.family == "body" and effect.effect.arm:
            # What one joint alone shows may be that joint's.
            gaining = [
                joint
                for joint in joints
                if gain(error_before, error_after, [joint]).certain
            ]
            is_shown = is_shown and len(gaining) >= min(FEWEST_OF_BODY, robot.n)
        return Judgement(
            change=change,
            min_gain=self.loop.material.selection_options.improvement,
            chance_probability=doubt(error_before, error_after, joints),
            is_likely=is_proven or probability > 0.5,
            is_determined=self._size(number) > 1.0,
            is_shown=is_shown,
            lacking=effect.effect.lacking(robot, effect.joint),
            is_unjudged=self.effects[number].effect.wide,
        )

    def _size(self, number: int) -> float:
        """Return an effect's coefficients over their errors, root mean square."""
        key = self.effects[number].key
        same = [
            effect
            for effect in self.model.effects
            if isinstance(effect, FittedEffect)
            and (effect.effect.name, effect.joint) == key
        ]
        if not same:  # no row shows it
            return 0.0
        effect = same[-1]
        variance = np.diag(effect.covariance)
        is_known = variance > 0.0
        if not is_known.any():
            return np.inf
        squares = effect.coefficients[is_known] ** 2 / variance[is_known]
        return float(np.sqrt(np.mean(squares)))

    @cached_property
    def losing(self) -> list[int]:
        """Joints that lose more than all others gain."""
        joints = range(self.loop.material.robot.n)
        error_before = self.loop.error_of(self.without)
        error_after = self.loop.error_of(self.model)
        if gain(error_before, error_after, joints).value > 0.0:
            return []
        return [
            joint for joint in joints if gain(error_before, error_after, [joint]).loses
        ]

    @property
    def accepted(self) -> bool:
        """Whether all its effects are worth it."""
        has_fault = any(judgement.fault for judgement in self.judgements)
        return not has_fault and not self.losing

    @property
    def weakest(self) -> int:
        """Number of the effect that is least worth it.

        It is the one of the least gain among those with a fault, or among all.
        """
        faulty = [
            number
            for number, judgement in enumerate(self.judgements)
            if judgement.fault
        ]
        numbers = faulty or range(len(self.effects))
        return min(numbers, key=lambda number: self.judgements[number].change.value)

    def fault_of(self, number: int) -> str:
        """Return why an effect is refused."""
        names = self.loop.material.robot.joint_names
        losing_names = ", ".join(names[joint] for joint in self.losing)
        loss = f"the model identified anew with it predicts {losing_names} worse"
        return self.judgements[number].fault or loss


class Refusal(NamedTuple):
    """An effect that is refused, how it was judged, and why.

    Without a judgement it was not tried.
    """

    result: TermResult
    judgement: Judgement | None
    reason: str

    @classmethod
    def across_logs(cls, result: ResultAcrossLogs) -> Refusal:
        """Return the refusal of an effect that whole logs disprove."""
        across = result.across
        worst = across.worst
        reason = (
            "does not certainly predict whole logs that were left out:"
            f" {Path(worst).name} {_in_words(across.of_each[worst])}"
        )
        return cls(result=result, judgement=None, reason=reason)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What is added in a round, and what of it is refused.

    Attributes
    ----------
    candidate_model : CandidateModel
        With the effects that are worth it, maybe none.
    refused : tuple of Refusal
        The others.
    """

    candidate_model: CandidateModel
    refused: tuple[Refusal, ...]

    @classmethod
    def of(cls, candidate_model: CandidateModel) -> Decision:
        """Leave out, the weakest first, what is not worth it beside the others.

        An effect whose coefficients are smaller than their errors is first tried in
        simpler forms.
        """
        refused = []
        while candidate_model.effects and not candidate_model.accepted:
            number = candidate_model.weakest
            judgement = candidate_model.judgements[number]
            is_unclear = judgement.gains and not judgement.is_determined
            simpler = candidate_model.with_simpler(number) if is_unclear else None
            if simpler is not None:
                candidate_model = simpler
                continue
            refused.append(
                Refusal(
                    result=candidate_model.results[number],
                    judgement=judgement,
                    reason=candidate_model.fault_of(number),
                )
            )
            candidate_model = candidate_model.without_each[number]
        return cls(candidate_model=candidate_model, refused=tuple(refused))


def _in_words(share: float) -> str:
    """Say a share of the squared error that goes."""
    if share < 0.0:
        return f"{percent(-share)} worse"
    return f"{percent(share)} better at most"


def effect_of(result: TermResult) -> Candidate:
    """Return the effect that a term is."""
    assert isinstance(result.term.what, Candidate)
    return result.term.what


def with_smooth_term(
    material: RefinementData, model: Refitted, function: SmoothFunction
) -> Refitted:
    """Return a model with one smooth term more, fitted to what the model leaves."""
    term = fitted_smooth(material, model, function)
    return replace(model, effects=(*model.effects, term))


def with_effects(model: Refitted, robot: Robot) -> Stages:
    """Return the stages with the effects written into them."""
    effects = []
    for effect in model.effects:
        if isinstance(effect, FittedEffect):
            effects.append(as_stage(effect, robot))
        else:
            effects.append(effect.to_stage(robot))
    return msgspec.structs.replace(model.stages, effects=effects)
