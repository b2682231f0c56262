"""Joint motion from encoders and all calibrated IMUs together, by one smoother with covariance.

Each joint's jerk is white, so its trajectory is a cubic spline whose third differences are
penalised (see `terms`). Encoders enter by the edges that they cross and by their codes,
IMUs by every accelerometer and gyro as a function of all joints before them; where an IMU sits,
its small misalignment and its biases are constants of a chunk. Gauss-Newton on the whole chunk: the
normal equations are banded, bordered by the constants. The size of each joint's jerk in a chunk is
the maximum of the marginal likelihood (MacKay's fixed point), its correlation between joints goes
towards it by expectation and maximisation; traces come from probing with random signs, covariances
from the factor's rows behind some of the knots.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.smoother.chunk import Chunk, Mounted, motion_at, resampled
from seqid_cli.motion.smoother.encoder import bridged, encoder_view
from seqid_cli.motion.smoother.imus import handed_on, mounted_imus, read
from seqid_cli.motion.smoother.screening import believed, contradiction, fits
from seqid_cli.motion.smoother.solve import (
    Solution,
    between,
    detailed,
    encoder_motion,
    probed_covariance,
    settled,
)
from seqid_cli.motion.smoother.system import chosen
from seqid_cli.motion.smoother.terms import Jerk
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index

FINE_S, COARSE_S = 1e-3, 4e-3  # between knots: no more, of the motion and for the constants


@dataclass(frozen=True)
class Smoothed:
    """Motion (N, n) at every sample; `covariance` (N, n, 3, 3) of each joint's q, dq, ddq.

    `bias` of each IMU's readings [m/s^2, then rad/s], `lever`, its place on the link [m], and
    `time_offset`, its clock's stamp minus the encoders' [s], are of the last chunk it took part in;
    `jerk` (n,) rad/s^3 is the standard deviation of the jerk between knots. The covariance is kept
    at some `places` only and made for all samples when asked for.
    """

    q: Array
    dq: Array
    ddq: Array
    places: Index
    covariance_at_places: Array  # (G, n, 3, 3)
    bias: dict[str, Array]
    lever: dict[str, Array]
    time_offset: dict[str, float]
    time_offset_std_error: dict[str, float]
    jerk: Array
    imus: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def covariance(self) -> Array:
        """(N, n, 3, 3), interpolated between the places."""
        return between(self.covariance_at_places, self.places, len(self.q))


def smoothed_motion(
    recording: Recording, robot: Robot, stage: ImuStage | None, *, every: int = 1
) -> Smoothed:
    """Smooth all joints of one log.

    Parameters
    ----------
    every : int
        Samples per knot of the splines. Slow logs get several knots per sample by themselves.

    Returns
    -------
    Smoothed
        At the log's own rate. Joints that no believed IMU sees rest on their encoders.
    """
    # Threads of the linear algebra only get into each other's way with matrices this narrow.
    with threadpool_limits(1):
        return _joined(recording, robot, stage, every)


@dataclass(frozen=True)
class _Part:
    """One chunk's motion (N, 3, n) and covariance, and its IMUs with what it says of them."""

    start: int
    motion: Array
    places: Index
    covariance: Array
    jerk: Array
    imus: tuple[Mounted, ...]
    notes: tuple[str, ...] = field(default=())


def _parts(
    recording: Recording,
    robot: Robot,
    imus: list[Mounted],
    every: int,
    *,
    first_jerk: float = 1000.0,
) -> Iterator[_Part]:
    """Smooth one chunk after the other; each starts from the constants that the last has found."""
    step = encoder_resolution(robot)
    step = np.where(step > 0, step, encoder_step(_filled(recording)))
    spacing = max(COARSE_S, every / recording.rate_hz)
    size = np.full(robot.n, first_jerk * np.sqrt(spacing / FINE_S))
    known = {x.name: x for x in imus}
    for start, stop in _bounds(len(recording.q), recording.rate_hz):
        own = slice(start, stop)
        views = tuple(
            encoder_view(recording.q[own, j], float(step[j]), recording.valid[own])
            for j in range(robot.n)
        )
        here = tuple(read(x, recording, own) for x in known.values())
        part, size = _smoothed(Chunk(robot, views, 1.0 / recording.rate_hz, every, here), size)
        known |= {x.name: x for x in part.imus}
        when = f"{start / recording.rate_hz:.1f} s: "
        yield replace(part, start=start, notes=tuple(when + text for text in part.notes))


def _filled(recording: Recording) -> Array:
    """Positions (N, n) with missing ones bridged."""
    q = recording.q
    if np.isfinite(q).all():
        return q
    return np.column_stack([bridged(x, np.isfinite(x)) for x in q.T])


def _smoothed(chunk: Chunk, size: Array) -> tuple[_Part, Array]:
    """Constants on coarse knots, motion on fine ones; the jerk's size (n,) on the coarse."""
    between_knots = COARSE_S if chunk.dt <= FINE_S else FINE_S
    coarse = _on_knots(chunk, between_knots, chunk.every).gathered()
    c, jerk = encoder_motion(coarse, size)
    coarse, notes = believed(coarse, c)
    shared, said = _agreed(chunk, coarse, c, jerk)
    notes += said
    fine, c, finer = _refined(chunk, shared)
    last = detailed(fine, c, finer)
    places, covariance = probed_covariance(last, shared)
    motion = motion_at(last.chunk, last.c)[:: last.chunk.stride]
    imus = _with_covariance(shared, last)
    part = _Part(0, motion, places, covariance, last.jerk.size, imus, tuple(notes))
    return part, shared.jerk.size * np.sqrt(shared.chunk.spacing / coarse.spacing)


