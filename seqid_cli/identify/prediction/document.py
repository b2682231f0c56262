"""Predicted torques as a document: errors added up log by log, with a verdict for each joint."""

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqid_cli.identify.bands.coverage import CoverageCounter
from seqid_cli.identify.bands.prediction import Bands
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.judging import as_a_whole, physics_verdicts
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.identify.prediction.torque_files import mcap_writer, parquet_writer
from seqid_cli.identify.prediction.verdicts import joint_verdicts, noise_floors
from seqid_cli.identify.settings import PredictSettings
from seqid_cli.model.effects.fitted import effect_notes
from seqid_cli.params.document import head, present, robot_id, used_settings
from seqid_cli.params.results import prediction
from seqid_cli.params.results.prediction import JointError, PredictionFile
from seqid_cli.typing import Array, Mask


def prediction_file(
    inputs: Inputs,
    logs: LogSet,
    predictions: Iterable[LogPrediction],
    torques: Path | None,
    cutoff_origin: str,
    *,
    unexplained: bool,
    settings: PredictSettings = PredictSettings(),
) -> PredictionFile:
    """Add up the errors of predictions, and write their torques where these are wanted.

    `logs` is read while the predictions, parts of a long log one by one, are taken.
    `torques` go to MCAP if it ends so, else Parquet. `unexplained`: whether smooth
    terms of no known cause count.
    """
    robot, stages = inputs.robot, inputs.stages
    names = robot.joint_names
    overall = ErrorSums.none(robot.n)
    of_log = ErrorSums.none(robot.n)
    errors = []

    with _writer(torques, inputs) as write:
        for log in predictions:
            of_log.add(log)
            overall.add(log)
            write(log)
            if log.last:
                error = prediction.LogPredictionError(
                    path=str(log.path),
                    sha256=log.sha256,
                    samples=log.samples,
                    cutoff_hz=log.cutoff_hz,
                    joints=of_log.by_joint(names),
                    notes=list(log.notes),
                    motion=log.motion,
                )
                errors.append(error)
                of_log = ErrorSums.none(robot.n)

    joints = overall.by_joint(names)
    still = ", ".join(name for name, error in joints.items() if not error.samples)
    notes = [f"never slides in these logs and is not judged: {still}"] if still else []
    bands = Bands.from_stages(stages, robot)
    cutoffs_hz = [error.cutoff_hz for error in errors]
    floors = noise_floors(stages, cutoffs_hz)
    notes += bands.notes(cutoffs_hz)
    verdicts = [
        *joint_verdicts(
            joints, stages, robot, noise_floors=floors, settings=settings.errors
        ),
        *physics_verdicts(stages, robot, settings.judging),
    ]
    return PredictionFile(
        **head(prediction.PREDICTION_SCHEMA, logs.created(inputs.documents)),
        robot=robot_id(robot),
        inputs=logs.inputs(),
        parameters=inputs.ids(),
        stages=list(present(stages)),
        joints=joints,
        logs=errors,
        cutoff_origin=cutoff_origin or "chosen per log",
        verdicts=as_a_whole([*verdicts, *logs.verdicts()]),
        notes=[*effect_notes(stages, unexplained=unexplained), *notes, *logs.notes()],
        settings=used_settings(settings),
    )


def _writer(
    torques: Path | None, inputs: Inputs
) -> AbstractContextManager[Callable[[LogPrediction], object]]:
    names = inputs.robot.joint_names
    if torques is None:
        return nullcontext(lambda _: None)
    if torques.suffix.lower() == ".mcap":
        return mcap_writer(torques, names)
    return parquet_writer(torques, names, [item.sha256 for item in inputs.ids()])


