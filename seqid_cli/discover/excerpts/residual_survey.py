"""Residual survey: one pass over a log of any length.

The torque is predicted part by part (see `identify.prediction`). Kept are sums over short blocks
of time, and the strongest places at which the residual stands out against all others of a span of
the log (see `survey.events`). None of it says what the model lacks. It says where to look (see
`design`).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from seqid_cli.discover.survey.event_windows import Track, windows_of
from seqid_cli.discover.survey.events import LENGTHS_S, Interval, standing_out
from seqid_cli.discover.survey.rows import BLOCK_S, SAMPLES_PER_CUTOFF
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, LongPrediction, predict
from seqid_cli.logs.pieces import whole_of
from seqid_cli.logs.recording import Recording, Whole
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.torque import TorqueModel, known_rotors
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

SPAN = 60_000  # kept samples, at least, within which places are compared with each other
OVERLAP_S = 2.0  # between spans
MOST_PLACES = 12  # of one log
SERIES = ("t", "q", "dq", "ddq", "load", "residual")  # of a track, sample by sample


@dataclass(frozen=True)
class ResidualSurvey:
    """What a pass over one log remembers.

    Attributes
    ----------
    path, whole
        The log.
    samples, rate_hz, kind
        Its length, rate and file format; `kind` is empty for one that is read as a whole.
    squares, counts : (B, n) arrays
        Sum of the squared residual [(N m)^2] over each `BLOCK_S`, and how many samples are in it;
        those at which a joint certainly slides.
    travel : (B, n, 2) array
        The way [rad] that each joint slides in each block, forward and backward.
    usable : (B,) array
        Samples of each block without a gap, once the filters have settled.
    places : tuple of Interval
        Where the residual stands out, the strongest first; s since the first sample.
    """

    path: Path
    whole: Whole
    samples: int
    rate_hz: float
    kind: str
    squares: Array
    counts: Array
    travel: Array
    usable: Array
    places: tuple[Interval, ...]


def residual_survey(
    log: Recording | SurveyedLog, robot: Robot, stages: Stages, *, options: InertiaOptions
) -> ResidualSurvey:
    """Pass over one log.

    Parameters
    ----------
    log : Recording or SurveyedLog
        With torque.
    robot : Robot
    stages : Stages
        The model, with its effects: of a log that is passed over, those that can be told part by
        part.
    options : InertiaOptions
        Cut-off; the motion is that of the encoders.

    Raises
    ------
    InputError
        If the log carries neither torque nor current, or no stretch is long enough to filter.
    """
    model = TorqueModel.from_stages(stages, robot)
    survey = _Survey(model)
    for part in _parts(log, robot, stages, model, options):
        survey.push(part)
    survey.end()
    sums = survey.table()
    n = robot.n
    streamed = isinstance(log, SurveyedLog)
    return ResidualSurvey(
        path=log.path,
        whole=whole_of(log),
        samples=log.samples if isinstance(log, SurveyedLog) else len(log.t),
        rate_hz=log.rate_hz,
        kind=log.format if streamed else "",
        squares=sums[:, :n],
        counts=sums[:, n : 2 * n],
        travel=sums[:, 2 * n : 4 * n].reshape(-1, 2, n).swapaxes(1, 2),
        usable=sums[:, -1],
        places=_strongest(survey.places),
    )


def _parts(
    log: Recording | SurveyedLog,
    robot: Robot,
    stages: Stages,
    model: TorqueModel,
    options: InertiaOptions,
) -> Iterable[LogPrediction]:
    options = replace(options, source="encoder")
    if not isinstance(log, SurveyedLog):
        return predict([log], robot, stages, options=options, unexplained=True)
    effects = [x for x in fitted_effects(stages, robot, unexplained=True) if x.local]
    return LongPrediction.of(log, model, stages, options, effects)


def _strongest(places: Iterable[Interval]) -> tuple[Interval, ...]:
    """The strongest places, each once: spans overlap."""
    kept: list[Interval] = []
    for place in sorted(places, key=lambda p: -p.score):
        if all(place.end < other.start or place.start > other.end for other in kept):
            kept.append(place)
    return tuple(kept[:MOST_PLACES])


@dataclass
class _Survey:
    """Takes the parts of a prediction one after the other."""

    model: TorqueModel
    sums: dict[int, Array] = field(default_factory=dict)  # (4 n + 1,) by block
    places: list[Interval] = field(default_factory=list)
    _tracks: list[Track] = field(default_factory=list)
    _held: int = 0
    _seen: int = 0

    def push(self, part: LogPrediction) -> None:
        """Take the next samples."""
        left, counts = part.tau - part.predicted, part.sliding & part.used[:, None]
        step = float(part.t[1] - part.t[0]) if len(part.t) > 1 else 0.0
        self._add_sums(part, np.where(counts, left, 0.0), counts, step)
        stride = 1.0 / (SAMPLES_PER_CUTOFF * part.cutoff_hz * max(step, 1e-9))
        every = max(1, int(stride + 1e-6))  # the stride of a rate that is known from its steps
        kept = np.arange(-self._seen % every, len(part.t), every)
        self._seen += len(part.t)
        self._add_track(part, np.where(counts, left, np.nan), kept)

    def _add_sums(self, part: LogPrediction, left: Array, counts: Mask, step: float) -> None:
        block = (part.t / BLOCK_S).astype(np.intp)
        starts = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
        way = np.where(counts, part.dq * step, 0.0)
        every = [left**2, counts, np.maximum(way, 0.0), np.maximum(-way, 0.0), part.used[:, None]]
        sums = np.add.reduceat(np.hstack(every), starts, axis=0)
        for k, own in zip(block[starts].tolist(), sums, strict=True):
            self.sums[k] = self.sums.get(k, 0.0) + own

    def table(self) -> Array:
        """The sums of all blocks, (B, 4 n + 1)."""
        result = np.zeros((max(self.sums) + 1, 4 * self.model.robot.n + 1))
        for k, own in self.sums.items():
            result[k] = own
        return result

    def _add_track(self, part: LogPrediction, left: Array, at: Index) -> None:
        q, dq, ddq = part.q[at], part.dq[at], part.ddq[at]
        rotor = known_rotors(self.model.robot) if self.model.rotor is None else self.model.rotor
        load = self.model.rigid(q, dq, ddq) - gear_ratios(self.model.robot) ** 2 * rotor * ddq
        shown = (part.t[at], q, dq, ddq, load, left[at])
        self._tracks.append(Track(*shown, cutoff_hz=part.cutoff_hz))
        self._held += len(at)
        if self._held >= 2 * SPAN:
            self._look(last=False)

    def end(self) -> None:
        """Look at what has not been looked at."""
        if self._tracks:
            self._look(last=True)

    def _look(self, *, last: bool) -> None:
        """Find the places of a span; a short rest at the end is looked at with the one before."""
        held = _joined(self._tracks)
        stop = len(held.t) if last else SPAN
        self.places += list(_standing_out(_part(held, 0, stop)))
        begin = int(np.searchsorted(held.t, held.t[stop - 1] - OVERLAP_S))
        rest = _part(held, begin, len(held.t))
        self._tracks, self._held = [rest], len(rest.t)


def _standing_out(track: Track) -> Iterator[Interval]:
    """Places of one span at which the residual stands out."""
    if len(track.t) < SAMPLES_PER_CUTOFF or not np.isfinite(track.residual).any():
        return
    windows = [windows_of([track], length) for length in LENGTHS_S]
    yield from standing_out([w for w in windows if len(w.centre)])


def _joined(tracks: list[Track]) -> Track:
    arrays = {name: np.concatenate([getattr(x, name) for x in tracks]) for name in SERIES}
    return Track(**arrays, cutoff_hz=tracks[0].cutoff_hz)


def _part(track: Track, low: int, high: int) -> Track:
    arrays = {name: getattr(track, name)[low:high] for name in SERIES}
    return Track(**arrays, cutoff_hz=track.cutoff_hz)
