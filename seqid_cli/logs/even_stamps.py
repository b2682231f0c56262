"""Even stamps for samples that are more even than their clock.

A coarse clock gives several samples one stamp, a buffered reader stamps them burst by
burst. Where the count of the samples is even, sample i of a stretch without a gap was
taken at

    t_i = a + b i,

with one step b for all stretches and a first time a for each, the least-squares line
through their stamps. Stamps may also be right and the samples uneven. The motion tells
the two apart: over some samples the positions of an arm are cubics of the time at which
they were taken, and of no other. Of samples that share a stamp and hold other values it
is known without that: they were not taken at once.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.logs.raw import GAP_INTERVALS, GAP_LEAST_S, Array, Mask, Stamps, Stream

CUBIC = 4  # coefficients of the curve through the positions of a window
# Share of the intervals that are no pauses between bursts: these are of up to a hundred
# samples.
IN_BURSTS = 0.99


@dataclass(frozen=True, kw_only=True)
class EvenStream:
    """A stream with even stamps, those that it had, and what was wrong with them."""

    stream: Stream
    stamps_before: Stamps
    warning: str


def evened(
    stream: Stream,
    *,
    min_samples: int = 50,
    min_scatter: float = 0.1,
    min_shared: float = 0.01,
    better: float = 1.2,
) -> EvenStream | None:
    """Lay a stream on even stamps where these are the times of its samples.

    Parameters
    ----------
    stream : Stream
        M samples in the order of time.
    min_samples : int
        Samples below which a count says nothing.
    min_scatter : float
        Standard deviation of the intervals, of their mean, from which on stamps are
        looked at: less does no harm.
    min_shared : float
        Share of the samples with the stamp of another one, from which on they are
        looked at as well.
    better : float
        Times what cubics of even times leave of the positions, that cubics of the
        stamps must leave.

    Returns
    -------
    EvenStream or None
        None where the stamps are to be taken as they are.
    """
    stamps = stream.stamp_ns
    if len(stamps) < min_samples:
        return None
    intervals = np.diff(stamps).astype(np.float64)
    limit = _gap_limit(intervals)
    is_gap = intervals > limit
    regular = intervals[~is_gap]
    n_tied = int(np.count_nonzero(intervals == 0.0))
    n_shared = 0
    if n_tied:
        n_shared = int(np.count_nonzero(_other_values_at_one_stamp(stream)))
    if n_tied and n_shared < 0.5 * n_tied:
        return None  # messages that were sent twice, or that complete each other
    shares = n_shared > min_shared * len(stamps)
    if not shares and regular.std() < min_scatter * regular.mean():
        return None

    step_ns, times_ns = _line(stamps, is_gap)
    # An even count is never farther from its stamps than these are from each other.
    farthest = np.quantile(np.abs(times_ns - (stamps - stamps[0])), 0.99)
    if step_ns <= 0.0 or farthest > np.quantile(regular, IN_BURSTS):
        return None
    ratio = _left_ratio(stream, times_ns, is_gap)
    # Where nothing moves only samples that share a stamp are known to be elsewhere.
    if ratio < better and not (shares and ratio > 1.0 / better):
        return None

    even = stamps[0] + np.rint(times_ns).astype(np.int64)
    coarse_ms = 1e-6 * float(np.quantile(regular, IN_BURSTS))
    warning = (
        f"{stream.name}: the stamps are coarser than the samples: {coarse_ms:.3g} ms"
        f" apart, though a sample comes every {1e-6 * step_ns:.3g} ms; the samples are"
        " laid evenly"
    )
    return EvenStream(
        stream=replace(stream, stamp_ns=even), stamps_before=stamps, warning=warning
    )


def _gap_limit(intervals: Array) -> float:
    """Return the interval [ns] from which on samples count as missing.

    Pauses between bursts are no gaps.
    """
    pause = float(np.quantile(intervals, IN_BURSTS))
    return max(GAP_INTERVALS * pause, GAP_LEAST_S * 1e9)


def _other_values_at_one_stamp(stream: Stream) -> Mask:
    """Tell which samples (M,) share the stamp of the one before, with other values."""
    differs = np.zeros(len(stream), np.bool_)
    for values in stream.channels.values():
        with np.errstate(invalid="ignore"):
            change = np.abs(np.diff(values, axis=0))
        differs[1:] |= (change > 0.0).any(axis=1)
    differs[1:] &= np.diff(stream.stamp_ns) == 0
    return differs


def _line(stamps: Stamps, is_gap: Mask) -> tuple[float, Array]:
    """Return the step and the times (M,) of the lines through stretches of stamps.

    Both are in ns, the times since the first stamp. `is_gap` (M - 1,) parts stretches.
    """
    stretch = np.concatenate([[0], np.cumsum(is_gap)])
    size = np.bincount(stretch).astype(np.float64)
    seconds = (stamps - stamps[0]).astype(np.float64)
    index = np.arange(len(stamps), dtype=np.float64)

    def centred(values: Array) -> Array:
        means = np.bincount(stretch, weights=values) / size
        return np.asarray(values - means[stretch])

    i = centred(index)
    step = float(i @ centred(seconds)) / max(float(i @ i), 1e-300)
    return step, seconds - centred(seconds) + step * i


def _left_ratio(
    stream: Stream, even_ns: Array, is_gap: Mask, *, most_windows: int = 500
) -> float:
    """Return by how much more cubics of the stamps leave than cubics of even times.

    It is the mean over the columns of the first channel, of joints their positions, and
    1 where there is nothing to compare. `is_gap` (M - 1,) parts stretches.
    """
    values = next(iter(stream.channels.values()))
    values = values[:, np.isfinite(values).all(axis=0)]
    stamps_ns = (stream.stamp_ns - stream.stamp_ns[0]).astype(np.float64)
    # A window holds stamps enough for a cubic, however many samples come with each.
    intervals = np.diff(stamps_ns)
    n_stamps = 1 + np.count_nonzero(intervals > 0.2 * intervals.mean())
    width = int(np.ceil(2.0 * CUBIC * len(stream) / n_stamps))
    n_windows = len(stream) - width + 1
    if n_windows < 1 or not values.shape[1]:
        return 1.0
    first = np.arange(0, n_windows, max(1, n_windows // most_windows))
    gaps_before = np.concatenate([[0], np.cumsum(is_gap)])
    first = first[gaps_before[first] == gaps_before[first + width - 1]]
    if not len(first):
        return 1.0

    rows = first[:, None] + np.arange(width)
    by_stamps = _left(stamps_ns[rows], values[rows])
    by_even = _left(even_ns[rows], values[rows])
    is_live = (by_stamps > 0.0) & (by_even > 0.0)
    if not is_live.any():
        return 1.0
    return float(np.mean(by_stamps[is_live] / by_even[is_live]))


def _left(t: Array, values: Array) -> Array:
    """Return the squares (w,) that cubics leave of values (K, L, w) at times (K, L)."""
    centred = t - t.mean(axis=1, keepdims=True)
    x = centred / np.maximum(np.abs(centred).max(axis=1, keepdims=True), 1e-300)
    powers = x[:, :, None] ** np.arange(CUBIC)
    fitted = powers @ (np.linalg.pinv(powers) @ values)
    return np.asarray(np.sum((values - fitted) ** 2, axis=(0, 1)))
