"""Gravity stage (Sec. 2.2.3, Eq. 17-19): base gravity parameters of the whole chain.

Rows are slice averages of constant-velocity trials, of the moving joint alone: a locked joint's
torque lies anywhere within its stiction. Friction comes from the friction stage. Its error flips
with the direction while gravity does not, so trials in both directions keep it out of the estimate.
"""

from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.friction_surface import corrections
from seqid_cli.identify.friction_surface.corrections import HeldJoints, SteadyGroup
from seqid_cli.identify.friction_surface.gravity_separation import configurations
from seqid_cli.identify.friction_surface.trials import Trial, collect_trials
from seqid_cli.identify.regression.least_squares import Accumulator, Solution, solve
from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from seqid_cli.identify.rigid.parameters import rigid_stage
from seqid_cli.identify.rigid.posterior import Posterior, Sensitivity
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.schema import RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


def identify_gravity(recordings: Iterable[Recording], robot: Robot, stages: Stages) -> RigidStage:
    """Identify the base parameters of gravity; the stage is empty where it loads no joint."""
    if stages.friction is None:
        raise UsageError("gravity needs the friction stage", hint="run seqid friction first")
    size = int(base_parameters(robot, rotor=()).gravity.sum())
    if size == 0:
        note = "gravity loads no joint of this robot: nothing to identify (Sec. 4.2)"
        return RigidStage(parameters=[], condition=0.0, rank=0, notes=[note])
    joints = [Accumulator(size) for _ in range(robot.n)]
    trials, surfaces = collect_trials(recordings, robot), friction_surfaces(stages, robot)
    cross = GravityRows(HeldJoints.of(robot, trials, surfaces), surfaces)
    for j in range(robot.n):
        cross.add_joint([trial for trial in trials if trial.joint == j], joints)
    if not cross.used:
        message = "no constant-velocity trial of a joint with known friction was found"
        hint = "give the logs of the friction stage again, or record single-joint moves"
        raise QualityError(message, hint=hint)
    return _stage(solve(joints), cross)


class GravityRows:
    """Turns trials into white rows of Eq. 19 and remembers how friction errors would enter them."""

    def __init__(self, held: HeldJoints, surfaces: list[FrictionSurface | None]) -> None:
        self.robot, self.held, self.surfaces = held.robot, held, surfaces
        self.size = len(held.theta)
        self.used = 0
        self.skipped: list[str] = []
        self.cross: dict[int, Array] = {}
        self.unseen: list[tuple[int, Array]] = []  # what is not known of acceleration and others

    def add_joint(self, trials: list[Trial], joints: list[Accumulator]) -> None:
        """Add the trials of one joint, the torque of what acceleration is left taken off."""
        j = trials[0].joint if trials else 0
        surface = self.surfaces[j]
        if surface is None:
            self.skipped += [self.robot.joint_names[trial.joint] for trial in trials]
            return
        every = configurations(trials)
        groups = corrections.without_acceleration(self.robot, every, surface)
        table = self._table(groups, surface)
        if not len(table):
            return
        H, y = table[:, : self.size], table[:, -7]
        t, weight, seconds = table[:, -6:-3].T
        trial, log, group = table[:, -3:].T.astype(np.intp)
        white = whitener_of(Rows(H, y, t, weight, seconds, trial, log))(table[:, :-6])
        parts_of = [self.size, -2 - self.robot.n, -2, -1]
        H, F, stood, accelerated, y = np.split(white, parts_of, axis=1)
        for number in np.unique(trial):  # each is a block
            self.used += 1
            for k, joint in enumerate(joints):
                joint.add(H, y[:, 0], (trial == number) & (k == j))
        self.cross[j] = H.T @ F
        for k, each in enumerate(groups):
            self.unseen.append((j, H.T @ (each.std_error * accelerated[:, 0] * (group == k))))
            for number in np.unique(log[group == k]):  # each with the same reading all along
                there = (group == k) & (log == number)
                self.unseen += [(j, H.T @ (column * there)) for column in stood.T]

    def _table(
        self, groups: list[SteadyGroup], surface: FrictionSurface, *, group_size: int = 8
    ) -> Array:
        """Rows of all trials, means over so many slices (`group_size`)."""
        # H, F, where others stand, acceleration, torque, time, samples, seconds; trial, log, group.
        every = [(k, trial) for k, group in enumerate(groups) for trial in group.trials]
        settled = [(k, trial.part(_settled(trial, surface))) for k, trial in every]
        used = [(k, trial) for k, trial in settled if len(trial.q) >= group_size]
        if not used:
            return np.zeros((0, 1))
        own = [trial for _, trial in used]
        by_gravity = zip(used, self.held.means(own), self.held.unseen(own), strict=True)
        parts = []
        for n, ((k, trial), H, stood) in enumerate(by_gravity):
            v, count = np.full(len(trial.q), trial.velocity), len(trial.q) // group_size
            F, y = surface.columns(trial.q, v), trial.tau - surface.torque(trial.q, v)
            wide = np.array_split(np.column_stack([H, F, stood, trial.ddq, y, trial.t]), count)
            slices = len(trial.q) / count
            about = slices * trial.weight, slices * trial.seconds, n, trial.log, k
            means = np.stack([part.mean(axis=0) for part in wide])
            parts.append(np.hstack([means, np.tile(about, (count, 1))]))
        return np.vstack(parts)

    def sensitivity(self, solution: Solution) -> Sensitivity:
        """How the parameters move with the coefficients of each joint's friction."""
        return {j: -solution.bread @ (S / solution.sigma[j] ** 2) for j, S in self.cross.items()}


