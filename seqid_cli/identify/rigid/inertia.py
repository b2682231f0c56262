"""Inertia stage (Sec. 2.2.4, Eq. 22-26): what gravity left open, from moves of few joints.

Rotor inertias are parameters of their own, acting on their own joint alone (Eq. 43);
the data are asked whether the gyroscopic coupling to the link that carries one is there
too (`rotor_coupling`).
"""

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import NamedTuple, cast

import msgspec
import numpy as np

from seqid_cli.errors import InputError, QualityError, UsageError
from seqid_cli.identify.bands.calibrate import calibrate
from seqid_cli.identify.bands.left_out import Fit
from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.nuisances import (
    DRIVE_NAMES,
    EVEN_NAMES,
    EvenPart,
    described,
    friction_rms,
    robot_friction_rms,
    shown,
    term_of,
    with_even_part,
    with_term,
)
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.equations import (
    cutoff_note,
    open_if_long,
    source_text,
    streams,
)
from seqid_cli.identify.regression.least_squares import Solution
from seqid_cli.identify.regression.noise_level import noise_of_rows
from seqid_cli.identify.rigid import parameters
from seqid_cli.identify.rigid.cutoff_check import cutoff_check, with_cutoff_check
from seqid_cli.identify.rigid.inertia_equations import (
    InertiaEquations,
    InertiaRows,
    tolerance_moves,
)
from seqid_cli.identify.rigid.log_agreement import agreement_verdicts, log_equations
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.rigid.rotor_coupling import decide
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.motion.filters.bandwidth import NOISE_BANDWIDTH
from seqid_cli.params.schema import FrictionStage, Nuisance, RigidStage, Stages, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# as used, at neighbouring cut-offs, by the encoders
AllRows = tuple[InertiaRows | None, ...]


@dataclass(frozen=True)
class InertiaResult:
    """The inertia stage, and friction with the delays and offsets that its logs show."""

    inertia: RigidStage
    friction: FrictionStage


def identify_inertia(
    recordings: Iterable[Recording | SurveyedLog],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    compare: bool = False,
) -> InertiaResult:
    """Identify the base parameters that gravity does not show."""
    # With `compare` a second time with the encoders alone, for their standard errors.
    if stages.friction is None:
        raise UsageError(
            "inertia needs the friction stage", hint="run seqid friction first"
        )
    equations, others = InertiaEquations(robot, stages, options), None
    if compare and stages.imu is not None and options.source != "encoder":
        hz = options.motion.encoder_hz or options.motion.cutoff_hz
        motion = replace(options.motion, cutoff_hz=hz)
        others = InertiaEquations(
            robot, stages, replace(options, source="encoder", motion=motion)
        )
    # whoever reduces them does not look inside
    logs = cast("Iterable[Recording]", recordings)
    opens = open_if_long if others is None and streams(stages, options) else None
    none: AllRows = (None,) * (2 + len(options.neighbours))
    parts = list(mapped(logs, partial(_rows_of, equations, others), opens))
    own, *near, encoder = reduce(_all, parts, none)
    if own is None or not any(joint.samples for joint in own.joints):
        raise QualityError("no joint with known friction moves in these logs")
    known = zip(options.neighbours, near, strict=True)
    result = _stage(
        equations, own, {factor: rows for factor, rows in known if rows is not None}
    )
    by_log = [rows for rows, *_ in parts if rows is not None]
    stage = _with_agreement(result.inertia, equations, own, by_log)
    if not (
        others and encoder and any(use.source != "encoder" for use in stage.motion_use)
    ):
        return InertiaResult(stage, result.friction)
    before = {
        p.name: p.std_error for p in _stage(others, encoder, {}).inertia.parameters
    }
    there = [p for p in stage.parameters if p.name in before]
    ratios = [before[p.name] / max(p.std_error, 1e-300) for p in there]
    notes = list(stage.notes)
    if ratios:
        times = f"{np.median(ratios):.2g} times these"
        notes.append(
            f"by the encoders alone the standard errors would be {times} (median)"
        )
    stage = msgspec.structs.replace(stage, encoder_std_errors=before, notes=notes)
    return InertiaResult(stage, result.friction)


