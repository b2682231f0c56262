"""What the selection decides by."""

from dataclasses import dataclass


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
    small: float = 0.04
    # share of the squared error left out that a term must take away
    improvement: float = small
    chance: float = 6.0  # log evidence that the best of all terms has on noise
    apart: float = 0.5
    most: int = 8  # terms
