"""Inertia stage (Sec. 2.2.4, Eq. 22-26): what gravity left open, by moves of joints.

Rotor inertias are parameters of their own, acting on their own joint alone (Eq. 43);
the data are asked whether the gyroscopic coupling to the link that carries one is there
too (`rotor_coupling`).
"""

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import msgspec
import numpy as np

from seqid_cli.errors import InputError, QualityError, UsageError
from seqid_cli.identify.bands.calibrate import calibrate
from seqid_cli.identify.bands.left_out import Fit
from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.nuisances import (
    DRIVE_NAMES,
    described,
    robot_friction_rms,
    shown,
    with_drive_terms,
)
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.equations import (
    cutoff_note,
    source_text,
    streams,
)
from seqid_cli.identify.regression.least_squares import Accumulator, Solution
from seqid_cli.identify.regression.noise_level import noise_of_rows
from seqid_cli.identify.rigid import parameters
from seqid_cli.identify.rigid.cutoff_check import cutoff_check, with_cutoff_check
from seqid_cli.identify.rigid.inertia_equations import (
    InertiaEquations,
    tolerance_moves,
)
from seqid_cli.identify.rigid.inertia_rows import InertiaRows
from seqid_cli.identify.rigid.log_agreement import (
    FEW_LOGS,
    agreement_verdicts,
    log_equations,
)
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.rigid.rotor_coupling import decide
from seqid_cli.logs import long as long_logs
from seqid_cli.logs.long import LongLog
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import NOISE_BANDWIDTH
from seqid_cli.params.schema import FrictionStage, Nuisance, RigidStage, Stages, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True)
class InertiaResult:
    """The inertia stage, and friction with the delays and offsets its logs show."""

    inertia: RigidStage
    friction: FrictionStage


@dataclass(frozen=True, kw_only=True)
class LogRows:
    """Rows of one log or of several, as used and otherwise filtered.

    `neighbours` are rows at multiples of the cut-off, by the multiple; `by_encoders`
    those of the encoders' motion where IMUs take part in the other.
    """

    used: InertiaRows
    neighbours: dict[float, InertiaRows]
    by_encoders: InertiaRows | None = None

    def __add__(self, other: "LogRows") -> "LogRows":
        neighbours = dict(self.neighbours)
        for multiple, rows in other.neighbours.items():
            present = neighbours.get(multiple)
            neighbours[multiple] = rows if present is None else present + rows
        by_encoders = self.by_encoders
        if by_encoders is None:
            by_encoders = other.by_encoders
        elif other.by_encoders is not None:
            by_encoders = by_encoders + other.by_encoders
        return LogRows(
            used=self.used + other.used,
            neighbours=neighbours,
            by_encoders=by_encoders,
        )


@dataclass(frozen=True, kw_only=True)
class LogFactors:
    """What tells one log from the others: its name, and factors of joints' rows."""

    log: str
    joints: list[Accumulator]

    @classmethod
    def of(cls, rows: InertiaRows) -> "LogFactors":
        """Take those of the rows of one log."""
        return cls(log=rows.uses[0].log, joints=rows.joints)

    def joined(self) -> "LogFactors":
        """Return the same with one factor for all blocks of a joint."""
        return replace(self, joints=[joint.joined() for joint in self.joints])


def identify_inertia(
    recordings: Iterable[Recording | LongLog],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    compare: bool = False,
) -> InertiaResult:
    """Identify the base parameters that gravity does not show.

    Parameters
    ----------
    recordings : iterable of Recording or LongLog
        Moves of two joints or more at a time; a `LogSet` is read log by log.
    robot : Robot
    stages : Stages
        With friction; with gravity where it loads a joint; with imu to use IMUs.
    options : InertiaOptions
        Cut-off, neighbouring cut-offs, whose motion counts.
    compare : bool
        Whether to solve a second time with the encoders alone, for their standard
        errors.

    Raises
    ------
    UsageError
        Without a friction stage.
    QualityError
        Where no joint with known friction moves.
    """
    if stages.friction is None:
        raise UsageError(
            "inertia needs the friction stage", hint="run seqid friction first"
        )
    equations = InertiaEquations(robot, stages, options)
    by_encoders = _encoder_equations(equations) if compare else None

    # whoever reduces the logs does not look inside
    logs = cast("Iterable[Recording]", recordings)
    can_stream = by_encoders is None and streams(stages, options)
    pass_over_from = long_logs.LONG if can_stream else None
    rows_of_log = partial(_rows_of_log, equations, by_encoders)
    # Added up as they come: the rows of all logs side by side would take most memory.
    together: LogRows | None = None
    each_log: list[LogFactors] = []
    for log_rows in mapped(logs, rows_of_log, pass_over_from):
        together = log_rows if together is None else together + log_rows
        each_log.append(LogFactors.of(log_rows.used))
        if len(each_log) > FEW_LOGS:
            # Stretches of logs are compared where there are few of these.
            each_log = [factors.joined() for factors in each_log]
    if together is None or not any(joint.samples for joint in together.used.joints):
        raise QualityError("no joint with known friction moves in these logs")

    # In the order of the options, which that of the cut-offs' comparison is.
    neighbours = {
        multiple: together.neighbours[multiple]
        for multiple in options.neighbours
        if multiple in together.neighbours
    }
    result = _stage(equations, together.used, neighbours)
    stage = _with_agreement(result.inertia, equations, together.used, each_log)
    uses_imus = any(use.source != "encoder" for use in stage.motion_use)
    if by_encoders is not None and together.by_encoders is not None and uses_imus:
        encoder_stage = _stage(by_encoders, together.by_encoders, {}).inertia
        stage = _with_encoder_errors(stage, encoder_stage)
    return InertiaResult(stage, result.friction)


