"""What the selection decides by."""

from __future__ import annotations

from dataclasses import dataclass, field

from seqid_cli.discover.settings import EvidenceSettings


def _negligible_share() -> float:
    return EvidenceSettings().negligible_share


@dataclass(frozen=True)
class Options:
    """What decides whether a term is taken, kept and told.

    Those that are settings have no value in the class: `Options.small` would be the
    default whatever the user has set.

    Attributes
    ----------
    doubt : float
        Probability, over drawn blocks, that a term gains nothing: at most this.
    small : float
        A share that does not matter: of the squared error (`improvement`), of a
        difference of two gains, of an effect that goes before a smooth function, and of
        an effect's torque, as no law is known better. Less than that at its joints is
        not told. Beside effects that look like it the error's square must be small.
    improvement : float
        Share of the squared error left out that a term must take away.
    chance : float
        Log evidence that the best of all terms has on noise.
    told : float
        Probability to be there from which a term is told.
    apart : float
        Share of an effect's torque that may be the error of its law, beside effects
        that look like it, where motor and link move apart.
    most : int
        Number of terms.
    """

    doubt: float = 0.025
    small: float = field(default_factory=_negligible_share)
    improvement: float = field(default_factory=_negligible_share)
    chance: float = field(default_factory=lambda: EvidenceSettings().min_log_evidence)
    told: float = field(default_factory=lambda: EvidenceSettings().min_confidence)
    apart: float = 0.5
    most: int = 8

    @classmethod
    def of(cls, settings: EvidenceSettings) -> Options:
        """Return the options by a user's settings."""
        return cls(
            small=settings.negligible_share,
            improvement=settings.negligible_share,
            chance=settings.min_log_evidence,
            told=settings.min_confidence,
        )
