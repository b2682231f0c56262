"""What the selection scores, and what it ends with."""

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
    """A term, its fit given all rows, and its score on blocks that were left out."""

    term: Term
    fit: TermFit
    score: Score


def again(term: Term, model: Model) -> ScoredTerm:
    """Score a term of a model, as if it were to be added to all others."""
    fit, score = model.linear.again(term.part)
    return ScoredTerm(term=term, fit=fit, score=score)


class TermInModel:
    """How much a term of a model is worth beside all others, worked out as it is asked.

    Parameters
    ----------
    term : Term
        One of the model's.
    model : Model
        With the term.
    """

    def __init__(self, term: Term, model: Model) -> None:
        self.term = term
        self.model = model

    @cached_property
    def scored(self) -> ScoredTerm:
        """The term, scored as it was before it was taken."""
        return again(self.term, self.model)

    @cached_property
    def linear(self) -> LinearModel:
        """The model without it."""
        return self.model.beside(self.term)

    @cached_property
    def evidence(self) -> float:
        """Log evidence for it: the less of its score and of that beside a free base."""
        return min(self.scored.score.total, self.model.margin(self.linear))

    @cached_property
    def share(self) -> float:
        """Share of the squared error that it takes away, beyond the file as it is.

        Of a smooth function by the squares of blocks that were left out as well: it
        follows large errors of a few blocks which an effect's law does not.
        """
        residuals_before = [self.model.ground.rows.y]
        if self.term.smooth:
            residuals_before.append(tuple(self.linear.left_out))
        beyond = [
            self.model.beyond(residual, self.term.channels)
            for residual in residuals_before
        ]
        return min(self.scored.score.share, *beyond)


@dataclass(frozen=True, kw_only=True)
class TermResult:
    """A term of the finished model, with what may stand in its place.

    Attributes
    ----------
    scored : ScoredTerm
        The term.
    rivals : tuple of ScoredTerm
        All that touches its channels, itself included, in its place.
    left_without : sequence of (M_c,) arrays
        By channel, what the model without it leaves of left-out blocks [N m].
    evidence : float
        Log evidence for it, no more than beside a base that may leave the file.
    share : float
        Share of the squared error, no more than beyond the file as it is.
    model : Model
        The model that it is judged in.
    alternatives : mapping of str to float
        Effects that may stand in its place, with the log evidence that they lack.
    log_evidence_of_variation : float
        For its size to be another one in every block.
    untried : tuple of str
        Effects that look like it, but these logs lack the channels to look for them.
    not_understood : float
        Share that larger smooth functions at its joints have in their gain and its own.
    """

    scored: ScoredTerm
    rivals: tuple[ScoredTerm, ...]
    left_without: Sequence[Array]
    evidence: float
    share: float
    model: Model
    alternatives: Mapping[str, float]
    log_evidence_of_variation: float
    untried: tuple[str, ...] = ()
    not_understood: float = 0.0

    @property
    def term(self) -> Term:
        """The term."""
        return self.scored.term


@dataclass(frozen=True)
class SelectionResult:
    """The finished model, the terms that are told, and what the model hides.

    Attributes
    ----------
    model : Model
        With all its terms, told or not.
    terms : tuple of TermResult
        Those that are told.
    visible_shares : mapping of Key to float
        Share of each other effect's torque that the model does not absorb.
    untaken : tuple of ScoredTerm
        What was tried last, beside all that was taken, the largest gain first.
    """

    model: Model
    terms: tuple[TermResult, ...]
    visible_shares: Mapping[Key, float]
    untaken: tuple[ScoredTerm, ...] = ()

    @property
    def effects(self) -> list[TermResult]:
        """Effects of the catalogue among the terms."""
        return [result for result in self.terms if not result.term.smooth]

    @property
    def smooth(self) -> list[TermResult]:
        """Smooth functions among the terms."""
        return [result for result in self.terms if result.term.smooth]
