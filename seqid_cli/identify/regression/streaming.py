"""Which logs are passed over instead of held, in memory that does not grow with them.

A log that is held has its motion in one block. A long one is passed over twice: to lay its time
base and choose its cut-off (`motion.filters.survey`; a third time where its stamps are uneven), and
to filter, decimate and reduce its equations block by block. Both give the same: blocks are cut on
the same grid, filtered with all the samples that the filter remembers, and reduced to the same
factors (`rigid.inertia_equations`).
"""

from pathlib import Path

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.long import likely_rows
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.blocks import (
    SurveyedLog,
    open_surveyed,
)
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.survey import Survey
from seqid_cli.motion.motion import as_asked, encoder_resolution
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LONG = 200_000  # samples from which on a log is better passed over than held


def streams(stages: Stages, options: InertiaOptions) -> bool:
    """Whether long logs may be passed over: the motion is to be that of the encoders."""
    imus = stages.imu is not None and bool(stages.imu.imus)
    return options.source == "encoder" or (options.source in ("auto", "needed") and not imus)


def open_if_long(
    path: Path, robot: Robot, *, time_source: TimeSource = "header", least: int | None = None
) -> SurveyedLog | None:
    """Open a log of at least so many samples (`LONG`) to be passed over.

    Returns None where the log is shorter, or can only be read as a whole. Raises InputError: the
    file cannot be read or lacks a channel.
    """
    least = LONG if least is None else least
    if likely_rows(path) < least:
        return None
    log = open_surveyed(path, robot, time_source=time_source)
    return log if log is not None and log.samples >= least else None


def survey_of(log: Recording | SurveyedLog) -> Survey:
    """Noise steps and cut-off by a log's positions."""
    if isinstance(log, Recording):
        return Survey.of(log.q, log.rate_hz)
    assert log.survey is not None
    return log.survey


def chosen_cutoff(log: SurveyedLog, robot: Robot, options: MotionOptions) -> tuple[Cutoff, Array]:
    """Choose the cut-off of a log; returns it and the noise steps (n,) rad."""
    resolution, survey = encoder_resolution(robot), survey_of(log)
    cutoff = as_asked(survey.cutoff(resolution), log.path, log.rate_hz, options)
    return cutoff, survey.noise_step(resolution)
