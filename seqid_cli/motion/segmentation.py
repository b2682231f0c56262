"""Which joints move when, and where one of them runs at constant velocity, from positions alone.

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
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.differentiation import runs, shrink
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Index, Mask

SCALES_S = (0.1, 0.3, 1.0)
TRAVEL_STEPS = 2.5  # noise steps of travel, beyond which a joint moves
SMALLEST_STEP = 1e-4  # rad; below this a position change is not motion
# of the fastest joint's travel, below which a locked joint is only shaken by it
SHAKEN = 0.01


@dataclass(frozen=True)
class Stretch:
    """One joint at constant velocity, all others standing still."""

    joint: int
    start: int
    stop: int
    # where the move in one direction that the stretch is part of begins
    move_start: int
    move_stop: int
    velocity: float  # rad/s, signed
    configuration: tuple[float, ...]  # mean position of every joint, rad

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.stop - self.start


def noise_step(q: Array, resolution: Array | None = None) -> Array:
    """Smallest position change of each joint (n,) rad that counts as more than encoder noise."""
    step = np.maximum(encoder_step(q), 0.0 if resolution is None else resolution)
    return np.asarray(
        np.maximum(np.where(step > 0, step, 3 * white_noise(q)), SMALLEST_STEP)
    )


def motion_reach(rate_hz: float) -> int:
    """Samples on either side that `moving_mask` looks at: half a time scale and its dilation."""
    return int(np.ceil(0.7 * max(SCALES_S) * rate_hz)) + 2


def moving_mask(q: Array, rate_hz: float, step: Array, at: Index | None = None) -> Mask:
    """Where (K, n) joints at positions q (N, n) rad move, on any scale; noise `step` (n,) rad."""
    # At the samples `at` (K,); all by default.
    at, rows = np.arange(len(q)) if at is None else at, q.T
    moving = np.zeros((len(rows), len(at)), dtype=np.bool_)
    halves = (max(1, round(scale * rate_hz / 2)) for scale in SCALES_S)
    for half in (half for half in halves if 2 * half < len(q)):
        travel = np.abs(rows[:, 2 * half :] - rows[:, : -2 * half])
        least = np.maximum(TRAVEL_STEPS * step[:, None], SHAKEN * travel.max(axis=0))
        changes = np.zeros((len(rows), travel.shape[1] + 1), dtype=np.int32)
        np.cumsum(travel > least, axis=1, out=changes[:, 1:])
        # A change within the window moves its middle and a third of a half to either
        # side.
        reach = -(half // 3), half // 3 + 1
        low, high = (np.clip(at - half + side, 0, travel.shape[1]) for side in reach)
        moving |= changes[:, high] > changes[:, low]
    return np.ascontiguousarray(moving.T)


def windowed_velocity(q: Array, rate_hz: float, half: int) -> Array:
    """Velocity (N,) rad/s of one joint: difference of two half-window means over their distance."""
    means = uniform_filter1d(q, 2 * half + 1, mode="nearest")
    velocity = np.zeros_like(q)
    velocity[half:-half] = (
        (means[2 * half :] - means[: -2 * half]) * rate_hz / (2 * half)
    )
    return velocity


def constant_velocity(
    q: Array, rate_hz: float, *, step: Array, valid: Mask
) -> list[Stretch]:
    """Every stretch in which exactly one joint moves, at constant velocity, in time order."""
    moving = moving_mask(q, rate_hz, step)
    alone = valid & (moving.sum(axis=1) == 1)
    found: list[Stretch] = []
    for j in range(q.shape[1]):
        for start, stop in runs(alone & moving[:, j], len(q)):
            found += _stretches(q, rate_hz, j, start, stop, step[j])
    return sorted(found, key=lambda stretch: stretch.start)


def _stretches(
    q: Array, rate_hz: float, joint: int, start: int, stop: int, step: float
) -> list[Stretch]:
    """Split one move of one joint at its reversals and keep what runs at constant velocity."""
    result: list[Stretch] = []
    for a, b in _directions(q[start:stop, joint], step):
        begin, end = start + a, start + b
        for c, d in _plateaus(q[begin:end, joint], rate_hz, step):
            part = q[begin + c : begin + d]
            time = np.arange(len(part)) / rate_hz
            time -= time.mean()
            slope = float(time @ part[:, joint] / (time @ time))
            where = tuple(part.mean(axis=0).tolist())
            if slope:
                result.append(
                    Stretch(joint, begin + c, begin + d, begin, end, slope, where)
                )
    return result


def _directions(position: Array, step: float) -> list[tuple[int, int]]:
    """Index ranges between reversals; a reversal is a turn back by more than three counts."""
    turns, extreme, direction = [0], 0, 0
    # Indices at which the position has changed by a count or more: all that a turn can
    # need.
    counts = np.round(position / step).astype(np.int64)
    for i in (np.flatnonzero(np.diff(counts)) + 1).tolist():
        change = position[i] - position[extreme]
        if direction == 0 and abs(change) > 3 * step:
            direction, extreme = int(np.sign(change)), i
        elif direction * change > 0:
            extreme = i
        elif direction != 0 and abs(change) > 3 * step:
            turns.append(extreme)
            direction, extreme = -direction, i
    turns.append(len(position))
    return [(a, b) for a, b in pairwise(turns) if b - a > 8]


def _plateaus(
    position: Array, rate_hz: float, step: float, *, velocity_tolerance: float = 0.1
) -> list[tuple[int, int]]:
    """Ranges of one-directional motion in which the velocity is constant."""
    travel = abs(position[-1] - position[0])
    if travel < 8 * step:
        return []
    # Half a window that holds about sixty counts, between 20 ms and a twelfth of the
    # move.
    speed = np.quantile(np.abs(np.diff(position[:: max(1, len(position) // 50)])), 0.7)
    speed *= rate_hz / max(1, len(position) // 50)
    wanted = 30 * step * rate_hz / max(float(speed), 1e-9)
    half = int(np.clip(wanted, max(2, 0.02 * rate_hz), max(2, len(position) / 12)))
    if 6 * half >= len(position):
        return []
    inner = windowed_velocity(position, rate_hz, half)[half:-half]
    drift = np.abs(inner[2 * half :] - inner[: -2 * half])
    middle = inner[half:-half]
    # Two windowed velocities of a quantised position differ by up to two counts per
    # window.
    steady = drift < velocity_tolerance * np.abs(middle) + 1.2 * step * rate_hz / (
        2 * half
    )
    found = []
    for a, b in runs(steady, len(steady)):
        whole = _trimmed(
            position, a + 5 * half // 2, b + 2 * half - half // 2, rate_hz, step
        )
        found += [whole] if whole else []
    return found


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
    """Cut a steady range back until its velocity is one and the same throughout."""
    # Drift within a window can be too slow to see and still add up, as near the top of
    # a sine; what is left must then be a fair share of the move.
    least = max(8 * step, least_share * abs(float(position[-1] - position[0])))
    while stop - start >= max(8, shortest_s * rate_hz):
        piece = position[start:stop]
        if abs(float(piece[-1] - piece[0])) < least:
            break
        first, last = _end_velocities(piece, step)
        if max(first, last) <= 1.0:
            return start, stop
        cut = max(1, (stop - start) // 12)
        start, stop = (start + cut, stop) if first > last else (start, stop - cut)
    return None


def _end_velocities(
    piece: Array, step: float, *, slower: float = 0.1, steady: float = 0.15
) -> list[float]:
    """How far the velocity at either end is from the mean, over what is allowed; a cubic fit."""
    x = np.linspace(-1.0, 1.0, len(piece))
    cubic = Polynomial.fit(x, piece, 3, domain=[-1, 1], window=[-1, 1]).deriv()
    mean = float(piece[-1] - piece[0]) / 2
    # The slope of a cubic at its ends, from samples quantised to a step, is known to
    # about this.
    slack = 30 * step / np.sqrt(12 * len(piece)) / abs(mean)
    first, middle, last = (float(cubic(at)) / mean for at in (-1.0, 0.0, 1.0))
    # An end faster than the middle is a controller settling, a slower one the top of a
    # sine.
    steady, slower = steady + slack, slower + slack
    return [
        float(max(abs(end - 1) / steady, (middle - end) / slower))
        for end in (first, last)
    ]


def unmoved(
    q: Array, resolution: Array | None, samples: int, *, max_swing_steps: float = 1.5
) -> Mask:
    """Where (N,) no joint leaves its place by more than the encoder's noise, for `samples`.

    Unlike `moving_mask`, whose windows are as long as a slow joint needs to pass two
    counts, it shows short rests between moves; a joint that creeps within a count
    stands. `q` (N, n): positions, rad (m). `resolution` (n,): smallest steps of the
    encoders, where known.
    """
    size = max(3, samples)
    swing = maximum_filter1d(q, size, axis=0) - minimum_filter1d(q, size, axis=0)
    middle = (swing <= max_swing_steps * noise_step(q, resolution)).all(axis=1)
    return np.asarray(maximum_filter1d(middle.astype(np.uint8), size) > 0)


def standing(moving: Mask, rate_hz: float, margin_s: float = 0.05) -> Mask:
    """Where each joint (N, n) certainly stands still: not moving, with a margin around motion."""
    return np.stack(
        [shrink(~column, round(margin_s * rate_hz)) for column in moving.T], axis=1
    )
