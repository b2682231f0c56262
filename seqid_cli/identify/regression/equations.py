"""Rows of the torque equation (Eq. 4) of one log, filtered and decimated, block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import Motion, decimated, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.base import Basis, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

BLOCK_S = 1.0
CHUNK = 4096


def torque_motion(
    recording: Recording,
    robot: Robot,
    options: MotionOptions,
    *,
    imu: ImuStage | None = None,
    source: str = "encoder",
) -> Motion:
    """Decimated motion of a log that carries torque.

    `imu` holds the calibrations and `source` says where motion comes from (see `best_motion`).

    Raises
    ------
    InputError
        If the log carries neither torque nor current, or not the IMU that `source` insists on.
    """
    torque_of(recording)
    encoder = estimate_motion(recording, robot, options)
    motion = best_motion(recording, robot, imu, encoder, source=source)
    return decimated(motion, options.samples_per_cutoff)


def cutoff_note(cutoffs: Sequence[float], options: MotionOptions) -> str:
    """Say which low-pass was used and where it came from."""
    low, high = min(cutoffs), max(cutoffs)
    span = f"{low:.3g} Hz" if high - low < 0.005 * high else f"{low:.3g} to {high:.3g} Hz"
    if options.cutoff_hz is not None:
        return f"low-pass {span}, {options.origin or 'as given'} (--cutoff overrides)"
    return (
        f"low-pass {span}, chosen per log from the encoder's step, the rate and the motion's "
        "bandwidth (--cutoff overrides)"
    )


@dataclass(frozen=True)
class Rows:
    """Consecutive samples of all joints: H (N, n, b) filtered like `motion.tau`."""

    motion: Motion
    H: Array
    where: slice


def filtered_regressor(motion: Motion, robot: Robot, basis: Basis) -> Iterator[Rows]:
    """Base regressor of a log in chunks, each filtered with enough overlap to have no seams.

    Yields
    ------
    Rows
        Chunks in time order.
    """
    overlap = motion.lowpass.memory
    for start in range(0, motion.samples, CHUNK):
        stop = min(start + CHUNK, motion.samples)
        low, high = max(0, start - overlap), min(motion.samples, stop + overlap)
        wide = slice(low, high)
        H = base_regressor(robot, basis, motion.q[wide], motion.dq[wide], motion.ddq[wide])
        H = motion.lowpass(H, motion.valid[wide])
        where = slice(start, stop)
        yield Rows(motion.part(where), H[start - low : stop - low], where)


def blocks(samples: int, rate_hz: float) -> Iterator[slice]:
    """Blocks of about a second: longer than the memory of the residual, shorter than a log."""
    length = max(8, round(BLOCK_S * rate_hz))
    count = max(1, round(samples / length))
    edges = np.linspace(0, samples, count + 1).astype(int)
    for a, b in pairwise(edges):
        yield slice(int(a), int(b))
