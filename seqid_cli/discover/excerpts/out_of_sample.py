"""Events in pieces that were taken because the residual stands out there.

Such pieces tell nothing of what the model lacks elsewhere: they are no part of the search. What it
arrived at is held against each of them, and its windows are compared with those of the logs that
were searched (see `events`). They are the most conspicuous of a much longer time, so that each must
stand out as much as the strongest event of a log has to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Stage
from seqid_cli.discover.investigate import STANDS_OUT, Investigation, no_push
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import Ground, Model
from seqid_cli.discover.survey.event_windows import (
    Track,
    residual_series,
    top_speeds,
    tracks_of,
    windows_of_tracks,
)
from seqid_cli.discover.survey.events import GATE, LENGTHS_S, Interval, events_of_scene, scores
from seqid_cli.discover.survey.rows import SAMPLES_PER_CUTOFF, extrapolated, rows_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.results.diagnosis import EventEntry
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EventAside:
    """One event, how far it stands out over the gate, and its energy in units of the noise."""

    event: EventEntry
    ratio: float
    energy: float


def events_aside(
    found: Investigation,
    aside: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    options: DiscoverOptions,
) -> list[EventAside]:
    """Look for events in pieces that were not searched.

    Parameters
    ----------
    found : Investigation
        Of other pieces of the same logs.
    aside : sequence of Recording
        Without the effects that the model has.
    robot : Robot
    stages : Stages
    options : DiscoverOptions
    """
    if not aside:
        return []
    rows = found.ground.stage.rows
    others = tracks_of(rows, residual_series(rows, found.model.scaled()))
    top = top_speeds(rows)
    looks = [_Look.of(piece, found, robot, stages, options) for piece in aside]
    return [
        look.told(place, robot)
        for look in looks
        for place in look.places(others, top, STANDS_OUT * GATE)
    ]


@dataclass(frozen=True)
class _Look:
    """A piece with what the search leaves of its torque, (N, n) N m at its scene's samples."""

    recording: Recording
    scene: Scene
    model: Model
    left: Array
    shown: Array

    @classmethod
    def of(
        cls,
        recording: Recording,
        found: Investigation,
        robot: Robot,
        stages: Stages,
        options: DiscoverOptions,
    ) -> _Look:
        scene = scenes_of([recording], robot, stages, options=options.motion)[0]
        scene = _beside(scene, recording, found)
        rows = rows_of([scene])
        there = Ground.of(Stage(rows), base_of(rows, stages))
        model = found.model
        return cls(recording, scene, model, model.left(there)[0], model.shown([scene])[0])

    def places(self, others: Sequence[Track], top: Array, gate: float) -> list[Interval]:
        """Places (scene 0 is this one) that stand out beside other logs."""
        tracks = [self.track(), *others]
        windows = [windows_of_tracks(tracks, top, length) for length in LENGTHS_S]
        events = events_of_scene(0, [(w, scores(w)) for w in windows], gate)
        return [
            e for e in events if not no_push(self.model, e, self.scene, [self.left], [self.shown])
        ]

    def track(self) -> Track:
        """The piece's kept samples, with the residual in units of the noise."""
        scene, motion = self.scene, self.scene.motion
        stride = max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))
        at = slice(None, None, stride)
        counts = (scene.slides & ~extrapolated([scene])[0])[at]
        return Track(
            motion.t[at],
            motion.q[at],
            motion.dq[at],
            motion.ddq[at],
            scene.load[at],
            np.where(counts, self.scaled()[at], np.nan),
            motion.lowpass.cutoff_hz,
        )

    def scaled(self) -> Array:
        """The residual (N, n) in units of each joint's noise."""
        return self.left / self.model.noise.sigma[: self.left.shape[1]]

    def told(self, place: Interval, robot: Robot) -> EventAside:
        """Describe an event."""
        begun = self.recording.offset
        event = EventEntry(
            log=str(self.recording.path),
            start=begun + place.start,
            end=begun + place.end,
            joints=[robot.joint_names[j] for j in place.joints],
        )
        return EventAside(event, place.score / GATE, place.energy(self.scene, self.scaled()))


def _beside(scene: Scene, recording: Recording, found: Investigation) -> Scene:
    """The scene on the clock of those that were searched, with the model that they have."""
    logs, scenes = found.logs, found.ground.stage.scenes
    known = scenes[0]
    before = [
        k
        for k, log in enumerate(logs)
        if log.path == recording.path and log.start <= recording.start
    ]
    number = scenes[before[-1]].log if before else 0
    origin = logs[0].start - known.start
    start = recording.start - origin if known.shared_clock else recording.offset

    def placed(one: Scene) -> Scene:
        full = None if one.full is None else placed(one.full)
        return replace(
            one,
            model=known.model,
            sign_width=known.sign_width,
            log=number,
            start=start,
            shared_clock=known.shared_clock,
            full=full,
        )

    return placed(scene)
