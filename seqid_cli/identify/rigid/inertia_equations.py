"""Rows of the inertia stage's equation (Eq. 22-26), reduced per joint, and their solution.

    tau - tau_f - H_g pi_g = H_r pi_r.

Friction is subtracted, gravity enters as a prior with the covariance of its stage, and both
uncertainties end up in the standard errors. Only joints that slide contribute rows: the torque of
a locked joint lies anywhere within its stiction.
"""

from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.motion_use import motion_use
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.equations import CHUNK, FilteredColumns, blocks, torque_motion
from seqid_cli.identify.regression.grouped_blocks import GroupedBlocks
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
    whitened,
)
from seqid_cli.identify.regression.streaming import chosen_cutoff
from seqid_cli.identify.rigid.parameters import imu_moves
from seqid_cli.identify.rigid.posterior import Posterior, by_joint, constant_moves, gravity_prior
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.model.friction_samples import sampled_friction
from seqid_cli.model.torque import friction_surfaces, known_rotors, sliding
from seqid_cli.motion.blocks import SurveyedLog, make_plan, motion_blocks, overlapping
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import SAMPLES_PER_CUTOFF, Motion, too_short
from seqid_cli.params.schema import MotionUse, Stages
from seqid_cli.robot.base_parameters import Basis, gear_ratios
from seqid_cli.robot.regressor import rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

LEAST_CHUNKS, MOST_CHUNKS = 2, 6  # of the equations, worked on together


@dataclass
class InertiaRows:
    """The equations of some logs, reduced: factors, sums and crossed sums per joint."""

    joints: list[Accumulator]
    torque_squares: Array
    cross: dict[int, Array]
    cutoffs: list[float]
    uses: list[MotionUse]
    counts: Array  # (2,): samples that count as independent, and all

    @classmethod
    def none(cls, size: int, n: int) -> "InertiaRows":
        """No equation of n joints with so many parameters."""
        joints = [Accumulator(size) for _ in range(n)]
        return cls(joints, np.zeros(n), {}, [], [], np.zeros(2))

    def __add__(self, other: "InertiaRows") -> "InertiaRows":
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


