"""Lost samples that the stamps do not show: found by the motion of the joints, and put right.

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
from scipy.interpolate import CubicHermiteSpline

from seqid_cli.logs.raw import Array, Mask, Rows, Stamps, Stream
from seqid_cli.robust import DIFFERENCES, gaussian_spread, rough

SIDE = 6  # samples of a parabola
# A parabola over intervals from the middle of a step, the least squares for its
# coefficients, and by how much more the velocity of two, per interval, is uncertain
# than the gap between them.
BASIS = np.vander(np.arange(SIDE) + 0.5, 3, increasing=True)
FIT = np.linalg.pinv(BASIS)
LINE = np.linalg.pinv(BASIS[:, :2])[1]
SLOPE = float(0.5 * np.linalg.norm(LINE) / np.linalg.norm(FIT[0]))
REACH = 12  # samples on either side of a hole that tell the slope of the position at it


@dataclass(frozen=True)
class Losses:
    """Time `seconds` (K,) that is lost behind the samples `rows` (K,), in their order."""

    rows: Rows
    seconds: Array


def with_losses(stream: Stream, losses: Losses) -> tuple[Stream, Mask]:
    """Move the stamps behind losses and fill the holes; tells the samples (M',) that fill them."""
    if not len(losses.rows):
        return stream, np.zeros(len(stream), np.bool_)
    shift = np.zeros(len(stream), np.int64)
    shift[losses.rows + 1] = np.rint(losses.seconds * 1e9).astype(np.int64)
    stamps = stream.stamp_ns + np.cumsum(shift)
    usual = float(np.median(np.diff(stream.stamp_ns)))
    pieces, parts = [stamps], [dict(stream.channels)]
    for row in losses.rows:
        width = stamps[row + 1] - stamps[row]
        count = max(1, round(float(width) / usual)) - 1
        at = stamps[row] + (np.arange(1, count + 1) * (width / (count + 1))).astype(
            np.int64
        )
        pieces.append(at)
        parts.append(
            {n: _filled(n, own, stamps, row, at) for n, own in stream.channels.items()}
        )
    joined = np.concatenate(pieces)
    order = np.argsort(joined, kind="stable")
    channels = {
        n: np.concatenate([part[n] for part in parts])[order] for n in stream.channels
    }
    return replace(stream, stamp_ns=joined[order], channels=channels), order >= len(
        stream
    )


def _filled(name: str, values: Array, stamps: Stamps, row: int, at: Stamps) -> Array:
    """Values (K, w) of one channel in the hole behind a sample."""
    x, seconds = (
        (stamps - stamps[row]).astype(np.float64) * 1e-9,
        (at - stamps[row]) * 1e-9,
    )
    reach, fit = (
        len(at) + 2 if name != "position" else REACH,
        np.polynomial.polynomial.polyfit,
    )
    low, high = max(0, row + 1 - reach), min(len(x), row + 1 + reach)
    if name != "position":
        line = fit(x[low:high], values[low:high], 1)
        return np.asarray(line[0] + seconds[:, None] * line[1])
    sides, ends = (slice(low, row + 1), slice(row + 1, high)), x[[row, row + 1]]
    slopes = [
        fit(x[s] - end, values[s], 2)[1] for s, end in zip(sides, ends, strict=True)
    ]
    curve = CubicHermiteSpline(ends, values[[row, row + 1]], np.array(slopes))
    return np.asarray(curve(seconds))


@dataclass(frozen=True)
class LossCriteria:
    """When a step of the positions is time that was lost; see the text of this module."""

    sure: float = 5.0  # standard errors of the lost time, beyond which it is believed
    least_intervals: float = 1.5  # that are lost
    longest_s: float = 1.0  # lost at once: behind that, motion before says nothing
    # times the smaller increment beside it, that it differs from their mean
    sudden: float = 1.2
    sudden_noise: float = 5.0  # times the noise, likewise
    uneven: float = 0.5  # of the lost motion by its faster side: joints accelerate
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
    """A stream put right, its `bridged` samples (M,); `losses` and `stamps` as it came."""

    stream: Stream
    bridged: Mask
    losses: Losses
    stamps: Stamps

    @property
    def warnings(self) -> tuple[str, ...]:
        """What there is to say; nothing where nothing was mended."""
        seconds = self.losses.seconds
        if not len(seconds):
            return ()
        text = (
            f"samples are lost at {len(seconds)} places, {1e3 * np.median(seconds):.3g}"
            " ms each "
        )
        text += (
            f"(median), {seconds.sum():.3g} s in all: all joints step there by the"
            " motion of "
        )
        text += (
            "that time and the stamps go on as if nothing was missing. The time"
            " base is "
        )
        return (
            (
                f"{text}repaired and the holes are bridged; log with the controller's"
                " own clock"
            ),
        )


@dataclass(frozen=True)
class _Steps:
    """What the motion on either side says of increments `rows` (K,); the rest is (K, n)."""

    rows: Rows
    gap: Array  # rad, by which a joint steps
    velocity: Array  # rad/s, mean of both sides
    shared: Array  # rad/s, the part that both sides have
    faster: Array  # rad/s, of the faster side
    noise: Array  # rad, of the gap

    @classmethod
    def at(cls, rows: Rows, q: Array, dt: float, noise: Array) -> "_Steps":
        """Fit both sides of rows of positions q (M, n) rad of `noise` (n,) rad, `dt` s apart."""
        after = np.arange(SIDE)
        beyond = np.pad(q, ((SIDE, SIDE), (0, 0)), mode="reflect", reflect_type="odd")
        at = rows[:, None] + SIDE
        behind, ahead = (
            beyond[at + way] - q[rows, None] for way in (-after, after + 1)
        )
        (a, u, _), (b, w, _) = (
            np.moveaxis(FIT @ side, 1, 0) for side in (behind, ahead)
        )
        left = [side - BASIS @ (FIT @ side) for side in (behind, ahead)]
        own = np.sqrt(np.sum(np.square(left), axis=(0, 2)) / (2 * SIDE - 6))
        lines = np.stack([-(LINE @ behind), LINE @ ahead]) / dt
        velocity = lines.mean(axis=0)
        # At the step itself a slope is that of the parabola, give or take its error.
        ends = (
            np.stack([-u, w]) * np.sign(velocity) + 2.0 * np.linalg.norm(FIT[1]) * noise
        )
        shared = np.minimum(
            (lines * np.sign(velocity)).min(axis=0), ends.min(axis=0) / dt
        )
        shared, faster = (
            np.clip(shared, 0.0, np.abs(velocity)),
            np.abs(lines).max(axis=0),
        )
        noise = np.sqrt(2.0) * np.linalg.norm(FIT[0]) * np.maximum(own, noise)
        return cls(rows, b - a, velocity, shared, faster, noise)

    def alike(self, lost: Array, dt: float) -> Mask:
        """Whether all joints step by the motion of the time that is lost, (K,) s."""
        seconds = lost[:, None]
        noise = self.noise * np.hypot(1.0, SLOPE * seconds / dt)
        most = CRITERIA.sure * noise + CRITERIA.uneven * self.faster * seconds
        return np.asarray(
            (np.abs(self.gap - self.velocity * seconds) < most).all(axis=1)
        )


def mended(joints: Stream) -> Mended:
    """Put right what the motion of the joints says of a stream with `position` (M, n)."""
    stamps, q = joints.stamp_ns, joints.channels["position"]
    losses = NONE
    if len(stamps) >= 4 * SIDE and np.isfinite(q).all():
        noise, d = _noise(q), np.diff(q, axis=0)
        # Increments that differ from those beside them by more than motion and noise:
        # one side alone is small where the position was held before it catches up.
        beside = CRITERIA.sudden * np.minimum(np.abs(d[:-2]), np.abs(d[2:]))
        least = np.maximum(beside, CRITERIA.sudden_noise * noise)
        sudden = np.abs(d[1:-1] - 0.5 * (d[:-2] + d[2:])) > least
        rows: Rows = np.flatnonzero(sudden.any(axis=1)) + 1
        if 0 < len(rows) <= CRITERIA.many * len(stamps):
            losses = _losses(np.diff(stamps) * 1e-9, q, rows, noise)
    stream, bridged = with_losses(joints, losses)
    return Mended(stream, bridged, losses, stamps)


def _noise(q: Array) -> Array:
    """Noise (n,) rad of positions (M, n): by their roughness, and at least that of their counts."""
    some = np.arange(0, len(q) - DIFFERENCES, max(1, len(q) // CRITERIA.most))
    windows = q[some[:, None] + np.arange(DIFFERENCES + 1)]
    noise = gaussian_spread(rough(np.moveaxis(windows, 1, 0))[0])
    size = np.abs(windows[:, 1] - windows[:, 0])
    counts = [
        np.quantile(own[own > 0], CRITERIA.smallest) if own.any() else 0.0
        for own in size.T
    ]
    return np.asarray(np.maximum(noise, np.array(counts) / np.sqrt(12.0)) + 1e-15)


def _losses(dt: Array, q: Array, rows: Rows, noise: Array) -> Losses:
    """Losses that increments `rows` show, and those that recur at slow motion."""
    usual = float(np.median(dt))
    rows = rows[(rows >= 2) & (rows < len(dt) - 2)]
    # Stamps around a step are as even as those of a logger that counts its rows.
    near = dt[rows[:, None] + np.arange(-2, 3)]
    rows = rows[(np.abs(near - usual) < CRITERIA.counted * usual).all(axis=1)]
    steps = _Steps.at(rows, q, usual, noise)
    weight = steps.noise**-2.0
    power = np.maximum(np.sum(steps.velocity**2 * weight, axis=1), 1e-300)
    lost = np.sum(steps.velocity * steps.gap * weight, axis=1) / power
    sure = lost * np.sqrt(np.sum(steps.shared**2 * weight, axis=1)) > CRITERIA.sure
    sure &= (lost > CRITERIA.least_intervals * usual) & (lost < CRITERIA.longest_s)
    sure &= steps.alike(lost, usual)
    seconds = lost[sure]
    whole = np.maximum(1.0, np.rint(seconds / usual))
    if len(seconds) and np.median(np.abs(seconds / usual - whole)) < CRITERIA.on_grid:
        seconds = whole * usual
    known = Losses(rows[sure], seconds)
    places = _recurring(known.rows, len(dt))
    return (
        _joined(known, _Steps.at(places, q, usual, noise), usual)
        if len(places)
        else known
    )


def _recurring(rows: Rows, count: int) -> Rows:
    """Rows at multiples of the distance at which losses recur, or one beside; none without it."""
    distances = np.diff(rows)
    period = int(np.bincount(distances).argmax()) if len(distances) else 0
    if (
        len(rows) < CRITERIA.least_losses
        or np.mean(distances == period) < CRITERIA.recurs
    ):
        return NONE.rows
    inner = [np.arange(a + period, b - 1, period) for a, b in pairwise(rows)]
    ends = [
        np.arange(rows[0] - period, 0, -period),
        np.arange(rows[-1] + period, count, period),
    ]
    places = np.concatenate([*inner, *ends])
    near = np.unique(np.concatenate([places - 1, places, places + 1]))
    return np.setdiff1d(near[(near >= 2) & (near < count - 2)], rows)


def _joined(known: Losses, steps: _Steps, dt: float) -> Losses:
    """Losses with those of the steps that the usual lost time explains better than none does."""
    seconds = np.full(len(steps.rows), float(np.median(known.seconds)))
    apart = steps.gap - steps.velocity * seconds[:, None]
    without, left = (np.sum((x / steps.noise) ** 2, axis=1) for x in (steps.gap, apart))
    likely = (left < without) & (without > CRITERIA.sure**2)
    likely &= steps.alike(seconds, dt)
    # Of neighbours the one is meant that stands out by more.
    certain = np.zeros(max(steps.rows[-1], known.rows[-1]) + 2)
    certain[steps.rows], certain[known.rows] = np.where(likely, without, 0.0), np.inf
    likely &= without > np.maximum(certain[steps.rows - 1], certain[steps.rows + 1])
    rows = np.concatenate([known.rows, steps.rows[likely]])
    order = np.argsort(rows, kind="stable")
    return Losses(rows[order], np.concatenate([known.seconds, seconds[likely]])[order])
