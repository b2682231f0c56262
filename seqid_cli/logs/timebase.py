"""One uniform time base for all channels.

The base runs from the first to the last sample that has every joint, at the mean rate
of the joint states. Samples that already lie on it are taken as they are; others are
interpolated, by a cubic spline between gaps and straight lines across them, or
throughout where samples come in bursts and a spline would swing; where the base is
coarser than the samples, they are averaged over an interval.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import Array, Mask, Stamps, Stream, gap_limit

LEAST_SAMPLES = 20
# of the interval: so far may a sample lie beside the base and be taken as it is
UNIFORM = 1e-3
JITTER_LIMIT = 0.5
Gaps = tuple[tuple[float, float], ...]  # s, from and to


@dataclass(frozen=True)
class Base:
    """The uniform time base, or a window of it: sample i lies at `start_ns` + i `step_s`."""

    start_ns: int
    step_s: float
    count: int
    jitter: float
    exact: bool  # whether the joint samples lie on it
    gaps: Gaps
    first: int = 0  # number of its first sample

    @property
    def t(self) -> Array:
        """Seconds since sample 0, (N,)."""
        return (self.first + np.arange(self.count, dtype=np.float64)) * self.step_s


def make_base(joints: Stream, where: str, *, least_seconds: float = 0.5) -> Base:
    """Lay the base through joint samples in the order of time, with `position` (M, n)."""
    present = np.isfinite(joints.channels["position"])
    rows = np.zeros(0, np.intp)
    # of the joint that has most, from where all have begun
    if present.any(axis=0).all():
        first = present.argmax(axis=0).max()
        last = len(present) - present[::-1].argmax(axis=0).max()
        rows = first + np.flatnonzero(present[first:last, present.sum(axis=0).argmax()])
    stamps = joints.stamp_ns[rows]
    span = int(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0
    if len(rows) < LEAST_SAMPLES or span < least_seconds:
        text = f"only {len(rows)} samples over {span:.3g} s hold all joints; at least "
        text += f"{LEAST_SAMPLES} over {least_seconds} s are needed"
        raise InputError(
            text, hint="Record longer, or leave this log out.", where=where
        )
    step, jitter, gaps = _own_step(stamps)
    count = int(np.floor(span / step + 1e-6)) + 1
    exact = count == len(rows) and _on_base(stamps, step)
    return Base(int(stamps[0]), step, count, jitter, exact, gaps)


def resample(stream: Stream, quantity: str, base: Base) -> tuple[Array, Mask, Gaps]:
    """Bring one channel (M, w) of a stream in the order of time to the base.

    Returns: values (N, w), finite everywhere in columns with any value, NaN in others;
    where (N,) the former are measured, not in a gap, not outside a column's time; the
    gaps.
    """
    values = stream.channels[quantity]
    # it looks at the count first
    if base.exact and (taken := _taken(stream, values, base)):
        return taken
    seconds: Array = (stream.stamp_ns - base.start_ns).astype(np.float64) * 1e-9
    out = np.full((base.count, values.shape[1]), np.nan)
    valid = np.ones(base.count, np.bool_)
    gaps: set[tuple[float, float]] = set()
    there = np.isfinite(values)
    patterns = [column.tobytes() for column in there.T]
    # columns that are there in the same samples
    for pattern in dict.fromkeys(patterns):
        columns = [k for k, own in enumerate(patterns) if own == pattern]
        present = there[:, columns[0]]
        if present.any():
            own = values[present][:, columns]
            out[:, columns], measured, holes = _interpolate(seconds[present], own, base)
            valid &= measured
            gaps.update(holes)
    return out, valid, tuple(sorted(gaps))


def overlap(stream: Stream, base: Base) -> float:
    """Return the share of the base that a stream's time covers."""
    if not len(stream):
        return 0.0
    length = (base.count - 1) * base.step_s
    start, end = np.clip((stream.stamp_ns[[0, -1]] - base.start_ns) * 1e-9, 0.0, length)
    return float(end - start) / length


