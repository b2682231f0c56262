"""Gravity stage (Sec. 2.2.3, Eq. 17-19): base gravity parameters of the whole chain.

Rows are slice averages of constant-velocity trials, of the moving joint alone: a locked
joint's torque lies anywhere within its stiction. Friction comes from the friction
stage. Its error flips with the direction while gravity does not, so trials in both
directions keep it out of the estimate. What does not turn with the direction either, a
drive's offset and the share by which friction is larger one way, is unknown beside
gravity, joint by joint (`identify.nuisances`). The surfaces are handed on with what
these trials, in more postures than friction's, show of it, and judged once more by
whether a joint rubs alike in all of them (`friction_of_logs`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec.structs import replace as replace_fields

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.friction_surface.corrections import HeldJoints
from seqid_cli.identify.friction_surface.trials import collect_trials
from seqid_cli.identify.judging import as_a_whole
from seqid_cli.identify.log_set import paths_of
from seqid_cli.identify.nuisances import (
    EVEN_NAMES,
    EVEN_TERMS,
    described,
    robot_friction_rms,
    shown,
    with_drive_terms,
)
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
)
from seqid_cli.identify.rigid.friction_of_logs import FrictionShares
from seqid_cli.identify.rigid.gravity_rows import GravityRows
from seqid_cli.identify.rigid.parameters import rigid_stage
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.settings import GravitySettings
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.schema import FrictionStage, Nuisance, RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index

LOCK_REMEDY = (
    "Move the joints that carry them with the others locked in other configurations"
)
NO_GRAVITY = (
    "no gravity shows in the torque: either no joint carries a weight, or a driver has"
    ' subtracted it (then write effort = "gravity_compensated" under [channels])'
)


@dataclass(frozen=True)
class GravityResult:
    """The gravity stage, and the friction stage with what gravity's trials show."""

    gravity: RigidStage
    friction: FrictionStage


def identify_gravity(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    settings: GravitySettings = GravitySettings(),
) -> GravityResult:
    """Identify gravity's base parameters; the stage is empty without loaded joints.

    Parameters
    ----------
    recordings : iterable of Recording
        Constant-velocity trials of single joints, those of the friction stage among
        them; a `LogSet` is read log by log.
    robot : Robot
    stages : Stages
        With the friction stage.
    settings : GravitySettings

    Raises
    ------
    UsageError
        Without a friction stage.
    QualityError
        Where no joint with known friction moves by itself at constant velocity.
    """
    if stages.friction is None:
        raise UsageError(
            "gravity needs the friction stage", hint="run seqid friction first"
        )
    size = int(base_parameters(robot, rotor=()).gravity.sum())
    if size == 0:
        note = "gravity loads no joint of this robot: nothing to identify (Sec. 4.2)"
        empty = RigidStage(parameters=[], condition=0.0, rank=0, notes=[note])
        return GravityResult(empty, stages.friction)

    if not hasattr(recordings, "logs"):  # all but a `LogSet` may come only once
        recordings = list(recordings)
    trials = list(collect_trials(recordings, robot))
    surfaces = friction_surfaces(stages, robot)
    held = HeldJoints.of(robot, trials, surfaces)
    rows = GravityRows(held, surfaces, stages.friction, settings)
    joints = [Accumulator(rows.columns) for _ in range(robot.n)]
    for j in range(robot.n):
        rows.add_joint([trial for trial in trials if trial.joint == j], joints)
    if not rows.trials_used:
        message = "no constant-velocity trial of a joint with known friction was found"
        hint = "give the logs of the friction stage again, or record single-joint moves"
        raise QualityError(message, hint=hint)

    logs = [path.name for path in paths_of(recordings)]
    prior = rows.prior(stages.friction)
    solution = solve(joints, prior=prior, nuisances=slice(size, None))
    judged_joints = _judged(solution, rows, stages.friction, logs)
    return _result(solution, rows, prior, stages.friction, judged_joints)


@dataclass(frozen=True, kw_only=True)
class JudgedJoints:
    """Verdicts on joints: on gravity's fit there, and on friction that has changed.

    `friction` and `changed_friction` hold, by name, the joints whose friction differs
    between logs.
    """

    gravity: list[Verdict]
    friction: dict[str, Verdict]
    changed_friction: dict[str, FrictionShares]


def _judged(
    solution: Solution, rows: GravityRows, friction: FrictionStage, logs: Sequence[str]
) -> JudgedJoints:
    """Judge the joints by what one gravity for all postures leaves there."""
    settings = rows.settings.fit
    of_gravity: list[Verdict] = []
    of_friction: dict[str, Verdict] = {}
    changed: dict[str, FrictionShares] = {}
    for j, joint_rows in rows.joints.items():
        joint = rows.robot.joints[j]
        residual = joint_rows.residual(solution.theta)
        shares = FrictionShares.of(joint_rows, solution.theta)
        if shares.has_changed(settings):
            changed[joint.name] = shares
            of_friction[joint.name] = shares.verdict(joint.name, logs)
            # What friction explains is no fault of gravity, which is alike both ways.
            residual = shares.unexplained

        rms_of_one = joint_rows.rms(residual)
        rms_of_each = friction.joints[joint.name].rmse
        if rms_of_one <= settings.max_left * rms_of_each:
            continue
        unit = joint.unit("N m")
        reason = (
            f"one gravity for all postures leaves {rms_of_one:.3g} {unit},"
            f" {rms_of_one / rms_of_each:.2g} times what a gravity of its own in each"
            f" does ({rms_of_each:.3g} {unit}):"
            " geometry, zeros or gravity's direction in the robot file are not the"
            " arm's, or the load was another in some trials"
        )
        of_gravity.append(
            Verdict(joint=joint.name, good=False, level="usable", reason=reason)
        )
    return JudgedJoints(
        gravity=of_gravity, friction=of_friction, changed_friction=changed
    )


