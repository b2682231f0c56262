"""Torque predicted by an identified model, log by log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.motion_use import motion_use
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.log_prediction import LogPrediction, notes_on, slides_from
from seqid_cli.identify.prediction.predict_long import LongPrediction, local_effects
from seqid_cli.identify.regression.streaming import open_if_long, streams
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.effects.apply import added_torque, scene_of_log
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.torque import TorqueModel, sliding
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

__all__ = ["LogPrediction", "predict"]


def predict(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    unexplained: bool = False,
) -> Iterator[LogPrediction]:
    """Predict the torque of any logs, with the effects that the parameter file names.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs with torque or current.
    robot : Robot
    stages : Stages
        Whatever has been identified; what is missing is taken as zero and noted.
    options : InertiaOptions
        Cut-off and source of the motion.
    unexplained : bool
        Whether smooth terms of no known cause count as well.

    Yields
    ------
    LogPrediction
        One per log; of a long one that is passed over, its parts one after the other.

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    ConfigError
        If an effect is not known to this version, or is not what it should be.
    """
    model = TorqueModel.from_stages(stages, robot)
    effects = fitted_effects(stages, robot, unexplained=unexplained)
    for found in mapped(recordings, _PredictionOf(robot, stages, model, effects, options)):
        if isinstance(found, LongPrediction):
            yield from found.parts()
        else:
            yield found


@dataclass(frozen=True)
class _PredictionOf:
    """The prediction of one log."""

    robot: Robot
    stages: Stages
    model: TorqueModel
    effects: list[Fitted]
    options: InertiaOptions

    def open_log(self, path: Path, robot: Robot, time_source: TimeSource) -> SurveyedLog | None:
        """Open a log that is better passed over than read; None for others."""
        if not (streams(self.stages, self.options) and local_effects(self.model, self.effects)):
            return None
        return open_if_long(path, robot, time_source=time_source)

    def __call__(
        self, recording: Recording | SurveyedLog, number: int
    ) -> LogPrediction | LongPrediction:
        """Predict it."""
        del number
        if isinstance(recording, SurveyedLog):
            options, effects = self.options, tuple(self.effects)
            return LongPrediction.of(recording, self.model, self.stages, options, effects)
        known = (self.robot, self.stages, self.model, self.effects, self.options)
        return _predict_log(recording, *known)


def _predict_log(
    recording: Recording,
    robot: Robot,
    stages: Stages,
    model: TorqueModel,
    effects: list[Fitted],
    options: InertiaOptions,
) -> LogPrediction:
    encoder = estimate_motion(recording, robot, options.motion)
    motion = best_motion(recording, robot, stages.imu, encoder, source=options.source)
    torque_of(recording)
    assert motion.tau is not None
    slowest = slides_from(model, options)
    slides = sliding(motion, slowest)
    added = None
    if effects:
        scene = scene_of_log(recording, robot, model, motion)
        added = added_torque(scene, recording, effects, slowest)
    allowed = model.predict_set(motion, slides, added)
    outside = model.outside(motion) & slides
    share = outside.sum(axis=0) / np.maximum(slides.sum(axis=0), 1)
    return LogPrediction(
        path=recording.path,
        sha256=recording.sha256,
        samples=motion.samples,
        cutoff_hz=motion.cutoff.hz,
        t=motion.t,
        tau=motion.tau,
        predicted=allowed.value,
        low=allowed.low,
        high=allowed.high,
        used=motion.usable,
        sliding=slides,
        notes=tuple(notes_on(model.surfaces, robot, stages, share)),
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        motion=motion_use(recording.path, robot, motion),
        start=recording.start,
        outside=outside,
    )
