"""Standard errors of a fit by rows.

They are those of Gauss-Newton with the delays as unknowns beside the gains, widened by
blocks of a second (sandwich): what is left is no white noise.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.drive.equations import Equations, JointLaw
from seqid_cli.drive.search import Solution, solved_at
from seqid_cli.typing import Array

# Steps in which delays are moved for their columns [s]: much less than a period of the
# band, much more than rounding.
STEP_S = 2e-4
# By so much rows, commands and torque may be late against each other [s]: half a
# step of a fast controller. No residual shows it.
LATE_S = 1e-4


def row_errors(law: JointLaw, names: Sequence[str], solution: Solution) -> Array:
    """Return standard errors (p + 2,) of gains and delays, the lag's last.

    The scatter over blocks counts, not that of rows, which are not independent. What
    the gains move by where rows are late against each other counts as well.
    """
    equations = law.equations(names, solution.delays)
    J = _jacobian(law, names, solution, equations)
    left = equations.y - equations.X @ solution.theta
    blocks = equations.blocks

    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-10)
    scores = np.zeros((int(blocks.max()) + 1, J.shape[1]))
    np.add.at(scores, blocks, (J / scale) * left[:, None])
    n_blocks = max(2, np.count_nonzero(scores.any(axis=1)))
    p = J.shape[1]
    # Few blocks bend the fit towards themselves.
    inflation = n_blocks / max(1.0, n_blocks - p)
    covariance = inverse @ (scores.T @ scores) @ inverse * inflation
    errors = np.zeros(len(names) + 2)
    errors[:p] = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale
    return np.hypot(errors, _moved_by_stamps(law, names, solution))


def _moved_by_stamps(law: JointLaw, names: Sequence[str], solution: Solution) -> Array:
    """Return what gains and delays (p + 2,) move by where stamps are off."""
    moves = np.full(len(names) + 2, LATE_S)
    moves[: len(names)] = 0.0
    back_s = -LATE_S if law.course == "held" else 0.0
    moved = solution.delays.moved(torque=LATE_S, command=back_s)
    other = solved_at(law, names, moved)
    if other is not None:
        moves[: len(names)] = np.abs(other.theta - solution.theta)
    return moves


def _jacobian(
    law: JointLaw, names: Sequence[str], solution: Solution, equations: Equations
) -> Array:
    """Return the columns (M, p + 1 or p + 2) of gains and delays."""
    columns = [equations.X]
    # What steps has no slope over its delay; a lag moves the motion alone then.
    steps = law.course == "held"
    moves = [{"command": 0.0 if steps else STEP_S}]
    if law.logs[0].measured:
        moves.append({"torque": STEP_S, "command": -STEP_S if steps else 0.0})
    for move in moves:
        later = law.equations(names, solution.delays.moved(**move))
        earlier = law.equations(
            names, solution.delays.moved(**{k: -v for k, v in move.items()})
        )
        if not len(later.y) == len(earlier.y) == len(equations.y):
            # Rows at an end come and go: the slope is left out.
            columns.append(np.zeros((len(equations.y), 1)))
            continue
        change = (later.X - earlier.X) @ solution.theta / (2.0 * STEP_S)
        columns.append(change[:, None])
    return np.hstack(columns)
