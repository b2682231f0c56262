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
from seqid_cli.discover.refinement.held_out import HeldOutError, gain, held_out_error
from seqid_cli.discover.refinement.left_out import Folds, left_out_error
from seqid_cli.discover.refinement.material import Key, Material, Refitted, identity, unique
from seqid_cli.discover.refinement.reidentify import refitted
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, FittedEffect, as_stage
from seqid_cli.params.schema import RefinementRound, Stages
from seqid_cli.robot.types import Robot


@dataclass(frozen=True)
class Account:
    """Which effects a model has, and the models of its folds, each fitted without one of them.

    `late` are the effects that came after the file was identified; `kept` says whether the stages
    stayed as they were in the last fit. Models of the first folds only make a first look.
    """

    models: tuple[Refitted, ...]
    candidates: tuple[Candidate, ...]
    late: frozenset[Key]
    kept: bool


@dataclass
class Loop:
    """The model as it grows and what was tried.

    `best` is what an effect must be better than: before the first one the file as it is, or
    identified anew without further effects, whichever predicts left-out blocks better; `base` are
    the models that fits of folds start from. `steps` are the models of all training logs: the file,
    then one after each effect; `without` is what the first of these is compared with.
    """

    material: Material
    folds: Folds
    base: tuple[Refitted, ...]
    best: Account
    steps: list[Refitted]
    without: Refitted
    rounds: list[RefinementRound] = field(default_factory=list)
    _materials: dict[int, tuple[Material, Material]] = field(default_factory=dict)
    _errors: list[tuple[Account, tuple[Recording, ...], HeldOutError]] = field(default_factory=list)

    @classmethod
    def begin(cls, material: Material, model: Refitted) -> Loop:
        """Start from the file, or from the file identified anew with the training logs.

        What that gains is no effect's. A file that has seen these very logs must be.
        """
        known, late = candidates_of_model(model.effects), model.late
        folds = Folds.of(material.training)
        base = (model,) * folds.count
        as_it_is = Account(base, tuple(known), late, kept=True)
        loop = cls(material, folds, base, as_it_is, [model], model)
        anew = loop.account(known, late, kept=False)
        everywhere = range(material.robot.n)
        before, after = loop.error_of(as_it_is), loop.error_of(anew)
        if material.known or gain(before, after, everywhere).certain:
            loop.best = anew
            loop.without = refitted(material, model, known, late=late, kept=False)
        return loop

    @property
    def model(self) -> Refitted:
        """The model of all training logs as it stands."""
        return self.steps[-1]

    @property
    def added(self) -> int:
        """Number of effects added."""
        return len(self.steps) - 1

    def account(
        self, candidates: Sequence[Candidate], late: frozenset[Key], *, kept: bool
    ) -> Account:
        """Fit the models of all folds with these effects."""
        return self.completed(Account((), tuple(candidates), late, kept))

    def first_look(self, account: Account) -> Account:
        """The account with the model of the first fold alone."""
        return replace(account, models=(self._of_fold(account, 0),))

    def completed(self, account: Account) -> Account:
        """The account with the models of all folds."""
        rest = range(len(account.models), self.folds.count)
        return replace(
            account, models=(*account.models, *(self._of_fold(account, fold) for fold in rest))
        )

    def _of_fold(self, account: Account, fold: int) -> Refitted:
        return refitted(
            self._without(fold),
            self.base[fold],
            account.candidates,
            late=account.late,
            kept=account.kept,
        )

    def error_of(self, account: Account) -> HeldOutError:
        """Squared errors of the models of the folds where they have seen nothing."""
        material = self.material
        for known, training, error in self._errors:
            if known is account and training is material.training:
                return error
        stages = [with_effects(model, material.robot) for model in account.models]
        motion = material.options.motion
        found = left_out_error(
            material.training, self.folds, material.robot, stages, options=motion
        )
        self._errors.append((account, material.training, found))
        return found

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
        return there.beside(held_out_error(before, material.robot, stages, options=motion))

    def _without(self, fold: int) -> Material:
        """What a fold's model is fitted to; a log of which nothing is left is nowhere in it."""
        whole, found = self._materials.get(fold, (None, None))
        if found is None or whole is not self.material:
            found = self._left_in(fold)
            self._materials[fold] = self.material, found
        return found

    def _left_in(self, fold: int) -> Material:
        """The material without a fold; the whole model alone is asked about other cut-offs."""
        logs = self.folds.without(self.material.training, fold)
        gone = {identity(log) for log in logs if not log.valid.any()}
        earlier = {
            stage: [log for log in own if identity(log) not in gone]
            for stage, own in self.material.earlier.items()
        }
        kept = tuple(log for log in logs if identity(log) not in gone)
        options = self.material.options
        motion = replace(options.motion, neighbours=())
        options = replace(options, motion=motion)
        return replace(self.material, training=kept, earlier=earlier, options=options)

    def accept(self, told: RefinementRound, account: Account) -> None:
        """Take effects into the model of all training logs."""
        self.best, self.base = account, account.models
        self.steps.append(self._whole(self.model, account))
        self.rounds.append(told)

    def _whole(self, model: Refitted, account: Account) -> Refitted:
        return refitted(
            self.material, model, account.candidates, late=account.late, kept=account.kept
        )


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
