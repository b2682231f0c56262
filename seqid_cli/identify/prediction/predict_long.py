"""Prediction of a log of any length, part by part, in memory that does not grow with it.

The log is passed over as for the inertia stage (see `streaming`), at its own rate. Every part is
worked on with so many samples more on either side that the filters have forgotten what lies beyond,
so that the parts together are what the log as a whole gives.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.identify.motion_use import motion_use
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.log_prediction import LogPrediction, notes_on, slides_from
from seqid_cli.identify.regression.streaming import chosen_cutoff, overlapping, too_short
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.model.effects.apply import added_torque, scene_of_log
from seqid_cli.model.effects.fitted import Fitted
from seqid_cli.model.torque import Added, TorqueModel, sliding
from seqid_cli.motion.blocks import Plan, SurveyedLog, make_plan, motion_blocks
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.typing import Array, Mask

ROWS = 32_768  # samples of a part, and twice the margin at least


def local_effects(model: TorqueModel, effects: Sequence[Fitted]) -> bool:
    """Whether effects can be predicted part by part, as they come out of the whole log.

    The speed over which the direction of motion changes must be known beforehand as well.
    """
    known = all(surface is not None for surface in model.surfaces)
    return not effects or (known and all(effect.local for effect in effects))


@dataclass(frozen=True)
class LongPrediction:
    """A long log, opened; `parts` passes over it. Sent elsewhere, it reads the file anew."""

    log: SurveyedLog
    sha256: str
    plan: Plan
    model: TorqueModel
    stages: Stages
    slides_from: tuple[float, ...]  # rad/s, by joint
    effects: tuple[Fitted, ...] = ()

    @classmethod
    def of(
        cls,
        log: SurveyedLog,
        model: TorqueModel,
        stages: Stages,
        options: InertiaOptions,
        effects: Sequence[Fitted] = (),
    ) -> LongPrediction:
        """Choose how the log is filtered; the effects must be `local_effects`."""
        cutoff, step = chosen_cutoff(log, model.robot, options.motion)
        plan = make_plan(log.rate_hz, cutoff, step, samples_per_cutoff=float("inf"))
        slowest = tuple(slides_from(model, options).tolist())
        log = replace(log, survey=None)
        return cls(log, log.sha256, plan, model, stages, slowest, tuple(effects))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the temporary file, which is of this process."""
        return {**self.__dict__, "log": replace(self.log, spool=None)}

    def parts(self) -> Iterator[LogPrediction]:
        """Yield the log's samples in order.

        Raises
        ------
        InputError
            The file can no longer be read, or no stretch of it is long enough to filter.
        """
        lowpass = self.plan.lowpass
        margin = 2 * (lowpass.memory + lowpass.settling)
        slowest = np.array(self.slides_from)
        outside = slides = np.zeros(self.model.robot.n, dtype=np.int64)
        moving = np.zeros(self.model.robot.n, dtype=bool)
        usable = False
        with self._file() as log:
            blocks = motion_blocks(log.blocks(), self.plan)
            cut = overlapping(blocks, max(ROWS, 2 * margin), margin)
            for number, (motion, start, stop) in enumerate(cut):
                found = self._part(motion, start, stop, slowest)
                assert found.outside is not None
                outside = outside + found.outside.sum(axis=0)
                slides = slides + found.sliding.sum(axis=0)
                moving |= motion.moving.any(axis=0)
                usable |= bool(found.used.any())
                ends = bool(found.t[-1] * log.rate_hz > log.samples - 1.5)
                if ends and not usable:
                    raise too_short(log.path, self.plan.cutoff)
                if ends:
                    found = self._told(found, motion, moving, outside / np.maximum(slides, 1))
                yield replace(found, part=number, last=ends)

    @contextlib.contextmanager
    def _file(self) -> Iterator[SurveyedLog]:
        """The log with its file at hand: a stored one's copy has gone with its first pass."""
        if self.log.spool is not None:
            yield self.log
            return
        with local_copy(self.log.path) as file:
            yield self.log if file is self.log.path else replace(self.log, file=Path(file))

    def _part(self, motion: Motion, start: int, stop: int, slowest: Array) -> LogPrediction:
        """Predict samples [start, stop) of the motion."""
        slides = sliding(motion, slowest)
        added = self._added(motion, slowest) if self.effects else None
        allowed = self.model.predict_set(motion, slides, added)
        inner = slice(start, stop)
        own = motion.part(slice(start, stop))
        assert own.tau is not None
        return LogPrediction(
            path=self.log.path,
            sha256=self.sha256,
            samples=self.log.samples,
            cutoff_hz=motion.cutoff.hz,
            t=own.t,
            tau=own.tau,
            predicted=allowed.value[inner],
            low=allowed.low[inner],
            high=allowed.high[inner],
            used=own.usable,
            sliding=slides[inner],
            q=own.q,
            dq=own.dq,
            ddq=own.ddq,
            start=self.log.start_ns * 1e-9,
            outside=self.model.outside(own) & slides[inner],
        )

    def _added(self, motion: Motion, slowest: Array) -> Added:
        """What effects add to samples whose margins are long enough for them."""
        part = Recording(
            path=self.log.path,
            sha256=self.sha256,
            format=self.log.format,
            t=motion.t,
            q=motion.q,
            valid=motion.valid,
            health=Health(self.log.rate_hz, self.log.jitter),
            start=self.log.start_ns * 1e-9,
        )
        scene = scene_of_log(part, self.model.robot, self.model, motion)
        return added_torque(scene, part, self.effects, slowest)

    def _told(
        self, part: LogPrediction, motion: Motion, moving: Mask, share: Array
    ) -> LogPrediction:
        """The last part, with what is to be said of the log."""
        robot = self.model.robot
        use = motion_use(self.log.path, robot, replace(motion, moving=moving[None]))
        notes = tuple(notes_on(self.model.surfaces, robot, self.stages, share))
        return replace(part, notes=notes, motion=use)
