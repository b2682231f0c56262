"""The investigation behind a diagnosis: data sets, rows, selection, events, noise.

Stretches that stand out against everything else the logs show are events. They are
taken out, and so are samples at which the torque of an effect is not known. Then the
selection goes on. What may be a push of seconds is left out from the first: it would
pass for an effect. Whatever is not told as an event in the end goes back in.
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
from seqid_cli.discover.pushes import events_of, not_of_terms
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import HELD, Model, SelectionProblem
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import SelectionResult
from seqid_cli.discover.select.selection import select, select_among
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.discover.survey.events import Interval, stretches_of
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.discover.survey.stretches import Stretch
from seqid_cli.effects.scene import Scene
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.typing import Array, Mask
from seqid_cli.working import step

# of a joint's rows that must stay beside what may be pushes, to tell what is usual
LEAST_BESIDE = 1.0 / 3.0


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

    @cached_property
    def held_model(self) -> Model:
        """The model with a base that is held as the file says."""
        return self.model.held_otherwise(HELD, self.model.terms)

    def forget_search(self) -> None:
        """Let go of what the search has worked out: what follows needs the room."""
        self.ground.forget_search()
        self.model.linear.forget_parts()
        for result in self.selection.terms:
            result.model.linear.forget_parts()

    @property
    def ground(self) -> SelectionProblem:
        """Rows and data sets, events left out."""
        return self.selection.model.ground

    @property
    def has_all_rows(self) -> bool:
        """Whether the model was fitted to all rows that the file sees."""
        return self.ground.stage.rows.has_rows_of(self.file_residual.rows)

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
        if not self.events:
            return self
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
    first_rows = _without_stretches(
        rows, stretches_of(rows, ground.base.y, settings.events)
    )
    if first_rows is rows:
        selection = select(ground)
    else:
        selection = select(SelectionProblem.of(first_rows, stages, selection_options))

    # Events, and samples at which the torque of an effect is not known, are left out.
    step("looking for events", 8, 10)
    first_model = selection.model
    other_models = selection.others
    unknown = guessed(first_model)
    events = not_of_terms(events_of(first_model, unknown, settings, rows), first_model)

    step("choosing effects again", 8, 10)
    while True:
        left_out = [mask.copy() for mask in unknown]
        _mark(events, rows.scenes, left_out)
        remaining = rows.without(left_out)
        if not remaining.has_rows_of(selection.model.ground.stage.rows):
            selection = select_among(
                SelectionProblem.of(remaining, stages, selection_options),
                first_model.hold,
                first_model.candidates,
            )
            selection.run()
            # What other models have of the first rows may be it on these as well.
            selection.others = other_models
        result = selection.told(least)

        step("estimating the noise", 9, 10)
        remaining = result.model.ground.stage.rows
        investigation = Investigation(
            logs=tuple(logs),
            selection=result,
            floor=noise_floor(
                logs,
                remaining.scenes,
                result.model.left(),
                encoder_residuals(logs, remaining.scenes),
                rows=remaining,
            ),
            events=tuple(events),
            file_residual=FileResidual.of(ground),
            settings=settings,
        )
        # What is too unsure to be told goes back in.
        min_confidence = settings.evidence.min_confidence
        told_events = [
            event
            for event, confidence in zip(
                events, event_confidences(investigation), strict=True
            )
            if confidence >= min_confidence
        ]
        if len(told_events) == len(events):
            return investigation
        events = told_events


def _without_stretches(rows: Rows, stretches: Sequence[Sequence[Stretch]]) -> Rows:
    """Return rows without some stretches of each log, if enough stays of each joint."""
    masks = [np.zeros_like(scene.slides) for scene in rows.scenes]
    for scene, mask, of_log in zip(rows.scenes, masks, stretches, strict=True):
        t = scene.motion.t - scene.motion.t[0]
        reach_s = 0.5 / scene.motion.lowpass.cutoff_hz
        for start, end in of_log:
            mask[(t >= start - reach_s) & (t <= end + reach_s)] = True
    if not any(mask.any() for mask in masks):
        return rows

    beside = rows.without(masks)
    counts = np.array([rows.count(joint) for joint in range(rows.n)])
    counts_beside = np.array([beside.count(joint) for joint in range(rows.n)])
    return beside if np.all(counts_beside >= LEAST_BESIDE * counts) else rows


def event_confidences(investigation: Investigation) -> list[float]:
    """Return how sure each event is.

    A push stands alone. Where much more than noise is left all along, the largest
    moment of it may be nothing else: it is no surer than the share that all events
    have in what is unknown at its joints. Of a long push that swells and falls only
    pieces stand out, and none of them speaks against another. A law that is not
    understood, and that a smooth function follows, errs at moments: beside much of it
    odds are even that the event is one of these.
    """
    events = investigation.events
    if not events:
        return []
    energies = event_energies(investigation)
    min_sigma = investigation.settings.events.min_sigma
    confidences = []
    for event, energy in zip(events, energies.of_events, strict=True):
        joints = list(event.joints)
        left = float(energies.left[joints].sum())
        of_functions = float(energies.of_functions[joints].sum())
        of_all = sum(
            energy_of_other
            for other, energy_of_other in zip(events, energies.of_events, strict=True)
            if set(other.joints) & set(joints)
        )
        share = of_all / max(of_all + left, 1e-300)
        not_understood = of_functions / max(energy + of_functions, 1e-300)
        certainty = event.certainty(min_sigma) * share
        confidences.append(float(certainty * (1.0 - 0.5 * not_understood)))
    return confidences


@dataclass(frozen=True, kw_only=True)
class EventEnergies:
    """Squares beyond noise, in units of noise.

    Attributes
    ----------
    of_events : list of float
        Of each event.
    left : (n,) array
        Of each joint in all that is left without the events.
    of_functions : (n,) array
        Of each joint in what smooth functions take up, as no effect explains it.
    """

    of_events: list[float]
    left: Array
    of_functions: Array


def event_energies(investigation: Investigation) -> EventEnergies:
    """Return the energies of events, and of what else is unknown at the joints."""
    model = investigation.model
    rows = investigation.ground.stage.rows
    floor = np.maximum(investigation.floor.rms, 1e-12)
    left_by_scene = model.left()
    of_events = [
        event.energy(rows.scenes[event.scene], left_by_scene[event.scene] / floor)
        for event in investigation.events
    ]

    counts = np.array([rows.count(joint) for joint in range(rows.n)])
    squares_left = model.rms() ** 2
    of_functions = _squares_of_functions(investigation, squares_left)
    return EventEnergies(
        of_events=of_events,
        left=np.maximum(squares_left / floor**2 - 1.0, 0.0) * counts,
        of_functions=of_functions / floor**2 * counts,
    )


def _squares_of_functions(investigation: Investigation, squares_left: Array) -> Array:
    """Return the mean squares (n,) that smooth functions take up at each joint.

    Parameters
    ----------
    investigation : Investigation
        The investigation.
    squares_left : (n,) array
        Mean squares that the model leaves [N^2 m^2; N^2 where prismatic].
    """
    n = investigation.ground.n
    squares = np.zeros(n)
    for result in investigation.selection.smooth:
        for joint in (channel for channel in result.term.channels if channel < n):
            without = rms(result.left_without[joint]) ** 2
            squares[joint] += max(without - squares_left[joint], 0.0)
    return squares


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
