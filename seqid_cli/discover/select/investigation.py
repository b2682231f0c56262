"""An investigation by the selection, in the terms of the search that it is built beside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import Base, base_of
from seqid_cli.discover.candidates import Candidate, Stage
from seqid_cli.discover.dependence import Dependence
from seqid_cli.discover.events import Interval, event_masks, find_events
from seqid_cli.discover.gates import Gates
from seqid_cli.discover.investigate import (
    Investigation,
    Named,
    Searched,
    floor_of,
    not_of_shape,
    stand_out,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.rivals import Rival
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.search import Search
from seqid_cli.discover.select.selection import Ground, Options, Ranked, Selected, select
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

DRAWS = 400  # of weights of the blocks
SELDOM = 0.05  # share of them, below which a rival is not told
SEED = 0


def investigate_by_evidence(
    logs: Sequence[Recording], robot: Robot, stages: Stages, options: DiscoverOptions
) -> Investigation:
    """Select what a model lacks, and tell events in what is left.

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    """
    rows = rows_of(scenes_of(logs, robot, stages, options=options.motion))
    stage, base, gates = Stage(rows), base_of(rows, stages), Gates()
    found = select(Ground.of(stage, base, Options()))
    search = _search_of(found, stage, base)
    left = search.system().left_out()[: rows.n]
    events = not_of_shape(search, find_events(rows, left, gate=gates.event))
    if stand_out(events, gates):
        rows = rows.without(event_masks(rows, events))
        stage, base = Stage(rows), base_of(rows, stages)
        found = select(Ground.of(stage, base, Options()))
        search = _search_of(found, stage, base)
    else:
        events = []
    return _told(logs, search, found, events, gates)


def _told(
    logs: Sequence[Recording],
    search: Search,
    found: Selected,
    events: Sequence[Interval],
    gates: Gates,
) -> Investigation:
    smooth = tuple(_dependence(search, one) for one in found.terms if one.term.smooth)
    named = {
        one.term.key: named_of(one, rivals)
        for one, rivals in zip(found.terms, found.rivals, strict=True)
        if not one.term.smooth
    }
    return Investigation(
        tuple(logs),
        Searched(search, ()),
        gates,
        search.base.start,
        floor_of(logs, search, events),
        (),
        tuple(events),
        smooth,
        named,
    )


def _search_of(found: Selected, stage: Stage, base: Base) -> Search:
    """A search that has arrived at what was selected."""
    rivals = [one.term.what for one in found.terms if isinstance(one.term.what, Rival)]
    search = Search.begin(
        stage,
        base,
        kept=found.shape == "held",
        broad=found.shape == "slow terms free",
        smooth=rivals,
    )
    for one in found.terms:
        if isinstance(one.term.what, Candidate):
            search.add(search.stage.try_all(search.system(), [one.term.what])[0])
    return search


def _dependence(search: Search, one: Ranked) -> Dependence:
    rival = one.term.what
    assert isinstance(rival, Rival)
    trial = search.system().tried([dict(one.term.part.columns)])[0]
    return Dependence(rival.joint, rival.quantities, (rival,), (trial,), one.foretold.share)


def named_of(one: Ranked, rivals: Sequence[Ranked]) -> Named:
    """How often it is the best of its rivals over drawn weights of the blocks.

    A smooth function must be better by as much as makes a tie.

    Rubin, "The Bayesian bootstrap", Annals of Statistics 9, 1981.
    """
    rng = np.random.default_rng(SEED)
    weights = rng.exponential(size=(DRAWS, len(one.foretold.density)))
    gains = weights @ np.array([rival.foretold.density for rival in rivals]).T
    gains -= Options().tie * one.foretold.total * np.array([rival.term.smooth for rival in rivals])
    best = np.argmax(gains, axis=1)
    shares: dict[str, float] = {}
    for number, rival in enumerate(rivals):
        name = "" if rival.term.smooth else rival.term.name
        shares[name] = shares.get(name, 0.0) + float(np.mean(best == number))
    own = shares.get(one.term.name, 0.0)
    others = [n for n, share in shares.items() if n not in ("", one.term.name) and share > SELDOM]
    return Named(own + sum(shares[n] for n in others), own, tuple(others))
