"""The investigation behind a diagnosis: data sets, rows, selection, events, noise floor.

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
    rms,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import HELD, Ground, Model
from seqid_cli.discover.select.naming import TOLD
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import SelectionResult
from seqid_cli.discover.select.selection import select, select_among
from seqid_cli.discover.survey.events import GATE, Interval, find_events
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask
from seqid_cli.working import step

AROUND_S = 0.5


@dataclass(frozen=True, kw_only=True)
class FileResidual:
    """What the parameter file leaves on the rows that it sees, before anything is taken out.

    `residual` (M_j,) N m (N where prismatic) is by joint, on the joint's rows; `counts`
    (M_j,) says which of these count.
    """

    rows: Rows
    residual: tuple[Array, ...]
    counts: tuple[Mask, ...]

    @classmethod
    def of(cls, ground: Ground) -> "FileResidual":
        """Take the residual of all rows."""
        residual = ground.base.y
        return cls(
            rows=ground.stage.rows,
            residual=residual,
            counts=tuple(np.ones(len(values), dtype=bool) for values in residual),
        )

    def without(self, masks: Sequence[Mask]) -> "FileResidual":
        """The same without some samples (N, n) of each log."""
        counts = []
        for joint, kept in enumerate(self.counts):
            gone = self.rows.of(
                joint, [mask[:, joint].astype(np.float64) for mask in masks]
            )
            counts.append(kept & (gone == 0.0))
        return replace(self, counts=tuple(counts))

    @cached_property
    def samples(self) -> list[int]:
        """Number of each joint's rows."""
        return [int(np.count_nonzero(kept)) for kept in self.counts]

    @cached_property
    def rms(self) -> Array:
        """RMS (n,) N m; 0 of a joint without rows."""
        pairs = zip(self.residual, self.counts, strict=True)
        return np.array([rms(values[kept]) for values, kept in pairs])

    @cached_property
    def rms_by_log(self) -> Array:
        """RMS (logs, n) N m; NaN where a log has no row of a joint."""
        scenes = self.rows.scenes
        numbers = [
            np.full(scene.samples, number) for number, scene in enumerate(scenes)
        ]
        found = np.full((len(scenes), self.rows.n), np.nan)
        for joint, (values, kept) in enumerate(
            zip(self.residual, self.counts, strict=True)
        ):
            log = self.rows.of(joint, numbers)
            for number in np.unique(log[kept]):
                found[number, joint] = rms(values[kept & (log == number)])
        return found


@dataclass(frozen=True)
class Investigation:
    """Everything that a diagnosis is made from."""

    logs: tuple[Recording, ...]
    selection: SelectionResult
    floor: NoiseFloor
    events: tuple[Interval, ...]
    file_residual: FileResidual

    @property
    def model(self) -> Model:
        """The model with all that was found."""
        return self.selection.model

    @property
    def ground(self) -> Ground:
        """Rows and data sets, events left out."""
        return self.selection.model.ground

    @property
    def file_rms(self) -> Array:
        """RMS (n,) N m of the file's own residual, on all rows that it sees."""
        return self.file_residual.rms

    def without_told_events(self) -> "Investigation":
        """The same where samples of events do not count for the file: a finding stands for them."""
        masks = [
            np.zeros_like(scene.slides) for scene in self.file_residual.rows.scenes
        ]
        _mark(self.events, self.file_residual.rows.scenes, masks)
        return replace(self, file_residual=self.file_residual.without(masks))

    @property
    def explained_joints(self) -> set[int]:
        """Joints that something was found at."""
        return {
            c % self.ground.n
            for taken in self.selection.terms
            for c in taken.term.channels
        }


