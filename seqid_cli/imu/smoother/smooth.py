"""Joint motion from encoders and all calibrated IMUs, by one smoother with variances.

Each joint's jerk is white, so its trajectory is a cubic spline whose third differences
are penalised (see `chunk`). Encoders enter by the edges that they cross and by their
codes, IMUs by every accelerometer and gyro as a function of all joints before them;
where an IMU sits, its small misalignment and its biases are constants of a chunk.
Gauss-Newton on the whole chunk: the normal equations are banded, bordered by the
constants. The size of each joint's jerk in a chunk is the maximum of the marginal
likelihood (MacKay's fixed point), its correlation between joints goes towards it by
expectation and maximisation; traces come from probing with random signs, variances from
the factor's rows behind some of the knots.

The letters are those of `chunk`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from seqid_cli.imu.clock import WINDOW_S, ClockScan, Sums, search
from seqid_cli.imu.smoother import chunk as splines
from seqid_cli.imu.smoother import solve
from seqid_cli.imu.smoother.chunk import Chunk, Jerk, Mounted, resampled
from seqid_cli.imu.smoother.imus import handed_on, mounted_imus, moved, read
from seqid_cli.imu.smoother.left_out import beyond_motion
from seqid_cli.imu.smoother.system import chosen, jacobians, predicted
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.robust import gaussian_spread
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index, Mask

# Times its noise that the motion may leave of an IMU's readings.
BEYOND_NOISE = 2.3


def believed(
    chunk: Chunk, c: Array, *, largest_offset: float = 2.0, least_seen: float = 0.3
) -> tuple[Chunk, list[str]]:
    """Place the IMUs on the encoders' motion `c` (K, n).

    Those that cannot be right are left out: they read in fewer than `least_seen` of the
    samples, or their mean reading is off by `largest_offset`. Returns the chunk, and
    notes on them.
    """
    believable = []
    notes = []
    for calibrated in chunk.imus:
        x = located(chunk, c, calibrated)
        share = float(x.seen.mean()) * chunk.stride
        residual = np.sum((x.y - predicted(chunk, c, x)) * x.seen, axis=0)
        n_seen = np.maximum(x.seen.sum(axis=0), 1)
        offset = float(np.abs(residual / n_seen).max())
        if share < least_seen:
            notes.append(
                f"{x.name} is left out: it reads in {percent(share, 0)} of the samples"
            )
        elif not offset < largest_offset:
            notes.append(
                f"{x.name} is left out: its mean reading is off by {offset:.3g} (limit"
                f" {largest_offset:g})"
            )
        else:
            believable.append(x)
    return replace(chunk, imus=tuple(believable)), notes


class Misfit(NamedTuple):
    """An IMU that fits the motion badly.

    `noises` is by how many times its noise it differs, `share` what that is of what it
    differs from the encoders' motion alone; `text` says both.
    """

    name: str
    noises: float
    share: float
    text: str


def misfits(
    chunk: Chunk, alone: Array, together: Array, *, in_motion: float = 0.05
) -> Iterator[Misfit]:
    """Yield the IMUs that leave more than noise of a motion.

    What counts is the RMS over the channels, m/s^2 (rad/s), that most of the intervals
    in motion do not exceed: a jolt is over in less time than there is between coarse
    knots, which cannot follow.

    Parameters
    ----------
    chunk : Chunk
    alone, together : Array
        Coefficients (K, n) of the encoders' motion, and of the motion by all.
    in_motion : float
        Share of a joint's highest speed, from which it is in motion.
    """
    for x in chunk.imus:
        speed = np.abs(splines.mean_motion(chunk, alone[:, : x.joints])[1])
        fastest = np.maximum(speed.max(axis=1, keepdims=True), 1e-9)
        counts = x.there & (speed > in_motion * fastest).any(axis=0)
        if not counts.any():
            counts = x.there

        residual = _without_drift(x, predicted(chunk, together, x))
        size = _typical(residual, x.seen, counts)
        noises = _typical(residual / x.spread, x.seen, counts)
        if not noises > BEYOND_NOISE:
            continue
        by_encoders = _without_drift(x, predicted(chunk, alone, x))
        noises_alone = _typical(by_encoders / x.spread, x.seen, counts)
        share = noises / max(noises_alone, 1e-9)
        text = (
            f"it differs from the motion by {size:.3g}, {noises:.1f} times its noise"
            f" and {percent(share, 0)} of what it differs from the encoders'"
        )
        yield Misfit(x.name, noises, share, text)


def contradiction(
    badly_fitting: Sequence[Misfit], *, unexplained: float = 0.36
) -> tuple[str, list[str]]:
    """Return the name of the IMU to be left out, if any, and notes on misfits."""
    # A right model leaves noise: motion that follows an IMU takes up nearly all in
    # which it differs from the encoders' motion. Wrong geometry or an arm that bends
    # leaves much more.
    if not badly_fitting:
        return "", []
    # The wrong one pulls sound ones with it, which hardly differ from the encoders: not
    # the share tells it, but the size.
    wrong = [misfit for misfit in badly_fitting if misfit.share > unexplained]
    if wrong:
        worst = max(wrong, key=lambda misfit: misfit.noises)
        limit = percent(unexplained, 0)
        return worst.name, [f"{worst.name} is left out: {worst.text} (limit {limit})"]
    remedy = "check geometry, mounting and gravity"
    return "", [
        f"{misfit.name} fits badly: {misfit.text}; {remedy}" for misfit in badly_fitting
    ]


def _without_drift(x: Mounted, expected: Array) -> Array:
    """Return the residual (M, L) of readings without what a drifting bias explains."""
    t = np.linspace(-1.0, 1.0, len(expected))[:, None] * x.seen
    residual = (x.y - expected) * x.seen
    slope = np.sum(t * residual, axis=0) / np.maximum(np.sum(t * t, axis=0), 1e-9)
    return np.asarray(residual - slope * t)


def _typical(
    residual: Array, seen: Mask, counts: Mask, *, typical: float = 0.8
) -> float:
    """Return the RMS over channels that a share `typical` of intervals stay below."""
    n_seen = np.maximum(seen[counts].sum(axis=1), 1)
    square = np.sum(residual[counts] ** 2, axis=1) / n_seen
    return float(np.sqrt(np.quantile(square, typical)))


def located(
    chunk: Chunk, c: Array, x: Mounted, *, sure_s: float = 0.002, sure_m: float = 0.005
) -> Mounted:
    """Fit an IMU's place, biases and clock offset to a motion `c` (K, n).

    A clock that is known to `sure_s` is not searched; with a lever that is known to
    `sure_m` nothing is fitted.
    """
    std_error = np.diag(x.precision) ** -0.5
    at_ends = _clock_std(x) @ [1.0, 0.5 * chunk.samples * chunk.dt]
    is_clock_sure = at_ends < sure_s
    is_lever_sure = std_error[x.places.lever].max() < sure_m
    if not x.seen.any() or (is_clock_sure and is_lever_sure):
        return x
    if not is_clock_sure:
        x = _searched(chunk, c, x)

    # One step of least squares without the clock, one with it.
    for taken in (_without_clock(x), np.arange(x.places.head)):
        design = _design(chunk, c, x, taken)
        pull = np.tensordot(design.residual / design.noise, design.G, 2)
        right = pull - (x.precision @ x.away)[taken]
        change = np.zeros(len(x.away))
        change[taken] = np.linalg.solve(design.information, right)
        x = _placed(chunk, x, change)
    return x


def _without_clock(x: Mounted) -> Index:
    """Return the numbers of an IMU's constants but for its clock and its axes."""
    places = x.places
    return np.concatenate(
        [np.arange(places.clock.start), np.arange(places.clock.stop, places.head)]
    )


