"""Which quantities a residual depends on in truth, and not only through what moves along.

Rivals are added one at a time, always the one that foretells most of what is left, a single
quantity before a product that does hardly better, until the next adds too little. Then each must
still be needed beside the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.rivals import Filtered, Rival, known_beforehand, tried
from seqid_cli.discover.system import Block, System, Trial

Array = NDArray[np.float64]

NEARLY = 0.9  # of a product's gain: a single quantity with so much is preferred
LEAST_SHARE = 0.2  # of the first rival's gain, which each further one must add
LEAST_GAIN = 0.01  # of the joint's loss, which the first must take away
MOST = 3


@dataclass(frozen=True)
class Dependence:
    """What the residual of one joint depends on.

    Attributes
    ----------
    joint : int
    quantities : tuple of str
        As the contract spells them, the strongest first; empty if nothing is foretold.
    rivals : tuple of Rival
        In the order in which they were added.
    trials : tuple of Trial
        What each added to those before it.
    relative : float
        Share of the joint's held-out squared residual that all of them take away.
    """

    joint: int
    quantities: tuple[str, ...]
    rivals: tuple[Rival, ...]
    trials: tuple[Trial, ...]
    relative: float


def dependence(
    system: System, joint: int, *, least_gain: float = LEAST_GAIN, most: int = MOST
) -> Dependence:
    """Find what the residual of a joint depends on by forward selection.

    Parameters
    ----------
    system : System
        Base and accepted effects.
    joint : int
    least_gain : float
        Share of the joint's held-out squared residual that the first rival must take away; raise
        it to what clean data give (the largest gain of `best_rivals` there).
    most : int
        At most so many rivals.
    """
    rows = system.rows
    if rows.count(joint) == 0:
        return Dependence(joint, (), (), (), 0.0)
    filtered = Filtered.of(rows)
    candidates = filtered.rivals(joint, system.residual()[joint])
    loss = max(float(system.loss[:, joint].sum()), 1e-300)
    chosen: list[tuple[Rival, Trial]] = []
    # The functions have no constant, and not every base has one.
    start = current = extended(system, {joint: np.ones((rows.count(joint), 1))})
    while len(chosen) < most:
        rival, trial = simplest(tried(current, candidates, filtered))
        least = LEAST_SHARE * chosen[0][1].total if chosen else least_gain * loss * trial.scarcity
        if trial.total < least:
            break
        chosen.append((rival, trial))
        current = extended(current, filtered.columns(rival))
    if not chosen:
        return Dependence(joint, (), (), (), 0.0)
    kept = _needed(start, chosen, [filtered.columns(rival) for rival, _ in chosen])
    rest = float(current.loss[:, joint].sum())
    return Dependence(
        joint,
        tuple(dict.fromkeys(q for rival, _ in kept for q in rival.quantities)),
        tuple(rival for rival, _ in kept),
        tuple(trial for _, trial in kept),
        max(0.0, 1.0 - rest / loss),
    )


def simplest(ranked: Sequence[tuple[Rival, Trial]]) -> tuple[Rival, Trial]:
    """Return the first of `ranked`, or a single quantity with nearly its gain."""
    top = ranked[0][1].total
    near = [pair for pair in ranked if pair[0].single and pair[1].total >= NEARLY * top]
    return near[0] if near and top > 0 else ranked[0]


def extended(system: System, columns: dict[int, Array]) -> System:
    """Add a rival's columns to the base of a system.

    Where the rows say nothing, what is known of its coefficients beforehand keeps the torque small.
    """
    ((joint, X),) = columns.items()
    held = known_beforehand(system.residual()[joint], X.shape[1])
    block = Block(columns, np.sqrt(held) * np.eye(X.shape[1]))
    blocks = [*system.blocks, block]
    return System(system.rows, system.y, system.noise, blocks, system.high)


def _needed(
    system: System,
    chosen: Sequence[tuple[Rival, Trial]],
    columns: Sequence[dict[int, Array]],
) -> list[tuple[Rival, Trial]]:
    """Leave out the rivals that those added after them have made superfluous."""
    kept = list(range(len(chosen)))
    for k in range(len(chosen)):
        others = [i for i in kept if i != k]
        if not others:
            break
        without = system
        for i in others:
            without = extended(without, columns[i])
        rival = chosen[k][0]
        held = known_beforehand(without.residual()[rival.joint], rival.size)
        if without.tried([columns[k]], [held])[0].total < 0.5 * LEAST_SHARE * chosen[0][1].total:
            kept = others
    return [chosen[i] for i in kept]