def _with_agreement(
    stage: RigidStage,
    equations: InertiaEquations,
    together: InertiaRows,
    logs: Sequence[InertiaRows],
) -> RigidStage:
    """Add verdicts on logs whose rigid body is not that of all of them `together`."""
    robot, size = equations.robot, equations.basis.size
    coupling = float(stage.rotor_coupling == "gyroscopic")
    joints = [
        [j.with_fixed(j.size - 1, coupling) for j in rows.joints] for rows in logs
    ]
    found = agreement_verdicts(
        log_equations([rows.uses[0].log for rows in logs], joints),
        robot,
        np.array([stage.rmse.get(name, np.inf) for name in robot.joint_names]),
        together.torque_squares,
        size,
        equations.options.settings.agreement,
        independent=together.independent,
    )
    return msgspec.structs.replace(stage, verdicts=[*stage.verdicts, *found])


def _rows_of(
    used: InertiaEquations,
    others: InertiaEquations | None,
    log: Recording | SurveyedLog,
    _: int,
) -> AllRows:
    """Reduce the equations of one log, and those by its encoders where they are asked for."""
    own, factors = used.rows_of(log), used.options.neighbours
    near: list[InertiaRows | None] = [None] * len(factors)
    for k, factor in enumerate(factors if isinstance(log, Recording) else ()):
        with contextlib.suppress(InputError):  # the log is too short or too slow for it
            near[k] = used.at_cutoff(own.uses[0].cutoff_hz * factor).rows_of(log)
    return own, *near, others.rows_of(log) if others else None


def _all(first: AllRows, second: AllRows) -> AllRows:
    pairs = zip(first, second, strict=True)
    return tuple(a + b if a is not None and b is not None else a or b for a, b in pairs)


def _stage(
    equations: InertiaEquations, rows: InertiaRows, near: Mapping[float, InertiaRows]
) -> InertiaResult:
    """Solve, decide on the rotor coupling, and describe; `near` by multiples of the cut-off."""
    robot, basis, stages = equations.robot, equations.basis, equations.stages
    settings = equations.options.settings
    coupling = decide(equations, [rows, *near.values()], settings.rotors)
    share = float(coupling.used)
    solution, posterior = equations.solved(rows, share)
    posterior = posterior.with_error(coupling.directions)
    there = {factor: equations.solved(other, share) for factor, other in near.items()}
    by_cutoff, differences = cutoff_check(
        (solution, posterior), there, equations.surfaces, settings.cutoff_check
    )
    imus = stages.imu.imus if stages.imu else {}
    used = {name for use in rows.uses for name in use.imus}
    errors = {name: imus[name].acceleration_std_error or 0.0 for name in used if imus}
    theta = solution.theta[: basis.size]
    inertia = np.where(basis.gravity & bool(stages.gravity), 0.0, theta)
    moves = parameters.imu_moves(robot, basis, inertia, equations.reflected, errors)
    moves = np.pad(moves, ((0, equations.nuisances.count), (0, 0)))
    posterior = posterior.with_error(by_cutoff).with_error(moves)
    posterior = replace(
        posterior, tolerances=tolerance_moves(equations, rows, solution)
    )
    stage = _described(
        equations, rows, solution.first(basis.size), posterior.first(basis.size)
    )
    believed = {
        verdict.joint for verdict in stage.verdicts if verdict.joint and verdict.good
    }
    drives = _drive_terms(equations, rows, solution, posterior, believed)
    stage = msgspec.structs.replace(
        stage,
        nuisances=drives.terms,
        nuisance_covariance=drives.covariance.tolist(),
        notes=[*stage.notes, *drives.notes],
    )
    verdicts = list(stage.verdicts)
    if coupling.contradicted:
        verdicts.append(
            Verdict(good=False, level="usable", reason=coupling.contradicted)
        )
    stage = msgspec.structs.replace(
        stage,
        rotor_coupling="gyroscopic" if coupling.used else "diagonal",
        verdicts=verdicts,
        notes=[*stage.notes, *coupling.notes],
    )
    stage = with_cutoff_check(stage, differences, basis, settings.cutoff_check)
    model = msgspec.structs.replace(stages, friction=drives.friction, inertia=stage)
    stage = _with_bands(equations, rows, model, stage, solution, share)
    return InertiaResult(stage, drives.friction)


