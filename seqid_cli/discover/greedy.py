"""Greedy growth of a search: the best effect first, while it is worth more than clean data show."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.search import Gate, Search
from seqid_cli.discover.tellings import at_its_joint, sharper, simplest
from seqid_cli.model.effects.effect import Effect


def _steadier(search: Search, effects: Sequence[Effect], chosen: Tried, gate: Gate) -> Tried:
    """A slow effect of fewer parameters that does as well, on logs too short to show that it lasts.

    Something is there in any case, so that the risk of naming slow noise is not the question.
    """
    slow = [effect for effect in effects if effect.slow]
    if chosen.candidate.effect.slow or not slow:
        return chosen
    joints = [j for j in chosen.columns if j < search.stage.rows.n]
    rivals = search.ranked(slow, search.system(), refine=0, near=joints, doubtful=True)
    near = [t for t in rivals if set(t.columns) & set(chosen.columns) and gate(t)]
    return simplest([chosen, *near])


def searched(search: Search, effects: Sequence[Effect], gate: Gate, most: int) -> list[Tried]:
    """Add effects while the best one passes the gate; returns the last ranking.

    Parameters
    ----------
    search : Search
        Grows by what is accepted.
    effects : sequence of Effect
    gate : callable
        Whether a candidate's gain is more than clean data show.
    most : int
        Largest number of effects.
    """
    tried_already: set[tuple[str, int | None]] = set()
    while True:
        ranked = search.ranked(effects, search.system())
        passing = [
            t
            for t in ranked
            if gate(t) and not search.is_shape(t) and t.candidate.key not in tried_already
        ]
        if not passing or len(search.accepted) >= most:
            return ranked
        best, before = simplest(passing), len(search.accepted)
        chosen = _steadier(search, effects, best, gate)
        told = at_its_joint(search, sharper(search, chosen, passing))
        search.add(told)
        if len(search.accepted) > 1:
            search.polish()
            search.prune(gate)
        # What was taken back does not come again; other lines of a ripple do, while they stay.
        if not chosen.candidate.effect.wide or len(search.accepted) <= before:
            tried_already |= {t.candidate.key for t in (best, chosen, told)}
