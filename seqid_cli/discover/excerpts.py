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

from seqid_cli.discover.survey import events
from seqid_cli.discover.survey.rows import BLOCK_S, SAMPLES_PER_CUTOFF
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, Predictor, predict
from seqid_cli.identify.regression.equations import open_if_long
from seqid_cli.inspect.screening import sound
from seqid_cli.logs.long import likely_rows
from seqid_cli.logs.pieces import Range, by_log, cut, read_pieces, whole_of
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording, Whole
from seqid_cli.logs.storage.remote import StoredLog, local_copy
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.torque import TorqueModel, known_rotors
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

# kept samples, at least, within which places are compared with each other
SPAN = 60_000
OVERLAP_S = 2.0  # between spans
PLACES_OF_LOG = 12  # of one log


@dataclass(frozen=True)
class ResidualSurvey:
    """What a pass over one log remembers, much of it by block (B) of `BLOCK_S`."""

    path: Path
    whole: Whole
    samples: int
    rate_hz: float
    kind: str  # file format; empty for a log that is read as a whole
    # (B, n) sum of the squared residual [(N m)^2] where a joint certainly slides
    squares: Array
    counts: Array  # (B, n) samples of that
    travel: Array  # (B, n, 2) way [rad] that a joint slides forward and backward
    usable: Array  # (B,) samples without a gap, once the filters have settled
    # where the residual stands out, the strongest first
    places: tuple[events.Interval, ...]


def residual_survey(
    log: Recording | SurveyedLog,
    number: int = 0,
    *,
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
) -> ResidualSurvey:
    """Pass over one log with torque; which `number` of a set it is makes no difference.

    The motion is that of the encoders. Of a log that is passed over, the model has
    those of its effects that can be told part by part. Raises InputError: the log
    carries neither torque nor current, or no stretch is long enough to filter.
    """
    del number
    model = TorqueModel.from_stages(stages, robot)
    n, seen, held, tracks = robot.n, 0, 0, list[events.Track]()
    blocks, sums, found = list[Index](), list[Array](), list[events.Interval]()
    for part in _parts(log, robot, stages, options):
        left, counts = part.tau - part.predicted, part.sliding & part.used[:, None]
        step = float(part.t[1] - part.t[0]) if len(part.t) > 1 else 0.0
        block, own = _block_sums(part, np.where(counts, left, 0.0), counts, step)
        blocks.append(block)
        sums.append(own)
        stride = 1.0 / (SAMPLES_PER_CUTOFF * part.cutoff_hz * max(step, 1e-9))
        # the stride of a rate that is known from its steps
        every = max(1, int(stride + 1e-6))
        kept = np.arange(-seen % every, len(part.t), every)
        tracks.append(_track(model, part, np.where(counts, left, np.nan), kept))
        seen, held = seen + len(part.t), held + len(kept)
        if held >= 2 * SPAN:
            whole = events.joined(tracks)
            found += _standing_out(whole[:SPAN])
            rest = np.searchsorted(whole.t, whole.t[SPAN - 1] - OVERLAP_S)
            tracks, held = [whole[int(rest) :]], len(whole.t) - int(rest)
    found += _standing_out(events.joined(tracks))
    at = np.concatenate(blocks)
    table = np.zeros((int(at.max()) + 1, 4 * n + 1))
    np.add.at(table, at, np.concatenate(sums))
    return ResidualSurvey(
        path=log.path,
        whole=whole_of(log),
        samples=log.samples if isinstance(log, SurveyedLog) else len(log.t),
        rate_hz=log.rate_hz,
        kind=log.format if isinstance(log, SurveyedLog) else "",
        squares=table[:, :n],
        counts=table[:, n : 2 * n],
        travel=table[:, 2 * n : 4 * n].reshape(-1, 2, n).swapaxes(1, 2),
        usable=table[:, -1],
        places=_strongest(found),
    )


def _parts(
    log: Recording | SurveyedLog, robot: Robot, stages: Stages, options: InertiaOptions
) -> Iterable[LogPrediction]:
    options = replace(options, source="encoder")
    if not isinstance(log, SurveyedLog):
        return predict([log], robot, stages, options=options, unexplained=True)
    effects = [x for x in fitted_effects(stages, robot, unexplained=True) if x.local]
    return Predictor(TorqueModel.from_stages(stages, robot), stages, options, effects)(
        log, 0
    )


def _block_sums(
    part: LogPrediction, left: Array, counts: Mask, step: float
) -> tuple[Index, Array]:
    """Blocks (K,) of a part, and sums (K, 4 n + 1): squares, counts, ways, usable samples."""
    block = (part.t / BLOCK_S).astype(np.intp)
    starts = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    way = np.where(counts, part.dq * step, 0.0)
    every = [
        left**2,
        counts,
        np.maximum(way, 0.0),
        np.maximum(-way, 0.0),
        part.used[:, None],
    ]
    return block[starts], np.add.reduceat(np.hstack(every), starts, axis=0)


