"""One uniform time base for all channels.

The base runs from the first to the last sample that has every joint, at the mean rate
of the joint states. Samples that already lie on it are taken as they are; others are
interpolated, by a cubic spline between gaps and straight lines across them, or
throughout where samples come in bursts and a spline would swing; where the base is
coarser than the samples, they are averaged over an interval.

M is the number of samples as they were logged, N the number on the base, w the number
of columns of a channel.
"""

from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import Array, Mask, Rows, Stamps, Stream, gap_limit

LEAST_SAMPLES = 20
# of the interval: so far may a sample lie beside the base and be taken as it is
UNIFORM = 1e-3
JITTER_LIMIT = 0.5  # of the interval, beyond which samples come in bursts
Gaps = tuple[tuple[float, float], ...]  # s, from and to


@dataclass(frozen=True)
class Base:
    """The uniform time base, or a window of it: sample i is at start_ns + i step_s."""

    start_ns: int
    step_s: float
    count: int
    _: KW_ONLY
    jitter: float  # standard deviation of the samples' interval over its median
    exact: bool  # whether the joint samples lie on it
    gaps: Gaps
    first: int = 0  # number of its first sample

    @property
    def t(self) -> Array:
        """Seconds since sample 0, (N,)."""
        return (self.first + np.arange(self.count, dtype=np.float64)) * self.step_s

    def window(self, first: int, count: int) -> "Base":
        """Return `count` samples from number `first` on, to resample rows to them."""
        return replace(self, first=first, count=count, exact=False, gaps=())


@dataclass(frozen=True)
class Resampled:
    """One channel on the base."""

    values: Array  # (N, w) finite in columns with any value, NaN in others
    valid: Mask  # (N,) measured: not in a gap, not outside a column's time
    gaps: Gaps


