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

import numpy as np

from seqid_cli.identify.rigid.inertia_equations import InertiaEquations, InertiaRows
from seqid_cli.typing import Array


def decide(
    equations: InertiaEquations,
    rows: Sequence[InertiaRows],
    *,
    max_sigma: float = 3.0,
    min_log_odds: float = 5.0,
) -> tuple[bool, Array, list[str]]:
    """Compare the two hypotheses by the logs; `rows` as used first, then at other cut-offs.

    The free share agrees with 0 or 1 within `max_sigma` standard errors; log odds of 5: 150 to 1.
    Returns whether the coupling is used, directions (p, d) along which the other hypothesis would
    move the parameters, in standard deviations, and notes.
    """
    kappa = equations.coupling_place
    nothing = np.zeros((kappa, 0))
    known = []  # value, standard error and log odds of the free share
    for own in rows if equations.rotors.any() else ():
        free, posterior = equations.solved(own, None)
        if free.determined[kappa]:
            k, error = float(free.theta[kappa]), float(np.sqrt(posterior.stated[kappa, kappa]))
            known.append((k, error, (2.0 * k - 1.0) / (2.0 * max(error, 1e-150) ** 2)))
        elif own is rows[0]:
            break
    if not known:  # both are the same
        return False, nothing, []
    share, error, odds = known[0]
    near = [min(abs(k), abs(k - 1.0)) < max_sigma * s for k, s, _ in known]
    sure = all(near) and all(abs(each) > min_log_odds for *_, each in known)
    if sure and len(known) == len(rows) and len({each > 0 for *_, each in known}) == 1:
        text = "the data show rotors coupled to the links that carry them; used as such"
        return odds > 0, nothing, [text] if odds > 0 else []
    # What does not decide does not count against the other hypothesis either.
    likely = max(0.5, 1.0 / (1.0 + np.exp(-np.clip(odds, -min_log_odds, min_log_odds))))
    without, coupled = (equations.solved(rows[0], each)[0].theta for each in (0.0, 1.0))
    left = f"{share:.2f} +- {error:.2f} of it when left free"
    note = (
        f"coupling of rotors to the links that carry them: {left}, neither 0 nor 1; something "
        "else is missing in the model, and the rotors act on their own joints alone"
    )
    if near[0]:
        note = (
            f"these logs do not tell whether rotors are coupled to the links that carry them "
            f"({left}); they act on their own joints alone, and the standard errors allow for it"
        )
    return False, np.sqrt(likely) * (coupled - without)[:, None], [note]
