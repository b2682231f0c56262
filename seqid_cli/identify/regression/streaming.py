"""Equations of logs of any length, in memory that does not grow with them.

A log that is held has its motion in one block. A long one is passed over twice: to lay its time
base and choose its cut-off (`motion.filters.survey`; a third time where its stamps are uneven), and
to filter, decimate and reduce its equations block by block. Both give the same, because

- blocks are cut on the same grid as there, filtered with all the samples that the filter remembers;
- each joint's equations are reduced to the factors of blocks of about a second, as ever; they carry
  what weights, standard errors (jackknife) and the judgement of the rotor coupling need, so
  nothing of it takes another pass.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.equations import CHUNK, FilteredColumns, blocks, torque_motion
from seqid_cli.logs.long import rows_at_least
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import sliding
from seqid_cli.motion.blocks import (
    SurveyedLog,
    make_plan,
    motion_blocks,
    open_surveyed,
    overlapping,
)
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.survey import Survey
from seqid_cli.motion.motion import Motion, as_asked, encoder_resolution, too_short
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import Basis
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

LONG = 200_000  # samples from which on a log is better passed over than held
LEAST_CHUNKS, MOST_CHUNKS = 2, 6  # of the equations, worked on together


class Equations(Protocol):
    """Takes the rows of one log, chunk by chunk."""

    robot: Robot
    basis: Basis
    stages: Stages
    options: InertiaOptions
    slowest: Array

    def right_side(self, motion: Motion) -> Array:
        """Torque (N, n) N m that the parameters are to explain."""
        ...

    def coupling_column(self, motion: Motion) -> Array:
        """One more column (N, n), filtered."""
        ...

    def expect(self, count: int, rows: int) -> None:
        """So many blocks of about so many rows follow; 0 when they have come."""
        ...

    def add_chunk(self, motion: Motion, H: Array, y: Array, usable: Mask) -> None:
        """Take rows H (N, n, b + 1), y (N, n)."""
        ...


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
    if not rows_at_least(path, least):
        return None
    log = open_surveyed(path, robot, time_source=time_source)
    return log if log is not None and log.samples >= least else None


def pass_over(
    log: Recording | SurveyedLog, equations: Equations, *, forgotten: float = 0.8
) -> Motion:
    """Add the rows of one log.

    `log`: the motion of one that is held is one block, of one to be passed over it comes in many.
    `equations`: given the rows. `forgotten`: share of the low-pass's memory that is computed beside
    a part: 0.8 of it leaves 1e-10. Returns: the last samples, `moving` (1, n) being that of all of
    them. Raises InputError if no stretch of the log is long enough to filter.
    """
    held = isinstance(log, Recording)
    if isinstance(log, Recording):
        parts, lowpass, samples = _held(log, equations)
    else:
        parts, lowpass, samples = _streamed(log, equations)
    reach = int(forgotten * lowpass.memory) + lowpass.settling
    rows = CHUNK * int(np.clip(-(-24 * reach // CHUNK), LEAST_CHUNKS, MOST_CHUNKS))
    columns = FilteredColumns(
        equations.robot, equations.basis, min(rows, samples), reach, equations.coupling_column
    )
    # How many blocks of equations a log will have.
    whole, rest = divmod(samples, CHUNK)
    sizes = [(CHUNK, whole), (rest, 1 if rest else 0)]
    expected = sum(times * sum(1 for _ in blocks(size, lowpass.rate_hz)) for size, times in sizes)
    equations.expect(expected, samples // max(expected, 1))
    moving, usable, last = np.zeros(equations.robot.n, dtype=bool), False, None
    # Right sides need little memory: they are made of longer parts than the regressor.
    for motion, start, stop in overlapping(parts, samples if held else 2 * rows, 2 * reach):
        y = equations.right_side(motion)
        for first in range(start, stop, rows):
            _add_part(equations, columns, motion, y, slice(first, min(first + rows, stop)), reach)
        moving |= motion.moving.any(axis=0)
        usable |= bool(motion.usable.any())
        last = motion
    equations.expect(0, 0)
    if last is None or not usable:
        raise too_short(log.path, lowpass.cutoff_hz)
    return replace(last, moving=moving[None])


def _held(log: Recording, equations: Equations) -> tuple[Iterable[Motion], Lowpass, int]:
    """The motion of a log as one block, its low-pass, and how many samples there are."""
    options, imu = equations.options, equations.stages.imu
    motion = torque_motion(log, equations.robot, options.motion, imu=imu, source=options.source)
    return [motion], motion.lowpass, motion.samples


def _streamed(log: SurveyedLog, equations: Equations) -> tuple[Iterable[Motion], Lowpass, int]:
    """The motion of a long log, block by block, its low-pass, and how many samples there are."""
    options = equations.options.motion
    cutoff, step = chosen_cutoff(log, equations.robot, options)
    plan = make_plan(log.rate_hz, cutoff, step, samples_per_cutoff=options.samples_per_cutoff)
    samples = -(-log.samples // plan.factor)
    return motion_blocks(log.blocks(), plan), plan.kept_lowpass, samples


def _add_part(
    equations: Equations,
    columns: FilteredColumns,
    motion: Motion,
    y: Array,
    part: slice,
    reach: int,
) -> None:
    """Add the rows of some samples; the others are there for the filters."""
    low, high = max(0, part.start - reach), min(motion.samples, part.stop + reach)
    usable = sliding(motion.part(slice(low, high)), equations.slowest)
    H = columns.of(motion, part.start, part.stop)
    for first in range(part.start, part.stop, CHUNK):
        end = min(first + CHUNK, part.stop)
        chunk = motion.part(slice(first, end))
        rows = H[first - part.start : end - part.start]
        equations.add_chunk(chunk, rows, y[first:end], usable[first - low : end - low])


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
