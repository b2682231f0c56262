"""Lost samples that the stamps do not show: found by the motion of the joints, and put right.

A logger that counts its rows instead of reading a clock gives rows behind a loss stamps that are
too early: the position then steps by the motion of the lost time, while the velocity before and
behind the step is that of the motion. With the increments d_j of the positions over one interval
dt, and the velocities v_j there (of the velocity channel, or of the positions around it, whichever
fits the increments better), the time L that is lost at a step is the least-squares solution of

    d_j - v_j dt = v_j L,    for all joints j, each weighted by its noise.

It counts where it is certain, longer than one and a half intervals, and the same for all joints
that move: a step of one joint alone is damage of its position. Stamps behind a loss are moved by L
and the hole is filled (`bridging`). A position that is held and then catches up loses no time.

Losses that recur at one distance tell where the next one is: at such a place, or a row beside it, a
step at slow motion is one too if the motion of the usual lost time explains it better than no loss.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.checks.bridging import Losses, with_losses
from seqid_cli.logs.raw import Array, Mask, Rows, Stamps, Stream
from seqid_cli.robust import gaussian_spread


@dataclass(frozen=True)
class LossCriteria:
    """When a step of the positions is time that was lost; see the text of this module.

    A `sudden` step differs from the mean of the increments beside it by so many times the smaller
    of them, by `sudden_noise` times what increments usually differ by, and by `counts` smallest
    increments. Joints may differ in the motion of the lost time, for they accelerate.
    """

    sure: float = 8.0  # standard errors of the lost time, beyond which it is believed
    least_intervals: float = 1.5  # that are lost
    longest_s: float = 1.0  # lost at once: behind that, motion before says nothing
    sudden: float = 1.2
    sudden_noise: float = 5.0
    counts: float = 4.0
    uneven: float = 0.15  # of that motion, at a single step
    uneven_usual: float = 0.5  # of it, where the usual time tells the loss
    returned: float = 0.5  # of a step, that the increments around it may take back
    counted: float = 0.3  # of an interval, by which stamps that count rows differ from even ones
    many: float = 0.2  # of the increments: steps as frequent are noise or a slower channel
    on_grid: float = 0.12  # of an interval (median) within which losses are whole intervals
    beside: int = 3  # increments from a step to its way back, if it is a spike
    around: int = 6  # increments on either side that tell the velocity at a step
    held_least: int = 2  # increments of nothing before a joint catches up
    smallest: float = 1e-3  # of the increments that make a count of the encoder or less ...
    most: int = 20_000  # ... of so many of them
    recurs: float = 0.5  # of the distances between losses that are one and the same ...
    least_losses: int = 4  # ... and losses that tell it


LOSSES = LossCriteria()


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
    """Increments of positions q (M, n) and, if they were logged, velocities dq, at t (M,) s."""

    t: Array
    q: Array
    dq: Array | None
    criteria: LossCriteria

    @cached_property
    def dt(self) -> Array:
        """Intervals (M - 1,) s."""
        return np.diff(self.t)

    @cached_property
    def usual(self) -> float:
        """Usual interval, s."""
        return float(np.median(self.dt))

    @cached_property
    def d(self) -> Array:
        """Increments (M - 1, n) rad."""
        return np.diff(self.q, axis=0)

    @cached_property
    def count(self) -> Array:
        """Smallest increment (n,) rad."""
        return _count(np.abs(self.d), self.criteria)

    @cached_property
    def beside(self) -> Array:
        """Standard deviation (n,) of increments about those beside them."""
        return _spread(self.d[1:-1] - 0.5 * (self.d[:-2] + self.d[2:]), self.d[1:-1])

    @cached_property
    def logged(self) -> Array:
        """Standard deviation (n,) of increments about the logged velocities; infinite without."""
        if self.dq is None:
            return np.full(self.q.shape[1], np.inf)
        mean = 0.5 * (self.dq[1:] + self.dq[:-1])
        return _spread(self.d - mean * self.dt[:, None], self.d)

    @cached_property
    def noise(self) -> Array:
        """Noise (n,) of increments about the velocities, at least half a count."""
        return np.maximum(np.minimum(self.beside, self.logged), 0.5 * self.count + 1e-15)


def mended(joints: Stream, criteria: LossCriteria = LOSSES) -> Mended:
    """Put right what the motion of the joints says of a stream.

    `joints`: in the order of time, with `position` (M, n), and `velocity` (M, n) where it was
    logged. Returns: with the stream itself where nothing is wrong.
    """
    stamps, q = joints.stamp_ns, joints.channels["position"]
    nothing = Losses(np.zeros(0, np.intp), np.zeros(0))
    as_it_is = Mended(joints, np.zeros(len(joints), np.bool_), nothing, stamps)
    if len(stamps) < 4 * criteria.around or not np.isfinite(q).all():
        return as_it_is
    steps = _sudden(np.diff(q, axis=0), criteria)
    if len(steps) > criteria.many * len(stamps):
        return as_it_is
    dq = joints.channels.get("velocity")
    sound = dq is not None and np.isfinite(dq).all()
    t: Array = (stamps - stamps[0]).astype(np.float64) * 1e-9
    losses = _all_losses(_Motion(t, q, dq if sound else None, criteria), steps)
    if not len(losses):
        return as_it_is
    stream, bridged = with_losses(joints, losses)
    return Mended(stream, bridged, losses, stamps)


def _sudden(d: Array, criteria: LossCriteria) -> Rows:
    """Increments (of (M, n)) that differ from those on both sides by more than these are large."""
    size = np.abs(d)
    apart = np.abs(d[1:-1] - 0.5 * (d[:-2] + d[2:]))
    beside = np.maximum(size[:-2], size[2:])
    # One side alone is small where the position was held before it catches up.
    found = (apart > criteria.sudden * np.minimum(size[:-2], size[2:])) & (size[1:-1] > beside)
    if not found.any():
        return np.zeros(0, np.intp)
    # Usual size (n,) of what increments differ by.
    some = apart[:: max(1, len(apart) // criteria.most)]
    found &= apart > np.maximum(
        criteria.counts * _count(size, criteria), criteria.sudden_noise * gaussian_spread(some)
    )
    rows: Rows = np.flatnonzero(found.any(axis=1)) + 1
    return rows


def _count(size: Array, criteria: LossCriteria) -> Array:
    """Smallest increment (n,) that joints make, nearly: a count where positions are quantised."""
    counts = np.zeros(size.shape[1])
    for j, own in enumerate(size.T):
        made = own[:: max(1, len(own) // criteria.most)]
        made = made[made > 0]
        counts[j] = np.quantile(made, criteria.smallest) if len(made) else 0.0
    return counts


def _slopes(motion: _Motion, at: Rows, side: int) -> tuple[Array, Array]:
    """Velocity over some increments before (-1) or behind (1) those at `at`, and their scatter."""
    # Returns (K, n): median and standard deviation [rad/s].
    t, q = motion.t, motion.q
    offsets = side * np.arange(1, motion.criteria.around + 1)
    rows = np.clip(at[:, None] + offsets, 0, len(t) - 2)
    dt = np.maximum(t[rows + 1] - t[rows], 1e-12)
    slopes = (q[rows + 1] - q[rows]) / dt[:, :, None]
    middle = np.median(slopes, axis=1)
    return middle, gaussian_spread(np.moveaxis(slopes - middle[:, None], 1, 0))


def _all_losses(motion: _Motion, steps: Rows) -> Losses:
    """Losses that increments show, and those that recur at slow motion."""
    losses, criteria = _losses(motion, steps), motion.criteria
    if motion.dq is None or len(losses) < criteria.least_losses:
        return losses
    v = 0.5 * (motion.dq[1:] + motion.dq[:-1])
    return _joined(losses, _recurring(motion.t, motion.q, v, motion.noise, losses, criteria))


def _losses(motion: _Motion, steps: Rows) -> Losses:
    """Time that is lost, by all joints together."""
    criteria, dt, d, usual = motion.criteria, motion.dt, motion.d, motion.usual
    steps = steps[(steps >= 2) & (steps < len(motion.t) - 3)]
    if not len(steps):
        return Losses(np.zeros(0, np.intp), np.zeros(0))
    (before, one), (behind, other) = (_slopes(motion, steps, side) for side in (-1, 1))
    v = 0.5 * (before + behind)
    if motion.dq is not None:
        v = np.where(motion.logged <= motion.beside, _logged(motion.dq, steps), v)
    noise = np.maximum(motion.noise, np.maximum(one, other) * usual)
    r = d[steps] - v * dt[steps, None]
    # Between two velocities the motion of the lost time is not certain.
    weight = 1.0 / (noise**2 + (criteria.uneven * (behind - before) * dt[steps, None]) ** 2)
    power = np.maximum(np.sum(v**2 * weight, axis=1), 1e-300)
    lost = np.sum(v * r * weight, axis=1) / power
    sure = (lost > criteria.sure / np.sqrt(power)) & _counted(motion, steps)
    sure &= _goes_on(motion, v * usual, steps)
    sure &= (lost > np.maximum(criteria.least_intervals * usual, 0.5 * dt[steps])) & (
        lost < criteria.longest_s
    )
    off = np.abs(r - v * lost[:, None])
    alike = (
        off
        < criteria.sure * noise + 0.5 * np.abs(v) * lost[:, None] + np.abs(behind - before) * usual
    )
    sure &= alike.all(axis=1) & (_net(motion, v, weight, steps, lost) > criteria.returned * lost)
    seconds = lost[sure]
    whole = np.maximum(1.0, np.rint(seconds / usual))
    if len(seconds) and np.median(np.abs(seconds / usual - whole)) < criteria.on_grid:
        seconds = whole * usual
    return Losses(steps[sure], seconds)


def _counted(motion: _Motion, steps: Rows) -> NDArray[np.bool_]:
    """Whether stamps around a step (K,) are as even as those of a logger that counts its rows."""
    near, usual = motion.dt[steps[:, None] + np.arange(-2, 3)], motion.usual
    return np.asarray((np.abs(near - usual) < motion.criteria.counted * usual).all(axis=1))


def _goes_on(motion: _Motion, expected: Array, steps: Rows) -> NDArray[np.bool_]:
    """Whether the joint that moves by most counts does so beside a step (K,) too: not held."""
    q, around = motion.q, motion.criteria.around
    counts = around * np.abs(expected) / np.maximum(motion.count, 1e-15)
    most = np.argmax(counts, axis=1)
    before = q[steps, most] != q[np.maximum(steps - around, 0), most]
    behind = q[steps + 1, most] != q[np.minimum(steps + 1 + around, len(q) - 1), most]
    beside = (motion.d[steps - 1, most] != 0) & (motion.d[steps + 1, most] != 0)
    slow = counts.max(axis=1) < around * motion.criteria.held_least
    unknown = counts.max(axis=1) < motion.criteria.held_least
    return np.asarray(beside | (slow & before & behind) | unknown)


def _logged(dq: Array, at: Rows) -> Array:
    """Velocity (K, n) of the channel at increments; a median keeps single wrong values out."""
    rows = np.clip(at[:, None] + np.arange(-3, 1), 0, len(dq) - 1)
    ahead = np.clip(at[:, None] + np.arange(1, 5), 0, len(dq) - 1)
    return np.asarray(0.5 * (np.median(dq[rows], axis=1) + np.median(dq[ahead], axis=1)))


def _spread(apart: Array, d: Array) -> Array:
    """Standard deviation (n,) of what increments (K, n) are apart from where joints move."""
    spread = np.zeros(d.shape[1])
    for j, own in enumerate(np.abs(d).T):
        moves = own > np.median(own)
        spread[j] = gaussian_spread(apart[moves, j]) if moves.any() else 0.0
    return spread


def _net(motion: _Motion, v: Array, weight: Array, steps: Rows, lost: Array) -> Array:
    """Time (K,) that the increments around a step gain, with the step itself."""
    # What is late and catches up has lost none, nor has a spike, whose way back is beside it.
    d, dt, usual, criteria = motion.d, motion.dt, motion.usual, motion.criteria
    net = np.zeros(len(steps))
    for k, i in enumerate(steps):
        reach = int(min(lost[k] / usual, criteria.longest_s / usual)) + 3 if lost[k] > 0 else 0
        near = np.array([x for x in range(i - reach, i + 4) if 0 <= x < len(d)], dtype=np.intp)
        others = steps[(steps != i) & (np.abs(steps - i) <= reach) & (lost > 0)]
        near = near[~np.isin(near, others)]
        gained = d[near] - v[k] * dt[near, None]
        # The velocity changes within the reach: only what is late by most of an interval counts.
        late = np.sum(v[k] * gained * weight[k], axis=1) / max(
            float(np.sum(v[k] ** 2 * weight[k])), 1e-300
        )
        late = np.where((np.abs(late) > 0.6 * usual) | (near == i), late, 0.0)
        net[k] = min(late.sum(), late[np.abs(near - i) <= criteria.beside].sum())
    return net


def _joined(first: Losses, second: Losses) -> Losses:
    """Losses of both, in their order."""
    rows = np.concatenate([first.rows, second.rows])
    order = np.argsort(rows, kind="stable")
    return Losses(rows[order], np.concatenate([first.seconds, second.seconds])[order])


def _recurring(
    t: Array, q: Array, v: Array, noise: Array, known: Losses, criteria: LossCriteria
) -> Losses:
    """Losses at slow motion, where those at faster motion say that there must be one.

    `t` (M,): as stamped [s]. `q` (M, n). `v` (M - 1, n): velocity before and behind each increment,
    on average. `noise` (n,): of increments. `known`: at least `criteria.least_losses`. Returns:
    others, each of the usual time; none where losses do not recur at one distance.
    """
    nothing = Losses(np.zeros(0, np.intp), np.zeros(0))
    distances = np.diff(known.rows)
    period = int(np.bincount(distances).argmax())
    if np.mean(distances == period) < criteria.recurs:
        return nothing
    usual = float(np.median(known.seconds))
    step = np.diff(q, axis=0) - v * np.diff(t)[:, None]
    motion = v * usual
    without, left = (np.sum((x / noise) ** 2, axis=1) for x in (step, step - motion))
    uneven = np.sum(
        ((step - motion) / (noise + criteria.uneven_usual * np.abs(motion))) ** 2, axis=1
    )
    likely = (left < without) & (without > criteria.sure**2) & (uneven < criteria.sure**2)
    rows = [row for row in _places(known.rows, period, len(v)) if likely[row]]
    return Losses(np.array(rows, dtype=np.intp), np.full(len(rows), usual))


def _places(rows: Rows, period: int, count: int) -> NDArray[np.intp]:
    """Rows at multiples of the period from a loss, or one beside, but for the losses."""
    inner = [np.arange(a + period, b - 1, period) for a, b in pairwise(rows)]
    ends = [np.arange(rows[0] - period, 0, -period), np.arange(rows[-1] + period, count, period)]
    places = np.concatenate([*inner, *ends])
    near = np.unique(np.concatenate([places - 1, places, places + 1]))
    return np.setdiff1d(near[(near >= 2) & (near < count - 2)], rows)
