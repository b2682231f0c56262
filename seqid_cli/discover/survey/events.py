"""Events: short stretches of a log in which something from outside pushed the arm.

The residual's mean over a short window is compared with what such windows show
elsewhere: with windows of like speed, with all those in which a joint reverses, and
with the nearest ones in state (same place, same motion or same load of this joint, same
state of all joints). What the model does not know of friction, gears or load recurs
there and so is no event; a push does not. A state that is seen once tells nothing. A
push on link k moves the joints up to k, so their evidence is taken together.

    z_w = min_c |m_w - med_c| / max_c s_c

m_w is the mean of the residual over the window, med_c and s_c median and robust size of
such means over the comparison c; s is of unit size for Gaussian noise, so z counts
robust sigmas.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from seqid_cli.discover.survey.rows import BLOCK_S, SAMPLES_PER_CUTOFF, Rows
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.robust import PER_MEDIAN
from seqid_cli.typing import Array, Index, Mask

OVERLAP = 4  # windows that cover each moment
USED = 0.6  # share of a window's samples that must count
STEEP = 0.1  # of the largest speed: below it directions and reversals are told apart


@dataclass(frozen=True)
class Windows:
    """Windows of one length over all data sets."""

    length_s: float
    scene: Index  # (W,), the data set
    centre: Array  # (W,) s
    mean: Array  # (W, n) of the scaled residual, NaN where too few samples count
    state: Array  # (W, 4n) position, speed, acceleration and load of each joint, scaled
    speed: Array  # (W, n)
    # (W, 2n), whether each joint's velocity and each joint's load change sign
    reverses: Mask


@dataclass(frozen=True)
class Track:
    """Samples of one log, and what each joint does there."""

    t: Array  # (M,) s
    # (5, M, n): position, velocity, acceleration, load, residual (NaN: no count)
    values: Array
    cutoff_hz: float

    def __getitem__(self, some: slice) -> "Track":
        """Some of the samples."""
        return Track(self.t[some], self.values[:, some], self.cutoff_hz)


def joined(tracks: Sequence[Track]) -> Track:
    """Tracks of one log, one after the other."""
    values = np.concatenate([track.values for track in tracks], axis=1)
    return Track(
        np.concatenate([track.t for track in tracks]), values, tracks[0].cutoff_hz
    )


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
    parts = [
        _windows_of_track(number, x, top, length_s) for number, x in enumerate(tracks)
    ]
    every = [np.concatenate(part) for part in zip(*parts, strict=True)]
    known = np.isfinite(every[2]).any(axis=1)
    scene, centre, mean, state, speed, reverses = (part[known] for part in every)
    spread = np.std(state, axis=0) if len(state) else np.ones(state.shape[1])
    state = state / np.where(spread > 0, spread, 1.0)
    return Windows(length_s, scene, centre, mean, state, speed, reverses)


def _windows_of_track(
    number: int, track: Track, top: Array, length_s: float
) -> tuple[Any, ...]:
    """Data set, centre, mean, state, speed and reversals of one log's windows."""
    t, (q, v, a, load, residual) = track.t, track.values
    step = float(np.min(np.diff(t), initial=np.inf))
    begin = np.arange(t[0], t[-1] - length_s + 1e-9, length_s / OVERLAP)
    low, high = np.searchsorted(t, begin), np.searchsorted(t, begin + length_s)
    reach = 0.5 / track.cutoff_hz
    wide = (
        np.searchsorted(t, begin - reach),
        np.searchsorted(t, begin + length_s + reach),
    )
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


LENGTHS_S = (0.15, 0.3, 0.6)
GATE = 5.2  # robust sigmas that an event must reach
# robust sigmas within its class from which a window is compared with like ones
LOOKED_AT = 3.0
MOST_REFERENCES = 3000
EDGE_SHARE = 0.4  # of an event's peak, down to which it reaches
# share of a log (or LONGEST_S, whichever is more) that events may fill
MOST_TIME = 0.05
LONGEST_S = 2.0  # of one event
NEIGHBOURS = 24
SPEEDS = 4  # classes of speed
FEWEST = 8  # windows that a class must have to be one
USUAL = 0.95  # share of the windows whose neighbours count as near
MOST = 1.645  # magnitude that one in ten exceeds, per standard deviation