def _settled(
    trial: Trial, surface: FrictionSurface, *, settling_s: float = 0.03, most_share: float = 0.125
) -> Mask:
    """Slices (K,) of a trial where friction is known and the joint keeps its speed."""
    # Left out are `settling_s` from either end, but no more than `most_share` of the trial.
    middle = (trial.t[0] + trial.t[-1]) / 2.0
    half = (trial.t[-1] - trial.t[0] + trial.seconds) / 2.0
    settled = np.abs(trial.t - middle) < half - min(settling_s, 2.0 * most_share * half)
    return np.asarray(settled & ~surface.outside(trial.q, np.full(len(trial.q), trial.velocity)))


def _stage(
    solution: Solution, rows: GravityRows, *, poor_condition: float = 300, clear_sigma: float = 4
) -> RigidStage:
    """The stage; gravity shows where a parameter is `clear_sigma` standard errors from zero."""
    robot, basis = rows.robot, rows.held.basis
    about = rows.surfaces, robot.torque_constant_errors, rows.sensitivity(solution)
    unseen = [solution.bread @ crossed / solution.sigma[j] ** 2 for j, crossed in rows.unseen]
    posterior = Posterior.of(solution, *about, known={})
    posterior = posterior.with_error(np.reshape(unseen, (-1, rows.size)).T)
    stage = rigid_stage(robot, basis, solution, posterior, np.arange(rows.size), np.zeros(robot.n))
    remedy = "Move the joints that carry them with the others locked in other configurations"
    notes = [f"{note}. {remedy}" for note in stage.notes]
    if rows.skipped:
        notes.append("trials without a friction surface left out: " + ", ".join(set(rows.skipped)))
    if all(abs(p.value) < clear_sigma * p.std_error for p in stage.parameters):
        notes.append(
            "no gravity shows in the torque: either no joint carries a weight, or a driver has "
            'subtracted it (then write effort = "gravity_compensated" under [channels])'
        )
    good = not stage.not_excited and solution.condition < poor_condition
    reason = f"rank {solution.rank} of {rows.size}, condition {solution.condition:.3g}"
    verdict = Verdict(good=good, reason=reason)
    return replace(stage, structural_rank=rows.size, verdicts=[verdict], notes=notes)