def _refined(chunk: Chunk, shared: Solution) -> tuple[Chunk, Array, Jerk]:
    """What was found on coarse knots, on fine ones."""
    fine = _on_knots(replace(chunk, imus=shared.chunk.imus), FINE_S, chunk.every).gathered()
    c = resampled(shared.chunk, shared.c, fine)
    return fine, c, _on_finer(shared.jerk, shared.chunk, fine)


def _agreed(chunk: Chunk, coarse: Chunk, c: Array, jerk: Jerk) -> tuple[Solution, list[str]]:
    """Settle the constants; IMUs whose readings no motion explains are left out one by one.

    Coarse knots may not follow what an IMU feels: before it is left out, fine ones have their say.
    """
    notes = []
    while True:
        shared = settled(coarse, c, jerk)
        found = fits(shared.chunk, c, shared.c)
        if any(fit.suspect for fit in found):
            fine = _refined(chunk, shared)
            shared = settled(*fine)
            found = fits(shared.chunk, resampled(coarse, c, shared.chunk), shared.c)
        name, said = contradiction(found)
        notes += said
        if not name:
            return shared, notes
        coarse = replace(coarse, imus=tuple(x for x in coarse.imus if x.name != name))


def _on_finer(jerk: Jerk, coarse: Chunk, fine: Chunk) -> Jerk:
    """The same jerk between knots that are closer together."""
    times = (np.arange(fine.intervals) + 0.5) * fine.spacing / coarse.spacing
    at = np.minimum(times.astype(int), coarse.intervals - 1)
    size = jerk.size * np.sqrt(coarse.spacing / fine.spacing)
    return replace(jerk, size=size, relative=jerk.relative[at])


def _with_covariance(shared: Solution, last: Solution) -> tuple[Mounted, ...]:
    """IMUs as the next chunk is to take them; the clocks as the fine knots have them."""
    found_here, found, start = np.linalg.inv(shared.schur), [], 0
    for x, fine in zip(shared.chunk.imus, last.chunk.imus, strict=True):
        taken = chosen(x, shared.constants)
        own = slice(start, start + len(taken))
        start += len(taken)
        covariance: Array = np.asarray(np.linalg.inv(x.precision), dtype=np.float64)
        covariance[taken], covariance[:, taken] = 0.0, 0.0
        covariance[np.ix_(taken, taken)] = found_here[own, own]
        found.append(handed_on(replace(x, delay=fine.delay), covariance))
    return tuple(found)


def _on_knots(chunk: Chunk, spacing: float, every: int) -> Chunk:
    """The same with knots about as far apart as `spacing` s, or `every` samples where set."""
    finer = max(1, round(chunk.dt / spacing)) if every == 1 else 1
    views = tuple(view.refined(finer) for view in chunk.views) if finer > 1 else chunk.views
    every = max(every, round(spacing / chunk.dt), 1) if finer == 1 else 1
    return replace(chunk, views=views, dt=chunk.dt / finer, every=every)


def _bounds(
    samples: int, rate_hz: float, *, chunk_s: float = 10.0, overlap_s: float = 0.5
) -> list[tuple[int, int]]:
    """Overlapping chunks of nearly the same length."""
    count = max(1, round(samples / (chunk_s * rate_hz)))
    edges = np.linspace(0, samples, count + 1).astype(int)
    lap = int(overlap_s * rate_hz)
    starts = np.maximum(edges[:-1] - lap, 0)
    stops = np.minimum(np.append(edges[1:-1], samples) + lap, samples)
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True)]


def _joined(recording: Recording, robot: Robot, stage: ImuStage | None, every: int) -> Smoothed:
    """Lay the chunks side by side; each fades into the next over their overlap."""
    samples = len(recording.q)
    imus, notes = mounted_imus(recording, robot, stage)
    bounds = [(-2, -1), *_bounds(samples, recording.rate_hz), (samples, samples + 1)]
    motion = np.zeros((samples, 3, robot.n))
    places, covariance = [], []
    found: dict[str, Mounted] = {}
    for k, part in enumerate(_parts(recording, robot, imus, every)):
        (start, stop), before, after = bounds[k + 1], bounds[k][1], bounds[k + 2][0]
        t = np.arange(start, stop, dtype=float)
        rise, fall = [max(start, 0) - (k == 0), before], [after, stop]
        if k == 0:
            rise = [-2, -1]
        share = np.interp(t, [*rise, *fall], [0.0, 1.0, 1.0, 0.0])
        motion[start:stop] += share[:, None, None] * part.motion
        own = share[part.places] >= 0.5
        places.append(part.places[own] + start)
        covariance.append(part.covariance[own])
        notes += part.notes
        found |= {x.name: x for x in part.imus}
        jerk = part.jerk
    q, dq, ddq = (np.ascontiguousarray(motion[:, d]) for d in range(3))
    late = {name: x.place.channels + 6 for name, x in found.items()}
    return Smoothed(
        q,
        dq,
        ddq,
        np.concatenate(places),
        np.concatenate(covariance),
        {name: x.bias for name, x in found.items()},
        {name: x.place.lever for name, x in found.items()},
        {name: x.delay for name, x in found.items()},
        {
            name: float(np.sqrt(np.linalg.inv(x.precision)[late[name], late[name]]))
            for name, x in found.items()
        },
        jerk,
        tuple(x.name for x in imus if x.name in found),
        tuple(notes),
    )
