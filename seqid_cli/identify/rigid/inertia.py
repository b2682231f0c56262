"""Inertia stage (Sec. 2.2.4, Eq. 22-26): what gravity left open, from moves of few joints.

    tau - tau_f - H_g pi_g = H_r pi_r.

Friction is subtracted, gravity enters as a prior with the covariance of its stage, and both
uncertainties end up in the standard errors. Only joints that slide contribute rows: the torque of
a locked joint lies anywhere within its stiction. Rotor inertias are parameters of their own,
acting on their own joint alone (Eq. 43); whether the gyroscopic coupling to the link that carries
the rotor is there too is asked of the data (see `rotor_coupling`).
"""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import msgspec
import numpy as np

from seqid_cli.errors import InputError, QualityError, UsageError
from seqid_cli.identify.log_set import reduced
from seqid_cli.identify.motion_use import motion_use, source_text
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.equations import (
    blocks,
    cutoff_note,
)
from seqid_cli.identify.regression.grouped_blocks import GroupedBlocks
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
    whitened,
)
from seqid_cli.identify.regression.streaming import open_if_long, pass_over, streams
from seqid_cli.identify.rigid.cutoff_check import cutoff_check, with_cutoff_check
from seqid_cli.identify.rigid.excitation import missing_pairs
from seqid_cli.identify.rigid.parameters import (
    imu_moves,
    not_excited,
    parameters_of,
    representative_of,
)
from seqid_cli.identify.rigid.posterior import (
    Posterior,
    as_lists,
    as_matrices,
    constant_moves,
    moves_of,
    sensitivity_of,
)
from seqid_cli.identify.rigid.rotor_coupling import Coupling, decide
from seqid_cli.identify.tree import or_none
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.model.friction_samples import sampled_friction
from seqid_cli.model.torque import friction_surfaces, known_rotors
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.motion.motion import SAMPLES_PER_CUTOFF, Motion
from seqid_cli.params.schema import MotionUse, RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import (
    Basis,
    free_basis,
    gear_ratios,
    loaded_columns,
    standard_names,
)
from seqid_cli.robot.regressor import rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