def _with_bands(
    equations: InertiaEquations,
    rows: InertiaRows,
    model: Stages,
    stage: RigidStage,
    solution: Solution,
    coupling: float,
) -> RigidStage:
    """Add the bands of predicted torques; the last column is the share of rotor coupling, held."""
    fit = Fit(
        theta=np.append(solution.theta, coupling),
        bread=np.pad(solution.bread, ((0, 1), (0, 1))),
        sigma=solution.sigma,
        independent=rows.independent,
    )
    cutoff_hz = stage.cutoff_hz or 0.0
    bands = calibrate(rows.band_rows, fit, model, equations.robot, cutoff_hz=cutoff_hz)
    return msgspec.structs.replace(stage, bands=bands)


class DriveTerms(NamedTuple):
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
    believed: Collection[str],
) -> DriveTerms:
    """Describe the terms of the drives, and put them into the friction stage.

    They are `believed` at joints of which noise alone is left: elsewhere they take what
    else the model lacks, a friction that has changed reads as a delay of ten
    milliseconds. There they are marginalised, and friction stays as it came.
    """
    robot, basis, columns = equations.robot, equations.basis, equations.nuisances
    friction = equations.stages.friction
    assert friction is not None
    joints = dict(friction.joints)
    # The delay's column is a jerk: where noise makes up too much of it, it is
    # marginalised alone.
    reads_delays = equations.options.motion.reads_delays
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
        delay = columns.of("delay", j)
        thermal = columns.of("thermal", j)
        even_places = [columns.of(term, j) for term in EVEN_NAMES]
        before = EvenPart.of_joint(joints[name], friction_rms(surface))
        even = EvenPart(
            values=before.values + solution.theta[even_places],
            covariance=posterior.covariance[np.ix_(even_places, even_places)],
        )
        joint = joints[name]
        stated = term_of(joint, "thermal")
        values = {
            "delay": float(solution.theta[delay]),
            "thermal": (
                float(solution.theta[thermal]) + (stated.value if stated else 0.0)
            ),
        }
        for place, (term, value) in zip((delay, thermal), values.items(), strict=True):
            if term == "delay" and not reads_delays:
                continue
            std_error = float(np.sqrt(posterior.covariance[place, place]))
            joint = with_term(joint, term, value, std_error)
        joints[name] = with_even_part(joint, name, even)
        if name not in believed:
            joints[name] = friction.joints[name]
        by_name = {term.name: term for term in joints[name].nuisances}
        terms += [by_name[term] for term in DRIVE_NAMES if term in by_name]
        places += [columns.of(term, j) for term in DRIVE_NAMES if term in by_name]

    sizes = robot_friction_rms(equations.surfaces, robot)
    return DriveTerms(
        terms=terms,
        covariance=posterior.covariance[np.ix_(places, places)],
        notes=[
            described(term)
            for term in shown(terms, sizes)
            if term.joint in believed and (reads_delays or term.name != "delay")
        ],
        friction=msgspec.structs.replace(friction, joints=joints),
    )


def _described(
    equations: InertiaEquations,
    rows: InertiaRows,
    solution: Solution,
    posterior: Posterior,
) -> RigidStage:
    """The stage, with the parameters that the gravity stage does not have."""
    settings = equations.options.settings.residual
    robot, basis, gravity = equations.robot, equations.basis, equations.stages.gravity
    known = {p.name for p in gravity.parameters} if gravity else set()
    own = np.array(
        [k for k in range(basis.size) if basis.names[k] not in known], dtype=int
    )
    stage = parameters.rigid_stage(
        robot, basis, solution, posterior, own, equations.rotors
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