def make_base(joints: Stream, where: str, *, least_seconds: float = 0.5) -> Base:
    """Lay the base through joint samples.

    Parameters
    ----------
    joints : Stream
        Joint samples in the order of time, with `position` (M, n).
    where : str
        The log, for messages.
    least_seconds : float
        Time that samples with every joint must span [s].

    Raises
    ------
    InputError
        Too few samples hold all joints, or over too short a time.
    """
    rows = _rows_of_all_joints(np.isfinite(joints.channels["position"]))
    stamps = joints.stamp_ns[rows]
    span_s = int(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0
    if len(rows) < LEAST_SAMPLES or span_s < least_seconds:
        raise InputError(
            f"only {len(rows)} samples over {span_s:.3g} s hold all joints; at least"
            f" {LEAST_SAMPLES} over {least_seconds} s are needed",
            hint="Record longer, or leave this log out.",
            where=where,
        )

    spacing = _spacing(stamps)
    # A span of whole intervals may be rounded to a little less than them.
    count = int(np.floor(span_s / spacing.step_s + 1e-6)) + 1
    return Base(
        start_ns=int(stamps[0]),
        step_s=spacing.step_s,
        count=count,
        jitter=spacing.jitter,
        exact=count == len(rows) and _lie_on_base(stamps, spacing.step_s),
        gaps=spacing.gaps,
    )


def _rows_of_all_joints(present: Mask) -> Rows:
    """Return the rows of the joint with most samples, while all joints are logged.

    Joints that come in messages of their own never share a row of `present` (M, n).
    Their common time is from where all have begun to where the first of them ends.
    """
    if not present.any(axis=0).all():
        return np.zeros(0, np.intp)
    first = present.argmax(axis=0).max()
    stop = len(present) - present[::-1].argmax(axis=0).max()
    fullest_joint = present.sum(axis=0).argmax()
    return np.asarray(first + np.flatnonzero(present[first:stop, fullest_joint]))


def resample(stream: Stream, quantity: str, base: Base) -> Resampled:
    """Bring one channel (M, w) of a stream in the order of time to the base."""
    values = stream.channels[quantity]
    if base.exact:
        resampled = _taken_as_logged(stream, values, base)
        if resampled is not None:
            return resampled

    seconds: Array = (stream.stamp_ns - base.start_ns).astype(np.float64) * 1e-9
    out = np.full((base.count, values.shape[1]), np.nan)
    valid = np.ones(base.count, np.bool_)
    gaps: set[tuple[float, float]] = set()

    # Columns that are there in the same samples are interpolated together.
    present = np.isfinite(values)
    columns_by_pattern: dict[bytes, list[int]] = {}
    for column, is_present in enumerate(present.T):
        columns_by_pattern.setdefault(is_present.tobytes(), []).append(column)

    for columns in columns_by_pattern.values():
        rows = present[:, columns[0]]
        if rows.any():
            part = _interpolate(seconds[rows], values[rows][:, columns], base)
            out[:, columns] = part.values
            valid &= part.valid
            gaps.update(part.gaps)
    return Resampled(out, valid, tuple(sorted(gaps)))


def overlap(stream: Stream, base: Base) -> float:
    """Return the share of the base that a stream's time covers."""
    if not len(stream):
        return 0.0
    length_s = (base.count - 1) * base.step_s
    ends_s = (stream.stamp_ns[[0, -1]] - base.start_ns) * 1e-9
    start_s, end_s = np.clip(ends_s, 0.0, length_s)
    return float(end_s - start_s) / length_s


@dataclass(frozen=True)
class _Spacing:
    """Interval of samples [s], its standard deviation over its median, and the gaps."""

    step_s: float
    jitter: float
    gaps: Gaps


def _spacing(stamps: Stamps) -> _Spacing:
    """Measure the interval of stamps (M,) and find the gaps."""
    steps = np.diff(stamps)
    median = float(np.median(steps))
    is_gap = steps > gap_limit(steps, 1e9)
    regular = steps[~is_gap]
    jitter = float(regular.std() / median)

    # A dropped sample makes one interval of two, so long steps count as several. In
    # bursts a long step is a pause, not a number of dropped samples.
    n_intervals = regular.size
    if jitter <= JITTER_LIMIT:
        n_intervals = int(np.maximum(1.0, np.rint(regular / median)).sum())

    seconds = (stamps - stamps[0]) * 1e-9
    gaps = tuple(
        (float(seconds[i]), float(seconds[i + 1])) for i in np.flatnonzero(is_gap)
    )
    step_s = int(regular.sum()) / n_intervals * 1e-9
    return _Spacing(step_s, jitter, gaps)


def _lie_on_base(stamps: Stamps, step_s: float) -> bool:
    """Tell whether stamps (M,) [ns] follow each other at a step."""
    offset_s = (stamps - stamps[0]) * 1e-9 - np.arange(len(stamps)) * step_s
    return bool(np.abs(offset_s).max() <= UNIFORM * step_s)


def _taken_as_logged(stream: Stream, values: Array, base: Base) -> Resampled | None:
    """Take samples that lie on the base as they are; None if any is not there."""
    start = int(np.searchsorted(stream.stamp_ns, base.start_ns))
    stamps = stream.stamp_ns[start : start + base.count]
    if len(stamps) < base.count or stamps[0] != base.start_ns:
        return None
    if not _lie_on_base(stamps, base.step_s):
        return None

    chosen = values[start : start + base.count]
    is_empty_column = ~np.isfinite(values).any(axis=0)
    if not (np.isfinite(chosen) | is_empty_column).all():
        return None
    return Resampled(np.array(chosen), np.ones(base.count, np.bool_), ())


def _interpolate(
    seconds: Array,
    values: Array,
    base: Base,
    *,
    coarser: float = 1.5,
    near: float = 0.1,
) -> Resampled:
    """Interpolate samples (M, w), all finite, at `seconds` (M,) since the base's start.

    Parameters
    ----------
    coarser : float
        Times the samples' interval; a base of larger steps averages its samples.
    near : float
        Of the samples' interval; samples closer than that make a spline swing.
    """
    from scipy.interpolate import make_interp_spline

    t = base.t
    tolerance = UNIFORM * base.step_s
    valid = (t >= seconds[0] - tolerance) & (t <= seconds[-1] + tolerance)
    if len(seconds) < 2:
        return Resampled(np.tile(values[0], (base.count, 1)), valid, ())

    steps = np.diff(seconds)
    median = float(np.median(steps))
    gap_at = np.flatnonzero(steps > gap_limit(steps))
    gaps = tuple((float(seconds[i]), float(seconds[i + 1])) for i in gap_at)
    for start, end in gaps:
        first, stop = np.searchsorted(t, (start + tolerance, end - tolerance))
        valid[first:stop] = False

    if base.step_s > coarser * median:
        return Resampled(_averaged(seconds, values, t, base.step_s), valid, gaps)

    # Straight lines everywhere, then a spline between gaps where samples are even.
    out = np.column_stack([np.interp(t, seconds, column) for column in values.T])
    regular_steps = np.delete(steps, gap_at)
    if regular_steps.size and regular_steps.std() <= JITTER_LIMIT * median:
        for piece in np.split(np.arange(len(seconds)), gap_at + 1):
            # Samples that nearly coincide would make the spline swing.
            spacing = np.diff(seconds[piece], prepend=-np.inf)
            rows = piece[spacing > near * median]
            x = seconds[rows]
            if len(rows) < 4:  # as many as a cubic has coefficients
                continue
            first = np.searchsorted(t, x[0])
            stop = np.searchsorted(t, x[-1], side="right")
            spline = make_interp_spline(x, values[rows], k=3)
            out[first:stop] = spline(t[first:stop])
    return Resampled(out, valid, gaps)


def _averaged(x: Array, values: Array, t: Array, width: float) -> Array:
    """Average the straight-line interpolant of (x, values) over `width` around each t.

    Averaging keeps what is faster than the base from aliasing. The window is symmetric,
    hence without delay, and shrinks at the ends of the samples.
    """
    from scipy.interpolate import make_interp_spline

    line = make_interp_spline(x, values, k=1)
    area = line.antiderivative()
    t = np.clip(t, x[0], x[-1])
    half_width = np.minimum(np.minimum(t - x[0], x[-1] - t), width / 2)

    out: Array = line(t)
    is_wide = half_width > 1e-6 * width
    center = t[is_wide]
    half = half_width[is_wide]
    total = area(center + half) - area(center - half)
    out[is_wide] = total / (2.0 * half)[:, None]
    return out
