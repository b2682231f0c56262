"""One low-pass cut-off per identification, and for every later stage that builds on it.

An inertia that is identified below one cut-off holds what the logs show there: friction that lags,
elasticity and what else a model leaves out enter it differently elsewhere. So all logs of a stage
are filtered alike: the scores of `motion.filters.bandwidth`, log S - KAPPA N / S, add up over logs
and joints, and the sum is maximised; the slowest rate of the logs limits it. The file carries the
cut-off and later stages take it (`inherited`), unless the user gives another.
"""

import contextlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.identify.options import RigidOptions
from seqid_cli.identify.regression.equations import open_if_long, survey_of
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.motion.filters import bandwidth
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import encoder_resolution, estimate_motion, highest_bridged
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.smoother.fused import score_of_smoothed
from seqid_cli.params.schema import ImuStage, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

GRID: Array = np.geomspace(bandwidth.LOWEST_HZ, bandwidth.HIGHEST_HZ, 200)


# A log's score of `GRID`, and that by its smoothed motion; the highest Hz that it allows.
LogScore = tuple[bandwidth.Score, bandwidth.Score | None, float]


def _score_of(
    given: Path | Recording, robot: Robot, options: RigidOptions, imu: ImuStage | None
) -> LogScore | None:
    """Score the cut-offs of one log; None where no joint moves."""
    source, time_source = options.source, options.time_source
    fuses = imu is not None and bool(imu.imus) and source != "encoder"
    with contextlib.ExitStack() as stack:
        log: Recording | SurveyedLog
        if isinstance(given, Recording):
            log = given
        else:
            file = Path(stack.enter_context(local_copy(given)))
            long = None if fuses else open_if_long(file, robot, time_source=time_source)
            log = long or read_recording(file, robot, time_source=time_source)
        found, highest = survey_of(log).score(encoder_resolution(robot), GRID), log.rate_hz / 8
        if found is None:
            return None
        smoothed = None
        if isinstance(log, Recording):
            highest = min(highest, highest_bridged(log))
            encoder = estimate_motion(log, robot, MotionOptions()) if fuses else None
            if encoder and best_motion(log, robot, imu, encoder, source=source).source == "fused":
                smoothed = score_of_smoothed(log, robot, imu, encoder, GRID)
        return found, smoothed, min(bandwidth.HIGHEST_HZ, highest)


def _summed(scores: Sequence[bandwidth.Score], allowed_hz: float) -> tuple[Array, int]:
    """Sum of the logs' scores, and how many of the grid's cut-offs all allow."""
    ordered = sorted(tuple(one.values) for one in scores)  # sums to the last bit
    widest, joints = (max(getattr(x, name) for x in scores) for name in ("bandwidth_hz", "joints"))
    highest = bandwidth.highest_of(widest, joints, sum(one.seconds for one in scores))
    count = int(np.searchsorted(GRID, min(highest, allowed_hz), side="right"))
    return np.sum(ordered, axis=0), max(1, count)


def identification_options(
    logs: Sequence[Path | Recording], robot: Robot, options: RigidOptions, imu: ImuStage | None
) -> MotionOptions:
    """How all logs of an identification are filtered, whatever their order."""
    # A single log chooses for itself as it is read. Several are looked at first, and read again.
    if options.cutoff_hz is not None:
        return MotionOptions(options.cutoff_hz, origin="as given")
    found: list[LogScore] = []
    for given in logs if len(logs) > 1 else ():
        # Errors are reported when the log is read to be identified from.
        with contextlib.suppress(SeqidError):
            own = _score_of(given, robot, options, imu)
            found += [own] if own is not None else []
    if not found:
        return MotionOptions()
    highest = min(hz for *_, hz in found)
    total, allowed = _summed([score for score, *_ in found], highest)
    best = alone = bandwidth.first_maximum(total[:allowed])
    if any(smoothed for _, smoothed, _ in found):
        # The lowest that scores nearly as well by the smoothed motion, from the encoders' best on.
        total, allowed = _summed([smoothed or score for score, smoothed, _ in found], highest)
        joints = sum(score.joints for score, *_ in found)
        best += bandwidth.lowest_as_good(total[best : max(allowed, best + 1)], joints)
    origin = f"chosen from all {len(logs)} logs together"
    return MotionOptions(float(GRID[best]), origin=origin, encoder_hz=float(GRID[alone]))


def inherited(stages: Stages, cutoff_hz: float | None) -> MotionOptions:
    """How logs are filtered by what builds on stages: as these were, unless the user says so."""
    if cutoff_hz is not None:
        return MotionOptions(cutoff_hz, origin="as given")
    if stages.inertia is None or stages.inertia.cutoff_hz is None:
        return MotionOptions()
    return MotionOptions(stages.inertia.cutoff_hz, origin="of the inertia stage")
