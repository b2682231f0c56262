"""Accepted effects that may be chance are taken back."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.floor import rms
from seqid_cli.discover.search import Search
from seqid_cli.discover.stationary import goes_with_motion

Array = NDArray[np.float64]

WORSE = 1.03  # times what the file leaves
PLAIN = 2.5  # noise floors that a joint's residual has where something is plainly missing


def take_back(search: Search, failing: Callable[[], Sequence[Tried]]) -> None:
    """Take accepted effects back, the last one first, until none fails beside the others."""
    while found := failing():
        search.accepted = search.without(found[-1]).accepted
        search.settle()


def take_back_doubtful(search: Search, floor: Array) -> None:
    """Take back effects that may be chance, and such that make nothing better than the file is.

    On few rows a free base foretells so badly that much seems to help it; in coloured noise of few
    independent values something always fits. `floor` (n,) N m is the noise with all effects.
    """
    n = search.stage.rows.n

    def failing() -> list[Tried]:
        worse = search.excess() > WORSE
        return [
            t
            for t in search.accepted
            if not (t.above_too or any(not worse[j] for j in t.joints(n)))
            or not _stands(search, t, floor)
        ]

    take_back(search, failing)


def _stands(search: Search, tried: Tried, floor: Array) -> bool:
    """Whether an effect's gain is no chance, or its joint lacks something in any case."""
    others = search.without(tried)
    system = others.system()
    (alone,) = search.stage.try_all(system, [tried.candidate])
    return search.holds(alone, system, floor) or _something_is_missing(
        others, tried, system.residual(), floor
    )


def _something_is_missing(
    others: Search, tried: Tried, residual: Sequence[Array], floor: Array
) -> bool:
    """Whether much is left without an effect, and it is all that was found at its joint.

    What shows in a few moments, a gap that is crossed say, fits some stretches better than others.
    """
    rows = others.stage.rows
    joints = tried.joints(rows.n)
    if any(joints & set(other.columns) for other in others.accepted):
        return False
    return any(
        rms(residual[j]) > PLAIN * floor[j] and goes_with_motion(rows, residual[j], j)
        for j in joints
        if len(residual[j])
    )