def _clock_std(x: Mounted) -> Array:
    """Return the standard deviations (2,) of the clock's offset and rate."""
    of_clock = x.places.clock
    covariance = np.linalg.inv(x.precision[of_clock, of_clock])
    return np.asarray(np.sqrt(np.diag(covariance)))


def _placed(chunk: Chunk, x: Mounted, change: Array) -> Mounted:
    """Change an IMU's constants (g,), and gather its readings by its clock."""
    return replace(chunk, imus=(moved(x, change),)).gathered().imus[0]


def _searched(
    chunk: Chunk,
    c: Array,
    x: Mounted,
    *,
    search_s: float = 0.06,
    std_errors: float = 3.0,
    most_lags: int = 60,
    independent_s: float = 0.05,
) -> Mounted:
    """Search the clock that leaves least of the readings, within the prior's reach.

    All else is fitted to each clock: `search_s` and `std_errors` of its prior either
    way, on a grid of knots of `most_lags` either way. The encoders' motion errs over
    long stretches: residuals are independent after `independent_s` only.
    """
    of_clock = x.places.clock
    still = _without_clock(x)
    reach = std_errors * _clock_std(x)
    reach_s = max(search_s, float(reach[0]))
    knots = int(np.ceil(reach_s / chunk.spacing / most_lags))
    spacing_s = knots * chunk.spacing
    lags = np.arange(-int(reach_s / spacing_s), int(reach_s / spacing_s) + 1)
    rate_step = 2.0 * spacing_s / (chunk.samples * chunk.dt)
    n_rates = int(reach[1] / rate_step)
    rates = np.arange(-n_rates, n_rates + 1, dtype=np.float64) * rate_step

    design = _design(chunk, c, x, still)
    scan = _scan(chunk, c, x, design, lags * knots)
    n_independent = chunk.samples * chunk.dt / independent_s
    precision = x.precision[np.ix_(still, still)]
    of_prior = x.precision[of_clock, of_clock]

    def cost(sums: Sums, rate: float) -> Array:
        """Return minus the logarithm of likelihood and prior (S,)."""
        pull = sums.xy[..., 0]
        explained = np.linalg.solve(sums.xx + precision, sums.xy)[..., 0]
        squares = sums.yy[..., 0] - np.sum(pull * explained, axis=1)
        away = np.column_stack([scan.shifts, np.full(len(lags), rate)])
        away = away + x.away[of_clock]
        prior = 0.5 * np.sum((away @ of_prior) * away, axis=1)
        likelihood = 0.5 * n_independent * np.log(np.maximum(squares, 1e-12))
        return np.asarray(likelihood + prior)

    likeliest = search([scan], rates, cost).clock
    change = np.zeros(len(x.away))
    change[of_clock] = likeliest.offset_s, likeliest.rate
    return _placed(chunk, x, change)


