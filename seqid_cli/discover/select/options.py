"""What the selection decides by."""

from __future__ import annotations

from dataclasses import dataclass, field

from seqid_cli.discover.settings import EvidenceSettings


def _negligible_share() -> float:
    return EvidenceSettings().negligible_share


@dataclass(frozen=True)
class Options:
    """What decides whether a term is taken, kept and told.

    Those that are settings have no value in the class: `Options.negligible_share` would
    be the default whatever the user has set.

    Attributes
    ----------
    alpha : float
        Probability, over drawn blocks, that a term gains nothing: at most this.
    negligible_share : float
        A share that does not matter: of the squared error (`improvement`), of a
        difference of two gains, of an effect that goes before a smooth function, and of
        an effect's torque, as no law is known better. Less than that at its joints is
        not told. Beside effects that look like it the error's square must be small.
    improvement : float
        Share of the squared error left out that a term must take away.
    min_log_bayes_factor : float
        Log evidence that the best of all terms has on noise.
    min_confidence : float
        Probability to be there from which a term is told.
    apart : float
        Share of an effect's torque that may be the error of its law, beside effects
        that look like it, where motor and link move apart.
    max_terms : int
        Number of terms.
    """

    alpha: float = 0.025
    negligible_share: float = field(default_factory=_negligible_share)
    improvement: float = field(default_factory=_negligible_share)
    min_log_bayes_factor: float = field(
        default_factory=lambda: EvidenceSettings().min_log_evidence
    )
    min_confidence: float = field(
        default_factory=lambda: EvidenceSettings().min_confidence
    )
    apart: float = 0.5
    max_terms: int = 8

    @classmethod
    def of(cls, settings: EvidenceSettings) -> Options:
        """Return the options by a user's settings."""
        return cls(
            negligible_share=settings.negligible_share,
            improvement=settings.negligible_share,
            min_log_bayes_factor=settings.min_log_evidence,
            min_confidence=settings.min_confidence,
        )
