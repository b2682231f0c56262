"""Gravity stage (Sec. 2.2.3, Eq. 17-19): base gravity parameters of the whole chain.

Rows are slice averages of constant-velocity trials, of the moving joint alone: a locked
joint's torque lies anywhere within its stiction. Friction comes from the friction
stage. Its error flips with the direction while gravity does not, so trials in both
directions keep it out of the estimate. What does not turn with the direction either, a
drive's offset and the share by which friction is larger one way, is unknown beside
gravity, joint by joint (`identify.nuisances`). The surfaces are handed on with what
these trials, in more postures than friction's, show of it.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace as replace_fields

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.friction_surface import corrections
from seqid_cli.identify.friction_surface.corrections import HeldJoints, SteadyGroup
from seqid_cli.identify.friction_surface.gravity_separation import configurations
from seqid_cli.identify.friction_surface.trials import Trial, collect_trials
from seqid_cli.identify.nuisances import (
    EVEN_TERMS,
    EvenPart,
    change_of,
    described,
    even_columns,
    even_prior,
    friction_rms,
    robot_friction_rms,
    shown,
    thermal_column,
    with_even_part,
    with_term,
)
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
)
from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from seqid_cli.identify.rigid.parameters import rigid_stage
from seqid_cli.identify.rigid.posterior import Posterior, Sensitivity
from seqid_cli.identify.settings import GravityFitSettings, GravitySettings
from seqid_cli.identify.tolerances import deviation_torques, deviations
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.schema import FrictionStage, Nuisance, RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

# of each joint's drive: what is alike both ways, and thermal change
TERMS = EVEN_TERMS + 1


@dataclass(frozen=True)
class GravityResult:
    """The gravity stage, and the friction stage with the offsets that gravity's trials show."""

    gravity: RigidStage
    friction: FrictionStage


def identify_gravity(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    settings: GravitySettings = GravitySettings(),
) -> GravityResult:
    """Identify the base parameters of gravity; the stage is empty where it loads no joint."""
    if stages.friction is None:
        raise UsageError(
            "gravity needs the friction stage", hint="run seqid friction first"
        )
    size = int(base_parameters(robot, rotor=()).gravity.sum())
    if size == 0:
        note = "gravity loads no joint of this robot: nothing to identify (Sec. 4.2)"
        empty = RigidStage(parameters=[], condition=0.0, rank=0, notes=[note])
        return GravityResult(empty, stages.friction)
    trials = list(collect_trials(recordings, robot))
    surfaces = friction_surfaces(stages, robot)
    held = HeldJoints.of(robot, trials, surfaces)
    rows = GravityRows(held, surfaces, stages.friction, settings)
    joints = [Accumulator(rows.columns) for _ in range(robot.n)]
    for j in range(robot.n):
        rows.add_joint([trial for trial in trials if trial.joint == j], joints)
    if not rows.used:
        message = "no constant-velocity trial of a joint with known friction was found"
        hint = "give the logs of the friction stage again, or record single-joint moves"
        raise QualityError(message, hint=hint)

    prior = rows.prior(stages.friction)
    solution = solve(joints, prior=prior, nuisances=slice(size, None))
    return _stage(solution, rows, prior, stages.friction, settings.fit)


@dataclass(frozen=True)
class TrialFit:
    """Rows H (N, p), y (N,) N m of one joint's trials as they were measured, and their weights."""

    H: Array
    y: Array
    weight: Array

    def left(self, theta: Array) -> float:
        """Return the RMS torque [N m] that parameters and nuisance terms (p,) leave."""
        residual = self.y - self.H @ theta
        return float(np.sqrt(np.average(residual**2, weights=self.weight)))


class EvenParts(NamedTuple):
    """Friction with another even part, its terms, and their places behind the parameters."""

    friction: FrictionStage
    terms: list[Nuisance]
    order: Index