@dataclass(frozen=True)
class Interval:
    """One event: a stretch of one data set, in seconds since its first sample."""

    scene: int
    start: float
    end: float
    joints: tuple[int, ...]
    score: float

    @property
    def certainty(self) -> float:
        """How sure it is that no noise made it, by its score alone: a half at the gate."""
        return float(1.0 - 0.5 ** (self.score / GATE) ** 2)

    def inside(self, scene: Scene, margin: float = 0.0) -> Mask:
        """Samples (N,) between its start and its end, and so many seconds more."""
        t = scene.motion.t - scene.motion.t[0]
        return np.asarray((t >= self.start - margin) & (t <= self.end + margin))

    def squares(self, scene: Scene, residual: Array) -> float:
        """Sum of the squared residual (N, n) of its joints in it, where they slide."""
        there = np.where(scene.slides, residual, 0.0)[self.inside(scene)]
        return float(np.sum(there[:, list(self.joints)] ** 2))

    def energy(self, scene: Scene, scaled: Array) -> float:
        """Squared residual (N, n), in units of noise, of its joints in it beyond noise."""
        motion = scene.motion
        thin = SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz / motion.rate_hz
        own = scaled[self.inside(scene)][:, list(self.joints)]
        return thin * float(np.sum(np.maximum(own**2 - 1.0, 0.0)))


def find_events(rows: Rows, left_out: Sequence[Array]) -> list[Interval]:
    """Find what stands out in joints' scaled residuals (M_j,), unless it fills much of a log."""
    tracks, found = tracks_of(rows, left_out), list[Interval]()
    every = [windows_of(tracks, length) for length in LENGTHS_S]
    scored = [(windows, scores(windows)) for windows in every]
    for number in range(len(rows.scenes)):
        events = places(number, scored)
        length = max(
            w.length_s * np.count_nonzero(w.scene == number) / OVERLAP for w in every
        )
        taken = sum(end - start for start, end in _occasions(events))
        found += events if taken <= max(MOST_TIME * length, LONGEST_S) else []
    return found


def _occasions(events: Sequence[Interval]) -> list[tuple[float, float]]:
    """Start and end of what stands out, where events nearer than `BLOCK_S` are one."""
    found: list[tuple[float, float]] = []
    for event in events:
        near = found and event.start - found[-1][1] <= BLOCK_S
        start, end = found.pop() if near else (event.start, event.end)
        found.append((start, max(end, event.end)))
    return found


def scores(windows: Windows) -> Array:
    """Robust sigmas (W, n), signed, by which every window stands out; zero where unknown."""
    n = windows.mean.shape[1]
    sizes = np.stack([_class_size(windows, j) for j in range(n)], axis=1)
    z = np.nan_to_num(windows.mean / np.maximum(sizes, 1e-300))
    looked = np.flatnonzero(combined(z) > LOOKED_AT)
    if len(looked) == 0:
        return z
    whole = _neighbours(windows, looked, [*range(2 * n)])[0]
    for j in range(n):
        place, far = _neighbours(windows, looked, [j])
        motion, farther = _neighbours(windows, looked, [n + j, 2 * n + j])
        load, farthest = _neighbours(windows, looked, [3 * n + j])
        size = sizes[looked, j] * np.max([far, farther, farthest], axis=0)
        z[looked, j] = _compared(
            windows.mean[:, j], size, looked, [whole, place, motion, load]
        )
    return z


def _compared(m: Array, size: Array, looked: Index, likes: Sequence[Index]) -> Array:
    """Robust sigmas (L,) of some windows' means of m (W,) beside each set of like windows."""
    rest = m[looked]
    for index in likes:
        near = np.where(index >= 0, m[index], np.nan)
        count = np.count_nonzero(np.isfinite(near), axis=1)
        median = np.where(count >= FEWEST, _medians(near, count), 0.0)
        deviation = _medians(np.abs(near - median[:, None]), count)
        size = np.maximum(size, np.where(count >= FEWEST, PER_MEDIAN * deviation, 0.0))
        shifted = m[looked] - median
        rest = np.where(np.abs(shifted) < np.abs(rest), shifted, rest)
    return np.asarray(np.nan_to_num(rest / np.maximum(size, 1e-300)))


def combined(z: Array) -> Array:
    """Score (W,) of windows from z (W, n): the largest of one joint or of the first k together."""
    k = np.arange(2, z.shape[1] + 1)
    # Normal deviate of a chi square with k degrees of freedom (Wilson and Hilferty
    # 1931).
    spread = 2.0 / (9.0 * k)
    deviate = (np.cbrt(np.cumsum(z**2, axis=1)[:, 1:] / k) - 1.0 + spread) / np.sqrt(
        spread
    )
    return np.asarray(np.max(np.hstack([np.abs(z), deviate]), axis=1))


