"""Events: short stretches of a log in which something from outside pushed the arm.

The residual's mean over a short window is compared with what such windows show
elsewhere: with windows of like speed, with all those in which a joint reverses, and
with the nearest ones in state (same place, same motion or same load of this joint, same
state of all joints). What the model does not know of friction, gears or load recurs
there and so is no event; a push does not. A state that is seen once tells nothing. A
push on link k moves the joints up to k, so their evidence is taken together.

A push of seconds fills so much of a log that its own windows would tell what is usual.
Stretches in which far more is left than elsewhere (`survey.stretches`) are no measure
of others, and none of their windows is compared with the same stretch. A shorter push
fills what few windows are alike: none is compared with what is near it in time.

    z_w = min_c |m_w - med_c| / max_c s_c

m_w is the mean of the residual over the window, med_c and s_c median and robust size of
such means over the comparison c; s is of unit size for Gaussian noise, so z counts
robust sigmas.

In shapes, M is the number of kept samples of a log, W the number of windows, L that of
the windows which are looked at closely, and n the number of joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.discover.settings import EventSettings
from seqid_cli.discover.survey.repeats import BLOCK_S, SAMPLES_PER_CUTOFF
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.discover.survey.stretches import (
    EDGE_S,
    Stretch,
    largest_part,
    long_stretches,
    sharpened,
    usual_squares,
)
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.robust import PER_MEDIAN, rms
from seqid_cli.typing import Array, Index, Mask

# ---- windows

OVERLAP = 4  # windows that cover each moment
USED = 0.6  # share of a window's samples that must count
STEEP = 0.1  # of the largest speed: below it directions and reversals are told apart


@dataclass(frozen=True)
class Track:
    """Samples of one log, and what each joint does there.

    Attributes
    ----------
    t : (M,) array
        Time since the log's start [s].
    values : (5, M, n) array
        Position, velocity, acceleration, load, and the residual, which is NaN where a
        joint does not count.
    cutoff_hz : float
        Cut-off of the log's low-pass.
    """

    t: Array
    values: Array
    cutoff_hz: float

    @property
    def residual(self) -> Array:
        """The residual (M, n)."""
        return np.asarray(self.values[-1])

    def __getitem__(self, samples: slice) -> "Track":
        """Return some of the samples."""
        return Track(
            t=self.t[samples],
            values=self.values[:, samples],
            cutoff_hz=self.cutoff_hz,
        )


def joined(tracks: Sequence[Track]) -> Track:
    """Join tracks of one log, one after the other."""
    return Track(
        t=np.concatenate([track.t for track in tracks]),
        values=np.concatenate([track.values for track in tracks], axis=1),
        cutoff_hz=tracks[0].cutoff_hz,
    )


def tracks_of(rows: Rows, left_out: Sequence[Array]) -> list[Track]:
    """Return the kept samples of every data set with the residual in its rows.

    Parameters
    ----------
    rows : Rows
        The rows of all data sets.
    left_out : sequence of (M_j,) arrays
        Each joint's residual in units of its noise, on blocks left out of the fit.
    """
    n_rows = np.array([used.sum(axis=0) for used in rows.used])
    ends = np.cumsum(n_rows, axis=0)
    by_joint = [np.split(left_out[j], ends[:-1, j]) for j in range(rows.n)]

    tracks: list[Track] = []
    for number, scene in enumerate(rows.scenes):
        samples = rows.samples[number]
        used = rows.used[number]
        residual = np.full(used.shape, np.nan)
        for joint, parts in enumerate(by_joint):
            residual[used[:, joint], joint] = parts[number]

        motion = scene.motion
        values = [
            motion.q[samples],
            motion.dq[samples],
            motion.ddq[samples],
            scene.load[samples],
            residual,
        ]
        tracks.append(
            Track(
                t=motion.t[samples] - motion.t[0],
                values=np.stack(values),
                cutoff_hz=motion.lowpass.cutoff_hz,
            )
        )
    return tracks


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Windows of one length over all data sets.

    Attributes
    ----------
    length_s : float
        Length of each window.
    `scene` : (W,) index array
        The data set of each.
    centre : (W,) array
        Its middle since the start of the log [s].
    mean : (W, n) array
        Mean of the scaled residual; NaN where too few samples count.
    state : (W, 4 n) array
        Means of position, speed, acceleration and load of each joint. `windows_of`
        scales each to unit spread.
    speed : (W, n) array
        Mean speed of each joint [rad/s; m/s].
    reverses : (W, 2 n) mask
        Whether each joint's velocity and each joint's load change sign.
    stretch : (W,) index array
        Number of the stretch that reaches into it, -1 for none.
    """

    length_s: float
    scene: Index
    centre: Array
    mean: Array
    state: Array
    speed: Array
    reverses: Mask
    stretch: Index


