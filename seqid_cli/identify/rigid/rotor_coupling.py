"""Reaction of rotors on the links that carry them: decided by the logs, or left open.

The torque of rotor i on its own joint is N_i^2 I_mi ddq_i (Eq. 43). A rotor that rides
on a link feels that link's motion as well, and the link feels the rotor's: N_i I_mi
times accelerations of other joints. `share` kappa of that coupling is 0 or 1. Both
hypotheses are fitted, the errors of friction and gravity included; with k and its
standard error s of the fit that leaves kappa free,

    log odds = (k^2 - (k - 1)^2) / (2 s^2).

It must decide alike at neighbouring cut-offs. A k that is neither near 0 nor near 1 is
a sign of something else. Where the logs do not decide, the data sheet's model stays
(rotors act on their own joints alone), and what the other one would change counts as an
error of the parameters: it is as likely as not, or more where the logs favour it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.rigid.inertia_equations import InertiaEquations
from seqid_cli.identify.rigid.inertia_rows import InertiaRows
from seqid_cli.identify.settings import RotorSettings
from seqid_cli.typing import Array


@dataclass(frozen=True)
class Coupling:
    """What the logs say of the coupling of rotors to the links that carry them.

    `directions` (p, d): along which the other hypothesis would move the parameters, in
    standard deviations. `contradicted`: why neither hypothesis agrees with the logs,
    empty where one does.
    """

    used: bool
    directions: Array
    notes: tuple[str, ...] = ()
    contradicted: str = ""


@dataclass(frozen=True)
class FreeShare:
    """The share of the coupling that logs ask for when it is left free."""

    value: float
    std_error: float

    @property
    def log_odds(self) -> float:
        """Log odds of a share of 1 against one of 0."""
        return (2.0 * self.value - 1.0) / (2.0 * max(self.std_error, 1e-150) ** 2)

    @property
    def sigma(self) -> float:
        """Standard errors from the nearer hypothesis."""
        return min(abs(self.value), abs(self.value - 1.0)) / max(self.std_error, 1e-150)


def decide(
    equations: InertiaEquations,
    rows: Sequence[InertiaRows],
    settings: RotorSettings = RotorSettings(),
) -> Coupling:
    """Compare the two hypotheses by the logs.

    Parameters
    ----------
    equations : InertiaEquations
    rows : sequence of InertiaRows
        As used first, then at other cut-offs.
    settings : RotorSettings
        When the free share agrees with 0 or 1, and from which odds that is decided on.
    """
    min_log_odds = settings.min_log_odds
    nothing = np.zeros((equations.coupling_place, 0))
    shares = _free_shares(equations, rows) if equations.rotors.any() else []
    if not shares:  # both are the same
        return Coupling(used=False, directions=nothing)

    used = shares[0]
    near = [share.sigma < settings.max_sigma for share in shares]
    sure = all(near) and all(abs(share.log_odds) > min_log_odds for share in shares)
    same_side = len({share.log_odds > 0.0 for share in shares}) == 1
    if sure and same_side and len(shares) == len(rows):
        coupled = used.log_odds > 0.0
        text = "the data show rotors coupled to the links that carry them; used as such"
        return Coupling(
            used=coupled, directions=nothing, notes=(text,) if coupled else ()
        )

    # What does not decide does not count against the other hypothesis either.
    odds = float(np.clip(used.log_odds, -min_log_odds, min_log_odds))
    likely = max(0.5, 1.0 / (1.0 + np.exp(-odds)))
    without = equations.solved(rows[0], 0.0)[0].theta
    coupled_theta = equations.solved(rows[0], 1.0)[0].theta
    directions = np.sqrt(likely) * (coupled_theta - without)[:, None]
    free_text = f"{used.value:.2f} +- {used.std_error:.2f} of it when left free"
    if near[0]:
        note = (
            "these logs do not tell whether rotors are coupled to the links that carry"
            f" them ({free_text}); they act on their own joints alone, and the standard"
            " errors allow for it"
        )
        return Coupling(used=False, directions=directions, notes=(note,))
    note = (
        f"coupling of rotors to the links that carry them: {free_text}, neither 0 nor"
        " 1; something else is missing in the model, and the rotors act on their own"
        " joints alone"
    )
    return Coupling(used=False, directions=directions, contradicted=note)


def _free_shares(
    equations: InertiaEquations, rows: Sequence[InertiaRows]
) -> list[FreeShare]:
    """Return the free share at each cut-off that determines it.

    The list is empty unless the first cut-off determines the share.
    """
    place = equations.coupling_place
    shares = []
    for own_rows in rows:
        free, posterior = equations.solved(own_rows, None)
        if free.determined[place]:
            std_error = float(np.sqrt(posterior.stated[place, place]))
            shares.append(FreeShare(float(free.theta[place]), std_error))
        elif own_rows is rows[0]:
            return []
    return shares