POOR_CONDITION = 1000.0
ROUNDS = 6  # of reweighting: the weights settle to a thousandth of a standard error
POOR_SHARE = 0.15  # residual over torque RMS beyond which a joint's verdict is poor


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
    options : InertiaOptions
        Cut-off and source of the motion.
    compare : bool
        Whether to do it a second time with the encoders alone, for their standard errors.

    Returns
    -------
    RigidStage
        Parameters in kg m^2 (others where gravity could not tell them), with a verdict per joint.

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
    stage = equations.with_rows(whole.own).stage(near)
    if others and whole.encoder and any(use.source != "encoder" for use in stage.motion_use):
        stage = _compared(stage, others.with_rows(whole.encoder).stage({}))
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
class InertiaRows:
    """The equations of some logs, reduced: factors, sums and crossed sums per joint."""

    joints: list[Accumulator]
    torque_squares: Array
    cross: dict[int, Array]
    cutoffs: list[float]
    uses: list[MotionUse]
    counts: Array  # (2,): samples that count as independent, and all

    def __add__(self, other: InertiaRows) -> InertiaRows:
        """The equations of both, those of `other` behind."""
        cross = dict(self.cross)
        for j, crossed in other.cross.items():
            cross[j] = cross[j] + crossed if j in cross else crossed
        return InertiaRows(
            [a + b for a, b in zip(self.joints, other.joints, strict=True)],
            self.torque_squares + other.torque_squares,
            cross,
            self.cutoffs + other.cutoffs,
            self.uses + other.uses,
            self.counts + other.counts,
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


class InertiaEquations:
    """Accumulates the rows of all logs; the last column is the share of gyroscopic coupling."""

    def __init__(self, robot: Robot, basis: Basis, stages: Stages, options: InertiaOptions) -> None:
        self.robot, self.basis, self.stages, self.options = robot, basis, stages, options
        self.surfaces = friction_surfaces(stages, robot)
        self.slowest = slowest_speeds(self.surfaces)
        self.rotors = known_rotors(robot)
        scaled = robot.torque_constant_errors > 0.0
        self._rotor_torque = np.where(scaled, gear_ratios(robot) ** 2 * self.rotors, 0.0)
        coupling = np.full((robot.n, 1), bool(self.rotors.any()))
        self._loaded = np.hstack([loaded_columns(robot, basis), coupling])
        self._start()

    def _start(self) -> None:
        """Forget all rows."""
        self.joints = [Accumulator(self.basis.size + 1) for _ in range(self.robot.n)]
        self.torque_squares = np.zeros(self.robot.n)
        self.cutoffs: list[float] = []
        self.uses: list[MotionUse] = []
        self.counts = np.zeros(2)
        self._grouped = GroupedBlocks(self.joints, self._loaded)
        self._cross: dict[int, Array] = {}

    def rows_of(self, recording: Recording | SurveyedLog) -> InertiaRows:
        """The rows of one log alone; these equations stay as they are."""
        fresh = copy(self)
        fresh._start()
        fresh.add(recording)
        sums = fresh.joints, fresh.torque_squares, fresh._cross
        return InertiaRows(*sums, fresh.cutoffs, fresh.uses, fresh.counts)

    def at_cutoff(self, cutoff_hz: float) -> InertiaEquations:
        """The same equations, to take rows that are filtered at another cut-off."""
        other = copy(self)
        motion = replace(self.options.motion, cutoff_hz=cutoff_hz)
        other.options = replace(self.options, motion=motion)
        return other

    def with_rows(self, rows: InertiaRows) -> InertiaEquations:
        """The same equations with rows."""
        full = copy(self)
        full.joints, full.torque_squares, full._cross = rows.joints, rows.torque_squares, rows.cross
        full.cutoffs, full.uses, full.counts = rows.cutoffs, rows.uses, rows.counts
        return full

    def add(self, log: Recording | SurveyedLog) -> None:
        """Add the rows of one log."""
        motion = pass_over(log, self)
        self.cutoffs.append(motion.cutoff.hz)
        self.uses.append(motion_use(log.path, self.robot, motion))

    def right_side(self, motion: Motion) -> Array:
        """Torque without friction and known rotors, filtered alike (N, n) N m."""
        assert motion.tau is not None
        friction = sampled_friction(self.surfaces, motion)
        own = motion.tau - motion.filtered(friction, times=2)
        if self.rotors.any():
            own -= motion.filtered(gear_ratios(self.robot) ** 2 * self.rotors * motion.ddq)
        return own

    def coupling_column(self, motion: Motion) -> Array:
        """Torque (N, n) that known rotors add if they are coupled to the links that carry them."""
        if not self.rotors.any():
            return np.zeros_like(motion.q)
        gear = gear_ratios(self.robot)
        state = (self.robot.chain, motion.q, motion.dq, motion.ddq, gear)
        coupled = rotor_regressor(*state, "gyroscopic") - rotor_regressor(*state, "diagonal")
        return motion.filtered(coupled @ self.rotors)

    def add_chunk(self, motion: Motion, H: Array, y: Array, usable: Mask) -> None:
        """Add rows H (N, n, b + 1), y (N, n) of consecutive samples, where they are usable."""
        self.counts += motion.samples * np.array([motion.independent_share, 1.0])
        known = usable & np.array([surface is not None for surface in self.surfaces])
        ends = [block.stop for block in blocks(motion.samples, motion.rate_hz)]
        self._grouped.add((H, y, known), ends)
        every = max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))
        for j, surface in enumerate(self.surfaces):
            rows = usable[:, j]
            if surface is None or not rows.any():
                continue
            assert motion.tau is not None
            self.torque_squares[j] += float(np.sum(motion.tau[rows, j] ** 2))
            some = np.flatnonzero(rows)[::every]
            F = every * surface.columns(motion.q[some, j], motion.dq[some, j])
            if self._rotor_torque[j]:
                F = np.column_stack([F, every * self._rotor_torque[j] * motion.ddq[some, j]])
            crossed = self._cross.get(j, np.zeros((H.shape[2], F.shape[1])))
            self._cross[j] = crossed + H[some, j].T @ F

    def expect(self, count: int, rows: int) -> None:
        """So many blocks of about so many rows of one log follow; 0 when they have come."""
        self._grouped.expect(count, rows)

    def stage(self, near: Mapping[float, InertiaEquations]) -> RigidStage:
        """Solve, decide on the rotor coupling, and describe the result.

        `near` holds the rows at multiples of the cut-off, to see what depends on it.
        """
        nothing = Coupling.none(self.basis.size)
        coupling = decide([self, *near.values()]) if self.rotors.any() else nothing
        fixed = self.with_coupling(float(coupling.used))
        solution, posterior = self.solved(fixed)
        posterior = posterior.with_doubt(coupling.doubt)
        there = {
            factor: other.solved(other.with_coupling(float(coupling.used)))
            for factor, other in near.items()
        }
        check = cutoff_check((solution, posterior), there, self.surfaces)
        posterior = posterior.with_doubt(check.doubt).with_doubt(self.imu_moves(solution.theta))
        stage = self._describe(solution, posterior, fixed, coupling)
        return with_cutoff_check(stage, check, self.basis)

    def with_coupling(self, share: float) -> list[Accumulator]:
        """The rows of all joints with the share of gyroscopic coupling held at a value."""
        return [joint.with_fixed(self.basis.size, share) for joint in self.joints]

    def solved(self, joints: list[Accumulator]) -> tuple[Solution, Posterior]:
        """Solve for the base parameters; with the coupling's share, where the rows still have it.

        The gravity stage enters as a prior with its covariance, friction's errors as they come,
        directly and through gravity.
        """
        free = joints[0].size > self.basis.size
        prior, through, inherited = gravity_prior(self.stages.gravity, self.basis), {}, {}
        if prior is not None and self.stages.gravity is not None:
            told = sensitivity_of(self.stages.gravity, self.robot.joint_names)
            rows = whitened(np.array(self.stages.gravity.covariance))
            through = {j: rows @ S for j, S in told.items()}
            told_moves = moves_of(self.stages.gravity, self.robot.joint_names)
            inherited = {j: rows @ M for j, M in told_moves.items()}
        if free:
            prior = _wider(prior)
        share = self.independent_share
        solution = solve(joints, prior=prior, iterations=ROUNDS, independent=share)
        size = len(solution.theta)
        crossed = {
            j: -share * solution.bread @ sums[:size] / solution.sigma[j] ** 2
            for j, sums in self._cross.items()
        }
        gain = solution.bread @ prior.A.T if prior is not None else np.zeros((size, 0))
        known = {j: S[:, -1] for j, S in crossed.items() if self._rotor_torque[j]}
        direct = {j: S[:, :-1] if j in known else S for j, S in crossed.items()}
        posterior = Posterior.of(solution, self.surfaces, direct, gain, through)
        by_gravity = {j: gain @ move for j, move in inherited.items()}
        errors = self.robot.torque_constant_errors
        moves = constant_moves(solution, errors, known, by_gravity)
        return solution, replace(posterior, constants=moves)

    def imu_moves(self, theta: Array) -> Array:
        """By what the errors of the IMUs that took part move the parameters (b, d)."""
        names = {name for use in self.uses for name in use.imus}
        imus = self.stages.imu.imus if self.stages.imu else {}
        errors = {name: imus[name].acceleration_std_error or 0.0 for name in names}
        inertia = np.where(self.basis.gravity & bool(self.stages.gravity), 0.0, theta)
        reflected = gear_ratios(self.robot) ** 2 * self.rotors
        return imu_moves(self.robot, self.basis, inertia, reflected, errors)

    @property
    def independent_share(self) -> float:
        """Share of the samples that count as independent beside the gravity stage."""
        return float(self.counts[0] / max(self.counts[1], 1.0))

    def _describe(
        self,
        solution: Solution,
        posterior: Posterior,
        joints: list[Accumulator],
        coupling: Coupling,
    ) -> RigidStage:
        robot, basis = self.robot, self.basis
        covariance, stated = posterior.covariance, posterior.stated
        known = {p.name for p in self.stages.gravity.parameters} if self.stages.gravity else set()
        own = np.array([k for k in range(basis.size) if basis.names[k] not in known], dtype=int)
        determined = own[solution.determined[own]]
        missing = not_excited(basis, solution, own)
        pairs = missing_pairs(robot, basis, solution.left_open) if missing else []
        rmse = {
            robot.joint_names[j]: float(solution.sigma[j])
            for j, joint in enumerate(joints)
            if joint.samples
        }
        return RigidStage(
            parameters=parameters_of(robot, basis, determined, solution.theta, stated),
            condition=solution.condition,
            rank=solution.rank,
            structural_rank=basis.size,
            representative=representative_of(basis, solution.theta, self.rotors),
            covariance=covariance[np.ix_(determined, determined)].tolist(),
            friction_sensitivity=as_matrices(posterior.friction, determined, robot.joint_names),
            torque_constant_moves=as_lists(posterior.constants, determined, robot.joint_names),
            not_excited=missing,
            rmse=rmse,
            rotor_coupling="gyroscopic" if coupling.used else "diagonal",
            motion={use.log: source_text(use) for use in self.uses},
            motion_use=self.uses,
            missing_pairs=pairs,
            cutoff_hz=float(np.median(self.cutoffs)),
            verdicts=self._verdicts(solution, joints),
            notes=self._notes(missing, pairs, coupling),
        )

    def _verdicts(self, solution: Solution, joints: list[Accumulator]) -> list[Verdict]:
        verdicts = []
        for j, name in enumerate(self.robot.joint_names):
            if not joints[j].samples:
                reason = "does not move in these logs, or its friction is not known"
                verdicts.append(Verdict(joint=name, good=False, reason=reason))
                continue
            rms = float(np.sqrt(self.torque_squares[j] / joints[j].samples))
            share = float(solution.sigma[j]) / max(rms, 1e-300)
            reason = f"leaves {percent(share)} of the torque ({solution.sigma[j]:.3g} N m)"
            verdicts.append(Verdict(joint=name, good=share < POOR_SHARE, reason=reason))
        full = solution.rank == self.basis.size
        reason = f"rank {solution.rank} of {self.basis.size}, condition {solution.condition:.3g}"
        verdicts.append(Verdict(good=full and solution.condition < POOR_CONDITION, reason=reason))
        return verdicts

    def _notes(self, missing: list[str], pairs: list[list[str]], coupling: Coupling) -> list[str]:
        notes = [cutoff_note(self.cutoffs, self.options.motion)]
        if missing:
            notes.append("not excited by these logs: " + "; ".join(missing))
        if pairs:
            text = ", ".join(" + ".join(pair) for pair in pairs)
            notes.append(f"moving these joints together as well would give full rank: {text}")
        return [*notes, *coupling.notes]