def windows_of(
    tracks: Sequence[Track],
    length_s: float,
    stretches: Sequence[Sequence[Stretch]] = (),
) -> Windows:
    """Cut logs into overlapping windows of one length.

    Windows in which no joint counts are left out.

    Parameters
    ----------
    tracks : sequence of Track
        By log.
    length_s : float
        Length of a window [s].
    stretches : sequence of sequence of Stretch
        By log, where far more is left than elsewhere; empty for nowhere.
    """
    top_speed = np.max(
        [np.max(np.abs(track.values[1]), axis=0) for track in tracks], axis=0
    )
    top_speed = np.maximum(top_speed, 1e-12)
    parts = [
        _windows_of_track(number, track, top_speed, length_s)
        for number, track in enumerate(tracks)
    ]

    mean = np.concatenate([part.mean for part in parts])
    counts = np.isfinite(mean).any(axis=1)
    state = np.concatenate([part.state for part in parts])[counts]
    spread = np.std(state, axis=0) if len(state) else np.ones(state.shape[1])
    scene = np.concatenate([part.scene for part in parts])[counts]
    centre = np.concatenate([part.centre for part in parts])[counts]
    return Windows(
        length_s=length_s,
        scene=scene,
        centre=centre,
        mean=mean[counts],
        state=state / np.where(spread > 0, spread, 1.0),
        speed=np.concatenate([part.speed for part in parts])[counts],
        reverses=np.concatenate([part.reverses for part in parts])[counts],
        stretch=_stretch_at(scene, centre, 0.5 * length_s, stretches),
    )


def _stretch_at(
    scene: Index, centre: Array, half: float, stretches: Sequence[Sequence[Stretch]]
) -> Index:
    """Return the number of the stretch (W,) that reaches into windows, -1 for none."""
    number = np.full(len(scene), -1)
    count = 0
    for log, of_log in enumerate(stretches):
        for stretch in of_log:
            overlaps = (centre + half > stretch.start) & (centre - half < stretch.end)
            number[overlaps & (scene == log)] = count
            count += 1
    return number


def _windows_of_track(
    number: int, track: Track, top_speed: Array, length_s: float
) -> Windows:
    """Return the windows of one log, their state not scaled yet."""
    t = track.t
    q, v, a, load, residual = track.values
    sample_s = float(np.min(np.diff(t), initial=np.inf))
    start = np.arange(t[0], t[-1] - length_s + 1e-9, length_s / OVERLAP)
    low = np.searchsorted(t, start)
    high = np.searchsorted(t, start + length_s)

    # A reversal near the window reaches into it through the low-pass.
    reach = 0.5 / track.cutoff_hz
    wide_low = np.searchsorted(t, start - reach)
    wide_high = np.searchsorted(t, start + length_s + reach)
    turns = np.hstack([_sign_changes(v), _sign_changes(load)])

    # Slow motion is spread out: there friction differs most from speed to speed.
    state = np.hstack([q, np.arcsinh(v / (STEEP * top_speed)), a, load])
    return Windows(
        length_s=length_s,
        scene=np.full(len(start), number),
        centre=start + 0.5 * length_s,
        mean=_means(residual, low, high, fewest=USED * length_s / sample_s),
        state=_means(state, low, high, fewest=1.0),
        speed=_means(np.abs(v), low, high, fewest=1.0),
        reverses=_means(turns, wide_low, wide_high, fewest=1.0) > 0,
        stretch=np.full(len(start), -1),
    )


