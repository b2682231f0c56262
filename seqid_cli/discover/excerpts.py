"""What is diagnosed of logs of any length: all of them, or excerpts that memory bounds.

Logs that fit are held as they are. Of others a pass over each tells how the model's
residual runs: the torque is predicted part by part (see `identify.prediction`), and
kept are sums over short blocks of time, and the strongest places at which the residual
stands out against all others of a span of the log (see `survey.events`). Every log is
divided into as many parts as it is to have excerpts, so that whatever comes and goes
slowly (warm-up, a drift, a tool) is seen from the first to the last. In each part the
excerpt is taken in which the joints travel most,

    U = sum_j sum_d sqrt(s_jd),

s_jd being the way that joint j slides in direction d: a way of every joint counts for
more than the same way of one. The residual has no say in it: excerpts that were taken
because the model is wrong there would make it look more wrong than it is. Short ones
about places at which the residual stands out are added: there pushes may be.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from seqid_cli.discover.settings import EventSettings
from seqid_cli.discover.survey import events
from seqid_cli.discover.survey.repeats import BLOCK_S, SAMPLES_PER_CUTOFF
from seqid_cli.effects.fitted import fitted_effects
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, Predictor
from seqid_cli.inspect.screening import sound
from seqid_cli.logs.log_file import LogFile, likely_rows
from seqid_cli.logs.long import LongLog
from seqid_cli.logs.pieces import read_pieces
from seqid_cli.logs.read import read_both
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Range, Recording, Whole, by_log
from seqid_cli.logs.storage.remote import StoredLog, local_copy
from seqid_cli.model.torque import TorqueModel, known_rotors
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

# kept samples, at least, within which places are compared with each other
SPAN = 60_000
OVERLAP_S = 2.0  # between spans
PLACES_OF_LOG = 12  # of one log


@dataclass(frozen=True, kw_only=True)
class ResidualSurvey:
    """What a pass over one log remembers, much of it by block of `BLOCK_S`.

    Attributes
    ----------
    path : Path
        Of the log.
    whole : Whole
        Its start, length and digest.
    samples : int
        Number of its samples.
    rate_hz : float
        Of these.
    passed_over : bool
        Whether excerpts can be read without the rest of the log.
    squares : (B, n) array
        Sum of the squared residual [(N m)^2] where a joint certainly slides.
    counts : (B, n) array
        Samples of that.
    travel : (B, n, 2) array
        Way [rad; m] that a joint slides forward and backward.
    usable : (B,) array
        Samples without a gap, once the filters have settled.
    places : tuple of Interval
        Where the residual stands out, the strongest first.
    """

    path: Path
    whole: Whole
    samples: int
    rate_hz: float
    passed_over: bool
    squares: Array
    counts: Array
    travel: Array
    usable: Array
    places: tuple[events.Interval, ...]


def residual_survey(
    log: Recording | LongLog,
    number: int = 0,
    *,
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
    settings: EventSettings = EventSettings(),
) -> ResidualSurvey:
    """Pass over one log with torque.

    Parameters
    ----------
    log : Recording or LongLog
        The motion is that of its encoders. Of one that is passed over, the model has
        those of its effects that can be told part by part.
    number : int
        Which of a set it is; it makes no difference.
    robot : Robot
        The arm.
    stages : Stages
        The model.
    options : InertiaOptions
        How motion is low-passed.
    settings : EventSettings
        What stands out.

    Raises
    ------
    InputError
        The log carries neither torque nor current, or no stretch is long enough to
        filter.
    """
    del number
    model = TorqueModel.from_stages(stages, robot)
    n = robot.n
    blocks: list[Index] = []
    sums: list[Array] = []
    places = _PlacesInSpans(settings)
    n_samples = 0
    for part in _parts(log, robot, stages, options):
        residual = part.tau - part.predicted
        counts = part.sliding & part.used[:, None]
        sample_s = float(part.t[1] - part.t[0]) if len(part.t) > 1 else 0.0
        block, of_blocks = _block_sums(
            part, np.where(counts, residual, 0.0), counts, sample_s
        )
        blocks.append(block)
        sums.append(of_blocks)

        # Every so many samples of the log, whatever its parts are.
        wanted = 1.0 / (SAMPLES_PER_CUTOFF * part.cutoff_hz * max(sample_s, 1e-9))
        stride = max(1, int(wanted + 1e-6))  # of a rate that is known from its steps
        samples = np.arange(-n_samples % stride, len(part.t), stride)
        counted = np.where(counts, residual, np.nan)
        places.add(_track(model, part, counted, samples))
        n_samples += len(part.t)

    block_of_sum = np.concatenate(blocks)
    table = np.zeros((int(block_of_sum.max()) + 1, 4 * n + 1))
    np.add.at(table, block_of_sum, np.concatenate(sums))
    return ResidualSurvey(
        path=log.path,
        whole=log.whole,
        samples=log.samples,
        rate_hz=log.rate_hz,
        passed_over=isinstance(log, LongLog),
        squares=table[:, :n],
        counts=table[:, n : 2 * n],
        travel=table[:, 2 * n : 4 * n].reshape(-1, 2, n).swapaxes(1, 2),
        usable=table[:, -1],
        places=_strongest(places.finished()),
    )


class _PlacesInSpans:
    """Places of a log at which the residual stands out, looked for span by span."""

    def __init__(self, settings: EventSettings) -> None:
        self._settings = settings
        self._tracks: list[events.Track] = []
        self._n_samples = 0
        self._places: list[events.Interval] = []

    def add(self, track: events.Track) -> None:
        """Take in the next samples; a span is searched once another follows it."""
        self._tracks.append(track)
        self._n_samples += len(track.t)
        if self._n_samples < 2 * SPAN:
            return
        joined = events.joined(self._tracks)
        self._places += _standing_out(joined[:SPAN], self._settings)
        # The next span begins a little before the end of this one.
        first = int(np.searchsorted(joined.t, joined.t[SPAN - 1] - OVERLAP_S))
        self._tracks = [joined[first:]]
        self._n_samples = len(joined.t) - first

    def finished(self) -> list[events.Interval]:
        """Return the places of all spans."""
        last = _standing_out(events.joined(self._tracks), self._settings)
        return self._places + last


def _parts(
    log: Recording | LongLog, robot: Robot, stages: Stages, options: InertiaOptions
) -> Iterable[LogPrediction]:
    """Predict a log, part by part if it is not held."""
    effects = fitted_effects(stages, robot, unexplained=True)
    if isinstance(log, LongLog):
        effects = [effect for effect in effects if effect.local]
    predictor = Predictor(
        model=TorqueModel.from_stages(stages, robot),
        stages=stages,
        options=replace(options, source="encoder"),
        effects=effects,
    )
    return predictor(log, 0)


def _block_sums(
    part: LogPrediction, residual: Array, counts: Mask, sample_s: float
) -> tuple[Index, Array]:
    """Return the blocks (K,) of a part, and sums (K, 4 n + 1) over each.

    These are squares, counts, ways forward and backward, and usable samples.
    """
    block = (part.t / BLOCK_S).astype(np.intp)
    starts = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    travel = np.where(counts, part.dq * sample_s, 0.0)
    columns = [
        residual**2,
        counts,
        np.maximum(travel, 0.0),
        np.maximum(-travel, 0.0),
        part.used[:, None],
    ]
    return block[starts], np.add.reduceat(np.hstack(columns), starts, axis=0)


def _track(
    model: TorqueModel, part: LogPrediction, residual: Array, samples: Index
) -> events.Track:
    """Return some samples of a part; its residual (N, n) may be NaN."""
    q = part.q[samples]
    dq = part.dq[samples]
    ddq = part.ddq[samples]
    rotor = known_rotors(model.robot) if model.rotor is None else model.rotor
    load = model.rigid(q, dq, ddq) - gear_ratios(model.robot) ** 2 * rotor * ddq
    return events.Track(
        t=part.t[samples],
        values=np.stack([q, dq, ddq, load, residual[samples]]),
        cutoff_hz=part.cutoff_hz,
    )


def _standing_out(
    track: events.Track, settings: EventSettings
) -> list[events.Interval]:
    """Return the places of one span at which the residual stands out."""
    if len(track.t) < SAMPLES_PER_CUTOFF or not np.isfinite(track.values[-1]).any():
        return []
    (in_span,) = events.standing_out([track], settings)
    return in_span


def _strongest(places: Iterable[events.Interval]) -> tuple[events.Interval, ...]:
    """Return the strongest places, each once: spans overlap."""
    different: list[events.Interval] = []
    for place in sorted(places, key=lambda each: -each.score):
        if all(
            place.end < other.start or place.start > other.end for other in different
        ):
            different.append(place)
    return tuple(different[:PLACES_OF_LOG])


# two periods of most trajectories, and long beside what the filters lose
PIECE_S = 20.0
WHOLE = 0.9  # share of an excerpt that must be free of gaps
# What is held of logs, in samples times joints, if an arm counts as ARM joints more
# than it has, a channel of an IMU as CHANNEL of one, and every second as PER_SECOND
# samples more: a search takes half a kB for each of these at the log's own rate, and
# more than that for each second at the rate of the cut-off. Beside 0.3 GiB for the
# program that is 0.6 GiB at 1 kHz and 1.3 GiB at 125 Hz (seven joints, measured).
MOST_VALUES = 1_740_000
ARM, CHANNEL = 2.0, 0.36
PER_SECOND = 350
# samples from which on a log that does not fit is not held even once
PASSED_OVER = 50_000
MOST_PLACES = 6  # excerpts about places that stand out
ABOUT_S = 4.0  # on either side of such a place
INNER_S = 1.5  # of an excerpt, that its filters need before an event
# parts of the time; ratio of the last to the first ones
TENTHS, ENDS, CHANGES = 10, 3, 1.5


@dataclass(frozen=True)
class Excerpts:
    """What is diagnosed: whole logs, or excerpts.

    Attributes
    ----------
    recordings : tuple of Recording
        The logs, or the excerpts.
    about_places : int
        Number of excerpts about places that stand out.
    seconds : float
        Of the other ones together.
    surveys : tuple of ResidualSurvey
        Of long logs; without any all logs are held.
    """

    recordings: tuple[Recording, ...]
    about_places: int = 0
    seconds: float = 0.0
    surveys: tuple[ResidualSurvey, ...] = ()

    def notes(self, robot: Robot) -> tuple[str, ...]:
        """Say how much of the logs is in the excerpts, and what the passes told."""
        if not self.surveys:
            return ()
        total_s = sum(survey.whole.length for survey in self.surveys)
        n_pieces = len(self.recordings) - self.about_places
        beside = ""
        if self.about_places:
            beside = f" and {self.about_places} about places that stand out"
        extent = (
            f"too long to be held: of {total_s:.0f} s {self.seconds:.0f} s were looked"
            f" at, in {n_pieces} pieces spread over the"
            f" time and varied in motion{beside}; the rest was passed over once"
        )

        counts = sum(survey.counts.sum(axis=0) for survey in self.surveys)
        squares = sum(survey.squares.sum(axis=0) for survey in self.surveys)
        residuals = []
        for joint, square, count in zip(robot.joints, squares, counts, strict=True):
            if count:
                rms = np.sqrt(square / count)
                residuals.append(f"{joint.name} {rms:.3g} {joint.unit('N m')}")
        of_all = (
            "RMS residual of all logs as a whole, where joints slide:"
            f" {', '.join(residuals)}"
        )
        return (extent, of_all, *_time_notes(self.surveys, robot))


def take_excerpts(
    recordings: LogSet | Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    settings: EventSettings = EventSettings(),
    most_values: int = MOST_VALUES,
    places: bool = True,
) -> Excerpts:
    """Hold logs with torque, or excerpts of them where they are too long.

    Parameters
    ----------
    recordings : LogSet or iterable of Recording
        Long logs of a `LogSet` are passed over instead of read.
    robot : Robot
        The arm.
    stages : Stages
        The model.
    options : InertiaOptions
        How motion is low-passed.
    settings : EventSettings
        What stands out.
    most_values : int
        Samples times joints that are held, as `MOST_VALUES` counts them.
    places : bool
        Whether places that stand out are wanted.

    Raises
    ------
    InputError
        A log cannot be read, or carries neither torque nor current.
    """
    n_imu_channels = sum(len(imu.positions) + 3 * imu.gyro for imu in robot.imus)
    most_samples = most_values / (robot.n + ARM + CHANNEL * n_imu_channels)
    # It is sent to processes that read logs, with all that it decides by.
    survey = partial(
        residual_survey,
        robot=robot,
        stages=stages,
        options=options,
        settings=settings,
    )
    logs: Sequence[Path | Recording]
    reading = HEADER_STAMPS
    if isinstance(recordings, LogSet) and _is_long(recordings, most_samples):
        logs = recordings.logs
        reading = recordings.reading
        surveys = tuple(recordings.mapped(survey, PASSED_OVER))
        if _held_samples(surveys) <= most_samples:
            return Excerpts(tuple(recordings.again(imus=stages.imu is not None)))
    else:
        held = tuple(recordings)
        if sum(_size(len(log.t), log.rate_hz) for log in held) <= most_samples:
            return Excerpts(held)
        logs = held
        surveys = tuple(survey(log) for log in held)

    # Of the samples of all logs this share is held.
    share = most_samples / _held_samples(surveys)
    total_samples = sum(of_log.samples for of_log in surveys)
    ranges = excerpts_of(surveys, share * total_samples)
    extra: list[list[Range]] = [[] for _ in surveys]
    if places:
        extra = about_places(surveys, ranges)

    pieces: list[Recording] = []
    for log, of_log, chosen, added in zip(logs, surveys, ranges, extra, strict=True):
        if chosen or added:
            pieces += _read(log, of_log, sorted([*chosen, *added]), robot, reading)
    return Excerpts(
        recordings=tuple(pieces),
        about_places=sum(map(len, extra)),
        seconds=sum(stop - start for chosen in ranges for start, stop in chosen),
        surveys=surveys,
    )


def by_digest(recordings: Sequence[Recording]) -> dict[str, list[Recording]]:
    """Return recordings, or the excerpts of each log, by the log's SHA-256."""
    pieces_of: dict[str, list[Recording]] = {}
    for recording in recordings:
        pieces_of.setdefault(recording.whole.sha256, []).append(recording)
    return pieces_of


