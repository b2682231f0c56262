"""Windows of time over which events are looked for: the mean residual and the state of each.

Cut from the rows of data sets, or from tracks: kept samples of logs of any length.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seqid_cli.discover.survey.rows import Rows
from seqid_cli.typing import Array, Index, Mask

OVERLAP = 4  # windows that cover each moment
USED = 0.6  # share of a window's samples that must count
STEEP = 0.1  # of the largest speed: below it directions and reversals are told apart


@dataclass(frozen=True)
class Windows:
    """Windows of one length over all data sets.

    `scene`, `centre` (W,) say where; `mean` (W, n) of the scaled residual, NaN where too few
    samples count; `state` (W, 4n) position, speed, acceleration and load of each joint, scaled;
    `reverses` (W, 2n) tells where each joint's velocity and each joint's load change sign.
    """

    length_s: float
    scene: Index
    centre: Array
    mean: Array
    state: Array
    speed: Array
    reverses: Mask


@dataclass(frozen=True)
class Track:
    """Samples of one log: `t` (M,) s, and what each joint does.

    `values` (5, M, n): position, velocity, acceleration, load, residual (NaN: does not count).
    """

    t: Array
    values: Array
    cutoff_hz: float

    def __getitem__(self, some: slice) -> "Track":
        """Some of the samples."""
        return Track(self.t[some], self.values[:, some], self.cutoff_hz)


def joined(tracks: Sequence[Track]) -> Track:
    """Tracks of one log, one after the other."""
    values = np.concatenate([track.values for track in tracks], axis=1)
    return Track(np.concatenate([track.t for track in tracks]), values, tracks[0].cutoff_hz)


def tracks_of(rows: Rows, left_out: Sequence[Array]) -> list[Track]:
    """The kept samples of every data set with each joint's scaled residual (M_j,) in its rows."""
    ends = np.cumsum([used.sum(axis=0) for used in rows.used], axis=0)
    own = [np.split(left_out[j], ends[:-1, j]) for j in range(rows.n)]
    tracks, logs = list[Track](), zip(rows.scenes, rows.picked, rows.used, strict=True)
    for number, (scene, at, used) in enumerate(logs):
        motion, residual = scene.motion, np.full(used.shape, np.nan)
        residual.T[used.T] = np.concatenate([parts[number] for parts in own])
        values = [motion.q[at], motion.dq[at], motion.ddq[at], scene.load[at], residual]
        t = motion.t[at] - motion.t[0]
        tracks.append(Track(t, np.stack(values), motion.lowpass.cutoff_hz))
    return tracks


def windows_of(tracks: Sequence[Track], length_s: float) -> Windows:
    """Cut logs into overlapping windows of one length."""
    top = np.max([np.max(np.abs(track.values[1]), axis=0) for track in tracks], axis=0)
    top = np.maximum(top, 1e-12)
    parts = [_windows_of_track(number, x, top, length_s) for number, x in enumerate(tracks)]
    every = [np.concatenate(part) for part in zip(*parts, strict=True)]
    known = np.isfinite(every[2]).any(axis=1)
    scene, centre, mean, state, speed, reverses = (part[known] for part in every)
    spread = np.std(state, axis=0) if len(state) else np.ones(state.shape[1])
    state = state / np.where(spread > 0, spread, 1.0)
    return Windows(length_s, scene, centre, mean, state, speed, reverses)


def _windows_of_track(number: int, track: Track, top: Array, length_s: float) -> tuple[Any, ...]:
    """Data set, centre, mean, state, speed and reversals of one log's windows."""
    t, (q, v, a, load, residual) = track.t, track.values
    step = float(np.min(np.diff(t), initial=np.inf))
    begin = np.arange(t[0], t[-1] - length_s + 1e-9, length_s / OVERLAP)
    low, high = np.searchsorted(t, begin), np.searchsorted(t, begin + length_s)
    reach = 0.5 / track.cutoff_hz
    wide = np.searchsorted(t, begin - reach), np.searchsorted(t, begin + length_s + reach)
    own = [q, np.arcsinh(v / (STEEP * top)), a, load]
    turns = np.hstack([_changes(v), _changes(load)])
    return (
        np.full(len(begin), number),
        begin + 0.5 * length_s,
        _means(residual, low, high, USED * length_s / step),
        _means(np.hstack(own), low, high, 1.0),
        _means(np.abs(v), low, high, 1.0),
        _means(turns, *wide, 1.0) > 0,
    )


def _changes(values: Array) -> Array:
    """One (M, k) where a column's sign differs from that of the row before, else zero."""
    sign = np.sign(values)
    return np.asarray(np.diff(sign, axis=0, prepend=sign[:1]) != 0, dtype=np.float64)


def _means(values: Array, low: Index, high: Index, fewest: float) -> Array:
    """Means (W, k) over half-open ranges of the finite values, NaN where fewer than `fewest`."""
    there, none = np.isfinite(values), np.zeros(values.shape[1])
    sums = np.vstack([none, np.cumsum(np.where(there, values, 0.0), axis=0)])
    counts = np.vstack([none, np.cumsum(there, axis=0)])
    total, count = sums[high] - sums[low], counts[high] - counts[low]
    return np.where(count >= max(fewest, 1.0), total / np.maximum(count, 1.0), np.nan)
