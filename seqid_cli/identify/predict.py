"""Torque predicted by an identified model, log by log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.inertia import slowest_speeds
from seqid_cli.identify.motion_use import motion_use
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.parts import mapped
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.effects.apply import added_torque, scene_of_log
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.torque import TorqueModel, sliding
from seqid_cli.motion.link_motion import best_motion
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.params.schema import MotionUse, Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTSIDE_NOTE = 0.01  # share of samples outside the identified friction worth a note


@dataclass(frozen=True)
class LogPrediction:
    """Measured and predicted torque (N, n) N m of one log, both low-passed alike.

    `used` (N,) marks the samples that count, away from ends and gaps; `sliding` (N, n) those at
    which a joint certainly slides. Elsewhere friction is known only as an interval, and
    `predicted` is the value of it that lies nearest to the measured torque. `q`, `dq` (N, n) are
    the joint positions and velocities behind the prediction, `start` [s] is the first sample on the
    log's own clock.
    """

    path: Path
    sha256: str
    samples: int
    cutoff_hz: float
    t: Array
    tau: Array
    predicted: Array
    used: Mask
    sliding: Mask
    notes: tuple[str, ...] = ()
    q: Array | None = None
    dq: Array | None = None
    motion: MotionUse | None = None
    start: float = 0.0


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
        One per log.

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    ConfigError
        If an effect is not known to this version, or is not what it should be.
    """
    model = TorqueModel.from_stages(stages, robot)
    effects = fitted_effects(stages, robot, unexplained=unexplained)
    yield from mapped(recordings, _PredictionOf(robot, stages, model, effects, options))


@dataclass(frozen=True)
class _PredictionOf:
    """The prediction of one log."""

    robot: Robot
    stages: Stages
    model: TorqueModel
    effects: list[Fitted]
    options: InertiaOptions

    def __call__(self, recording: Recording, number: int) -> LogPrediction:
        """Predict it."""
        del number
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
    slowest = slowest_speeds(model.surfaces)
    slides = sliding(motion, slowest)
    added = None
    if effects:
        scene = scene_of_log(recording, robot, model, motion)
        added = added_torque(scene, recording, effects, slowest)
    return LogPrediction(
        path=recording.path,
        sha256=recording.sha256,
        samples=motion.samples,
        cutoff_hz=motion.cutoff.hz,
        t=motion.t,
        tau=motion.tau,
        predicted=model.predict_set(motion, slides, added),
        used=motion.usable,
        sliding=slides,
        notes=tuple(_notes(model, robot, stages, model.outside(motion) & slides, slides)),
        q=motion.q,
        dq=motion.dq,
        motion=motion_use(recording.path, robot, motion),
        start=recording.start,
    )


def _notes(
    model: TorqueModel, robot: Robot, stages: Stages, outside: Mask, slides: Mask
) -> Iterator[str]:
    if stages.inertia is None:
        yield "no inertia stage in the parameter file: inertial torque is taken as zero"
    unknown = [n for n, s in zip(robot.joint_names, model.surfaces, strict=True) if s is None]
    if unknown:
        yield f"no friction in the parameter file, taken as zero: {', '.join(unknown)}"
    share = outside.sum(axis=0) / np.maximum(slides.sum(axis=0), 1)
    far = [
        f"{name} {100 * part:.0f} %"
        for name, part in zip(robot.joint_names, share, strict=True)
        if part > OUTSIDE_NOTE
    ]
    if far:
        yield (
            "outside the speeds or positions at which friction was identified, so that the nearest "
            f"identified value stands in: {', '.join(far)} of the samples"
        )
