"""What the selection ranks, and what it ends with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.rows import Score, TermFit
from seqid_cli.discover.select.terms import Term
from seqid_cli.typing import Array

Key = tuple[str, int | None]


@dataclass(frozen=True)
class ScoredTerm:
    """A term, what it gains given all rows, and on blocks that were left out."""

    term: Term
    fit: TermFit
    score: Score


def again(term: Term, model: Model) -> ScoredTerm:
    """A taken term as it gains beside all others."""
    return ScoredTerm(term, *model.linear.again(term.part))


class TermInModel:
    """What a term does beside all others: the less of beside a free base, and beside the file."""

    def __init__(self, term: Term, model: Model) -> None:
        self.term, self.model = term, model

    @cached_property
    def scored(self) -> ScoredTerm:
        """It, as it was tried before it was taken."""
        return again(self.term, self.model)

    @cached_property
    def linear(self) -> LinearModel:
        """The model without it."""
        return self.model.beside(self.term)

    @cached_property
    def evidence(self) -> float:
        """Log evidence for it."""
        return min(self.scored.score.total, self.model.margin(self.linear))

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
        return min(self.scored.score.share, *beyond)


@dataclass(frozen=True)
class TermResult:
    """A term of the finished model.

    `evidence` (log) and `share` of the squared error are no more than beside a base
    that may leave the file, and beyond the file as it is.
    """

    scored: ScoredTerm
    # all that touches its channels, itself included, in its place
    rivals: tuple[ScoredTerm, ...]
    # (M_c,) N m by channel: left-out blocks by the model without it
    left_without: Sequence[Array]
    evidence: float
    share: float
    model: Model  # that it is judged in
    # effects that may stand in its place, log evidence they lack
    alternatives: Mapping[str, float]
    log_evidence_of_variation: (
        float  # log evidence that its size is another one in every block
    )
    # look alike, but these logs lack the channels to look for them
    untried: tuple[str, ...] = ()

    @property
    def term(self) -> Term:
        """The term."""
        return self.scored.term


@dataclass(frozen=True)
class SelectionResult:
    """The finished model, the terms that are told, and what the model hides."""

    model: Model
    terms: tuple[TermResult, ...]
    # share of each other effect's torque that it does not absorb
    visible_shares: Mapping[Key, float]
    # last, beside all that was taken, the largest gain first
    untaken: tuple[ScoredTerm, ...] = ()

    @property
    def effects(self) -> list[TermResult]:
        """Those of the catalogue."""
        return [one for one in self.terms if not one.term.smooth]

    @property
    def smooth(self) -> list[TermResult]:
        """Smooth functions."""
        return [one for one in self.terms if one.term.smooth]