def one_each(held: Excerpts) -> list[Recording]:
    """Return one recording of every log: its sensors are those of all excerpts."""
    return [pieces[-1] for pieces in by_log(held.recordings)]


def _is_long(logs: LogSet, most_samples: float) -> bool:
    """Return whether logs are likely to hold more samples than may be held."""
    return sum(_likely_samples(log) for log in logs.logs) > most_samples


def _held_samples(surveys: Sequence[ResidualSurvey]) -> float:
    """Return what all logs count as if they are held."""
    return sum(_size(survey.samples, survey.rate_hz) for survey in surveys)


def _size(samples: int, rate_hz: float) -> float:
    """Return the samples of a log, and what its seconds count as."""
    return samples * (1.0 + PER_SECOND / rate_hz)


def _likely_samples(log: Path | Recording) -> int:
    """Return the rows of a local log; of a stored one what makes it passed over."""
    if isinstance(log, Recording):
        return len(log.t)
    return MOST_VALUES if isinstance(log, StoredLog) else likely_rows(log)


def _read(
    log: Path | Recording,
    survey: ResidualSurvey,
    ranges: list[Range],
    robot: Robot,
    reading: Reading,
) -> list[Recording]:
    """Read some stretches of a log."""
    if isinstance(log, Recording):
        return log.pieces(ranges)
    with local_copy(log) as copy:
        if survey.passed_over:
            pieces = read_pieces(
                LogFile.at(copy, reading=reading),
                robot,
                survey.whole,
                ranges,
                sound=partial(sound, robot=robot),
            )
        else:
            recording, raw = read_both(copy, robot, reading=reading)
            pieces = sound(recording, raw, robot).pieces(ranges)
    return [replace(piece, path=log) for piece in pieces]


