"""How sure a term is, and its name.

That a term is more than the errors of a model which lacks nothing goes with the share
of the squared error that it takes away where it was not fitted, and with its gain in
log predictive density: a logistic regression on cases of which the truth is known
(docs/explanation/discovery.md). How sure its name is follows from the gains of all
effects that touch the same channels, over drawn weights of the blocks (D. B. Rubin,
"The Bayesian bootstrap", Annals of Statistics 9, 1981). The gains are tempered: no law
is exactly the effect's, and of a large effect the rows tell laws apart that differ by
less than the effect's own does from its law. Smooth functions have no part in it: where
one is clearly better than all effects, it is what the selection takes. An effect that
looks alike and that these logs lack the channels for cannot be ruled out: it is as
likely as the name. Effects of `TermResult.alternatives` count by their evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import TermResult
from seqid_cli.typing import Array

TOLD = 0.7  # probability from which something is told
BEHIND = -float(logit(Options.doubt))  # log odds against a rival that is not told


@dataclass(frozen=True)
class NameConfidence:
    """How sure a name is: it or one of `others`, and it by itself."""

    confidence: float
    by_itself: float
    others: tuple[str, ...] = ()


def tempered(gain: Array | float) -> Array:
    """By what gains are divided, so that a rival that lacks a small share of `gain` is not told."""
    return np.maximum(Options.small * np.asarray(gain) / BEHIND, 1.0)  # never enlarged


def reality(share: float, gain: float, *, of_share: float = 0.6) -> float:
    """Probability that a term is more than the errors of a model that lacks nothing.

    `share` is what it takes away of the squared error, `gain` the log evidence for it.
    The log odds are `of_share` of its logit and the gain's logarithm to base 10.
    """
    odds = of_share * logit(float(np.clip(share, 1e-3, 1.0 - 1e-3)))
    return float(expit(odds + np.log10(max(gain, 1.0))))


def steadiness(varied: float, share: float, left: float) -> float:
    """Probability that a term is no error of another law: an effect always has the same size.

    `varied` is the log evidence that its size is another one in every block, `share`
    what it takes away of the squared error, `left` what the model leaves in noise
    floors. Odds are even where its size varies, and as much as there was without it is
    left above the floor.
    """
    above = np.sqrt(1.0 - np.clip(share, 0.0, 1.0)) * (1.0 - 1.0 / max(left, 1.0))
    return float(1.0 - 0.5 * expit(varied) * above)


def named(taken: TermResult, left: float = 1.0) -> NameConfidence:
    """How sure a term is to be there, and to be what its name says; `left` as in `steadiness`."""
    shares = _shares(taken)
    own = shares.pop(taken.term.name, 0.0)
    others = {name: share for name, share in shares.items() if share > Options.doubt}
    there = reality(taken.share, taken.evidence) * steadiness(
        taken.log_evidence_of_variation, taken.share, left
    )
    every = (*others, *(name for name in taken.untried if name not in others))
    by_itself = there * own / (1.0 + len(taken.untried))
    return NameConfidence(there * (own + sum(others.values())), by_itself, every)


def probable_names(taken: TermResult, *, of_most: float = 0.5) -> set[str]:
    """Names that may head a finding; all of them, unless the most probable one is a change.

    A change of the file's values adds no law: its parameters are the model's own. So a
    law with fewer parameters is no simpler, and heads the finding only if it is
    `of_most` as probable.
    """
    names = {rival.term.name for rival in taken.rivals}
    if taken.term.smooth:
        return names
    shares = _shares(taken)
    first = max(shares, key=lambda name: shares[name])
    changes = {rival.term.name for rival in taken.rivals if rival.term.change}
    if first not in changes:
        return names
    return {name for name, share in shares.items() if share >= of_most * shares[first]}


def _shares(taken: TermResult) -> dict[str, float]:
    """Probability of each name."""
    scale, gains = tempered(taken.scored.score.total), dict[str, Array]()
    for rival in (rival for rival in taken.rivals if not rival.term.smooth):
        name, own = rival.term.name, rival.score.drawn / scale
        gains[name] = np.maximum(gains.get(name, own), own)
    if taken.term.name in gains:
        for name, behind in taken.alternatives.items():
            own = gains[taken.term.name] - behind / scale
            gains[name] = np.maximum(gains.get(name, own), own)
    return shares_of(gains)


def shares_of(gains: Mapping[str, Array]) -> dict[str, float]:
    """Probability of each name, from tempered gains (DRAWS,) over drawn weights of the blocks."""
    best = np.stack(list(gains.values()), axis=1)
    odds = np.exp(best - best.max(axis=1, keepdims=True))
    shares = np.mean(odds / odds.sum(axis=1, keepdims=True), axis=0)
    return dict(zip(gains, shares.tolist(), strict=True))
