"""Gravity stage (Sec. 2.2.3, Eq. 17-19): base gravity parameters of the whole chain.

Rows are slice averages of constant-velocity trials, of the moving joint alone: a locked joint's
torque lies anywhere within its stiction. Friction comes from the friction stage. Its error flips
with the direction while gravity does not, so trials in both directions keep it out of the estimate.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.least_squares import Accumulator, Solution, solve
from seqid_cli.identify.rigid_stage import (
    empty_stage,
    not_excited,
    parameters_of,
    representative_of,
)
from seqid_cli.identify.trials import Trial, collect_trials
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage, Stages, Verdict
from seqid_cli.robot.base import Basis, base_parameters, base_regressor
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

POOR_CONDITION = 300.0


def identify_gravity(
    recordings: Iterable[Recording], robot: Robot, stages: Stages, *, options: MotionOptions
) -> RigidStage:
    """Identify the base parameters of gravity.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs in which one joint at a time moves at constant velocity, the others locked in several
        configurations; those of the friction stage can be used again.
    robot : Robot
        Chain and gravity vector.
    stages : Stages
        With the friction stage.
    options : MotionOptions
        Not used by this stage, which averages instead of filtering.

    Returns
    -------
    RigidStage
        Parameters with units kg m (kg for prismatic chains); empty where gravity loads no joint.

    Raises
    ------
    UsageError
        If there is no friction stage.
    QualityError
        If no usable trial was found.
    """
    if stages.friction is None:
        raise UsageError("gravity needs the friction stage", hint="run seqid friction first")
    basis = base_parameters(robot, rotor=())
    size = int(basis.gravity.sum())
    if size == 0:
        return empty_stage("gravity loads no joint of this robot: nothing to identify (Sec. 4.2)")
    joints = [Accumulator(size) for _ in range(robot.n)]
    cross = GravityRows(robot, basis, friction_surfaces(stages, robot))
    for trial in collect_trials(recordings, robot):
        cross.add(trial, joints)
    if not cross.used:
        raise QualityError(
            "no constant-velocity trial of a joint with known friction was found",
            hint="give the logs of the friction stage again, or record single-joint moves",
        )
    solution = solve(joints)
    covariance = solution.covariance + cross.friction_part(solution)
    return _stage(robot, basis, solution, covariance, cross)


class GravityRows:
    """Turns trials into rows of Eq. 19 and remembers how friction errors would enter them."""

    def __init__(self, robot: Robot, basis: Basis, surfaces: list[FrictionSurface | None]) -> None:
        self.robot, self.basis, self.surfaces = robot, basis, surfaces
        self.size = int(basis.gravity.sum())
        self.used = 0
        self.skipped: list[str] = []
        self._cross: dict[int, Array] = {}

    def add(self, trial: Trial, joints: list[Accumulator]) -> None:
        """Add the rows of one trial."""
        surface = self.surfaces[trial.joint]
        if surface is None:
            self.skipped.append(self.robot.joint_names[trial.joint])
            return
        v = np.full(len(trial.q), trial.velocity)
        inside = ~surface.outside(trial.q, v)
        q = trial.positions(self.robot.n)[inside]
        if not len(q):
            return
        zero = np.zeros_like(q)
        H = base_regressor(self.robot, self.basis, q, zero, zero)[:, trial.joint, : self.size]
        F = surface.columns(trial.q[inside], v[inside])
        y = trial.tau[inside] - surface.torque(trial.q[inside], v[inside])
        root = np.sqrt(trial.weight)
        # Drift and friction errors are shared within a trial: it is one block.
        for j, joint in enumerate(joints):
            own = slice(None) if j == trial.joint else slice(0, 0)
            joint.add(H[own] * root, y[own] * root)
        crossed = self._cross.get(trial.joint, np.zeros((self.size, F.shape[1])))
        self._cross[trial.joint] = crossed + trial.weight * H.T @ F
        self.used += 1

    def friction_part(self, solution: Solution) -> Array:
        """Covariance that the friction stage's own uncertainty adds."""
        total = np.zeros_like(solution.bread)
        for j, crossed in self._cross.items():
            surface = self.surfaces[j]
            assert surface is not None
            G = solution.bread @ crossed / solution.sigma[j] ** 2
            total += G @ surface.covariance @ G.T
        return total


def _stage(
    robot: Robot, basis: Basis, solution: Solution, covariance: Array, rows: GravityRows
) -> RigidStage:
    indices = np.arange(rows.size)
    determined = indices[solution.determined]
    theta = np.zeros(basis.size)
    theta[: rows.size] = solution.theta
    missing = not_excited(basis, solution, indices)
    notes = []
    if missing:
        notes.append(
            f"not excited by these logs: {'; '.join(missing)}. Move the joints that carry them "
            "with the others locked in other configurations"
        )
    if rows.skipped:
        notes.append("trials without a friction surface left out: " + ", ".join(set(rows.skipped)))
    good = not missing and solution.condition < POOR_CONDITION
    reason = f"rank {solution.rank} of {rows.size}, condition {solution.condition:.3g}"
    return RigidStage(
        parameters=parameters_of(robot, basis, determined, theta, covariance),
        condition=solution.condition,
        rank=solution.rank,
        structural_rank=rows.size,
        representative=representative_of(basis, theta, np.zeros(robot.n)),
        covariance=covariance[np.ix_(determined, determined)].tolist(),
        not_excited=missing,
        rmse={},
        verdicts=[Verdict(good=good, reason=reason)],
        notes=notes,
    )
