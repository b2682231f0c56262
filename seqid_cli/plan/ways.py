"""The ways from the end of each planned move to the start of the next one.

A controller that is sent to the start of a move drives all joints on a straight line.
That line is no planned move, and may go below the floor or through the arm itself,
though both its ends are free. It can be driven round by way of a posture from which
both ends are free on straight lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.strokes import postures_of
from seqid_cli.typing import Array

STEP = 0.05  # rad (m), between postures that are looked at: a link moves 5 cm at most
DRAWN = 200  # postures among which one to go round by is looked for
TRIED = 24  # of them, from the highest that is free to the lowest
LISTED = 4  # moves that a note names


@dataclass(frozen=True, kw_only=True)
class Way:
    """A straight line in the joints from the end of a move to the start of `to`."""

    to: str
    ends: Array  # (2, n) rad (m where prismatic)


def ways_of(moves: Sequence[PlannedMove], names: Sequence[str]) -> list[Way]:
    """Return the ways between moves, in their order."""
    ways = []
    for before, after in pairwise(moves):
        end = dict(before.start)
        if before.strokes:
            end[before.joints[0]] = before.strokes[-1].end
        ends = [[place[name] for name in names] for place in (end, after.start)]
        ways.append(Way(to=after.name, ends=np.array(ends)))
    return ways


def note_on_ways(belief: Belief, moves: Sequence[PlannedMove]) -> str:
    """Say which ways between moves are not free, and by which posture to go round."""
    ways = ways_of(moves, belief.robot.joint_names)
    if not belief.bounded or not ways:
        return "the ways between moves are not checked"
    blocked = [way for way in ways if not _is_free(belief, *way.ends)]
    if not blocked:
        return (
            "the ways between moves were checked as straight lines of all joints, and"
            " are free; that to the first move is not known"
        )

    listed = ", ".join(way.to for way in blocked[:LISTED])
    if len(blocked) > LISTED:
        listed += f" and {len(blocked) - LISTED} more"
    note = (
        f"the ways between moves: {len(blocked)} of {len(ways)} are not free as"
        " straight lines of all joints (below the floor, or links touch): those to"
        f" {listed}"
    )
    posture, count = _best_posture(belief, blocked)
    if not count:
        return f"{note}; drive there slowly, by postures high above the base"
    unit = "rad or m" if belief.robot.chain.prismatic.any() else "rad"
    angles = ", ".join(
        f"{name} {angle:.2f}"
        for name, angle in zip(belief.robot.joint_names, posture, strict=True)
    )
    shares = "all of them" if count == len(blocked) else f"{count} of them"
    return f"{note}; by way of {angles} {unit} {shares} are"


def _is_free(belief: Belief, start: Array, end: Array) -> bool:
    """Return whether nothing is touched on a straight line of all joints."""
    count = 2 + int(np.abs(end - start).max() / STEP)
    line = np.linspace(start, end, count)
    # The floor is cheap to ask, links that may touch are not.
    if belief.floor is not None and belief.floor.below(line).any():
        return False
    return not belief.touches(line).any()


def _best_posture(belief: Belief, blocked: Sequence[Way]) -> tuple[Array, int]:
    """Return the posture by which most ways are free, and how many are."""
    drawn = postures_of(belief.limits, DRAWN, np.random.default_rng(0))
    # What a note shows is what is looked at.
    drawn = np.round(drawn, 2)
    free = drawn[~belief.touches(drawn)]
    if belief.floor is not None:
        free = free[np.argsort(-belief.floor.height(free))]

    best = (np.zeros(belief.robot.n), 0)
    for posture in free[:: max(1, len(free) // TRIED)]:
        count = sum(
            all(_is_free(belief, end, posture) for end in way.ends) for way in blocked
        )
        if count > best[1]:
            best = (posture, count)
        if count == len(blocked):
            break
    return best
