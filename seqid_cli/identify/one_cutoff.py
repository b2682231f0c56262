"""One low-pass cut-off per identification, and for every later stage that builds on it.

An inertia that is identified below one cut-off holds what the logs say there: friction that lags,
elasticity and what else a model leaves out enter it differently elsewhere. So all logs of a stage
are filtered alike: the scores of `motion.cutoff`, log S - KAPPA N / S, add up over logs and joints,
and the sum is maximised; the slowest rate of the logs limits it. The file carries the cut-off and
later stages take it (`inherited`), unless the user gives another.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import SeqidError
from seqid_cli.identify.streaming import open_if_long
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.stored import local_copy
from seqid_cli.motion.cutoff import BANDWIDTHS, HIGHEST_HZ, LOWEST_HZ, Score, first_maximum, score
from seqid_cli.motion.motion import encoder_resolution, highest_bridged
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segments import moving_mask, noise_step
from seqid_cli.motion.survey import SurveyedLog
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

GRID: Array = np.geomspace(LOWEST_HZ, HIGHEST_HZ, 200)


@dataclass(frozen=True)
class LogScore:
    """What one log says of every cut-off of `GRID`, and the highest that it allows [Hz]."""

    score: Score
    highest_hz: float


def score_of(log: Recording | SurveyedLog, robot: Robot) -> LogScore | None:
    """Score the cut-offs of one log; None where no joint moves.

    Parameters
    ----------
    log : Recording or SurveyedLog
        Held, or passed over once.
    robot : Robot
    """
    resolution, rate = encoder_resolution(robot), log.rate_hz
    if isinstance(log, SurveyedLog):
        assert log.survey is not None
        found = log.survey.score(resolution, GRID)
        return None if found is None else LogScore(found, min(HIGHEST_HZ, rate / 8))
    step = noise_step(log.q, resolution)
    moving = np.flatnonzero(moving_mask(log.q, rate, step).any(axis=0))
    if not len(moving):
        return None
    found = score(log.q[:, moving], rate, resolution[moving], GRID)
    return LogScore(found, min(HIGHEST_HZ, rate / 8, highest_bridged(log)))


def chosen_together(scores: Sequence[LogScore]) -> float | None:
    """The cut-off [Hz] that suits all logs together; None without any.

    The order of the logs does not matter.
    """
    if not scores:
        return None
    ordered = sorted(scores, key=lambda one: tuple(one.score.values))  # sums to the last bit
    total = np.sum([one.score.values for one in ordered], axis=0)
    bandwidth = max(one.score.bandwidth_hz for one in scores)
    highest = min(one.highest_hz for one in scores)
    highest = min(highest, max(BANDWIDTHS * bandwidth, 2 * LOWEST_HZ))
    allowed = max(1, int(np.searchsorted(GRID, highest, side="right")))
    return float(GRID[first_maximum(total[:allowed])])


def identification_options(
    paths: Sequence[Path],
    robot: Robot,
    *,
    cutoff_hz: float | None,
    smoothed: bool = False,
    time_source: TimeSource = "header",
) -> MotionOptions:
    """How all logs of an identification are filtered.

    A single log chooses for itself as it is read. Several are looked at first, and read again.

    Parameters
    ----------
    paths : sequence of Path
        The logs.
    robot : Robot
    cutoff_hz : float or None
        As given by the user.
    smoothed : bool
        Whether motion may come from the smoother, whose choice needs the smoothed motion: then each
        log still chooses for itself.
    time_source : {"header", "log"}
        As for `read_recording`.
    """
    if cutoff_hz is not None:
        return MotionOptions(cutoff_hz, origin="as given")
    if len(paths) < 2 or smoothed:
        return MotionOptions()
    found: list[LogScore] = []
    for path in paths:
        # Errors are told when the log is read to be identified from.
        with contextlib.suppress(SeqidError), local_copy(path) as copy:
            file = Path(copy)
            log = open_if_long(file, robot, time_source=time_source)
            own = score_of(log or read_recording(file, robot, time_source=time_source), robot)
            found += [own] if own is not None else []
    hz = chosen_together(found)
    return MotionOptions(hz, origin=f"chosen from all {len(paths)} logs together" if hz else "")


def inherited(stages: Stages, cutoff_hz: float | None) -> MotionOptions:
    """How logs are filtered by what builds on stages: as these were, unless the user says so."""
    if cutoff_hz is not None:
        return MotionOptions(cutoff_hz, origin="as given")
    if stages.inertia is None or stages.inertia.cutoff_hz is None:
        return MotionOptions()
    return MotionOptions(stages.inertia.cutoff_hz, origin="of the inertia stage")
