"""Sweeps of one joint at a time, and the space that they are drawn from.

Rows of a sweep count where the gravity stage will count them: at steady speed, within
the friction that is known (`Coverage`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves import strokes
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.coverage import Coverage, ramp_ways
from seqid_cli.robot.base_parameters import gravity_base_regressor
from seqid_cli.typing import Array, Index, Mask

SLOW = 0.3  # of the largest speed


@dataclass(frozen=True, kw_only=True)
class Sweeps:
    """Sweeps of one joint each.

    Parameters
    ----------
    joint : (M,) int
        The joint that moves.
    posture : (M, n) float
        Where the others are locked [rad; m where prismatic].
    ends : (M, 2) float
        Ends of the way [rad; m where prismatic].
    information : (M, g, g) float
        Phi(H_g)' Phi(H_g) of each, rows weighted by time alone.
    """

    joint: Index
    posture: Array
    ends: Array
    information: Array

    @property
    def total(self) -> Array:
        """Information (g, g) of all of them."""
        return np.asarray(self.information.sum(axis=0))

    def __getitem__(self, sweeps: Index) -> "Sweeps":
        """Return some of the sweeps."""
        return Sweeps(
            joint=self.joint[sweeps],
            posture=self.posture[sweeps],
            ends=self.ends[sweeps],
            information=self.information[sweeps],
        )

    def with_one_replaced(self, k: int, replacement: "Sweeps") -> "Sweeps":
        """Return the same with sweep k exchanged for a single other one."""
        joint = self.joint.copy()
        posture = self.posture.copy()
        ends = self.ends.copy()
        information = self.information.copy()
        joint[k] = replacement.joint[0]
        posture[k] = replacement.posture[0]
        ends[k] = replacement.ends[0]
        information[k] = replacement.information[0]
        return Sweeps(joint=joint, posture=posture, ends=ends, information=information)


def joined(parts: Sequence[Sweeps]) -> Sweeps:
    """Return all sweeps of several sets."""
    return Sweeps(
        joint=np.concatenate([part.joint for part in parts]),
        posture=np.concatenate([part.posture for part in parts]),
        ends=np.concatenate([part.ends for part in parts]),
        information=np.concatenate([part.information for part in parts]),
    )


@dataclass(frozen=True, kw_only=True)
class SweepSpace:
    """Postures within the limits and ways within known friction.

    Parameters
    ----------
    belief : Belief
    joints : list of int
        The joints that are swept.
    speed : (n,) float
        Speed of each joint's sweeps [rad/s; m/s where prismatic].
    span : (n, 2) float
        Where the ends of a way may be [rad; m where prismatic].
    steady : (n, 2) float
        The positions that count [rad; m where prismatic].
    least_width : (n,) float
        The shortest steady way that is taken [rad; m where prismatic].
    """

    belief: Belief
    joints: list[int]
    speed: Array
    span: Array
    steady: Array
    least_width: Array

    def steady_ends(self, joint: Index, ends: Array) -> Array:
        """Return where sweeps are at speed and friction is known.

        Parameters
        ----------
        joint : (M,) int
            The joint that moves.
        ends : (M, 2) float
            Ends of its way [rad; m where prismatic].

        Returns
        -------
        (M, 2) array
            [rad; m where prismatic]; both ends are the same where there is no such way.
        """
        acceleration = self.belief.limits.acceleration[joint]
        ramp = ramp_ways(self.speed[joint], acceleration)
        low = np.maximum(ends[:, 0] + ramp, self.steady[joint, 0])
        high = np.minimum(ends[:, 1] - ramp, self.steady[joint, 1])
        return np.stack([low, np.maximum(high, low)], axis=1)

    def steady_width(self, sweeps: Sweeps) -> Array:
        """Return the widths (M,) of the ways that count [rad; m where prismatic]."""
        return np.asarray(np.diff(self.steady_ends(sweeps.joint, sweeps.ends))[:, 0])

    def draw(self, j: int, postures: Array) -> Sweeps:
        """Return sweeps of joint j in postures (P, n), as far as nothing is touched."""
        joint = np.full(len(postures), j)
        span = (float(self.span[j, 0]), float(self.span[j, 1]))
        ends = strokes.free_ends(self.belief, j, postures, span)
        return self.with_ends(joint, postures, ends)

    def with_ends(
        self, joint: Index, postures: Array, ends: Array, *, points: int = 9
    ) -> Sweeps:
        """Return sweeps between given ends.

        Parameters
        ----------
        joint : (M,) int
            The joint that moves.
        postures : (M, n) float
            Where the others are locked [rad; m where prismatic].
        ends : (M, 2) float
            Ends of the ways [rad; m where prismatic].
        points : int
            Positions of each steady way whose rows are added up.

        Returns
        -------
        Sweeps
        """
        belief = self.belief
        count, n = postures.shape
        sweep = np.arange(count)

        # Gravity's torque at a joint is a cos q + b sin q + c in its own angle,
        # constant in its own slide: three places determine all others.
        nodes = np.linspace(0.0, 4.0 * np.pi / 3.0, 3)
        q = np.repeat(postures[:, None], 3, axis=1)
        q[sweep, :, joint] = nodes
        H = gravity_base_regressor(belief.robot, belief.basis, q.reshape(-1, n))
        at_nodes = H.reshape(count, 3, n, -1)[sweep, :, joint]
        coefficients: Array = np.linalg.inv(_harmonics(nodes)) @ at_nodes

        steady = self.steady_ends(joint, ends)
        rows = _harmonics(middles(steady, points)) @ coefficients
        seconds = np.diff(steady)[:, 0] / self.speed[joint]
        seconds_of_row = (seconds / points)[:, None, None]
        information = rows.transpose(0, 2, 1) @ rows * seconds_of_row
        return Sweeps(joint=joint, posture=postures, ends=ends, information=information)

    def depth(self, sweeps: Sweeps, *, points: int = 9) -> Array:
        """Return how far sweeps (M,) go below the floor at their lowest [m]."""
        if self.belief.floor is None:
            return np.zeros(len(sweeps.joint))
        places = np.linspace(sweeps.ends[:, 0], sweeps.ends[:, 1], points, axis=1)
        height = self.belief.floor.height_along(sweeps.joint, sweeps.posture, places)
        return np.asarray(np.maximum(-height.min(axis=1), 0.0))

    def allowed(self, sweeps: Sweeps) -> Mask:
        """Return which sweeps (M,) are wide enough and keep the torque limits."""
        width = self.steady_width(sweeps)
        is_allowed = (width >= self.least_width[sweeps.joint]) & (width > 0.0)
        limits = self.belief.limits
        if self.belief.theta is None or not np.isfinite(limits.torque).any():
            return is_allowed

        for j in np.unique(sweeps.joint):
            of_joint = np.flatnonzero(is_allowed & (sweeps.joint == j))
            if len(of_joint):
                overload = strokes.overloads(
                    self.belief, int(j), sweeps.posture[of_joint], float(self.speed[j])
                )
                is_allowed[of_joint] &= overload <= 1.0
        return is_allowed


def middles(ends: Array, parts: int) -> Array:
    """Return the middles (M, parts) of equal parts of ways between ends (M, 2).

    A sum over them is the integral over the way; one that counts the ends like all
    other places makes conditions look better by a tenth.
    """
    share = (np.arange(parts) + 0.5) / parts
    return np.asarray(ends[:, :1] + share * np.diff(ends, axis=1))


def _harmonics(q: Array) -> Array:
    """Return 1, cos q and sin q (..., 3)."""
    return np.stack([np.ones_like(q), np.cos(q), np.sin(q)], axis=-1)


def draw_sweeps(
    belief: Belief,
    coverage: Coverage,
    options: PlanOptions,
    *,
    enough: int = 10,
) -> tuple[SweepSpace, Sweeps]:
    """Draw sweeps of joints that move, that gravity loads, and whose friction is known.

    Parameters
    ----------
    belief : Belief
    coverage : Coverage
        Where friction is known.
    options : PlanOptions
    enough : int
        Accelerations are halved until so many sweeps of each joint keep the torque
        limits.

    Returns
    -------
    space : SweepSpace
    pool : Sweeps

    Raises
    ------
    ConfigError
        No sweep keeps the limits.
    """
    is_loaded = _loaded_joints(belief)
    joints = [j for j in belief.limits.moving if is_loaded[j] and coverage.is_known[j]]
    for eased in strokes.gentler(belief):
        space, pool = _draw_within(eased, joints, coverage, options)
        if pool is not None and all(np.sum(pool.joint == j) >= enough for j in joints):
            break
    if pool is None:
        message = (
            "no sweep of a joint that gravity loads keeps the limits within known"
            " friction"
        )
        hint = (
            "Correct effort in the URDF, give a friction file that covers more, or,"
            " where the base stands on no floor, plan with --no-floor."
        )
        raise ConfigError(message, where=str(belief.robot.source), hint=hint)
    return space, pool


def _draw_within(
    belief: Belief,
    joints: list[int],
    coverage: Coverage,
    options: PlanOptions,
    *,
    most_postures: int = 60,
    widest: float = 0.5,
) -> tuple[SweepSpace, Sweeps | None]:
    """Draw sweeps with the accelerations of a belief; None where none keeps the limits.

    A sweep has to be as wide as a share `widest` of the widest one of its joint.
    """
    limits = belief.limits
    fastest = np.minimum(SLOW * limits.speed, coverage.fastest)
    speed = np.maximum(fastest, np.minimum(coverage.slowest, limits.speed))
    # Ramps may lie where friction is not known: rows of them do not count.
    ramp = ramp_ways(speed, np.maximum(limits.acceleration, 1e-300))
    space = SweepSpace(
        belief=belief,
        joints=joints,
        speed=speed,
        span=np.stack([coverage.lower - ramp, coverage.upper + ramp], axis=1),
        steady=np.stack([coverage.lower, coverage.upper], axis=1),
        least_width=np.zeros(belief.robot.n),
    )

    rng = np.random.default_rng(options.seed)
    parts = []
    for j in joints:
        drawn = space.draw(j, strokes.postures_of(limits, most_postures, rng))
        space.least_width[j] = widest * space.steady_width(drawn).max(initial=0.0)
        allowed = drawn[np.flatnonzero(space.allowed(drawn))]
        if len(allowed.joint):
            parts.append(allowed)
    return space, joined(parts) if parts else None


def _loaded_joints(belief: Belief, *, negligible: float = 1e-9) -> Mask:
    """Return which joints (n,) gravity loads: an upright axis is by rounding alone."""
    postures = strokes.postures_of(belief.limits, 50, np.random.default_rng(0))
    H = gravity_base_regressor(belief.robot, belief.basis, postures)
    largest = np.abs(H).max(axis=(0, 2))
    return np.asarray(negligible * largest.max() < largest)
