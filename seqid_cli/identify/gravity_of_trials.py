"""Eq. 12-15: the gravity torque of single-joint trials, and whether friction depends on direction.

Forward and backward trials at one speed have the half-sum

    (tau_1 + tau_2) / 2 = a(q)' p_xi + (f_forward - f_backward) / 2.

Gravity cannot know the speed and has the shape a(q); the second term is the direction dependence
that Eq. 15 takes to be zero. Both are fitted, the second as an offset and a slope over the speed,
and kept only where the data speak for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.trials import (
    HalfSums,
    Trial,
    configurations,
    gravity_columns,
    half_sums,
)
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

ASYMMETRY_SHARE = 0.02  # of the friction, below which a direction dependence does not matter
ASYMMETRY_SIGMA = 4.0


@dataclass(frozen=True)
class GravityGroup:
    """Trials in one locked configuration with p_xi (2,) kg m and its standard errors."""

    robot: Robot
    configuration: Array
    trials: list[Trial]
    p_xi: Array
    std_error: Array

    def columns_of(self, trial: Trial) -> Array:
        """Vector a of Eq. 13 along one trial, (K, 2) m/s^2."""
        return gravity_columns(self.robot, trial.joint, self.configuration, trial.q)


@dataclass(frozen=True)
class GravityFit:
    """p_xi of every configuration; `asymmetry` is the direction-dependent share of friction."""

    groups: list[GravityGroup]
    unpaired: int
    directional: bool
    asymmetry: float


def fit_gravity(robot: Robot, joint: int, trials: list[Trial]) -> GravityFit:
    """Fit p_xi per configuration to the half-sums, with or without direction dependence.

    Parameters
    ----------
    robot : Robot
        Chain and gravity vector.
    joint : int
        The moving joint.
    trials : list of Trial
        Its constant-velocity trials.

    Returns
    -------
    GravityFit
        Groups without a forward/backward pair are left out and counted in `unpaired`.
    """
    groups = configurations(trials)
    loaded = gravity_columns(robot, joint, trials[0].configuration, trials[0].q).shape[1] > 0
    paired = [(group, sums) for group in groups if (sums := half_sums(group))]
    if not loaded and len(paired) < len(groups):
        return GravityFit([_unloaded(robot, group) for group in groups], 0, False, 0.0)
    unpaired = len(trials) - sum(len(group) for group, _ in paired)
    if not paired:
        return GravityFit([], unpaired, False, 0.0)
    friction = _friction_scale(paired)
    columns, extra, y, block = _system(robot, joint, paired)
    plain, errors = _solve(columns, y, block)
    share, directional = _asymmetry(columns, extra, y, block, friction)
    if directional:
        full, errors = _solve(np.hstack([columns, extra]), y, block)
        plain, errors = full[: columns.shape[1]], errors[: columns.shape[1]]
    width = columns.shape[1] // len(paired)
    fitted = [
        GravityGroup(
            robot,
            group[0].configuration,
            group,
            plain[i * width : (i + 1) * width],
            errors[i * width : (i + 1) * width],
        )
        for i, (group, _) in enumerate(paired)
    ]
    return GravityFit(fitted, unpaired, directional, share)


def _unloaded(robot: Robot, group: list[Trial]) -> GravityGroup:
    """Trials of a joint that gravity does not load: nothing to remove, no twin needed."""
    return GravityGroup(robot, group[0].configuration, group, np.zeros(0), np.zeros(0))


Paired = list[tuple[list[Trial], list[HalfSums]]]


def _friction_scale(paired: Paired) -> float:
    """RMS friction, N m: half the difference of the directions."""
    squares = []
    for group, _ in paired:
        ahead = [t.tau.mean() for t in group if t.velocity > 0]
        back = [t.tau.mean() for t in group if t.velocity < 0]
        if ahead and back:
            squares.append(((np.mean(ahead) - np.mean(back)) / 2) ** 2)
    return float(np.sqrt(np.mean(squares)))


def _system(robot: Robot, joint: int, paired: Paired) -> tuple[Array, Array, Array, Array]:
    """Stack the half-sums: gravity columns per configuration, offset and slope over the speed."""
    rows, extra, right, block = [], [], [], []
    fastest = max(item.speed for _, sums in paired for item in sums)
    count = 0
    for i, (group, sums) in enumerate(paired):
        for item in sums:
            a = gravity_columns(robot, joint, group[0].configuration, item.q)
            wide = np.zeros((len(item.q), a.shape[1] * len(paired)))
            wide[:, i * a.shape[1] : (i + 1) * a.shape[1]] = a
            rows.append(wide)
            slope = np.full(len(item.q), item.speed / fastest)
            # The gravity force of a prismatic joint is itself an offset.
            offset = [] if robot.chain.prismatic[joint] and a.shape[1] else [np.ones_like(slope)]
            extra.append(np.column_stack([*offset, slope]))
            right.append(item.tau)
            block.append(count + np.arange(len(item.q)) // 8)
            count += -(-len(item.q) // 8)
    return np.vstack(rows), np.vstack(extra), np.concatenate(right), np.concatenate(block)


def _solve(columns: Array, y: Array, block: Array) -> tuple[Array, Array]:
    """Least squares with standard errors that are robust within blocks of neighbouring slices."""
    if columns.shape[1] == 0:
        return np.zeros(0), np.zeros(0)
    solution: Array = np.asarray(np.linalg.lstsq(columns, y, rcond=1e-10)[0], dtype=np.float64)
    left = y - columns @ solution
    bread = np.linalg.pinv(columns.T @ columns)
    scores = np.zeros((int(block.max()) + 1, columns.shape[1]))
    np.add.at(scores, block.astype(int), columns * left[:, None])
    covariance = bread @ (scores.T @ scores) @ bread
    return solution, np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _asymmetry(
    columns: Array, extra: Array, y: Array, block: Array, friction: float
) -> tuple[float, bool]:
    """Share of friction that depends on direction, and whether it is beyond doubt and size."""
    both = np.hstack([columns, extra])
    solution, errors = _solve(both, y, block)
    offset = extra @ solution[columns.shape[1] :]
    share = float(np.sqrt(np.mean(offset**2)) / max(friction, 1e-12))
    sigma = np.abs(solution[columns.shape[1] :]) / np.maximum(errors[columns.shape[1] :], 1e-300)
    plain, _ = _solve(columns, y, block)
    left_plain = float(np.sum((y - columns @ plain) ** 2))
    left_both = float(np.sum((y - both @ solution) ** 2))
    helps = left_both < 0.97 * left_plain
    return share, bool(share > ASYMMETRY_SHARE and sigma.max() > ASYMMETRY_SIGMA and helps)
