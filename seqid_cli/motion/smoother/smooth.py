"""Joint motion from encoders and all calibrated IMUs together, by one smoother with variances.

Each joint's jerk is white, so its trajectory is a cubic spline whose third differences are
penalised (see `chunk`). Encoders enter by the edges that they cross and by their codes,
IMUs by every accelerometer and gyro as a function of all joints before them; where an IMU sits,
its small misalignment and its biases are constants of a chunk. Gauss-Newton on the whole chunk: the
normal equations are banded, bordered by the constants. The size of each joint's jerk in a chunk is
the maximum of the marginal likelihood (MacKay's fixed point), its correlation between joints goes
towards it by expectation and maximisation; traces come from probing with random signs, variances
from the factor's rows behind some of the knots.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.smoother import solve
from seqid_cli.motion.smoother.chunk import (
    Chunk,
    Jerk,
    Mounted,
    bridged,
    encoder_view,
    motion_at,
    resampled,
)
from seqid_cli.motion.smoother.imus import handed_on, mounted_imus, read
from seqid_cli.motion.smoother.screening import believed, contradiction, misfits
from seqid_cli.motion.smoother.system import chosen
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index, Mask

FINE_S, COARSE_S = 1e-3, 4e-3  # between knots: no more, of the motion and for the constants


@dataclass(frozen=True)
class Smoothed:
    """Motion (N, n) at every sample; variances of each joint's q, dq, ddq at some places."""

    q: Array
    dq: Array
    ddq: Array
    places: Index
    variance: Array  # (G, n, 3)
    mounted: dict[str, Mounted]  # that took part, as the last chunk left them
    notes: tuple[str, ...]

    def typical(self, valid: Mask) -> Array:
        """Median variance (n, 3) at valid samples (N,); infinite for joints beyond all IMUs."""
        known = valid[self.places]
        found = np.median(self.variance[known if known.any() else slice(None)], axis=0)
        found[1 + max((x.place.link for x in self.mounted.values()), default=-1) :] = np.inf
        return np.asarray(found)


Part = tuple[Array, Index, Array, tuple[Mounted, ...], list[str]]


def _smoothed(chunk: Chunk, size: Array) -> tuple[Part, Array]:
    """Constants on coarse knots, motion on fine ones; the jerk's size (n,) on the coarse."""
    # Of a chunk come motion (N, 3, n), variances at some places, its IMUs and what it says of them.
    coarse = _on_knots(chunk, COARSE_S if chunk.dt <= FINE_S else FINE_S).gathered()
    c, jerk = solve.encoder_motion(coarse, size)
    coarse, notes = believed(coarse, c)
    shared, said = _agreed(chunk, coarse, c, jerk)
    last = solve.detailed(*_refined(chunk, shared))
    motion = motion_at(last.chunk, last.c)[:: last.chunk.stride]
    # IMUs as the next chunk is to take them; the clocks as the fine knots have them.
    covariance: Array = np.asarray(np.linalg.inv(shared.schur), dtype=np.float64)
    slots = chosen(shared.chunk, shared.constants)
    imus = tuple(
        handed_on(replace(x, delay=fine.delay), taken, covariance[own, own])
        for (x, taken, own), fine in zip(slots, last.chunk.imus, strict=True)
    )
    size = shared.jerk.size * np.sqrt(shared.chunk.spacing / coarse.spacing)
    return (motion, *solve.probed_variance(last, shared), imus, notes + said), size


def _refined(chunk: Chunk, shared: solve.Solution) -> tuple[Chunk, Array, Jerk]:
    """What was found on coarse knots, on fine ones."""
    fine = _on_knots(replace(chunk, imus=shared.chunk.imus), FINE_S).gathered()
    c = resampled(shared.chunk, shared.c, fine)
    # The same jerk between knots that are closer together.
    times = (np.arange(fine.intervals) + 0.5) * fine.spacing / shared.chunk.spacing
    at = np.minimum(times.astype(int), shared.chunk.intervals - 1)
    size = shared.jerk.size * np.sqrt(shared.chunk.spacing / fine.spacing)
    return fine, c, replace(shared.jerk, size=size, relative=shared.jerk.relative[at])


