"""Stamps put right: sorted, without duplicates, from one pass of one clock.

A clock that was set back runs twice over the same time. Rows of both passes would be
mixed if they were sorted by stamp, so that only the longest stretch of one pass is
kept.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from seqid_cli.logs.even_stamps import EvenStream, evened
from seqid_cli.logs.raw import Array, Rows, Stamps, Stream, gap_limit

NS = 1_000_000_000  # per second


@dataclass(frozen=True)
class TidyStream:
    """A stream in the order of time, and what was wrong with its stamps."""

    stream: Stream
    steps_back: int  # in time, as the samples came
    duplicates: int  # samples dropped because they repeat a stamp
    warnings: list[str]
    even: EvenStream | None  # the stream before samples were merged, if laid evenly


def tidy(stream: Stream, joints: EvenStream | None = None) -> TidyStream:
    """Sort a stream by stamp, lay it evenly, and merge samples of equal stamp.

    Samples that are more even than a coarse clock says are laid evenly, as the `joints`
    were where they have the same stamps. Of merged samples the first that holds a
    joint's value gives it. Where the clock was set back, only the longest stretch of
    one pass is kept.
    """
    warnings: list[str] = []
    steps_back = int(np.count_nonzero(np.diff(stream.stamp_ns) < 0))
    if steps_back:
        stream = _one_pass(stream, warnings)
        stream = stream.take(np.argsort(stream.stamp_ns, kind="stable"))
        warnings.append(f"{stream.name}: time steps back {steps_back} times; sorted")

    stream = _far_stamps_cut(stream, warnings)
    even = _as_joints(stream, joints)
    if even is None:
        even = evened(stream)
        warnings += [even.warning] if even is not None else []
    if even is not None:
        stream = even.stream

    n_samples = len(stream)
    stream, duplicates, conflicts = _merged(stream)
    if duplicates:
        warnings.append(f"{stream.name}: {duplicates} samples repeat a stamp; dropped")
    if conflicts > 0.01 * n_samples:
        warnings.append(
            f"{stream.name}: {conflicts} samples share a stamp with others but hold"
            " other values: the clock is too coarse; use the times of logging"
        )
    return TidyStream(stream, steps_back, duplicates, warnings, even)


def _as_joints(stream: Stream, joints: EvenStream | None) -> EvenStream | None:
    """Lay a stream as the joints were where it has their stamps; None where not."""
    if joints is None or not np.array_equal(stream.stamp_ns, joints.stamps_before):
        return None
    even = replace(stream, stamp_ns=joints.stream.stamp_ns)
    return replace(joints, stream=even)


def _one_pass(stream: Stream, warnings: list[str], *, many_steps: int = 100) -> Stream:
    """Keep the longest stretch without a jump of the clock back over logged time.

    Rows in no order step back as well, but often, by little, or without holding the
    time twice; these are only sorted.
    """
    steps = np.diff(stream.stamp_ns)
    forward_steps = steps[steps > 0]
    if not forward_steps.size:
        return stream
    far_back = np.flatnonzero(steps < -gap_limit(forward_steps, NS))
    if not 0 < far_back.size <= many_steps:
        return stream

    median_ns = float(np.median(forward_steps))
    is_jump = [_holds_time_twice(stream, int(row), median_ns) for row in far_back]
    jumps: Rows = far_back[np.array(is_jump, np.bool_)]
    if not len(jumps):
        return stream

    longest = _longest_stretch(stream, jumps)
    farthest_s = -steps[jumps].min() * 1e-9
    warnings.append(
        f"{stream.name}: the clock jumps back {len(jumps)} times (by up to"
        f" {farthest_s:.3g} s) and runs twice over the same time; only the longest"
        f" stretch is kept, {len(longest)} of {len(stream)} samples. Use the times of"
        " logging, or split the log at the jump"
    )
    return longest


def _longest_stretch(stream: Stream, cuts: Rows) -> Stream:
    """Return the longest stretch of samples between cuts, each behind a sample."""
    ends = [0, *(cuts + 1).tolist(), len(stream)]
    first, stop = max(pairwise(ends), key=lambda pair: pair[1] - pair[0])
    return stream.take(slice(first, stop))


def _holds_time_twice(stream: Stream, step_row: int, median_ns: float) -> bool:
    """Tell whether the time of a step back holds clearly more samples than it should.

    A sample that repeats stamp and values of another one does not count: it was
    published twice.
    """
    stamps = stream.stamp_ns
    first = int(stamps[step_row + 1])
    last = int(stamps[step_row])
    region = stream.take((stamps >= first) & (stamps <= last))
    region = region.take(np.argsort(region.stamp_ns, kind="stable"))

    repeats = np.concatenate([[False], np.diff(region.stamp_ns) == 0])
    for values in region.channels.values():
        same = np.isclose(values[1:], values[:-1], rtol=0.0, atol=0.0, equal_nan=True)
        repeats[1:] &= same.all(axis=1)

    n_samples = int(np.count_nonzero(~repeats))
    n_expected = (last - first) / median_ns + 1.0
    return n_samples > 1.25 * n_expected + 1.0


def _far_stamps_cut(stream: Stream, warnings: list[str], *, hole_s: int = 60) -> Stream:
    """Cut away stamps so far off that no grid can span them: a zero among epoch times.

    Far off is what would make a grid of twenty times the samples and a million more.
    """
    steps = np.diff(stream.stamp_ns)
    forward_steps = steps[steps > 0]
    if not forward_steps.size:
        return stream
    span_ns = int(stream.stamp_ns[-1]) - int(stream.stamp_ns[0])
    n_on_grid = span_ns / np.median(forward_steps)
    if n_on_grid < 20 * len(stream) + 1_000_000:
        return stream

    longest = _longest_stretch(stream, np.flatnonzero(steps > hole_s * NS))
    warnings.append(
        f"{stream.name}: the stamps span {span_ns * 1e-9:.3g} s with only"
        f" {len(stream)} samples; the longest stretch without a hole of {hole_s} s is"
        f" kept, {len(longest)} samples. Check the clock, or split the log"
    )
    return longest


def _merged(stream: Stream) -> tuple[Stream, int, int]:
    """Merge samples of equal stamp.

    Returns
    -------
    Stream
        One sample for each stamp; of each column the first finite value.
    int
        Samples dropped: the most that a joint loses.
    int
        Samples whose values differ from those that are kept.
    """
    repeats = np.diff(stream.stamp_ns) == 0
    if not repeats.any():
        return stream, 0, 0
    group = np.concatenate([[0], np.cumsum(~repeats)])
    stamps: Stamps = stream.stamp_ns[np.concatenate([[True], ~repeats])]

    channels: dict[str, Array] = {}
    for name, values in stream.channels.items():
        channels[name] = np.full((len(stamps), values.shape[1]), np.nan)
        # Backwards, so that the first value of a group is written last and stays.
        rows, columns = np.argwhere(np.isfinite(values))[::-1].T
        channels[name][group[rows], columns] = values[rows, columns]
    merged = replace(stream, stamp_ns=stamps, channels=channels)

    # The first channel speaks for the stream: the position of joints.
    lead = next(iter(stream.channels))
    logged = stream.channels[lead]
    is_logged = np.isfinite(logged)
    n_lost = is_logged.sum(axis=0) - np.isfinite(channels[lead]).sum(axis=0)
    differs = np.any(is_logged & (logged != channels[lead][group]), axis=1)
    return merged, int(n_lost.max(initial=0)), int(np.count_nonzero(differs))
