"""Eq. 12-15: the gravity torque of single-joint trials, and whether friction depends on direction.

Forward and backward trials at one speed have the half-sum

    (tau_1 + tau_2) / 2 = a(q)' p_xi + (f_forward - f_backward) / 2.

Gravity cannot know the speed and has the shape a(q); the second term is the direction dependence
that Eq. 15 takes to be zero. Both are fitted, the second as an offset and a slope over the speed,
and kept only where the data speak for it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.identify.friction_surface.trials import Trial, configurations, speed_levels
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index


def gravity_columns(robot: Robot, joint: int, configuration: Array, q: Array) -> Array:
    """Vector a of Eq. 13 at positions q of one joint, the others locked.

    `configuration` (n,): positions of the joints before it [rad]. `q` (K,): positions of the joint
    itself [rad]. Returns (K, 2): m/s^2, to be multiplied by p_xi of Eq. 14; (K, 1) for a prismatic
    joint, whose gravity force is mass times gravity along the axis; no column where gravity has no
    part across the axis.
    """
    zero = configuration.copy()
    zero[joint] = 0.0
    R = forward(robot.chain, zero[None]).R[0, joint]
    g = R.T @ robot.gravity
    axis = robot.chain.axis[joint]
    if robot.chain.prismatic[joint]:
        column = np.full((len(q), 1), -float(g @ axis))
        return column if abs(g @ axis) > 1e-6 else column[:, :0]
    e_x, e_y = plane_across(axis)
    g_x, g_y = float(g @ e_x), float(g @ e_y)
    if np.hypot(g_x, g_y) < 1e-6:
        return np.empty((len(q), 0))
    sin, cos = np.sin(q), np.cos(q)
    return np.column_stack([g_x * sin - g_y * cos, g_x * cos + g_y * sin])


def plane_across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors across a joint axis; x and y of the frame where the axis is z."""
    start = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    e_x = start - axis * (axis @ start)
    e_x /= np.linalg.norm(e_x)
    return e_x, np.cross(axis, e_x)


HalfSums = tuple[Array, Array, float, float]  # (K,) rad, N m; the pair's speed, samples per slice


def _half_sums(group: list[Trial]) -> list[HalfSums]:
    """Half-sums of forward and backward trials of one configuration, speed by speed (Eq. 15)."""
    result = []
    for level in speed_levels(group):
        ways = ([t for t in level if t.velocity > 0], [t for t in level if t.velocity < 0])
        for ahead, back in zip(*ways, strict=False):
            inside = (ahead.q >= back.q.min()) & (ahead.q <= back.q.max())
            order = np.argsort(back.q)
            twin = np.interp(ahead.q[inside], back.q[order], back.tau[order])
            if inside.sum() >= 4:
                half = (ahead.tau[inside] + twin) / 2
                result.append((ahead.q[inside], half, level[0].speed, ahead.weight))
    return result


@dataclass(frozen=True)
class GravityGroup:
    """Trials in one locked configuration with p_xi (2,) kg m and its standard errors."""

    robot: Robot
    configuration: Array
    trials: list[Trial]
    p_xi: Array
    std_error: Array

    def torque(self, q: Array) -> Array:
        """Gravity torque (K,) N m at positions q (K,) of the moving joint (Eq. 12)."""
        joint = self.trials[0].joint
        return gravity_columns(self.robot, joint, self.configuration, q) @ self.p_xi


@dataclass(frozen=True)
class GravityFit:
    """p_xi of every configuration; `asymmetry` is the direction-dependent share of friction."""

    groups: list[GravityGroup]
    unpaired: int
    directional: bool
    asymmetry: float


def fit_gravity(robot: Robot, joint: int, trials: list[Trial]) -> GravityFit:
    """Fit p_xi per configuration to the half-sums, with or without direction dependence.

    Returns: groups without a forward/backward pair are left out and counted in `unpaired`.
    """
    groups = configurations(trials)
    paired = [(group, sums) for group in groups if (sums := _half_sums(group))]
    if len(paired) < len(groups) and not any(_loads(robot, joint, groups)):
        none = np.zeros(0)  # nothing to remove, no twin needed
        free = [GravityGroup(robot, group[0].configuration, group, none, none) for group in groups]
        return GravityFit(free, 0, False, 0.0)
    unpaired = len(trials) - sum(len(group) for group, _ in paired)
    if not paired:
        return GravityFit([], unpaired, False, 0.0)
    columns, extra, y, root, block, of_group = _system(robot, joint, paired)
    both = np.hstack([columns, extra])
    plain, extended = (_solved(each, y, root, block) for each in (columns, both))
    squares = []  # of friction: half the difference of the directions
    for group, _ in paired:
        ahead = [t.tau.mean() for t in group if t.velocity > 0]
        back = [t.tau.mean() for t in group if t.velocity < 0]
        squares.append(((np.mean(ahead) - np.mean(back)) / 2) ** 2)
    friction = float(np.sqrt(np.mean(squares)))
    share, directional = _asymmetry(plain, extended, extra, friction)
    p_xi, errors, _ = extended if directional else plain
    fitted = [
        GravityGroup(robot, group[0].configuration, group, p_xi[own], errors[own])
        for (group, _), own in zip(paired, of_group, strict=True)
    ]
    return GravityFit(fitted, unpaired, directional, share)