def _encoder_equations(equations: InertiaEquations) -> InertiaEquations | None:
    """Return the same equations by encoders alone, None if they are that already."""
    options = equations.options
    if equations.stages.imu is None or options.source == "encoder":
        return None
    motion = replace(
        options.motion, cutoff_hz=options.motion.encoder_hz or options.motion.cutoff_hz
    )
    encoder_options = replace(options, source="encoder", motion=motion)
    return InertiaEquations(equations.robot, equations.stages, encoder_options)


def _with_encoder_errors(stage: RigidStage, encoder_stage: RigidStage) -> RigidStage:
    """Add the standard errors that the encoders alone would have."""
    by_encoders = {
        p.name: p.std_error for p in encoder_stage.parameters if p.std_error is not None
    }
    ratios = [
        by_encoders[p.name] / max(p.std_error, 1e-300)
        for p in stage.parameters
        if p.name in by_encoders and p.std_error is not None
    ]
    notes = list(stage.notes)
    if ratios:
        notes.append(
            "by the encoders alone the standard errors would be"
            f" {np.median(ratios):.2g} times these (median)"
        )
    return msgspec.structs.replace(stage, encoder_std_errors=by_encoders, notes=notes)


def _with_agreement(
    stage: RigidStage,
    equations: InertiaEquations,
    together: InertiaRows,
    logs: Sequence[LogFactors],
) -> RigidStage:
    """Add verdicts on logs whose rigid body is not that of all of them `together`."""
    robot = equations.robot
    coupling = float(stage.rotor_coupling == "gyroscopic")
    joints_of_logs = [
        [joint.with_fixed(joint.size - 1, coupling) for joint in factors.joints]
        for factors in logs
    ]
    residual_rms = np.array(
        [stage.rmse.get(name, np.inf) for name in robot.joint_names]
    )
    verdicts = agreement_verdicts(
        log_equations([factors.log for factors in logs], joints_of_logs),
        robot,
        residual_rms,
        together.torque_squares,
        equations.basis.size,
        equations.options.settings.agreement,
        independent=together.independent,
    )
    return msgspec.structs.replace(stage, verdicts=[*stage.verdicts, *verdicts])


def _rows_of_log(
    equations: InertiaEquations,
    by_encoders: InertiaEquations | None,
    log: Recording | LongLog,
    _: int,
) -> LogRows:
    """Reduce one log's equations, and those by its encoders where they are wanted."""
    used = equations.rows_of(log)
    neighbours: dict[float, InertiaRows] = {}
    if isinstance(log, Recording):
        for multiple in equations.options.neighbours:
            # The log may be too short or too slow for another cut-off.
            with contextlib.suppress(InputError):
                cutoff_hz = used.uses[0].cutoff_hz * multiple
                neighbours[multiple] = equations.at_cutoff(cutoff_hz).rows_of(log)
    return LogRows(
        used=used,
        neighbours=neighbours,
        by_encoders=by_encoders.rows_of(log) if by_encoders else None,
    )


