"""The state of a refinement: the model as it grows, and what was tried.

Held-out logs play no part here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement.held_out import HeldOutError, gain, held_out_error, joined
from seqid_cli.discover.refinement.material import Key, Material, Refitted, identity, unique
from seqid_cli.discover.refinement.reidentify import refitted
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, FittedEffect, as_stage
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot


@dataclass(frozen=True, eq=False)
class Account:
    """A model with one effect more, the model `without` it, and when the effects came.

    `late` are those that came after the file was identified; `kept` says whether the stages stayed
    as they were in this fit. It is not finished where it is clearly worse than a `rival`.
    """

    loop: Loop
    candidates: tuple[Candidate, ...]
    late: frozenset[Key]
    kept: bool
    rival: Account | None = None

    @cached_property
    def model(self) -> Refitted:
        """Fitted to all logs."""
        loop, rival = self.loop, self.rival
        asked = loop.material, loop.model, self.candidates
        beaten = None if rival is None else rival.beats
        return refitted(*asked, late=self.late, kept=self.kept, beaten=beaten)

    @cached_property
    def without(self) -> Refitted:
        """The model as it stands; before the first effect by the same recipe as this one."""
        loop = self.loop
        return loop.model if self.kept or loop.added else loop.anew

    @property
    def error(self) -> HeldOutError:
        """Squared errors on the logs that are fitted."""
        return self.loop.error_of(self.model)

    @property
    def everywhere(self) -> HeldOutError:
        """The same, beside those on the logs of earlier stages: they tell when effects came."""
        return self.loop.error_everywhere(self.model)

    def beats(self, other: Refitted) -> bool:
        """Whether all logs are predicted better than by another model, and not by chance."""
        joints = range(self.loop.material.robot.n)
        return gain(self.loop.error_everywhere(other), self.everywhere, joints).certain


@dataclass
class Loop:
    """The model as it grows and what was tried.

    `steps` are the file's model, then one after each effect; `without` is what the first of these
    is compared with.
    """

    material: Material
    steps: list[Refitted]
    without: Refitted
    rounds: list[RefinementRound] = field(default_factory=list)
    _errors: dict[Refitted, HeldOutError] = field(default_factory=dict)
    _before: list[tuple[Refitted, HeldOutError]] = field(default_factory=list)

    @property
    def model(self) -> Refitted:
        """The model as it stands."""
        return self.steps[-1]

    @property
    def added(self) -> int:
        """Number of effects added."""
        return len(self.steps) - 1

    @cached_property
    def anew(self) -> Refitted:
        """The file identified anew with the training logs: what that gains is no effect's."""
        start = self.steps[0]
        candidates = candidates_of_model(start.effects)
        return refitted(self.material, start, candidates, late=start.late, kept=False)

    def error_of(self, model: Refitted) -> HeldOutError:
        """Squared errors of a model on the logs that are fitted."""
        if model not in self._errors:
            self._errors[model] = self._error(self.material.training, model)
        return self._errors[model]

    def error_everywhere(self, model: Refitted) -> HeldOutError:
        """The same, beside those on the logs of earlier stages; what came late is not in these."""
        return joined([self.error_of(model), self._error_before(model)])

    @cached_property
    def logs_before(self) -> list[Recording]:
        """The logs of earlier stages with torque that are not fitted, each once."""
        fitted = {identity(log) for log in self.material.training}
        every = unique([log for own in self.material.earlier.values() for log in own])
        return [x for x in every if identity(x) not in fitted and x.tau is not None]

    def _error_before(self, model: Refitted) -> HeldOutError:
        """Squared errors on those; models that differ in what came late alone have the same."""
        lasting = replace(model, effects=tuple(model.lasting))
        for known, error in self._before:
            if known.stages is lasting.stages and not (known.effects or lasting.effects):
                return error
        self._before.append((lasting, self._error(self.logs_before, lasting)))
        return self._before[-1][1]

    def _error(self, logs: Sequence[Recording], model: Refitted) -> HeldOutError:
        robot, options = self.material.robot, self.material.options.motion
        return held_out_error(logs, robot, with_effects(model, robot), options=options)

    def accept(self, told: RefinementRound, account: Account) -> None:
        """Take an effect into the model."""
        if not self.added:
            self.without = account.without
        self.steps.append(account.model)
        self.rounds.append(told)


def with_effects(model: Refitted, robot: Robot) -> Stages:
    """The stages with the effects written into them."""
    effects = [
        as_stage(f, robot) if isinstance(f, FittedEffect) else f.to_stage(robot)
        for f in model.effects
    ]
    return msgspec.structs.replace(model.stages, effects=effects)


def candidates_of_model(effects: Sequence[Fitted]) -> list[Candidate]:
    """The model's effects as candidates, to be fitted again."""
    return [
        Candidate(f.effect, f.joint, dict(f.settings), apart=f.effect.wide)
        for f in effects
        if isinstance(f, FittedEffect)
    ]