@dataclass
class Sums:
    """Sums over some samples of each joint (n,): their number, squares of error and torque."""

    samples: Array
    error_squares: Array  # (N m)^2
    torque_squares: Array
    largest: Array  # N m, of the error

    @classmethod
    def none(cls, n: int) -> "Sums":
        """Return sums over no samples of n joints."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n))

    def add(self, counts: Mask, error: Array, torque: Array) -> None:
        """Add samples (N, n) that count, with their errors and measured torques [N m]."""
        error = np.where(counts, error, 0.0)
        torque = np.where(counts, torque, 0.0)
        self.samples += counts.sum(axis=0)
        self.error_squares += np.square(error).sum(axis=0)
        self.torque_squares += np.square(torque).sum(axis=0)
        self.largest = np.maximum(self.largest, np.abs(error).max(axis=0, initial=0.0))

    def rmse(self, joint: int) -> float | None:
        """Return the RMS error of a joint [N m]; None without samples."""
        return _root(self.error_squares[joint], self.samples[joint])


@dataclass(kw_only=True)
class ErrorSums:
    """Errors of predicted torques, added up part by part of the logs.

    `every` sample that counts is one that slides or one that rests. At rest friction
    takes any value up to its limit, and the error is the distance to that interval.
    Those that slide are `inside` the positions and speeds at which friction was
    identified, or `outside`.
    """

    every: Sums
    sliding: Sums
    inside: Sums
    outside: Sums
    rest: Sums
    std_squares: Array  # (n,) (N m)^2, sums over the sliding samples
    parameter_squares: Array  # likewise, of what errors of parameters make
    coverage: CoverageCounter

    @classmethod
    def none(cls, n: int) -> "ErrorSums":
        """Return the errors of no log of n joints."""
        groups = ("every", "sliding", "inside", "outside", "rest")
        return cls(
            **{name: Sums.none(n) for name in groups},
            std_squares=np.zeros(n),
            parameter_squares=np.zeros(n),
            coverage=CoverageCounter(),
        )

    def add(self, log: LogPrediction) -> None:
        """Add a log, or a part of one."""
        used = np.broadcast_to(log.used[:, None], log.tau.shape)
        outside = log.sliding & log.outside
        self.every.add(used, log.beyond, log.tau)
        self.sliding.add(log.sliding, log.residual, log.tau)
        self.inside.add(log.sliding & ~outside, log.residual, log.tau)
        self.outside.add(outside, log.residual, log.tau)
        self.rest.add(used & ~log.sliding, log.beyond, log.tau)
        self.std_squares += np.square(np.where(log.sliding, log.std, 0.0)).sum(axis=0)
        by_parameters = np.where(log.sliding, log.parameter_std, 0.0)
        self.parameter_squares += np.square(by_parameters).sum(axis=0)
        self.coverage.add(
            log=str(log.path),
            t=log.t,
            residual=log.residual,
            std=log.std,
            counts=log.sliding,
            fast=log.fast,
            loaded=log.loaded,
        )

    def by_joint(self, names: Sequence[str]) -> dict[str, JointError]:
        """Return the errors of each joint."""
        return {name: self._of_joint(j) for j, name in enumerate(names)}

    def _of_joint(self, j: int) -> JointError:
        sliding = self.sliding
        count = float(sliding.samples[j])
        every = float(self.every.samples[j])
        std = _root(self.std_squares[j], count)
        return JointError(
            rmse=sliding.rmse(j),
            relative_rmse=_root(sliding.error_squares[j], sliding.torque_squares[j]),
            max_abs=float(sliding.largest[j]) if count else None,
            samples=int(count),
            rmse_all=self.every.rmse(j),
            samples_all=int(every),
            share_sliding=count / every if every else None,
            rmse_inside=self.inside.rmse(j),
            rmse_outside=self.outside.rmse(j),
            share_outside=float(self.outside.samples[j] / count) if count else None,
            rmse_rest=self.rest.rmse(j),
            std=std if std is not None and math.isfinite(std) else None,
            parameter_std=_root(self.parameter_squares[j], count),
            coverage=self.coverage.of_joint(j),
        )


def _root(squares: float, over: float) -> float | None:
    """Return the root of a ratio; None where there is nothing to divide by."""
    return math.sqrt(squares / over) if over else None
