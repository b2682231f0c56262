"""Predicted torques as a document.

Errors are added up log by log, and each joint gets a verdict.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqid_cli.effects.fitted import effect_notes
from seqid_cli.identify.bands.coverage import CoverageCounter
from seqid_cli.identify.bands.prediction import Bands
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.judging import as_a_whole
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.prediction.model_checks import model_verdicts
from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.identify.prediction.verdicts import joint_verdicts, noise_floors
from seqid_cli.identify.settings import PredictSettings
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
    """Add up the errors of predictions, and write their torques to a file if wanted.

    Parameters
    ----------
    inputs : Inputs
        Robot, model and their documents.
    logs : LogSet
        The logs. They are read while the predictions are iterated over.
    predictions : iterable of LogPrediction
        Predictions of the logs, the parts of a long log one after the other.
    torques : Path or None
        File for the torques: MCAP by its suffix, else Parquet. None writes nothing.
    cutoff_origin : str
        Origin of the cut-off, empty where it was chosen per log.
    unexplained : bool
        Whether smooth terms of no known cause count.
    settings : PredictSettings
        Limits of the verdicts.

    Returns
    -------
    PredictionFile
        Errors by log and overall, verdicts and notes.
    """
    robot = inputs.robot
    stages = inputs.stages
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
    cutoffs_hz = [error.cutoff_hz for error in errors]
    notes = []
    resting = ", ".join(name for name, error in joints.items() if not error.samples)
    if resting:
        notes.append(f"never slides in these logs and is not judged: {resting}")
    notes += Bands.from_stages(stages, robot).notes(cutoffs_hz)

    floors = noise_floors(stages, cutoffs_hz)
    verdicts = [
        *joint_verdicts(
            joints, stages, robot, noise_floors=floors, settings=settings.errors
        ),
        *model_verdicts(stages, robot, settings.judging),
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
    """Open the file of torques; its context gives the function that appends a part."""
    names = inputs.robot.joint_names
    if torques is None:
        return nullcontext(lambda _: None)
    from seqid_cli.identify.prediction.torque_files import mcap_writer, parquet_writer

    if torques.suffix.lower() == ".mcap":
        return mcap_writer(torques, names)
    return parquet_writer(torques, names, [item.sha256 for item in inputs.ids()])


@dataclass
class Sums:
    """Sums (n,) over some samples of each joint."""

    samples: Array  # their number
    error_squares: Array  # (N m)^2
    torque_squares: Array  # (N m)^2
    largest: Array  # largest error without sign, N m

    @classmethod
    def none(cls, n: int) -> "Sums":
        """Return sums over no samples of n joints."""
        return cls(
            samples=np.zeros(n),
            error_squares=np.zeros(n),
            torque_squares=np.zeros(n),
            largest=np.zeros(n),
        )

    def add(self, counts: Mask, error: Array, torque: Array) -> None:
        """Add the samples (N, n) that count, of errors and measured torques [N m]."""
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
    """Sums of errors of predicted torques, part by part of the logs.

    Samples that count (`counted`) are `sliding` or `at_rest`. At rest friction takes
    any value up to its limit, and the error is the distance to that interval. Sliding
    samples are `inside` the positions and speeds at which friction was identified, or
    `outside`.
    """

    counted: Sums
    sliding: Sums
    inside: Sums
    outside: Sums
    at_rest: Sums
    std_squares: Array  # (n,) (N m)^2, sums over the sliding samples
    parameter_squares: Array  # likewise, of the part by errors of parameters
    coverage: CoverageCounter

    @classmethod
    def none(cls, n: int) -> "ErrorSums":
        """Return the sums over no log, for n joints."""
        return cls(
            counted=Sums.none(n),
            sliding=Sums.none(n),
            inside=Sums.none(n),
            outside=Sums.none(n),
            at_rest=Sums.none(n),
            std_squares=np.zeros(n),
            parameter_squares=np.zeros(n),
            coverage=CoverageCounter(),
        )

    def add(self, log: LogPrediction) -> None:
        """Add a log, or a part of one."""
        used = np.broadcast_to(log.used[:, None], log.tau.shape)
        outside = log.sliding & log.outside
        self.counted.add(used, log.beyond, log.tau)
        self.sliding.add(log.sliding, log.residual, log.tau)
        self.inside.add(log.sliding & ~outside, log.residual, log.tau)
        self.outside.add(outside, log.residual, log.tau)
        self.at_rest.add(used & ~log.sliding, log.beyond, log.tau)

        std = np.where(log.sliding, log.std, 0.0)
        parameter_std = np.where(log.sliding, log.parameter_std, 0.0)
        self.std_squares += np.square(std).sum(axis=0)
        self.parameter_squares += np.square(parameter_std).sum(axis=0)
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
        """Return the errors of joint `j`."""
        sliding = self.sliding
        n_sliding = float(sliding.samples[j])
        n_samples = float(self.counted.samples[j])
        n_outside = float(self.outside.samples[j])
        # A joint without any statement on its errors has a deviation of NaN.
        std = _root(self.std_squares[j], n_sliding)
        return JointError(
            rmse=sliding.rmse(j),
            relative_rmse=_root(sliding.error_squares[j], sliding.torque_squares[j]),
            max_abs=float(sliding.largest[j]) if n_sliding else None,
            samples=int(n_sliding),
            rmse_all=self.counted.rmse(j),
            samples_all=int(n_samples),
            share_sliding=n_sliding / n_samples if n_samples else None,
            rmse_inside=self.inside.rmse(j),
            rmse_outside=self.outside.rmse(j),
            share_outside=n_outside / n_sliding if n_sliding else None,
            rmse_rest=self.at_rest.rmse(j),
            std=std if std is not None and math.isfinite(std) else None,
            parameter_std=_root(self.parameter_squares[j], n_sliding),
            coverage=self.coverage.of_joint(j),
        )


def _root(numerator: float, denominator: float) -> float | None:
    """Return the root of a ratio; None where the denominator is zero."""
    return math.sqrt(numerator / denominator) if denominator else None
