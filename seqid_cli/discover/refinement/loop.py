"""The state of a refinement: the model as it grows, and what was tried.

Held-out logs play no part here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement.held_out import HeldOutError, held_out_error, joined
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
    as they were in this fit.
    """

    loop: Loop
    candidates: tuple[Candidate, ...]
    late: frozenset[Key]
    kept: bool

    @cached_property
    def model(self) -> Refitted:
        """Fitted to all logs."""
        return self.loop.refitted(self.candidates, self.late, kept=self.kept)

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
        return joined([self.error, self.loop.error_before(self.model)])


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
        return self.refitted(candidates_of_model(start.effects), start.late, kept=False)

    def refitted(
        self, candidates: Sequence[Candidate], late: frozenset[Key], *, kept: bool
    ) -> Refitted:
        """The model as it stands, fitted anew with these effects."""
        return refitted(self.material, self.model, candidates, late=late, kept=kept)

    def error_of(self, model: Refitted) -> HeldOutError:
        """Squared errors of a model on the logs that are fitted."""
        if model not in self._errors:
            logs, robot = self.material.training, self.material.robot
            stages, motion = with_effects(model, robot), self.material.options.motion
            self._errors[model] = held_out_error(logs, robot, stages, options=motion)
        return self._errors[model]

    @cached_property
    def logs_before(self) -> list[Recording]:
        """The logs of earlier stages with torque that are not fitted, each once."""
        fitted = {identity(log) for log in self.material.training}
        every = unique([log for own in self.material.earlier.values() for log in own])
        return [x for x in every if identity(x) not in fitted and x.tau is not None]

    def error_before(self, model: Refitted) -> HeldOutError:
        """Squared errors of a model on those; what came late is not in them."""
        material = self.material
        stages = with_effects(replace(model, effects=tuple(model.lasting)), material.robot)
        motion = material.options.motion
        return held_out_error(self.logs_before, material.robot, stages, options=motion)

    def accept(self, told: RefinementRound, account: Account) -> None:
        """Take an effect into the model."""
        if not self.added:
            self.without = account.without
        self.steps.append(account.model)
        self.rounds.append(told)


def key_of_round(told: RefinementRound, robot: Robot) -> Key:
    """The effect of a round, and its joint by number."""
    return told.effect, None if told.joint is None else robot.joint_names.index(told.joint)


def joints_of(key: Key, robot: Robot) -> set[int]:
    """Joints that an effect is of."""
    return set(range(robot.n)) if key[1] is None else {key[1]}


def with_effects(model: Refitted, robot: Robot) -> Stages:
    """The stages with the effects written into them."""
    effects = [
        as_stage(f, robot) if isinstance(f, FittedEffect) else f.term.to_stage(robot)
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
