"""What a model is identified from, and a model with its effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import Ground
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import without_effects
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
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
    _grounds: list[tuple[Stages, Ground]] = field(
        init=False, default_factory=list, compare=False, repr=False
    )

    def ground(self, stages: Stages) -> Ground:
        """Rows of the training logs with the base of these stages; the last two are kept."""
        known = next((pair for pair in self._grounds if pair[0] is stages), None)
        others = [pair for pair in self._grounds if pair is not known]
        if known is None:
            options = self.options.motion
            rows = rows_of(scenes_of(self.training, self.robot, stages, options=options))
            known = stages, Ground.of(rows, stages)
        self._grounds[:] = [known, *others[:1]]
        return known[1]

    def without(self, log: Recording, stages: Stages, effects: Sequence[Fitted]) -> Recording:
        """A log without the torque of some effects."""
        motion = self.options.motion
        given = log, self.robot, stages, effects
        return without_effects(*given, motion=motion.motion, source=motion.source)

    def freed(self, log: Recording, model: Refitted) -> Recording:
        """A log without effects: any, if it is fitted, else those that were there all along."""
        fitted = identity(log) in map(identity, self.training)
        return self.without(log, model.stages, model.effects if fitted else model.lasting)

    def now(self, model: Refitted) -> list[Recording]:
        """The training logs without any effect."""
        return [self.freed(log, model) for log in self.training]

    def logs_of(self, stage: str) -> list[Recording]:
        """The logs of an earlier stage, each once; those that are fitted last."""
        fitted = {identity(log) for log in self.training}
        logs = unique(self.earlier.get(stage, ()))
        return sorted(logs, key=lambda log: identity(log) in fitted)

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