def _track(
    model: TorqueModel, part: LogPrediction, left: Array, at: Index
) -> events.Track:
    """Some samples of a part with their residual (N, n), NaN where a joint does not count."""
    q, dq, ddq = part.q[at], part.dq[at], part.ddq[at]
    rotor = known_rotors(model.robot) if model.rotor is None else model.rotor
    load = model.rigid(q, dq, ddq) - gear_ratios(model.robot) ** 2 * rotor * ddq
    return events.Track(
        part.t[at], np.stack([q, dq, ddq, load, left[at]]), part.cutoff_hz
    )


def _standing_out(track: events.Track) -> list[events.Interval]:
    """Places of one span at which the residual stands out."""
    if len(track.t) < SAMPLES_PER_CUTOFF or not np.isfinite(track.values[-1]).any():
        return []
    every = (events.windows_of([track], length) for length in events.LENGTHS_S)
    return events.places(
        0, [(some, events.scores(some)) for some in every if len(some.centre)]
    )


def _strongest(found: Iterable[events.Interval]) -> tuple[events.Interval, ...]:
    """The strongest places, each once: spans overlap."""
    kept: list[events.Interval] = []
    for place in sorted(found, key=lambda p: -p.score):
        if all(place.end < other.start or place.start > other.end for other in kept):
            kept.append(place)
    return tuple(kept[:PLACES_OF_LOG])


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
    """What is diagnosed: whole logs, or excerpts."""

    recordings: tuple[Recording, ...]
    about_places: int = 0  # excerpts about places that stand out
    seconds: float = 0.0  # of the other ones
    # of long logs; without any all logs are held
    surveys: tuple[ResidualSurvey, ...] = ()

    def notes(self, robot: Robot) -> tuple[str, ...]:
        """Say how much of the logs is in the excerpts, and what the passes over them told."""
        if not self.surveys:
            return ()
        whole = sum(survey.whole.length for survey in self.surveys)
        about = (
            f" and {self.about_places} about places that stand out"
            if self.about_places
            else ""
        )
        said = (
            f"too long to be held: of {whole:.0f} s {self.seconds:.0f} s were looked"
            f" at, in {len(self.recordings) - self.about_places} pieces spread over the"
            f" time and varied in motion{about}; the rest was passed over once"
        )
        counts = sum(survey.counts.sum(axis=0) for survey in self.surveys)
        squares = sum(survey.squares.sum(axis=0) for survey in self.surveys)
        every = zip(robot.joints, squares, counts, strict=True)
        known = [
            f"{x.name} {np.sqrt(s / c):.3g} {x.unit('N m')}" for x, s, c in every if c
        ]
        of_all = (
            "RMS residual of all logs as a whole, where joints slide:"
            f" {', '.join(known)}"
        )
        return (said, of_all, *_time_notes(self.surveys, robot))


def take_excerpts(
    recordings: LogSet | Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    most_values: int = MOST_VALUES,
    places: bool = True,
) -> Excerpts:
    """Hold logs with torque, or excerpts of them where they are too long.

    Long logs of a `LogSet` are passed over instead of read. `most_values`: samples
    times joints that are held, as `MOST_VALUES` counts them. `places`: whether places
    that stand out are wanted. Raises InputError: a log cannot be read or carries
    neither torque nor current.
    """
    channels = sum(len(imu.positions) + 3 * imu.gyro for imu in robot.imus)
    most = most_values / (robot.n + ARM + CHANNEL * channels)
    survey = partial(residual_survey, robot=robot, stages=stages, options=options)
    logs: Sequence[Path | Recording]
    clock: TimeSource = "header"
    if isinstance(recordings, LogSet) and sum(map(_likely, recordings.logs)) > most:
        logs, clock = recordings.logs, recordings.time_source
        surveys = tuple(
            recordings.mapped(survey, partial(open_if_long, least=PASSED_OVER))
        )
        if sum(_size(one.samples, one.rate_hz) for one in surveys) <= most:
            return Excerpts(tuple(recordings.again(imus=stages.imu is not None)))
    else:
        held = tuple(recordings)
        if sum(_size(len(log.t), log.rate_hz) for log in held) <= most:
            return Excerpts(held)
        logs, surveys = held, tuple(map(survey, held))
    share = most / sum(_size(one.samples, one.rate_hz) for one in surveys)
    ranges = excerpts_of(surveys, share * sum(one.samples for one in surveys))
    extra = about_places(surveys, ranges) if places else [[] for _ in surveys]
    found = list[Recording]()
    for log, one, own, more in zip(logs, surveys, ranges, extra, strict=True):
        if own or more:
            found += _read(log, one, sorted([*own, *more]), robot, clock)
    seconds = sum(high - low for own in ranges for low, high in own)
    return Excerpts(tuple(found), sum(map(len, extra)), seconds, surveys)


def by_digest(recordings: Sequence[Recording]) -> dict[str, list[Recording]]:
    """Recordings, or the excerpts of each log, by the log's SHA-256."""
    found: dict[str, list[Recording]] = {}
    for recording in recordings:
        found.setdefault(whole_of(recording).sha256, []).append(recording)
    return found


