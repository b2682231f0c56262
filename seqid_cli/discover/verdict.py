"""Whether anything is missing: what the file leaves of each joint's torque, against its noise.

The parameter file is judged as it came, on all rows that it sees. A model that is
fitted to these rows says why more than noise is left: where it leaves noise only, the
form of the model is right and the file's values are not; where it leaves more,
something is missing that no effect explains; where it predicts left-out blocks worse
than the file does, the logs are too short to tell.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

import numpy as np

from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.select.changes import Cause, causes_at
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.rows import doubt_of
from seqid_cli.params.results import diagnosis
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

JointState = Literal["unseen", "noise", "found", "changed", "too_short", "unexplained"]

FITTED = 0.5  # of what the file leaves, below which a fitted model blames its values


def joint_states(
    found: Investigation, ordinary: Array, most_of_noise: Array
) -> list[JointState]:
    """Return what the file leaves of each joint's torque.

    Parameters
    ----------
    found : Investigation
    ordinary : (n,) array
        RMS torque that a right model leaves [N m; N where prismatic].
    most_of_noise : (n,) array
        The most that it leaves: the upper end of the noise floor's interval.

    Returns
    -------
    list of JointState
        `found` where an effect or a smooth function was found at the joint.
    """
    return [
        _state(found, joint, MORE_THAN_NOISE * ordinary[joint], most_of_noise[joint])
        for joint in range(found.ground.n)
    ]


def _state(
    found: Investigation, joint: int, many_floors: float, most_of_noise: float
) -> JointState:
    if found.file_residual.samples[joint] == 0:
        return "unseen"
    if joint in found.explained_joints:
        return "found"

    left_by_file = found.file_rms[joint]
    if left_by_file <= min(most_of_noise, many_floors):
        return "noise"
    if found.floor.rms[joint] <= 0.0 or predicted_worse(found, joint):
        return "too_short"

    left_when_fitted = found.model.rms()[joint]
    if left_when_fitted <= min(FITTED * left_by_file, many_floors):
        return "changed"
    if left_when_fitted <= most_of_noise < left_by_file and predicted_better(
        found, joint
    ):
        return "changed"
    # Between the two bounds a small lack cannot be told from noise that is larger than
    # it seems.
    return (
        "unexplained" if left_by_file > max(most_of_noise, many_floors) else "too_short"
    )


def predicted_worse(found: Investigation, joint: int) -> bool:
    """Whether a model fitted to a part of the logs surely predicts the rest worse."""
    fitted, file = _squares(found, joint)
    return doubt_of(fitted - (1.0 + Options.improvement) * file) <= Options.doubt


def predicted_better(found: Investigation, joint: int) -> bool:
    """Whether a model fitted to a part of the logs surely predicts the rest better."""
    fitted, file = _squares(found, joint)
    return doubt_of((1.0 - Options.improvement) * file - fitted) <= Options.doubt


def _squares(found: Investigation, joint: int) -> tuple[Array, Array]:
    """Squared errors (blocks,) of the model on blocks it was not fitted to, and of the file."""
    rows = found.ground.rows
    block = rows.block[joint]
    left_out, file = found.model.linear.left_out[joint], found.ground.base.y[joint]
    fitted_squares = np.bincount(block, left_out**2, minlength=rows.blocks)
    file_squares = np.bincount(block, file**2, minlength=rows.blocks)
    return np.asarray(fitted_squares, dtype=float), np.asarray(
        file_squares, dtype=float
    )


def verdict_of(
    findings: Collection[diagnosis.FindingEntry],
    unexplained: Collection[diagnosis.UnexplainedPart],
    states: Collection[JointState],
) -> diagnosis.DiagnosisVerdict:
    """Return the verdict in the words of the contract."""
    if findings:
        return "effect_found"
    if unexplained:
        return "unexplained"
    if "changed" in states:
        return "values_changed"
    if "too_short" in states:
        return "too_short"
    if set(states) == {"unseen"}:
        return "nothing_seen"
    return "nothing_missing"


def changed_values(
    found: Investigation, robot: Robot, states: Collection[JointState]
) -> list[diagnosis.ChangedValues]:
    """Describe the joints at which the file's values do not hold, the most floors first."""
    changed = [
        _changed_at(found, robot, joint)
        for joint, state in enumerate(states)
        if state == "changed"
    ]
    return sorted(changed, key=lambda one: -one.floors)


def _changed_at(
    found: Investigation, robot: Robot, joint: int
) -> diagnosis.ChangedValues:
    left_by_file = float(found.file_rms[joint])
    told = [taken.term for taken in found.selection.terms]
    causes = causes_at(found.model, joint, told)
    return diagnosis.ChangedValues(
        joint=robot.joint_names[joint],
        rmse=left_by_file,
        rmse_refitted=float(found.model.rms()[joint]),
        floors=left_by_file / float(found.floor.rms[joint]),
        since=_since(found, joint),
        causes=[_described(cause, robot) for cause in causes],
    )


def _described(cause: Cause, robot: Robot) -> diagnosis.ChangeCause:
    return diagnosis.ChangeCause(
        effect=cause.term.name,
        joint=robot.name_of(cause.term.joint),
        probability=cause.probability,
        log_gain=cause.log_gain,
    )


def _since(found: Investigation, joint: int) -> str | None:
    """Path of the first log that leaves more than noise; None where all do."""
    left = found.file_residual.rms_by_log[:, joint]
    stands_out = left > found.floor.high[joint]
    seen = np.isfinite(left)
    if np.array_equal(stands_out, seen):
        return None
    starts = [scene.start for scene in found.ground.stage.scenes]
    in_order = np.argsort(starts, kind="stable")
    first = next((log for log in in_order if stands_out[log]), None)
    return None if first is None else str(found.logs[first].path)
