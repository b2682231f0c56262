"""Rows of the inertia stage's equation (Eq. 22-26), reduced per joint, and solution.

    tau - tau_f - H_g pi_g = H_r pi_r.

Friction is subtracted, gravity enters as a prior with the covariance of its stage, and
both uncertainties end up in the standard errors. So do what the drives add, delay,
offset and asymmetry of each joint (`identify.nuisances`), which are unknowns beside the
parameters. Only joints that slide contribute rows: the torque of a locked joint lies
anywhere within its stiction.
"""

from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from seqid_cli.identify.bands.rows import BandRowsCollector
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.equations import CHUNK
from seqid_cli.identify.regression.least_squares import (
    MOST_BLOCKS,
    Prior,
    Solution,
    solve,
)
from seqid_cli.identify.regression.noise_level import noise_of_log
from seqid_cli.identify.rigid.drive_columns import DriveColumns, Drives
from seqid_cli.identify.rigid.inertia_rows import InertiaRows, States
from seqid_cli.identify.rigid.nuisance_priors import NuisanceColumns, later_prior
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.tolerances import deviation_torques, deviations
from seqid_cli.logs.long import LongLog
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import slowest_speeds
from seqid_cli.model.torque import friction_surfaces, known_rotors, sliding
from seqid_cli.motion.blocks import motion_blocks, overlapping
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import SAMPLES_PER_CUTOFF, Motion, too_short
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import base_regressor, free_basis, gear_ratios
from seqid_cli.robot.regressor import rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

# Chunks of the equations that are worked on together.
LEAST_CHUNKS = 2
MOST_CHUNKS = 6
# States of one log at which deviations from the robot file are looked at.
MOST_STATES = 200
# Share of the low-pass's memory that is computed beside a part: it leaves 1e-10.
REMEMBERED = 0.8
# Rounds of weighing joints by what is left of them: weights settle to 1e-3 standard
# errors.
ROUNDS = 6