class GravityRows:
    """Turns trials into white rows of Eq. 19 and remembers how friction errors would enter them."""

    def __init__(
        self,
        held: HeldJoints,
        surfaces: list[FrictionSurface | None],
        friction: FrictionStage,
        settings: GravitySettings = GravitySettings(),
    ) -> None:
        self.robot, self.held, self.surfaces = held.robot, held, surfaces
        self.settings = settings
        self.size = len(held.theta)
        # Behind the parameters: changes of all joints' offsets, then of their
        # asymmetries, then of the viscous ones, then of friction per kelvin.
        self.columns = self.size + TERMS * held.robot.n
        joints = friction.joints
        self.thermal = [
            change_of(joints[name], "thermal") if name in joints else None
            for name in held.robot.joint_names
        ]
        self.used = 0
        self.skipped: list[str] = []
        self.cross: dict[int, Array] = {}
        self.fits: dict[int, TrialFit] = {}
        standard = held.basis.representative[:, : self.size] @ held.theta
        # The whole of the bodies counts where the geometry is another, not their base
        # parameters.
        links = standard[: 10 * self.robot.n].reshape(-1, 10)
        self.standard = links if self.robot.nominal is None else self.robot.nominal
        self.deviations = [deviation.name for deviation in deviations(self.robot)]
        self.tolerances: dict[str, dict[int, Array]] = {
            name: {} for name in self.deviations
        }
        # what is not known of acceleration and others
        self.unseen: list[tuple[int, Array]] = []

    def add_joint(self, trials: list[Trial], joints: list[Accumulator]) -> None:
        """Add the trials of one joint, the torque of what acceleration is left taken off."""
        j = trials[0].joint if trials else 0
        surface = self.surfaces[j]
        if surface is None:
            self.skipped += [self.robot.joint_names[trial.joint] for trial in trials]
            return
        every = configurations(trials, self.settings.trials)
        groups = corrections.without_acceleration(self.robot, every, surface)
        table = self._table(groups, surface)
        if not len(table):
            return
        shared = self.size + TERMS
        t, weight, seconds = table[:, -6:-3].T
        trial, log, group = table[:, -3:].T.astype(np.intp)
        noise = Rows(table[:, :shared], table[:, -7], t, weight, seconds, trial, log)
        white = whitener_of(noise)(table[:, :-6])
        count = len(self.deviations)
        parts_of = [self.size, shared, -2 - count - self.robot.n, -2 - count, -2, -1]
        gravity, even, F, stood, deviated, accelerated, y = np.split(
            white, parts_of, axis=1
        )

        H = np.zeros((len(gravity), self.columns))
        H[:, : self.size] = gravity
        H[:, self.size + j :: self.robot.n] = even
        for number in np.unique(trial):  # each is a block
            self.used += 1
            for k, joint in enumerate(joints):
                joint.add(H, y[:, 0], (trial == number) & (k == j))
        self.cross[j] = H.T @ F
        raw = np.zeros((len(table), self.columns))
        raw[:, : self.size] = table[:, : self.size]
        raw[:, self.size + j :: self.robot.n] = table[:, self.size : shared]
        self.fits[j] = TrialFit(raw, table[:, -7], weight)
        for name, torque in zip(self.deviations, deviated.T, strict=True):
            self.tolerances[name][j] = H.T @ torque
        for k, each in enumerate(groups):
            self.unseen.append(
                (j, H.T @ (each.std_error * accelerated[:, 0] * (group == k)))
            )
            # each with the same reading all along
            for number in np.unique(log[group == k]):
                there = (group == k) & (log == number)
                self.unseen += [(j, H.T @ (column * there)) for column in stood.T]

    def _table(
        self,
        groups: list[SteadyGroup],
        surface: FrictionSurface,
        *,
        group_size: int = 8,
    ) -> Array:
        """Rows of all trials, means over so many slices (`group_size`)."""
        # H, offset and asymmetries, F, where others stand, deviations, acceleration,
        # torque, time, samples, seconds; last come trial, log, group.
        every = [(k, trial) for k, group in enumerate(groups) for trial in group.trials]
        settling = self.settings.fit
        settled = [
            (k, trial.part(_settled(trial, surface, settling))) for k, trial in every
        ]
        used = [(k, trial) for k, trial in settled if len(trial.q) >= group_size]
        if not used:
            return np.zeros((0, 1))
        own = [trial for _, trial in used]
        by_gravity = zip(used, self.held.means(own), self.held.unseen(own), strict=True)
        parts = []
        for n, ((k, trial), H, stood) in enumerate(by_gravity):
            v, count = np.full(len(trial.q), trial.velocity), len(trial.q) // group_size
            # What friction's surfaces have alike both ways is an unknown here, of which
            # they hold a first estimate; its error is not friction's.
            F = surface.error_columns(trial.q, v)
            warmed = surface.warmed(np.full(len(v), trial.celsius))
            y = trial.tau - warmed * surface.torque(trial.q, v)
            even = even_columns(surface, trial.q, v)
            still = np.zeros_like(trial.places)
            torques = deviation_torques(
                self.robot, self.standard, trial.places, still, still
            )
            deviated = [torque[:, trial.joint] for torque in torques.values()]
            warm = self._warm(trial, surface, v)
            columns = [H, even, warm, F, stood, *deviated, trial.ddq, y, trial.t]
            wide = np.array_split(np.column_stack(columns), count)
            slices = len(trial.q) / count
            about = slices * trial.weight, slices * trial.seconds, n, trial.log, k
            means = np.stack([part.mean(axis=0) for part in wide])
            parts.append(np.hstack([means, np.tile(about, (count, 1))]))
        return np.vstack(parts)

    def _warm(self, trial: Trial, surface: FrictionSurface, v: Array) -> Array:
        """Return the torque (K,) [N m K] per friction's change per kelvin; 0 without a sensor."""
        change = self.thermal[trial.joint]
        if change is None:
            return np.zeros(len(v))
        kelvin = surface.kelvin(np.full(len(v), trial.celsius))
        return thermal_column(surface, change, kelvin, trial.q, v)

    def prior(self, friction: FrictionStage) -> Prior:
        """Return what friction's trials know of the drives' terms, as rows of unit variance."""
        n = self.robot.n
        even = even_prior(self.surfaces, friction, self.robot.joint_names)
        weights = [
            1.0 if change is None else 1.0 / change.std_error for change in self.thermal
        ]
        A = np.zeros((TERMS * n, self.columns))
        A[: len(even.b), self.size : self.size + len(even.b)] = even.A
        A[len(even.b) :, self.size + len(even.b) :] = np.diag(weights)
        return Prior(A, np.concatenate([even.b, np.zeros(n)]))

    def tolerance_moves(self, solution: Solution) -> dict[str, Array]:
        """How the parameters move with one standard deviation of what no log shows."""
        moves = {}
        for name, crossed in self.tolerances.items():
            parts = [cross / solution.sigma[j] ** 2 for j, cross in crossed.items()]
            moves[name] = solution.bread @ np.sum(parts, axis=0)
        return moves

    def sensitivity(self, solution: Solution) -> Sensitivity:
        """How the parameters move with the coefficients of each joint's friction."""
        return {
            j: -solution.bread @ (S / solution.sigma[j] ** 2)
            for j, S in self.cross.items()
        }


