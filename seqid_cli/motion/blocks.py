"""The motion of a long log, block by block: the same values as `estimate_motion` and `decimated`.

Blocks lie on a fixed grid of sample numbers, whatever parts the samples come in. Each is worked on
with so many samples more on either side that the zero-phase filters have forgotten (to 1e-13 of
the signal) what lies beyond; gaps and the ends of the log are runs' ends like in the whole log.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.long import Block
from seqid_cli.motion.cutoff import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import SIDE, differentiate, shrink
from seqid_cli.motion.motion import Motion, _all_valid
from seqid_cli.motion.segments import SCALES_S, SHAKEN, TRAVEL_STEPS, motion_reach

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_BLOCK = 32_768
COARSE = 8  # looks per half of a time scale that mostly tell whether a joint moves


@dataclass(frozen=True)
class Plan:
    """How a log is filtered: its rate, cut-off, noise steps (n,) rad, and every which sample stays.

    `rows` (a multiple of `factor`) samples make a block, `margin` more are needed on either side.
    """

    rate_hz: float
    cutoff: Cutoff
    step: Array
    factor: int
    rows: int
    margin: int

    @property
    def lowpass(self) -> Lowpass:
        """The filter at the log's own rate."""
        return Lowpass(self.cutoff.hz, self.rate_hz)

    @property
    def kept_lowpass(self) -> Lowpass:
        """The same filter for the samples that stay."""
        return Lowpass(self.cutoff.hz, self.kept_rate_hz, self.factor)

    @property
    def kept_rate_hz(self) -> float:
        """Samples per second that stay."""
        return self.rate_hz / self.factor