def investigate(
    logs: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    options: DiscoverOptions,
    *,
    least: float = TOLD,
) -> Investigation:
    """Select what a model lacks, and find events in what is left; tell what is likely."""
    step("filtering the logs", 0, 10)  # tenths of the time that it mostly takes
    rows = rows_of(scenes_of(logs, robot, stages, options=options.motion))
    step("choosing effects", 4, 10)
    whole = Ground.of(rows, stages)
    file = FileResidual.of(whole)
    found = select(whole)
    step("looking for events", 8, 10)
    first = found.model
    gone = guessed(first)
    events = events_of(first, gone)
    _mark(events, rows.scenes, gone)
    sure = rows.without(gone)
    step("choosing effects again", 8, 10)
    if not all(map(np.array_equal, sure.used, rows.used)):
        found = select_among(Ground.of(sure, stages), first.hold, first.candidates)
        found.run()
    told, events = found.told(least), not_of_terms(events, first)
    step("estimating the noise", 9, 10)
    rows = told.model.ground.stage.rows
    echo = encoder_residuals(logs, rows.scenes)
    floor = noise_floor(logs, rows.scenes, told.model.left(), echo, rows=rows)
    return Investigation(tuple(logs), told, floor, tuple(events), file)


def _mark(
    events: Sequence[Interval], scenes: Sequence[Scene], masks: Sequence[Mask]
) -> None:
    """Mark samples of events in masks (N, n), and those that feel them through the low-pass."""
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
    """Select again where the stages are others and the logs are freed of what they have taken in.

    `candidates` are what was found before and is not in the model yet: the one of them
    that gains most now is told, or all that the model may still lack where that is no
    finding. Also whether all was looked for. Events are those of before.
    """
    rows = rows_of(scenes_of(logs, robot, stages, options=options.motion))
    ground = Ground.of(rows, stages)
    found = select_among(ground, HELD, candidates)
    told = found.largest()
    look = all(one.scored.score.share <= Options.improvement for one in told.terms)
    if look:
        found.finish()
        told = found.told(0.0)
    file = FileResidual.of(ground)
    return replace(before, logs=tuple(logs), selection=told, file_residual=file), look


def guessed(model: Model) -> list[Mask]:
    """Samples (N, n) of each data set at which effects of the model may have any torque."""
    scenes = model.ground.stage.scenes
    masks = [np.zeros_like(scene.slides) for scene in scenes]
    for what in model.candidates:
        for scene, mask in zip(scenes, masks, strict=True):
            for joint, own in what.effect.guessed(
                scene, what.joint, what.settings
            ).items():
                mask[:, joint] |= own
    return masks


def events_of(
    model: Model, guess: Sequence[Mask], *, most: float = 0.5
) -> list[Interval]:
    """Stretches that stand out in what the model leaves, and are no errors of its laws.

    At `most` of their samples an effect may have any torque (`guess`, (N, n)), a joint
    does not slide, or stops above the cut-off.
    """
    rows, left, found = model.ground.stage.rows, model.left(), list[Interval]()
    own = zip(model.linear.left_out[: rows.n], model.noise.sigma, strict=False)
    for event in find_events(rows, [r / sigma for r, sigma in own]):
        scene = rows.scenes[event.scene]
        unknown = (guess[event.scene] | scene.stops | ~scene.slides)[
            event.inside(scene)
        ]
        known = np.mean(unknown[:, list(event.joints)]) <= most
        if known and not of_law(event, scene, left[event.scene]):
            found.append(event)
    return found


def not_of_terms(events: Sequence[Interval], model: Model) -> list[Interval]:
    """Events but those that terms of a model made: they add more there than the file leaves."""
    left, kept = model.left() if events else [], list[Interval]()
    for event in events:
        scene = model.ground.stage.scenes[event.scene]
        file = model.ground.base.scene_bases[event.scene].residual
        if event.squares(scene, file - left[event.scene]) < event.squares(scene, file):
            kept.append(event)
    return kept


def of_law(event: Interval, scene: Scene, residual: Array) -> bool:
    """Whether an event's residual (N, n) N m is small beside the torque's swing around it.

    The more it stands out against moments of like motion, at which a law errs alike,
    the smaller it may be; but not within a period of the cut-off of where a joint may
    stick.
    """
    inside, around = event.inside(scene), event.inside(scene, AROUND_S)
    period = round(scene.motion.rate_hz / scene.motion.lowpass.cutoff_hz)
    for j in event.joints:
        least = Options.small * float(np.ptp(scene.modelled[around, j]))
        away = inside & shrink(scene.slides[:, j], period)
        size = max(
            rms(residual[inside, j]), rms(residual[away, j]) * event.score / GATE
        )
        if size >= least:
            return False
    return True