def _sign_changes(values: Array) -> Array:
    """Return one (M, k) where a sign differs from the row before, else zero."""
    sign = np.sign(values)
    return np.asarray(np.diff(sign, axis=0, prepend=sign[:1]) != 0, dtype=np.float64)


def _means(values: Array, low: Index, high: Index, *, fewest: float) -> Array:
    """Return means (W, k) of the finite values (M, k) in half-open ranges.

    They are NaN where fewer than `fewest` values are finite.
    """
    is_finite = np.isfinite(values)
    zero = np.zeros(values.shape[1])
    sums = np.vstack([zero, np.cumsum(np.where(is_finite, values, 0.0), axis=0)])
    counts = np.vstack([zero, np.cumsum(is_finite, axis=0)])
    total = sums[high] - sums[low]
    count = counts[high] - counts[low]
    return np.where(count >= max(fewest, 1.0), total / np.maximum(count, 1.0), np.nan)


# ---- events

LENGTHS_S = (0.15, 0.3, 0.6, 1.2, 2.4)
PARTS_S = 0.5  # between parts of one event, at most
FILLED = 0.5  # share of a stretch that must stand out of windows of like state
# robust sigmas within its class from which a window is compared with like ones
LOOKED_AT = 3.0
MOST_REFERENCES = 3000
EDGE_SHARE = 0.4  # of an event's peak, down to which it reaches
NEIGHBOURS = 24
SPEEDS = 4  # classes of speed
FEWEST = 8  # windows that a class must have to be one
USUAL = 0.95  # share of the windows whose neighbours count as near
MOST = 1.645  # magnitude that one in ten exceeds, per standard deviation


@dataclass(frozen=True, kw_only=True)
class Interval:
    """One event: a stretch of one data set.

    Attributes
    ----------
    `scene` : int
        Number of the data set.
    start, end : float
        Seconds since its first sample.
    joints : tuple of int
        Joints at which it stands out.
    score : float
        Robust sigmas of its peak.
    """

    scene: int
    start: float
    end: float
    joints: tuple[int, ...]
    score: float

    def certainty(self, min_sigma: float) -> float:
        """Return the probability by its score that no noise made it.

        It is a half at `min_sigma`, the least score of an event.
        """
        return float(1.0 - 0.5 ** (self.score / min_sigma) ** 2)

    def inside(self, scene: Scene, margin: float = 0.0) -> Mask:
        """Return which samples (N,) lie in it, or within a margin [s] of it."""
        t = scene.motion.t - scene.motion.t[0]
        return np.asarray((t >= self.start - margin) & (t <= self.end + margin))

    def squares(self, scene: Scene, residual: Array) -> float:
        """Return the squares of a residual (N, n) in it, where its joints slide."""
        sliding = np.where(scene.slides, residual, 0.0)[self.inside(scene)]
        return float(np.sum(sliding[:, list(self.joints)] ** 2))

    def energy(self, scene: Scene, scaled: Array) -> float:
        """Return the squares of its joints' residual beyond noise.

        Parameters
        ----------
        `scene` : `Scene`
            Its data set.
        scaled : (N, n) array
            Residual in units of each joint's noise.

        Returns
        -------
        float
            Sum over independent samples in it.
        """
        motion = scene.motion
        independent = SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz / motion.rate_hz
        of_joints = scaled[self.inside(scene)][:, list(self.joints)]
        return independent * float(np.sum(np.maximum(of_joints**2 - 1.0, 0.0)))


