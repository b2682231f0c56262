"""Inertia stage (Sec. 2.2.4, Eq. 22-26): what gravity left open, from moves of few joints.

Rotor inertias are parameters of their own, acting on their own joint alone (Eq. 43); the data are
asked whether the gyroscopic coupling to the link that carries the rotor is there too (see
`rotor_coupling`).
"""

import contextlib
import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import msgspec
import numpy as np

from seqid_cli.errors import InputError, QualityError, UsageError
from seqid_cli.identify.log_set import reduced
from seqid_cli.identify.motion_use import source_text
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.equations import cutoff_note
from seqid_cli.identify.regression.least_squares import Accumulator, Solution
from seqid_cli.identify.regression.streaming import open_if_long, streams
from seqid_cli.identify.rigid.cutoff_check import cutoff_check, with_cutoff_check
from seqid_cli.identify.rigid.excitation import missing_pairs
from seqid_cli.identify.rigid.inertia_equations import InertiaEquations, InertiaRows
from seqid_cli.identify.rigid.parameters import residual_share, rigid_stage
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.rigid.rotor_coupling import Coupling, decide
from seqid_cli.identify.tree import or_none
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.motion.filters.bandwidth import NOISE_BANDWIDTH
from seqid_cli.params.schema import RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot


def identify_inertia(
    recordings: Iterable[Recording | SurveyedLog],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    compare: bool = False,
) -> RigidStage:
    """Identify the base parameters that gravity does not show.

    Parameters
    ----------
    recordings : iterable of Recording or SurveyedLog
        Logs with torque in which one, two or more joints move, held or to be passed over.
    robot : Robot
        Chain, gravity, gear ratios, known rotor inertias.
    stages : Stages
        With friction; with gravity where gravity loads the arm; with imu to use accelerometers.
    compare : bool
        Whether to do it a second time with the encoders alone, for their standard errors.

    Returns
    -------
    RigidStage
        Parameters in kg m^2 (others where gravity leaves them open), with a verdict per joint.

    Raises
    ------
    UsageError
        If the friction stage is missing.
    QualityError
        If no joint moves.
    """
    if stages.friction is None:
        raise UsageError("inertia needs the friction stage", hint="run seqid friction first")
    basis = free_basis(robot)
    equations = InertiaEquations(robot, basis, stages, options)
    compare = compare and stages.imu is not None and options.source != "encoder"
    alone = replace(options.motion, cutoff_hz=options.motion.encoder_hz or options.motion.cutoff_hz)
    by_encoder = replace(options, source="encoder", motion=alone)
    others = InertiaEquations(robot, basis, stages, by_encoder) if compare else None
    logs = cast("Iterable[Recording]", recordings)  # whoever reduces them does not look inside
    whole = reduced(logs, InertiaRowsOf(equations, others), _all)
    if whole is None or not any(joint.samples for joint in whole.own.joints):
        raise QualityError("no joint with known friction moves in these logs")
    near = {
        factor: equations.with_rows(rows)
        for factor, rows in zip(options.neighbours, whole.near, strict=True)
        if rows is not None
    }
    stage = _stage(equations.with_rows(whole.own), near)
    if others and whole.encoder and any(use.source != "encoder" for use in stage.motion_use):
        stage = _compared(stage, _stage(others.with_rows(whole.encoder), {}))
    return stage


def _compared(stage: RigidStage, encoders: RigidStage) -> RigidStage:
    """The stage with the standard errors that encoders alone would have left."""
    before = {p.name: p.std_error for p in encoders.parameters}
    both = [(before[p.name], p.std_error) for p in stage.parameters if p.name in before]
    ratio = [encoder / max(used, 1e-300) for encoder, used in both]
    note = ""
    if ratio:
        times = f"{np.median(ratio):.2g} times these"
        note = f"by the encoders alone the standard errors would be {times} (median)"
    return msgspec.structs.replace(
        stage, encoder_std_errors=before, notes=[*stage.notes, *([note] if note else [])]
    )


@dataclass(frozen=True)
class AllRows:
    """Rows as they are used, at neighbouring cut-offs, and by the encoders alone."""

    own: InertiaRows
    near: tuple[InertiaRows | None, ...]
    encoder: InertiaRows | None


@dataclass(frozen=True)
class InertiaRowsOf:
    """The reduced equations of one log, and those by its encoders alone where they are asked for.

    Both equations must be without rows; they carry what was worked out once for all logs.
    """

    equations: InertiaEquations
    others: InertiaEquations | None

    def open_log(self, path: Path, robot: Robot, time_source: TimeSource) -> SurveyedLog | None:
        """Open a log that is better passed over than read; None for others."""
        if self.others is not None or not streams(self.equations.stages, self.equations.options):
            return None
        return open_if_long(path, robot, time_source=time_source)

    def __call__(self, recording: Recording | SurveyedLog, number: int) -> AllRows:
        """Reduce them."""
        del number
        own = self.equations.rows_of(recording)
        factors = self.equations.options.neighbours
        near: tuple[InertiaRows | None, ...] = (None,) * len(factors)
        if isinstance(recording, Recording):
            near = tuple(self._near(recording, own.cutoffs[0] * factor) for factor in factors)
        return AllRows(own, near, self.others.rows_of(recording) if self.others else None)

    def _near(self, recording: Recording, cutoff_hz: float) -> InertiaRows | None:
        """Rows at another cut-off; None where the log is too short or too slow for it."""
        with contextlib.suppress(InputError):
            return self.equations.at_cutoff(cutoff_hz).rows_of(recording)
        return None


