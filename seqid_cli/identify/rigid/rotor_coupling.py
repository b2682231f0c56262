"""Whether rotors react on the links that carry them: the logs decide, or it is left open.

The torque of rotor i on its own joint is N_i^2 I_mi ddq_i (Eq. 43). A rotor that rides on a link
feels that link's motion as well, and the link feels the rotor's: N_i I_mi times accelerations of
other joints. `share` kappa of that coupling is 0 or 1. Both hypotheses are fitted, the errors of
friction and gravity included; with k and its standard error s of the fit that leaves kappa free,

    log odds = (k^2 - (k - 1)^2) / (2 s^2).

It must decide alike at neighbouring cut-offs. A k that is neither near 0 nor near 1 is a sign of
something else. Where the logs do not decide, the data sheet's model stays (rotors act on their own
joints alone), and what the other one would change counts as an error of the parameters: it is as
likely as not, or more where the logs favour it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.rigid.inertia_equations import InertiaEquations
from seqid_cli.typing import Array


@dataclass(frozen=True)
class Coupling:
    """The decision: whether the coupling is `used`, and how it came about.

    `errors` (p, d) are directions along which the other hypothesis would move the parameters, in
    standard deviations.
    """

    used: bool
    errors: Array
    notes: tuple[str, ...] = ()

    @classmethod
    def none(cls, size: int) -> "Coupling":
        """Nothing to decide for `size` parameters: no known rotor, or both models are the same."""
        return cls(False, np.zeros((size, 0)))


@dataclass(frozen=True)
class _Share:
    """The share of the coupling when it is left free, and its standard error."""

    value: float
    error: float

    @property
    def odds(self) -> float:
        """Logarithm of the odds of 1 against 0."""
        return (self.value**2 - (self.value - 1.0) ** 2) / (2.0 * self.error**2)

    def near(self, sigma: float) -> bool:
        """Whether it agrees with 0 or with 1 within so many standard errors."""
        return min(abs(self.value), abs(self.value - 1.0)) < sigma * self.error


def decide(
    equations: Sequence[InertiaEquations], *, max_sigma: float = 3.0, min_log_odds: float = 5.0
) -> Coupling:
    """Compare the two hypotheses by the logs.

    `equations`: with the rows of all logs; the first as they are used, the others at other
    cut-offs. `max_sigma`: standard errors within which the free share agrees with 0 or 1.
    `min_log_odds`: logarithm of the odds that decide: 5 are 150 to 1. Returns: not used where the
    logs do not decide, or not alike at all cut-offs.
    """
    own = equations[0]
    kappa = own.basis.size
    found = [_free(each) for each in equations]
    first = found[0]
    if first is None:
        return Coupling.none(kappa)
    sure = [
        share is not None and share.near(max_sigma) and abs(share.odds) > min_log_odds
        for share in found
    ]
    sides = {share.odds > 0 for share in found if share is not None}
    if all(sure) and len(sides) == 1:
        used = sides.pop()
        text = "the data show rotors coupled to the links that carry them; used as such"
        return Coupling(used, np.zeros((kappa, 0)), (text,) if used else ())
    # What does not decide does not count against the other hypothesis either.
    likely = max(0.5, 1.0 / (1.0 + np.exp(-np.clip(first.odds, -min_log_odds, min_log_odds))))
    without, coupled = (own.solved(own.with_coupling(share))[0].theta for share in (0.0, 1.0))
    errors = np.sqrt(likely) * (coupled - without)[:, None]
    return Coupling(False, errors, _open(first, near=first.near(max_sigma)))


def _free(equations: InertiaEquations) -> _Share | None:
    """The share that rows of one cut-off show; None where both models are the same."""
    kappa = equations.basis.size
    free, posterior = equations.solved(equations.joints)
    if not free.determined[kappa]:
        return None
    return _Share(float(free.theta[kappa]), float(np.sqrt(posterior.stated[kappa, kappa])))


def _open(share: _Share, *, near: bool) -> tuple[str, ...]:
    free = f"{share.value:.2f} +- {share.error:.2f} of it when left free"
    if not near:
        return (
            f"coupling of rotors to the links that carry them: {free}, neither 0 nor 1; something "
            "else is missing in the model, and the rotors act on their own joints alone",
        )
    return (
        f"these logs do not tell whether rotors are coupled to the links that carry them ({free}); "
        "they act on their own joints alone, and the standard errors allow for it",
    )
