"""The motion of a long log, block by block: the same values as `estimate_motion` and `decimated`.

Blocks lie on a fixed grid of sample numbers, whatever parts the samples come in. Each
is worked on with so many samples more on either side that the zero-phase filters have
forgotten (to 1e-13 of the signal) what lies beyond; gaps and the ends of the log are
runs' ends like in the whole log.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from seqid_cli.logs.long import Block, LongLog, open_long
from seqid_cli.logs.raw import TimeSource
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import SIDE
from seqid_cli.motion.filters.survey import Survey
from seqid_cli.motion.motion import Motion, filtered_motion, thinned
from seqid_cli.motion.segmentation import motion_reach, moving_mask
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True)
class Plan:
    """How a log is filtered."""

    rate_hz: float
    cutoff: Cutoff
    step: Array  # (n,) rad, noise steps
    factor: int  # every which sample stays
    rows: int  # samples of a block, a multiple of `factor`
    margin: int  # more that are needed on either side

    @property
    def lowpass(self) -> Lowpass:
        """The filter at the log's own rate."""
        return Lowpass(self.cutoff.hz, self.rate_hz)


LEAST_BLOCK = 32_768  # samples; thinned ones need less memory and are twice as long


def make_plan(
    rate_hz: float, cutoff: Cutoff, step: Array, *, samples_per_cutoff: float
) -> Plan:
    """Plan the blocks for noise steps (n,) rad; `samples_per_cutoff` stay, infinite keeps all."""
    lowpass = Lowpass(cutoff.hz, rate_hz)
    factor = (
        max(1, int(rate_hz / (samples_per_cutoff * cutoff.hz))) if lowpass.active else 1
    )
    margin = max(2 * lowpass.memory + SIDE, 2 * lowpass.settling, motion_reach(rate_hz))
    margin = -(-(margin + factor) // factor) * factor if factor > 1 else margin
    least = LEAST_BLOCK if factor == 1 else 2 * LEAST_BLOCK
    rows = -(-max(least, 2 * margin) // factor) * factor
    return Plan(rate_hz, cutoff, step, factor, rows, margin)


def motion_blocks(blocks: Iterable[Block], plan: Plan) -> Iterator[Motion]:
    """Filter, differentiate and decimate a log's samples; `t` counts from its first."""
    for window, start, stop in overlapping(blocks, plan.rows, plan.margin):
        t = (window.start + np.arange(window.samples)) / plan.rate_hz
        # asked at the kept samples alone
        later = np.broadcast_to(np.False_, window.q.shape)
        motion = filtered_motion(
            t, window.q, window.valid, plan.rate_hz, plan.cutoff, later
        )
        lowpass, valid = motion.lowpass, window.valid
        motion = replace(motion, tau=lowpass(lowpass(window.tau, valid), valid))
        moving = moving_mask(
            window.q, plan.rate_hz, plan.step, np.arange(start, stop, plan.factor)
        )
        yield replace(thinned(motion, plan.factor, start, stop), moving=moving)


S = TypeVar("S", Block, Motion)


def joined(parts: list[S]) -> S:
    """Put consecutive parts together; motion must have torque."""
    first = parts[0]
    names = first.PER_SAMPLE if len(parts) > 1 else ()
    whole: dict[str, Any] = {
        n: np.concatenate([getattr(x, n) for x in parts]) for n in names
    }
    return replace(first, **whole)


def overlapping(
    parts: Iterable[S], rows: int, margin: int
) -> Iterator[tuple[S, int, int]]:
    """Cut samples into blocks of `rows` with `margin` more; yields [start, stop) within."""
    held: list[S] = []
    before = have = 0  # samples held in front of the next block, and in all
    for part in parts:
        held.append(part)
        have += part.samples
        while have >= before + rows + margin:
            whole = joined(held)
            yield whole.part(slice(0, before + rows + margin)), before, before + rows
            drop = max(0, before + rows - margin)
            before, have = before + rows - drop, have - drop
            held = [whole.part(slice(drop, drop + have))]
    while have > before:
        whole = joined(held)
        stop = min(before + rows, have)
        yield whole.part(slice(0, min(stop + margin, have))), before, stop
        held, before = [whole], stop


@dataclass(frozen=True)
class SurveyedLog(LongLog):
    """A long log with what there is to know of its positions."""

    survey: Survey | None = None


def open_surveyed(
    path: Path, robot: Robot, *, time_source: TimeSource = "header"
) -> SurveyedLog | None:
    """Open a log to be passed over, as `open_long` does, and survey it, in one pass if it can."""
    found: list[Survey] = []

    def watch(rate_hz: float, q: Array) -> None:
        if not found:
            found.append(Survey(robot.n, rate_hz))
        found[0].push(q)

    log = open_long(path, robot, time_source=time_source, watch=watch)
    if log is None:
        return None
    survey = found[0]
    if not (log.exact and survey.at_rate(log.rate_hz, log.samples)):
        survey = Survey(robot.n, log.rate_hz, log.samples)
        for block in log.blocks():
            survey.push(block.q)
    known = {field.name: getattr(log, field.name) for field in fields(LongLog)}
    return SurveyedLog(**known, survey=survey)
