"""Refine chosen moves one after the other by L-BFGS-B on their Fourier coefficients.

What is minimised is the product of the goal, tr(W C), and the condition of the information: of sets
with nearly the same error of the torque the one in which no parameter is left far behind is taken.

The limits hold for every value of the variables, so that bounds are all the constraints; torque
limits enter as a penalty, and a move that breaks them is not taken. The gradient is by differences,
all steps in one batch of regressors.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, minimize

from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import COEFFICIENTS, Drawn, Shapes, joined
from seqid_cli.plan.stages.choose import Goal, assess
from seqid_cli.robot.types import Array


@dataclass(frozen=True)
class _Problem:
    """One move as a function of its variables; `rest` (b, b) is the information of all others."""

    belief: Belief
    goal: Goal
    shapes: Shapes
    rest: Array
    start: Drawn

    @property
    def group(self) -> NDArray[np.intp]:
        """Joints that move."""
        return np.flatnonzero(self.start.coefficients[0].any(axis=1))

    @property
    def x(self) -> Array:
        """Variables of the start: coefficients of the joints that move, places of all."""
        return np.append(self.start.coefficients[0, self.group].ravel(), self.start.place[0])

    def drawn(self, x: Array) -> Drawn:
        """Moves of variables (P, v)."""
        n = self.start.place.shape[1]
        coefficients = np.zeros((len(x), n, COEFFICIENTS))
        coefficients[:, self.group] = x[:, :-n].reshape(len(x), -1, COEFFICIENTS)
        return Drawn(coefficients, x[:, -n:], np.repeat(self.start.extent, len(x), axis=0))

    def values(self, x: Array, *, penalty: float = 100.0) -> Array:
        """Log of the goal and of the condition (P,), with the penalty on torque."""
        moves = self.shapes.moves(self.drawn(x), self.belief.limits)
        information, overload = assess(self.belief, self.goal, moves)
        total = self.rest + information
        error = np.log(self.goal.errors(total)) + self.goal.log_condition(total)
        return np.asarray(error + penalty * np.maximum(overload - 1.0, 0.0) ** 2)

    def with_gradient(self, x: Array, *, step: float = 1e-4) -> tuple[float, Array]:
        """Value and gradient, by steps that lead inwards from the bounds."""
        steps = np.where(x > 0, -step, step)
        found = self.values(np.vstack([x, x + np.diag(steps)]))
        return float(found[0]), (found[1:] - found[0]) / steps


def refine(
    belief: Belief, goal: Goal, shapes: Shapes, chosen: Drawn, have: Array, *, sweeps: int
) -> Drawn:
    """Improve each of the `chosen` moves with all others held, `sweeps` times over.

    `have` (b, b) is scaled information that is there already.
    """
    information, _ = assess(belief, goal, shapes.moves(chosen, belief.limits))
    drawn = [chosen[[k]] for k in range(len(chosen))]
    total = have + information.sum(axis=0)
    for _ in range(sweeps):
        for k, move in enumerate(drawn):
            rest = total - information[k]
            drawn[k] = _improved(_Problem(belief, goal, shapes, rest, move))
            moves = shapes.moves(drawn[k], belief.limits)
            information[k] = assess(belief, goal, moves)[0][0]
            total = rest + information[k]
    return joined(drawn)


def _improved(problem: _Problem, *, iterations: int = 8) -> Drawn:
    x = problem.x
    places = problem.start.place.shape[1]
    low = np.append(np.full(len(x) - places, -1.0), np.zeros(places))
    found = minimize(
        problem.with_gradient,
        x,
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(low, np.ones(len(x))),
        options={"maxiter": iterations},
    )
    better = problem.drawn(np.asarray(found.x)[None])
    moves = problem.shapes.moves(better, problem.belief.limits)
    _, overload = assess(problem.belief, problem.goal, moves)
    worse = found.fun >= problem.values(x[None])[0]
    kept = worse or overload[0] > 1.0 or problem.belief.collides(moves.q)[0]
    return problem.start if kept else better