def about_places(
    surveys: Sequence[ResidualSurvey], ranges: Sequence[Sequence[Range]]
) -> list[list[Range]]:
    """Return excerpts, per log, about the strongest places that stand out.

    Places that lie within `ranges`, the excerpts that are chosen already, need none.
    """
    places = [
        (place, number)
        for number, survey in enumerate(surveys)
        for place in survey.places
    ]
    places.sort(key=lambda pair: -pair[0].score)

    excerpts: list[list[Range]] = [[] for _ in surveys]
    for place, number in places:
        # The filters take a part of an excerpt to settle.
        is_covered = any(
            start + INNER_S <= place.start and place.end <= stop - INNER_S
            for start, stop in (*ranges[number], *excerpts[number])
        )
        n_excerpts = sum(map(len, excerpts))
        if not is_covered and n_excerpts < MOST_PLACES:
            start = max(place.start - ABOUT_S, 0.0)
            stop = min(place.end + ABOUT_S, surveys[number].whole.length)
            excerpts[number].append((start, stop))
    return excerpts


def _time_notes(surveys: Sequence[ResidualSurvey], robot: Robot) -> Iterator[str]:
    """Yield the residual in parts of the time, where the last differ from the first."""
    for survey in surveys:
        if len(survey.squares) < TENTHS:
            continue
        starts = np.linspace(0, len(survey.squares), TENTHS + 1).astype(int)[:-1]
        squares = np.add.reduceat(survey.squares, starts)
        counts = np.add.reduceat(survey.counts, starts)
        rms = np.sqrt(squares / np.maximum(counts, 1.0))
        early = rms[:ENDS].mean(axis=0)
        late = rms[-ENDS:].mean(axis=0)
        low = np.minimum(early, late)
        high = np.maximum(early, late)
        for joint in np.flatnonzero((low > 0.0) & (high > CHANGES * low)).tolist():
            numbers = " ".join(f"{value:.3g}" for value in rms[:, joint])
            yield (
                f"{survey.path}: RMS residual of {robot.joint_names[joint]} in tenths"
                f" of the time: {numbers}"
            )


