"""Stamps, in integer nanoseconds, put right: sorted, without duplicates, from one clock."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.raw import Array, Rows, Stamps, Stream

GAP_INTERVALS = 5.0
GAP_LEAST_S = 0.02
BURSTS = 0.05


@dataclass(frozen=True)
class Tidy:
    """A stream in the order of time; its steps back, and the samples dropped as repeated."""

    stream: Stream
    non_monotonic: int = 0  # steps back in time
    duplicates: int = 0  # samples dropped because another one holds the same stamp
    warnings: tuple[str, ...] = ()


def tidy(stream: Stream) -> Tidy:
    """Sort a stream by stamp; merge samples of equal stamp, of which the first to hold it counts.

    Where the clock was set back, only the longest stretch of one pass is kept.
    """
    backwards = int(np.count_nonzero(np.diff(stream.stamp_ns) < 0))
    warnings: list[str] = []
    if backwards:
        stream = _one_pass(stream, warnings)
        stream = stream.take(np.argsort(stream.stamp_ns, kind="stable"))
        warnings.append(f"{stream.name}: time steps back {backwards} times; sorted")
    stream = _far_stamps_cut(stream, warnings)
    before = len(stream)
    stream, duplicates, conflicts = _merged(stream)
    if duplicates:
        warnings.append(f"{stream.name}: {duplicates} samples repeat a stamp; dropped")
    if conflicts > 0.01 * before:
        text = f"{stream.name}: {conflicts} samples share a stamp with others but hold other values"
        warnings.append(f"{text}: the clock is too coarse; use the times of logging")
    return Tidy(stream, backwards, duplicates, tuple(warnings))


def gap_limit(steps: NDArray[np.floating] | NDArray[np.int64], second: float = 1.0) -> float:
    """Return the interval from which on samples count as missing, in the unit of `steps` (M,).

    Five median intervals, but at least 20 ms, over which the curve itself follows an arm. Where
    samples come in bursts, more than one interval in twenty is beyond that: then five mean ones.
    """
    least = GAP_LEAST_S * second
    limit = max(GAP_INTERVALS * float(np.median(steps)), least)
    if np.count_nonzero(steps > limit) > BURSTS * len(steps):
        return max(GAP_INTERVALS * float(np.mean(steps)), least)
    return limit


def _one_pass(stream: Stream, warnings: list[str], *, many_steps: int = 100) -> Stream:
    steps = np.diff(stream.stamp_ns)
    forward = steps[steps > 0]
    far = np.flatnonzero(steps < -gap_limit(forward, 1e9)) if forward.size else forward
    if not 0 < far.size <= many_steps:
        return stream
    median = float(np.median(forward))
    jumps = np.array([i for i in far if _overlaps(stream, int(i), median)], np.intp)
    if not len(jumps):
        return stream
    kept = _longest(stream, jumps)
    warnings.append(
        f"{stream.name}: the clock jumps back {len(jumps)} times (by up to "
        f"{-steps[jumps].min() * 1e-9:.3g} s) and runs twice over the same time; only the longest "
        f"stretch is kept, {len(kept)} of {len(stream)} samples. Use the times of logging, or "
        "split the log at the jump"
    )
    return kept


def _longest(stream: Stream, cuts: Rows) -> Stream:
    """The longest stretch of samples between cuts, each behind a sample."""
    ends = [0, *(cuts + 1).tolist(), len(stream)]
    return stream.take(slice(*max(pairwise(ends), key=lambda pair: pair[1] - pair[0])))


def _overlaps(stream: Stream, step: int, median_ns: float) -> bool:
    """Tell whether the time behind a step back holds twice the samples that it should."""
    stamps = stream.stamp_ns
    low, high = int(stamps[step + 1]), int(stamps[step])
    region = stream.take((stamps >= low) & (stamps <= high))
    region = region.take(np.argsort(region.stamp_ns, kind="stable"))
    repeated = np.concatenate([[False], np.diff(region.stamp_ns) == 0])
    for values in region.channels.values():
        same = np.isclose(values[1:], values[:-1], rtol=0.0, atol=0.0, equal_nan=True)
        repeated[1:] &= same.all(axis=1)
    return int(np.count_nonzero(~repeated)) > 1.25 * ((high - low) / median_ns + 1.0) + 1.0


def _far_stamps_cut(stream: Stream, warnings: list[str], *, hole_s: int = 60) -> Stream:
    """Cut away stamps so far off (a zero among epoch times, say) that no grid can span them."""
    steps = np.diff(stream.stamp_ns)
    forward = steps[steps > 0]
    if not forward.size:
        return stream
    span = int(stream.stamp_ns[-1]) - int(stream.stamp_ns[0])
    if span / np.median(forward) < 20 * len(stream) + 1_000_000:  # samples on the grid
        return stream
    kept = _longest(stream, np.flatnonzero(steps > hole_s * 1_000_000_000))
    warnings.append(
        f"{stream.name}: the stamps span {span * 1e-9:.3g} s with only {len(stream)} samples; the "
        f"longest stretch without a hole of {hole_s} s is kept, {len(kept)} samples. "
        "Check the clock, or split the log"
    )
    return kept


def _merged(stream: Stream) -> tuple[Stream, int, int]:
    """Merge rows of equal stamp; returns duplicates and those of them that hold other values."""
    repeats = np.diff(stream.stamp_ns) == 0
    if not repeats.any():
        return stream, 0, 0
    group = np.concatenate([[0], np.cumsum(~repeats)])
    stamps: Stamps = stream.stamp_ns[np.concatenate([[True], ~repeats])]
    channels: dict[str, Array] = {}
    for name, values in stream.channels.items():
        channels[name] = np.full((len(stamps), values.shape[1]), np.nan)
        rows, columns = np.nonzero(np.isfinite(values))
        rows, columns = rows[::-1], columns[::-1]  # so that the first counts
        channels[name][group[rows], columns] = values[rows, columns]
    lead = next(iter(stream.channels))
    given = np.isfinite(stream.channels[lead])
    surplus = given.sum(axis=0) - np.isfinite(channels[lead]).sum(axis=0)
    other = given & (stream.channels[lead] != channels[lead][group])
    conflicts = int(np.count_nonzero(other.any(axis=1)))
    merged = replace(stream, stamp_ns=stamps, channels=channels)
    return merged, int(surplus.max(initial=0)), conflicts