class InertiaEquations:
    """Accumulates the rows of all logs; the last column is the share of gyroscopic coupling."""

    def __init__(self, robot: Robot, basis: Basis, stages: Stages, options: InertiaOptions) -> None:
        self.robot, self.basis, self.stages, self.options = robot, basis, stages, options
        self.surfaces = friction_surfaces(stages, robot)
        self.slowest = slowest_speeds(self.surfaces)
        self.rotors = known_rotors(robot)
        scaled = robot.torque_constant_errors > 0.0
        self._rotor_torque = np.where(scaled, gear_ratios(robot) ** 2 * self.rotors, 0.0)
        self.rows = InertiaRows.none(basis.size + 1, robot.n)
        self.grouped = GroupedBlocks(self.rows.joints)

    @property
    def joints(self) -> list[Accumulator]:
        """The rows of each joint."""
        return self.rows.joints

    def rows_of(self, log: Recording | SurveyedLog) -> InertiaRows:
        """The rows of one log alone; these equations stay as they are."""
        fresh = self.with_rows(InertiaRows.none(self.basis.size + 1, self.robot.n))
        fresh.grouped = GroupedBlocks(fresh.joints)
        motion = pass_over(log, fresh)
        fresh.rows.cutoffs.append(motion.cutoff.hz)
        fresh.rows.uses.append(motion_use(log.path, self.robot, motion))
        return fresh.rows

    def at_cutoff(self, cutoff_hz: float) -> "InertiaEquations":
        """The same equations, to take rows that are filtered at another cut-off."""
        other = copy(self)
        motion = replace(self.options.motion, cutoff_hz=cutoff_hz)
        other.options = replace(self.options, motion=motion)
        return other

    def with_rows(self, rows: InertiaRows) -> "InertiaEquations":
        """The same equations with rows."""
        full = copy(self)
        full.rows = rows
        return full

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
        self.rows.counts += motion.samples * np.array([motion.independent_share, 1.0])
        known = usable & np.array([surface is not None for surface in self.surfaces])
        ends = [block.stop for block in blocks(motion.samples, motion.rate_hz)]
        self.grouped.add((H, y, known), ends)
        every = max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))
        for j, surface in enumerate(self.surfaces):
            rows = usable[:, j]
            if surface is None or not rows.any():
                continue
            assert motion.tau is not None
            self.rows.torque_squares[j] += float(np.sum(motion.tau[rows, j] ** 2))
            some = np.flatnonzero(rows)[::every]
            F = every * surface.columns(motion.q[some, j], motion.dq[some, j])
            if self._rotor_torque[j]:
                F = np.column_stack([F, every * self._rotor_torque[j] * motion.ddq[some, j]])
            crossed = self.rows.cross.get(j, np.zeros((H.shape[2], F.shape[1])))
            self.rows.cross[j] = crossed + H[some, j].T @ F

    def with_coupling(self, share: float) -> list[Accumulator]:
        """The rows of all joints with the share of gyroscopic coupling held at a value."""
        return [joint.with_fixed(self.basis.size, share) for joint in self.joints]

    def solved(self, joints: list[Accumulator], *, rounds: int = 6) -> tuple[Solution, Posterior]:
        """Solve for the base parameters; with the coupling's share, where the rows still have it.

        The gravity stage enters as a prior with its covariance, friction's errors as they come,
        directly and through gravity. After six `rounds` of reweighting the weights have settled to
        a thousandth of a standard error.
        """
        free = joints[0].size > self.basis.size
        prior, through, inherited = gravity_prior(self.stages.gravity, self.basis), {}, {}
        if prior is not None and self.stages.gravity is not None:
            before, names = self.stages.gravity, self.robot.joint_names
            rows = whitened(np.array(before.covariance))
            through, inherited = (
                {j: rows @ values for j, values in by_joint(known, names).items()}
                for known in (before.friction_sensitivity, before.torque_constant_moves)
            )
        if free and prior is not None:
            # The same prior with a column of zeros behind: it knows nothing of the coupling.
            prior = Prior(np.hstack([prior.A, np.zeros((len(prior.A), 1))]), prior.b)
        share = self.independent_share
        solution = solve(joints, prior=prior, iterations=rounds, independent=share)
        size = len(solution.theta)
        crossed = {
            j: -share * solution.bread @ sums[:size] / solution.sigma[j] ** 2
            for j, sums in self.rows.cross.items()
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
        names = {name for use in self.rows.uses for name in use.imus}
        imus = self.stages.imu.imus if self.stages.imu else {}
        errors = {name: imus[name].acceleration_std_error or 0.0 for name in names}
        inertia = np.where(self.basis.gravity & bool(self.stages.gravity), 0.0, theta)
        reflected = gear_ratios(self.robot) ** 2 * self.rotors
        return imu_moves(self.robot, self.basis, inertia, reflected, errors)

    @property
    def independent_share(self) -> float:
        """Share of the samples that count as independent beside the gravity stage."""
        return float(self.rows.counts[0] / max(self.rows.counts[1], 1.0))


def slowest_speeds(surfaces: list[FrictionSurface | None]) -> Array:
    """Speed (n,) below which the sign of the friction is not certain."""
    return np.array([0.0 if s is None else SLIDES * s.sign_width for s in surfaces])


def pass_over(
    log: Recording | SurveyedLog, equations: InertiaEquations, *, forgotten: float = 0.8
) -> Motion:
    """Add the rows of one log.

    The motion of a log that is held is one block, of one to be passed over it comes in many.
    `forgotten`: share of the low-pass's memory that is computed beside a part: 0.8 of it leaves
    1e-10. Returns:
    the last samples, `moving` (1, n) being that of all of them. Raises InputError if no stretch of
    the log is long enough to filter.
    """
    held = isinstance(log, Recording)
    if isinstance(log, Recording):
        parts, lowpass, samples = _held(log, equations)
    else:
        parts, lowpass, samples = _streamed(log, equations)
    reach = int(forgotten * lowpass.memory) + lowpass.settling
    rows = CHUNK * int(np.clip(-(-24 * reach // CHUNK), LEAST_CHUNKS, MOST_CHUNKS))
    columns = FilteredColumns(
        equations.robot, equations.basis, min(rows, samples), reach, equations.coupling_column
    )
    # How many blocks of equations a log will have.
    whole, rest = divmod(samples, CHUNK)
    sizes = [(CHUNK, whole), (rest, 1 if rest else 0)]
    expected = sum(times * sum(1 for _ in blocks(size, lowpass.rate_hz)) for size, times in sizes)
    equations.grouped.expect(expected, samples // max(expected, 1))
    moving, usable, last = np.zeros(equations.robot.n, dtype=bool), False, None
    # Right sides need little memory: they are made of longer parts than the regressor.
    for motion, start, stop in overlapping(parts, samples if held else 2 * rows, 2 * reach):
        y = equations.right_side(motion)
        for first in range(start, stop, rows):
            _add_part(equations, columns, motion, y, slice(first, min(first + rows, stop)), reach)
        moving |= motion.moving.any(axis=0)
        usable |= bool(motion.usable.any())
        last = motion
    equations.grouped.expect(0, 0)
    if last is None or not usable:
        raise too_short(log.path, lowpass.cutoff_hz)
    return replace(last, moving=moving[None])


def _held(log: Recording, equations: InertiaEquations) -> tuple[Iterable[Motion], Lowpass, int]:
    """The motion of a log as one block, its low-pass, and how many samples there are."""
    options, imu = equations.options, equations.stages.imu
    motion = torque_motion(log, equations.robot, options.motion, imu=imu, source=options.source)
    return [motion], motion.lowpass, motion.samples


def _streamed(
    log: SurveyedLog, equations: InertiaEquations
) -> tuple[Iterable[Motion], Lowpass, int]:
    """The motion of a long log, block by block, its low-pass, and how many samples there are."""
    options = equations.options.motion
    cutoff, step = chosen_cutoff(log, equations.robot, options)
    plan = make_plan(log.rate_hz, cutoff, step, samples_per_cutoff=options.samples_per_cutoff)
    samples = -(-log.samples // plan.factor)
    return motion_blocks(log.blocks(), plan), plan.kept_lowpass, samples


def _add_part(
    equations: InertiaEquations,
    columns: FilteredColumns,
    motion: Motion,
    y: Array,
    part: slice,
    reach: int,
) -> None:
    """Add the rows of some samples; the others are there for the filters."""
    low, high = max(0, part.start - reach), min(motion.samples, part.stop + reach)
    usable = sliding(motion.part(slice(low, high)), equations.slowest)
    H = columns.of(motion, part.start, part.stop)
    for first in range(part.start, part.stop, CHUNK):
        end = min(first + CHUNK, part.stop)
        chunk = motion.part(slice(first, end))
        rows = H[first - part.start : end - part.start]
        equations.add_chunk(chunk, rows, y[first:end], usable[first - low : end - low])