def _scan(
    chunk: Chunk, c: Array, x: Mounted, design: "_Design", lags: Index
) -> ClockScan:
    """Sum residuals and slopes of windows of cells, for readings `lags` knots later."""
    times = chunk.from_middle[chunk.cells]
    number = np.floor((times - times[0]) / WINDOW_S)
    edges = np.flatnonzero(np.diff(number, prepend=-1.0))
    expected = predicted(chunk, c, x)
    of_cells = np.einsum("clp,clq->cpq", design.G, design.G)
    xx = np.add.reduceat(of_cells, edges)

    xy = []
    yy = []
    for lag in lags.tolist():
        seen = _later(np.asarray(x.seen, dtype=np.float64), lag) > 0
        shifted = replace(x, y=_later(x.y, lag), seen=seen)
        residual = _cell_means(chunk, shifted, shifted.y - expected) / design.noise
        pull = np.einsum("cl,clp->cp", residual, design.G)
        xy.append(np.add.reduceat(pull, edges)[:, :, None])
        yy.append(np.add.reduceat(np.sum(residual**2, axis=1), edges)[:, None])
    return ClockScan(
        times=np.add.reduceat(times, edges) / np.diff(np.append(edges, len(times))),
        shifts=lags.astype(np.float64) * chunk.spacing,
        windows=Sums(
            xx=np.repeat(xx[:, None], len(lags), axis=1),
            xy=np.stack(xy, axis=1),
            yy=np.stack(yy, axis=1),
        ),
    )


