"""The motion of a long log, block by block: as by `estimate_motion` and `decimated`.

Blocks lie on a fixed grid of sample numbers, whatever parts the samples come in. Each
is worked on with so many samples more on either side that the zero-phase filters have
forgotten (to 1e-13 of the signal) what lies beyond; gaps and the ends of the log are
runs' ends like in the whole log.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from seqid_cli.logs.recording import Block
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import SIDE
from seqid_cli.motion.motion import Motion, filtered_motion, thinned
from seqid_cli.motion.segmentation import motion_reach, moving_mask
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How a log is filtered.

    Attributes
    ----------
    rate_hz : float
        Of the log.
    cutoff : Cutoff
    step : Array
        (n,) rad, noise steps of the encoders.
    factor : int
        Every `factor`-th sample stays.
    rows : int
        Samples of a block, a multiple of `factor`.
    margin : int
        Samples more that are needed on either side of a block.
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


LEAST_BLOCK = 32_768  # samples; thinned ones need less memory and are twice as long


def make_plan(
    rate_hz: float, cutoff: Cutoff, step: Array, *, samples_per_cutoff: float
) -> Plan:
    """Plan the blocks of a log.

    Parameters
    ----------
    rate_hz : float
    cutoff : Cutoff
    step : Array
        (n,) rad, noise steps of the encoders.
    samples_per_cutoff : float
        Samples per period of the cut-off that stay; infinite keeps all.
    """
    lowpass = Lowpass(cutoff.hz, rate_hz)
    factor = 1
    if lowpass.active:
        factor = max(1, int(rate_hz / (samples_per_cutoff * cutoff.hz)))

    # All that a sample depends on: two passes and derivatives, or the looks at motion.
    memory = 2 * lowpass.memory + SIDE
    margin = max(memory, 2 * lowpass.settling, motion_reach(rate_hz))
    if factor > 1:
        margin = _rounded_up(margin + factor, factor)
    least_rows = LEAST_BLOCK if factor == 1 else 2 * LEAST_BLOCK
    return Plan(
        rate_hz=rate_hz,
        cutoff=cutoff,
        step=step,
        factor=factor,
        rows=_rounded_up(max(least_rows, 2 * margin), factor),
        margin=margin,
    )


def _rounded_up(value: int, factor: int) -> int:
    """Return the smallest multiple of a factor that is no smaller than a value."""
    return -(-value // factor) * factor


def motion_blocks(blocks: Iterable[Block], plan: Plan) -> Iterator[Motion]:
    """Filter, differentiate and decimate a log's samples; `t` counts from its first."""
    for window, start, stop in overlapping(blocks, plan.rows, plan.margin):
        t = (window.start + np.arange(window.samples)) / plan.rate_hz
        # Which joints move is asked at the kept samples alone, below.
        not_asked = np.broadcast_to(np.False_, window.q.shape)
        motion = filtered_motion(
            t, window.q, window.valid, plan.rate_hz, plan.cutoff, not_asked
        )
        once = motion.lowpass(window.tau, window.valid)
        motion = replace(motion, tau=motion.lowpass(once, window.valid))

        kept_samples = np.arange(start, stop, plan.factor)
        moving = moving_mask(window.q, plan.rate_hz, plan.step, kept_samples)
        motion = thinned(motion, plan.factor, start, stop)
        yield replace(motion, moving=moving)


S = TypeVar("S", Block, Motion)


def joined(parts: list[S]) -> S:
    """Put consecutive parts together; motion must have torque."""
    first = parts[0]
    if len(parts) == 1:
        return replace(first)
    arrays: dict[str, Any] = {}
    for name in first.PER_SAMPLE:
        arrays[name] = np.concatenate([getattr(part, name) for part in parts])
    return replace(first, **arrays)


def overlapping(
    parts: Iterable[S], rows: int, margin: int
) -> Iterator[tuple[S, int, int]]:
    """Cut samples into blocks that overlap.

    Parameters
    ----------
    parts : iterable of Block or Motion
        Consecutive samples, in parts of any length.
    rows : int
        Samples of a block.
    margin : int
        Samples more on either side, as far as there are any.

    Yields
    ------
    tuple of Block or Motion, int and int
        Samples, of which those from the first number up to the second are the block.
    """
    held: list[S] = []
    n_before = 0  # samples held in front of the next block
    n_held = 0
    for part in parts:
        held.append(part)
        n_held += part.samples
        while n_held >= n_before + rows + margin:
            samples = joined(held)
            stop = n_before + rows
            yield samples.part(slice(0, stop + margin)), n_before, stop

            dropped = max(0, stop - margin)
            n_before = stop - dropped
            n_held = n_held - dropped
            held = [samples.part(slice(dropped, dropped + n_held))]

    # The rest is shorter than a block and its margin.
    while n_held > n_before:
        samples = joined(held)
        stop = min(n_before + rows, n_held)
        yield samples.part(slice(0, min(stop + margin, n_held))), n_before, stop
        held = [samples]
        n_before = stop
