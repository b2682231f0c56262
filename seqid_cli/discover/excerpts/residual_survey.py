"""Residual survey: one pass over a log of any length.

The torque is predicted part by part (see `identify.prediction`). Kept are sums over short blocks
of time, and the strongest places at which the residual stands out against all others of a span of
the log (see `survey.events`). None of it says what the model lacks. It says where to look (see
`excerpts`).
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from seqid_cli.discover.survey.event_windows import Track, joined, windows_of
from seqid_cli.discover.survey.events import LENGTHS_S, Interval, places, scores
from seqid_cli.discover.survey.rows import BLOCK_S, SAMPLES_PER_CUTOFF
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, Predictor, predict
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


@dataclass(frozen=True)
class ResidualSurvey:
    """What a pass over one log remembers.

    `kind` is its file format; empty for a log that is read as a whole. By block of `BLOCK_S`:
    `squares`, `counts` (B, n), the sum of the squared residual [(N m)^2] over samples at which a
    joint certainly slides, and their number; `travel` (B, n, 2), the way [rad] that it slides
    forward and backward; `usable` (B,), samples without a gap, once the filters have settled.
    `places` are where the residual stands out, the strongest first; s since the first sample.
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
    log: Recording | SurveyedLog,
    number: int = 0,
    *,
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
) -> ResidualSurvey:
    """Pass over one log with torque; which `number` of a set it is makes no difference.

    The motion is that of the encoders. Of a log that is passed over, the model has those of its
    effects that can be told part by part. Raises InputError: the log carries neither torque nor
    current, or no stretch is long enough to filter.
    """
    del number
    model = TorqueModel.from_stages(stages, robot)
    n, seen, held, tracks = robot.n, 0, 0, list[Track]()
    blocks, sums, found = list[Index](), list[Array](), list[Interval]()
    for part in _parts(log, robot, stages, options):
        left, counts = part.tau - part.predicted, part.sliding & part.used[:, None]
        step = float(part.t[1] - part.t[0]) if len(part.t) > 1 else 0.0
        block, own = _block_sums(part, np.where(counts, left, 0.0), counts, step)
        blocks.append(block)
        sums.append(own)
        stride = 1.0 / (SAMPLES_PER_CUTOFF * part.cutoff_hz * max(step, 1e-9))
        every = max(1, int(stride + 1e-6))  # the stride of a rate that is known from its steps
        kept = np.arange(-seen % every, len(part.t), every)
        tracks.append(_track(model, part, np.where(counts, left, np.nan), kept))
        seen, held = seen + len(part.t), held + len(kept)
        if held >= 2 * SPAN:
            whole = joined(tracks)
            found += _standing_out(whole[:SPAN])
            rest = np.searchsorted(whole.t, whole.t[SPAN - 1] - OVERLAP_S)
            tracks, held = [whole[int(rest) :]], len(whole.t) - int(rest)
    found += _standing_out(joined(tracks))
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
    return Predictor(TorqueModel.from_stages(stages, robot), stages, options, effects)(log, 0)


def _block_sums(part: LogPrediction, left: Array, counts: Mask, step: float) -> tuple[Index, Array]:
    """Blocks (K,) of a part, and sums (K, 4 n + 1): squares, counts, ways, usable samples."""
    block = (part.t / BLOCK_S).astype(np.intp)
    starts = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    way = np.where(counts, part.dq * step, 0.0)
    every = [left**2, counts, np.maximum(way, 0.0), np.maximum(-way, 0.0), part.used[:, None]]
    return block[starts], np.add.reduceat(np.hstack(every), starts, axis=0)


def _track(model: TorqueModel, part: LogPrediction, left: Array, at: Index) -> Track:
    """Some samples of a part with their residual (N, n), NaN where a joint does not count."""
    q, dq, ddq = part.q[at], part.dq[at], part.ddq[at]
    rotor = known_rotors(model.robot) if model.rotor is None else model.rotor
    load = model.rigid(q, dq, ddq) - gear_ratios(model.robot) ** 2 * rotor * ddq
    return Track(part.t[at], np.stack([q, dq, ddq, load, left[at]]), part.cutoff_hz)


def _standing_out(track: Track) -> list[Interval]:
    """Places of one span at which the residual stands out."""
    if len(track.t) < SAMPLES_PER_CUTOFF or not np.isfinite(track.values[-1]).any():
        return []
    every = [windows_of([track], length) for length in LENGTHS_S]
    return places(0, [(windows, scores(windows)) for windows in every if len(windows.centre)])


def _strongest(found: Iterable[Interval]) -> tuple[Interval, ...]:
    """The strongest places, each once: spans overlap."""
    kept: list[Interval] = []
    for place in sorted(found, key=lambda p: -p.score):
        if all(place.end < other.start or place.start > other.end for other in kept):
            kept.append(place)
    return tuple(kept[:MOST_PLACES])
