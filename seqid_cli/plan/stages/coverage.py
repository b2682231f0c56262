"""Where friction is known: the positions and speeds of each joint that gravity may use.

The gravity stage leaves slices out at which a joint's friction surface was not
identified. So a sweep counts within the ranges of the surfaces that are given, or,
before friction is recorded, within what the planned friction moves will reach: the ends
of a way less its ramps, and the speeds of its strokes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.plan.belief import Belief
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Ranges (n,) in which each joint's friction is known.

    Parameters
    ----------
    is_known : (n,) bool
        Whether the joint has a friction surface, or will have one.
    lower, upper : (n,) float
        Positions [rad; m where prismatic].
    slowest, fastest : (n,) float
        Speeds [rad/s; m/s where prismatic].
    """

    is_known: Mask
    lower: Array
    upper: Array
    slowest: Array
    fastest: Array

    @classmethod
    def of_surfaces(cls, belief: Belief) -> Self:
        """Return the ranges of the friction surfaces that are given."""
        n = belief.robot.n
        lower = np.zeros(n)
        upper = np.zeros(n)
        slowest = np.zeros(n)
        fastest = np.zeros(n)
        for j, surface in enumerate(belief.surfaces):
            if surface is None:
                continue
            scaling = surface.scaling
            lower[j], upper[j] = scaling.over_position.known_range()
            slowest[j], fastest[j] = scaling.speed
        return cls(
            is_known=np.array([surface is not None for surface in belief.surfaces]),
            lower=lower,
            upper=upper,
            slowest=slowest,
            fastest=fastest,
        )

    @classmethod
    def of_moves(cls, belief: Belief, moves: Sequence[PlannedMove]) -> Self:
        """Return the ranges that friction moves will cover at steady speed.

        Parameters
        ----------
        belief : Belief
        moves : sequence of PlannedMove
            Strokes of one joint each.

        Returns
        -------
        Coverage
        """
        names = belief.robot.joint_names
        n = len(names)
        is_known = np.zeros(n, dtype=bool)
        lower = np.full(n, np.inf)
        upper = np.full(n, -np.inf)
        slowest = np.full(n, np.inf)
        fastest = np.zeros(n)
        for move in moves:
            j = names.index(move.joints[0])
            is_known[j] = True

            # Ramps are no part of a way at steady speed.
            for stroke in move.strokes:
                ramp = ramp_way(stroke.speed, stroke.acceleration)
                lower[j] = min(lower[j], min(stroke.start, stroke.end) + ramp)
                upper[j] = max(upper[j], max(stroke.start, stroke.end) - ramp)
                slowest[j] = min(slowest[j], stroke.speed)
                fastest[j] = max(fastest[j], stroke.speed)
        return cls(
            is_known=is_known,
            lower=lower,
            upper=upper,
            slowest=slowest,
            fastest=fastest,
        )

    @classmethod
    def everywhere(cls, belief: Belief) -> Self:
        """Return the whole range of each joint, as if friction were known there."""
        limits = belief.limits
        return cls(
            is_known=limits.moves.copy(),
            lower=limits.lower.copy(),
            upper=limits.upper.copy(),
            slowest=np.zeros(belief.robot.n),
            fastest=limits.speed.copy(),
        )

    def text(self, belief: Belief, j: int) -> str:
        """Return the ranges of a joint in words."""
        joint = belief.robot.joints[j]
        lower = self.lower[j]
        place = "all angles"
        if np.isfinite(lower):
            place = f"{lower:.2f} to {self.upper[j]:.2f} {joint.unit('rad')}"
        speeds = f"{self.slowest[j]:.2g} to {self.fastest[j]:.2g} {joint.unit('rad/s')}"
        return f"{joint.name} {place}, {speeds}"


def ramp_way(speed: float, acceleration: float) -> float:
    """Return the way [rad] of a cosine ramp from rest to a speed: pi v^2 / (4 a)."""
    return float(np.pi * speed**2 / (4.0 * acceleration))


def ramp_ways(speed: Array, acceleration: Array) -> Array:
    """Return the ways [rad] of cosine ramps to speeds (...): pi v^2 / (4 a)."""
    return np.asarray(np.pi * speed**2 / (4.0 * acceleration))
