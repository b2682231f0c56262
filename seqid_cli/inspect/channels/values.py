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
    min_pile: float = 3.0,  # times the next level
    min_levels: int = 20,
) -> tuple[float, float] | None:
    """Find a limit at which a channel (M,) is cut off, and its share of the samples; or None."""
    if len(np.unique(values[:: max(1, len(values) // 2000)])) < min_levels:
        return None
    for limit in (float(values.max()), float(values.min())):
        if limit == 0.0:
            continue  # a brake, or a channel that is off, not a limit
        count = int(np.count_nonzero(values == limit))
        if count < max(min_samples, min_share * len(values)):
            continue
        levels = np.abs(values - limit) / (lattice(values) or np.inf)
        inner = max(int(np.count_nonzero(np.abs(levels - k) < 0.5)) for k in (1, 2))
        if count > min_pile * inner:
            return limit, count / len(values)
    return None


def held(
    values: Array,
    *,
    min_equal: float = 0.7,
    min_regular: float = 0.95,
    max_longer: float = 0.1,
    min_changes: int = 20,
) -> int:
    """Return in groups of how many samples a channel (M,) repeats its values; 1 if it does not."""
    changes = np.flatnonzero(np.diff(values) != 0)
    if len(changes) < min_changes:
        return 1
    gaps = np.diff(changes)
    size = int(np.bincount(gaps).argmax())
    regular = float(np.mean(gaps % size == 0))
    if size < 2 or regular < min_regular:
        return 1
    if np.count_nonzero(gaps > size) > max(min_changes, max_longer * len(gaps)):
        return size  # changes far apart and still in step: no motion keeps such time
    if np.mean(gaps == size) < min_equal:
        return 1
    step = lattice(values)
    if step and np.median(np.abs(np.diff(values)[changes])) < 1.5 * step:
        return 1  # a coarse channel at constant speed changes as evenly
    return size


def lattice(values: Array) -> float:
    """Return the step of a quantised channel (M,); 0 where it is not quantised."""
    scale = float(np.abs(values).max(initial=0.0))
    if not scale:
        return 0.0
    step = float(encoder_step((values / scale)[:, None])[0]) * scale
    return _refined(values, step) if step else 0.0


def _refined(values: Array, step: float) -> float:
    """Count the steps over ever larger spans, so that all digits of the step come out."""
    levels = np.unique(values)
    span = levels - levels[0]
    for reach in np.geomspace(20.0, 1e7, 18) * step:
        near = span[span <= reach]
        count = np.rint(near / step)
        if len(near) > 2 and count.any():  # all may lie within half a step
            step = float(count @ near / (count @ count))
        if reach > span[-1]:
            break
    return step


def missing(
    values: Array, joint: str, channel: str, *, what: str = "values", max_missing: float = 0.01
) -> Iterator[InspectionFinding]:
    """Find values of a channel (M,) that are missing at uneven distances, as of no slower one."""
    present = np.flatnonzero(np.isfinite(values))
    if len(present) < 2:
        return
    distance = np.diff(present)
    usual = int(np.bincount(distance).argmax())
    share = 1.0 - (len(present) - 1) * usual / float(present[-1] - present[0])
    if share > max_missing:
        text = f"{percent(share)} of the {what} are missing"
        yield found("values_missing", text, joint=joint, channel=channel)
