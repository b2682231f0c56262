"""Terms that say that the file's values do not hold, judged beside a base that holds to the file.

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
from seqid_cli.discover.select.naming import TOLD, reality, shares_of, tempered
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import TermInModel, TermResult
from seqid_cli.discover.select.search import Search
from seqid_cli.discover.select.terms import Term
from seqid_cli.model.effects.registry import catalogue_of

if TYPE_CHECKING:
    from seqid_cli.discover.select.selection import Selection

MOST_ERRORS = 3.0  # of the file, by which its values may be off for want of statistics
# of the best one's gain, from which a change of values stands for a set of terms
OF_A_SET = 0.5


class TermAgainstFile(TermInModel):
    """A term beside a base that leaves the file by its errors only, with and without the term."""

    @cached_property
    def evidence(self) -> float:
        """Log evidence for it."""
        margin = self.model.margin(self.linear, MOST_ERRORS)
        return min(self.scored.score.total, margin)


@dataclass(frozen=True, kw_only=True)
class ValueChange:
    """A change of the file's values that stands for several terms, or for a base that left it."""

    taken: TermResult
    instead_of: tuple[Term, ...]  # terms of the model that are not told beside it


def held_to_file(model: Model, terms: Sequence[Term]) -> Model:
    """Fit a model with some terms whose base leaves the file by its errors only."""
    held = Model(model.ground, model.hold.capped(MOST_ERRORS))
    held.terms = list(terms)
    held.settle()
    return held


def value_changes(
    selection: Selection, told: Sequence[TermResult], least: float
) -> list[ValueChange]:
    """Find the changes of values that are hidden by other terms, or by a base that left the file.

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
    sure = [
        taken.term for taken in told if reality(taken.share, taken.evidence) >= TOLD
    ]
    places = (None, *range(selection.model.ground.n))
    found = [_at_place(selection, joint, sure, least) for joint in places]
    return [change for change in found if change is not None]


@dataclass(frozen=True, kw_only=True)
class Cause:
    """An effect that may be what has changed; `probability` among those that may be."""

    term: Term
    probability: float
    log_gain: float  # in log predictive density, beside the file and by itself


def causes_at(model: Model, joint: int, terms: Sequence[Term]) -> list[Cause]:
    """Find the effects that may be what has changed at a joint, the most probable first.

    Parameters
    ----------
    model : Model
        The finished one.
    joint : int
    terms : sequence of Term
        What is known beside it.

    Returns
    -------
    list of Cause
        Each by itself beside a base that leaves the file by its errors only.
    """
    bare = held_to_file(model, terms)
    known = tuple(catalogue_of(model.ground.stage.scenes[0].robot).values())
    changes = [effect for effect in known if effect.change]
    search = Search(bare, changes)
    tried = [one for place in (joint, None) for one in search.effects_at(place, bare)]
    able = [one for one in tried if one.evidence > 0.0 and joint in one.term.channels]
    gains = bare.linear.scores([one.term.part for one in able])
    by_name = {one.term.name: gain for one, gain in zip(able, gains, strict=True)}
    if not by_name:
        return []

    best = max(gain.total for gain in gains)
    scale = tempered(best)
    shares = shares_of({name: gain.drawn / scale for name, gain in by_name.items()})
    causes = [
        Cause(
            term=one.term,
            probability=shares[one.term.name],
            log_gain=by_name[one.term.name].total,
        )
        for one in able
    ]
    likely = [cause for cause in causes if cause.probability > Options.doubt]
    return sorted(likely, key=lambda cause: -cause.probability)


def _at_place(
    selection: Selection, joint: int | None, sure: Sequence[Term], least: float
) -> ValueChange | None:
    """The change of values at a joint (None: of the whole arm), if one may stand for all."""
    model = selection.model
    group = [term for term in model.terms if not term.smooth and term.joint == joint]
    unsure = [term for term in group if term not in sure and not model.is_detail(term)]
    scale = model.hold.rigid if joint is None else model.hold.of(joint)
    beside_others = len(group) > 1 and any(term.change for term in group)
    if scale <= MOST_ERRORS and not unsure and not beside_others:
        return None

    # What there is at the place by itself: in place of all, beside a base that holds to
    # the file.
    others = [term for term in model.terms if term not in group]
    bare = held_to_file(model, others)
    alone = [
        one for one in selection.alone_at(joint, bare) if one.fit.log_bayes_factor > 0.0
    ]
    changes = [one for one in alone if one.term.change and one.term.joint == joint]
    if not changes:
        return None
    first = changes[0]
    stands = selection.as_good(first, alone[0])
    if not stands and len(unsure) == len(group):
        best = max(one.score.total for one in alone if not one.term.smooth)
        stands = first.score.total >= OF_A_SET * best
    if not stands:
        return None

    with_change = held_to_file(model, [*others, first.term])
    weighed = TermAgainstFile(first.term, with_change)
    if not selection.is_told(weighed, least):
        return None
    return ValueChange(taken=selection.taken_of(weighed), instead_of=tuple(unsure))