def make_plan(rate_hz: float, cutoff: Cutoff, step: Array, *, samples_per_cutoff: float) -> Plan:
    """Plan the blocks.

    Parameters
    ----------
    rate_hz : float
        Samples per second of the log.
    cutoff : Cutoff
    step : (n,) array
        Position changes [rad] that are more than noise.
    samples_per_cutoff : float
        Samples that stay per period of the cut-off, at least; infinite keeps all.
    """
    lowpass = Lowpass(cutoff.hz, rate_hz)
    factor = 1
    if lowpass.active:
        factor = max(1, int(rate_hz / (samples_per_cutoff * cutoff.hz)))
    margin = max(2 * lowpass.memory + SIDE, 2 * lowpass.settling, motion_reach(rate_hz))
    margin = -(-(margin + factor) // factor) * factor if factor > 1 else margin
    least = LEAST_BLOCK if factor == 1 else 2 * LEAST_BLOCK  # thinned ones need less memory
    rows = -(-max(least, 2 * margin) // factor) * factor
    return Plan(rate_hz, cutoff, step, factor, rows, margin)


def motion_blocks(blocks: Iterable[Block], plan: Plan) -> Iterator[Motion]:
    """Filter, differentiate and decimate.

    Parameters
    ----------
    blocks : iterable of Block
        The log's samples in order.
    plan : Plan

    Yields
    ------
    Motion
        Consecutive parts of the decimated motion; `t` counts from the first sample of the log.
    """
    for window, low, start, stop in windows(blocks, plan.rows, plan.margin):
        yield _motion(window, plan, low, start, stop)


def windows(
    blocks: Iterable[Block], rows: int, margin: int
) -> Iterator[tuple[Block, int, int, int]]:
    """Cut samples into blocks of `rows` with `margin` more on either side.

    Yields
    ------
    tuple of Block, int, int, int
        The samples, the number of the first of them, and the range [start, stop) of numbers that
        is the block itself.
    """
    held: list[Block] = []
    begin = end = start = 0
    for block in blocks:
        held.append(block)
        end += len(block.q)
        while end >= start + rows + margin:
            low = max(0, start - margin)
            joined = joined_blocks(held)
            yield (
                part_of_block(joined, low - begin, start + rows + margin - begin),
                low,
                start,
                start + rows,
            )
            start += rows
            keep = max(0, start - margin)
            held, begin = [part_of_block(joined, keep - begin, end - begin)], keep
    while start < end:
        low, stop = max(0, start - margin), min(start + rows, end)
        joined = joined_blocks(held)
        yield part_of_block(joined, low - begin, min(stop + margin, end) - begin), low, start, stop
        held, start = [joined], stop


def joined_blocks(held: list[Block]) -> Block:
    """Put consecutive blocks together."""
    if len(held) == 1:
        return held[0]
    return Block(
        held[0].start,
        np.concatenate([block.q for block in held]),
        np.concatenate([block.tau for block in held]),
        np.concatenate([block.valid for block in held]),
    )


def part_of_block(block: Block, low: int, high: int) -> Block:
    """Samples [low, high) of a block, counted from its first."""
    part = slice(low, high)
    return Block(block.start + low, block.q[part], block.tau[part], block.valid[part])


def _motion(window: Block, plan: Plan, low: int, start: int, stop: int) -> Motion:
    factor = plan.factor
    inner = slice(start - low, stop - low)
    q, dq, ddq, tau = _filtered(window, plan, inner)
    usable = shrink(window.valid, 2 * plan.lowpass.settling)
    return Motion(
        t=np.arange(start, stop, factor) / plan.rate_hz,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=tau,
        moving=_kept_moving(window.q, plan, inner),
        usable=usable[inner][::factor],
        valid=_all_valid(window.valid[inner], factor),
        rate_hz=plan.kept_rate_hz,
        lowpass=plan.kept_lowpass,
        cutoff=plan.cutoff,
    )


def _filtered(window: Block, plan: Plan, inner: slice) -> tuple[Array, Array, Array, Array]:
    """q, dq, ddq and tau (M, n) at every `factor`-th inner sample."""
    lowpass, factor, valid = plan.lowpass, plan.factor, window.valid
    inside = inner.start >= plan.margin and len(window.q) - inner.stop >= plan.margin
    if lowpass.can_decimate(factor) and inside and valid.all():
        kept = factor, inner.start, -(-(inner.stop - inner.start) // factor)
        q, dq, ddq = lowpass.decimated(window.q, *kept, derivatives=True)
        return q, dq, ddq, lowpass.decimated(window.tau, *kept, passes=2)[0]
    q = lowpass(window.q, valid)
    dq, ddq = differentiate(q, plan.rate_hz, valid)
    tau = lowpass(lowpass(window.tau, valid), valid)
    return q[inner][::factor], dq[inner][::factor], ddq[inner][::factor], tau[inner][::factor]


def _kept_moving(q: Array, plan: Plan, inner: slice) -> Mask:
    """Where joints (N, n) move, as `moving_mask` tells, at every `factor`-th inner sample."""
    rows = q.T
    kept = np.arange(inner.start, inner.stop, plan.factor)
    moving = np.zeros((len(rows), len(kept)), dtype=np.bool_)
    for scale in sorted(SCALES_S, reverse=True):  # the longest one mostly says it all
        half = max(1, round(scale * plan.rate_hz / 2))
        if 2 * half >= len(q):
            continue
        for every in (max(plan.factor, half // COARSE), 1):  # and some samples of it
            left = np.flatnonzero(~moving.all(axis=1))
            if len(left):
                moving[left] |= _seen_moving(rows, plan.step, kept, half, every)[left]
    return np.ascontiguousarray(moving.T)


def _seen_moving(rows: Array, step: Array, kept: NDArray[np.intp], half: int, every: int) -> Mask:
    """Where joints (n, K) move on one time scale, by the travel at every so many samples."""
    travel = rows[:, 2 * half :: every] - rows[:, : -2 * half : every]
    np.abs(travel, out=travel)
    least = np.maximum(TRAVEL_STEPS * step[:, None], SHAKEN * travel.max(axis=0))
    found = travel > least
    changes = np.zeros((len(rows), travel.shape[1] + 1), dtype=np.int32)
    np.cumsum(found, axis=1, out=changes[:, 1:])
    # A change within the window moves its middle and a third of a half to either side.
    low, high = (
        np.clip(-(-(kept - half + reach) // every), 0, travel.shape[1])
        for reach in (-(half // 3), half // 3 + 1)
    )
    return np.asarray(changes[:, high] > changes[:, low])


def joined_motions(parts: list[Motion]) -> Motion:
    """Put consecutive parts of one motion together."""
    if len(parts) == 1:
        return parts[0]

    return replace(
        parts[0],
        t=np.concatenate([part.t for part in parts]),
        q=np.concatenate([part.q for part in parts]),
        dq=np.concatenate([part.dq for part in parts]),
        ddq=np.concatenate([part.ddq for part in parts]),
        tau=np.concatenate([_torque(part) for part in parts]),
        moving=np.concatenate([part.moving for part in parts]),
        usable=np.concatenate([part.usable for part in parts]),
        valid=np.concatenate([part.valid for part in parts]),
    )


def _torque(motion: Motion) -> Array:
    assert motion.tau is not None
    return motion.tau


def part_of(motion: Motion, low: int, high: int) -> Motion:
    """Samples [low, high) of a motion."""
    part = slice(low, high)
    return replace(
        motion,
        t=motion.t[part],
        q=motion.q[part],
        dq=motion.dq[part],
        ddq=motion.ddq[part],
        tau=_torque(motion)[part],
        moving=motion.moving[part],
        usable=motion.usable[part],
        valid=motion.valid[part],
    )
