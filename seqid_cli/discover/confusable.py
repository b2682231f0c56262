"""Which other effects these data cannot tell from a finding, and how sure its name is.

Two candidates are compared by their gains on the same folds: the difference has a mean and a
scatter over the folds. A rival whose shortfall is not clear, while it has a good part of the gain,
is reported as confusable. How clear the others are gives the probability that it is the leader or
one of those; how clear all are, that it is the leader itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.system import Trial

CLEAR = 3.0  # standard errors by which a rival falls short
GOOD_PART = 0.5  # of the gain
EQUAL = 0.97  # of the gain: whatever the scatter, no difference that matters


@dataclass(frozen=True)
class Rivalry:
    """How a candidate compares: `share` of the leader's gain, `clear` standard errors behind."""

    tried: Tried
    share: float
    clear: float

    @property
    def confusable(self) -> bool:
        """Whether these data do not tell it from the leader."""
        return self.share >= EQUAL or (self.share >= GOOD_PART and self.clear < CLEAR)


def rivalries(leader: Tried, ranked: Sequence[Tried]) -> list[Rivalry]:
    """Compare all other effects that touch a joint of the leader's with it.

    The same effect at the same joints is no other: a drive of two joints can be either's.
    """
    name, joints = leader.candidate.effect.name, set(leader.columns)
    return [
        Rivalry(t, t.trial.total / max(leader.trial.total, 1e-300), behind(leader.trial, t.trial))
        for t in ranked
        if t.candidate.key != leader.candidate.key
        and (t.candidate.effect.name != name or set(t.columns) != joints)
        and set(t.columns) & joints
    ]


def behind(leader: Trial, other: Trial) -> float:
    """Standard errors, over the folds, by which another candidate gains less."""
    difference = leader.gain - other.gain
    count = len(difference)
    error = float(np.std(difference, ddof=1)) * np.sqrt(count) if count > 1 else np.inf
    return float(difference.sum() / max(error, 1e-300))


def certainty(rivals: Sequence[Rivalry]) -> float:
    """Probability that it is none of `rivals`, from how clearly they fall behind."""
    odds = sum(
        np.exp(-0.5 * max(r.clear, 0.0) ** 2) * min(max(r.share, 0.0), 1.0) ** 2
        for r in rivals
        if r.share > 0
    )
    return float(1.0 / (1.0 + odds))


def event_confidence(ratio: float) -> float:
    """Confidence in an event from its score over the gate: a half at the gate itself."""
    return float(1.0 - 0.5 ** max(ratio, 0.0) ** 2)
