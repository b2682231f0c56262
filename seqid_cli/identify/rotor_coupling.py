"""Whether rotors react on the links that carry them: the logs decide, or it is left open.

The torque of rotor i on its own joint is N_i^2 I_mi ddq_i (Eq. 43). A rotor that rides on a link
feels that link's motion as well, and the link feels the rotor's: N_i I_mi times accelerations of
other joints. `share` kappa of that coupling is 0 or 1. Both hypotheses are fitted, the errors of
friction and gravity included; with k and its standard error s of the fit that leaves kappa free,

    log odds = (k^2 - (k - 1)^2) / (2 s^2).

A k that is neither near 0 nor near 1 is a sign of something else. Where the logs do not decide, the
data sheet's model stays (rotors act on their own joints alone), and what the other one would change
counts as an error of the parameters, in the measure in which it is likely.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.least_squares import Accumulator, Solution
from seqid_cli.identify.posterior import Posterior
from seqid_cli.robot.base import Basis

Array = NDArray[np.float64]

CONSISTENT = 3.0  # standard errors within which the free share agrees with 0 or 1
LOG_ODDS = 5.0  # that decide: 150 to 1


@dataclass(frozen=True)
class Coupling:
    """The decision: whether the coupling is `used`, and how it came about.

    `share` and `std_error` are those of the fit that leaves it free; `doubt` (p, d) are directions
    along which the other hypothesis would move the parameters, in standard deviations.
    """

    used: bool
    decided: bool
    share: float
    std_error: float
    doubt: Array
    notes: tuple[str, ...] = ()

    @classmethod
    def none(cls, size: int) -> Coupling:
        """Nothing to decide for `size` parameters: no known rotor, or both models are the same."""
        return cls(False, True, 0.0, np.inf, np.zeros((size, 0)))


class Equations(Protocol):
    """Rows of an identification whose last column is the share of the coupling."""

    basis: Basis
    joints: list[Accumulator]

    def with_coupling(self, share: float) -> list[Accumulator]:
        """The rows with the share held at a value."""
        ...

    def solved(self, joints: list[Accumulator]) -> tuple[Solution, Posterior]:
        """Solve rows, with the share free or held."""
        ...


def decide(equations: Equations) -> Coupling:
    """Compare the two hypotheses by what the logs say.

    Parameters
    ----------
    equations : Equations
        With the rows of all logs.

    Returns
    -------
    Coupling
        Not used where the logs do not decide.
    """
    kappa = equations.basis.size
    without = equations.solved(equations.with_coupling(0.0))[0].theta
    free, posterior = equations.solved(equations.joints)
    if not free.determined[kappa]:
        return Coupling.none(kappa)
    share, error = float(free.theta[kappa]), float(np.sqrt(posterior.covariance[kappa, kappa]))
    odds = (share**2 - (share - 1.0) ** 2) / (2.0 * error**2)
    near = min(abs(share), abs(share - 1.0)) < CONSISTENT * error
    if near and abs(odds) > LOG_ODDS:
        return Coupling(odds > 0, True, share, error, np.zeros((kappa, 0)), _decided(odds > 0))
    likely = 1.0 / (1.0 + np.exp(-np.clip(odds, -LOG_ODDS, LOG_ODDS)))
    moved = equations.solved(equations.with_coupling(1.0))[0].theta - without
    doubt = np.sqrt(likely) * moved[:, None]
    return Coupling(False, False, share, error, doubt, _open(share, error, near=near))


def _decided(used: bool) -> tuple[str, ...]:
    said = "the data show rotors coupled to the links that carry them; used as such"
    return (said,) if used else ()


def _open(share: float, error: float, *, near: bool) -> tuple[str, ...]:
    free = f"{share:.2f} +- {error:.2f} of it when left free"
    if not near:
        return (
            f"coupling of rotors to the links that carry them: {free}, neither 0 nor 1; something "
            "else is missing in the model, and the rotors act on their own joints alone",
        )
    return (
        f"these logs do not tell whether rotors are coupled to the links that carry them ({free}); "
        "they act on their own joints alone, and the standard errors allow for it",
    )