class InertiaEquations:
    """The equations of every log.

    Their unknowns are the base parameters, the nuisance terms of all joints
    (`NuisanceColumns`), and last the share of gyroscopic coupling.

    Equations that are solved for a comparison alone (`only_compares`) leave out what a
    written stage needs besides: the torque's noise, and the rows of its bands.
    """

    def __init__(
        self,
        robot: Robot,
        stages: Stages,
        options: InertiaOptions,
        *,
        only_compares: bool = False,
    ) -> None:
        self.robot = robot
        self.stages = stages
        self.options = options
        self.only_compares = only_compares
        self.basis = free_basis(robot)
        self.nuisances = NuisanceColumns(self.basis.size, robot.n)
        self.coupling_place = self.nuisances.size
        self.surfaces = friction_surfaces(stages, robot)
        self.slowest = slowest_speeds(self.surfaces)
        self.rotors = known_rotors(robot)
        self.reflected = gear_ratios(robot) ** 2 * self.rotors
        self.drives = Drives(robot, stages, self.surfaces)
        self._scaled = (robot.torque_constant_errors > 0.0) & (self.reflected > 0.0)

    def rows_of(self, log: Recording | LongLog) -> InertiaRows:
        """Return the rows of one log, reduced.

        Raises
        ------
        InputError
            Where the log has no torque, or is too short for its cut-off.
        """
        motions = self._motions_of(log)
        lowpass = motions.lowpass
        reach = int(REMEMBERED * lowpass.memory) + lowpass.settling
        # Friction at the onset of sliding is not that of its surface, and the filter
        # mixes it in: the shorter quarter period that a prediction is judged by reads
        # delays of up to a millisecond where there are none.
        settled = self.options.settings.reversals.settled_periods
        n_chunks = np.clip(-(-24 * reach // CHUNK), LEAST_CHUNKS, MOST_CHUNKS)
        size = CHUNK * int(n_chunks)
        block_s = _block_samples(lowpass.rate_hz, motions.samples) / lowpass.rate_hz

        rows = InertiaRows.empty(self.robot.n, self.nuisances.size + 1)
        rows.band_rows.next_log()
        moving = np.zeros(self.robot.n, dtype=bool)
        is_usable = False
        # Right sides need little memory: they are made of longer parts than the
        # regressor.
        held = motions.samples if isinstance(log, Recording) else 2 * size
        for motion, start, stop in overlapping(motions.parts, held, 2 * reach):
            drive = self.drives.columns(motion)
            y = self._right_side(motion, drive)
            for part, H in equations.filtered_regressor(
                motion,
                self.robot,
                self.basis,
                within=(start, stop),
                chunk=size,
                reach=reach,
                beside=self.coupling_column,
            ):
                first = max(0, part.start - reach)
                surrounding = motion.part(slice(first, part.stop + reach))
                used = sliding(surrounding, self.slowest, reach_periods=settled)
                judged = used
                if not self.only_compares:
                    judged = sliding(surrounding, self.slowest)
                for begin in range(part.start, part.stop, CHUNK):
                    end = min(begin + CHUNK, part.stop)
                    samples = slice(begin, end)
                    rigid = H[begin - part.start : end - part.start]
                    columns = self._joined(rigid, drive.part(samples))
                    inner = slice(begin - first, end - first)
                    self.add_chunk(
                        rows,
                        motion.part(samples),
                        columns,
                        y[samples],
                        used[inner],
                        block_s,
                    )
                    if self.only_compares:
                        continue
                    self._add_band_rows(
                        rows.band_rows,
                        motion.part(samples),
                        columns,
                        y[samples],
                        used=used[inner],
                        judged=judged[inner],
                    )
            moving |= motion.moving.any(axis=0)
            is_usable |= bool(motion.usable.any())
        if not is_usable:
            raise too_short(log.path, lowpass.cutoff_hz)

        if isinstance(log, Recording) and not self.only_compares:
            used = sliding(motion, self.slowest, reach_periods=settled)
            rows.noise.append(noise_of_log(log, motion, used))
            rows.states.append(_some_states(motion, used))
        of_all_parts = replace(motion, moving=moving[None])
        rows.uses.append(equations.motion_use(log.path, self.robot, of_all_parts))
        return rows

    def _motions_of(self, log: Recording | LongLog) -> "LogMotions":
        """Return the motion of a log, in one part if held, else in many."""
        options = self.options.motion
        if isinstance(log, Recording):
            motion = equations.torque_motion(
                log,
                self.robot,
                options,
                imu=self.stages.imu,
                source=self.options.source_of(log.sha256),
            )
            return LogMotions(
                parts=[motion], lowpass=motion.lowpass, samples=motion.samples
            )
        plan = equations.plan_of(log, self.robot, options)
        return LogMotions(
            parts=motion_blocks(log.blocks(), plan),
            lowpass=Lowpass(plan.cutoff.hz, plan.rate_hz / plan.factor, plan.factor),
            samples=-(-log.samples // plan.factor),
        )

    def at_cutoff(self, cutoff_hz: float) -> "InertiaEquations":
        """Return the same equations at another cut-off, to be compared with.

        Their motions are asked for once, and are not kept with those that are used.
        """
        motion = replace(
            self.options.motion,
            cutoff_hz=cutoff_hz,
            logs_with_own_cutoff=frozenset(),
            kept=None,
        )
        other = copy(self)
        other.options = replace(self.options, motion=motion)
        other.only_compares = True
        return other

    def _right_side(self, motion: Motion, drive: DriveColumns) -> Array:
        """Return the torque (N, n) N m without friction and known rotors, filtered.

        Friction is that of no delay: the delay's column has the whole of it.
        """
        assert motion.tau is not None
        by_delay = drive.friction_per_second * self.drives.delays_of_friction
        torque = np.asarray(motion.tau - drive.friction + by_delay)
        if self.rotors.any():
            torque -= motion.filtered(self.reflected * motion.ddq)
        return torque

    def _joined(self, rigid: Array, drive: DriveColumns) -> Array:
        """Return all columns (N, n, p) from those of the rigid body (N, n, b + 1)."""
        size = self.basis.size
        samples, n = rigid.shape[:2]
        columns = np.zeros((n, self.nuisances.size + 1, samples)).transpose(2, 0, 1)
        columns[:, :, :size] = rigid[:, :, :size]
        columns[:, :, -1] = rigid[:, :, size]
        for j in range(n):
            of_drive = [
                drive.delay,
                np.ones_like(drive.delay),
                drive.dry_size,
                drive.viscous_size,
                drive.per_kelvin,
            ]
            places = self.nuisances.of_joint(j)
            columns[:, j, places] = np.stack(
                [values[:, j] for values in of_drive], axis=1
            )
        return columns

    def coupling_column(self, motion: Motion) -> Array:
        """Return the torque (N, n) N m that known rotors add if links feel them."""
        if not self.rotors.any():
            return np.zeros_like(motion.q)
        of_coupling = partial(
            rotor_regressor,
            self.robot.chain,
            motion.q,
            motion.dq,
            motion.ddq,
            gear_ratios(self.robot),
        )
        difference = of_coupling("gyroscopic") - of_coupling("diagonal")
        return motion.filtered(difference @ self.rotors)

    def add_chunk(
        self,
        rows: InertiaRows,
        motion: Motion,
        H: Array,
        y: Array,
        usable: Mask,
        block_s: float,
    ) -> None:
        """Add consecutive samples to some rows.

        Parameters
        ----------
        rows : InertiaRows
            What they are added to.
        motion : Motion
            That of the N samples.
        H : (N, n, p) array
            Columns of all unknowns.
        y : (N, n) array
            Right side [N m].
        usable : (N, n) array of bool
            Whose rows count.
        block_s : float
            Length of a block of rows [s], whose errors count as one.
        """
        assert motion.tau is not None
        share = equations.independent_share(motion)
        rows.sample_counts += motion.samples * np.array([share, 1.0])
        blocks = list(equations.blocks(motion.samples, motion.rate_hz, block_s=block_s))
        # The errors of friction are smooth: some samples stand for those around them.
        per_cutoff = motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)
        stride = max(1, int(per_cutoff))
        for j, surface in enumerate(self.surfaces):
            used = usable[:, j] & (surface is not None)
            for block in blocks:
                rows.joints[j].add(H[block, j], y[block, j], used[block])
            if surface is None or not used.any():
                continue
            rows.torque_squares[j] += float(np.sum(motion.tau[used, j] ** 2))
            # What is alike both ways of friction's error is in the nuisance terms.
            some = np.flatnonzero(used)[::stride]
            errors = surface.error_columns(motion.q[some, j], motion.dq[some, j])
            F = stride * errors
            if self._scaled[j]:
                rotor_torque = self.reflected[j] * motion.ddq[some, j]
                F = np.column_stack([F, stride * rotor_torque])
            rows.cross[j] = rows.cross.get(j, 0.0) + H[some, j].T @ F

    def _add_band_rows(
        self,
        collected: BandRowsCollector,
        motion: Motion,
        H: Array,
        y: Array,
        *,
        used: Mask,
        judged: Mask,
    ) -> None:
        """Add rows that calibrate bands, of the samples that judge predictions."""
        has_friction = np.array([surface is not None for surface in self.surfaces])
        chosen = collected.pick(motion, judged & has_friction)
        collected.add(
            motion,
            chosen,
            H=H[chosen],
            y=y[chosen],
            used=(used & has_friction)[chosen],
            judged=(judged & has_friction)[chosen],
        )

    def prior(self) -> Prior:
        """Return the earlier stages' knowledge of the unknowns, except coupling."""
        return later_prior(
            self.stages, self.surfaces, self.basis, self.robot.joint_names
        )

    def solved(
        self, rows: InertiaRows, coupling: float | None, *, rounds: int = ROUNDS
    ) -> tuple[Solution, Posterior]:
        """Solve for the base parameters and the drives' terms.

        The gravity stage enters as a prior with its covariance, friction's errors
        directly and through gravity.

        Parameters
        ----------
        rows : InertiaRows
        coupling : float or None
            Share of the rotors' coupling at which it is held; free where None.
        rounds : int
            Rounds of weighing joints by what is left of them.
        """
        joints = rows.joints
        prior = self.prior()
        if coupling is None:  # of which the prior knows nothing
            prior = replace(prior, A=np.pad(prior.A, ((0, 0), (0, 1))))
        else:
            joints = [joint.with_fixed(joint.size - 1, coupling) for joint in joints]
        solution = solve(
            joints,
            prior=prior,
            iterations=rounds,
            independent=rows.independent,
            nuisances=self.nuisances.all,
        )

        size = len(solution.theta)
        moves = {
            j: -rows.independent * solution.bread @ sums[:size] / solution.sigma[j] ** 2
            for j, sums in rows.cross.items()
        }
        # The last column of a joint with a known rotor is the torque of that.
        by_rotors = {j: move[:, -1] for j, move in moves.items() if self._scaled[j]}
        by_friction = {
            j: move[:, :-1] if j in by_rotors else move for j, move in moves.items()
        }
        posterior = Posterior.of(
            solution,
            self.surfaces,
            self.robot.torque_constant_errors,
            by_friction,
            by_rotors,
            prior,
        )
        return solution, posterior


@dataclass(frozen=True, kw_only=True)
class LogMotions:
    """The motion of one log in parts, with what all of them share."""

    parts: Iterable[Motion]
    lowpass: Lowpass
    samples: int  # of all parts


def _block_samples(rate_hz: float, samples: int) -> float:
    """Return the samples of a second; of longer where blocks would be merged anyway."""
    block = rate_hz
    while samples > MOST_BLOCKS * block and block < CHUNK / 2:
        block *= 2.0
    return block


def _some_states(motion: Motion, used: Mask) -> States:
    """Return evenly chosen states of a log at which a joint is `used` (N, n)."""
    some = np.flatnonzero(used.any(axis=1))
    some = some[:: max(1, len(some) // MOST_STATES)]
    return States(
        q=motion.q[some], dq=motion.dq[some], ddq=motion.ddq[some], used=used[some]
    )


def tolerance_moves(
    equations: InertiaEquations, rows: InertiaRows, solution: Solution
) -> dict[str, Array]:
    """Return moves of the unknowns (p,) per standard deviation of tolerances.

    No log shows these tolerances.
    """
    robot = equations.robot
    basis = equations.basis
    names = [deviation.name for deviation in deviations(robot)]
    if not names or not rows.states:
        return {}
    q = np.concatenate([states.q for states in rows.states])
    dq = np.concatenate([states.dq for states in rows.states])
    ddq = np.concatenate([states.ddq for states in rows.states])
    used = np.concatenate([states.used for states in rows.states])
    links = (basis.representative @ solution.theta[: basis.size])[: 10 * robot.n]
    standard = links.reshape(-1, 10) if robot.nominal is None else robot.nominal
    H = base_regressor(robot, basis, q, dq, ddq)
    torques = deviation_torques(robot, standard, q, dq, ddq)

    prior = equations.prior()
    size = len(solution.theta)
    moves = {}
    for name in names:
        right = np.zeros(size)
        for j, joint in enumerate(rows.joints):
            # Some states stand for all rows of a joint, of which a share counts as
            # independent.
            mask = used[:, j]
            per_state = rows.independent * joint.samples / max(int(mask.sum()), 1)
            weight = per_state / solution.sigma[j] ** 2
            right[: basis.size] += weight * (H[mask, j].T @ torques[name][mask, j])
        if name in prior.tolerances:
            right += prior.A[:, :size].T @ prior.tolerances[name]
        moves[name] = solution.bread @ right
    return moves
