"""Changes of the file's values, judged beside a base that holds to the file.

A change of friction, a torque constant or an offset has the form of the base itself. A
base that may leave the file by thirty of its errors takes it up, and so do waves over a
turn on a joint that travels less than one. Judged beside what contains it, such a term
is worth nothing, so is each of several that contain one another, and the size of one
that is told is anything. Therefore one that may stand for all that was selected at a
joint is tried in place of all of it, beside a base that leaves the file by its errors
only. What it is worth there, and how large it is, is told.

Three times its standard errors a file may be off for want of statistics. What asks for
more says itself that the values do not hold, so that it is no rival of a term that says
which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.naming import reality, shares_of, tempered
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import TermInModel, TermResult
from seqid_cli.discover.select.search import Search
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.select.tuning import FittedTerm
from seqid_cli.effects.registry import catalogue_of

if TYPE_CHECKING:
    from seqid_cli.discover.select.selection import Selection

MOST_ERRORS = 3.0  # of the file, by which its values may be off for want of statistics
# of the best one's gain, from which a change of values stands for a set of terms
OF_A_SET = 0.5


class TermAgainstFile(TermInModel):
    """A term beside a base that leaves the file by its errors only, or without it."""

    @cached_property
    def evidence(self) -> float:
        """Log evidence for it."""
        margin = self.model.margin(self.linear, MOST_ERRORS)
        return min(self.scored.score.total, margin)


@dataclass(frozen=True, kw_only=True)
class ValueChange:
    """A change of the file's values that stands for several terms, or for a free base.

    Attributes
    ----------
    result : TermResult
        The change.
    instead_of : tuple of Term
        Terms of the model that are not told beside it.
    """

    result: TermResult
    instead_of: tuple[Term, ...]


def held_to_file(model: Model, terms: Sequence[Term]) -> Model:
    """Fit a model with some terms whose base leaves the file by its errors only."""
    return model.held_otherwise(model.hold.capped(MOST_ERRORS), terms)


def value_changes(
    selection: Selection, told: Sequence[TermResult], least: float
) -> list[ValueChange]:
    """Find the changes of values that other terms hide, or a base that left the file.

    Parameters
    ----------
    selection : Selection
        The finished one.
    told : sequence of TermResult
        Terms that are told, each judged beside all others.
    least : float
        Probability from which a change is told.

    Returns
    -------
    list of ValueChange
        One per joint at most, and one for the whole arm.
    """
    sure_terms = [
        result.term
        for result in told
        if reality(result.share, result.evidence) >= selection.options.min_confidence
    ]
    places = (None, *range(selection.model.ground.n))
    changes = [_change_at(selection, joint, sure_terms, least) for joint in places]
    return [change for change in changes if change is not None]


@dataclass(frozen=True, kw_only=True)
class Cause:
    """An effect that may be what has changed.

    Attributes
    ----------
    term : Term
        The effect.
    probability : float
        Among all that may be.
    log_gain : float
        In log predictive density, beside the file and by itself.
    """

    term: Term
    probability: float
    log_gain: float


def causes_at(model: Model, joint: int, terms: Sequence[Term]) -> list[Cause]:
    """Find the effects that may be what has changed at a joint, the likeliest first.

    Parameters
    ----------
    model : Model
        The finished one.
    joint : int
        Index of the joint.
    terms : sequence of Term
        What is known beside it.

    Returns
    -------
    list of Cause
        Each by itself beside a base that leaves the file by its errors only.
    """
    bare = held_to_file(model, terms)
    catalogue = catalogue_of(model.ground.stage.scenes[0].robot).values()
    search = Search(bare, [effect for effect in catalogue if effect.change])

    possible: list[FittedTerm] = []
    for place in (joint, None):
        for fitted in search.effects_at(place, bare):
            if fitted.evidence > 0.0 and joint in fitted.term.channels:
                possible.append(fitted)
    if not possible:
        return []

    scores = bare.linear.scores([fitted.term.part for fitted in possible])
    score_of = {
        fitted.term.name: score for fitted, score in zip(possible, scores, strict=True)
    }
    largest = max(score.total for score in scores)
    scale = tempered(largest, model.ground.options)
    probability_of = shares_of(
        {name: score.drawn / scale for name, score in score_of.items()}
    )
    causes = [
        Cause(
            term=fitted.term,
            probability=probability_of[fitted.term.name],
            log_gain=score_of[fitted.term.name].total,
        )
        for fitted in possible
    ]
    likely = [cause for cause in causes if cause.probability > Options.alpha]
    return sorted(likely, key=lambda cause: -cause.probability)


def _change_at(
    selection: Selection, joint: int | None, sure_terms: Sequence[Term], least: float
) -> ValueChange | None:
    """Return the change of values at a joint that stands for all its terms, if any.

    With `joint` None it is one of the whole arm.
    """
    model = selection.model
    at_place = [term for term in model.terms if not term.smooth and term.joint == joint]
    unsure = [
        term
        for term in at_place
        if term not in sure_terms and not model.is_detail(term)
    ]
    scale = model.hold.rigid if joint is None else model.hold.of(joint)
    beside_others = len(at_place) > 1 and any(term.change for term in at_place)
    if scale <= MOST_ERRORS and not unsure and not beside_others:
        return None

    # In place of all that is there, else beside what is sure: a file may lack friction
    # over the position and have a wrong offset.
    in_place_of_all = _change_beside(
        selection, joint, at_place=at_place, staying=(), unsure=unsure, least=least
    )
    sure = [term for term in at_place if term in sure_terms and not term.change]
    if in_place_of_all is not None or not sure:
        return in_place_of_all
    return _change_beside(
        selection, joint, at_place=at_place, staying=sure, unsure=unsure, least=least
    )


def _change_beside(
    selection: Selection,
    joint: int | None,
    *,
    at_place: Sequence[Term],
    staying: Sequence[Term],
    unsure: Sequence[Term],
    least: float,
) -> ValueChange | None:
    """Return the change of values at a joint that is told beside some of its terms.

    Parameters
    ----------
    selection : Selection
        The finished one.
    joint : int or None
        The place; None for the whole arm.
    at_place : sequence of Term
        The model's terms there.
    staying : sequence of Term
        Those of them beside which the change is tried.
    unsure : sequence of Term
        Those that are not told beside it.
    least : float
        Probability from which it is told.
    """
    # Beside a base that holds to the file.
    model = selection.model
    beside = [term for term in model.terms if term not in at_place or term in staying]
    bare = held_to_file(model, beside)
    taken = {term.key for term in staying}
    alone = [
        scored
        for scored in selection.alone_at(joint, bare)
        if scored.fit.log_bayes_factor > 0.0 and scored.term.key not in taken
    ]
    changes = [
        scored for scored in alone if scored.term.change and scored.term.joint == joint
    ]
    if not changes:
        return None

    # It stands where nothing does clearly better; or in place of terms of which none is
    # sure by itself, if it has a good part of the best one's gain.
    first = changes[0]
    stands = selection.as_good(first, alone[0])
    if not stands and len(unsure) == len(at_place):
        best_gain = max(
            scored.score.total for scored in alone if not scored.term.smooth
        )
        stands = first.score.total >= OF_A_SET * best_gain
    if not stands:
        return None

    with_change = held_to_file(model, [*beside, first.term])
    judged = TermAgainstFile(first.term, with_change)
    if not selection.is_told(judged, least):
        return None
    return ValueChange(result=selection.result_of(judged), instead_of=tuple(unsure))