def with_edges(event: Interval, rows: Rows, residual: Array, sigma: Array) -> Interval:
    """Return an event from edge to edge, also where few of its samples count.

    Windows tell an event by the samples that count. Of a push at speeds at which
    friction was not identified these are a few pieces, but it is about as large at
    every sample at which its joints slide.

    Parameters
    ----------
    event : Interval
        The event, by its windows.
    rows : Rows
        The samples that count.
    residual : (N, n) array
        What is left in the event's data set [N m; N where prismatic].
    sigma : (n,) array
        What noise leaves of each joint [N m; N where prismatic].
    """
    scene = rows.scenes[event.scene]
    joints = list(event.joints)
    slides = scene.slides[:, joints]
    samples = rows.samples[event.scene]
    around = event.inside(scene, PARTS_S)[samples]
    n_counting = np.count_nonzero(rows.used[event.scene][around][:, joints])
    if n_counting >= USED * np.count_nonzero(slides[samples][around]):
        return event

    squares = np.where(slides, residual[:, joints] ** 2, np.nan)
    inside = event.inside(scene)
    is_shown = np.isfinite(squares[inside]).any(axis=0)
    if not is_shown.any():
        return event

    squares = squares[:, is_shown]
    size = np.nanmean(squares[inside], axis=0)
    least = np.maximum(EDGE_SHARE**2 * size, sigma[joints][is_shown] ** 2)
    near = np.flatnonzero(event.inside(scene, EDGE_S))
    part = largest_part(squares[near], least, inside[near])
    if part is None:
        return event
    t = scene.motion.t[near[part]] - scene.motion.t[0]
    return replace(event, start=float(t[0]), end=float(t[-1]))


def joined_pieces(
    events: Sequence[Interval],
    scenes: Sequence[Scene],
    residuals: Sequence[Array],
    longest_s: float,
) -> list[Interval]:
    """Return events of which the pieces of one push are one.

    Pieces overlap, or about as much is left between them: there few samples count, or
    the joints rest for a while.

    Parameters
    ----------
    events : sequence of Interval
        The events.
    `scenes` : sequence of `Scene`
        The data sets.
    residuals : sequence of (N, n) arrays
        What is left, by data set [N m; N where prismatic].
    longest_s : float
        Of a push that is joined of pieces.
    """
    joined: list[Interval] = []
    for event in sorted(events, key=lambda each: (each.scene, each.start)):
        earlier = joined[-1] if joined else None
        if (
            earlier is None
            or earlier.scene != event.scene
            or event.end - earlier.start > longest_s
            or not _is_one_push(
                earlier, event, scenes[event.scene], residuals[event.scene]
            )
        ):
            joined.append(event)
            continue

        joined[-1] = Interval(
            scene=event.scene,
            start=earlier.start,
            end=max(earlier.end, event.end),
            joints=tuple(sorted({*earlier.joints, *event.joints})),
            score=max(earlier.score, event.score),
        )
    return joined


def _is_one_push(
    earlier: Interval, event: Interval, scene: Scene, residual: Array
) -> bool:
    """Return whether two events of a log overlap, or as much is left between them."""
    if event.start <= earlier.end:
        return True
    t = scene.motion.t - scene.motion.t[0]
    between = (t > earlier.end) & (t < event.start)
    for joint in {*earlier.joints} & {*event.joints}:
        slides = scene.slides[:, joint]
        least = EDGE_SHARE * max(
            rms(residual[each.inside(scene) & slides, joint])
            for each in (earlier, event)
        )
        left_between = residual[between & slides, joint]
        if len(left_between) and rms(left_between) >= least:
            return True
    return False


def find_events(
    rows: Rows, left_out: Sequence[Array], settings: EventSettings = EventSettings()
) -> list[Interval]:
    """Find what stands out, unless it does so often.

    Parameters
    ----------
    rows : Rows
        The rows of all data sets.
    left_out : sequence of (M_j,) arrays
        Each joint's residual in units of its noise, on blocks left out of the fit.
    settings : EventSettings
        What counts as an event.

    Returns
    -------
    list of Interval
        By data set, then by time.
    """
    tracks = tracks_of(rows, left_out)
    events: list[Interval] = []
    for track, in_log in zip(tracks, standing_out(tracks, settings), strict=True):
        # Parts of one event are one occasion. A law that errs does so often.
        if len(_occasions(in_log)) <= settings.most_in(float(track.t[-1])):
            events += in_log
    return events


