"""Joint motion from encoders and all calibrated IMUs together, by one smoother with variances.

Each joint's jerk is white, so its trajectory is a cubic spline whose third differences
are penalised (see `chunk`). Encoders enter by the edges that they cross and by their
codes, IMUs by every accelerometer and gyro as a function of all joints before them;
where an IMU sits, its small misalignment and its biases are constants of a chunk.
Gauss-Newton on the whole chunk: the normal equations are banded, bordered by the
constants. The size of each joint's jerk in a chunk is the maximum of the marginal
likelihood (MacKay's fixed point), its correlation between joints goes towards it by
expectation and maximisation; traces come from probing with random signs, variances from
the factor's rows behind some of the knots.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.smoother import chunk as splines
from seqid_cli.motion.smoother import solve
from seqid_cli.motion.smoother.chunk import Chunk, Jerk, Mounted, resampled
from seqid_cli.motion.smoother.imus import handed_on, mounted_imus, moved, read
from seqid_cli.motion.smoother.left_out import beyond_motion
from seqid_cli.motion.smoother.system import chosen, jacobians, predicted
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.robust import gaussian_spread
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index, Mask

BEYOND_NOISE = 2.3  # limits of what joint motion leaves of an IMU's readings


def believed(
    chunk: Chunk, c: Array, *, largest_offset: float = 2.0, least_seen: float = 0.3
) -> tuple[Chunk, list[str]]:
    """Place the IMUs on the encoders' motion `c`; those that cannot be right are left out."""
    kept, notes = [], []
    for given in chunk.imus:
        x = located(chunk, c, given)
        share = float(x.seen.mean()) * chunk.stride
        off = np.sum((x.y - predicted(chunk, c, x)) * x.seen, axis=0)
        mean = float(np.abs(off / np.maximum(x.seen.sum(axis=0), 1)).max())
        if share < least_seen:
            notes.append(
                f"{x.name} is left out: it reads in {percent(share, 0)} of the samples"
            )
        elif not mean < largest_offset:
            reason = f"its mean reading is off by {mean:.3g} (limit {largest_offset:g})"
            notes.append(f"{x.name} is left out: {reason}")
        else:
            kept.append(x)
    return replace(chunk, imus=tuple(kept)), notes


# an IMU, its share of what the encoders alone leave, and a text
Misfit = tuple[str, float, str]


def misfits(
    chunk: Chunk, alone: Array, together: Array, *, in_motion: float = 0.05
) -> Iterator[Misfit]:
    """IMUs that leave more than noise of the motion by coefficients (K, n), encoders' and all."""
    # The RMS over the channels, m/s^2 (rad/s), that `typical` of the intervals in
    # motion do not exceed: a jolt is over in less time than there is between coarse
    # knots, which cannot follow.
    for x in chunk.imus:
        speed = np.abs(splines.mean_motion(chunk, alone[:, : x.joints])[1])
        fastest = np.maximum(speed.max(axis=1, keepdims=True), 1e-9)
        own = x.there & (speed > in_motion * fastest).any(axis=0)
        own = own if own.any() else x.there
        off = _without_drift(x, predicted(chunk, together, x))
        size, noises = (_typical(v, x.seen, own) for v in (off, off / x.spread))
        if noises > BEYOND_NOISE:
            before = _without_drift(x, predicted(chunk, alone, x))
            share = noises / max(_typical(before / x.spread, x.seen, own), 1e-9)
            beyond = (
                f"by {size:.3g}, {noises:.1f} times its noise and {percent(share, 0)}"
            )
            told = (
                f"it differs from the motion {beyond} of what it differs from the"
                " encoders'"
            )
            yield x.name, share, told


def contradiction(
    found: Sequence[Misfit], *, unexplained: float = 0.36
) -> tuple[str, list[str]]:
    """The IMU to be left out, if any, and what is to be said of those that fit badly."""
    # A right model leaves noise: motion that follows an IMU takes up nearly all in
    # which it differs from the encoders' motion. Wrong geometry or an arm that bends
    # leaves much more.
    name, share, text = max(found, key=lambda x: x[1], default=("", 0.0, ""))
    if share > unexplained:
        return name, [f"{name} is left out: {text} (limit {percent(unexplained, 0)})"]
    remedy = "check geometry, mounting and gravity"
    return "", [f"{name} fits badly: {text}; {remedy}" for name, _, text in found]


def _without_drift(x: Mounted, told: Array) -> Array:
    """Residual (M, K) of the readings without what a drifting bias explains."""
    t = np.linspace(-1.0, 1.0, len(told))[:, None] * x.seen
    off = (x.y - told) * x.seen
    slope = np.sum(t * off, axis=0) / np.maximum(np.sum(t * t, axis=0), 1e-9)
    return np.asarray(off - slope * t)


