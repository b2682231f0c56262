"""The rule that decides whether a number has changed, and numbers that one file lacks.

A number has changed from a to b when

    |b - a| > sigma sqrt(e_a^2 + e_b^2)    and    |b - a| > rtol max(|a|, |b|, least),

e_a and e_b its standard errors. The first condition alone would report the last digits
of another machine where data are good; the second alone the noise of another log where
they are poor. Numbers without a standard error are judged by their size alone.
"""

import math
from collections.abc import Iterator, Mapping
from typing import TypeVar

from msgspec.structs import replace

from seqid_cli import shares
from seqid_cli.params.results.comparison import Difference, RuleEntry

Pair = tuple[float, float]  # of the first and of the second file
NOT_DETERMINED = "not determined by the logs of a file"
K = TypeVar("K")
V = TypeVar("V")


def judged(
    place: Difference,
    rule: RuleEntry,
    values: Pair,
    std_errors: tuple[float | None, float | None] = (0.0, 0.0),
    *,
    least: float = 0.0,
) -> Difference:
    """Return a difference with its numbers and whether they count as changed.

    Parameters
    ----------
    place : Difference
        Stage, joint, name and unit of the number.
    rule : RuleEntry
        Limits of a change.
    values, std_errors : pair of float
        The number in both files, and its standard errors: 0 of one that has none, None
        of one that its logs do not determine. The latter says nothing of a change.
    least : float
        Size that the number has at least, in its own unit.
    """
    a, b = values
    relative = shares.change(a, b, least)
    first_error, second_error = std_errors
    if first_error is None or second_error is None:
        return replace(
            place, a=a, b=b, relative=relative, remark=NOT_DETERMINED, different=False
        )
    std_error = math.hypot(first_error, second_error)
    sigmas = abs(b - a) / std_error if std_error > 0.0 else None

    within_errors = False
    if sigmas is not None and rule.sigma is not None:
        within_errors = sigmas <= rule.sigma
    return replace(
        place,
        a=a,
        b=b,
        std_error=std_error or None,
        sigmas=sigmas,
        relative=relative,
        different=not within_errors and abs(relative) > rule.rtol,
    )


def missing(stage: str, name: str, joint: str = "", *, in_first: bool) -> Difference:
    """Return the difference that one file alone has a number, the first or the second.

    A difference without numbers counts as a change.
    """
    remark = "only in the first" if in_first else "only in the second"
    return Difference(stage=stage, name=name, joint=joint, remark=remark)


def pairs(
    first: Mapping[K, V], second: Mapping[K, V]
) -> Iterator[tuple[K, V | None, V | None]]:
    """Yield all keys of two mappings with both values; None where one lacks the key."""
    for key in {**first, **second}:
        yield key, first.get(key), second.get(key)