def excerpts_of(
    logs: Sequence[ResidualSurvey], samples: float, *, most: int = 16
) -> list[list[Range]]:
    """Choose excerpts of about so many samples together.

    Parameters
    ----------
    logs : sequence of ResidualSurvey
        What the passes over the logs remember.
    samples : float
        Of all excerpts together.
    most : int
        Number of excerpts.

    Returns
    -------
    list of list of Range
        Per log, by time: start and end of each excerpt [s].
    """
    total = sum(log.samples for log in logs)
    lengths = [log.whole.length for log in logs]
    if total <= samples:
        return [[(0.0, length)] for length in lengths]

    seconds = samples * sum(lengths) / total
    count = int(np.clip(round(seconds / PIECE_S), 1, most))
    # Another log tells more that is new than more of the same one.
    weight = np.cumsum(np.sqrt(lengths))
    ends = np.round(count * weight / weight[-1])
    parts = np.diff(ends, prepend=0.0).astype(int)
    return [
        list(_excerpts_of_log(log, n_parts, seconds / count))
        for log, n_parts in zip(logs, parts, strict=True)
    ]


def _excerpts_of_log(log: ResidualSurvey, parts: int, length: float) -> Iterator[Range]:
    """Yield the excerpt of most travel in each part of a log.

    It has the given length [s], or that of the log where this is less.
    """
    log_s = max(log.whole.length, 1e-9)
    piece_s = min(length, log_s)
    parts = min(parts, max(1, int(log_s / length)))

    # (B + 1, k), travel and usable samples over the blocks of an excerpt from each on
    n_blocks = max(1, round(piece_s / BLOCK_S))
    blocks = np.column_stack([log.travel.reshape(len(log.travel), -1), log.usable])
    sums = np.vstack([np.zeros(blocks.shape[1]), np.cumsum(blocks, axis=0)])
    stop_block = np.minimum(np.arange(len(sums)) + n_blocks, len(blocks))
    within = sums[stop_block] - sums
    n_starts = max(1, len(blocks) - n_blocks + 1)
    most_usable = np.max(within[:n_starts, -1])

    for low, high in pairwise(np.linspace(0.0, log_s, parts + 1)):
        starts = np.arange(low, max(high - piece_s, low) + 1e-9, BLOCK_S)
        of_starts = within[(starts / BLOCK_S).astype(np.intp)]
        # A way of every joint counts for more than the same way of one.
        worth = np.sqrt(np.maximum(of_starts[:, :-1], 0.0)).sum(axis=1)
        worth[of_starts[:, -1] < WHOLE * most_usable] = -1.0
        if worth.max() >= 0.0:
            start = float(starts[np.argmax(worth)])
            yield start, start + piece_s
