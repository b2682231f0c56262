"""The investigation behind a diagnosis: search in both stances, events, calibration, rivals.

1. Scenes, rows and base columns; the search in both stances (see `search`).
2. Which stance: the file is kept if its own parameters, with few changes, explain as much as free
   ones do; otherwise the base is free. Where something is left, or nothing was found, a broad base
   is tried as well.
3. Short stretches that stand out against everything else the logs show are events: they are taken
   out, and the search begins anew.
4. The same screening on clean data of this robot and these logs gives the level below which a gain
   means nothing (see `gates`); what does not pass is taken back.
5. Smooth functions of everything that was measured look at what is left (see `dependence`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from seqid_cli.discover.base import Base, base_of
from seqid_cli.discover.candidates import Stage, Tried
from seqid_cli.discover.clean import echoes
from seqid_cli.discover.dependence import Dependence, dependence
from seqid_cli.discover.doubtful import take_back, take_back_doubtful
from seqid_cli.discover.events import Interval, event_masks, find_events
from seqid_cli.discover.floor import NoiseFloor, noise_floor
from seqid_cli.discover.gates import SMOOTH, Gates, calibrated
from seqid_cli.discover.greedy import searched
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.relinearise import moved, relinearised
from seqid_cli.discover.rows import Rows, rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.search import Search
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHANGED = 0.05  # relative excess over a free base from which the file counts as off
CLEARLY = 0.7  # of what a joint's effects leave: smooth functions must leave less to replace them
MOST = 0.8  # of what they explain: effects that do as much stay, and the rest is told beside them
ANOTHER = 0.1  # of what effects leave: where smooth functions leave less, the shape is another
BY_EFFECTS = 0.5  # of what a broad base alone leaves: its effects must leave less
WORTH = 0.08  # of the squared residual, by which they must be better
BESIDE = 0.5  # of what effects show in an interval: less may be the error of their shape
AROUND_S = 0.5
STANDS_OUT = 1.5  # times the gate, that the strongest event must reach for any to be believed
MOVED = 0.01  # of a joint's rigid-body torque, from which effects are looked at from there
RELINEARISED = 2  # times at most
AS_GOOD = 0.05  # relative excess that a kept file with few changes may have, or a moved model


@dataclass(frozen=True)
class Searched:
    """A search that has ended, and the last ranking of what was not accepted."""

    search: Search
    ranked: tuple[Tried, ...]


@dataclass(frozen=True)
class Named:
    """How sure a name is: it or one of `others`, and it by itself."""

    confidence: float
    by_itself: float
    others: tuple[str, ...]


@dataclass(frozen=True)
class Investigation:
    """Everything that a diagnosis is made from.

    `start` (n,) N m is the RMS of the file's own residual, `dependences` what smooth functions find
    in what is left, one per joint, `outside` what they say better than any effects did.
    """

    logs: tuple[Recording, ...]
    result: Searched
    gates: Gates
    start: Array
    floor: NoiseFloor
    dependences: tuple[Dependence, ...]
    events: tuple[Interval, ...]
    outside: tuple[Dependence, ...]
    named: Mapping[tuple[str, int | None], Named] = field(default_factory=dict)

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
    explained = bool(result.search.accepted or events)
    unexplained = any(d.quantities for d in dependences)
    if (unexplained or not explained) and any(map(len, result.search.base.broad)):
        other, own = _without_events(rows, stages, gates, options, broad=True)
        if _explains_more(other.search, result.search):
            result, events = other, own
            dependences = _dependences(result.search, gates)
    stage = result.search.stage
    if result.search.accepted or events or any(d.quantities for d in dependences):
        smooth = [d for d in dependences if d.quantities]
        before = [t.candidate for t in result.search.accepted]
        result, events, gates = _judged(logs, result, events, smooth, rows, stages, options)
        same = result.search.stage is stage and before == [
            t.candidate for t in result.search.accepted
        ]
        dependences = _dependences(result.search, gates, dependences if same else ())
    floor = floor_of(logs, result.search, events)
    count = len(result.search.accepted)
    take_back_doubtful(result.search, floor.rms)
    outside = _outside(result.search, gates)
    if outside:
        result = _beside(result.search, outside, gates, options)
        dependences = _dependences(result.search, gates)
    if outside or len(result.search.accepted) < count:
        floor = floor_of(logs, result.search, events)
    return Investigation(
        tuple(logs),
        result,
        gates,
        result.search.base.start,
        floor,
        dependences,
        tuple(events),
        outside,
    )


def floor_of(logs: Sequence[Recording], search: Search, events: Sequence[Interval]) -> NoiseFloor:
    """Noise floor with all that was found taken out."""
    stage, system = search.stage, search.system()
    apart = event_masks(stage.rows, events)
    echo = echoes(logs, stage.scenes, search.deviation(system), apart)
    return noise_floor(logs, stage.scenes, stage.rows, search.residual(system), echo)


def _judged(
    logs: Sequence[Recording],
    result: Searched,
    events: list[Interval],
    smooth: Sequence[Dependence],
    rows: Rows,
    stages: Stages,
    options: DiscoverOptions,
) -> tuple[Searched, list[Interval], Gates]:
    """Hold what was found against clean data; what is found instead, too."""
    gates = calibrated(logs, result.search, smooth, stages, options, events)
    if events and (min(e.score for e in events) < gates.event or not stand_out(events, gates)):
        broad = result.search.broad
        result, events = _without_events(rows, stages, gates, options, broad=broad)
    result = _again(result.search, gates, options)
    if {t.candidate.effect.name for t in result.search.accepted} - set(gates.clean):
        anew = calibrated(logs, result.search, smooth, stages, options, events)
        gates = gates.joined(anew)
        _take_back(result.search, gates)
    return result, events, gates


def _explains_more(broad: Search, other: Search) -> bool:
    """Whether effects beside a broad base leave clearly less than another search, at some joint.

    And whether it is the effects that do: a broad base alone swallows what varies slowly.
    """
    least, bare, rest = broad.rms(), broad.bare[: broad.stage.rows.n], other.rms()
    clearer = least**2 < CLEARLY * rest**2
    by_effects = least**2 < BY_EFFECTS * bare**2
    return bool(broad.accepted) and bool(np.any(clearer & by_effects))


def _without_events(
    rows: Rows, stages: Stages, gates: Gates, options: DiscoverOptions, *, broad: bool = False
) -> tuple[Searched, list[Interval]]:
    """Search; where events stand out in what is left, search anew without them."""

    def search(rows: Rows) -> Searched:
        stage, base = Stage(rows), base_of(rows, stages)
        return (_broad if broad else _both_stances)(stage, base, gates, options)

    result = search(rows)
    sure = rows.without(guessed(result.search))
    if not all(map(np.array_equal, sure.used, rows.used)):
        rows, result = sure, search(sure)
    left = result.search.system().left_out()[: rows.n]
    events = find_events(rows, left, gate=gates.event)
    events = not_of_shape(result.search, events)
    if not stand_out(events, gates):
        return result, []
    quiet = rows.without(event_masks(rows, events))
    return search(quiet), events


def guessed(search: Search) -> list[Mask]:
    """Samples (N, n) of each scene at which accepted effects may have any torque."""
    masks = [np.zeros_like(scene.slides) for scene in search.stage.scenes]
    for tried in search.accepted:
        c = tried.candidate
        for scene, mask in zip(search.stage.scenes, masks, strict=True):
            for joint, own in c.effect.guessed(scene, c.joint, c.settings).items():
                mask[:, joint] |= own
    return masks


def stand_out(events: Sequence[Interval], gates: Gates) -> bool:
    """Whether the strongest event is so strong that all of them are believed."""
    return max((event.score for event in events), default=0.0) >= STANDS_OUT * gates.event


def not_of_shape(search: Search, events: list[Interval]) -> list[Interval]:
    """Events without those where accepted effects, large there, may only not have quite the shape.

    A push is nothing beside which an effect that the logs show all along is large. What the effect
    shows is looked at a little around the event too, where it shows most in as short a time, and
    how far it swings there: shapes are wrong where effects change sign.
    """
    if not search.accepted or not events:
        return events
    system = search.system()
    left, shown = search.residual(system), search.shown(system)
    return [e for e in events if not of_shape(search, e, left[e.scene], shown[e.scene])]


def of_shape(search: Search, event: Interval, residual: Array, effects: Array) -> bool:
    """Whether an event's residual (N, n) is small beside its log's effects (N, n) around it."""
    scene = search.stage.scenes[event.scene]
    t = scene.motion.t - scene.motion.t[0]
    joints = list(event.joints)
    inside = (t >= event.start) & (t <= event.end)
    around = (t >= event.start - AROUND_S) & (t <= event.end + AROUND_S)
    left = residual[inside][:, joints] / search.noise[joints]
    shown = effects[around][:, joints] / search.noise[joints]
    strongest = float(np.max(uniform_filter1d(np.mean(shown**2, axis=1), int(inside.sum()))))
    swing = float(np.mean(np.ptp(shown[inside[around]], axis=0) ** 2))
    return bool(np.mean(left**2) < BESIDE**2 * max(strongest, swing))


def _again(search: Search, gates: Gates, options: DiscoverOptions) -> Searched:
    """Take back what does not pass the calibrated gates, and look for more."""
    _take_back(search, gates)
    return _search(search, gates, options)


def _take_back(search: Search, gates: Gates) -> None:
    take_back(search, lambda: [t for t in search.accepted if not gates.passes(search.marginal(t))])


def _outside(search: Search, gates: Gates) -> tuple[Dependence, ...]:
    """Joints whose residual smooth functions explain clearly better than their effects do."""
    found = []
    joints = {t.candidate.joint for t in search.accepted if t.candidate.joint is not None}
    with_effects = search.system().loss.sum(axis=0) if joints else np.zeros(0)
    for j in sorted(joints):
        others = replace(
            search, accepted=[t for t in search.accepted if t.candidate.joint != j]
        ).system()
        smooth = dependence(others, j, least_gain=gates.least(SMOOTH))
        without = float(others.loss[:, j].sum())
        by_effects = float(with_effects[j])
        by_smooth = (1.0 - smooth.relative) * without
        better = by_smooth < CLEARLY * by_effects
        worth = by_effects - by_smooth > WORTH * without
        short = without - by_effects < MOST * (without - by_smooth)
        another = by_smooth < ANOTHER * by_effects
        if smooth.rivals and better and (another or (worth and short)):
            found.append(smooth)
    return tuple(found)


def _beside(
    search: Search, outside: Sequence[Dependence], gates: Gates, options: DiscoverOptions
) -> Searched:
    """Search anew with smooth functions in place of those joints' effects.

    What touches those joints below the cut-off alone is left out, and constant changes: with part
    of a joint's torque free, nothing tells them any more. What the whole arm has shown beside them
    stays, and so does what shows above the cut-off.
    """
    taken, n = {dependence.joint for dependence in outside}, search.stage.rows.n

    def gate(tried: Tried) -> bool:
        free = tried.above_too or not taken & tried.joints(n)
        return gates.passes(tried) and free

    smooth = [rival for dependence in outside for rival in dependence.rivals]
    fresh = Search.begin(
        search.stage, search.base, kept=search.kept, broad=search.broad, smooth=smooth
    )
    for tried in search.accepted:
        apart = tried.candidate.joint is None or tried.above_too or not tried.joints(n)
        if apart and gates.passes(fresh.marginal(tried)):
            fresh.add(tried)
    effects = [effect for effect in CATALOGUE.values() if not effect.change]
    ranked = searched(fresh, effects, gate, options.max_effects)
    return Searched(fresh, tuple(ranked))


def _dependences(
    search: Search, gates: Gates, known: Sequence[Dependence] = ()
) -> tuple[Dependence, ...]:
    """What smooth functions find at every joint; `known` of the same search at a lower gate."""
    system = search.system()
    least = gates.least(SMOOTH)
    return tuple(
        known[j] if known and _stands(known[j], least) else dependence(system, j, least_gain=least)
        for j in range(search.stage.rows.n)
    )


def _stands(known: Dependence, least: float) -> bool:
    """Whether a higher gate leaves a dependence as it is."""
    first = known.trials[0] if known.trials else None
    return first is None or first.relative >= least * first.scarcity


def _both_stances(stage: Stage, base: Base, gates: Gates, options: DiscoverOptions) -> Searched:
    """Search with the base free; with the file kept as well, where the file is off."""
    search = Search.begin(stage, base, kept=False)
    held = Search.begin(stage, base, kept=True)
    scale = np.maximum(search.rms(), 1e-12)
    off = float(np.mean((held.rms() / scale) ** 2)) > 1 + CHANGED
    free = _about_itself(_search(search, gates, options), gates, options)
    if not off:
        return free
    kept = _search(held, gates, options)
    return kept if kept.search.accepted and _as_good(kept.search, free.search) else free


def _broad(stage: Stage, base: Base, gates: Gates, options: DiscoverOptions) -> Searched:
    """Search with the base free, friction's broad terms in any case."""
    search = Search.begin(stage, base, kept=False, broad=True)
    return _about_itself(_search(search, gates, options), gates, options)


def _about_itself(found: Searched, gates: Gates, options: DiscoverOptions) -> Searched:
    """Search anew about the model that a search has found, where that is another.

    Not about the next one where what is found there leaves more.
    """
    for _ in range(RELINEARISED):
        if not found.search.accepted or moved(found.search) < MOVED:
            break
        stage, base = relinearised(found.search)
        begun = Search.begin(stage, base, kept=False, broad=found.search.broad)
        again = _search(begun, gates, options)
        if not _as_good(again.search, found.search):
            break
        found = again
    return found


def _as_good(search: Search, other: Search) -> bool:
    """Whether a search leaves hardly more than another, in mean square over the joints."""
    scale = np.maximum(other.rms(), 1e-12)
    return float(np.mean((search.rms() / scale) ** 2)) <= 1 + AS_GOOD


def _search(search: Search, gates: Gates, options: DiscoverOptions) -> Searched:
    effects = tuple(CATALOGUE.values())
    ranked = searched(search, effects, gates.passes, options.max_effects)
    return Searched(search, tuple(ranked))