def _agreed(chunk: Chunk, coarse: Chunk, c: Array, jerk: Jerk) -> tuple[solve.Solution, list[str]]:
    """Settle the constants; IMUs whose readings no motion explains are left out one by one."""
    # Coarse knots may not follow what an IMU feels: before it is left out, fine ones have their
    # say.
    notes = []
    while True:
        shared = solve.settled(coarse, c, jerk)
        found = list(misfits(shared.chunk, c, shared.c))
        if found:
            shared = solve.settled(*_refined(chunk, shared))
            found = list(misfits(shared.chunk, resampled(coarse, c, shared.chunk), shared.c))
        name, said = contradiction(found)
        notes += said
        if not name:
            return shared, notes
        coarse = replace(coarse, imus=tuple(x for x in coarse.imus if x.name != name))


def _on_knots(chunk: Chunk, spacing: float) -> Chunk:
    """The same with knots about as far apart as `spacing` s."""
    finer = max(1, round(chunk.dt / spacing))
    views = tuple(view.refined(finer) for view in chunk.views)
    every = max(1, round(spacing / chunk.dt)) if finer == 1 else 1
    return replace(chunk, views=views, dt=chunk.dt / finer, every=every)


def smoothed_motion(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    *,
    chunk_s: float = 10.0,
    overlap_s: float = 0.5,
    first_jerk: float = 1000.0,
    mostly: float = 0.95,
) -> Smoothed:
    """Smooth all joints of one log, by chunks of `chunk_s` s that fade into each other."""
    # A chunk begins with the constants that the one before has found. An IMU that reads in fewer
    # than `mostly` of the samples is named. Joints that no believed IMU sees rest on their
    # encoders.
    samples, rate = len(recording.q), recording.rate_hz
    filled = np.column_stack([bridged(x, np.isfinite(x)) for x in recording.q.T])
    step = encoder_resolution(robot)
    step = np.where(step > 0, step, encoder_step(filled))
    size = np.full(robot.n, first_jerk * np.sqrt(max(COARSE_S, 1.0 / rate) / FINE_S))
    known = {x.name: x for x in mounted_imus(recording, robot, stage)}
    joined, live = np.zeros((samples, 3, robot.n)), dict.fromkeys(known, 0.0)
    used: set[str] = set()
    at, variances, notes = [], [], []
    for own, share in _fading(samples, chunk_s * rate, int(overlap_s * rate)):
        views = tuple(
            encoder_view(recording.q[own, j], float(step[j]), recording.valid[own])
            for j in range(robot.n)
        )
        imus = tuple(read(x, recording, own) for x in known.values())
        live |= {x.name: live[x.name] + float(share @ x.live.any(axis=1)) for x in imus}
        # Threads of the linear algebra only get into each other's way with matrices this narrow.
        with threadpool_limits(1):
            part, size = _smoothed(Chunk(robot, views, 1.0 / rate, 1, imus), size)
        states, places, variance, found, said = part
        known |= {x.name: x for x in found}
        used |= {x.name for x in found}
        notes += [f"{own.start / rate:.1f} s: {x}" for x in said]
        joined[own] += share[:, None, None] * states
        kept = share[places] >= 0.5
        at.append(places[kept] + own.start)
        variances.append(variance[kept])
    mounted = {name: x for name, x in known.items() if name in used}
    shares = {name: live[name] / max(int(recording.valid.sum()), 1) for name in mounted}
    text = "{} reads in {} of the samples"
    notes += [text.format(name, percent(x, 0)) for name, x in shares.items() if x < mostly]
    q, dq, ddq = (np.ascontiguousarray(joined[:, d]) for d in range(3))
    known_at = np.concatenate(at), np.concatenate(variances)
    return Smoothed(q, dq, ddq, *known_at, mounted, tuple(notes))


def _fading(samples: int, length: float, lap: int) -> Iterator[tuple[slice, Array]]:
    """Chunks of about a length with a lap on either side, and their samples' shares, 1 in all."""
    edges = np.linspace(0, samples, max(1, round(samples / length)) + 1).astype(int)
    starts = np.maximum(edges[:-1] - lap, 0).tolist()
    stops = np.minimum(np.append(edges[1:-1], samples) + lap, samples).tolist()
    for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        rise = [start, stops[k - 1]] if k else [-2, -1]
        fall = [starts[k + 1] if k + 1 < len(starts) else samples, stop]
        t = np.arange(start, stop, dtype=float)
        yield slice(start, stop), np.interp(t, [*rise, *fall], [0.0, 1.0, 1.0, 0.0])
