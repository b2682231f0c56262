"""Which joints move when, and where one joint runs at constant velocity, by positions.

A coarse encoder shows a slow joint as rare single counts, so motion is looked for on
several time scales: a joint moves where its position changes by more than two counts
within the window of a scale. A stretch of constant velocity is one where the windowed
velocity neither drifts nor steps by more than the encoder's uncertainty and a few
percent; ramps at its ends fall away by the window.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import Polynomial

from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.differentiation import runs, shrink
from seqid_cli.robust import white_noise
from seqid_cli.running import running_max, running_mean, running_min
from seqid_cli.typing import Array, Index, Mask

SCALES_S = (0.1, 0.3, 1.0)
TRAVEL_STEPS = 2.5  # noise steps of travel, beyond which a joint moves
SMALLEST_STEP = 1e-4  # rad; below this a position change is not motion
# Of the fastest joint's travel, below which a locked joint is only shaken by it.
SHAKEN = 0.01


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """One joint at constant velocity, all others standing still.

    Attributes
    ----------
    joint : int
    start, stop : int
        Its samples, [start, stop).
    move_start, move_stop : int
        Samples of the move in one direction that it is part of.
    velocity : float
        rad/s, signed.
    configuration : tuple of float
        Mean position of every joint [rad].
    """

    joint: int
    start: int
    stop: int
    move_start: int
    move_stop: int
    velocity: float
    configuration: tuple[float, ...]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.stop - self.start


def noise_step(
    q: Array, resolution: Array | None = None, *, encoder: Array | None = None
) -> Array:
    """Return the position changes that count as more than encoder noise.

    Parameters
    ----------
    q : Array
        Positions (N, n) rad.
    resolution : Array, optional
        (n,) rad, smallest steps of the encoders; zero where not known.
    encoder : Array, optional
        (n,) rad, `encoder_step` of the positions where it is known already.

    Returns
    -------
    Array
        (n,) rad.
    """
    if encoder is None:
        encoder = encoder_step(q)
    step = np.maximum(encoder, 0.0 if resolution is None else resolution)
    noise = np.where(step > 0, step, 3 * white_noise(q))
    return np.asarray(np.maximum(noise, SMALLEST_STEP))


def motion_reach(rate_hz: float) -> int:
    """Return the samples on either side that `moving_mask` looks at."""
    # Half the longest time scale, and its dilation.
    return int(np.ceil(0.7 * max(SCALES_S) * rate_hz)) + 2


def moving_mask(q: Array, rate_hz: float, step: Array, at: Index | None = None) -> Mask:
    """Find which joints move when, on any time scale.

    Parameters
    ----------
    q : Array
        Positions (N, n) rad.
    rate_hz : float
    step : Array
        (n,) rad, noise steps of the encoders.
    at : Index, optional
        Samples (K,) that are asked for; all by default.

    Returns
    -------
    Mask
        (K, n).
    """
    samples = np.arange(len(q)) if at is None else at
    rows = q.T
    moving = np.zeros((len(rows), len(samples)), dtype=np.bool_)
    for scale_s in SCALES_S:
        half = max(1, round(scale_s * rate_hz / 2))
        if 2 * half >= len(q):
            continue
        travel = np.abs(rows[:, 2 * half :] - rows[:, : -2 * half])
        least = np.maximum(TRAVEL_STEPS * step[:, None], SHAKEN * travel.max(axis=0))

        # A change within the window moves its middle and a third of a half to either
        # side; a running count says whether there is one.
        n_windows = travel.shape[1]
        count = np.zeros((len(rows), n_windows + 1), dtype=np.int32)
        np.cumsum(travel > least, axis=1, out=count[:, 1:])
        first = np.clip(samples - half - half // 3, 0, n_windows)
        last = np.clip(samples - half + half // 3 + 1, 0, n_windows)
        moving |= count[:, last] > count[:, first]
    return np.ascontiguousarray(moving.T)


def windowed_velocity(q: Array, rate_hz: float, half: int) -> Array:
    """Compute the velocity (N,) rad/s of one joint from means over windows.

    It is the difference of two means, each over 2 `half` + 1 samples, over their
    distance; zero near the ends.

    Parameters
    ----------
    q : Array
        Positions (N,) rad of the joint.
    rate_hz : float
    half : int
        Samples between a sample and the middle of either mean.
    """
    means = running_mean(q, 2 * half + 1, beyond="edge")
    change = means[2 * half :] - means[: -2 * half]
    velocity = np.zeros_like(q)
    velocity[half:-half] = change * rate_hz / (2 * half)
    return velocity


def constant_velocity(
    q: Array,
    rate_hz: float,
    *,
    step: Array,
    valid: Mask,
    moving: Mask | None = None,
) -> list[Stretch]:
    """Find all stretches in which exactly one joint moves, at constant velocity.

    Parameters
    ----------
    q : Array
        Positions (N, n) rad.
    rate_hz : float
    step : Array
        (n,) rad, noise steps of the encoders.
    valid : Mask
        (N,), false in gaps.
    moving : Mask, optional
        (N, n), `moving_mask` of all samples where it is known already.

    Returns
    -------
    list of Stretch
        In time order.
    """
    if moving is None:
        moving = moving_mask(q, rate_hz, step)
    alone = valid & (moving.sum(axis=1) == 1)
    stretches: list[Stretch] = []
    for j in range(q.shape[1]):
        for start, stop in runs(alone & moving[:, j], len(q)):
            stretches += _stretches(q, rate_hz, j, start, stop, step[j])
    return sorted(stretches, key=lambda stretch: stretch.start)


def _stretches(
    q: Array, rate_hz: float, joint: int, start: int, stop: int, step: float
) -> list[Stretch]:
    """Split a move of one joint at its reversals, keep what has constant velocity."""
    stretches: list[Stretch] = []
    for first, last in _directions(q[start:stop, joint], step):
        move_start = start + first
        move_stop = start + last
        move = q[move_start:move_stop]
        for begin, end in _plateaus(move[:, joint], rate_hz, step):
            part = move[begin:end]
            time = np.arange(len(part)) / rate_hz
            time -= time.mean()
            velocity = float(time @ part[:, joint] / (time @ time))
            if not velocity:
                continue
            stretches.append(
                Stretch(
                    joint=joint,
                    start=move_start + begin,
                    stop=move_start + end,
                    move_start=move_start,
                    move_stop=move_stop,
                    velocity=velocity,
                    configuration=tuple(part.mean(axis=0).tolist()),
                )
            )
    return stretches


def _directions(position: Array, step: float) -> list[tuple[int, int]]:
    """Return the index ranges between reversals of a joint's position (N,).

    A reversal is a turn back by more than three counts.
    """
    # Only where the position has changed by a count or more can it turn.
    counts = np.round(position / step).astype(np.int64)
    changes = np.flatnonzero(np.diff(counts)) + 1

    turns = [0]
    extreme = 0
    direction = 0
    for i in changes.tolist():
        change = position[i] - position[extreme]
        is_clear = abs(change) > 3 * step
        if direction == 0 and is_clear:
            direction = int(np.sign(change))
            extreme = i
        elif direction * change > 0:
            extreme = i
        elif direction != 0 and is_clear:
            turns.append(extreme)
            direction = -direction
            extreme = i
    turns.append(len(position))
    return [(start, stop) for start, stop in pairwise(turns) if stop - start > 8]


def _plateaus(
    position: Array, rate_hz: float, step: float, *, velocity_tolerance: float = 0.1
) -> list[tuple[int, int]]:
    """Return the ranges of a move in one direction that have constant velocity."""
    travel = abs(position[-1] - position[0])
    if travel < 8 * step:
        return []

    # Half a window that holds about sixty counts, between 20 ms and a twelfth of the
    # move.
    stride = max(1, len(position) // 50)
    usual_change = np.quantile(np.abs(np.diff(position[::stride])), 0.7)
    usual_speed = float(usual_change * (rate_hz / stride))
    wanted = 30 * step * rate_hz / max(usual_speed, 1e-9)
    half = int(np.clip(wanted, max(2, 0.02 * rate_hz), max(2, len(position) / 12)))
    if 6 * half >= len(position):
        return []

    velocity = windowed_velocity(position, rate_hz, half)[half:-half]
    drift = np.abs(velocity[2 * half :] - velocity[: -2 * half])
    middle = velocity[half:-half]
    # Two windowed velocities of a quantised position differ by up to two counts per
    # window.
    quantisation = 1.2 * step * rate_hz / (2 * half)
    steady = drift < velocity_tolerance * np.abs(middle) + quantisation

    # Counted from the position's first sample, windows at the ends left out.
    plateaus = []
    for first, last in runs(steady, len(steady)):
        start = first + 5 * half // 2
        stop = last + 2 * half - half // 2
        plateau = _trimmed(position, start, stop, rate_hz, step)
        if plateau:
            plateaus.append(plateau)
    return plateaus


def _trimmed(
    position: Array,
    start: int,
    stop: int,
    rate_hz: float,
    step: float,
    *,
    least_share: float = 0.5,
    shortest_s: float = 0.12,
) -> tuple[int, int] | None:
    """Cut a steady range back until its velocity is one and the same throughout.

    None where less than `least_share` of the move or `shortest_s` is left.
    """
    # Drift within a window can be too slow to see and still add up, as near the top of
    # a sine; what is left must then be a fair share of the move.
    least_travel = max(8 * step, least_share * abs(float(position[-1] - position[0])))
    while stop - start >= max(8, shortest_s * rate_hz):
        piece = position[start:stop]
        if abs(float(piece[-1] - piece[0])) < least_travel:
            break
        at_start, at_stop = _end_velocities(piece, step)
        if max(at_start, at_stop) <= 1.0:
            return start, stop

        cut = max(1, (stop - start) // 12)
        if at_start > at_stop:
            start = start + cut
        else:
            stop = stop - cut
    return None


def _end_velocities(
    piece: Array, step: float, *, slower: float = 0.1, steady: float = 0.15
) -> list[float]:
    """Return how far the velocities at both ends are off, over what is allowed.

    Velocities are those of a cubic fit. An end faster than the middle is a controller
    settling: it may be off by `steady`. A slower one is the top of a sine: it may be
    off by `slower`.
    """
    x = np.linspace(-1.0, 1.0, len(piece))
    velocity = Polynomial.fit(x, piece, 3, domain=[-1, 1], window=[-1, 1]).deriv()
    mean = float(piece[-1] - piece[0]) / 2
    # The slope of a cubic at its ends, from samples quantised to a step, is known to
    # about this.
    slack = 30 * step / np.sqrt(12 * len(piece)) / abs(mean)

    middle = float(velocity(0.0)) / mean
    excesses = []
    for end in (-1.0, 1.0):
        at_end = float(velocity(end)) / mean
        from_mean = abs(at_end - 1) / (steady + slack)
        below_middle = (middle - at_end) / (slower + slack)
        excesses.append(float(max(from_mean, below_middle)))
    return excesses


def unmoved(
    q: Array, resolution: Array | None, samples: int, *, max_swing_steps: float = 1.5
) -> Mask:
    """Find where no joint leaves its place by more than the encoder's noise.

    Unlike `moving_mask`, whose windows are as long as a slow joint needs to pass two
    counts, it shows short rests between moves; a joint that creeps within a count
    stands.

    Parameters
    ----------
    q : Array
        Positions (N, n) [rad; m where prismatic].
    resolution : Array, optional
        (n,), smallest steps of the encoders, where known.
    samples : int
        Length of the shortest rest.
    max_swing_steps : float
        Noise steps that a joint at rest may swing.

    Returns
    -------
    Mask
        (N,).
    """
    size = max(3, samples)
    swing = running_max(q, size) - running_min(q, size)
    rests = np.all(swing <= max_swing_steps * noise_step(q, resolution), axis=1)
    # A window that rests does so in all its length, not in its middle alone.
    return running_max(rests, size)


def standing(moving: Mask, rate_hz: float, margin_s: float = 0.05) -> Mask:
    """Return where (N, n) joints certainly stand still, a margin away from motion."""
    margin = round(margin_s * rate_hz)
    return np.stack([shrink(~column, margin) for column in moving.T], axis=1)
