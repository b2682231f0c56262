"""The motion of one log and how files describe it; rows of its torque equation (Eq. 4).

A log that is held has its motion in one block. A long one is passed over several times,
in memory that does not grow with it: to lay its time base, to look for damaged samples,
to choose its cut-off (`motion.filters.survey`), and to filter, decimate and reduce its
equations block by block. Both give the same: blocks are cut on the same grid, filtered
with all the samples that the filter remembers, and reduced to the same factors
(`rigid.inertia_equations`).
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.imu.link_acceleration import log_motion
from seqid_cli.logs.long import LongLog
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.motion.blocks import Plan, make_plan
from seqid_cli.motion.filters.bandwidth import NOISE_BANDWIDTH
from seqid_cli.motion.filters.survey import Survey, survey_of_positions
from seqid_cli.motion.motion import Motion, as_asked, decimated, encoder_resolution
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage, MotionUse, Stages
from seqid_cli.robot.base_parameters import Basis, base_regressor, loaded_columns
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

CHUNK = 4096  # samples whose regressor is made at once


def streams(stages: Stages, options: InertiaOptions) -> bool:
    """Return whether long logs may be streamed.

    They may where the motion is to be that of the encoders.
    """
    sources = {options.source, *options.source_by_log.values()}
    imus = stages.imu is not None and bool(stages.imu.imus)
    return sources <= {"encoder"} or (
        sources <= {"encoder", "auto", "needed"} and not imus
    )


def survey_of(log: Recording | LongLog) -> Survey:
    """Return what the choice of noise steps and cut-off needs of a log's positions."""
    if isinstance(log, Recording):
        return survey_of_positions(log.q, log.rate_hz)
    survey = Survey(log.robot.n, log.rate_hz, log.samples)
    for block in log.blocks():
        survey.push(block.q)
    return survey


def plan_of(log: LongLog, robot: Robot, options: MotionOptions) -> Plan:
    """How a log that is passed over is filtered."""
    resolution = encoder_resolution(robot)
    survey = survey_of(log)
    cutoff = as_asked(survey.cutoff(resolution), log.path, log.rate_hz, options)
    return make_plan(
        log.rate_hz,
        cutoff,
        survey.noise_step(resolution),
        samples_per_cutoff=options.samples_per_cutoff,
    )


def torque_motion(
    recording: Recording,
    robot: Robot,
    options: MotionOptions,
    *,
    imu: ImuStage | None = None,
    source: str = "encoder",
) -> Motion:
    """Return the decimated motion of a log with torque.

    Raises InputError without torque, or as `best_motion` does.
    """
    torque_of(recording)
    motion = log_motion(recording, robot, options, imu=imu, source=source)
    return decimated(motion, options.samples_per_cutoff)


def cutoff_note(uses: Sequence[MotionUse], options: MotionOptions) -> str:
    """Say which low-pass was used and where it came from."""
    cutoffs = [use.cutoff_hz for use in uses]
    low = min(cutoffs)
    high = max(cutoffs)
    span = f"{low:.3g} to {high:.3g} Hz"
    if high - low < 0.005 * high:
        span = f"{low:.3g} Hz"
    if options.cutoff_hz is not None:
        return f"low-pass {span}, {options.origin or 'as given'} (--cutoff overrides)"
    return (
        f"low-pass {span}, chosen per log from the encoder's step, the rate and the"
        " motion's bandwidth (--cutoff overrides)"
    )


def filtered_regressor(
    motion: Motion,
    robot: Robot,
    basis: Basis,
    *,
    within: tuple[int, int] | None = None,
    chunk: int = CHUNK,
    reach: int | None = None,
    beside: Callable[[Motion], Array] | None = None,
) -> Iterator[tuple[slice, Array]]:
    """Yield the base regressor of a log in chunks that have no seams.

    Each chunk is filtered with enough overlap.

    `within`: first and last of the samples that are wanted. `reach`: samples on either
    side that the low-pass remembers. `beside`: one more column (N, n) of a motion,
    filtered already. Yields samples of the chunk, in time order, and H (N, n, b),
    filtered as `motion.tau`, until the next.
    """
    first, last = (0, motion.samples) if within is None else within
    reach = motion.lowpass.memory if reach is None else reach
    spare = 0 if beside is None else 1
    loaded = np.pad(loaded_columns(robot, basis), ((0, 0), (0, spare)))
    only = np.flatnonzero(loaded)
    # What is never written to is never given to the process.
    room = np.zeros((*loaded.shape, min(chunk, last - first) + 2 * reach))
    rows = room.reshape(loaded.size, -1)
    for start in range(first, last, chunk):
        stop = min(start + chunk, last)
        low = max(0, start - reach)
        high = min(stop + reach, motion.samples)
        near = motion.part(slice(low, high))
        inner = slice(start - low, stop - low)
        base_regressor(robot, basis, near.q, near.dq, near.ddq, out=room)
        motion.lowpass.filter_rows(rows[:, : near.samples], near.valid, only=only)
        H = room.transpose(2, 0, 1)[inner]
        if beside is not None:
            H[:, :, -1] = beside(near)[inner]
        yield slice(start, stop), H


def blocks(samples: int, rate_hz: float, *, block_s: float = 1.0) -> Iterator[slice]:
    """Yield blocks of about a second.

    A block is longer than the memory of the residual and shorter than a log.
    """
    # By time, so that the same stretch has the same blocks at any rate, and cut-offs
    # can be paired.
    length = max(4.0, block_s * rate_hz)
    edges = np.linspace(0, samples, max(1, round(samples / length)) + 1).astype(int)
    for a, b in pairwise(edges):
        yield slice(int(a), int(b))


def independent_share(motion: Motion) -> float:
    """Return the share of a log's samples that counts as independent."""
    # What is left of the torque is low-passed: two samples per period of its band say
    # all.
    if not motion.lowpass.active:
        return 1.0
    return min(1.0, 2.0 * NOISE_BANDWIDTH * motion.lowpass.cutoff_hz / motion.rate_hz)


def motion_use(path: Path, robot: Robot, motion: Motion) -> MotionUse:
    """Describe the motion of one log."""
    used_error = motion.acceleration_error
    encoder_error = used_error if motion.encoder_error is None else motion.encoder_error
    moving = np.flatnonzero(motion.moving.any(axis=0))

    def of_joints(values: Array | None) -> dict[str, float]:
        if values is None:
            return {}
        return {robot.joint_names[j]: float(values[j]) for j in moving}

    return MotionUse(
        log=str(path),
        source=motion.source,
        imus=list(motion.imus),
        cutoff_hz=float(motion.cutoff.hz),
        acceleration_error=of_joints(used_error),
        encoder_error=of_joints(encoder_error),
        fused_error=of_joints(motion.fused_error),
        disagreement=of_joints(motion.disagreement),
        velocity_error=of_joints(motion.velocity_error),
        warnings=list(motion.warnings),
    )


def source_text(use: MotionUse) -> str:
    """Return the source with its IMUs, as in "encoder" or "fused: imu_a, imu_b"."""
    return f"{use.source}: {', '.join(use.imus)}" if use.imus else use.source


def motion_uses(
    recordings: Iterable[Recording],
    robot: Robot,
    imu: ImuStage | None,
    *,
    options: InertiaOptions,
) -> list[MotionUse]:
    """Describe the motion that commands take from logs, where they can."""
    uses = []
    for recording in recordings:
        with contextlib.suppress(InputError):
            motion = log_motion(
                recording, robot, options.motion, imu=imu, source=options.source
            )
            uses.append(motion_use(recording.path, robot, motion))
    return uses
