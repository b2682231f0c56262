"""Rows of the torque equation (Eq. 4) of one log, filtered and decimated, block by block."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import Motion, decimated, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.base_parameters import Basis, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

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

    Raises InputError if the log carries neither torque nor current, or not the IMU that `source`
    insists on.
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


def filtered_columns(
    motion: Motion,
    robot: Robot,
    basis: Basis,
    where: slice,
    reach: int,
    beside: Callable[[Motion], Array] | None = None,
) -> Array:
    """Base regressor of some samples of a motion (N, n, b), filtered.

    `where`: the samples, [start, stop). `reach`: samples on either side that the low-pass
    remembers. `beside`: one more column (N, n) of a motion, filtered already.
    """
    low, high = max(0, where.start - reach), min(where.stop + reach, motion.samples)
    near, inner = motion.part(slice(low, high)), slice(where.start - low, where.stop - low)
    spare = 0 if beside is None else 1
    H = base_regressor(robot, basis, near.q, near.dq, near.ddq, spare=spare)
    motion.lowpass.filter_rows(H.transpose(1, 2, 0).reshape(-1, near.samples), near.valid)
    if beside is not None:
        H[:, :, -1] = beside(near)
    return H[inner]


def filtered_regressor(motion: Motion, robot: Robot, basis: Basis) -> Iterator[Rows]:
    """Base regressor of a log in chunks, each filtered with enough overlap to have no seams."""
    for start in range(0, motion.samples, CHUNK):
        where = slice(start, min(start + CHUNK, motion.samples))
        H = filtered_columns(motion, robot, basis, where, motion.lowpass.memory)
        yield Rows(motion.part(where), H, where)


def blocks(samples: int, rate_hz: float, *, block_s: float = 1.0) -> Iterator[slice]:
    """Blocks of about a second: longer than the memory of the residual, shorter than a log."""
    length = max(8, round(block_s * rate_hz))
    count = max(1, round(samples / length))
    edges = np.linspace(0, samples, count + 1).astype(int)
    for a, b in pairwise(edges):
        yield slice(int(a), int(b))