def _settled(
    trial: Trial, surface: FrictionSurface, settings: GravityFitSettings
) -> Mask:
    """Return the slices (K,) of a trial where friction is known and the joint keeps its speed."""
    # Left out are slices that begin or end within `settling` of either end, but no more
    # than `settling_share` of the trial there. One that only reaches into it holds the
    # torque of a rotor's acceleration, which is many times a light joint's friction.
    middle = (trial.t[0] + trial.t[-1]) / 2.0
    half_slice = trial.seconds / 2.0
    half_trial = (trial.t[-1] - trial.t[0]) / 2.0 + half_slice
    settling = min(settings.settling, 2.0 * settings.settling_share * half_trial)
    farthest = np.abs(trial.t - middle) + half_slice
    settled = farthest <= half_trial - settling
    speed = np.full(len(trial.q), trial.velocity)
    return np.asarray(settled & ~surface.outside(trial.q, speed))


def _stage(
    solution: Solution,
    rows: GravityRows,
    prior: Prior,
    friction: FrictionStage,
    settings: GravityFitSettings,
) -> GravityResult:
    """The stage; gravity shows where a parameter is `shown_sigma` standard errors from zero.

    One set of parameters may leave `max_left` times what friction's surface leaves of
    the same joint's trials, each posture having its own gravity there.
    """
    robot = rows.robot
    size = rows.size
    unseen = [
        solution.bread @ crossed / solution.sigma[j] ** 2 for j, crossed in rows.unseen
    ]
    joint_posterior = Posterior.of(
        solution,
        rows.surfaces,
        robot.torque_constant_errors,
        rows.sensitivity(solution),
        known=_by_prior(solution, prior, robot.n),
        prior=prior,
    ).with_error(np.reshape(unseen, (-1, rows.columns)).T)
    joint_posterior = replace(
        joint_posterior, tolerances=rows.tolerance_moves(solution)
    )

    posterior = joint_posterior.first(size)
    parameters = solution.first(size)
    own = np.arange(size)
    stage = rigid_stage(
        robot, rows.held.basis, parameters, posterior, own, np.zeros(robot.n)
    )
    remedy = (
        "Move the joints that carry them with the others locked in other configurations"
    )
    notes = [f"{note}. {remedy}" for note in stage.notes]
    if rows.skipped:
        notes.append(
            "trials without a friction surface left out: "
            + ", ".join(set(rows.skipped))
        )
    if all(abs(p.value) < settings.shown_sigma * p.std_error for p in stage.parameters):
        notes.append(
            "no gravity shows in the torque: either no joint carries a weight, or a"
            ' driver has subtracted it (then write effort = "gravity_compensated" under'
            " [channels])"
        )

    friction, terms, order = _with_even_parts(solution, joint_posterior, rows, friction)
    used = np.concatenate([np.flatnonzero(parameters.determined), size + order])
    covariance = joint_posterior.covariance[np.ix_(used, used)]
    sizes = robot_friction_rms(rows.surfaces, robot)
    notes += [described(term) for term in shown(terms, sizes)]

    of_joints = _joint_verdicts(solution, rows, friction, settings.max_left)
    good = not stage.not_excited and solution.condition < settings.max_condition
    reason = f"rank {solution.rank} of {size}, condition {solution.condition:.3g}"
    stage = replace_fields(
        stage,
        structural_rank=size,
        verdicts=[*of_joints, Verdict(good=good, reason=reason)],
        notes=notes,
        nuisances=terms,
        nuisance_covariance=covariance.tolist(),
    )
    return GravityResult(stage, friction)