def _stage(
    equations: InertiaEquations,
    rows: InertiaRows,
    neighbours: Mapping[float, InertiaRows],
) -> InertiaResult:
    """Solve, decide on the rotor coupling, and describe.

    `neighbours` are rows at other cut-offs, by multiples of the one in use.
    """
    basis = equations.basis
    settings = equations.options.settings

    coupling = decide(equations, [rows, *neighbours.values()], settings.rotors)
    share = float(coupling.used)
    solution, posterior = equations.solved(rows, share)
    posterior = posterior.with_error(coupling.directions)
    at_neighbours = {
        multiple: equations.solved(neighbour_rows, share)
        for multiple, neighbour_rows in neighbours.items()
    }
    by_cutoff = cutoff_check(
        (solution, posterior), at_neighbours, equations.surfaces, settings.cutoff_check
    )
    by_imus = _imu_moves(equations, rows, solution)
    posterior = posterior.with_error(by_cutoff.directions).with_error(by_imus)
    tolerances = tolerance_moves(equations, rows, solution)
    posterior = replace(posterior, tolerances=tolerances)

    stage = _described(
        equations, rows, solution.first(basis.size), posterior.first(basis.size)
    )
    good_joints = {
        verdict.joint for verdict in stage.verdicts if verdict.joint and verdict.good
    }
    drives = _drive_terms(equations, rows, solution, posterior, good_joints)
    verdicts = list(stage.verdicts)
    if coupling.contradicted:
        verdicts.append(
            Verdict(good=False, level="usable", reason=coupling.contradicted)
        )
    stage = msgspec.structs.replace(
        stage,
        nuisances=drives.terms,
        nuisance_covariance=drives.covariance.tolist(),
        rotor_coupling="gyroscopic" if coupling.used else "diagonal",
        verdicts=verdicts,
        notes=[*stage.notes, *drives.notes, *coupling.notes],
    )
    stage = with_cutoff_check(
        stage, by_cutoff.differences, basis, settings.cutoff_check
    )
    model = msgspec.structs.replace(
        equations.stages, friction=drives.friction, inertia=stage
    )
    stage = _with_bands(equations, rows, model, stage, solution, share)
    return InertiaResult(stage, drives.friction)


def _imu_moves(
    equations: InertiaEquations, rows: InertiaRows, solution: Solution
) -> Array:
    """Return moves of the unknowns (p, k) per standard error of each IMU's scale."""
    basis = equations.basis
    stages = equations.stages
    imus = stages.imu.imus if stages.imu else {}
    used = {name for use in rows.uses for name in use.imus}
    std_errors = {
        name: imus[name].acceleration_std_error or 0.0 for name in used if imus
    }
    theta = solution.theta[: basis.size]
    # Gravity has been identified without IMUs.
    inertia = np.where(basis.gravity & bool(stages.gravity), 0.0, theta)
    moves = parameters.imu_moves(
        equations.robot, basis, inertia, equations.reflected, std_errors
    )
    return np.pad(moves, ((0, equations.nuisances.count), (0, 0)))


def _with_bands(
    equations: InertiaEquations,
    rows: InertiaRows,
    model: Stages,
    stage: RigidStage,
    solution: Solution,
    coupling: float,
) -> RigidStage:
    """Add the bands of predicted torques.

    The last column is the share of rotor coupling, held.
    """
    fit = Fit(
        theta=np.append(solution.theta, coupling),
        bread=np.pad(solution.bread, ((0, 1), (0, 1))),
        sigma=solution.sigma,
        independent=rows.independent,
    )
    cutoff_hz = stage.cutoff_hz or 0.0
    bands = calibrate(rows.band_rows, fit, model, equations.robot, cutoff_hz=cutoff_hz)
    return msgspec.structs.replace(stage, bands=bands)


@dataclass(frozen=True, kw_only=True)
class DriveTerms:
    """Nuisance terms of the joints that moved, their notes, and friction with them.

    `covariance` is that of the stage's determined parameters, then of the terms.
    """

    terms: list[Nuisance]
    covariance: Array
    notes: list[str]
    friction: FrictionStage


def _drive_terms(
    equations: InertiaEquations,
    rows: InertiaRows,
    solution: Solution,
    posterior: Posterior,
    good_joints: Collection[str],
) -> DriveTerms:
    """Describe the terms of the drives, and put them into the friction stage.

    They are believed at `good_joints`, of which noise alone is left. Elsewhere they
    take what else the model lacks: there they are marginalised, and friction stays as
    it came. A delay goes into the file all the same. The parameters were found beside
    it, and with that of the friction trials, which know it to milliseconds, they would
    leave a lag in every fast motion.
    """
    robot = equations.robot
    basis = equations.basis
    columns = equations.nuisances
    term_covariance = posterior.beside_tolerances
    friction = equations.stages.friction
    assert friction is not None
    joints = dict(friction.joints)
    gravity = equations.stages.gravity
    of_gravity = {p.name for p in gravity.parameters} if gravity else set()
    places = [
        k
        for k in range(basis.size)
        if solution.determined[k] and basis.names[k] not in of_gravity
    ]
    terms: list[Nuisance] = []
    for j, name in enumerate(robot.joint_names):
        surface = equations.surfaces[j]
        if surface is None or not rows.joints[j].samples:
            continue
        told = DRIVE_NAMES if name in good_joints else ("delay",)
        joints[name] = with_drive_terms(
            joints[name],
            name,
            surface,
            theta=solution.theta,
            covariance=term_covariance,
            places={term: columns.of(term, j) for term in told},
        )
        by_name = {term.name: term for term in joints[name].nuisances}
        terms += [by_name[term] for term in DRIVE_NAMES if term in by_name]
        places += [columns.of(term, j) for term in DRIVE_NAMES if term in by_name]

    sizes = robot_friction_rms(equations.surfaces, robot)
    return DriveTerms(
        terms=terms,
        covariance=posterior.covariance[np.ix_(places, places)],
        notes=[
            described(term) for term in shown(terms, sizes) if term.joint in good_joints
        ],
        friction=msgspec.structs.replace(friction, joints=joints),
    )


