"""Tests of one channel by itself: stuck, clipped, held, quantised."""

from collections.abc import Iterator

import numpy as np

from seqid_cli.inspect.findings import finding_of
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array
from seqid_cli.shares import percent

# Of a channel's values, missing at uneven distances, from which on what is left is no
# record of it: three of four are then made up.
LOST_SHARE = 0.75


def equal_runs(values: Array, least: int) -> list[tuple[int, int]]:
    """Return stretches [start, stop) of `least` equal values of a channel, or more."""
    is_same = np.diff(values) == 0
    return [
        (start, stop + 1)
        for start, stop in runs(is_same, len(is_same))
        if stop + 1 - start >= least
    ]


def clipped(
    values: Array,
    *,
    min_samples: int = 10,
    min_share: float = 2e-3,
    min_pile: float = 3.0,
) -> tuple[float, float] | None:
    """Find a limit at which a channel is cut off.

    Parameters
    ----------
    values : (M,) array
        Values, all finite.
    min_samples, min_share : int, float
        Samples at the limit, and their share, which a limit has at least.
    min_pile : float
        Multiple of the samples at the levels beside it that are at the limit.

    Returns
    -------
    (limit, share) or None
        The limit in the channel's unit, and the share of samples at it.
    """
    if not len(values):
        return None
    for limit in (float(values.max()), float(values.min())):
        count = int(np.count_nonzero(values == limit))
        # Zero is a brake, or a channel that is off, not a limit.
        if limit == 0.0 or count < max(min_samples, min_share * len(values)):
            continue
        # A quantised channel has many samples at every level.
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
    """Return in groups of how many samples a channel repeats its values.

    Parameters
    ----------
    values : (M,) array
        Values, all finite.
    min_equal, min_regular : float
        Shares of the distances between changes that are the size of a group, and a
        multiple of it.
    min_changes : int
        Changes below which nothing is said.

    Returns
    -------
    int
        Samples of a group; 1 where the channel does not repeat its values.
    """
    changes = np.flatnonzero(np.diff(values) != 0)
    if len(changes) < min_changes:
        return 1
    distances = np.diff(changes)
    size = int(np.bincount(distances).argmax())
    if size < 2 or np.mean(distances % size == 0) < min_regular:
        return 1
    # A coarse channel at constant speed changes as evenly.
    change = np.abs(np.diff(values)[changes])
    is_coarse = np.median(change) < 1.5 * lattice(values)
    if np.mean(distances == size) < min_equal or is_coarse:
        return 1
    return size


def lattice(values: Array) -> float:
    """Return the step of a quantised channel (M,); 0 where it is not quantised."""
    scale = float(np.abs(values).max(initial=0.0))
    if not scale:
        return 0.0
    step = float(encoder_step((values / scale)[:, None])[0]) * scale
    if not step:
        return 0.0

    # Steps are counted over ever larger spans, so that all digits of the step come out.
    distance = np.unique(values) - values.min()
    spans = np.geomspace(20.0, max(distance[-1] / step, 20.0), 18)
    for reach in spans * step:
        near = distance[distance <= reach]
        count = np.rint(near / step)
        if len(near) > 2 and count.any():  # all may lie within half a step
            step = float(count @ near / (count @ count))
    return step


def missing(
    values: Array, stamps: Array, joint: str, channel: str, max_missing: float
) -> Iterator[InspectionFinding]:
    """Find values that are missing at uneven distances.

    Where `LOST_SHARE` of them are, that is an error: bridges between few values are no
    measurement. Values of a slower channel are missing evenly: that is no fault. Nor
    are those of a table into which rows of two clocks were merged: they are uneven by
    row, and even by their stamps.

    Parameters
    ----------
    values : (M,) array
        Values, NaN where one is missing.
    stamps : (M,) array
        Their stamps, in any unit.
    joint, channel : str
        Names of the joint or IMU, and of the channel.
    max_missing : float
        Share of the values that may be missing.
    """
    present = np.flatnonzero(np.isfinite(values))
    if len(present) < 2 or len(present) == len(values):
        return
    usual_distance = int(np.bincount(np.diff(present)).argmax())
    covered = (len(present) - 1) * usual_distance
    share = 1.0 - covered / float(present[-1] - present[0])

    # A stamp that is coarse or jitters hides neither clock.
    times = np.asarray(stamps[present], dtype=np.float64)
    intervals = np.diff(times)
    covered_time = (len(present) - 1) * float(np.median(intervals))
    share_of_time = 1.0 - covered_time / max(float(times[-1] - times[0]), 1e-300)
    if min(share, share_of_time) > max_missing:
        text = f"{percent(share)} of the values are missing"
        code = "values_lost" if share > LOST_SHARE else "values_missing"
        yield finding_of(code, text, joint, channel)
