"""What the selection decides by."""

from dataclasses import dataclass, field

from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.settings_in_force import in_force


def _min_log_evidence() -> float:
    return in_force(DiscoverSettings).evidence.min_log_evidence


def _negligible_share() -> float:
    return in_force(DiscoverSettings).evidence.negligible_share


@dataclass(frozen=True)
class Options:
    """What decides.

    A share that is `small` does not matter: `improvement`; a difference of two gains,
    an effect going before a smooth function then; and an error of an effect's torque,
    as no law is known better: less than that at its joints is not told. Beside effects
    that look like it the error's square must be small, or it may be `apart` of the
    torque, where motor and link move apart.
    """

    doubt: float = 0.025  # probability over drawn blocks that a term gains nothing
    small: float = field(default_factory=_negligible_share)
    # share of the squared error left out that a term must take away
    improvement: float = field(default_factory=_negligible_share)
    # log evidence that the best of all terms has on noise
    chance: float = field(default_factory=_min_log_evidence)
    apart: float = 0.5
    most: int = 8  # terms