def standing_out(
    tracks: Sequence[Track], settings: EventSettings
) -> list[list[Interval]]:
    """Find where each of some logs stands out, however often it does.

    Parameters
    ----------
    tracks : sequence of Track
        By log; each has samples that count.
    settings : EventSettings
        What stands out.

    Returns
    -------
    list of list of Interval
        By log, by time.
    """
    usual = _usual_squares(tracks)
    stretches = _long_stretches(tracks, usual, settings)
    scored = []
    for length_s in LENGTHS_S:
        windows = windows_of(tracks, length_s, stretches)
        if len(windows.centre):
            scored.append((windows, scores(windows)))

    events_by_log = []
    for number, track in enumerate(tracks):
        in_log = places(number, scored, settings)
        for stretch in stretches[number]:
            whole = sharpened(stretch, track.residual, track.t, usual[number])
            joints = _joints_of(whole, track, usual[number])
            in_log = _with_stretch(in_log, whole, joints, number, scored)
        events_by_log.append(in_log)
    return events_by_log


def stretches_of(
    rows: Rows, residual: Sequence[Array], settings: EventSettings = EventSettings()
) -> list[list[Stretch]]:
    """Find stretches that may be long pushes in what the file leaves.

    Parameters
    ----------
    rows : Rows
        The rows of all data sets.
    residual : sequence of (M_j,) arrays
        What the file leaves of each joint's torque [N m; N where prismatic].
    settings : EventSettings
        What counts as an event.

    Returns
    -------
    list of list of Stretch
        By data set.
    """
    tracks = tracks_of(rows, residual)
    return _long_stretches(tracks, _usual_squares(tracks), settings)


def _usual_squares(tracks: Sequence[Track]) -> list[Array]:
    """Return by log the usual mean squares (n,) of the residual."""
    return usual_squares(
        [track.residual for track in tracks], [track.t for track in tracks]
    )


def _long_stretches(
    tracks: Sequence[Track], usual: Sequence[Array], settings: EventSettings
) -> list[list[Stretch]]:
    """Return by log the stretches in which far more is left than is usual (n,)."""
    return [
        long_stretches(track.residual, track.t, of_log, settings)
        for track, of_log in zip(tracks, usual, strict=True)
    ]


def _joints_of(stretch: Stretch, track: Track, usual: Array) -> set[int]:
    """Return the joints at which about as much of a stretch is left as at any.

    Joints may slide in turn while the arm is pushed, for less time than a window needs.
    """
    inside = (track.t >= stretch.start) & (track.t <= stretch.end)
    squares = track.residual[inside] ** 2
    counts = np.isfinite(squares)
    sums = np.sum(np.where(counts, squares, 0.0), axis=0)
    size = np.sqrt(sums / np.maximum(counts.sum(axis=0), 1) / usual)
    return set(np.flatnonzero(size > 0.5 * np.max(size)).tolist())


def _with_stretch(
    events: Sequence[Interval],
    stretch: Stretch,
    joints: set[int],
    number: int,
    scored: Sequence[tuple[Windows, Array]],
) -> list[Interval]:
    """Put one event in the place of those within a stretch that they fill.

    Parameters
    ----------
    events : sequence of Interval
        Of one data set.
    stretch : Stretch
        Where far more is left than elsewhere.
    joints : set of int
        Joints at which it is.
    number : int
        Of the data set.
    scored : sequence of (Windows, (W, n) array)
        Windows of every length over all data sets, with their `scores`.
    """
    inside = [
        event
        for event in events
        if event.start < stretch.end and event.end > stretch.start
    ]
    is_filled = False
    for windows, z in scored:
        middle = windows.centre
        in_stretch = (middle > stretch.start) & (middle < stretch.end)
        in_stretch &= windows.scene == number
        if in_stretch.any():
            stands_out = combined(z[in_stretch]) > LOOKED_AT
            is_filled |= bool(np.mean(stands_out) >= FILLED)
    if not inside or not is_filled:
        return list(events)

    whole = Interval(
        scene=number,
        start=stretch.start,
        end=stretch.end,
        joints=tuple(sorted(joints.union(*(event.joints for event in inside)))),
        score=max(event.score for event in inside),
    )
    others = [event for event in events if event not in inside]
    return sorted([*others, whole], key=lambda event: event.start)


