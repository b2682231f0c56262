"""The investigation behind a diagnosis: search in both stances, events, calibration, rivals.

1. Scenes, rows and base columns; the search in both stances (see `search`).
2. Which stance: the file is kept if its own parameters, with few changes, explain as much as free
   ones do; otherwise the base is free.
3. Short stretches that stand out against everything else the logs show are events: they are taken
   out, and the search begins anew.
4. The same screening on clean data of this robot and these logs gives the level below which a gain
   means nothing (see `gates`); what does not pass is taken back.
5. Smooth functions of everything that was measured look at what is left (see `dependence`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import Base, base_of
from seqid_cli.discover.candidates import Stage, Tried
from seqid_cli.discover.dependence import Dependence, dependence
from seqid_cli.discover.events import Interval, event_masks, find_events
from seqid_cli.discover.floor import NoiseFloor, noise_floor
from seqid_cli.discover.gates import SMOOTH, Gates, calibrated
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.rows import Rows, rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.search import Search, searched
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

CHANGED = 0.05  # relative excess over a free base from which the file counts as off
AS_GOOD = 0.05  # relative excess that a kept file with few changes may have


@dataclass(frozen=True)
class Searched:
    """A search that has ended, and the last ranking of what was not accepted."""

    search: Search
    ranked: tuple[Tried, ...]


@dataclass(frozen=True)
class Investigation:
    """Everything that a diagnosis is made from.

    `start` (n,) N m is the RMS of the file's own residual, `dependences` what smooth functions find
    in what is left, one per joint.
    """

    logs: tuple[Recording, ...]
    result: Searched
    gates: Gates
    start: Array
    floor: NoiseFloor
    dependences: tuple[Dependence, ...]
    events: tuple[Interval, ...]

    @property
    def search(self) -> Search:
        """The search in the stance that was chosen."""
        return self.result.search


def investigate(
    logs: Sequence[Recording], robot: Robot, stages: Stages, options: DiscoverOptions
) -> Investigation:
    """Search both stances, choose one, and look at what is left.

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    """
    scenes = scenes_of(logs, robot, stages, options=options.motion)
    rows, gates = rows_of(scenes), Gates()
    result, events = _without_events(rows, stages, gates, options)
    dependences = _dependences(result.search, gates)
    if result.search.accepted or events or any(d.quantities for d in dependences):
        gates = calibrated(logs, result.search, stages, options)
        if not _holds(result.search, events, gates):
            result, events = _without_events(rows, stages, gates, options)
            dependences = _dependences(result.search, gates)
    start = [np.sqrt(np.mean(y**2)) if len(y) else 0.0 for y in result.search.base.y]
    left = result.search.residual(result.search.system())
    return Investigation(
        tuple(logs),
        result,
        gates,
        np.array(start),
        noise_floor(logs, scenes, result.search.stage.rows, left),
        dependences,
        tuple(events),
    )


def _without_events(
    rows: Rows, stages: Stages, gates: Gates, options: DiscoverOptions
) -> tuple[Searched, list[Interval]]:
    """Search; where events stand out in what is left, search anew without them."""
    result = _both_stances(Stage(rows), base_of(rows, stages), gates, options)
    left = result.search.system().left_out()[: rows.n]
    events = find_events(rows, left, gate=gates.event)
    if not events:
        return result, events
    quiet = rows.without(event_masks(rows, events))
    return _both_stances(Stage(quiet), base_of(quiet, stages), gates, options), events


def _holds(search: Search, events: Sequence[Interval], gates: Gates) -> bool:
    """Whether everything that was found still passes the calibrated gates."""
    found = all(gates.passes(t) for t in marginal(search))
    return found and all(event.score >= gates.event for event in events)


def marginal(search: Search) -> list[Tried]:
    """Every accepted effect, tried against all others."""
    return [
        search.stage.try_all(search.without(t).system(), [t.candidate])[0] for t in search.accepted
    ]


def _dependences(search: Search, gates: Gates) -> tuple[Dependence, ...]:
    system = search.system()
    least = gates.least(SMOOTH)
    return tuple(dependence(system, j, least_gain=least) for j in range(search.stage.rows.n))


def _both_stances(stage: Stage, base: Base, gates: Gates, options: DiscoverOptions) -> Searched:
    bare, held = (Search.begin(stage, base, kept=kept) for kept in (False, True))
    free = _search(Search.begin(stage, base, kept=False), gates, options)
    kept = _search(Search.begin(stage, base, kept=True), gates, options)
    return _chosen(free, kept, bare, held)


def _search(search: Search, gates: Gates, options: DiscoverOptions) -> Searched:
    effects = tuple(CATALOGUE.values())
    ranked = searched(search, effects, gates.passes, options.max_effects)
    return Searched(search, tuple(ranked))


def _chosen(free: Searched, kept: Searched, bare: Search, held: Search) -> Searched:
    """The stance that explains the logs with the least change."""
    scale = np.maximum(free.search.rms(), 1e-12)
    cost = {
        name: float(np.mean((s.rms() / scale) ** 2))
        for name, s in (
            ("bare", bare),
            ("held", held),
            ("free", free.search),
            ("kept", kept.search),
        )
    }
    if cost["held"] <= (1 + CHANGED) * cost["bare"]:
        return free
    if kept.search.accepted and cost["kept"] <= (1 + AS_GOOD) * cost["free"]:
        return kept
    return free
