"""Standard errors of what windows tell: their scatter, the prior, stamps, and steps.

Windows are independent of each other, rows of one are not: the scatter of the windows'
gradients counts (sandwich). A prior counts as one observation more.

Steps of a simulation are a bias and no scatter. What half of their length moves the
numbers by is at least a half of what no steps would: it counts twice.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.drive.rollouts.loop import JointLoop
from seqid_cli.drive.rollouts.solver import Solved, errors_of
from seqid_cli.drive.rollouts.unknowns import Unknowns
from seqid_cli.typing import Array, Mask

# Commands and rows may be late against each other by this [s]; see `row_errors`.
LATE_S = 1e-4
# A number is the prior's whose error grows so much where the prior is so much wider.
WIDER = 3.0
GROWS = 1.5


def std_errors(
    loops: Sequence[JointLoop], unknowns: Unknowns, solution: Solved
) -> Array:
    """Return standard errors (p,) in what is searched."""
    information = unknowns.std**-2.0
    p = len(information)
    H = np.zeros((p, p))
    scores = []
    first = 0
    for jacobian, off, rho in zip(
        solution.jacobian, solution.errors, solution.scale, strict=True
    ):
        count = off.shape[-1]
        weights = solution.weights[first : first + count] / rho
        first += count
        H += np.einsum("prb,qrb,b->pq", jacobian, jacobian, weights)
        scores.append(np.einsum("prb,rb,b->bp", jacobian, off, weights))
    H += np.diag(information)
    by_window = np.concatenate(scores)
    n = len(by_window)
    inflation = n / max(1.0, n - p)
    inner = by_window.T @ by_window * inflation + np.diag(information)
    scale = np.sqrt(np.diag(H))
    inverse = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12)
    inverse = inverse / np.outer(scale, scale)
    covariance = inverse @ inner @ inverse
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    moved = 2.0 * inverse @ _pull_of_steps(loops, unknowns, solution)
    errors = np.hypot(errors, moved)
    late = np.array([name == "command_delay" for name in unknowns.names])
    return np.asarray(np.hypot(errors, np.where(late, LATE_S, 0.0)))


def of_the_prior(unknowns: Unknowns, solution: Solved) -> Mask:
    """Return which numbers (p,) are the prior's and not the data's.

    Their errors grow with those of the prior. Several numbers may share one direction
    that the data leave open, as a scale of all torques.
    """
    data = _information(solution)
    prior = np.diag(unknowns.std**-2.0)
    close = _root_of_diagonal(data + prior)
    wide = _root_of_diagonal(data + prior / WIDER**2)
    return np.asarray(wide > GROWS * close)


def _information(solution: Solved) -> Array:
    """Return what the windows alone tell, (p, p)."""
    p = len(solution.theta)
    H = np.zeros((p, p))
    first = 0
    for jacobian, rho in zip(solution.jacobian, solution.scale, strict=True):
        count = jacobian.shape[-1]
        weights = solution.weights[first : first + count] / rho
        first += count
        H += np.einsum("prb,qrb,b->pq", jacobian, jacobian, weights)
    return H


def _root_of_diagonal(H: Array) -> Array:
    """Return the standard errors (p,) of an information matrix."""
    scale = np.sqrt(np.diag(H))
    inverse = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12)
    return np.asarray(np.sqrt(np.diag(inverse)) / scale)


def _pull_of_steps(
    loops: Sequence[JointLoop], unknowns: Unknowns, solution: Solved
) -> Array:
    """Return what half of the simulation's steps changes in the gradient (p,)."""
    finer = [replace(loop, course=loop.course.finer()) for loop in loops]
    pull = np.zeros(len(unknowns.searched))
    first = 0
    for jacobian, off, fine, rho in zip(
        solution.jacobian,
        solution.errors,
        errors_of(finer, unknowns, solution.theta[None]),
        solution.scale,
        strict=True,
    ):
        count = off.shape[-1]
        weights = solution.weights[first : first + count] / rho
        first += count
        pull += np.einsum("prb,rb,b->p", jacobian, fine[0] - off, weights)
    return pull
