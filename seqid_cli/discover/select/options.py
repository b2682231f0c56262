"""What the selection decides by."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """What decides whether a term is taken, kept and told.

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
    apart : float
        Share of an effect's torque that may be the error of its law, beside effects
        that look like it, where motor and link move apart.
    most : int
        Number of terms.
    """

    doubt: float = 0.025
    small: float = 0.04
    improvement: float = small
    chance: float = 6.0
    apart: float = 0.5
    most: int = 8