def _loads(robot: Robot, joint: int, groups: list[list[Trial]]) -> list[int]:
    """How many gravity columns each configuration has, 0 to 2."""
    none = np.zeros(1)
    return [gravity_columns(robot, joint, g[0].configuration, none).shape[1] for g in groups]


Paired = list[tuple[list[Trial], list[HalfSums]]]
Solved = tuple[Array, Array, float]  # solution, its standard errors, squares left


def _system(
    robot: Robot, joint: int, paired: Paired, *, enough_pairs: int = 8
) -> tuple[Array, Array, Array, Array, Index, list[slice]]:
    """Half-sums stacked: gravity columns per configuration, offset and slope over the speed.

    Then the half-sums, their weights' roots, the blocks that share errors, and the columns of each
    configuration: none where gravity does not load the joint.
    """
    rows, extra, right, root, block = [], [], [], [], []
    pairs = sum(len(sums) for _, sums in paired)
    fastest = max(speed for _, sums in paired for *_, speed, _ in sums)
    count = 0
    ends = np.cumsum([0, *_loads(robot, joint, [group for group, _ in paired])])
    of_group = [slice(a, b) for a, b in pairwise(ends)]
    for (group, sums), own in zip(paired, of_group, strict=True):
        for q, half, speed, weight in sums:
            wide = np.zeros((len(q), ends[-1]))
            wide[:, own] = gravity_columns(robot, joint, group[0].configuration, q)
            rows.append(wide)
            slope = np.full(len(q), speed / fastest)
            # The gravity force of a prismatic joint is itself an offset.
            offset = [] if robot.chain.prismatic[joint] and ends[-1] else [np.ones_like(slope)]
            extra.append(np.column_stack([*offset, slope]))
            right.append(half)
            root.append(np.full(len(q), np.sqrt(weight)))
            # Drift and friction errors are shared within a pair; few pairs must be cut up.
            parts = 1 if pairs >= enough_pairs else 4
            block.append(count + np.arange(len(q)) * parts // len(q))
            count += parts
    y, weights, blocks = (np.concatenate(part) for part in (right, root, block))
    return np.vstack(rows), np.vstack(extra), y, weights, blocks, of_group


@dataclass(frozen=True)
class Clustered:
    """Least squares `theta` (p,) whose rows share errors within clusters.

    `left` is the residual, `bread` the inverse of the normal matrix, `moves` (G, p) what each
    cluster pulls the estimate by.
    """

    theta: Array
    left: Array
    bread: Array
    moves: Array

    @classmethod
    def of(cls, A: Array, y: Array, cluster: Index) -> "Clustered":
        """Solve rows A (N, p), y (N,) of clusters (N,), numbered from 0."""
        theta = np.asarray(np.linalg.lstsq(A, y, rcond=1e-10)[0], dtype=np.float64)
        left = y - A @ theta
        bread = np.asarray(np.linalg.pinv(A.T @ A, hermitian=True))
        scores = np.zeros((int(cluster.max()) + 1, A.shape[1]))
        np.add.at(scores, cluster, A * left[:, None])
        return cls(theta, left, bread, scores @ bread)


def _solved(columns: Array, y: Array, root: Array, block: Index) -> Solved:
    """Weighted least squares with standard errors that are robust within blocks."""
    if columns.shape[1] == 0:
        return np.zeros(0), np.zeros(0), float(np.sum((root * y) ** 2))
    found = Clustered.of(columns * root[:, None], y * root, block)
    blocks = len(found.moves)
    variance = np.sum(found.moves**2, axis=0) * blocks / max(blocks - columns.shape[1], 1)
    return found.theta, np.sqrt(variance), float(found.left @ found.left)


def _asymmetry(
    plain: Solved,
    extended: Solved,
    extra: Array,
    friction: float,
    *,
    min_share: float = 0.02,
    min_sigma: float = 6.0,
) -> tuple[float, bool]:
    """Share of friction that depends on direction, and whether it is large and significant."""
    solution, errors = (values[len(plain[0]) :] for values in extended[:2])
    share = float(np.sqrt(np.mean((extra @ solution) ** 2)) / max(friction, 1e-12))
    sigma = np.abs(solution) / np.maximum(errors, 1e-300)
    helps = extended[2] < 0.97 * plain[2]
    return share, bool(share > min_share and sigma.max() > min_sigma and helps)
