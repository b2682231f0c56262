"""Lost samples that the stamps do not show: found by the motion of the joints, and put right.

A logger that counts its rows instead of reading a clock gives rows behind a loss stamps that are
too early: the position then steps by the motion of the lost time, while the motion on either side
goes on as it was. Parabolas through the positions before and behind an increment reach its middle
at positions a, b with velocities u, w. The time L that is lost there is the least-squares solution
of

    (b - a)_j = (u + w)_j / 2 L,    for all joints j,

each weighted by its noise, the encoder's or what the parabolas leave. A joint is a witness only by
the speed that both sides have: one that is held and then catches up has lost no time, and of a
spike the parabolas leave as much as it steps by.

A loss counts where it is certain, longer than one and a half intervals, and the same for all joints
that move: a step of one joint alone is damage of its position. Stamps behind a loss are moved by L
and the hole is filled (`bridging`).

Losses that recur at one distance tell where the next one is: at such a place, or a row beside it, a
step at slow motion is one too if the motion of the usual lost time explains it better than no loss.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from seqid_cli.logs.checks.bridging import Losses, with_losses
from seqid_cli.logs.raw import Array, Mask, Rows, Stamps, Stream
from seqid_cli.robust import DIFFERENCES, gaussian_spread, rough

SIDE = 6  # samples of a parabola
# A parabola over intervals from the middle of a step, the least squares for its coefficients, and
# by how much more the velocity of two, per interval, is uncertain than the gap between them.
BASIS = np.vander(np.arange(SIDE) + 0.5, 3, increasing=True)
FIT = np.linalg.pinv(BASIS)
SLOPE = float(0.5 * np.linalg.norm(FIT[1]) / np.linalg.norm(FIT[0]))


@dataclass(frozen=True)
class LossCriteria:
    """When a step of the positions is time that was lost; see the text of this module.

    A `sudden` step differs from the mean of the increments beside it by so many times the smaller
    of them. Joints may differ in the motion of the lost time, for they accelerate.
    """

    sure: float = 8.0  # standard errors of the lost time, beyond which it is believed
    least_intervals: float = 1.5  # that are lost
    longest_s: float = 1.0  # lost at once: behind that, motion before says nothing
    sudden: float = 1.2
    uneven: float = 0.5  # of the motion of the lost time, at a single step
    counted: float = 0.3  # of an interval, by which stamps that count rows differ from even ones
    many: float = 0.2  # of the increments: steps as frequent are noise or a slower channel
    on_grid: float = 0.12  # of an interval (median) within which losses are whole intervals
    smallest: float = 1e-3  # of the increments that make a count of the encoder or less ...
    most: int = 5_000  # ... of so many of them
    recurs: float = 0.5  # of the distances between losses that are one and the same ...
    least_losses: int = 4  # ... and losses that tell it


LOSSES = LossCriteria()
NONE = Losses(np.zeros(0, np.intp), np.zeros(0))


@dataclass(frozen=True)
class Mended:
    """A stream put right; `bridged` (M,) says which of its samples were not measured.

    `losses` are those of the stream as it came, with its `stamps`.
    """

    stream: Stream
    bridged: Mask
    losses: Losses
    stamps: Stamps

    @property
    def warnings(self) -> tuple[str, ...]:
        """What there is to say; nothing where nothing was mended."""
        if not len(self.losses):
            return ()
        seconds = self.losses.seconds
        return (
            f"samples are lost at {len(seconds)} places, {1e3 * np.median(seconds):.3g} ms "
            f"each (median), {seconds.sum():.3g} s in all: all joints step there by the motion "
            "of that time and the stamps go on as if nothing was missing. The time base is "
            "repaired and the holes are bridged; log with the controller's own clock",
        )


@dataclass(frozen=True)
class _Motion:
    """Positions with SIDE samples more at both ends, at intervals of `dt` s, and their `noise`.

    `dq` (M, n) rad/s are logged velocities, where they tell the increments as well as these tell
    each other.
    """

    beyond: Array
    dt: float
    noise: Array
    dq: Array | None

    @classmethod
    def of(cls, joints: Stream, dt: float, criteria: LossCriteria) -> "_Motion":
        """Take the positions (M, n) rad of a stream, and its velocities if they are good."""
        q, dq = joints.channels["position"], joints.channels.get("velocity")
        beyond = np.pad(q, ((SIDE, SIDE), (0, 0)), mode="reflect", reflect_type="odd")
        motion = cls(beyond, dt, _noise(q, criteria), dq)
        if dq is None or not np.isfinite(dq).all():
            return replace(motion, dq=None)
        d = np.diff(q, axis=0)
        moves = np.where(np.abs(d) > np.median(np.abs(d), axis=0), 1.0, np.nan)
        off = np.nanmedian(np.abs(d - 0.5 * (dq[1:] + dq[:-1]) * dt) * moves, axis=0)
        own = np.nanmedian(np.abs(d[1:-1] - 0.5 * (d[:-2] + d[2:])) * moves[1:-1], axis=0)
        return motion if (off <= own + motion.noise).all() else replace(motion, dq=None)


@dataclass(frozen=True)
class _Steps:
    """What the motion on either side says of increments `rows` (K,); the rest is (K, n).

    `gap` [rad] is what a joint steps by, `velocity` [rad/s] that on average, `shared` [rad/s] the
    part that both sides have, `noise` [rad] that of the gap.
    """

    rows: Rows
    gap: Array
    velocity: Array
    shared: Array
    noise: Array

    @classmethod
    def at(cls, rows: Rows, motion: "_Motion") -> "_Steps":
        """Fit parabolas on both sides of some rows."""
        q, dq, after = motion.beyond, motion.dq, np.arange(SIDE)
        sides = [
            q[SIDE + rows[:, None] + way] - q[SIDE + rows, None] for way in (-after, 1 + after)
        ]
        (a, u, _), (b, w, _) = (np.moveaxis(FIT @ side, 1, 0) for side in sides)
        left = [side - BASIS @ (FIT @ side) for side in sides]
        own = np.sqrt(np.sum(np.square(left), axis=(0, 2)) / (2 * SIDE - 6))
        u, w = -u / motion.dt, w / motion.dt
        gain = float(np.sqrt(2.0) * np.linalg.norm(FIT[0]))
        middle = 0.5 * (u + w)
        if dq is not None:  # medians keep single wrong values out
            near = np.clip(rows[:, None] + np.arange(-2, 4), 0, len(dq) - 1)
            middle = 0.5 * sum(np.median(dq[side], axis=1) for side in np.split(near, 2, axis=1))
        speeds = np.stack([u, w, middle]) * np.sign(middle)
        shared = np.maximum(speeds.min(axis=0), 0.0)
        return cls(rows, b - a, middle, shared, gain * np.maximum(own, motion.noise))

    def alike(self, lost: Array, dt: float, criteria: LossCriteria) -> Mask:
        """Whether all joints step by the motion of the time that is lost, (K,) s."""
        motion = self.velocity * lost[:, None]
        noise = self.noise * np.hypot(1.0, SLOPE * lost / dt)[:, None]
        off = np.abs(self.gap - motion)
        alike = off < criteria.sure * noise + criteria.uneven * np.abs(motion)
        return np.asarray(alike.all(axis=1))


def mended(joints: Stream, criteria: LossCriteria = LOSSES) -> Mended:
    """Put right what the motion of the joints says of a stream.

    `joints`: in the order of time, with `position` (M, n). Returns: with the stream itself where
    nothing is wrong.
    """
    stamps, q = joints.stamp_ns, joints.channels["position"]
    as_it_is = Mended(joints, np.zeros(len(joints), np.bool_), NONE, stamps)
    if len(stamps) < 4 * SIDE or not np.isfinite(q).all():
        return as_it_is
    rows = _sudden(np.diff(q, axis=0), criteria)
    if not len(rows) or len(rows) > criteria.many * len(stamps):
        return as_it_is
    losses = _losses(joints, rows, criteria)
    if not len(losses):
        return as_it_is
    stream, bridged = with_losses(joints, losses)
    return Mended(stream, bridged, losses, stamps)


def _sudden(d: Array, criteria: LossCriteria) -> Rows:
    """Increments (of (M, n)) that differ from those on both sides by more than these are large."""
    size = np.abs(d)
    apart = np.abs(d[1:-1] - 0.5 * (d[:-2] + d[2:]))
    # One side alone is small where the position was held before it catches up.
    found = (apart > criteria.sudden * np.minimum(size[:-2], size[2:])) & (
        size[1:-1] > np.maximum(size[:-2], size[2:])
    )
    rows: Rows = np.flatnonzero(found.any(axis=1)) + 1
    return rows


def _noise(q: Array, criteria: LossCriteria) -> Array:
    """Noise (n,) rad of positions (M, n): by their roughness, and at least that of their counts."""
    some = np.arange(0, len(q) - DIFFERENCES, max(1, len(q) // criteria.most))
    windows = q[some[:, None] + np.arange(DIFFERENCES + 1)]
    noise = gaussian_spread(rough(np.moveaxis(windows, 1, 0))[0])
    size = np.abs(windows[:, 1] - windows[:, 0])
    counts = [np.quantile(own[own > 0], criteria.smallest) if own.any() else 0.0 for own in size.T]
    return np.asarray(np.maximum(noise, np.array(counts) / np.sqrt(12.0)) + 1e-15)


def _losses(joints: Stream, rows: Rows, criteria: LossCriteria) -> Losses:
    """Losses that increments `rows` show, and those that recur at slow motion."""
    dt = np.diff(joints.stamp_ns) * 1e-9
    usual = float(np.median(dt))
    rows = rows[(rows >= 2) & (rows < len(dt) - 2)]
    # Stamps around a step are as even as those of a logger that counts its rows.
    near = dt[rows[:, None] + np.arange(-2, 3)]
    rows = rows[(np.abs(near - usual) < criteria.counted * usual).all(axis=1)]
    motion = _Motion.of(joints, usual, criteria)
    steps = _Steps.at(rows, motion)
    weight = steps.noise**-2.0
    power = np.maximum(np.sum(steps.velocity**2 * weight, axis=1), 1e-300)
    lost = np.sum(steps.velocity * steps.gap * weight, axis=1) / power
    sure = lost * np.sqrt(np.sum(steps.shared**2 * weight, axis=1)) > criteria.sure
    sure &= (lost > criteria.least_intervals * usual) & (lost < criteria.longest_s)
    sure &= steps.alike(lost, usual, criteria)
    seconds = lost[sure]
    whole = np.maximum(1.0, np.rint(seconds / usual))
    if len(seconds) and np.median(np.abs(seconds / usual - whole)) < criteria.on_grid:
        seconds = whole * usual
    known = Losses(rows[sure], seconds)
    return _recurring(motion, known, criteria)


def _recurring(motion: _Motion, known: Losses, criteria: LossCriteria) -> Losses:
    """Losses with those at slow motion, where those at faster motion say that there must be one.

    Returns: those that are `known` alone where losses do not recur at one distance.
    """
    distances = np.diff(known.rows)
    if len(known) < criteria.least_losses:
        return known
    period = int(np.bincount(distances).argmax())
    if np.mean(distances == period) < criteria.recurs:
        return known
    steps = _Steps.at(_places(known.rows, period, len(motion.beyond) - 2 * SIDE), motion)
    seconds = float(np.median(known.seconds))
    every = np.full(len(steps.rows), seconds)
    apart = steps.gap - steps.velocity * seconds
    without, left = (np.sum((x / steps.noise) ** 2, axis=1) for x in (steps.gap, apart))
    likely = (
        (left < without) & (without > criteria.sure**2) & steps.alike(every, motion.dt, criteria)
    )
    # Of neighbours the one is meant that stands out by more.
    certain = np.zeros(len(motion.beyond))
    certain[steps.rows], certain[known.rows] = np.where(likely, without, 0.0), np.inf
    beside = np.maximum(certain[steps.rows - 1], certain[steps.rows + 1])
    likely &= without > beside
    rows = np.concatenate([known.rows, steps.rows[likely]])
    order = np.argsort(rows, kind="stable")
    return Losses(rows[order], np.concatenate([known.seconds, every[likely]])[order])


def _places(rows: Rows, period: int, count: int) -> Rows:
    """Rows at multiples of the period from a loss, or one beside, but for the losses."""
    inner = [np.arange(a + period, b - 1, period) for a, b in pairwise(rows)]
    ends = [np.arange(rows[0] - period, 0, -period), np.arange(rows[-1] + period, count, period)]
    places = np.concatenate([*inner, *ends])
    near = np.unique(np.concatenate([places - 1, places, places + 1]))
    return np.setdiff1d(near[(near >= 2) & (near < count - 3)], rows)