def _later(values: Array, lag: int) -> Array:
    """Return rows `lag` further on, zero where there are none."""
    shifted = np.zeros_like(values)
    m = len(values)
    shifted[max(-lag, 0) : m - max(lag, 0)] = values[max(lag, 0) : m + min(lag, 0)]
    return shifted


def _cell_means(chunk: Chunk, x: Mounted, residual: Array) -> Array:
    """Return means (C, L) over the readings of each cell; zero if there are none."""
    count = np.add.reduceat(x.seen.astype(float), chunk.cells)
    total = np.add.reduceat(residual * x.seen, chunk.cells)
    return np.asarray(total / np.maximum(count, 1.0))


class _Design(NamedTuple):
    """A least squares for some constants of an IMU, p in number.

    `residual` (C, L) and its `noise` (L,), whitened Jacobians `G` (C, L, p), and
    `information` (p, p) with that of the prior.
    """

    residual: Array
    noise: Array
    G: Array
    information: Array


def _design(chunk: Chunk, c: Array, x: Mounted, taken: Index) -> _Design:
    """Set up the least squares for the constants `taken` (p,) of an IMU."""
    residual = _cell_means(chunk, x, x.y - predicted(chunk, c, x))
    noise: Array = np.maximum(x.spread, gaussian_spread(residual))
    by_constants = jacobians(chunk, c, x, gains=False).by_constants
    there = np.add.reduceat(x.seen.astype(float), chunk.cells) > 0
    G = by_constants[:, :, taken] * there[:, :, None] / noise[:, None]
    of_readings = np.tensordot(G, G, ([0, 1], [0, 1]))
    information = of_readings + x.precision[np.ix_(taken, taken)]
    return _Design(residual, noise, G, information)


# Time between knots at most, of the motion and for the constants.
FINE_S = 1e-3
COARSE_S = 4e-3


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """A smoothed motion.

    Attributes
    ----------
    q, dq, ddq : Array
        (N, n) at every sample.
    places : Index
        Samples (G,) with a variance.
    variance : Array
        (G, n, 3), of each joint's q, dq, ddq at these places.
    mounted : dict of str to Mounted
        IMUs that took part, as the last chunk left them.
    notes : tuple of str
    beyond : Array
        (N, n) rad/s^2 by which links accelerate beyond the motion, by every calibrated
        IMU.
    """

    q: Array
    dq: Array
    ddq: Array
    places: Index
    variance: Array
    mounted: dict[str, Mounted]
    notes: tuple[str, ...]
    beyond: Array

    def typical(self, valid: Mask) -> Array:
        """Return the median variance (n, 3) at valid samples (N,).

        It is infinite for joints beyond all IMUs.
        """
        counts = valid[self.places]
        variance = self.variance[counts] if counts.any() else self.variance
        typical = np.median(variance, axis=0)
        last_link = max((x.place.link for x in self.mounted.values()), default=-1)
        typical[1 + last_link :] = np.inf
        return np.asarray(typical)


@dataclass(frozen=True, kw_only=True)
class _SmoothedChunk:
    """What comes of a chunk.

    Attributes
    ----------
    motion : Array
        q, dq, ddq (N, 3, n) at its samples.
    places, variance : Index, Array
        Samples (G,) with a variance (G, n, 3).
    imus : tuple of Mounted
        As the next chunk is to take them.
    notes : list of str
        On its IMUs.
    jerk_size : Array
        (n,), of the jerk between coarse knots.
    """

    motion: Array
    places: Index
    variance: Array
    imus: tuple[Mounted, ...]
    notes: list[str]
    jerk_size: Array