def one_each(held: Excerpts) -> list[Recording]:
    """One recording of every log: what holds of an excerpt's sensors holds of the log's."""
    return [pieces[-1] for pieces in by_log(held.recordings)]


def _size(samples: int, rate_hz: float) -> float:
    """Samples of a log, and what its seconds count as."""
    return samples * (1.0 + PER_SECOND / rate_hz)


def _likely(log: Path | Recording) -> int:
    """Rows of a local log; of a stored one so many that it is passed over."""
    if isinstance(log, Recording):
        return len(log.t)
    return MOST_VALUES if isinstance(log, StoredLog) else likely_rows(log)


def _read(
    log: Path | Recording,
    one: ResidualSurvey,
    some: list[Range],
    robot: Robot,
    clock: TimeSource,
) -> list[Recording]:
    if isinstance(log, Recording):
        return cut(log, some)
    with local_copy(log) as file:
        check = partial(sound, robot=robot)
        given = Path(file), robot, one.whole, some
        found = read_pieces(*given, time_source=clock, kind=one.kind, sound=check)
    return [replace(piece, path=log) for piece in found]


def about_places(
    surveys: Sequence[ResidualSurvey], ranges: Sequence[Sequence[Range]]
) -> list[list[Range]]:
    """Excerpts, per log, about the strongest places that stand out and lie in none of `ranges`."""
    places = [(place, k) for k, survey in enumerate(surveys) for place in survey.places]
    result: list[list[Range]] = [[] for _ in surveys]
    for place, k in sorted(places, key=lambda found: -found[0].score):
        inner = [
            (low + INNER_S, high - INNER_S) for low, high in (*ranges[k], *result[k])
        ]
        inside = any(low <= place.start and place.end <= high for low, high in inner)
        if not inside and sum(map(len, result)) < MOST_PLACES:
            low, high = place.start - ABOUT_S, place.end + ABOUT_S
            result[k].append((max(low, 0.0), min(high, surveys[k].whole.length)))
    return result


def _time_notes(surveys: Sequence[ResidualSurvey], robot: Robot) -> Iterator[str]:
    """The residual in parts of the time, where it has changed from the first to the last."""
    for survey in (one for one in surveys if len(one.squares) >= TENTHS):
        starts = np.linspace(0, len(survey.squares), TENTHS + 1).astype(int)[:-1]
        squares, counts = (
            np.add.reduceat(x, starts) for x in (survey.squares, survey.counts)
        )
        parts = np.sqrt(squares / np.maximum(counts, 1.0))
        early, late = parts[:ENDS].mean(axis=0), parts[-ENDS:].mean(axis=0)
        low, high = np.minimum(early, late), np.maximum(early, late)
        for j in np.flatnonzero((low > 0.0) & (high > CHANGES * low)).tolist():
            numbers, name = (
                " ".join(f"{x:.3g}" for x in parts[:, j]),
                robot.joint_names[j],
            )
            yield (
                f"{survey.path}: RMS residual of {name} in tenths of the time:"
                f" {numbers}"
            )


def excerpts_of(
    logs: Sequence[ResidualSurvey], samples: float, *, most: int = 16
) -> list[list[Range]]:
    """Choose at most `most` excerpts, of about so many samples together; per log, by time."""
    total, lengths = (
        sum(log.samples for log in logs),
        [log.whole.length for log in logs],
    )
    if total <= samples:
        return [[(0.0, length)] for length in lengths]
    seconds = samples * sum(lengths) / total
    count = int(np.clip(round(seconds / PIECE_S), 1, most))
    # Another log tells more that is new than more of the same one.
    weight = np.cumsum(np.sqrt(lengths))
    parts = np.diff(np.round(count * weight / weight[-1]), prepend=0.0).astype(int)
    return [
        list(_of_log(log, k, seconds / count))
        for log, k in zip(logs, parts, strict=True)
    ]


def _of_log(log: ResidualSurvey, parts: int, length: float) -> Iterator[Range]:
    """The excerpt of most travel in each part of a log, of this length or of the whole log's."""
    whole = max(log.whole.length, 1e-9)
    piece, parts = min(length, whole), min(parts, max(1, int(whole / length)))
    size = max(1, round(piece / BLOCK_S))
    blocks = np.column_stack([log.travel.reshape(len(log.travel), -1), log.usable])
    sums = np.vstack([np.zeros(blocks.shape[1]), np.cumsum(blocks, axis=0)])
    ahead = np.minimum(np.arange(len(sums)) + size, len(blocks))
    # (B + 1, k), over the blocks of an excerpt from each on
    within = sums[ahead] - sums
    most = np.max(within[: max(1, len(blocks) - size + 1), -1])
    for low, high in pairwise(np.linspace(0.0, whole, parts + 1)):
        starts = np.arange(low, max(high - piece, low) + 1e-9, BLOCK_S)
        found = within[(starts / BLOCK_S).astype(np.intp)]
        worth = np.sqrt(np.maximum(found[:, :-1], 0.0)).sum(axis=1)
        worth[found[:, -1] < WHOLE * most] = -1.0
        if worth.max() >= 0.0:
            start = float(starts[np.argmax(worth)])
            yield start, start + piece
