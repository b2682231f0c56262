"""Joint motion from encoders and all calibrated IMUs together, by one smoother with covariance.

Each joint's jerk is white, so its trajectory is a cubic spline whose third differences are
penalised (see `smoother_terms`). Encoders enter by the edges that they cross and by their codes,
IMUs by every accelerometer and gyro as a function of all joints before them; where an IMU sits,
its small misalignment and its biases are constants of a chunk. Gauss-Newton on the whole chunk: the
normal equations are banded, bordered by the constants. The size of each joint's jerk in a chunk is
the maximum of the marginal likelihood (MacKay's fixed point), its correlation between joints goes
towards it by expectation and maximisation; traces and covariances come from probing with random
signs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.cutoff import encoder_step
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.smoother_encoder import encoder_view
from seqid_cli.motion.smoother_imus import believed, mounted_imus
from seqid_cli.motion.smoother_solve import (
    Solution,
    all_together,
    encoder_motion,
    probed_covariance,
)
from seqid_cli.motion.smoother_system import Chunk, Mounted, motion_at
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

FIRST_JERK = 1e3  # rad/s^3 between knots, to start with
LEAST_KNOTS_HZ = 1000.0
CHUNK_S, OVERLAP_S = 10.0, 0.5


@dataclass(frozen=True)
class Smoothed:
    """Motion (N, n) at every sample; `covariance` (N, n, 3, 3) of each joint's q, dq, ddq.

    `bias` of each IMU's readings [m/s^2, then rad/s] and `lever`, its place on the link [m], are
    of the last chunk; `jerk` (n,) rad/s^3 is the standard deviation of the jerk between knots.
    """

    q: Array
    dq: Array
    ddq: Array
    covariance: Array
    bias: dict[str, Array]
    lever: dict[str, Array]
    jerk: Array
    imus: tuple[str, ...]
    notes: tuple[str, ...]


def smoothed_motion(
    recording: Recording, robot: Robot, stage: ImuStage | None, *, every: int = 1
) -> Smoothed:
    """Smooth all joints of one log.

    Parameters
    ----------
    recording : Recording
        One log; IMU channels where it has them.
    robot : Robot
    stage : ImuStage, optional
        Calibrations; IMUs without one take no part.
    every : int
        Samples per knot of the splines. Slow logs get several knots per sample by themselves.

    Returns
    -------
    Smoothed
        At the log's own rate. Joints that no believed IMU sees rest on their encoders.
    """
    # Threads of the linear algebra only get into each other's way with matrices this narrow.
    with threadpool_limits(1):
        return _smoothed(recording, robot, stage, every)


def _smoothed(recording: Recording, robot: Robot, stage: ImuStage | None, every: int) -> Smoothed:
    step = encoder_resolution(robot)
    step = np.where(step > 0, step, encoder_step(recording.q))
    views = [encoder_view(recording.q[:, j], float(step[j])) for j in range(robot.n)]
    imus, notes = mounted_imus(recording, robot, stage, every)
    # A jolt between two samples must not have to spread over both: knots come no rarer than this.
    finer = max(1, round(LEAST_KNOTS_HZ / recording.rate_hz)) if every == 1 else 1
    views = [view.refined(finer) for view in views]
    imus = [_refined(x, finer) for x in imus]
    valid = np.repeat(recording.valid, finer)
    rate_hz = recording.rate_hz * finer
    parts, jerk = [], np.full(robot.n, FIRST_JERK)
    whole = Chunk(robot, tuple(views), valid, 1.0 / rate_hz, every, tuple(imus))
    for start, stop in _bounds(len(valid), rate_hz, every):
        chunk = _cut(whole, start, stop)
        c, sizes = encoder_motion(chunk, jerk)
        chunk, said = believed(chunk, c)
        notes += [f"{start * chunk.dt:.1f} s: {text}" for text in said]
        solution = all_together(chunk, c, sizes)
        parts.append((start, solution))
        jerk = solution.jerk.size
    return _joined(whole, parts, tuple(notes), finer)


def _bounds(samples: int, rate_hz: float, every: int) -> list[tuple[int, int]]:
    """Overlapping chunks of nearly the same length, each starting on a knot."""
    count = max(1, round(samples / (CHUNK_S * rate_hz)))
    edges = np.linspace(0, samples, count + 1).astype(int) // every * every
    lap = int(OVERLAP_S * rate_hz) // every * every
    starts = np.maximum(edges[:-1] - lap, 0)
    stops = np.minimum(np.append(edges[1:-1], samples) + lap, samples)
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True)]


def _refined(x: Mounted, finer: int) -> Mounted:
    """The same with `finer` intervals per sample, of which the first was read."""
    seen = np.zeros((len(x.seen), finer), dtype=bool)
    seen[:, 0] = x.seen
    return replace(x, y=np.repeat(x.y, finer, axis=0), seen=seen.ravel())


def _cut(whole: Chunk, start: int, stop: int) -> Chunk:
    """Part of the log between two samples."""
    knots = slice(start // whole.every, -(-stop // whole.every))
    return replace(
        whole,
        views=tuple(view.part(start, stop) for view in whole.views),
        valid=whole.valid[start:stop],
        imus=tuple(replace(x, y=x.y[knots], seen=x.seen[knots]) for x in whole.imus),
    )


def _joined(
    whole: Chunk, parts: list[tuple[int, Solution]], notes: tuple[str, ...], finer: int
) -> Smoothed:
    """Lay the chunks side by side; each fades into the next over their overlap."""
    samples, n = whole.samples, whole.joints
    motion, covariance = np.zeros((samples, 3, n)), np.zeros((samples, n, 3, 3))
    spans = [(start, start + solution.chunk.samples) for start, solution in parts]
    t = np.arange(samples, dtype=float)
    for k, (_, solution) in enumerate(parts):
        own = slice(*spans[k])
        before = [spans[k][0], spans[k - 1][1]] if k else [-2.0, -1.0]
        after = [spans[k + 1][0], spans[k][1]] if k < len(parts) - 1 else [samples, samples + 1.0]
        share = np.interp(t[own], [*before, *after], [0.0, 1.0, 1.0, 0.0])
        motion[own] += share[:, None, None] * motion_at(solution.chunk, solution.c)
        covariance[own] += share[:, None, None, None] * probed_covariance(solution)
    imus = parts[-1][1].chunk.imus
    q, dq, ddq = (np.ascontiguousarray(motion[::finer, d]) for d in range(3))
    return Smoothed(
        q,
        dq,
        ddq,
        covariance[::finer],
        {x.imu.name: x.bias for x in imus},
        {x.imu.name: x.lever for x in imus},
        parts[-1][1].jerk.size,
        tuple(x.imu.name for x in imus),
        notes,
    )