def _smoothed(chunk: Chunk, jerk_size: Array) -> _SmoothedChunk:
    """Find the constants on coarse knots and the motion on fine ones.

    `jerk_size` (n,) is a first guess for coarse knots.
    """
    coarse_s = COARSE_S if chunk.dt <= FINE_S else FINE_S
    coarse = _on_knots(chunk, coarse_s).gathered()
    c, jerk = solve.encoder_motion(coarse, jerk_size)
    coarse, notes = believed(coarse, c)
    shared, notes_on_misfits = _agreed(chunk, coarse, c, jerk)

    refined = _refined(chunk, shared)
    last = solve.detailed(refined.chunk, refined.c, refined.jerk)
    places, variance = solve.probed_variance(last, shared)

    # IMUs as the next chunk is to take them; the clocks as the fine knots have them.
    covariance: Array = np.asarray(np.linalg.inv(shared.schur), dtype=np.float64)
    imus = []
    slots = chosen(shared.chunk, shared.constants)
    for slot, fine in zip(slots, last.chunk.imus, strict=True):
        x = replace(slot.imu, delay=fine.delay, rate=fine.rate)
        imus.append(handed_on(x, slot.taken, covariance[slot.at, slot.at]))
    return _SmoothedChunk(
        motion=splines.motion_at(last.chunk, last.c)[:: last.chunk.stride],
        places=places,
        variance=variance,
        imus=tuple(imus),
        notes=notes + notes_on_misfits,
        jerk_size=_scaled_jerk(shared, coarse.spacing),
    )


def _scaled_jerk(solution: solve.Solution, spacing: float) -> Array:
    """Return the size (n,) of the same white jerk between knots of another spacing."""
    ratio = solution.chunk.spacing / spacing
    return np.asarray(solution.jerk.size * np.sqrt(ratio))


class _Start(NamedTuple):
    """A chunk with coefficients c (K, n) and jerk to begin with."""

    chunk: Chunk
    c: Array
    jerk: Jerk


def _refined(chunk: Chunk, shared: solve.Solution) -> _Start:
    """Return on fine knots what was found on coarse ones."""
    fine = _on_knots(replace(chunk, imus=shared.chunk.imus), FINE_S).gathered()
    middles = (np.arange(fine.intervals) + 0.5) * fine.spacing / shared.chunk.spacing
    at = np.minimum(middles.astype(int), shared.chunk.intervals - 1)
    jerk = replace(
        shared.jerk,
        size=_scaled_jerk(shared, fine.spacing),
        relative=shared.jerk.relative[at],
    )
    return _Start(fine, resampled(shared.chunk, shared.c, fine), jerk)


def _agreed(
    chunk: Chunk, coarse: Chunk, c: Array, jerk: Jerk
) -> tuple[solve.Solution, list[str]]:
    """Settle the constants; IMUs that no motion explains are left out one by one.

    Returns the solution that tells of the constants, and notes.
    """
    notes = []
    while True:
        shared = solve.settled(coarse, c, jerk)
        badly_fitting = list(misfits(shared.chunk, c, shared.c))
        if badly_fitting:
            # Coarse knots may not follow what an IMU feels: before it goes, fine ones
            # have their say.
            refined = _refined(chunk, shared)
            shared = solve.settled(refined.chunk, refined.c, refined.jerk)
            alone = resampled(coarse, c, shared.chunk)
            badly_fitting = list(misfits(shared.chunk, alone, shared.c))
        name, new_notes = contradiction(badly_fitting)
        notes += new_notes
        if not name:
            return shared, notes
        coarse = replace(coarse, imus=tuple(x for x in coarse.imus if x.name != name))


