"""Whether anything is missing: what the file leaves of each joint, against its noise.

The parameter file is judged as it came, on all rows that it sees. A model that is
fitted to these rows says why more than noise is left: where it leaves noise only, the
form of the model is right and the file's values are not; where it leaves more,
something is missing that no effect explains; where it predicts left-out blocks worse
than the file does, the logs are too short to tell. A joint of which nothing was seen
does not pass for one of which nothing is missing.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

import numpy as np

from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.select.changes import Cause, causes_at
from seqid_cli.discover.select.rows import doubt_of
from seqid_cli.params.results import diagnosis
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.typing import Array

JointState = Literal["unseen", "noise", "found", "changed", "too_short", "unexplained"]
VERDICT_OF_STATE: dict[JointState, diagnosis.DiagnosisVerdict] = {
    "unseen": "nothing_seen",
    "noise": "nothing_missing",
    "found": "effect_found",
    "changed": "values_changed",
    "too_short": "too_short",
    "unexplained": "unexplained",
}

FITTED = 0.5  # of what the file leaves, below which a fitted model blames its values


def joint_states(
    investigation: Investigation,
    ordinary: Array,
    most_of_noise: Array,
    *,
    nameless: Collection[int] = (),
) -> list[JointState]:
    """Return what the file leaves of each joint's torque.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    ordinary : (n,) array
        RMS torque that a right model leaves [N m; N where prismatic].
    most_of_noise : (n,) array
        The most that it leaves: the upper end of the noise floor's interval.
    nameless : collection of int
        Joints at which something is missing whose name is too unsure to be told.

    Returns
    -------
    list of JointState
        `found` where an effect or a smooth function was found at the joint.
    """
    return [
        _state(
            investigation,
            joint,
            many_floors=MORE_THAN_NOISE * ordinary[joint],
            most_of_noise=most_of_noise[joint],
            is_nameless=joint in nameless,
        )
        for joint in range(investigation.ground.n)
    ]


def _state(
    investigation: Investigation,
    joint: int,
    *,
    many_floors: float,
    most_of_noise: float,
    is_nameless: bool,
) -> JointState:
    """Return what the file leaves of a joint's torque; both bounds in N m."""
    if investigation.file_residual.samples[joint] == 0:
        return "unseen"
    if joint in investigation.explained_joints:
        return "found"

    left_by_file = investigation.file_rms[joint]
    if left_by_file <= min(most_of_noise, many_floors):
        return "unseen" if is_drowned(investigation, joint) else "noise"
    if is_nameless:
        return "unexplained"
    has_no_floor = investigation.floor.rms[joint] <= 0.0
    if has_no_floor or predicted_worse(investigation, joint):
        return "too_short"

    # The form of the model is right where a fit leaves noise alone.
    left_when_fitted = investigation.model.rms()[joint]
    if left_when_fitted <= min(FITTED * left_by_file, many_floors):
        return "changed"
    fit_leaves_noise = left_when_fitted <= most_of_noise < left_by_file
    if fit_leaves_noise and predicted_better(investigation, joint):
        return "changed"

    # Between the two bounds a small lack cannot be told from noise that is larger than
    # it seems.
    is_more_than_noise = left_by_file > max(most_of_noise, many_floors)
    return "unexplained" if is_more_than_noise else "too_short"


def is_drowned(investigation: Investigation, joint: int) -> bool:
    """Return whether noise is as large as a joint's torque: it hides all else."""
    return bool(
        investigation.floor.rms[joint] >= rms(investigation.ground.torque[joint])
    )


def predicted_worse(investigation: Investigation, joint: int) -> bool:
    """Return whether a model fitted to some blocks surely predicts others worse."""
    fitted, file = _squares(investigation, joint)
    options = investigation.ground.options
    loss = fitted - (1.0 + options.improvement) * file
    return doubt_of(loss) <= options.alpha


def predicted_better(investigation: Investigation, joint: int) -> bool:
    """Return whether a model fitted to some blocks surely predicts others better."""
    fitted, file = _squares(investigation, joint)
    options = investigation.ground.options
    gain = (1.0 - options.improvement) * file - fitted
    return doubt_of(gain) <= options.alpha


def _squares(investigation: Investigation, joint: int) -> tuple[Array, Array]:
    """Return squared errors (parts,) of the model and of the file.

    The model's are on parts that it was not fitted to.
    """
    rows = investigation.ground.rows
    left_out = investigation.model.linear.left_out[joint]
    of_file = investigation.ground.base.y[joint]
    return rows.by_part(joint, left_out**2), rows.by_part(joint, of_file**2)


def verdict_of(
    findings: Collection[diagnosis.FindingEntry],
    unexplained: Collection[diagnosis.UnexplainedPart],
    states: Collection[JointState],
) -> diagnosis.DiagnosisVerdict:
    """Return the verdict in the words of the contract.

    Parameters
    ----------
    findings : collection of FindingEntry
        Effects that are told.
    unexplained : collection of UnexplainedPart
        What no effect explains.
    states : collection of JointState
        What the file leaves of each joint's torque.
    """
    if findings:
        return "effect_found"
    if unexplained:
        return "unexplained"
    if "changed" in states:
        return "values_changed"
    if "too_short" in states:
        return "too_short"
    if "unseen" in states:
        return "nothing_seen"
    return "nothing_missing"


def changed_values(
    investigation: Investigation, robot: Robot, states: Collection[JointState]
) -> list[diagnosis.ChangedValues]:
    """Describe where the file's values do not hold, the most noise floors first.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    states : collection of JointState
        Of its joints.
    """
    changed = [
        _changed_at(investigation, robot, joint)
        for joint, state in enumerate(states)
        if state == "changed"
    ]
    return sorted(changed, key=lambda values: -values.floors)


def _changed_at(
    investigation: Investigation, robot: Robot, joint: int
) -> diagnosis.ChangedValues:
    left_by_file = float(investigation.file_rms[joint])
    told_terms = [result.term for result in investigation.selection.terms]
    causes = causes_at(investigation.model, joint, told_terms)
    return diagnosis.ChangedValues(
        joint=robot.joint_names[joint],
        rmse=left_by_file,
        rmse_refitted=float(investigation.model.rms()[joint]),
        floors=left_by_file / float(investigation.floor.rms[joint]),
        since=_since(investigation, joint),
        causes=[_described(cause, robot) for cause in causes],
    )


def _described(cause: Cause, robot: Robot) -> diagnosis.ChangeCause:
    return diagnosis.ChangeCause(
        effect=cause.term.name,
        joint=robot.name_of(cause.term.joint),
        probability=cause.probability,
        log_gain=cause.log_gain,
    )


def _since(investigation: Investigation, joint: int) -> str | None:
    """Return the first log that leaves more than noise; None where all do."""
    rms_by_log = investigation.file_residual.rms_by_log[:, joint]
    stands_out = rms_by_log > investigation.floor.high[joint]
    has_rows = np.isfinite(rms_by_log)
    if np.array_equal(stands_out, has_rows):
        return None
    starts = [scene.start for scene in investigation.ground.stage.scenes]
    in_order = np.argsort(starts, kind="stable")
    first = next((log for log in in_order if stands_out[log]), None)
    return None if first is None else str(investigation.logs[first].path)
