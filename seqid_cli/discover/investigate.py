"""The investigation behind a diagnosis: data sets, rows, selection, events, noise.

Short stretches that stand out against everything else the logs show are events. They
are taken out, and so are samples at which the torque of an effect is not known. Then
the selection goes on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.noise.floor import (
    NoiseFloor,
    encoder_residuals,
    noise_floor,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import HELD, Model, SelectionProblem
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import SelectionResult
from seqid_cli.discover.select.selection import select, select_among
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.discover.survey.events import Interval, find_events
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.effects.scene import Scene
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.typing import Array, Mask
from seqid_cli.working import step

AROUND_S = 0.5  # on either side of an event, in which the torque swings


@dataclass(frozen=True, kw_only=True)
class FileResidual:
    """What the parameter file leaves on the rows that it sees, before any is taken out.

    Attributes
    ----------
    rows : Rows
        The rows.
    residual : tuple of (M_j,) arrays
        By joint, N m (N where prismatic).
    counts : tuple of (M_j,) masks
        By joint, which of the rows count.
    """

    rows: Rows
    residual: tuple[Array, ...]
    counts: tuple[Mask, ...]

    @classmethod
    def of(cls, ground: SelectionProblem) -> "FileResidual":
        """Take the residual of all rows."""
        residual = ground.base.y
        return cls(
            rows=ground.stage.rows,
            residual=residual,
            counts=tuple(np.ones(len(values), dtype=bool) for values in residual),
        )

    def without(self, masks: Sequence[Mask]) -> "FileResidual":
        """Return the residual without some samples (N, n) of each log."""
        counts = []
        for joint, counting in enumerate(self.counts):
            in_mask = [mask[:, joint].astype(np.float64) for mask in masks]
            is_masked = self.rows.of(joint, in_mask)
            counts.append(counting & (is_masked == 0.0))
        return replace(self, counts=tuple(counts))

    @cached_property
    def samples(self) -> list[int]:
        """Number of each joint's rows."""
        return [int(np.count_nonzero(counting)) for counting in self.counts]

    @cached_property
    def rms(self) -> Array:
        """RMS (n,) N m; 0 of a joint without rows."""
        pairs = zip(self.residual, self.counts, strict=True)
        return np.array([rms(values[counting]) for values, counting in pairs])

    @cached_property
    def rms_by_log(self) -> Array:
        """RMS (logs, n) N m; NaN where a log has no row of a joint."""
        scenes = self.rows.scenes
        log_of_sample = [
            np.full(scene.samples, number) for number, scene in enumerate(scenes)
        ]
        by_log = np.full((len(scenes), self.rows.n), np.nan)
        for joint, values in enumerate(self.residual):
            counting = self.counts[joint]
            log = self.rows.of(joint, log_of_sample)
            for number in np.unique(log[counting]):
                by_log[number, joint] = rms(values[counting & (log == number)])
        return by_log


@dataclass(frozen=True, kw_only=True)
class Investigation:
    """All that a diagnosis is made from.

    Attributes
    ----------
    logs : tuple of Recording
        The logs.
    selection : SelectionResult
        What the model lacks.
    floor : NoiseFloor
        What noise alone would leave.
    events : tuple of Interval
        Short stretches in which something pushed the arm.
    file_residual : FileResidual
        What the file leaves.
    settings : DiscoverSettings
        What was decided by.
    """

    logs: tuple[Recording, ...]
    selection: SelectionResult
    floor: NoiseFloor
    events: tuple[Interval, ...]
    file_residual: FileResidual
    settings: DiscoverSettings

    @property
    def model(self) -> Model:
        """The model with all that was selected."""
        return self.selection.model

    @property
    def ground(self) -> SelectionProblem:
        """Rows and data sets, events left out."""
        return self.selection.model.ground

    @property
    def file_rms(self) -> Array:
        """RMS (n,) N m of the file's own residual, on all rows that it sees."""
        return self.file_residual.rms

    @property
    def explained_joints(self) -> set[int]:
        """Joints at which an effect or a smooth function is told."""
        n = self.ground.n
        return {
            channel % n
            for result in self.selection.terms
            for channel in result.term.channels
        }

    def without_told_events(self) -> "Investigation":
        """Let samples of events not count for the file: a finding stands for them."""
        scenes = self.file_residual.rows.scenes
        masks = [np.zeros_like(scene.slides) for scene in scenes]
        _mark(self.events, scenes, masks)
        return replace(self, file_residual=self.file_residual.without(masks))