def _typical(off: Array, seen: Mask, own: Mask, *, typical: float = 0.8) -> float:
    """Root mean square over the channels, where it is larger than in most of the intervals."""
    square = np.sum(off[own] ** 2, axis=1) / np.maximum(seen[own].sum(axis=1), 1)
    return float(np.sqrt(np.quantile(square, typical)))


def located(
    chunk: Chunk, c: Array, x: Mounted, *, sure_s: float = 0.002, sure_m: float = 0.005
) -> Mounted:
    """Fit an IMU's place, biases and clock offset to a motion that is taken as given."""
    late = x.place.channels + 6
    known = np.diag(x.precision) ** -0.5
    sure = known[late] < sure_s
    if not x.seen.any() or (sure and known[late - 6 : late - 3].max() < sure_m):
        return x
    if not sure:
        x = _searched(chunk, c, x)
    for count in (late, late + 1):  # one step of least squares for the first constants
        r, noise, G, info = _design(chunk, c, x, count)
        right = np.tensordot(r / noise, G, 2) - (x.precision @ x.away)[:count]
        change = np.zeros(len(x.away))
        change[:count] = np.linalg.solve(info, right)
        x = _placed(chunk, x, change)
    return x


def _placed(chunk: Chunk, x: Mounted, change: Array) -> Mounted:
    """An IMU with its constants changed, its readings where the clock has them."""
    return replace(chunk, imus=(moved(x, change),)).gathered().imus[0]


def _searched(
    chunk: Chunk,
    c: Array,
    x: Mounted,
    *,
    search_s: float = 0.06,
    independent_s: float = 0.05,
) -> Mounted:
    """The clock offset, of a grid of knots, that leaves least of the readings, all else fitted."""
    # The encoders' motion errs over long stretches; few of the residuals are
    # independent.
    h, late = chunk.spacing, x.place.channels + 6
    told = predicted(chunk, c, x)
    _, noise, G, info = _design(chunk, c, x, late)
    lags = range(-int(search_s / h), int(search_s / h) + 1)
    left = np.empty(len(lags))
    for i, lag in enumerate(lags):
        seen = _later(np.asarray(x.seen, dtype=np.float64), lag) > 0
        later = replace(x, y=_later(x.y, lag), seen=seen)
        r = _cell_means(chunk, later, later.y - told) / noise
        g = np.tensordot(r, G, 2)
        left[i] = np.sum(r**2) - g @ np.linalg.solve(info, g)
    independent = chunk.samples * chunk.dt / independent_s
    away = np.array(lags) * h + x.away[late]
    cost = 0.5 * independent * np.log(np.maximum(left, 1e-12))
    lag = lags[int(np.argmin(cost + 0.5 * x.precision[late, late] * away**2))]
    return _placed(chunk, x, lag * h * np.eye(len(x.away))[late])


def _later(values: Array, lag: int) -> Array:
    """Rows `lag` further on, zero where there are none."""
    out, m = np.zeros_like(values), len(values)
    out[max(-lag, 0) : m - max(lag, 0)] = values[max(lag, 0) : m + min(lag, 0)]
    return out


def _cell_means(chunk: Chunk, x: Mounted, off: Array) -> Array:
    """Mean (C, K) over the readings of each cell; zero where there are none."""
    count = np.add.reduceat(x.seen.astype(float), chunk.cells)
    return np.asarray(
        np.add.reduceat(off * x.seen, chunk.cells) / np.maximum(count, 1.0)
    )


def _design(
    chunk: Chunk, c: Array, x: Mounted, count: int
) -> tuple[Array, Array, Array, Array]:
    """Residuals (C, K), their noise (K,), whitened Jacobians (C, K, g), information (g, g)."""
    r = _cell_means(chunk, x, x.y - predicted(chunk, c, x))
    noise: Array = np.maximum(x.spread, gaussian_spread(r))
    _, by_constants = jacobians(chunk, c, x, gains=False)
    G = by_constants[:, :, :count]
    there = np.add.reduceat(x.seen.astype(float), chunk.cells) > 0
    G = G * there[:, :, None] / noise[:, None]
    return (
        r,
        noise,
        G,
        np.tensordot(G, G, ([0, 1], [0, 1])) + x.precision[:count, :count],
    )


# between knots: no more, of the motion and for the constants
FINE_S, COARSE_S = 1e-3, 4e-3


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
    # (N, n) rad/s^2 by which links accelerate beyond it, by every calibrated IMU.
    beyond: Array

    def typical(self, valid: Mask) -> Array:
        """Median variance (n, 3) at valid samples (N,); infinite for joints beyond all IMUs."""
        known = valid[self.places]
        found = np.median(self.variance[known if known.any() else slice(None)], axis=0)
        found[1 + max((x.place.link for x in self.mounted.values()), default=-1) :] = (
            np.inf
        )
        return np.asarray(found)


Part = tuple[Array, Index, Array, tuple[Mounted, ...], list[str], Array]


