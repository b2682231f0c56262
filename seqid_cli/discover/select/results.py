"""What the selection ranks, and what it ends with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from seqid_cli.discover.select.linear import Linear
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.rows import Gained, Predicted
from seqid_cli.discover.select.terms import Term
from seqid_cli.typing import Array

Key = tuple[str, int | None]


@dataclass(frozen=True)
class Ranked:
    """A term, what it gains given all rows, and on blocks that were left out."""

    term: Term
    gained: Gained
    predicted: Predicted


def again(term: Term, model: Model) -> Ranked:
    """A taken term as it gains beside all others."""
    return Ranked(term, *model.linear.again(term.part))


class Weighed:
    """What a term does beside all others: the less of beside a free base, and beside the file."""

    def __init__(self, term: Term, model: Model) -> None:
        self.term, self.model = term, model

    @cached_property
    def one(self) -> Ranked:
        """It, as it was tried before it was taken."""
        return again(self.term, self.model)

    @cached_property
    def linear(self) -> Linear:
        """The model without it."""
        return self.model.beside(self.term)

    @cached_property
    def evidence(self) -> float:
        """Log evidence for it."""
        return min(self.one.predicted.total, self.model.margin(self.linear))

    @cached_property
    def share(self) -> float:
        """Share of the squared error that it takes away.

        Of a smooth function by the squares of blocks that were left out as well: it
        follows large errors of a few blocks which an effect's law does not.
        """
        model = self.model
        first = [
            model.ground.rows.y,
            *([self.linear.left_out] if self.term.smooth else []),
        ]
        beyond = [model.beyond(left, self.term.channels) for left in first]
        return min(self.one.predicted.share, *beyond)


@dataclass(frozen=True)
class Taken:
    """A term of the finished model.

    `evidence` (log) and `share` of the squared error are no more than beside a base
    that may leave the file, and beyond the file as it is.
    """

    one: Ranked
    # all that touches its channels, itself included, in its place
    rivals: tuple[Ranked, ...]
    # (M_c,) N m by channel: left-out blocks by the model without it
    left: Sequence[Array]
    evidence: float
    share: float
    model: Model  # that it is judged in
    # effects that may stand in its place, log evidence they lack
    instead: Mapping[str, float]
    varied: float  # log evidence that its size is another one in every block
    # look alike, but these logs lack the channels to look for them
    untried: tuple[str, ...] = ()

    @property
    def term(self) -> Term:
        """The term."""
        return self.one.term


@dataclass(frozen=True)
class Selected:
    """The finished model, the terms that are told, and what the model hides."""

    model: Model
    taken: tuple[Taken, ...]
    # share of each other effect's torque that it does not absorb
    visible: Mapping[Key, float]
    # last, beside all that was taken, the largest gain first
    tried: tuple[Ranked, ...] = ()

    @property
    def effects(self) -> list[Taken]:
        """Those of the catalogue."""
        return [one for one in self.taken if not one.term.smooth]

    @property
    def smooth(self) -> list[Taken]:
        """Smooth functions."""
        return [one for one in self.taken if one.term.smooth]
