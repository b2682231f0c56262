"""Choose moves greedily from a pool, by the torque error that the parameters will leave.

The goal is tr(W C): C the covariance of the base parameters, W the mean of H' D H over typical
all-joint moves with D the noise information, so that it is the mean square of the predicted
torque's error in units of the noise (A-optimality in the sense of the torque). Parameters are
scaled by the diagonal of W; a vague prior of `VAGUE` times the noise keeps C finite.

References
----------
Pukelsheim, Optimal Design of Experiments, SIAM 2006, ch. 6 and 9 (A-optimality, linear criteria).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from seqid_cli.params.results.plan import HARMONICS
from seqid_cli.plan.belief import NOISE_HZ, Belief, typical
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.fourier import COEFFICIENTS, SPARSE, Drawn, Moves, Shapes, joined
from seqid_cli.robot.types import Array

VAGUE = 1e3  # torque error, in noise, that a parameter of which nothing is known could make
REDUCTION = 0.5  # factor on the amplitude of a move that needs too much torque


@dataclass(frozen=True)
class Goal:
    """`W` (b, b) of scaled parameters, `scale` (b,) noise per unit, `prior` (b, b) scaled.

    `shared` are the joints that W is the sum over.
    """

    W: Array
    scale: Array
    prior: Array
    shared: list[int]

    @classmethod
    def of(cls, belief: Belief, seed: int) -> Goal:
        """Average over typical moves."""
        moves = typical(belief, seed)
        H = belief.regressor(moves)
        seconds = float(moves.t[-1] - moves.t[0])
        W = belief.information(moves, H).mean(axis=0) / (2.0 * NOISE_HZ * seconds)
        scale = np.sqrt(np.maximum(np.diag(W), 1e-12 * np.diag(W).max()))
        prior = belief.prior / np.outer(scale, scale) + np.eye(len(W)) / VAGUE**2
        return cls(W / np.outer(scale, scale), scale, prior, belief.limits.moving)

    def scaled(self, information: Array) -> Array:
        """Information (..., b, b) on the scaled parameters."""
        return np.asarray(information / np.outer(self.scale, self.scale))

    def errors(self, information: Array) -> Array:
        """tr(W C) of scaled information matrices (..., b, b), prior included."""
        C = np.linalg.inv(information + self.prior)
        return np.asarray(np.einsum("ab,...ba->...", self.W, C))

    def log_condition(self, information: Array) -> Array:
        """Log (...) of the condition of information (..., b, b) with columns of length 1."""
        N = information + self.prior
        size = np.sqrt(np.diagonal(N, axis1=-2, axis2=-1))
        values = np.linalg.eigvalsh(N / (size[..., :, None] * size[..., None, :]))
        return np.asarray(np.log(values[..., -1] / np.maximum(values[..., 0], 1e-15)) / 2.0)

    def covariance(self, information: Array) -> Array:
        """Covariance (b, b) of the parameters in their own units, prior included."""
        C = np.linalg.inv(information + self.prior)
        return np.asarray(C / np.outer(self.scale, self.scale))


@dataclass(frozen=True)
class Pool:
    """Moves to choose from with their scaled information (M, b, b)."""

    drawn: Drawn
    information: Array


def groups_of(limits: Limits, *, together: bool) -> list[tuple[int, ...]]:
    """Joints that move at a time: every pair (Sec. 2.2.4), or all of them."""
    free = tuple(limits.moving)
    if together or len(free) < 3:
        return [free]
    return list(combinations(free, 2))


def draw_pool(
    belief: Belief,
    goal: Goal,
    shapes: Shapes,
    groups: Sequence[tuple[int, ...]],
    size: int,
    rng: np.random.Generator,
    *,
    at_once: int = 60,
) -> Pool:
    """Draw moves of each group in turn; those of too much torque or that collide are left out.

    Harmonics have equal speed, which leaves room for wide positions, where gravity shows.
    """
    n = belief.robot.n
    coefficients = np.zeros((size, n, COEFFICIENTS))
    harmonic = np.repeat(np.arange(1, HARMONICS + 1), 2)
    for k in range(size):
        group = list(groups[k % len(groups)])
        coefficients[k, group] = rng.uniform(-1.0, 1.0, (len(group), COEFFICIENTS)) / harmonic
    drawn = Drawn(coefficients, rng.uniform(size=(size, n)), np.ones((size, n)))
    parts = [
        _reduced(belief, goal, shapes, drawn[start : start + at_once])
        for start in range(0, size, at_once)
    ]
    within = np.concatenate([overload <= 1.0 for _, _, overload in parts])
    whole = joined([drawn for drawn, _, _ in parts])
    if belief.geometry is not None:
        within &= ~belief.collides(shapes.moves(whole, belief.limits).every(2).q)
    fit = np.flatnonzero(within)
    information = np.concatenate([information for _, information, _ in parts])
    return Pool(whole[fit], information[fit])


def _reduced(
    belief: Belief, goal: Goal, shapes: Shapes, drawn: Drawn, *, max_times: int = 3
) -> tuple[Drawn, Array, Array]:
    """Moves, smaller where they needed too much torque, with information and overload."""
    information, overload = assess(belief, goal, shapes.moves(drawn, belief.limits))
    for _ in range(max_times):
        over = np.flatnonzero(overload > 1.0)
        if not len(over):
            break
        drawn = drawn.smaller(over, REDUCTION)
        moves = shapes.moves(drawn[over], belief.limits)
        information[over], overload[over] = assess(belief, goal, moves)
    return drawn, information, overload


def assess(belief: Belief, goal: Goal, moves: Moves) -> tuple[Array, Array]:
    """Scaled information (M, b, b) of moves, and the largest torque over its limit (M,)."""
    some = moves.every(SPARSE)
    H = belief.regressor(some)
    return goal.scaled(belief.information(some, H)), belief.overload(some, H)


def choose(goal: Goal, information: Array, count: int, have: Array) -> list[int]:
    """Take the moves one by one that lower the error most, by their scaled `information`.

    They come on top of `have` (b, b), scaled.
    """
    chosen: list[int] = []
    total = have
    for _ in range(min(count, len(information))):
        errors = goal.errors(total + information)
        errors[chosen] = np.inf
        chosen.append(int(np.argmin(errors)))
        total = total + information[chosen[-1]]
    return chosen
