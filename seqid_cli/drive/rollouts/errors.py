"""Standard errors of what windows tell: their scatter, the prior, stamps, and steps.

Windows are independent of each other, rows of one are not: what leaving out one window
after the other moves the numbers by counts (jackknife). A prior counts as one
observation more.

Steps of a simulation are a bias and no scatter. What half of their length moves the
numbers by is about a half of what no steps would: twice of it is taken off them, and
a third of that counts as an error. What the low-pass takes of the other joints' motion
is a bias as well: half of the band shows what an octave does.

Numbers that are known from elsewhere have errors as well. What each of them moves the
result by counts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from seqid_cli.drive.rollouts.loop import JointLoop
from seqid_cli.drive.rollouts.solver import Solved, errors_of, freed
from seqid_cli.drive.rollouts.unknowns import Unknown, Unknowns
from seqid_cli.typing import Array, Mask

# A controller acts in steps of its own: half a step of a fast one [s].
LATE_S = 1e-4
# Times what half of a step moves numbers by: what no steps would. It is 2 for a scheme
# of first order and 4/3 for one of second; friction makes the latter one of the former.
TO_NO_STEPS = 2.0
BIAS_ERROR = 0.3  # of what is taken off
# No logarithm of a number is surer: curves between rows, and steps of whoever moved the
# arm, make as much.
LEAST_ERROR = 3e-4
# A number is the prior's whose error grows so much where the prior is so much wider.
WIDER = 3.0
GROWS = 1.5


def bias_of_steps(
    loops: Sequence[JointLoop], unknowns: Unknowns, solution: Solved
) -> Array:
    """Return what the simulation's steps make of numbers (p,), as they are searched.

    Directions of which the windows say less than the prior are left alone. Along the
    scale of all torques, say, numbers go together by no linear law: to move them by one
    would spoil ratios that are known well.
    """
    std = unknowns.std
    information, directions = np.linalg.eigh(
        std[:, None] * _information(solution) * std
    )
    pull = directions.T @ (std * _pull_of_steps(loops, unknowns, solution))
    moved = np.where(information > 1.0, pull / (information + 1.0), 0.0)
    return np.asarray(TO_NO_STEPS * std * (directions @ moved))


def std_errors(
    loops: Sequence[JointLoop],
    smooth: Sequence[JointLoop],
    unknowns: Unknowns,
    solution: Solved,
    given: Mapping[str, float],
    bias: Array,
) -> Array:
    """Return standard errors (p,) in what is searched.

    Parameters
    ----------
    loops, smooth : sequence of JointLoop
        The windows, and the same with the arm's motion in half of its band.
    unknowns, solution
    given : mapping of str to float
        Standard errors of numbers that are known from elsewhere and not searched.
    bias : (p,) array
        Of the simulation's steps, which is taken off.
    """
    H = _information(solution) + np.diag(unknowns.std**-2.0)
    errors = _of_scatter(H, unknowns, solution)
    inverse = _inverse(H)
    errors = np.hypot(errors, BIAS_ERROR * bias)
    other = errors_of(smooth, unknowns, solution.theta[None])
    errors = np.hypot(errors, inverse @ _pull(solution, [each[0] for each in other]))
    for pull in _pulls_of_given(loops, unknowns, solution, given):
        errors = np.hypot(errors, inverse @ pull)
    errors = np.hypot(errors, _least_errors(loops, unknowns, solution))
    late = np.array([name == "command_delay" for name in unknowns.names])
    return np.asarray(np.hypot(errors, np.where(late, LATE_S, 0.0)))


def _least_errors(
    loops: Sequence[JointLoop], unknowns: Unknowns, solution: Solved
) -> Array:
    """Return `LEAST_ERROR` of each number (p,) as it is searched.

    A rotor's is that of the whole inertia, of which it is a part.
    """
    inertia = float(np.mean([loop.course.inertia.mean() for loop in loops]))
    natural = unknowns.natural(solution.theta[None])[0]
    errors = np.zeros(len(natural))
    for k, each in enumerate(unknowns.searched):
        if not each.positive:
            continue
        errors[k] = LEAST_ERROR
        if each.name == "armature":
            errors[k] *= 1.0 + inertia / max(float(natural[k]), 1e-12)
    return errors


def _of_scatter(H: Array, unknowns: Unknowns, solution: Solved) -> Array:
    """Return what leaving out one window after the other tells (p,): the jackknife.

    A window that few others are like counts in full then. Few windows tell their
    scatter itself not surely: the interval of 95 % is that of Student.
    """
    moves = []
    first = 0
    for jacobian, off, rho in zip(
        solution.jacobian, solution.errors, solution.scale, strict=True
    ):
        count = off.shape[-1]
        weights = solution.weights[first : first + count] / rho
        first += count
        own = np.einsum("prb,qrb,b->bpq", jacobian, jacobian, weights)
        scores = np.einsum("prb,rb,b->bp", jacobian, off, weights)
        moves += [_inverse(H - own[b]) @ (scores[b]) for b in range(count)]
    by_window = np.array(moves)
    n = len(by_window)
    by_prior = np.einsum("pk,k->p", _inverse(H) ** 2, unknowns.std**-2.0)
    wider = float(student.ppf(0.975, n - 1) / 1.96)
    of_windows = np.sum(by_window**2, axis=0) * (n - 1) / n
    return np.asarray(wider * np.sqrt(of_windows + by_prior))


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
    return np.asarray(np.sqrt(np.diag(_inverse(H))))


def _inverse(H: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    inverse = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12)
    return np.asarray(inverse / np.outer(scale, scale))


def _pull_of_steps(
    loops: Sequence[JointLoop], unknowns: Unknowns, solution: Solved
) -> Array:
    """Return what half of the simulation's steps changes in the gradient (p,)."""
    finer = [replace(loop, course=loop.course.finer()) for loop in loops]
    fine = errors_of(finer, unknowns, solution.theta[None])
    return _pull(solution, [each[0] for each in fine])


def _pulls_of_given(
    loops: Sequence[JointLoop],
    unknowns: Unknowns,
    solution: Solved,
    given: Mapping[str, float],
) -> list[Array]:
    """Return what a standard error of each given number changes in the gradient."""
    if not given:
        return []
    more = [
        Unknown(name=name, start=unknowns.fixed[name], std=error, positive=False)
        for name, error in given.items()
    ]
    moved = unknowns.with_more(more)
    values = [unknowns.fixed[name] for name in given]
    sets = np.tile(np.append(solution.theta, values), (len(given), 1))
    sets[:, len(solution.theta) :] += np.diag(list(given.values()))
    simulated = errors_of(loops, moved, sets)
    return [_pull(solution, [each[k] for each in simulated]) for k in range(len(given))]


def _pull(solution: Solved, errors: Sequence[Array]) -> Array:
    """Return what other errors (R, B) of each rate change in the gradient (p,)."""
    pull = np.zeros(len(solution.theta))
    first = 0
    for jacobian, off, other, rho in zip(
        solution.jacobian,
        solution.errors,
        freed(errors, solution.starts),
        solution.scale,
        strict=True,
    ):
        count = off.shape[-1]
        weights = solution.weights[first : first + count] / rho
        first += count
        pull += np.einsum("prb,rb,b->p", jacobian, other - off, weights)
    return pull
