"""Tests of one channel by itself: stuck, clipped, held, quantised."""

from collections.abc import Iterator

import numpy as np

from seqid_cli.inspect.findings import found
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array
from seqid_cli.shares import percent


def equal_runs(values: Array, least: int) -> list[tuple[int, int]]:
    """List the stretches [start, stop) of at least `least` equal values of a channel (M,)."""
    same = np.diff(values) == 0
    return [(a, b + 1) for a, b in runs(same, len(same)) if b + 1 - a >= least]


def clipped(
    values: Array,
    *,
    min_samples: int = 10,
    min_share: float = 2e-3,
    min_pile: float = 3.0,
) -> tuple[float, float] | None:
    """Find a limit at which a channel (M,) is cut off, and its share of the samples; or None."""
    for limit in (float(values.max()), float(values.min())) if len(values) else ():
        count = int(np.count_nonzero(values == limit))
        # Zero is a brake, or a channel that is off, not a limit.
        if limit != 0.0 and count >= max(min_samples, min_share * len(values)):
            levels = np.rint(np.abs(values - limit) / (lattice(values) or np.inf))
            beside = max(int(np.count_nonzero(levels == k)) for k in (1, 2))
            if count > min_pile * beside:
                return limit, count / len(values)
    return None


def held(
    values: Array,
    *,
    min_equal: float = 0.7,
    min_regular: float = 0.95,
    min_changes: int = 20,
) -> int:
    """Return in groups of how many samples a channel (M,) repeats its values; 1 if it does not."""
    changes = np.flatnonzero(np.diff(values) != 0)
    if len(changes) < min_changes:
        return 1
    gaps = np.diff(changes)
    size = int(np.bincount(gaps).argmax())
    if size < 2 or np.mean(gaps % size == 0) < min_regular:
        return 1
    coarse = np.median(np.abs(np.diff(values)[changes])) < 1.5 * lattice(values)
    # A coarse channel at constant speed changes as evenly.
    return 1 if np.mean(gaps == size) < min_equal or coarse else size


def lattice(values: Array) -> float:
    """Return the step of a quantised channel (M,); 0 where it is not quantised."""
    scale = float(np.abs(values).max(initial=0.0))
    step = float(encoder_step((values / scale)[:, None])[0]) * scale if scale else 0.0
    if not step:
        return 0.0
    span = np.unique(values) - values.min()
    # Steps are counted over ever larger spans, so that all digits of the step come out.
    for reach in np.geomspace(20.0, max(span[-1] / step, 20.0), 18) * step:
        near = span[span <= reach]
        count = np.rint(near / step)
        if len(near) > 2 and count.any():  # all may lie within half a step
            step = float(count @ near / (count @ count))
    return step


def missing(
    values: Array, joint: str, channel: str, *, max_missing: float = 0.01
) -> Iterator[InspectionFinding]:
    """Find values of a channel (M,) that are missing at uneven distances, as of no slower one."""
    present = np.flatnonzero(np.isfinite(values))
    if len(present) < 2:
        return
    usual = int(np.bincount(np.diff(present)).argmax())
    share = 1.0 - (len(present) - 1) * usual / float(present[-1] - present[0])
    if share > max_missing:
        text = f"{percent(share)} of the values are missing"
        yield found("values_missing", text, joint, channel)
