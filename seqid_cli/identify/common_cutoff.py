"""One low-pass cut-off per identification, and for every later stage that builds on it.

An inertia that is identified below one cut-off holds what the logs show there: friction
that lags, elasticity and what else a model leaves out enter it differently elsewhere.
So all logs of a stage are filtered alike. The scores of `motion.filters.bandwidth`, log
S - KAPPA N / S, add up over logs and joints, and the sum is maximised; the slowest rate
of the logs limits it. From there the identification itself looks for the smallest error
of the predicted torque (`rigid.cutoff_choice`), on pieces of the logs where they are
long. The file carries the cut-off and later stages take it (`inherited`), unless the
user gives another.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.identify.options import RigidOptions
from seqid_cli.identify.regression.equations import survey_of
from seqid_cli.identify.rigid.cutoff_choice import (
    SAMPLES_PER_CUTOFF,
    CutoffChoice,
    Trial,
    choose_cutoff,
)
from seqid_cli.identify.settings import CutoffSettings
from seqid_cli.imu.link_acceleration import best_motion
from seqid_cli.imu.smoother.fused import score_of_smoothed
from seqid_cli.logs import long as long_logs
from seqid_cli.logs.long import LongLog, open_if_long
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Range, Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.motion.filters import bandwidth
from seqid_cli.motion.motion import encoder_resolution, estimate_motion, highest_bridged
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

GRID: Array = np.geomspace(bandwidth.LOWEST_HZ, bandwidth.HIGHEST_HZ, 200)


@dataclass(frozen=True, kw_only=True)
class _Surveyed:
    """What one log says of cut-offs before anything is identified.

    `score` is by the encoders, `smoothed` by the smoothed motion where IMUs take part,
    `highest_hz` the highest cut-off that the log allows, `pieces` what cut-offs are
    tried on: the whole log where it is short.
    """

    score: bandwidth.Score
    smoothed: bandwidth.Score | None
    highest_hz: float
    seconds: float
    pieces: list[Recording]

    @property
    def used_score(self) -> bandwidth.Score:
        """The score by the motion that is used of the log."""
        return self.smoothed or self.score


def _survey(
    given: Path | Recording,
    robot: Robot,
    options: RigidOptions,
    imu: ImuStage | None,
    reading: Reading,
    most_values: float,
) -> _Surveyed | None:
    """Score the cut-offs of one log, and keep pieces of it; None where no joint moves.

    `most_values`: samples times joints of the pieces.
    """
    source = options.source
    fuses = imu is not None and bool(imu.imus) and source != "encoder"
    with contextlib.ExitStack() as stack:
        log: Recording | LongLog
        if isinstance(given, Recording):
            log = given
        else:
            file = Path(stack.enter_context(local_copy(given)))
            long = None
            if not fuses:
                long = open_if_long(file, robot, reading=reading, least=long_logs.LONG)
            log = long or read_recording(file, robot, reading=reading)

        score = survey_of(log).score(encoder_resolution(robot), GRID)
        if score is None:
            return None
        highest_hz = log.rate_hz / 8
        smoothed = None
        if isinstance(log, Recording):
            highest_hz = min(highest_hz, highest_bridged(log))
            if fuses:
                encoder = estimate_motion(log, robot, MotionOptions())
                best = best_motion(log, robot, imu, encoder, source=source)
                if best.source == "fused":
                    smoothed = score_of_smoothed(log, robot, imu, encoder, GRID)

        seconds = log.whole.length
        ranges = _spread(seconds, most_values / robot.n / log.rate_hz)
        if isinstance(log, Recording) and not ranges:
            pieces = [log]
        else:
            pieces = log.pieces(ranges or [(0.0, log.length)])
        return _Surveyed(
            score=score,
            smoothed=smoothed,
            highest_hz=min(bandwidth.HIGHEST_HZ, highest_hz),
            seconds=seconds,
            pieces=pieces,
        )


def _spread(length_s: float, wanted_s: float, *, piece_s: float = 16.0) -> list[Range]:
    """Return pieces of `piece_s` spread evenly over a log, none of a short log."""
    # Longer pieces would be reduced in chunks, whose blocks of time differ with the
    # cut-off.
    if length_s <= 1.5 * piece_s:
        return []
    count = max(1, int(min(wanted_s, length_s) / piece_s))
    middles = (np.arange(count) + 0.5) * length_s / count
    return [(float(m - piece_s / 2), float(m + piece_s / 2)) for m in middles]


def _fewer(pieces: list[Recording], share: float) -> list[Recording]:
    """Return about a share of the pieces of one log, spread evenly; at least one."""
    count = max(1, round(share * len(pieces)))
    return [pieces[int((k + 0.5) * len(pieces) / count)] for k in range(count)]


def _summed(scores: Sequence[bandwidth.Score], allowed_hz: float) -> tuple[Array, int]:
    """Return the logs' summed scores, and the number of cut-offs that all logs allow.

    The cut-offs are those of the grid.
    """
    ordered = sorted(tuple(score.values) for score in scores)  # sums to the last bit
    highest_hz = bandwidth.highest_of(
        max(score.bandwidth_hz for score in scores),
        max(score.joints for score in scores),
        sum(score.seconds for score in scores),
    )
    count = int(np.searchsorted(GRID, min(highest_hz, allowed_hz), side="right"))
    return np.sum(ordered, axis=0), max(1, count)


def identification_options(
    logs: Sequence[Path | Recording],
    robot: Robot,
    options: RigidOptions,
    imu: ImuStage | None,
    trial: Trial | None = None,
    *,
    reading: Reading = HEADER_STAMPS,
    most_values: float = 1e6,
    limits: CutoffSettings = CutoffSettings(),
) -> MotionOptions:
    """Return how all logs of an identification are filtered, whatever their order.

    Parameters
    ----------
    logs : sequence of Path or Recording
        All logs of the identification; they are looked at first, and read again.
    imu : ImuStage, optional
        Calibrated IMUs, whose motion counts where they can be used.
    trial : Trial, optional
        Whoever identifies, to find the cut-off with the smallest error of the predicted
        torque. Without one the motion alone decides.
    reading : Reading
        By which stamps logs are read, and which part of them.
    most_values : float
        Samples times joints that cut-offs are tried on: pieces of logs that have more.
    limits : CutoffSettings
        What makes a cut-off admissible.
    """
    if options.cutoff_hz is not None:
        return MotionOptions(options.cutoff_hz, origin="as given")
    surveys: list[_Surveyed] = []
    if trial is not None or len(logs) > 1:
        for log in logs:
            # Errors are reported when the log is read to be identified from.
            with contextlib.suppress(SeqidError):
                survey = _survey(
                    log, robot, options, imu, reading, most_values / len(logs)
                )
                if survey is not None:
                    surveys.append(survey)
    if not surveys:
        return MotionOptions()

    # By the motion: what all logs allow, and the sum of their scores.
    highest_hz = min(survey.highest_hz for survey in surveys)
    total, allowed = _summed([survey.score for survey in surveys], highest_hz)
    by_encoders = bandwidth.first_maximum(total[:allowed])
    best = by_encoders
    if any(survey.smoothed for survey in surveys):
        # The lowest that scores nearly as well by the smoothed motion, from the
        # encoders' best on.
        total, allowed = _summed([survey.used_score for survey in surveys], highest_hz)
        joints = sum(survey.score.joints for survey in surveys)
        best += bandwidth.lowest_as_good(total[best : max(allowed, best + 1)], joints)
    hz = float(GRID[best])
    encoder_hz = float(GRID[by_encoders])
    origin = "chosen from the log"
    if len(logs) > 1:
        origin = f"chosen from all {len(logs)} logs together"
    if trial is not None:
        # No higher than the motion's bandwidth allows: beyond it parameters gain
        # little, and every prediction at the inherited cut-off would have the torque's
        # noise.
        bounded_hz = min(highest_hz, float(GRID[allowed - 1]))
        choice = _by_posterior(trial, surveys, hz, highest_hz=bounded_hz, limits=limits)
        hz = choice.cutoff_hz
        encoder_hz = min(encoder_hz, hz)
        origin += ": the smallest error of the predicted torque"
    return MotionOptions(cutoff_hz=hz, origin=origin, encoder_hz=encoder_hz)


def _by_posterior(
    trial: Trial,
    surveys: Sequence[_Surveyed],
    start_hz: float,
    *,
    highest_hz: float,
    limits: CutoffSettings,
    most_rows: float = 2e4,
) -> CutoffChoice:
    """Choose the cut-off by what is identified from pieces of the logs.

    `most_rows`: samples of the pieces that stay an octave above the start.
    """
    most_s = most_rows / (2.0 * SAMPLES_PER_CUTOFF * start_hz)
    available_s = sum(
        float(piece.t[-1]) for survey in surveys for piece in survey.pieces
    )
    share = min(1.0, most_s / max(available_s, 1e-9))
    pieces: list[Recording] = []
    for survey in surveys:
        pieces += _fewer(survey.pieces, share)
    # In an order of their own, so that sums are the same to the last bit.
    pieces.sort(key=lambda piece: piece.sha256)

    noise = _noise_shares(surveys).of_acceleration()
    tried_s = sum(float(piece.t[-1]) for piece in pieces)
    logged_s = sum(survey.seconds for survey in surveys)
    return choose_cutoff(
        lambda hz: trial(pieces, hz),
        start_hz,
        lowest_hz=bandwidth.LOWEST_HZ,
        highest_hz=highest_hz,
        acceleration_noise=lambda hz: _at(noise, hz),
        represented=logged_s / max(tried_s, 1e-9),
        limits=limits,
    )


def _noise_shares(surveys: Sequence[_Surveyed]) -> bandwidth.NoiseShares:
    """Return the share of noise in the motion that is used of all logs."""
    shares = [survey.used_score.shares for survey in surveys]
    return reduce(add, [share for share in shares if share is not None])


def _at(values: Array, hz: float) -> float:
    """Return the value at a cut-off [Hz] of one that is given for those of the grid."""
    return float(np.interp(np.log(hz), np.log(GRID), values))


def inherited(stages: Stages, cutoff_hz: float | None) -> MotionOptions:
    """Return the motion options by `cutoff_hz`, else by the inertia stage."""
    if cutoff_hz is not None:
        return MotionOptions(cutoff_hz, origin="as given")
    if stages.inertia is None or stages.inertia.cutoff_hz is None:
        return MotionOptions()
    return MotionOptions(stages.inertia.cutoff_hz, origin="of the inertia stage")
