"""The state of a refinement: the model as it grows, those of its folds, and what was tried.

Held-out logs play no part here. The model of all training logs is what is written in the end.
Models of folds decide whether an effect is worth it: each is fitted without some blocks of time,
which it then predicts (see `left_out`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement.held_out import HeldOutError, gain, held_out_error, joined
from seqid_cli.discover.refinement.left_out import Folds, left_out_error
from seqid_cli.discover.refinement.material import Key, Material, Refitted, identity, unique
from seqid_cli.discover.refinement.reidentify import refitted
from seqid_cli.model.effects.fitted import Fitted, FittedEffect, as_stage
from seqid_cli.params.schema import RefinementRound, Stages
from seqid_cli.robot.types import Robot


@dataclass(frozen=True, eq=False)
class Account:
    """Which effects a model has, and the models of its folds, each fitted without one of them.

    `late` are the effects that came after the file was identified; `kept` says whether the stages
    stayed as they were in the last fit. Models of the first folds only make a first look.
    """

    candidates: tuple[Candidate, ...]
    late: frozenset[Key]
    kept: bool
    models: tuple[Refitted, ...] = ()


@dataclass
class Loop:
    """The model as it grows and what was tried.

    `best` is what an effect must be better than: before the first one the file as it is, or
    identified anew without further effects, whichever predicts left-out blocks better; `base` are
    the models that fits of folds start from, `parts` what they are fitted to. `steps` are the
    models of all training logs: the file, then one after each effect; `without` is what the first
    of these is compared with.
    """

    material: Material
    folds: Folds
    parts: tuple[Material, ...]
    base: tuple[Refitted, ...]
    best: Account
    steps: list[Refitted]
    without: Refitted
    rounds: list[RefinementRound] = field(default_factory=list)
    _errors: dict[Account, HeldOutError] = field(default_factory=dict)

    @classmethod
    def begin(cls, material: Material, model: Refitted) -> Loop:
        """Start from the file, or from the file identified anew with the training logs.

        What that gains is no effect's. A file that has seen these very logs must be.
        """
        known, folds = tuple(candidates_of_model(model.effects)), Folds.of(material.training)
        parts = tuple(_without(material, folds, k) for k in range(folds.count))
        base = (model,) * folds.count
        as_it_is = Account(known, model.late, kept=True, models=base)
        loop = cls(material, folds, parts, base, as_it_is, [model], model)
        anew = loop.fitted(Account(known, model.late, kept=False))
        before, after = loop.error_of(as_it_is), loop.error_of(anew)
        if material.known or gain(before, after, range(material.robot.n)).certain:
            loop.best = anew
            loop.without = refitted(material, model, known, late=model.late, kept=False)
        return loop

    @property
    def model(self) -> Refitted:
        """The model of all training logs as it stands."""
        return self.steps[-1]

    @property
    def added(self) -> int:
        """Number of effects added."""
        return len(self.steps) - 1

    def fitted(self, account: Account, folds: int | None = None) -> Account:
        """The account with the models of the first folds, or of all, that it does not have yet."""
        models = list(account.models)
        for part, base in list(zip(self.parts, self.base, strict=True))[len(models) : folds]:
            late, kept = account.late, account.kept
            models.append(refitted(part, base, account.candidates, late=late, kept=kept))
        return replace(account, models=tuple(models))

    def error_of(self, account: Account) -> HeldOutError:
        """Squared errors of the models of the folds where they have seen nothing."""
        if account not in self._errors:
            material = self.material
            self._errors[account] = left_out_error(
                material.training,
                self.folds,
                material.robot,
                [with_effects(model, material.robot) for model in account.models],
                options=material.options.motion,
            )
        return self._errors[account]

    def error_everywhere(self, account: Account) -> HeldOutError:
        """The same, beside the errors on the logs of earlier stages: they tell when effects came.

        What came late is not in those.
        """
        material, model = self.material, account.models[0]
        fitted = {identity(log) for log in material.training}
        every = unique([log for own in material.earlier.values() for log in own])
        before = [x for x in every if identity(x) not in fitted and x.tau is not None]
        there = self.error_of(account)
        if not before:
            return there
        stages = with_effects(replace(model, effects=tuple(model.lasting)), material.robot)
        motion = material.options.motion
        return joined([there, held_out_error(before, material.robot, stages, options=motion)])

    def accept(self, told: RefinementRound, account: Account) -> None:
        """Take effects into the model of all training logs."""
        self.best, self.base = account, account.models
        late, kept = account.late, account.kept
        whole = refitted(self.material, self.model, account.candidates, late=late, kept=kept)
        self.steps.append(whole)
        self.rounds.append(told)


def _without(material: Material, folds: Folds, fold: int) -> Material:
    """What a fold's model is fitted to; a log of which nothing is left is nowhere in it.

    The whole model alone is asked about other cut-offs.
    """
    logs = folds.without(material.training, fold)
    gone = {identity(log) for log in logs if not log.valid.any()}
    earlier = {
        stage: [log for log in own if identity(log) not in gone]
        for stage, own in material.earlier.items()
    }
    kept = tuple(log for log in logs if identity(log) not in gone)
    motion = replace(material.options.motion, neighbours=())
    options = replace(material.options, motion=motion)
    return replace(material, training=kept, earlier=earlier, options=options)


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