def _on_knots(chunk: Chunk, spacing: float) -> Chunk:
    """Return the same with knots about as far apart as `spacing` s."""
    finer = max(1, round(chunk.dt / spacing))
    every = max(1, round(spacing / chunk.dt)) if finer == 1 else 1
    views = tuple(view.refined(finer) for view in chunk.views)
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
    """Smooth all joints of one log, by chunks that fade into each other.

    A chunk begins with the constants that the one before has found. Joints beyond
    believed IMUs rest on their encoders.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    stage : ImuStage, optional
    chunk_s, overlap_s : float
        Length of a chunk [s], and lap on either side.
    first_jerk : float
        First guess of the jerk between fine knots [rad/s^3].
    mostly : float
        Share of the samples; an IMU that reads in fewer is named.
    """
    n_samples = len(recording.q)
    rate_hz = recording.rate_hz
    steps = _encoder_steps(recording, robot)
    coarse_ratio = max(COARSE_S, 1.0 / rate_hz) / FINE_S
    # The mean of white jerk over a longer interval is smaller. A guess that is larger
    # smooths little, and the search comes down from there.
    jerk_size = np.full(robot.n, first_jerk * np.sqrt(coarse_ratio))
    current = {x.name: x for x in mounted_imus(recording, robot, stage)}

    joined = np.zeros((n_samples, 3, robot.n))
    n_live = dict.fromkeys(current, 0.0)
    used: set[str] = set()
    places = []
    variances = []
    notes = []
    for part in _fading(n_samples, chunk_s * rate_hz, int(overlap_s * rate_hz)):
        own = part.samples
        imus = tuple(read(x, recording, own) for x in current.values())
        for x in imus:
            n_live[x.name] += float(part.share @ x.live.any(axis=1))
        chunk = Chunk(
            robot=robot,
            views=tuple(
                splines.encoder_view(q, step, recording.valid[own])
                for q, step in zip(recording.q[own].T, steps.tolist(), strict=True)
            ),
            dt=1.0 / rate_hz,
            every=1,
            imus=imus,
        )
        # Threads of the linear algebra only get into each other's way with matrices
        # this narrow.
        with threadpool_limits(1):
            smoothed = _smoothed(chunk, jerk_size)

        jerk_size = smoothed.jerk_size
        current |= {x.name: x for x in smoothed.imus}
        used |= {x.name for x in smoothed.imus}
        notes += [f"{own.start / rate_hz:.1f} s: {note}" for note in smoothed.notes]
        joined[own] += part.share[:, None, None] * smoothed.motion
        is_mostly_of_chunk = part.share[smoothed.places] >= 0.5
        places.append(smoothed.places[is_mostly_of_chunk] + own.start)
        variances.append(smoothed.variance[is_mostly_of_chunk])

    mounted = {name: x for name, x in current.items() if name in used}
    n_valid = max(int(recording.valid.sum()), 1)
    for name in mounted:
        share = n_live[name] / n_valid
        if share < mostly:
            notes.append(f"{name} reads in {percent(share, 0)} of the samples")

    q, dq, ddq = (np.ascontiguousarray(joined[:, order]) for order in range(3))
    # By the constants that explain this log best; of an IMU that was left out by its
    # calibration.
    calibrated = mounted_imus(recording, robot, stage)
    witnesses = [
        read(mounted.get(x.name, x), recording, slice(0, n_samples)) for x in calibrated
    ]
    return Smoothed(
        q=q,
        dq=dq,
        ddq=ddq,
        places=np.concatenate(places),
        variance=np.concatenate(variances),
        mounted=mounted,
        notes=tuple(notes),
        beyond=beyond_motion(robot, recording.t, (q, dq, ddq), witnesses),
    )


def _encoder_steps(recording: Recording, robot: Robot) -> Array:
    """Return the encoder steps (n,) rad of the robot file, or else of the positions."""
    filled = np.column_stack(
        [splines.bridged(q, np.isfinite(q)) for q in recording.q.T]
    )
    resolution = encoder_resolution(robot)
    return np.where(resolution > 0, resolution, encoder_step(filled))


class _Part(NamedTuple):
    """Samples of a chunk, and their shares (N,) in the joined motion."""

    samples: slice
    share: Array


def _fading(n_samples: int, length: float, lap: int) -> Iterator[_Part]:
    """Yield chunks of about a length with a lap on either side.

    The shares of a sample add up to 1.
    """
    n_chunks = max(1, round(n_samples / length))
    edges = np.linspace(0, n_samples, n_chunks + 1).astype(int)
    starts = np.maximum(edges[:-1] - lap, 0).tolist()
    stops = np.minimum(np.append(edges[1:-1], n_samples) + lap, n_samples).tolist()
    for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        rise = [start, stops[k - 1]] if k else [-2, -1]
        fall_from = starts[k + 1] if k + 1 < len(starts) else n_samples
        t = np.arange(start, stop, dtype=float)
        share = np.interp(t, [*rise, fall_from, stop], [0.0, 1.0, 1.0, 0.0])
        yield _Part(slice(start, stop), share)
