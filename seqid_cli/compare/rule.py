"""When a number has changed: by more than its standard errors and by more than a share of its size.

    |b - a| > sigma sqrt(e_a^2 + e_b^2)    and    |b - a| > rtol max(|a|, |b|, least)

The first condition alone would report the last digits of another machine where data are good; the
second alone the noise of another log where they are poor. Numbers without a standard error are
judged by their size alone.
"""

from __future__ import annotations

import math

from seqid_cli.params.results.comparison import Difference, RuleEntry

DEFAULT_SIGMA = 4.0  # one false alarm in 160 comparisons of 100 parameters each
DEFAULT_RTOL = 0.01


class Rule(RuleEntry, frozen=True):
    """Limits of a change: `sigma` standard errors (None: not used) and `rtol`."""

    @classmethod
    def of(cls, sigma: float | None, rtol: float | None, *, rounding: float = 1e-6) -> Rule:
        """Take the limits that were given; with neither, the defaults of both.

        Of one alone, it alone decides, down to rounding.
        """
        if sigma is None and rtol is None:
            return cls(sigma=DEFAULT_SIGMA, rtol=DEFAULT_RTOL)
        return cls(sigma=sigma, rtol=rounding if rtol is None else rtol)

    def broken(self, sigmas: float | None, relative: float | None) -> bool:
        """Return whether a difference is a change; it is where `relative` is None."""
        if relative is None:
            return True
        if sigmas is not None and self.sigma is not None and sigmas <= self.sigma:
            return False
        return relative > self.rtol


def judged(
    stage: str,
    name: str,
    joint: str,
    unit: str,
    values: tuple[float, float],
    errors: tuple[float, float] | None,
    rule: Rule,
    *,
    least: float = 0.0,
    remark: str = "",
) -> Difference:
    """Return two values (and their standard errors) as a difference, judged by a rule.

    `least` is the size that the number has at least.
    """
    a, b = values
    moved = abs(b - a)
    size = max(abs(a), abs(b), least)
    relative = moved / size if size > 0.0 else 0.0
    error = math.hypot(*errors) if errors is not None else 0.0
    sigmas = moved / error if error > 0.0 else None
    return Difference(
        stage=stage,
        name=name,
        joint=joint,
        unit=unit,
        a=a,
        b=b,
        std_error=error if error > 0.0 else None,
        sigmas=sigmas,
        relative=relative,
        different=rule.broken(sigmas, relative),
        remark=remark,
    )


def missing(stage: str, name: str, *, joint: str = "", there: bool) -> Difference:
    """Return the change that a number is missing, in the second file if it is `there`."""
    remark = "only in the first" if there else "only in the second"
    return unlike(stage, name, joint, remark)


def unlike(stage: str, name: str, joint: str, remark: str) -> Difference:
    """Return a change that has no numbers."""
    return Difference(stage=stage, name=name, joint=joint, remark=remark)
