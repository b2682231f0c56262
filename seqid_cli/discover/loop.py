"""The state of a refinement: the model as it grows, its errors, and the accounts of an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.heldout import Gain, HeldOutError, held_out_error
from seqid_cli.discover.reidentify import Key, Material, Refitted, identity, unique
from seqid_cli.discover.results import Round
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, FittedEffect, as_stage
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot


@dataclass
class Loop:
    """The model as it grows, its error on the held-out logs, and what was tried."""

    material: Material
    held_out: tuple[Recording, ...]
    model: Refitted
    error: HeldOutError
    rounds: list[Round]
    refused: dict[Key, float]  # until so many effects have been added
    rng: np.random.Generator
    broad: bool = False  # whether an effect was found beside a broad base

    @property
    def added(self) -> int:
        """Number of effects added."""
        return sum(r.accepted for r in self.rounds)

    def judged(self, model: Refitted) -> HeldOutError:
        """Error of a model on the held-out logs."""
        return self._error(self.held_out, model.stages, model.effects)

    def explained(self, model: Refitted) -> HeldOutError:
        """Error of a model on all logs that it is to explain, each with the effects it had."""
        logs = unique([log for logs in self.material.earlier.values() for log in logs])
        fitted = {identity(log) for log in self.material.training}
        before = [log for log in logs if identity(log) not in fitted and _drives(log)]
        now = self._error(self.material.training, model.stages, model.effects)
        if not before:
            return now
        return now.beside(self._error(before, model.stages, model.lasting))

    def _error(
        self, logs: Sequence[Recording], stages: Stages, effects: Sequence[Fitted]
    ) -> HeldOutError:
        whole = with_effects(Refitted(stages, tuple(effects)), self.material.robot)
        motion = self.material.options.motion
        return held_out_error(logs, self.material.robot, whole, options=motion, unexplained=True)


@dataclass(frozen=True)
class Account:
    """A model with one effect more, when that effect came, and what the held-out logs say."""

    model: Refitted
    late: bool
    error: HeldOutError
    change: Gain  # at the joints of the effect
    whole: Gain
    losing: tuple[int, ...]  # joints that lose more than is tolerated

    @property
    def accepted(self) -> bool:
        """Whether the held-out logs agree."""
        return self.helps and not self.losing

    @property
    def helps(self) -> bool:
        """Whether the held-out logs agree, as far as the effect's own joints are concerned."""
        return self.change.certain and self.whole.value > 0.0


def with_effects(model: Refitted, robot: Robot) -> Stages:
    """The stages with the effects written into them."""
    effects = [
        as_stage(f, robot) if isinstance(f, FittedEffect) else f.term.to_stage(robot)
        for f in model.effects
    ]
    return msgspec.structs.replace(model.stages, effects=effects)


def _drives(log: Recording) -> bool:
    return log.tau is not None


def candidates_of_model(effects: Sequence[Fitted]) -> list[Candidate]:
    """The model's effects as candidates, to be fitted again."""
    return [
        Candidate(f.effect, f.joint, dict(f.settings), below=f.effect.wide)
        for f in effects
        if isinstance(f, FittedEffect)
    ]