def slowest_speeds(surfaces: list[FrictionSurface | None]) -> Array:
    """Speed (n,) below which the sign of the friction is not certain."""
    return np.array([0.0 if s is None else SLIDES * s.sign_width for s in surfaces])


def gravity_prior(gravity: RigidStage | None, basis: Basis) -> Prior | None:
    """The gravity stage as rows of unit variance on the base parameters that it determined."""
    if gravity is None or not gravity.parameters:
        return None
    size = int(basis.gravity.sum())
    rows = whitened(np.array(gravity.covariance))
    wide = np.zeros((len(rows), basis.size))
    own = [basis.names.index(parameter.name) for parameter in gravity.parameters]
    wide[:, own] = rows
    return Prior(wide, rows @ _gravity_values(gravity, basis, size)[own])


def _gravity_values(gravity: RigidStage, basis: Basis, size: int) -> Array:
    """Base gravity parameters of the stage, undetermined ones at their smallest values."""
    names = standard_names(basis.expression.shape[1] // 11)
    phi = np.array([gravity.representative.get(name, 0.0) for name in names])
    values: Array = (basis.expression @ phi)[:size]
    return values


def _wider(prior: Prior | None) -> Prior | None:
    if prior is None:
        return None
    return Prior(np.hstack([prior.A, np.zeros((len(prior.A), 1))]), prior.b)
