"""The state of a refinement: the model as it grows, and what comes of one effect more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import msgspec

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement import held_out
from seqid_cli.discover.refinement.held_out import Gain, HeldOutError, doubt, gain
from seqid_cli.discover.refinement.reidentify import Material, Refitted, identity, refitted, unique
from seqid_cli.discover.select.naming import reality
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import Key, Taken
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import FittedEffect, as_stage
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

ALL_ALONG = "was there all along"
LATE = "came after the file was identified"


@dataclass
class Refinement:
    """What is decided before any held-out log is opened.

    The first effect had to be better than the model as it came in, or the same identified anew.
    """

    material: Material  # what models are fitted to
    came: Stages
    steps: list[Refitted]  # the model as it came in, and after each effect that was added
    without: Refitted  # what the first effect had to be better than
    rounds: list[RefinementRound] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    _errors: dict[Refitted, HeldOutError] = field(default_factory=dict)
    _before: dict[Refitted | int, HeldOutError] = field(default_factory=dict)

    @property
    def model(self) -> Refitted:
        """The model as it stands."""
        return self.steps[-1]

    @property
    def stages(self) -> Stages:
        """The refined model."""
        return with_effects(self.model, self.material.robot)

    @property
    def added(self) -> int:
        """Number of effects added."""
        return len(self.steps) - 1

    @cached_property
    def anew(self) -> Refitted:
        """The file identified anew with the training logs: what that gains is no effect's."""
        start = self.steps[0]
        return refitted(self.material, start, start.candidates, late=start.late, kept=False)

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
            self._before[key] = self._error(self.logs_before, replace(model, effects=lasting))
        return held_out.joined([self.error_of(model), self._before[key]])

    @cached_property
    def logs_before(self) -> list[Recording]:
        """The logs of earlier stages with torque that are not fitted, each once."""
        fitted = {identity(log) for log in self.material.training}
        every = unique([log for own in self.material.earlier.values() for log in own])
        return [x for x in every if identity(x) not in fitted and x.tau is not None]

    def _error(self, logs: Sequence[Recording], model: Refitted) -> HeldOutError:
        robot, options = self.material.robot, self.material.options.motion
        return held_out.held_out_error(logs, robot, with_effects(model, robot), options=options)


@dataclass(frozen=True, eq=False)
class Account:
    """A model with one effect more, what was `taken` for it, and when the effects came."""

    loop: Refinement
    taken: Taken
    candidates: tuple[Candidate, ...]
    late: frozenset[Key]  # those that came after the file was identified
    kept: bool  # whether the stages stayed as they were in this fit

    @cached_property
    def model(self) -> Refitted:
        """Fitted to all logs."""
        asked = self.loop.material, self.loop.model, self.candidates
        return refitted(*asked, late=self.late, kept=self.kept)

    @cached_property
    def without(self) -> Refitted:
        """The model as it stands; before the first effect by the same recipe as this one."""
        return self.loop.model if self.kept or self.loop.added else self.loop.anew

    @cached_property
    def _errors(self) -> tuple[HeldOutError, HeldOutError]:
        return self.loop.error_of(self.without), self.loop.error_of(self.model)

    @cached_property
    def change(self) -> Gain:
        """Gain at the effect's joints on the logs that are fitted."""
        return gain(*self._errors, self._own)

    @property
    def _own(self) -> list[int]:
        return joints_below(self.taken.term.channels, self.loop.material.robot.n)

    @cached_property
    def gains(self) -> bool:
        """Whether it gains as much as a finding does, and not by chance."""
        doubted = doubt(*self._errors, self._own)
        return self.change.value >= Options.improvement and doubted <= Options.doubt

    @property
    def likely(self) -> bool:
        """Whether the effect is likelier there than not, by what is gained."""
        return reality(max(self.change.value, self.taken.share), self.taken.evidence) > 0.5

    @cached_property
    def losing(self) -> list[int]:
        """Joints that lose more than all others gain."""
        joints = range(self.loop.material.robot.n)
        gains = gain(*self._errors, joints).value > 0.0
        return [j for j in joints if not gains and gain(*self._errors, [j]).loses]

    @property
    def unjudged(self) -> bool:
        """Whether it may be there, but above the low-pass, where the model is not judged."""
        return effect_of(self.taken).effect.wide and not self.gains

    @property
    def accepted(self) -> bool:
        """Whether it is worth it."""
        return self.gains and self.likely and not self.losing

    @property
    def reason(self) -> str:
        """When the effect came; why it is refused, if it is."""
        candidate, names = effect_of(self.taken), self.loop.material.robot.joint_names
        if self.accepted:
            return LATE if candidate.key in self.late else ALL_ALONG
        if self.unjudged:
            return "lies above the low-pass, where the model is not judged"
        if not self.gains:
            return "the model identified anew with it is not certainly better"
        if not self.likely:
            return "is less likely than not"
        lost = ", ".join(names[j] for j in self.losing)
        return f"the model identified anew with it predicts {lost} worse"


def effect_of(taken: Taken) -> Candidate:
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