def _own_step(stamps: Stamps) -> tuple[float, float, Gaps]:
    """Return the interval [s], its relative jitter, and the gaps."""
    steps = np.diff(stamps)
    median = float(np.median(steps))
    gap = steps > gap_limit(steps, 1e9)
    regular = steps[~gap]
    jitter = float(regular.std() / median)
    count = regular.size
    # a dropped sample makes one interval of two; bursts do not
    if jitter <= JITTER_LIMIT:
        count = int(np.maximum(1.0, np.rint(regular / median)).sum())
    seconds = (stamps - stamps[0]) * 1e-9
    gaps = tuple(
        (float(seconds[i]), float(seconds[i + 1])) for i in np.flatnonzero(gap)
    )
    return int(regular.sum()) / count * 1e-9, jitter, gaps


def _on_base(stamps: Stamps, step: float) -> bool:
    off = (stamps - stamps[0]) * 1e-9 - np.arange(len(stamps)) * step
    return bool(np.abs(off).max() <= UNIFORM * step)


def _taken(
    stream: Stream, values: Array, base: Base
) -> tuple[Array, Mask, Gaps] | None:
    """Take samples that lie on the base as they are; None if they do not or some are missing."""
    start = int(np.searchsorted(stream.stamp_ns, base.start_ns))
    picked = slice(start, start + base.count)
    stamps, chosen = stream.stamp_ns[picked], values[picked]
    if (
        len(stamps) < base.count
        or stamps[0] != base.start_ns
        or not _on_base(stamps, base.step_s)
    ):
        return None
    sound = np.isfinite(chosen) | ~np.isfinite(values).any(axis=0)
    return (
        (np.array(chosen), np.ones(base.count, np.bool_), ()) if sound.all() else None
    )


def _interpolate(
    seconds: Array,
    values: Array,
    base: Base,
    *,
    coarser: float = 1.5,
    near: float = 0.1,
) -> tuple[Array, Mask, list[tuple[float, float]]]:
    t = base.t
    tolerance = UNIFORM * base.step_s
    valid = (t >= seconds[0] - tolerance) & (t <= seconds[-1] + tolerance)
    if len(seconds) < 2:
        return np.tile(values[0], (base.count, 1)), valid, []
    steps = np.diff(seconds)
    median = float(np.median(steps))
    gap_at = np.flatnonzero(steps > gap_limit(steps))
    gaps = [(float(seconds[i]), float(seconds[i + 1])) for i in gap_at]
    for start, end in gaps:
        valid[slice(*np.searchsorted(t, (start + tolerance, end - tolerance)))] = False
    if base.step_s > coarser * median:
        return _averaged(seconds, values, t, base.step_s), valid, gaps
    out = np.column_stack([np.interp(t, seconds, column) for column in values.T])
    kept = np.delete(steps, gap_at)
    if kept.size and kept.std() <= JITTER_LIMIT * median:
        for piece in np.split(np.arange(len(seconds)), gap_at + 1):
            # Samples that nearly coincide would make the spline swing.
            x = seconds[piece]
            rows = piece[np.diff(x, prepend=-np.inf) > near * median]
            x = seconds[rows]
            if len(rows) > 3:  # as many as a cubic has coefficients
                inner = slice(
                    np.searchsorted(t, x[0]), np.searchsorted(t, x[-1], side="right")
                )
                out[inner] = make_interp_spline(x, values[rows], k=3)(t[inner])
    return out, valid, gaps


def _averaged(x: Array, values: Array, t: Array, width: float) -> Array:
    """Average the straight-line interpolant over `width` around each t, so that nothing aliases."""
    # The window is symmetric, hence without delay, and shrinks at the ends of the
    # samples.
    line = make_interp_spline(x, values, k=1)
    area, t = line.antiderivative(), np.clip(t, x[0], x[-1])
    half = np.minimum(np.minimum(t - x[0], x[-1] - t), width / 2)
    out: Array = line(t)
    wide = half > 1e-6 * width
    at, half = t[wide], half[wide]
    out[wide] = (area(at + half) - area(at - half)) / (2.0 * half)[:, None]
    return out