def _occasions(events: Sequence[Interval]) -> list[tuple[float, float]]:
    """Return start and end of what stands out, events nearer than `PARTS_S` joined."""
    occasions: list[tuple[float, float]] = []
    for event in events:
        start, end = event.start, event.end
        if occasions and event.start - occasions[-1][1] <= PARTS_S:
            start, end = occasions.pop()
        occasions.append((start, max(end, event.end)))
    return occasions


def scores(windows: Windows) -> Array:
    """Return the robust sigmas (W, n), signed, by which every window stands out.

    They are zero where nothing is known. Only windows that stand out within their class
    are compared with those of like state: that takes most of the time.
    """
    n = windows.mean.shape[1]
    class_size = np.stack([_class_size(windows, j) for j in range(n)], axis=1)
    z = np.nan_to_num(windows.mean / np.maximum(class_size, 1e-300))
    suspects = np.flatnonzero(combined(z) > LOOKED_AT)
    if len(suspects) == 0:
        return z

    position = 0
    velocity = n
    acceleration = 2 * n
    load = 3 * n
    all_joints = _neighbours(windows, suspects, [*range(2 * n)])[0]
    for j in range(n):
        place, place_gap = _neighbours(windows, suspects, [position + j])
        motion, motion_gap = _neighbours(
            windows, suspects, [velocity + j, acceleration + j]
        )
        loaded, load_gap = _neighbours(windows, suspects, [load + j])

        # What is remote from all others may err by more than others show.
        gap = np.max([place_gap, motion_gap, load_gap], axis=0)
        z[suspects, j] = _compared(
            windows.mean[:, j],
            class_size[suspects, j] * gap,
            suspects,
            [all_joints, place, motion, loaded],
        )
    return z


def _compared(
    mean: Array, size: Array, suspects: Index, comparisons: Sequence[Index]
) -> Array:
    """Return the robust sigmas (L,) of some windows beside each set of like windows.

    Parameters
    ----------
    mean : (W,) array
        Means of all windows.
    size : (L,) array
        Robust size that the means have at least.
    suspects : (L,) index array
        The windows that are compared.
    comparisons : sequence of (L, k) index arrays
        Windows like each of them, -1 for none.
    """
    smallest = mean[suspects]
    for index in comparisons:
        like_means = np.where(index >= 0, mean[index], np.nan)
        count = np.count_nonzero(np.isfinite(like_means), axis=1)
        is_enough = count >= FEWEST
        median = np.where(is_enough, _medians(like_means, count), 0.0)
        deviation = _medians(np.abs(like_means - median[:, None]), count)
        size = np.maximum(size, np.where(is_enough, PER_MEDIAN * deviation, 0.0))

        shifted = mean[suspects] - median
        smallest = np.where(np.abs(shifted) < np.abs(smallest), shifted, smallest)
    return np.asarray(np.nan_to_num(smallest / np.maximum(size, 1e-300)))


def combined(z: Array) -> Array:
    """Return the score (W,) of windows from z (W, n).

    It is the largest of one joint, or of the first k joints together. Those are the
    normal deviate of a chi square with k degrees of freedom (Wilson and Hilferty 1931).
    """
    k = np.arange(2, z.shape[1] + 1)
    variance = 2.0 / (9.0 * k)
    mean_square = np.cumsum(z**2, axis=1)[:, 1:] / k
    deviate = (np.cbrt(mean_square) - 1.0 + variance) / np.sqrt(variance)
    return np.asarray(np.max(np.hstack([np.abs(z), deviate]), axis=1))


