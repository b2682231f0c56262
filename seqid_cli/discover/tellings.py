"""Which of several tellings of one effect is taken before it is accepted.

The leader of a ranking may be the same thing as another candidate: with more parameters, at the
other of two joints, or as the rows above the cut-off show it as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.search import Search

Array = NDArray[np.float64]

TIE = 0.02  # of the gain, that one more parameter must be worth
TELLS_MORE = 0.5  # of what one telling leaves: another leaves less
AS_GOOD = 0.98  # of its gain, that an effect told at its other joint must have


def simplest(ranked: Sequence[Tried]) -> Tried:
    """The leader, or a candidate of fewer parameters that does as well."""
    leader = ranked[0]
    for other in ranked[1:]:
        fewer = leader.candidate.freedom - other.candidate.freedom
        if fewer > 0 and other.trial.total >= (1 - TIE * fewer) * leader.trial.total:
            leader = other
    return leader


def at_its_joint(search: Search, tried: Tried) -> Tried:
    """An effect between two joints, told at the one whose residual it clearly explains most."""
    c = tried.candidate
    partner = c.effect.seen_from_partner(c.joint, c.settings)
    if partner is None:
        return tried
    joint, settings = partner
    before = search.system()
    rest = _left(search, tried) / np.maximum(before.loss.sum(axis=0), 1e-300)
    if TELLS_MORE * rest[c.joint] <= rest[joint]:
        return tried
    found = search.stage.try_all(before, [replace(c, joint=joint, settings=settings)])
    as_good = found and found[0].trial.total >= AS_GOOD * tried.trial.total
    return found[0] if as_good and search.stage.plausible(found[0]) else tried


def sharper(search: Search, tried: Tried, ranked: Sequence[Tried]) -> Tried:
    """The effect as the rows below the cut-off tell it, where that clearly fits these better.

    What is faster than the position loop moves the arm: above the cut-off it looks smaller, and
    later.
    """
    c = tried.candidate
    same = [t for t in ranked if t.candidate.key == c.key and t.candidate.below]
    if c.below or c.joint is None or not same:
        return tried
    all_rows, below = (_left(search, t)[c.joint] for t in (tried, same[0]))
    return same[0] if below < TELLS_MORE * all_rows else tried


def _left(search: Search, tried: Tried) -> Array:
    """Squared residual (channels,) with the candidate accepted, on left-out folds."""
    told = replace(search, accepted=[*search.accepted, tried])
    return np.asarray(told.system().loss.sum(axis=0))
