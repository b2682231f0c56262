"""Findings beside a larger one at the same joint: another effect, or its law's error.

A parameter file has taken up a part of an effect that was there from the start, and no
law is exactly the catalogue's. What is left beside the largest finding of a joint is
often no second effect but the difference of these two. It has the form of friction and
gravity, as far as they go: a base that may leave the file by hundreds of its errors
takes it up. An effect that is really there has a form of its own, and gains as much
beside such a base as it does beside the file.

So a smaller finding is worth what it gains there. A change of the file's values is not
asked: its form is that of the base (see `changes`).

Where the larger finding is a smooth function, it is not understood, and an effect
beside it may be a part of the same. Of a change of the file's values a function of time
is no such thing: it says how the change goes on, as where a gear warms up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from seqid_cli.discover.select.model import Model, PriorScale
from seqid_cli.discover.select.naming import reality
from seqid_cli.discover.select.results import TermResult, again
from seqid_cli.discover.select.search import is_wide
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import Term

# Times the file's errors, by which the base may leave it: ten times what the evidence
# may choose for a whole model.
LOOSE = PriorScale(300.0)


def worth_beside_larger(
    model: Model, results: Mapping[Term, TermResult], min_confidence: float
) -> dict[Term, TermResult]:
    """Judge findings beside a larger one at a joint by what no base takes up.

    Parameters
    ----------
    model : Model
        The finished one.
    results : mapping of Term to TermResult
        What would be told.
    min_confidence : float
        Probability to be there from which a finding is told.

    Returns
    -------
    dict of Term to TermResult
        Those that are told, with the evidence and the share that they have there.
    """
    judged = {
        term: replace(result, not_understood=share_not_understood(result, results))
        for term, result in results.items()
    }
    smaller = [term for term in results if _has_larger(results[term], results)]
    if not smaller:
        return judged

    loose = model.held_otherwise(LOOSE, model.terms)
    for term in smaller:
        score = again(term, loose).score
        evidence = min(results[term].evidence, score.total)
        share = min(results[term].share, score.share)
        if reality(share, evidence) >= min_confidence:
            judged[term] = replace(judged[term], evidence=evidence, share=share)
        else:
            del judged[term]
    return judged


def _has_larger(result: TermResult, results: Mapping[Term, TermResult]) -> bool:
    """Return whether something that gains more was found at one of its joints."""
    if result.term.change or result.term not in result.model.terms:
        return False
    return bool(_larger(result, results))


def _larger(result: TermResult, results: Mapping[Term, TermResult]) -> list[TermResult]:
    """Return what gains more than a finding, at one of its joints."""
    return [
        other
        for other in results.values()
        if other.term.channels & result.term.channels
        and other.scored.score.total > result.scored.score.total
    ]


def share_not_understood(
    result: TermResult, results: Mapping[Term, TermResult]
) -> float:
    """Return the share of larger smooth functions in their gain and a finding's.

    A ripple or a line in time is finer than any smooth function: it is no part of one.
    Nor is a change of the file's values part of a function of time: that is its course.
    """
    if is_wide(result.term):
        return 0.0
    gain = max(result.scored.score.total, 0.0)
    of_functions = sum(
        other.scored.score.total
        for other in _larger(result, results)
        if other.term.smooth and not (result.term.change and _is_of_time(other.term))
    )
    return of_functions / max(of_functions + gain, 1e-300)


def _is_of_time(term: Term) -> bool:
    """Return whether a term is a smooth function of time, with its direction or not."""
    return isinstance(term.what, SmoothFunction) and term.what.quantities[0] == "time"