def _all(first: AllRows, second: AllRows) -> AllRows:
    near = zip(first.near, second.near, strict=True)
    return AllRows(
        first.own + second.own,
        tuple(_both(*pair) for pair in near),
        _both(first.encoder, second.encoder),
    )


_both = or_none(operator.add)


def _stage(equations: InertiaEquations, near: Mapping[float, InertiaEquations]) -> RigidStage:
    """Solve, decide on the rotor coupling, and describe the result."""
    # `near` holds the rows at multiples of the cut-off, to see what depends on it.
    nothing = Coupling.none(equations.basis.size)
    coupling = decide([equations, *near.values()]) if equations.rotors.any() else nothing
    fixed = equations.with_coupling(float(coupling.used))
    solution, posterior = equations.solved(fixed)
    posterior = posterior.with_error(coupling.errors)
    there = {
        factor: other.solved(other.with_coupling(float(coupling.used)))
        for factor, other in near.items()
    }
    check = cutoff_check((solution, posterior), there, equations.surfaces)
    posterior = posterior.with_error(check.errors).with_error(equations.imu_moves(solution.theta))
    stage = _described(equations, solution, posterior, fixed, coupling)
    return with_cutoff_check(stage, check, equations.basis)


def _described(
    equations: InertiaEquations,
    solution: Solution,
    posterior: Posterior,
    joints: list[Accumulator],
    coupling: Coupling,
) -> RigidStage:
    """The stage, with the parameters that the gravity stage does not have."""
    robot, basis, gravity = equations.robot, equations.basis, equations.stages.gravity
    known = {p.name for p in gravity.parameters} if gravity else set()
    own = np.array([k for k in range(basis.size) if basis.names[k] not in known], dtype=int)
    stage = rigid_stage(robot, basis, solution, posterior, own, equations.rotors)
    missing = stage.not_excited
    pairs = missing_pairs(robot, basis, solution.left_open) if missing else []
    # Say which parameters the logs leave open, and which moves would determine them.
    notes = ["not excited by these logs: " + "; ".join(missing)] if missing else []
    if pairs:
        text = ", ".join(" + ".join(pair) for pair in pairs)
        notes.append(f"moving these joints together as well would give full rank: {text}")
    return msgspec.structs.replace(
        stage,
        rmse={
            name: float(solution.sigma[j])
            for j, name in enumerate(robot.joint_names)
            if joints[j].samples
        },
        noise_density=_noise_density(equations, solution),
        rotor_coupling="gyroscopic" if coupling.used else "diagonal",
        motion={use.log: source_text(use) for use in equations.rows.uses},
        motion_use=equations.rows.uses,
        missing_pairs=pairs,
        cutoff_hz=float(np.median(equations.rows.cutoffs)),
        verdicts=_verdicts(equations, solution, joints),
        notes=[
            cutoff_note(equations.rows.cutoffs, equations.options.motion),
            *notes,
            *coupling.notes,
        ],
    )


def _noise_density(equations: InertiaEquations, solution: Solution) -> dict[str, float]:
    """Noise N m/sqrt(Hz) of each joint as the parameters feel it, slow noise included."""
    white = solution.sigma**2 / (NOISE_BANDWIDTH * np.median(equations.rows.cutoffs))
    return {
        name: float(np.sqrt(solution.designs[j] * white[j]))
        for j, name in enumerate(equations.robot.joint_names)
        if equations.joints[j].samples
    }


def _verdicts(
    equations: InertiaEquations,
    solution: Solution,
    joints: list[Accumulator],
    *,
    poor_share: float = 0.15,
    poor_condition: float = 1000.0,
) -> list[Verdict]:
    """A verdict for each joint, and one for all parameters."""
    # A joint is poor where more than `poor_share` of its torque's RMS is left, the parameters where
    # the condition number of their scaled equations is `poor_condition` or more.
    verdicts = []
    for j, name in enumerate(equations.robot.joint_names):
        if not joints[j].samples:
            reason = "does not move in these logs, or its friction is not known"
            verdicts.append(Verdict(joint=name, good=False, reason=reason))
            continue
        left = float(solution.sigma[j]), float(equations.rows.torque_squares[j]), joints[j].samples
        share, reason = residual_share(*left)
        verdicts.append(Verdict(joint=name, good=share < poor_share, reason=reason))
    size = equations.basis.size
    good = solution.rank == size and solution.condition < poor_condition
    reason = f"rank {solution.rank} of {size}, condition {solution.condition:.3g}"
    return [*verdicts, Verdict(good=good, reason=reason)]
