"""How the law's torque changes with its delays, in rows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.drive.equations import Delays, Equations, JointLaw
from seqid_cli.typing import Array

# Steps in which delays are moved [s]: much less than a period of the band, much more
# than rounding.
STEP_S = 2e-4


def slopes_over_delays(
    law: JointLaw,
    names: Sequence[str],
    theta: Array,
    delays: Delays,
    equations: Equations,
) -> Array:
    """Return the slopes (M, 1 or 2) [N m/s] of a law over both delays.

    The second column is that of the torque's lag, where there is a torque. A command
    that steps has no slope over its delay: that column is zero, and the lag moves the
    motion alone.
    """
    steps = law.course == "held"
    measured = law.logs[0].measured
    moves: dict[int, dict[str, float]] = {}
    if not steps:
        moves[0] = {"command": STEP_S}
    if measured:
        moves[1] = {"torque": STEP_S, "command": -STEP_S if steps else 0.0}
    slopes = np.zeros((len(equations.y), 2 if measured else 1))
    # Bends change little with a delay: those of the equations are taken out below.
    bare = replace(law, bends=False)
    for k, move in moves.items():
        later = bare.equations(names, delays.moved(**move))
        back = {name: -step for name, step in move.items()}
        earlier = bare.equations(names, delays.moved(**back))
        # Rows at an end come and go: they have no slope.
        common, i, j = np.intersect1d(later.at, earlier.at, return_indices=True)
        _, own, other = np.intersect1d(equations.at, common, return_indices=True)
        change = (later.X[i] - earlier.X[j]) @ theta / (2.0 * STEP_S)
        slopes[own, k] = change[other]
    return equations.freed(slopes) if equations.bends.shape[1] else slopes