def investigate(
    logs: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    options: DiscoverOptions,
    *,
    least: float | None = None,
) -> Investigation:
    """Select what a model lacks, and find events in what is left.

    Parameters
    ----------
    logs : sequence of Recording
        With torque or current, without the torque of effects that the file has.
    robot : Robot
        The arm.
    stages : Stages
        The parameter file's.
    options : DiscoverOptions
        Where motion comes from.
    least : float, optional
        Probability to be there from which an effect is told; by default that of the
        settings.
    """
    settings = options.settings
    selection_options = Options.of(settings.evidence)
    step("filtering the logs", 0, 10)  # tenths of the time that it mostly takes
    rows = rows_of(scenes_of(logs, robot, stages, options=options.motion))

    step("choosing effects", 4, 10)
    ground = SelectionProblem.of(rows, stages, selection_options)
    file_residual = FileResidual.of(ground)
    selection = select(ground)

    # Events, and samples at which the torque of an effect is not known, are left out.
    step("looking for events", 8, 10)
    first_model = selection.model
    left_out = guessed(first_model)
    events = events_of(first_model, left_out, settings)
    _mark(events, rows.scenes, left_out)
    remaining = rows.without(left_out)

    step("choosing effects again", 8, 10)
    is_changed = not all(map(np.array_equal, remaining.used, rows.used))
    if is_changed:
        selection = select_among(
            SelectionProblem.of(remaining, stages, selection_options),
            first_model.hold,
            first_model.candidates,
        )
        selection.run()
    result = selection.told(least)
    events = not_of_terms(events, first_model)

    step("estimating the noise", 9, 10)
    rows = result.model.ground.stage.rows
    floor = noise_floor(
        logs,
        rows.scenes,
        result.model.left(),
        encoder_residuals(logs, rows.scenes),
        rows=rows,
    )
    return Investigation(
        logs=tuple(logs),
        selection=result,
        floor=floor,
        events=tuple(events),
        file_residual=file_residual,
        settings=settings,
    )


def _mark(
    events: Sequence[Interval], scenes: Sequence[Scene], masks: Sequence[Mask]
) -> None:
    """Mark samples of events in masks (N, n), with those that the low-pass reaches."""
    for event in events:
        scene = scenes[event.scene]
        reach_s = 0.5 / scene.motion.lowpass.cutoff_hz
        masks[event.scene][event.inside(scene, reach_s)] = True


def investigate_beside(
    before: Investigation,
    logs: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    options: DiscoverOptions,
    *,
    candidates: Sequence[Candidate],
) -> tuple[Investigation, bool]:
    """Select again beside stages that have been identified anew.

    Parameters
    ----------
    before : Investigation
        The last one; its events and its noise floor stay.
    logs : sequence of Recording
        Freed of the effects that the model has by now.
    robot : Robot
        The arm.
    stages : Stages
        The model's.
    options : DiscoverOptions
        Where motion comes from.
    candidates : sequence of Candidate
        What was found before and is not in the model yet.

    Returns
    -------
    Investigation
        It tells the one of the candidates that gains most now; or all that the model
        may still lack where that one is no finding.
    bool
        Whether all was looked for.
    """
    rows = rows_of(scenes_of(logs, robot, stages, options=options.motion))
    ground = SelectionProblem.of(rows, stages, Options.of(options.settings.evidence))
    selection = select_among(ground, HELD, candidates)
    largest = selection.largest()
    is_complete = all(
        result.scored.score.share <= ground.options.improvement
        for result in largest.terms
    )
    chosen = largest
    if is_complete:
        selection.finish()
        chosen = selection.told(0.0)
    investigation = replace(
        before,
        logs=tuple(logs),
        selection=chosen,
        file_residual=FileResidual.of(ground),
    )
    return investigation, is_complete


