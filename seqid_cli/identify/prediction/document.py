"""Predicted torques as a document: errors added up log by log, with a verdict for each joint."""

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.judging import as_a_whole, physics_verdicts
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.identify.prediction.torque_files import mcap_writer, parquet_writer
from seqid_cli.model.effects.fitted import effect_notes
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.document import head, present, robot_id
from seqid_cli.params.results import prediction
from seqid_cli.params.results.prediction import JointError, PredictionFile
from seqid_cli.params.schema import Stages, Verdict
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array


def prediction_file(
    inputs: Inputs,
    logs: LogSet,
    predictions: Iterable[LogPrediction],
    torques: Path | None,
    cutoff_origin: str,
    *,
    unexplained: bool,
) -> PredictionFile:
    """Add up the errors of predictions, and write their torques where these are wanted.

    `logs` is read while the predictions, parts of a long log one by one, are taken. `torques` go to
    MCAP if it ends so, else Parquet. `unexplained`: whether smooth terms of no known cause count.
    """
    robot, stages = inputs.robot, inputs.stages
    names = robot.joint_names
    overall = own = none = np.zeros((2, 4, len(names)))
    errors = []
    effects = effect_notes(stages, unexplained=unexplained)
    with _writer(torques, inputs) as write:
        for log in predictions:
            own = _both(own, _sums(log))
            write(log)
            if log.last:
                error = prediction.LogPredictionError(
                    path=str(log.path),
                    sha256=log.sha256,
                    samples=log.samples,
                    cutoff_hz=log.cutoff_hz,
                    joints=_joints(own, names),
                    notes=list(log.notes),
                    motion=log.motion,
                )
                errors.append(error)
                overall, own = _both(overall, own), none
    joints = _joints(overall, names)
    still = ", ".join(name for name, error in joints.items() if not error.samples)
    notes = [f"never slides in these logs and is not judged: {still}"] if still else []
    own_verdicts = [*_verdicts(joints, stages, robot), *physics_verdicts(stages, robot)]
    return PredictionFile(
        **head(prediction.PREDICTION_SCHEMA),
        robot=robot_id(robot),
        inputs=logs.inputs(),
        parameters=inputs.ids(),
        stages=list(present(stages)),
        joints=joints,
        logs=errors,
        cutoff_origin=cutoff_origin or "chosen per log",
        verdicts=as_a_whole([*own_verdicts, *logs.verdicts()]),
        notes=[*effects, *notes, *logs.notes()],
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


def _sums(log: LogPrediction) -> Array:
    """Sums (2, 4, n) over one log: samples, squared errors and torques, and the largest error."""
    # Over all samples that count, then over those that slide: at rest friction takes any value up
    # to its limit, and the error is the distance to that interval.
    used = np.broadcast_to(log.used[:, None], log.tau.shape)
    found = []
    for counts, left in ((used, log.beyond), (log.sliding, log.residual)):
        error, torque = (np.where(counts, values, 0.0) for values in (left, log.tau))
        sums = [values.sum(axis=0) for values in (counts, np.square(error), np.square(torque))]
        found.append([*sums, np.abs(error).max(axis=0, initial=0.0)])
    return np.array(found)


def _both(first: Array, second: Array) -> Array:
    """Sums over two logs."""
    both = first + second
    both[:, 3] = np.maximum(first[:, 3], second[:, 3])
    return both


def _joints(sums: Array, names: tuple[str, ...]) -> dict[str, JointError]:
    def root(squares: float, over: float) -> float | None:
        return math.sqrt(squares / over) if over else None

    found = {}
    for j, name in enumerate(names):
        (every, squares, *_), (count, error, torque, largest) = sums[:, :, j].tolist()
        found[name] = JointError(
            rmse=root(error, count),
            relative_rmse=root(error, torque),
            max_abs=largest if count else None,
            samples=int(count),
            rmse_all=root(squares, every),
            samples_all=int(every),
            share_sliding=count / every if every else None,
        )
    return found


def _verdicts(
    joints: dict[str, JointError], stages: Stages, robot: Robot, *, max_relative_rmse: float = 0.3
) -> Iterator[Verdict]:
    """A joint is poor where the model lacks something of it, or errs too much to rely on it."""
    bare = stages.inertia is None and not free_basis(robot).gravity.all()
    surfaces = friction_surfaces(stages, robot)
    for (name, error), surface in zip(joints.items(), surfaces, strict=True):
        share = error.relative_rmse
        left, limit = "-" if share is None else percent(share), percent(max_relative_rmse)
        faults = {
            "the file holds no friction of this joint": surface is None,
            "the file holds no inertia stage": bare,
            f"the error is {left} of the torque's RMS, above {limit}": (
                share is None or share > max_relative_rmse
            ),
        }
        reason = "; ".join(text for text, holds in faults.items() if holds)
        if error.samples:
            yield Verdict(joint=name, good=not reason, reason=reason)
