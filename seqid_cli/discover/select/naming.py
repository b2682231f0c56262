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

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import TermResult
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.typing import Array

BEHIND = -float(logit(Options.alpha))  # log odds against a rival that is not told


@dataclass(frozen=True)
class NameConfidence:
    """How sure a term's name is.

    Attributes
    ----------
    confidence : float
        Probability that the term is there, and is what its name or one of `others`
        says.
    by_itself : float
        Probability that it is what its name says.
    others : tuple of str
        Names that these logs cannot rule out, the most probable first.
    """

    confidence: float
    by_itself: float
    others: tuple[str, ...] = ()


def tempered(gain: Array | float, options: Options) -> Array:
    """Return what gains are divided by before names compete.

    A rival that lacks a small share of `gain` is just not told then. Differences are
    never enlarged.
    """
    return np.maximum(options.negligible_share * np.asarray(gain) / BEHIND, 1.0)


def reality(share: float, gain: float, *, of_share: float = 0.6) -> float:
    """Return the probability that a term is more than the errors of a right model.

    Parameters
    ----------
    share : float
        Share of the squared error that it takes away.
    gain : float
        Log evidence for it.
    of_share : float
        Log odds per logit of the share; those of the gain's logarithm to base 10 are 1.
    """
    log_odds_of_share = of_share * logit(float(np.clip(share, 1e-3, 1.0 - 1e-3)))
    return float(expit(log_odds_of_share + np.log10(max(gain, 1.0))))


def steadiness(varied: float, share: float, floors_left: float) -> float:
    """Return the probability that a term is no error of another law.

    An effect always has the same size. Odds are even where its size varies, and as much
    as there was without it is left above the floor. They are so whatever its size does,
    where as much is left above what a right model may leave: what is not understood may
    be what the term is a part of, and its share in that is steady as well.

    Parameters
    ----------
    varied : float
        Log evidence that its size is another one in every block.
    share : float
        Share of the squared error that it takes away.
    floors_left : float
        RMS that the model leaves, in noise floors.
    """
    share_left = np.sqrt(1.0 - np.clip(share, 0.0, 1.0))

    def share_above(floors: float) -> float:
        return float(share_left * (1.0 - floors / max(floors_left, floors)))

    doubt = max(expit(varied) * share_above(1.0), share_above(MORE_THAN_NOISE))
    return float(1.0 - 0.5 * doubt)


def named(result: TermResult, *, floors_left: float = 1.0) -> NameConfidence:
    """Return how sure a term is to be there, and to be what its name says.

    Parameters
    ----------
    result : TermResult
        The term and its rivals.
    floors_left : float
        RMS that the model leaves at its joints, in noise floors.
    """
    shares = _name_probabilities(result)
    by_name = shares.pop(result.term.name, 0.0)
    by_share = sorted(shares.items(), key=lambda pair: -pair[1])
    likely = {name: share for name, share in by_share if share > Options.alpha}

    is_there = reality(result.share, result.evidence) * steadiness(
        result.log_evidence_of_variation, result.share, floors_left
    )
    # Beside much that is not understood odds are even that it is a part of that.
    is_there *= 1.0 - 0.5 * result.not_understood
    # What these logs lack the channels for is as likely as the name itself.
    untried = [name for name in result.untried if name not in likely]
    return NameConfidence(
        confidence=is_there * (by_name + sum(likely.values())),
        by_itself=is_there * by_name / (1.0 + len(result.untried)),
        others=(*likely, *untried),
    )


def tied_names(
    result: TermResult, names: Collection[str], *, of_most: float = 0.5
) -> set[str]:
    """Return the most probable of some names, and those that nearly are.

    Parameters
    ----------
    result : TermResult
        The term and its rivals.
    names : collection of str
        Names of rivals that may head the finding.
    of_most : float
        Share of the most probable one's probability, from which a name is tied with it.
    """
    shares = _name_probabilities(result)
    least = of_most * max(shares[name] for name in names)
    return {name for name in names if shares[name] >= least}


def _name_probabilities(result: TermResult) -> dict[str, float]:
    """Return the probability of each name, over drawn weights of the blocks."""
    scale = tempered(result.scored.score.total, result.model.ground.options)
    gains: dict[str, Array] = {}
    for rival in result.rivals:
        if rival.term.smooth:
            continue
        name = rival.term.name
        drawn = rival.score.drawn / scale
        gains[name] = np.maximum(gains.get(name, drawn), drawn)

    # Effects of other finished models take part by how far these are behind.
    if result.term.name in gains:
        for name, lag in result.alternatives.items():
            drawn = gains[result.term.name] - lag / scale
            gains[name] = np.maximum(gains.get(name, drawn), drawn)
    return shares_of(gains)


def shares_of(gains: Mapping[str, Array]) -> dict[str, float]:
    """Return the probability of each name.

    Parameters
    ----------
    gains : mapping of str to (DRAWS,) array
        Tempered gains over drawn weights of the blocks.
    """
    by_name = np.stack(list(gains.values()), axis=1)
    odds = np.exp(by_name - by_name.max(axis=1, keepdims=True))
    shares = np.mean(odds / odds.sum(axis=1, keepdims=True), axis=0)
    return dict(zip(gains, shares.tolist(), strict=True))
