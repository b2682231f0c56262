"""The state of a refinement: the model as it grows, and what comes of one effect more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import msgspec
import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement import held_out
from seqid_cli.discover.refinement.held_out import Gain, HeldOutError, doubt, gain
from seqid_cli.discover.refinement.reidentify import (
    Material,
    Refitted,
    fitted_smooth,
    identity,
    refitted,
    unique,
)
from seqid_cli.discover.select.naming import reality
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import Key, TermResult
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import FittedEffect, as_stage
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

ALL_ALONG = "was there all along"
LATE = "came after the file was identified"


@dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """What one round has added, and the model with it.

    A round adds one effect, at one joint or at several; or a smooth term. `rounds`
    tells of each effect in the order of `effects`. `keeps_stages`: the stages stayed as they
    were in the fit. Of several effects `beside` has, in the same order, the model with
    the others of the round alone.
    """

    rounds: tuple[RefinementRound, ...]
    effects: tuple[Candidate, ...] = ()
    smooth: SmoothFunction | None = None
    keeps_stages: bool
    model: Refitted
    beside: tuple[Refitted, ...] = ()

    @property
    def models(self) -> tuple[Refitted, ...]:
        """The model with the round, and those without one of its effects."""
        return (self.model, *self.beside)

    def without(self, gone: RefinementRound) -> Step | None:
        """Return the step without one of its effects; None if none is left.

        Its models are as they were: `again` fits the step to what is left.
        """
        left = [number for number, entry in enumerate(self.rounds) if entry is not gone]
        if not left:
            return None

        return replace(
            self,
            rounds=tuple(self.rounds[number] for number in left),
            effects=tuple(self.effects[number] for number in left),
        )

    def again(self, material: Material, before: Refitted) -> Step:
        """Return the step fitted again to the training logs, on top of another model."""
        if self.smooth is not None:
            term = fitted_smooth(material, before, self.smooth)
            return replace(self, model=replace(before, effects=(*before.effects, term)))

        late = self.model.late

        def fitted(effects: Sequence[Candidate]) -> Refitted:
            return refitted(
                material,
                before,
                (*before.candidates, *effects),
                late=before.late | ({effect.key for effect in effects} & late),
                kept=self.keeps_stages,
            )

        others: list[tuple[Candidate, ...]] = []
        if len(self.effects) > 1:
            others = [
                tuple(x for x in self.effects if x is not one) for one in self.effects
            ]
        return replace(
            self, model=fitted(self.effects), beside=tuple(map(fitted, others))
        )


@dataclass
class Refinement:
    """What is decided before any held-out log is opened.

    The first effect had to be better than the model as it came in, or the same
    identified anew. `untried` are effects that were found when the limit of rounds had
    been reached.
    """

    material: Material  # what models are fitted to
    incoming_stages: Stages
    incoming_model: Refitted  # the model as it came in
    steps: list[Step] = field(default_factory=list)
    refused: list[RefinementRound] = field(default_factory=list)
    untried: list[Candidate] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    _errors: dict[Refitted, HeldOutError] = field(default_factory=dict)
    _before: dict[Refitted | int, HeldOutError] = field(default_factory=dict)

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
        """The file identified anew with the training logs: what that gains is no effect's."""
        start = self.incoming_model
        return refitted(
            self.material, start, start.candidates, late=start.late, kept=False
        )

    def without(self, steps: Sequence[Step]) -> Refitted:
        """Return what the first of some steps has to be better than."""
        return self.incoming_model if not steps or steps[0].keeps_stages else self.anew

    def fitted_again(self, steps: Sequence[Step], later: Sequence[Step]) -> list[Step]:
        """Return steps and `later` ones, these fitted again to the training logs on top of them."""
        path = list(steps)
        for step in later:
            before = path[-1].model if path else self.incoming_model
            path.append(step.again(self.material, before))
        return path

    def error_of(self, model: Refitted) -> HeldOutError:
        """Squared errors of a model on the logs that are fitted."""
        if model not in self._errors:
            self._errors[model] = self._error(self.material.training, model)
        return self._errors[model]

    def error_everywhere(self, model: Refitted) -> HeldOutError:
        """The same, beside those on logs of earlier stages, without what came late."""
        lasting = tuple(model.lasting)
        key: Refitted | int = model if lasting else id(model.stages)
        if key not in self._before:
            self._before[key] = self._error(
                self.logs_before, replace(model, effects=lasting)
            )
        return held_out.joined([self.error_of(model), self._before[key]])

    @cached_property
    def logs_before(self) -> list[Recording]:
        """The logs of earlier stages with torque that are not fitted, each once."""
        fitted = {identity(log) for log in self.material.training}
        every = unique([log for own in self.material.earlier.values() for log in own])
        return [x for x in every if identity(x) not in fitted and x.tau is not None]

    def _error(self, logs: Sequence[Recording], model: Refitted) -> HeldOutError:
        robot, options = self.material.robot, self.material.options.motion
        return held_out.held_out_error(
            logs, robot, with_effects(model, robot), options=options
        )


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What the training logs say of one effect of a round, beside all others of the model.

    `change` is its gain at its joints on the logs that are fitted, `by_chance` the
    probability that nothing is gained there.
    """

    change: Gain
    by_chance: float
    likely: bool  # whether it is likelier there than not, by what is gained
    shown: bool  # whether its coefficients are larger than their errors
    # whether it may be there, but above the low-pass, where no model is judged
    unjudged: bool

    @property
    def gains(self) -> bool:
        """Whether it gains as much as a finding does, and not by chance."""
        return (
            self.change.value >= Options.improvement and self.by_chance <= Options.doubt
        )

    @property
    def fault(self) -> str:
        """Return why it is not worth it; empty if it is."""
        if self.unjudged and not self.gains:
            return "lies above the low-pass, where the model is not judged"
        if not self.gains:
            return "the model identified anew with it is not certainly better"
        if not self.likely:
            return "is less likely than not"
        if not self.shown:
            return "its coefficients are smaller than their errors"
        return ""


@dataclass(frozen=True, eq=False, kw_only=True)
class CandidateModel:
    """A model with the effects of one round more, and when these came.

    The effects of a round are one hypothesis, an effect at one joint or at several.
    `results` is what was selected, `effects` the effects as they are to be fitted. `keeps_stages`:
    the stages are right as they are, and the effects came after the file was
    identified.
    """

    loop: Refinement
    results: tuple[TermResult, ...]
    effects: tuple[Candidate, ...]
    keeps_stages: bool

    @property
    def late(self) -> frozenset[Key]:
        """Effects of the model that came after the file was identified."""
        new = {effect.key for effect in self.effects} if self.keeps_stages else set()
        return self.loop.model.late | new

    @cached_property
    def model(self) -> Refitted:
        """Fitted to all logs."""
        known = self.loop.model
        candidates = (*known.candidates, *self.effects)
        material = self.loop.material
        return refitted(
            material, known, candidates, late=self.late, kept=self.keeps_stages
        )

    @cached_property
    def without(self) -> Refitted:
        """The model as it stands; before the first effect by the same recipe as this one."""
        return (
            self.loop.model if self.keeps_stages or self.loop.added else self.loop.anew
        )

    @cached_property
    def without_each(self) -> tuple[CandidateModel, ...]:
        """The candidate models without each of its effects, one at a time."""
        candidate_models = []
        for number in range(len(self.effects)):
            left = [other for other in range(len(self.effects)) if other != number]
            candidate_models.append(
                replace(
                    self,
                    results=tuple(self.results[other] for other in left),
                    effects=tuple(self.effects[other] for other in left),
                )
            )
        return tuple(candidate_models)

    def with_simpler(self, number: int) -> CandidateModel | None:
        """Return the model with an effect in a form of fewer coefficients, if any."""
        effect = self.effects[number]
        settings = effect.effect.simpler(effect.settings)
        if settings is None:
            return None
        simpler = replace(effect, settings=settings)
        return replace(
            self, effects=(*self.effects[:number], simpler, *self.effects[number + 1 :])
        )

    @cached_property
    def judgements(self) -> tuple[Judgement, ...]:
        """What the training logs say of each effect, all others of the model beside it."""
        return tuple(map(self._judged, range(len(self.effects))))

    def _judged(self, number: int) -> Judgement:
        """Compare the model with one that is fitted without the effect."""
        several = len(self.effects) > 1
        before = self.loop.error_of(
            self.without_each[number].model if several else self.without
        )
        after = self.loop.error_of(self.model)
        taken = self.results[number]
        joints = joints_below(taken.term.channels, self.loop.material.robot.n)

        change = gain(before, after, joints)
        return Judgement(
            change=change,
            by_chance=doubt(before, after, joints),
            likely=reality(max(change.value, taken.share), taken.evidence) > 0.5,
            shown=self._size(number) > 1.0,
            unjudged=self.effects[number].effect.wide,
        )

    def _size(self, number: int) -> float:
        """Return an effect's coefficients over their errors, root mean square."""
        key = self.effects[number].key
        fitted = [x for x in self.model.effects if isinstance(x, FittedEffect)]
        effect = next(
            (x for x in reversed(fitted) if (x.effect.name, x.joint) == key), None
        )
        if effect is None:  # no row shows it
            return 0.0
        variance = np.diag(effect.covariance)
        known = variance > 0.0
        if not known.any():
            return np.inf
        return float(
            np.sqrt(np.mean(effect.coefficients[known] ** 2 / variance[known]))
        )

    @cached_property
    def losing(self) -> list[int]:
        """Joints that lose more than all others gain."""
        joints = range(self.loop.material.robot.n)
        errors = self.loop.error_of(self.without), self.loop.error_of(self.model)
        if gain(*errors, joints).value > 0.0:
            return []
        return [j for j in joints if gain(*errors, [j]).loses]

    @property
    def accepted(self) -> bool:
        """Whether all its effects are worth it."""
        faults = any(judgement.fault for judgement in self.judgements)
        return not faults and not self.losing

    @property
    def weakest(self) -> int:
        """Number of the effect that is least worth it: with a fault, and of the least gain."""
        judgements = enumerate(self.judgements)
        faulty = [number for number, judgement in judgements if judgement.fault]
        numbers = faulty or range(len(self.effects))
        return min(numbers, key=lambda number: self.judgements[number].change.value)

    def fault_of(self, number: int) -> str:
        """Return why an effect is refused."""
        names = self.loop.material.robot.joint_names
        lost = ", ".join(names[j] for j in self.losing)
        predicted = f"the model identified anew with it predicts {lost} worse"
        return self.judgements[number].fault or predicted


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What is added in a round, and what of it is refused.

    `candidate_model` has the effects that are worth it, maybe none; `refused` are the others,
    with how each was judged and why.
    """

    candidate_model: CandidateModel
    refused: tuple[tuple[TermResult, Judgement, str], ...]

    @classmethod
    def of(cls, candidate_model: CandidateModel) -> Decision:
        """Leave out, the weakest first, what is not worth it beside the rest of the round.

        An effect whose coefficients are smaller than their errors is first tried in
        simpler forms.
        """
        refused = []
        while candidate_model.effects and not candidate_model.accepted:
            number = candidate_model.weakest
            judgement = candidate_model.judgements[number]
            unclear = judgement.gains and not judgement.shown
            simpler = candidate_model.with_simpler(number) if unclear else None
            if simpler is not None:
                candidate_model = simpler
                continue
            refused.append(
                (
                    candidate_model.results[number],
                    judgement,
                    candidate_model.fault_of(number),
                )
            )
            candidate_model = candidate_model.without_each[number]
        return cls(candidate_model=candidate_model, refused=tuple(refused))


def effect_of(taken: TermResult) -> Candidate:
    """The effect that a term is."""
    assert isinstance(taken.term.what, Candidate)
    return taken.term.what


def with_effects(model: Refitted, robot: Robot) -> Stages:
    """The stages with the effects written into them."""
    effects = [
        as_stage(f, robot) if isinstance(f, FittedEffect) else f.to_stage(robot)
        for f in model.effects
    ]
    return msgspec.structs.replace(model.stages, effects=effects)