def _described(
    equations: InertiaEquations,
    rows: InertiaRows,
    solution: Solution,
    posterior: Posterior,
) -> RigidStage:
    """Return the stage, with the parameters that the gravity stage does not have."""
    settings = equations.options.settings.residual
    robot = equations.robot
    basis = equations.basis
    gravity = equations.stages.gravity
    of_gravity = {p.name for p in gravity.parameters} if gravity else set()
    new_parameters = np.array(
        [k for k in range(basis.size) if basis.names[k] not in of_gravity], dtype=int
    )
    stage = parameters.rigid_stage(
        robot, basis, solution, posterior, new_parameters, equations.rotors
    )
    pairs = (
        parameters.missing_pairs(robot, basis, solution.left_open)
        if stage.not_excited
        else []
    )
    cutoff = float(np.median([use.cutoff_hz for use in rows.uses]))
    notes = [cutoff_note(rows.uses, equations.options.motion), *stage.notes]
    if pairs:
        text = ", ".join(" + ".join(pair) for pair in pairs)
        notes.append(
            f"moving these joints together as well would give full rank: {text}"
        )
    idle = "does not move in these logs, or its friction is not known"
    floor = noise_of_rows(
        stage,
        robot,
        uses=rows.uses,
        logs=rows.noise,
        joints=rows.joints,
        torque_squares=rows.torque_squares,
        friction=_friction_error(equations, rows),
    )
    verdicts = parameters.joint_verdicts(
        robot,
        solution,
        rows.joints,
        rows.torque_squares,
        floor,
        poor_share=settings.poor_share,
        max_of_noise=settings.max_of_noise,
        idle=idle,
    )
    good = solution.rank == basis.size and solution.condition < settings.max_condition
    reason = f"rank {solution.rank} of {basis.size}, condition {solution.condition:.3g}"
    # N m/sqrt(Hz) of each joint as the parameters feel it, slow noise included.
    noise = np.sqrt(solution.designs / NOISE_BANDWIDTH / cutoff) * solution.sigma
    moved = {robot.joint_names[j]: j for j in range(robot.n) if rows.joints[j].samples}
    return msgspec.structs.replace(
        stage,
        rmse={name: float(solution.sigma[j]) for name, j in moved.items()},
        noise_density={name: float(noise[j]) for name, j in moved.items()},
        noise_floor={
            name: float(floor.rms[j]) for name, j in moved.items() if floor.rms[j]
        },
        noise_floor_high={
            name: float(floor.high[j]) for name, j in moved.items() if floor.high[j]
        },
        motion={use.log: source_text(use) for use in rows.uses},
        motion_use=rows.uses,
        missing_pairs=pairs,
        cutoff_hz=cutoff,
        verdicts=[*verdicts, Verdict(good=good, reason=reason)],
        notes=notes,
    )


def _friction_error(equations: InertiaEquations, rows: InertiaRows) -> Array:
    """Return the RMS error (n,) N m that friction is known to have in the used rows."""
    errors = np.zeros(equations.robot.n)
    friction = equations.stages.friction
    assert friction is not None
    for j, surface in enumerate(equations.surfaces):
        if surface is None or not rows.states:
            continue
        q = np.concatenate([states.q[states.used[:, j], j] for states in rows.states])
        v = np.concatenate([states.dq[states.used[:, j], j] for states in rows.states])
        if not len(q):
            continue
        # By its standard error, or by what it leaves of speeds that it was not fitted
        # to.
        stated = float(np.sqrt(np.mean(surface.std_error(q, v) ** 2)))
        held_out = friction.joints[equations.robot.joint_names[j]].held_out_rmse
        errors[j] = max(stated, held_out or 0.0)
    return errors
