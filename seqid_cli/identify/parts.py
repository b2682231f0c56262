"""Stages as reductions: what one log says, how two such parts merge, and what the whole gives.

Parts of different logs are independent of each other, so anyone may make them: this process, others
or a cluster (`seqid_cli.scale`). They are merged in one binary tree whose shape depends on the
number of logs alone; the result is the same to the last bit, whoever made the parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol, TypeVar, runtime_checkable

from seqid_cli.identify.tree import Tree

L = TypeVar("L")  # a Recording, or a log that is passed over
P = TypeVar("P")
R = TypeVar("R")
PartOf = Callable[[L, int], P]
Merge = Callable[[P, P], P]


@runtime_checkable
class Reducible(Protocol):
    """Recordings that know better than one after the other how to be worked on."""

    def reduced(self, part: PartOf[Any, P], merge: Merge[P]) -> P | None:
        """Merge the parts of all recordings; None without any."""

    def mapped(self, part: PartOf[Any, R]) -> Iterator[R]:
        """Yield the parts in the order of the recordings."""


def reduced(recordings: Iterable[L], part: PartOf[L, P], merge: Merge[P]) -> P | None:
    """Merge what every recording says.

    Parameters
    ----------
    recordings : iterable of Recording, or of logs to be passed over
        If it is `Reducible`, it decides who does the work.
    part : callable
        From a recording and its number to a part. To be sent elsewhere it must be an object of a
        class, or a function, of a module.
    merge : callable
        From two neighbouring parts to one.

    Returns
    -------
    part or None
        None without recordings.
    """
    if isinstance(recordings, Reducible):
        return recordings.reduced(part, merge)
    tree: Tree[P] = Tree(merge)
    for number, recording in enumerate(recordings):
        tree.push(part(recording, number))
    return tree.root()


def mapped(recordings: Iterable[L], part: PartOf[L, R]) -> Iterator[R]:
    """Yield what every recording says, in their order; see `reduced`."""
    if isinstance(recordings, Reducible):
        yield from recordings.mapped(part)
        return
    for number, recording in enumerate(recordings):
        yield part(recording, number)
