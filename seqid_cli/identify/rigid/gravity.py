"""Gravity stage (Sec. 2.2.3, Eq. 17-19): base gravity parameters of the whole chain.

Rows are slice averages of constant-velocity trials, of the moving joint alone: a locked joint's
torque lies anywhere within its stiction. Friction comes from the friction stage. Its error flips
with the direction while gravity does not, so trials in both directions keep it out of the estimate.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.friction_surface.ramps import without_acceleration
from seqid_cli.identify.friction_surface.trials import Trial, by_joint, collect_trials
from seqid_cli.identify.regression.least_squares import Accumulator, Solution, solve
from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from seqid_cli.identify.rigid.parameters import empty_stage, rigid_stage
from seqid_cli.identify.rigid.posterior import (
    Posterior,
    Sensitivity,
    constant_moves,
    friction_covariance,
)
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.schema import RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import Basis, base_parameters, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


def identify_gravity(recordings: Iterable[Recording], robot: Robot, stages: Stages) -> RigidStage:
    """Identify the base parameters of gravity.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs in which one joint at a time moves at constant velocity, the others locked in several
        configurations; those of the friction stage can be used again.

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
    trials = collect_trials(recordings, robot)
    for j in range(robot.n):
        cross.add_joint(by_joint(trials, j), joints)
    if not cross.used:
        message = "no constant-velocity trial of a joint with known friction was found"
        hint = "give the logs of the friction stage again, or record single-joint moves"
        raise QualityError(message, hint=hint)
    solution = solve(joints)
    return _stage(robot, basis, solution, cross)


GROUP = 8  # slices of a trial that make a row


class GravityRows:
    """Turns trials into rows of Eq. 19 and remembers how friction errors would enter them.

    Rows are divided by the root of their noise's covariance (see `slow_noise`).
    """

    def __init__(self, robot: Robot, basis: Basis, surfaces: list[FrictionSurface | None]) -> None:
        self.robot, self.basis, self.surfaces = robot, basis, surfaces
        self.size = int(basis.gravity.sum())
        self.used = 0
        self.skipped: list[str] = []
        self._cross: dict[int, Array] = {}
        self._accelerated: list[tuple[int, Array]] = []

    def add_joint(self, trials: list[Trial], joints: list[Accumulator]) -> None:
        """Add the trials of one joint, the torque of what acceleration is left taken off."""
        surface = self.surfaces[trials[0].joint] if trials else None
        if surface is None:
            self.skipped += [self.robot.joint_names[trial.joint] for trial in trials]
            return
        groups = without_acceleration(self.robot, trials, surface)
        parts = [
            part
            for number, group in enumerate(groups)
            for trial in group.trials
            if (part := self._rows(trial, surface, number)) is not None
        ]
        if not parts:
            return
        self.used += len(parts)
        self._add_white(trials[0].joint, parts, [g.std_error for g in groups], joints)

    def _rows(self, trial: Trial, surface: FrictionSurface, group: int) -> "_TrialRows | None":
        """Rows of one trial, where friction is known."""
        v = np.full(len(trial.q), trial.velocity)
        inside = ~surface.outside(trial.q, v)
        count = int(inside.sum()) // GROUP
        if count == 0:
            return None
        q = trial.positions(self.robot.n)[inside]
        zero = np.zeros_like(q)
        H = base_regressor(self.robot, self.basis, q, zero, zero)[:, trial.joint, : self.size]
        F = surface.columns(trial.q[inside], v[inside])
        y = trial.tau[inside] - surface.torque(trial.q[inside], v[inside])
        wide = np.column_stack([H, F, trial.ddq[inside], trial.t[inside], y])
        means = np.stack([part.mean(axis=0) for part in np.array_split(wide, count)])
        return _TrialRows(means, float(inside.sum()) / count, trial, group)

    def _add_white(
        self, j: int, parts: "list[_TrialRows]", errors: list[float], joints: list[Accumulator]
    ) -> None:
        """Whiten the rows of one joint; each trial is a block."""
        rows = _joined(parts, self.size)
        values = np.vstack([part.values for part in parts])
        white = whitener_of(rows)(np.delete(values, -2, axis=1))
        H, F = white[:, : self.size], white[:, self.size : -2]
        for number in range(len(parts)):
            own = rows.trial == number
            for k, joint in enumerate(joints):
                kept = own if k == j else np.zeros_like(own)
                joint.add(H[kept], white[kept, -1])
        self._cross[j] = H.T @ F
        group = np.array([part.group for part in parts])[rows.trial]
        for number, error in enumerate(errors):
            own = group == number
            self._accelerated.append((j, error * (H[own].T @ white[own, -2])))

    def sensitivity(self, solution: Solution) -> Sensitivity:
        """How the parameters move with the coefficients of each joint's friction."""
        return {
            j: -solution.bread @ crossed / solution.sigma[j] ** 2
            for j, crossed in self._cross.items()
        }

    def acceleration_part(self, solution: Solution) -> Array:
        """Covariance of what is not known of the trials' own acceleration (see `ramps`)."""
        moves = [solution.bread @ c / solution.sigma[j] ** 2 for j, c in self._accelerated]
        return sum((np.outer(move, move) for move in moves), np.zeros_like(solution.bread))


@dataclass(frozen=True)
class _TrialRows:
    """Columns of H, F, acceleration, time and torque (M, p + K + 3), means of so many slices."""

    values: Array
    slices: float
    trial: Trial
    group: int


def _joined(parts: list[_TrialRows], size: int) -> Rows:
    values = np.vstack([part.values for part in parts])
    count = [len(part.values) for part in parts]

    def each(numbers: list[float]) -> Array:
        return np.repeat(np.array(numbers, dtype=np.float64), count)

    return Rows(
        H=values[:, :size],
        y=values[:, -1],
        t=values[:, -2],
        weight=each([part.slices * part.trial.weight for part in parts]),
        seconds=each([part.slices * part.trial.seconds for part in parts]),
        trial=np.repeat(np.arange(len(parts)), count),
        log=np.repeat(np.array([part.trial.log for part in parts]), count),
    )


def _stage(
    robot: Robot,
    basis: Basis,
    solution: Solution,
    rows: GravityRows,
    *,
    poor_condition: float = 300.0,
) -> RigidStage:
    """The stage; it is poor from a condition number of `poor_condition` on."""
    sensitivity = rows.sensitivity(solution)
    covariance = solution.covariance + rows.acceleration_part(solution)
    covariance += friction_covariance(sensitivity, rows.surfaces, rows.size)
    moves = constant_moves(solution, robot.torque_constant_errors, {})
    posterior = Posterior(covariance, sensitivity, moves)
    own = np.arange(rows.size)
    stage = rigid_stage(robot, basis, solution, posterior, own, np.zeros(robot.n))
    missing, notes = stage.not_excited, []
    if missing:
        notes.append(
            f"not excited by these logs: {'; '.join(missing)}. Move the joints that carry them "
            "with the others locked in other configurations"
        )
    if rows.skipped:
        notes.append("trials without a friction surface left out: " + ", ".join(set(rows.skipped)))
    good = not missing and solution.condition < poor_condition
    reason = f"rank {solution.rank} of {rows.size}, condition {solution.condition:.3g}"
    verdict = Verdict(good=good, reason=reason)
    return replace(stage, structural_rank=rows.size, verdicts=[verdict], notes=notes)