def _neighbours(
    windows: Windows, looked: Index, columns: list[int]
) -> tuple[Index, Array]:
    """Windows (L, NEIGHBOURS) nearest to some in columns of the state, -1 where too near in time.

    And how remote each of those looked at is (L,): 1 where its neighbours are as near
    as usual, more beyond what other windows have seen. Only every few windows serve as
    references: they overlap, and logs may be long.
    """
    stride = max(OVERLAP, len(windows.centre) // MOST_REFERENCES)
    reference, state = (
        np.arange(0, len(windows.centre), stride),
        windows.state[:, columns],
    )
    overlapping = 2 * int(np.ceil(BLOCK_S * OVERLAP / windows.length_s / stride))
    asked = [*range(1, min(NEIGHBOURS + overlapping, len(reference)) + 1)]
    tree = cKDTree(state[reference])
    distance, at = tree.query(state[looked], k=asked)
    index = reference[at]
    close = np.abs(windows.centre[index] - windows.centre[looked, None]) < BLOCK_S
    close &= windows.scene[index] == windows.scene[looked, None]
    order = np.argsort(close, axis=1, kind="stable")[:, :NEIGHBOURS]
    picked: Index = np.take_along_axis(np.where(close, -1, index), order, axis=1)
    reached = np.median(np.take_along_axis(np.asarray(distance), order, axis=1), axis=1)
    usual = np.quantile(
        np.median(tree.query(state[reference], k=asked)[0], axis=1), USUAL
    )
    return picked, np.maximum(1.0, reached / max(float(usual), 1e-300))


def _medians(values: Array, count: Index) -> Array:
    """Medians (L,) of the `count` numbers of each row; NaN come last in order."""
    ordered = np.sort(values, axis=1)
    low, high = (
        np.maximum(count - 1, 0) // 2,
        np.minimum(count // 2, values.shape[1] - 1),
    )
    row = np.arange(len(values))
    return np.asarray(0.5 * (ordered[row, low] + ordered[row, high]))


def _class_size(windows: Windows, j: int) -> Array:
    """Robust size (W,) of the means of joint j in windows of like speed and like reversals."""
    m, known = windows.mean[:, j], np.isfinite(windows.mean[:, j])
    if np.count_nonzero(known) < FEWEST:
        return np.full(len(m), np.inf)
    edges = np.quantile(windows.speed[known, j], np.linspace(0, 1, SPEEDS + 1)[1:-1])
    speed, size = np.searchsorted(edges, windows.speed[:, j]), np.zeros(len(m))
    for members in (*(speed == k for k in range(SPEEDS)), *windows.reverses.T):
        inside = np.abs(m[members & known])
        if len(inside):
            median, most = np.quantile(inside, (0.5, 0.9))  # of bursts as well
            few = len(inside) < FEWEST
            own = np.max(inside) if few else max(PER_MEDIAN * median, most / MOST)
            size[members] = np.maximum(size[members], own)
    return size


def places(number: int, scored: Sequence[tuple[Windows, Array]]) -> list[Interval]:
    """Where one data set stands out, over windows of all lengths with their scores."""
    found = list[Interval]()
    for windows, z in scored:
        here = windows.scene == number
        found += _joined(number, windows.length_s, z[here], windows.centre[here])
    return _merged(found)


def _joined(number: int, length_s: float, z: Array, centre: Array) -> list[Interval]:
    """Peaks above the gate with the windows around that reach a share of their height."""
    score, found, margin = combined(z), list[Interval](), 0.25 * length_s
    while len(score) and float(np.max(score)) > GATE:
        peak = int(np.argmax(score))
        top = float(score[peak])
        along = score * (np.abs(centre - centre[peak]) < LONGEST_S) > EDGE_SHARE * top
        first, stop = next((a, b) for a, b in runs(along, len(along)) if a <= peak < b)
        weight = np.abs(z[first:stop]).max(axis=0)
        joints = np.flatnonzero(weight > 0.5 * max(GATE, weight.max())).tolist()
        start, end = (
            max(float(centre[first]) - margin, 0.0),
            float(centre[stop - 1]) + margin,
        )
        if end - start <= LONGEST_S:
            joints = joints or [int(np.argmax(weight))]
            found.append(Interval(number, start, end, tuple(joints), top))
        score[max(first - 2, 0) : stop + 2] = 0.0
    return found


def _merged(found: Sequence[Interval]) -> list[Interval]:
    """Join what overlaps, to the interval of the higher score, and what nearly touches."""
    kept: list[Interval] = []
    for event in sorted(found, key=lambda e: -e.score):
        apart = [max(event.start - e.end, e.start - event.end) for e in kept]
        k = int(np.argmin(apart)) if kept else 0
        if not kept or apart[k] >= LENGTHS_S[0]:
            kept.append(event)
            continue
        old, start, end = kept[k], kept[k].start, kept[k].end
        wide = min(start, event.start), max(end, event.end)
        if apart[k] >= 0.0 and wide[1] - wide[0] <= LONGEST_S:
            start, end = wide
        joints = tuple(sorted({*old.joints, *event.joints}))
        kept[k] = Interval(event.scene, start, end, joints, old.score)
    return sorted(kept, key=lambda e: e.start)