def _by_prior(solution: Solution, prior: Prior, joints: int) -> dict[int, Array]:
    """Return what the centre of each joint's prior adds to the solution (p,), taken off.

    A prior's centre is an offset that was measured: it scales with the torque as the
    rows do.
    """
    found = {}
    for j in range(joints):
        rows = np.arange(j, len(prior.b), joints)
        found[j] = -solution.bread @ prior.A[rows].T @ prior.b[rows]
    return found


def _joint_verdicts(
    solution: Solution, rows: GravityRows, friction: FrictionStage, max_left: float
) -> list[Verdict]:
    """Judge the joints at which one gravity for all postures leaves more than noise."""
    verdicts = []
    for j, fit in rows.fits.items():
        joint = rows.robot.joints[j]
        left = fit.left(solution.theta)
        alone = friction.joints[joint.name].rmse
        if left <= max_left * alone:
            continue
        unit = joint.unit("N m")
        reason = (
            f"one gravity for all postures leaves {left:.3g} {unit}, {left / alone:.2g}"
            f" times what a gravity of its own in each does ({alone:.3g} {unit}):"
            " geometry, zeros or gravity's direction in the robot file are not the"
            " arm's, or the load was another in some trials"
        )
        verdicts.append(
            Verdict(joint=joint.name, good=False, level="usable", reason=reason)
        )
    return verdicts


def _with_even_parts(
    solution: Solution, posterior: Posterior, rows: GravityRows, friction: FrictionStage
) -> EvenParts:
    """Return friction with offsets and asymmetries as gravity's trials show them.

    Beside it stand the terms as the file lists them, joint by joint, and the place of
    each of them behind the parameters.
    """
    n = rows.robot.n
    joints = dict(friction.joints)
    terms: list[Nuisance] = []
    order: list[int] = []
    for j, name in enumerate(rows.robot.joint_names):
        surface = rows.surfaces[j]
        if surface is None or j not in rows.cross:
            continue
        places = [k * n + j for k in range(EVEN_TERMS)]
        wide = [rows.size + place for place in places]
        change = rows.thermal[j]
        if change is not None:
            place = rows.size + EVEN_TERMS * n + j
            joints[name] = with_term(
                joints[name],
                "thermal",
                value=change.value + float(solution.theta[place]),
                std_error=float(np.sqrt(posterior.covariance[place, place])),
            )
        before = EvenPart.of_joint(joints[name], friction_rms(surface))
        even = EvenPart(
            values=before.values + solution.theta[wide],
            covariance=posterior.covariance[np.ix_(wide, wide)],
        )
        joints[name] = with_even_part(joints[name], name, even)
        terms += even.terms(name, joints[name].unit)
        order += places
    stage = replace_fields(friction, joints=joints)
    return EvenParts(stage, terms, np.array(order, dtype=np.intp))
