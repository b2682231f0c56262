"""What a model is identified from, and a model with its effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import motions_of, scenes_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import without_effects
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Mask

Key = tuple[str, int | None]  # name of an effect, and its joint


@dataclass(frozen=True, eq=False)
class Refitted:
    """A model with effects: the stages without them, the effects, and which of these came late."""

    stages: Stages
    effects: tuple[Fitted, ...]
    late: frozenset[Key] = frozenset()

    @property
    def lasting(self) -> list[Fitted]:
        """Effects that were there all along."""
        return [f for f in self.effects if key_of(f) not in self.late]


def key_of(fitted: Fitted) -> Key | None:
    """What tells a fitted effect from the others; None for a smooth term."""
    return (fitted.effect.name, fitted.joint) if isinstance(fitted, FittedEffect) else None


@dataclass(frozen=True)
class Material:
    """What a model is identified from.

    `earlier` are the logs of the earlier stages, by stage; empty where they are not at hand.
    """

    training: tuple[Recording, ...]
    earlier: Mapping[str, Sequence[Recording]]
    robot: Robot
    options: DiscoverOptions
    _motions: list[Motion] = field(init=False, default_factory=list, compare=False, repr=False)

    def scenes(self, stages: Stages) -> list[Scene]:
        """Data sets of the training logs; their motion is the same whatever the model."""
        options = self.options.motion
        if not self._motions:
            found = motions_of(self.training, self.robot, stages, options=options)
            self._motions.extend(found)
        return scenes_of(self.training, self.robot, stages, options=options, motions=self._motions)

    def freed(
        self, logs: Sequence[Recording], stages: Stages, effects: Sequence[Fitted]
    ) -> list[Recording]:
        """The logs without the effects' torque."""
        motion = self.options.motion
        return [
            without_effects(
                log, self.robot, stages, effects, motion=motion.motion, source=motion.source
            )
            for log in logs
        ]

    def before(self, stage: str, model: Refitted) -> list[Recording]:
        """The logs of an earlier stage without what was there all along, each once.

        Those that are fitted are left to `now`.
        """
        fitted = {identity(log) for log in self.training}
        logs = [x for x in unique(self.earlier.get(stage, ())) if identity(x) not in fitted]
        return self.freed(logs, model.stages, model.lasting)

    def now(self, model: Refitted) -> list[Recording]:
        """The training logs without any effect."""
        return self.freed(self.training, model.stages, model.effects)

    def before_or_now(self, stage: str, model: Refitted) -> list[Recording]:
        """All logs of an earlier stage; those that are fitted as well, without any effect."""
        own = {identity(log) for log in self.earlier.get(stage, ())}
        fitted = [log for log in self.training if identity(log) in own]
        return [*self.before(stage, model), *self.freed(fitted, model.stages, model.effects)]

    def as_they_were(self, stage: str, freed: Sequence[Recording]) -> bool:
        """Whether logs of an earlier stage are still what it was identified from."""
        logs = {identity(log): log for log in self.earlier.get(stage, ())}
        return len(logs) == len(freed) and not any(
            changed_joints(logs[identity(log)], log).any()
            or not np.array_equal(logs[identity(log)].valid, log.valid)
            for log in freed
        )

    @property
    def known(self) -> bool:
        """Whether the file was identified from all of the training logs."""
        logs = {identity(log) for stage in self.earlier.values() for log in stage}
        return all(identity(log) in logs for log in self.training)


def changed_joints(log: Recording, freed: Recording) -> Mask:
    """Joints (n,) whose torque or position the effects have changed."""
    assert log.tau is not None
    assert freed.tau is not None
    changed: Mask = np.any((log.tau != freed.tau) | (log.q != freed.q), axis=0)
    return changed


def unique(logs: Sequence[Recording]) -> list[Recording]:
    """Logs in their order, each once."""
    return list({identity(log): log for log in logs}.values())


def identity(log: Recording) -> tuple[str, str]:
    """What tells a log from others."""
    return log.sha256, str(log.path)