def _neighbours(
    windows: Windows, suspects: Index, columns: list[int]
) -> tuple[Index, Array]:
    """Find the windows nearest to some in columns of the state.

    Only every few windows serve as references: they overlap, and logs may be long.

    Returns
    -------
    (L, NEIGHBOURS) index array
        The nearest windows, -1 where one is too near in time.
    (L,) array
        How remote each window is: 1 where its neighbours are as near as usual, more
        beyond what other windows have seen.
    """
    from scipy.spatial import cKDTree

    n_windows = len(windows.centre)
    stride = max(OVERLAP, n_windows // MOST_REFERENCES)
    reference = np.arange(0, n_windows, stride)
    state = windows.state[:, columns]

    # Those too near in time may all be among the nearest: so many more are asked for.
    n_overlapping = 2 * int(np.ceil(BLOCK_S * OVERLAP / windows.length_s / stride))
    in_stretches = windows.stretch[reference][windows.stretch[reference] >= 0]
    n_overlapping += int(np.max(np.bincount(in_stretches), initial=0))
    n_asked = min(NEIGHBOURS + n_overlapping, len(reference))
    ranks = [*range(1, n_asked + 1)]
    tree = cKDTree(state[reference])
    distance, nearest = tree.query(state[suspects], k=ranks)
    index = reference[nearest]

    same_log = windows.scene[index] == windows.scene[suspects, None]
    apart_s = np.abs(windows.centre[index] - windows.centre[suspects, None])
    too_near = (apart_s < BLOCK_S) & same_log
    own_stretch = windows.stretch[suspects, None]
    too_near |= (windows.stretch[index] == own_stretch) & (own_stretch >= 0)
    order = np.argsort(too_near, axis=1, kind="stable")[:, :NEIGHBOURS]
    neighbours: Index = np.take_along_axis(np.where(too_near, -1, index), order, axis=1)

    reached = np.take_along_axis(np.asarray(distance), order, axis=1)
    median_reach = np.median(reached, axis=1)
    among_references = np.median(tree.query(state[reference], k=ranks)[0], axis=1)
    usual_reach = float(np.quantile(among_references, USUAL))
    return neighbours, np.maximum(1.0, median_reach / max(usual_reach, 1e-300))


def _medians(values: Array, count: Index) -> Array:
    """Return medians (L,) of the `count` numbers of each row; NaN come last."""
    ordered = np.sort(values, axis=1)
    low = np.maximum(count - 1, 0) // 2
    high = np.minimum(count // 2, values.shape[1] - 1)
    row = np.arange(len(values))
    return np.asarray(0.5 * (ordered[row, low] + ordered[row, high]))


def _class_size(windows: Windows, joint: int) -> Array:
    """Return the robust size (W,) of a joint's means in windows of like motion.

    Classes are four of speed, and one for each joint that reverses. The largest of a
    window's classes counts.
    """
    mean = windows.mean[:, joint]
    is_known = np.isfinite(mean) & (windows.stretch < 0)
    if np.count_nonzero(is_known) < FEWEST:
        return np.full(len(mean), np.inf)

    shares = np.linspace(0, 1, SPEEDS + 1)[1:-1]
    edges = np.quantile(windows.speed[is_known, joint], shares)
    speed_class = np.searchsorted(edges, windows.speed[:, joint])
    classes = [speed_class == number for number in range(SPEEDS)]
    classes += list(windows.reverses.T)

    size = np.zeros(len(mean))
    for members in classes:
        of_class = _sizes_at_other_times(windows, np.abs(mean), members, is_known)
        size[members] = np.maximum(size[members], of_class)
    return size


def _sizes_at_other_times(
    windows: Windows, magnitude: Array, members: Mask, is_known: Mask
) -> Array:
    """Return the robust size (members,) that each window of a class is compared with.

    A class may have few windows: those of one push would tell what is usual in it. So
    what is near a window in time is no measure of it, if enough is left without.

    Parameters
    ----------
    windows : Windows
        All windows.
    magnitude : (W,) array
        Of a joint's mean in each.
    members : (W,) mask
        Windows of the class.
    is_known : (W,) mask
        Windows that are a measure of others.
    """
    in_class = np.flatnonzero(members)
    references = np.flatnonzero(members & is_known)
    if len(references) == 0:
        return np.zeros(len(in_class))
    of_all = _robust_size(magnitude[references])
    sizes = np.full(len(in_class), of_all)

    # What is no more than usual beside its own moment does not stand out without it.
    block = np.floor(windows.centre / BLOCK_S).astype(np.intp)
    is_large = np.nan_to_num(magnitude[in_class]) > of_all
    large = in_class[is_large]
    for log, number in np.unique(
        np.stack([windows.scene[large], block[large]], axis=1), axis=0
    ).tolist():
        same_log = windows.scene[references] == log
        is_near = same_log & (np.abs(block[references] - number) <= 1)
        others = magnitude[references[~is_near]]
        if len(others) >= FEWEST:
            here = (windows.scene[in_class] == log) & (block[in_class] == number)
            sizes[here] = np.minimum(sizes[here], _robust_size(others))
    return sizes


def _robust_size(magnitude: Array) -> float:
    """Return the robust size of means of a magnitude (K,), K at least one."""
    if len(magnitude) < FEWEST:
        return float(np.max(magnitude))
    # Of bursts, which a median does not see, as well.
    ordered = np.sort(magnitude)
    median = _quantile(ordered, 0.5)
    one_in_ten = _quantile(ordered, 0.9)
    return max(PER_MEDIAN * median, one_in_ten / MOST)


def _quantile(ordered: Array, share: float) -> float:
    """Return a quantile of ordered numbers; they are too few for NumPy's to be fast."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    step = float(ordered[above] - ordered[below])
    return float(ordered[below]) + (place - below) * step


def places(
    number: int, scored: Sequence[tuple[Windows, Array]], settings: EventSettings
) -> list[Interval]:
    """Find where one data set stands out.

    Parameters
    ----------
    number : int
        Of the data set.
    scored : sequence of (Windows, (W, n) array)
        Windows of every length over all data sets, with their `scores`.
    settings : EventSettings
        What counts as an event.
    """
    peaks: list[Interval] = []
    for windows, z in scored:
        in_log = windows.scene == number
        centre = windows.centre[in_log]
        peaks += _peaks(number, windows.length_s, z[in_log], centre, settings)
    return _merged(peaks, settings.longest)


def _peaks(
    number: int, length_s: float, z: Array, centre: Array, settings: EventSettings
) -> list[Interval]:
    """Return peaks above the gate, with the windows around that belong to them."""
    score = combined(z)
    margin = 0.25 * length_s
    peaks: list[Interval] = []
    while len(score) and float(np.max(score)) > settings.min_sigma:
        peak = int(np.argmax(score))
        top = float(score[peak])

        # Windows around belong to it while they reach a share of its height.
        is_near = np.abs(centre - centre[peak]) < settings.longest
        is_high = np.where(is_near, score, 0.0) > EDGE_SHARE * top
        first, stop = next(
            (begin, end)
            for begin, end in runs(is_high, len(is_high))
            if begin <= peak < end
        )
        start = max(float(centre[first]) - margin, 0.0)
        end = float(centre[stop - 1]) + margin

        height = np.abs(z[first:stop]).max(axis=0)
        least_height = 0.5 * max(settings.min_sigma, height.max())
        joints = np.flatnonzero(height > least_height).tolist()
        if end - start <= settings.longest:
            # A push may stand out in several joints together and in none of them.
            joints = joints or [int(np.argmax(height))]
            peaks.append(
                Interval(
                    scene=number,
                    start=start,
                    end=end,
                    joints=tuple(joints),
                    score=top,
                )
            )
        score[max(first - 2, 0) : stop + 2] = 0.0
    return peaks


def _merged(peaks: Sequence[Interval], longest_s: float) -> list[Interval]:
    """Join what overlaps to the interval of the higher score, or nearly touches it."""
    merged: list[Interval] = []
    for event in sorted(peaks, key=lambda peak: -peak.score):
        gaps_s = [
            max(event.start - higher.end, higher.start - event.end) for higher in merged
        ]
        nearest = int(np.argmin(gaps_s)) if merged else 0
        if not merged or gaps_s[nearest] >= LENGTHS_S[0]:
            merged.append(event)
            continue

        higher = merged[nearest]
        start = min(higher.start, event.start)
        end = max(higher.end, event.end)
        touches = gaps_s[nearest] >= 0.0
        if not touches or end - start > longest_s:
            start, end = higher.start, higher.end
        merged[nearest] = Interval(
            scene=event.scene,
            start=start,
            end=end,
            joints=tuple(sorted({*higher.joints, *event.joints})),
            score=higher.score,
        )
    return sorted(merged, key=lambda event: event.start)
