"""Lost samples that the stamps do not show, found by the motion of the joints.

A logger that counts its rows instead of reading a clock gives rows behind a loss stamps
that are too early: the position steps by the motion of the lost time, while the motion
on either side goes on as it was. Parabolas through the positions before and behind an
increment reach its middle at positions a and b. With the mean v of the velocities of
both sides, the time L that is lost there is the least-squares solution of

    (b - a)_j = v_j L,    for all joints j,

each weighted by its noise, the encoder's or what the parabolas leave. A joint is a
witness only by the speed that both sides have: one that is held and then catches up has
lost no time, and of a spike the parabolas leave as much as it steps by. A loss counts
where it is certain and the same for all joints that move: a step of one joint alone is
damage of its position. Stamps behind a loss are moved by L; the hole is filled by the
cubic through positions and velocities of both sides and by straight lines through what
else was logged around it.

Losses that recur at one distance tell where the next one is: at such a place, or a row
beside it, a step at slow motion is one too if the motion of the usual lost time
explains it better than no loss.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from seqid_cli.logs.raw import Array, Mask, Rows, Stamps, Stream
from seqid_cli.robust import DIFFERENCES, gaussian_spread, rough

SIDE = 6  # samples of a parabola

# A parabola q(x) = c_0 + c_1 x + c_2 x^2 with x in intervals from the middle of a step:
# `FIT` gives its least-squares coefficients by the samples of a side, `LINE` the slope
# of the straight line through them.
BASIS = np.vander(np.arange(SIDE) + 0.5, 3, increasing=True)
FIT = np.linalg.pinv(BASIS)
LINE = np.linalg.pinv(BASIS[:, :2])[1]
# By how much more the mean slope of both lines, per interval, is uncertain than the gap
# between both parabolas.
SLOPE = float(0.5 * np.linalg.norm(LINE) / np.linalg.norm(FIT[0]))

REACH = 12  # samples on either side of a hole that tell the slope of the position at it


@dataclass(frozen=True)
class Losses:
    """Time that is lost behind K samples, in their order."""

    rows: Rows  # (K,)
    seconds: Array  # (K,)


def with_losses(stream: Stream, losses: Losses) -> tuple[Stream, Mask]:
    """Move the stamps behind losses and fill the holes.

    Parameters
    ----------
    stream : Stream
        M samples in the order of time.
    losses : Losses
        Where time is lost, and how much.

    Returns
    -------
    Stream
        M' samples, the holes filled at the usual interval.
    ndarray of bool, (M',)
        The samples that fill holes.
    """
    n_logged = len(stream)
    if not len(losses.rows):
        return stream, np.zeros(n_logged, np.bool_)

    shift = np.zeros(n_logged, np.int64)
    shift[losses.rows + 1] = np.rint(losses.seconds * 1e9).astype(np.int64)
    stamps = stream.stamp_ns + np.cumsum(shift)

    # The fillings of all holes, behind what was logged; sorted afterwards.
    usual_ns = float(np.median(np.diff(stream.stamp_ns)))
    stamp_parts = [stamps]
    channel_parts = [dict(stream.channels)]
    for row in losses.rows:
        hole_ns = stamps[row + 1] - stamps[row]
        count = max(1, round(float(hole_ns) / usual_ns)) - 1
        offsets = np.arange(1, count + 1) * (hole_ns / (count + 1))
        filling = stamps[row] + offsets.astype(np.int64)
        stamp_parts.append(filling)
        channel_parts.append(
            {
                name: _filled(name, values, stamps, row, filling)
                for name, values in stream.channels.items()
            }
        )

    all_stamps = np.concatenate(stamp_parts)
    order = np.argsort(all_stamps, kind="stable")
    channels = {}
    for name in stream.channels:
        values = np.concatenate([part[name] for part in channel_parts])
        channels[name] = values[order]
    filled = replace(stream, stamp_ns=all_stamps[order], channels=channels)
    return filled, order >= n_logged


def _filled(
    name: str, values: Array, stamps: Stamps, row: int, filling: Stamps
) -> Array:
    """Return values (K, w) of one channel (M, w) at K stamps in the hole behind a row.

    Positions follow the cubic through positions and slopes of both sides, everything
    else a straight line through what was logged around the hole.
    """
    from scipy.interpolate import CubicHermiteSpline

    polyfit = np.polynomial.polynomial.polyfit
    x = (stamps - stamps[row]).astype(np.float64) * 1e-9
    seconds = (filling - stamps[row]) * 1e-9
    reach = REACH if name == "position" else len(filling) + 2
    first = max(0, row + 1 - reach)
    stop = min(len(x), row + 1 + reach)
    if name != "position":
        intercept, slope = polyfit(x[first:stop], values[first:stop], 1)
        return np.asarray(intercept + seconds[:, None] * slope)

    ends = x[[row, row + 1]]
    slopes = []
    for side, end in zip(
        (slice(first, row + 1), slice(row + 1, stop)), ends, strict=True
    ):
        coefficients = polyfit(x[side] - end, values[side], 2)
        slopes.append(coefficients[1])
    curve = CubicHermiteSpline(ends, values[[row, row + 1]], np.array(slopes))
    return np.asarray(curve(seconds))


@dataclass(frozen=True)
class LossCriteria:
    """Limits by which a step of the positions is time that was lost; see the module."""

    sure: float = 5.0  # standard errors of the lost time, beyond which it is believed
    least_intervals: float = 1.5  # that are lost
    longest_s: float = 1.0  # lost at once: behind that, motion before says nothing
    # times the smaller increment beside it, that it differs from their mean
    sudden: float = 1.2
    sudden_noise: float = 5.0  # times the noise, likewise
    uneven: float = 0.5  # of the lost motion by its faster side: joints accelerate
    # of a joint's usual speed, below which it is no witness: where a brake lets go, or
    # a drive takes over, joints creep and step
    creep: float = 0.03
    # of an interval, by which stamps that count rows differ from even ones
    counted: float = 0.3
    # of the increments: steps as frequent are noise or a slower channel
    many: float = 0.2
    # of an interval (median) within which losses are whole intervals
    on_grid: float = 0.12
    # of the increments that make a count of the encoder or less ...
    smallest: float = 1e-3
    most: int = 5_000  # ... of so many of them
    recurs: float = 0.5  # of the distances between losses that are one and the same ...
    least_losses: int = 4  # ... and losses that tell it


CRITERIA = LossCriteria()
NONE = Losses(np.zeros(0, np.intp), np.zeros(0))


@dataclass(frozen=True)
class Mended:
    """A stream with its losses put right."""

    stream: Stream
    bridged: Mask  # (M,) samples of it that were not measured
    losses: Losses  # by the rows of the stream as it came
    stamps: Stamps  # of the stream as it came

    @property
    def warnings(self) -> tuple[str, ...]:
        """A note on what was mended; empty where nothing was."""
        seconds = self.losses.seconds
        if not len(seconds):
            return ()
        return (
            f"samples are lost at {len(seconds)} places, {1e3 * np.median(seconds):.3g}"
            f" ms each (median), {seconds.sum():.3g} s in all: all joints step there by"
            " the motion of that time and the stamps go on as if nothing was missing."
            " The time base is repaired and the holes are bridged; log with the"
            " controller's own clock",
        )


@dataclass(frozen=True, kw_only=True)
class _Steps:
    """What the motion on either side says of K increments of n joints."""

    rows: Rows  # (K,) an increment is behind its row
    gap: Array  # (K, n) rad, by which a joint steps
    velocity: Array  # (K, n) rad/s, mean of both sides
    shared_speed: Array  # (K, n) rad/s, the part that both sides have
    faster_speed: Array  # (K, n) rad/s, of the faster side
    noise: Array  # (K, n) rad, of the gap

    @classmethod
    def at(cls, rows: Rows, q: Array, dt: float, encoder_noise: Array) -> "_Steps":
        """Fit both sides of increments.

        Parameters
        ----------
        rows : ndarray of int, (K,)
            The increments are behind them.
        q : ndarray, (M, n)
            Positions [rad], `dt` s apart.
        encoder_noise : ndarray, (n,)
            Standard deviation of the positions [rad].
        """
        # Positions of both sides (K, SIDE, n), nearest first, from that of the row.
        padded = np.pad(q, ((SIDE, SIDE), (0, 0)), mode="reflect", reflect_type="odd")
        away = np.arange(SIDE)
        center = rows[:, None] + SIDE
        behind = padded[center - away] - q[rows, None]
        ahead = padded[center + away + 1] - q[rows, None]

        # Parabolas through them, with x away from the step on either side.
        fit_behind = FIT @ behind
        fit_ahead = FIT @ ahead
        gap = fit_ahead[:, 0] - fit_behind[:, 0]
        residuals = [behind - BASIS @ fit_behind, ahead - BASIS @ fit_ahead]
        degrees_of_freedom = 2 * SIDE - 6
        squares = np.sum(np.square(residuals), axis=(0, 2))
        residual_std = np.sqrt(squares / degrees_of_freedom)
        noise_of_fit = np.sqrt(2.0) * np.linalg.norm(FIT[0])
        noise = noise_of_fit * np.maximum(residual_std, encoder_noise)

        slopes = np.stack([-(LINE @ behind), LINE @ ahead]) / dt
        velocity = slopes.mean(axis=0)
        direction = np.sign(velocity)
        # At the step itself a slope is that of the parabola, give or take its error.
        slopes_at_step = np.stack([-fit_behind[:, 1], fit_ahead[:, 1]])
        slope_error = 2.0 * np.linalg.norm(FIT[1]) * encoder_noise
        upper_at_step = slopes_at_step * direction + slope_error
        shared = np.minimum(
            (slopes * direction).min(axis=0), upper_at_step.min(axis=0) / dt
        )
        return cls(
            rows=rows,
            gap=gap,
            velocity=velocity,
            shared_speed=np.clip(shared, 0.0, np.abs(velocity)),
            faster_speed=np.abs(slopes).max(axis=0),
            noise=noise,
        )

    def fit_all_joints(self, lost_s: Array, dt: float) -> Mask:
        """Tell where all joints step by the motion of the lost time (K,)."""
        seconds = lost_s[:, None]
        noise = self.noise * np.hypot(1.0, SLOPE * seconds / dt)
        accelerated = CRITERIA.uneven * self.faster_speed * seconds
        largest = CRITERIA.sure * noise + accelerated
        unexplained = np.abs(self.gap - self.velocity * seconds)
        return np.asarray((unexplained < largest).all(axis=1))


def mended(joints: Stream) -> Mended:
    """Find lost samples by the motion of joints, `position` (M, n), and bridge them."""
    stamps = joints.stamp_ns
    q = joints.channels["position"]
    losses = NONE
    if len(stamps) >= 4 * SIDE and np.isfinite(q).all():
        encoder_noise = _encoder_noise(q)
        rows = _sudden_increments(q, encoder_noise)
        # Steps in every fifth sample are noise, or a channel slower than the log.
        if 0 < len(rows) <= CRITERIA.many * len(stamps):
            losses = _losses(np.diff(stamps) * 1e-9, q, rows, encoder_noise)
    stream, bridged = with_losses(joints, losses)
    return Mended(stream, bridged, losses, stamps)


def _encoder_noise(q: Array) -> Array:
    """Return the noise (n,) rad of positions (M, n), at least that of their counts."""
    # By the roughness of a limited number of short windows.
    stride = max(1, len(q) // CRITERIA.most)
    first = np.arange(0, len(q) - DIFFERENCES, stride)
    windows = q[first[:, None] + np.arange(DIFFERENCES + 1)]
    noise = gaussian_spread(rough(np.moveaxis(windows, 1, 0))[0])

    # The smallest increments of a joint are one count of its encoder.
    counts = np.zeros(q.shape[1])
    for joint, increments in enumerate(np.abs(windows[:, 1] - windows[:, 0]).T):
        if increments.any():
            counts[joint] = np.quantile(increments[increments > 0], CRITERIA.smallest)
    return np.asarray(np.maximum(noise, counts / np.sqrt(12.0)) + 1e-15)


def _sudden_increments(q: Array, encoder_noise: Array) -> Rows:
    """Find increments that differ from those beside them by more than motion and noise.

    The smaller neighbour counts: one side alone is small where the position was held
    before it catches up.
    """
    increments = np.diff(q, axis=0)
    before = increments[:-2]
    after = increments[2:]
    smaller = np.minimum(np.abs(before), np.abs(after))
    limit = np.maximum(CRITERIA.sudden * smaller, CRITERIA.sudden_noise * encoder_noise)
    change = np.abs(increments[1:-1] - 0.5 * (before + after))
    return np.asarray(np.flatnonzero((change > limit).any(axis=1)) + 1)


def _losses(dt: Array, q: Array, rows: Rows, encoder_noise: Array) -> Losses:
    """Return the losses that increments show, and those that recur at slow motion.

    Parameters
    ----------
    dt : ndarray, (M - 1,)
        Intervals of the stamps [s].
    q : ndarray, (M, n)
        Positions [rad].
    rows : ndarray of int
        Increments that are sudden.
    encoder_noise : ndarray, (n,)
        Standard deviation of the positions [rad].
    """
    usual = float(np.median(dt))
    rows = rows[(rows >= 2) & (rows < len(dt) - 2)]
    # Stamps around a step are as even as those of a logger that counts its rows.
    near = dt[rows[:, None] + np.arange(-2, 3)]
    rows = rows[(np.abs(near - usual) < CRITERIA.counted * usual).all(axis=1)]

    # The lost time by weighted least squares over the joints; see the module's text.
    steps = _Steps.at(rows, q, usual, encoder_noise)
    weight = steps.noise**-2.0
    information = np.maximum(np.sum(steps.velocity**2 * weight, axis=1), 1e-300)
    lost_s = np.sum(steps.velocity * steps.gap * weight, axis=1) / information
    usual_speed = np.quantile(np.abs(np.diff(q, axis=0)), 0.9, axis=0) / usual
    witness_speed = np.where(
        steps.shared_speed > CRITERIA.creep * usual_speed, steps.shared_speed, 0.0
    )
    z_score = lost_s * np.sqrt(np.sum(witness_speed**2 * weight, axis=1))
    is_loss = z_score > CRITERIA.sure
    is_loss &= lost_s > CRITERIA.least_intervals * usual
    is_loss &= lost_s < CRITERIA.longest_s
    is_loss &= steps.fit_all_joints(lost_s, usual)

    # A logger that counts its rows loses whole intervals.
    seconds = lost_s[is_loss]
    rounded = np.maximum(1.0, np.rint(seconds / usual))
    if len(seconds):
        off_grid = np.median(np.abs(seconds / usual - rounded))
        if off_grid < CRITERIA.on_grid:
            seconds = rounded * usual
    certain = Losses(rows[is_loss], seconds)

    places = _recurring(certain.rows, len(dt))
    if not len(places):
        return certain
    return _with_recurring(certain, _Steps.at(places, q, usual, encoder_noise), usual)


def _recurring(rows: Rows, count: int) -> Rows:
    """Return the rows where losses recur at one distance, and those beside them.

    Parameters
    ----------
    rows : ndarray of int
        Rows of certain losses, which are left out; empty is returned where these do
        not recur.
    count : int
        Number of increments.
    """
    distances = np.diff(rows)
    if len(rows) < CRITERIA.least_losses:
        return NONE.rows
    period = int(np.bincount(distances).argmax())
    if np.mean(distances == period) < CRITERIA.recurs:
        return NONE.rows

    places = [
        np.arange(before + period, after - 1, period)
        for before, after in pairwise(rows)
    ]
    places.append(np.arange(rows[0] - period, 0, -period))
    places.append(np.arange(rows[-1] + period, count, period))
    row = np.concatenate(places)
    near = np.unique(np.concatenate([row - 1, row, row + 1]))
    return np.setdiff1d(near[(near >= 2) & (near < count - 2)], rows)


def _with_recurring(certain: Losses, steps: _Steps, dt: float) -> Losses:
    """Add the steps that the usual lost time explains better than no loss does."""
    seconds = np.full(len(steps.rows), float(np.median(certain.seconds)))
    unexplained = steps.gap - steps.velocity * seconds[:, None]
    chi_square_without = np.sum((steps.gap / steps.noise) ** 2, axis=1)
    chi_square_with = np.sum((unexplained / steps.noise) ** 2, axis=1)
    is_likely = chi_square_with < chi_square_without
    is_likely &= chi_square_without > CRITERIA.sure**2
    is_likely &= steps.fit_all_joints(seconds, dt)

    # Of neighbours the one is meant that stands out by more.
    prominence = np.zeros(max(steps.rows[-1], certain.rows[-1]) + 2)
    prominence[steps.rows] = np.where(is_likely, chi_square_without, 0.0)
    prominence[certain.rows] = np.inf
    neighbours = np.maximum(prominence[steps.rows - 1], prominence[steps.rows + 1])
    is_likely &= chi_square_without > neighbours

    rows = np.concatenate([certain.rows, steps.rows[is_likely]])
    all_seconds = np.concatenate([certain.seconds, seconds[is_likely]])
    order = np.argsort(rows, kind="stable")
    return Losses(rows[order], all_seconds[order])