def _result(
    solution: Solution,
    rows: GravityRows,
    prior: Prior,
    friction: FrictionStage,
    judged_joints: JudgedJoints,
) -> GravityResult:
    """Return the stage with its verdicts, and friction with what its trials show."""
    robot = rows.robot
    size = rows.size
    settings = rows.settings.fit
    joint_posterior = _posterior(solution, rows, prior)
    parameters = solution.first(size)
    stage = rigid_stage(
        robot,
        rows.held.basis,
        parameters,
        joint_posterior.first(size),
        np.arange(size),
        np.zeros(robot.n),
    )

    drives = _handed_on(solution, joint_posterior, rows, friction)
    used = np.concatenate([np.flatnonzero(parameters.determined), size + drives.places])
    covariance = joint_posterior.covariance[np.ix_(used, used)]
    friction_sizes = robot_friction_rms(rows.surfaces, robot)

    notes = [f"{note}. {LOCK_REMEDY}" for note in stage.notes]
    if rows.skipped_joints:
        names = ", ".join(rows.skipped_joints)
        notes.append(f"trials without a friction surface left out: {names}")
    shows_gravity = [
        abs(p.value) >= settings.shown_sigma * p.uncertainty for p in stage.parameters
    ]
    if not any(shows_gravity):
        notes.append(NO_GRAVITY)
    notes += [described(term) for term in shown(drives.terms, friction_sizes)]

    good = not stage.not_excited and solution.condition < settings.max_condition
    reason = f"rank {solution.rank} of {size}, condition {solution.condition:.3g}"
    stage = replace_fields(
        stage,
        structural_rank=size,
        verdicts=[*judged_joints.gravity, Verdict(good=good, reason=reason)],
        notes=notes,
        nuisances=drives.terms,
        nuisance_covariance=covariance.tolist(),
    )
    return GravityResult(stage, _with_changes(drives.friction, judged_joints))


def _posterior(solution: Solution, rows: GravityRows, prior: Prior) -> Posterior:
    """Return the covariance of all unknowns, with all that is not known better."""
    unseen = [
        solution.bread @ crossed / solution.sigma[j] ** 2 for j, crossed in rows.unseen
    ]
    posterior = Posterior.of(
        solution,
        rows.surfaces,
        rows.robot.torque_constant_errors,
        rows.sensitivity(solution),
        computed=_by_prior(solution, prior, rows.robot.n),
        prior=prior,
    ).with_error(np.reshape(unseen, (-1, rows.columns)).T)
    return replace(posterior, tolerances=rows.tolerance_moves(solution))


def _by_prior(solution: Solution, prior: Prior, joints: int) -> dict[int, Array]:
    """Return minus the part (q,) of the solution by each joint's prior centre.

    A prior's centre is an offset that was measured: it scales with the torque as the
    rows do.
    """
    moves = {}
    for j in range(joints):
        rows = np.arange(j, len(prior.b), joints)
        moves[j] = -solution.bread @ prior.A[rows].T @ prior.b[rows]
    return moves


def _with_changes(
    friction: FrictionStage, judged_joints: JudgedJoints
) -> FrictionStage:
    """Return friction as uncertain as it differs between logs, and judged by that."""
    if not judged_joints.friction:
        return friction
    joints = dict(friction.joints)
    for name, shares in judged_joints.changed_friction.items():
        joints[name] = shares.widened(joints[name])

    verdicts = []
    for verdict in friction.verdicts:
        if verdict.level == "good":
            verdict = judged_joints.friction.get(verdict.joint, verdict)
        verdicts.append(verdict)
    return replace_fields(friction, joints=joints, verdicts=as_a_whole(verdicts))


@dataclass(frozen=True, kw_only=True)
class HandedOn:
    """Friction with the drives' terms as gravity's trials show them, for a file.

    `places` (m,): where `terms`, those alike both ways, stand behind the parameters.
    """

    friction: FrictionStage
    terms: list[Nuisance]
    places: Index


def _handed_on(
    solution: Solution, posterior: Posterior, rows: GravityRows, friction: FrictionStage
) -> HandedOn:
    """Return friction with the drives' terms as gravity's trials show them."""
    n = rows.robot.n
    covariance = posterior.beside_tolerances
    joints = dict(friction.joints)
    terms: list[Nuisance] = []
    all_places: list[int] = []
    for j, name in enumerate(rows.robot.joint_names):
        surface = rows.surfaces[j]
        if surface is None or j not in rows.cross:
            continue
        places = [k * n + j for k in range(EVEN_TERMS)]
        columns = [rows.size + place for place in places]
        places_of_terms = dict(zip(EVEN_NAMES, columns, strict=True))
        if rows.thermal[j] is not None:
            places_of_terms["thermal"] = rows.size + EVEN_TERMS * n + j
        joint = with_drive_terms(
            joints[name],
            name,
            surface,
            theta=solution.theta,
            covariance=covariance,
            places=places_of_terms,
        )
        joints[name] = joint
        terms += [term for term in joint.nuisances if term.name in EVEN_NAMES]
        all_places += places
    return HandedOn(
        friction=replace_fields(friction, joints=joints),
        terms=terms,
        places=np.array(all_places, dtype=np.intp),
    )