def _smoothed(chunk: Chunk, size: Array) -> Part:
    """Constants on coarse knots, motion on fine ones; from the jerk's size (n,) on the coarse."""
    # Of a chunk come motion (N, 3, n), variances at some places, its IMUs, what it says
    # of them, and the size of the jerk.
    coarse = _on_knots(chunk, COARSE_S if chunk.dt <= FINE_S else FINE_S).gathered()
    c, jerk = solve.encoder_motion(coarse, size)
    coarse, notes = believed(coarse, c)
    shared, said = _agreed(chunk, coarse, c, jerk)
    last = solve.detailed(*_refined(chunk, shared))
    motion = splines.motion_at(last.chunk, last.c)[:: last.chunk.stride]
    # IMUs as the next chunk is to take them; the clocks as the fine knots have them.
    covariance: Array = np.asarray(np.linalg.inv(shared.schur), dtype=np.float64)
    slots = chosen(shared.chunk, shared.constants)
    imus = tuple(
        handed_on(replace(x, delay=fine.delay), taken, covariance[own, own])
        for (x, taken, own), fine in zip(slots, last.chunk.imus, strict=True)
    )
    size = shared.jerk.size * np.sqrt(shared.chunk.spacing / coarse.spacing)
    return motion, *solve.probed_variance(last, shared), imus, notes + said, size


def _refined(chunk: Chunk, shared: solve.Solution) -> tuple[Chunk, Array, Jerk]:
    """What was found on coarse knots, on fine ones."""
    fine = _on_knots(replace(chunk, imus=shared.chunk.imus), FINE_S).gathered()
    c = resampled(shared.chunk, shared.c, fine)
    # The same jerk between knots that are closer together.
    times = (np.arange(fine.intervals) + 0.5) * fine.spacing / shared.chunk.spacing
    at = np.minimum(times.astype(int), shared.chunk.intervals - 1)
    size = shared.jerk.size * np.sqrt(shared.chunk.spacing / fine.spacing)
    return fine, c, replace(shared.jerk, size=size, relative=shared.jerk.relative[at])


def _agreed(
    chunk: Chunk, coarse: Chunk, c: Array, jerk: Jerk
) -> tuple[solve.Solution, list[str]]:
    """Settle the constants; IMUs whose readings no motion explains are left out one by one."""
    # Coarse knots may not follow what an IMU feels: before it goes, fine ones have
    # their say.
    notes = []
    while True:
        shared = solve.settled(coarse, c, jerk)
        found = list(misfits(shared.chunk, c, shared.c))
        if found:
            shared = solve.settled(*_refined(chunk, shared))
            found = list(
                misfits(shared.chunk, resampled(coarse, c, shared.chunk), shared.c)
            )
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
    # A chunk begins with the constants that the one before has found. An IMU that reads
    # in fewer than `mostly` of the samples is named. Joints beyond believed IMUs rest
    # on their encoders.
    samples, rate = len(recording.q), recording.rate_hz
    filled = np.column_stack(
        [splines.bridged(x, np.isfinite(x)) for x in recording.q.T]
    )
    step = encoder_resolution(robot)
    step = np.where(step > 0, step, encoder_step(filled))
    size = np.full(robot.n, first_jerk * np.sqrt(max(COARSE_S, 1.0 / rate) / FINE_S))
    known = {x.name: x for x in mounted_imus(recording, robot, stage)}
    joined, live = np.zeros((samples, 3, robot.n)), dict.fromkeys(known, 0.0)
    used: set[str] = set()
    at, variances, notes = [], [], []
    for own, share in _fading(samples, chunk_s * rate, int(overlap_s * rate)):
        codes = zip(recording.q[own].T, step.tolist(), strict=True)
        views = tuple(
            splines.encoder_view(q, count, recording.valid[own]) for q, count in codes
        )
        imus = tuple(read(x, recording, own) for x in known.values())
        live |= {x.name: live[x.name] + float(share @ x.live.any(axis=1)) for x in imus}
        # Threads of the linear algebra only get into each other's way with matrices
        # this narrow.
        with threadpool_limits(1):
            given = Chunk(robot, views, 1.0 / rate, 1, imus)
            states, places, variance, found, said, size = _smoothed(given, size)
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
    notes += [
        text.format(name, percent(x, 0)) for name, x in shares.items() if x < mostly
    ]
    q, dq, ddq = (np.ascontiguousarray(joined[:, d]) for d in range(3))
    known_at = np.concatenate(at), np.concatenate(variances)
    # By the constants that explain this log best; of an IMU that was left out by its
    # calibration.
    calibrated = mounted_imus(recording, robot, stage)
    witnesses = [mounted.get(x.name, x) for x in calibrated]
    every = [read(x, recording, slice(0, samples)) for x in witnesses]
    beyond = beyond_motion(robot, recording.t, (q, dq, ddq), every)
    return Smoothed(q, dq, ddq, *known_at, mounted, tuple(notes), beyond)


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