def guessed(model: Model) -> list[Mask]:
    """Return where effects of the model may have any torque, (N, n) by log."""
    scenes = model.ground.stage.scenes
    masks = [np.zeros_like(scene.slides) for scene in scenes]
    for candidate in model.candidates:
        for scene, mask in zip(scenes, masks, strict=True):
            unknown = candidate.effect.guessed(
                scene, candidate.joint, candidate.settings
            )
            for joint, samples in unknown.items():
                mask[:, joint] |= samples
    return masks


def events_of(
    model: Model,
    guess: Sequence[Mask],
    settings: DiscoverSettings = DiscoverSettings(),
    *,
    most: float = 0.5,
) -> list[Interval]:
    """Find stretches that stand out in the residual, and are no errors of laws.

    Parameters
    ----------
    model : Model
        The model with what was selected.
    guess : sequence of (N, n) masks
        By data set, where an effect may have any torque.
    settings : DiscoverSettings
        Numbers that decide.
    most : float
        Share of an event's samples that may be unknown: by `guess`, or as a joint does
        not slide, or stops above the cut-off.
    """
    rows = model.ground.stage.rows
    left_by_scene = model.left()
    left_out = model.linear.left_out[: rows.n]
    scaled = [
        residual / sigma
        for residual, sigma in zip(left_out, model.noise.sigma, strict=False)
    ]
    events: list[Interval] = []
    for event in find_events(rows, scaled, settings.events):
        scene = rows.scenes[event.scene]
        is_unknown = guess[event.scene] | scene.stops | ~scene.slides
        at_joints = is_unknown[event.inside(scene)][:, list(event.joints)]
        is_known = np.mean(at_joints) <= most
        residual = left_by_scene[event.scene]
        if is_known and not of_law(event, scene, residual, settings):
            events.append(event)
    return events


def not_of_terms(events: Sequence[Interval], model: Model) -> list[Interval]:
    """Return the events but those that terms of a model made.

    The terms of such a one add more there than the file leaves.
    """
    if not events:
        return []
    left_by_scene = model.left()
    of_push: list[Interval] = []
    for event in events:
        scene = model.ground.stage.scenes[event.scene]
        of_file = model.ground.base.scene_bases[event.scene].residual
        added = event.squares(scene, of_file - left_by_scene[event.scene])
        if added < event.squares(scene, of_file):
            of_push.append(event)
    return of_push


def of_law(
    event: Interval,
    scene: Scene,
    residual: Array,
    settings: DiscoverSettings = DiscoverSettings(),
) -> bool:
    """Return whether an event is small beside the torque's swing around it.

    The more it stands out against moments of like motion, at which a law errs alike,
    the smaller it may be; but not within a period of the cut-off of where a joint may
    stick.

    Parameters
    ----------
    event : Interval
        The event.
    scene : Scene
        Its data set.
    residual : (N, n) array
        What is left there [N m; N where prismatic].
    settings : DiscoverSettings
        Numbers that decide.
    """
    negligible_share = settings.evidence.negligible_share
    inside = event.inside(scene)
    around = event.inside(scene, AROUND_S)
    period = round(scene.motion.rate_hz / scene.motion.lowpass.cutoff_hz)
    for joint in event.joints:
        least = negligible_share * float(np.ptp(scene.modelled[around, joint]))
        away_from_rest = inside & shrink(scene.slides[:, joint], period)
        size = max(
            rms(residual[inside, joint]),
            rms(residual[away_from_rest, joint])
            * event.score
            / settings.events.min_sigma,
        )
        if size >= least:
            return False
    return True
