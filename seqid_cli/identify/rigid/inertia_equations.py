"""Rows of the inertia stage's equation (Eq. 22-26), reduced per joint, and their solution.

    tau - tau_f - H_g pi_g = H_r pi_r.

Friction is subtracted, gravity enters as a prior with the covariance of its stage, and
both uncertainties end up in the standard errors. So do what the drives add, delay,
offset and asymmetry of each joint (`identify.nuisances`), which are unknowns beside the
parameters. Only joints that slide contribute rows: the torque of a locked joint lies
anywhere within its stiction.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from seqid_cli.identify.bands.rows import BandRowsCollector
from seqid_cli.identify.nuisances import (
    FrictionChange,
    NuisanceColumns,
    change_of,
    even_surfaces,
    later_prior,
)
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.equations import CHUNK
from seqid_cli.identify.regression.least_squares import (
    MOST_BLOCKS,
    Accumulator,
    Prior,
    Solution,
    solve,
)
from seqid_cli.identify.regression.noise_level import LogNoise, noise_of_log
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.tolerances import deviation_torques, deviations
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.model.torque import (
    friction_surfaces,
    known_rotors,
    sampled_friction,
    sliding,
)
from seqid_cli.motion.blocks import SurveyedLog, motion_blocks, overlapping
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import SAMPLES_PER_CUTOFF, Motion, too_short
from seqid_cli.params.schema import MotionUse, Stages
from seqid_cli.robot.base_parameters import base_regressor, free_basis, gear_ratios
from seqid_cli.robot.regressor import rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

LEAST_CHUNKS, MOST_CHUNKS = 2, 6  # of the equations, worked on together


MOST_STATES = 200  # of one log, at which deviations from the robot file are looked at


@dataclass(frozen=True)
class States:
    """Some states (S, n) of a log [rad, rad/s, rad/s^2], and where joints' rows were `used`."""

    q: Array
    dq: Array
    ddq: Array
    used: Mask


@dataclass
class InertiaRows:
    """The equations of some logs, reduced: factors, sums and crossed sums per joint."""

    joints: list[Accumulator]
    torque_squares: Array
    cross: dict[int, Array]
    uses: list[MotionUse]
    counts: Array  # (2,): samples that count as independent, and all
    noise: list[LogNoise] = field(default_factory=list)  # of the logs that are held
    states: list[States] = field(default_factory=list)  # some of each log's
    band_rows: BandRowsCollector = field(default_factory=BandRowsCollector)

    def __add__(self, other: "InertiaRows") -> "InertiaRows":
        none, known = np.zeros(()), self.cross | other.cross
        cross = {j: self.cross.get(j, none) + other.cross.get(j, none) for j in known}
        joints = [a + b for a, b in zip(self.joints, other.joints, strict=True)]
        squares, counts = (
            self.torque_squares + other.torque_squares,
            self.counts + other.counts,
        )
        return InertiaRows(
            joints=joints,
            torque_squares=squares,
            cross=cross,
            uses=self.uses + other.uses,
            counts=counts,
            noise=self.noise + other.noise,
            states=self.states + other.states,
            band_rows=self.band_rows + other.band_rows,
        )

    @property
    def independent(self) -> float:
        """Share of the samples that counts as independent."""
        return float(self.counts[0] / max(self.counts[1], 1.0))


@dataclass(frozen=True)
class DriveColumns:
    """What the drives add to the torques of n joints, filtered alike, all (N, n).

    `delay` [N m/s] is per second by which the torque is late, `friction_per_second` the
    part of it by which friction was identified differently; `dry_size` and
    `viscous_size` [N m] are per asymmetry of either part of friction, `per_kelvin` [N m
    K] is per friction's change per kelvin.
    """

    delay: Array
    friction_per_second: Array
    dry_size: Array
    viscous_size: Array
    per_kelvin: Array

    def part(self, where: slice) -> "DriveColumns":
        """Return the columns of some samples."""
        return DriveColumns(
            delay=self.delay[where],
            friction_per_second=self.friction_per_second[where],
            dry_size=self.dry_size[where],
            viscous_size=self.viscous_size[where],
            per_kelvin=self.per_kelvin[where],
        )


class InertiaEquations:
    """The equations of every log.

    Their unknowns are the base parameters, the nuisance terms of all joints
    (`NuisanceColumns`), and last the share of gyroscopic coupling.
    """

    measures_noise = True

    def __init__(self, robot: Robot, stages: Stages, options: InertiaOptions) -> None:
        self.robot, self.stages, self.options = robot, stages, options
        self.basis = free_basis(robot)
        self.nuisances = NuisanceColumns(self.basis.size, robot.n)
        self.coupling_place = self.nuisances.size
        self.surfaces = friction_surfaces(stages, robot)
        self.slowest = slowest_speeds(self.surfaces)
        self.rotors = known_rotors(robot)
        self.reflected = gear_ratios(robot) ** 2 * self.rotors
        self._delays = [self._change_of(name, "delay") for name in robot.joint_names]
        self._thermal = [self._change_of(name, "thermal") for name in robot.joint_names]
        self._scaled = (robot.torque_constant_errors > 0.0) & (self.reflected > 0.0)

    def rows_of(
        self, log: Recording | SurveyedLog, *, forgotten: float = 0.8
    ) -> InertiaRows:
        """Rows of one log; `forgotten`: share of the low-pass's memory computed beside."""
        # The motion of a held log is one block, of others many. 0.8 of the memory
        # leaves 1e-10.
        options = self.options.motion
        if isinstance(log, Recording):
            imu, source = self.stages.imu, self.options.source
            motion = equations.torque_motion(
                log, self.robot, options, imu=imu, source=source
            )
            parts: Iterable[Motion] = [motion]
            lowpass, samples = motion.lowpass, motion.samples
        else:
            plan = equations.plan_of(log, self.robot, options)
            parts = motion_blocks(log.blocks(), plan)
            factor, samples = plan.factor, -(-log.samples // plan.factor)
            lowpass = Lowpass(plan.cutoff.hz, plan.rate_hz / factor, factor)
        reach = int(forgotten * lowpass.memory) + lowpass.settling
        # Friction at the onset of sliding is not that of its surface, and the filter
        # mixes it in: the shorter quarter period that a prediction is judged by reads
        # delays of up to a millisecond where there are none.
        settled = self.options.settings.reversals.settled_periods
        size = CHUNK * int(np.clip(-(-24 * reach // CHUNK), LEAST_CHUNKS, MOST_CHUNKS))
        # samples of a second; longer where blocks would be merged anyway
        block = lowpass.rate_hz
        while samples > MOST_BLOCKS * block and block < CHUNK / 2:
            block *= 2.0
        joints = [Accumulator(self.nuisances.size + 1) for _ in range(self.robot.n)]
        rows = InertiaRows(joints, np.zeros(self.robot.n), {}, [], np.zeros(2))
        rows.band_rows.next_log()
        moving, usable = np.zeros(self.robot.n, dtype=bool), False
        # Right sides need little memory: they are made of longer parts than the
        # regressor.
        held = samples if isinstance(log, Recording) else 2 * size
        for motion, start, stop in overlapping(parts, held, 2 * reach):
            y = self.right_side(motion)
            drive = self.drive_columns(motion)
            y += self._reference(drive)
            about, beside = (motion, self.robot, self.basis), self.coupling_column
            for part, H in equations.filtered_regressor(
                *about, within=(start, stop), chunk=size, reach=reach, beside=beside
            ):
                low, high = max(0, part.start - reach), part.stop + reach
                near = motion.part(slice(low, high))
                slides = sliding(near, self.slowest, reach_periods=settled)
                judged = sliding(near, self.slowest)
                for at in range(part.start, part.stop, CHUNK):
                    own = slice(at, min(at + CHUNK, part.stop))
                    rigid = H[own.start - part.start : own.stop - part.start]
                    columns = self._joined(rigid, drive.part(own))
                    inner = slice(own.start - low, own.stop - low)
                    self.add_chunk(
                        rows,
                        motion.part(own),
                        columns,
                        y[own],
                        slides[inner],
                        block / lowpass.rate_hz,
                    )
                    self._add_band_rows(
                        rows.band_rows,
                        motion.part(own),
                        columns,
                        y[own],
                        used=slides[inner],
                        judged=judged[inner],
                    )
            moving |= motion.moving.any(axis=0)
            usable |= bool(motion.usable.any())
        if not usable:
            raise too_short(log.path, lowpass.cutoff_hz)
        if isinstance(log, Recording) and self.measures_noise:
            slides = sliding(motion, self.slowest, reach_periods=settled)
            rows.noise.append(noise_of_log(log, motion, slides))
            some = np.flatnonzero(slides.any(axis=1))
            some = some[:: max(1, len(some) // MOST_STATES)]
            rows.states.append(
                States(motion.q[some], motion.dq[some], motion.ddq[some], slides[some])
            )
        whole = replace(motion, moving=moving[None])
        rows.uses.append(equations.motion_use(log.path, self.robot, whole))
        return rows

    def at_cutoff(self, cutoff_hz: float) -> "InertiaEquations":
        """The same equations, filtered at another cut-off."""
        motion = replace(self.options.motion, cutoff_hz=cutoff_hz, own=frozenset())
        return InertiaEquations(
            self.robot, self.stages, replace(self.options, motion=motion)
        )

    def right_side(self, motion: Motion) -> Array:
        """Torque without friction and known rotors, filtered alike (N, n) N m."""
        assert motion.tau is not None
        own = motion.tau - motion.filtered(
            sampled_friction(self.surfaces, motion), times=2
        )
        if self.rotors.any():
            own -= motion.filtered(self.reflected * motion.ddq)
        return own

    def _change_of(self, name: str, term: str) -> FrictionChange | None:
        """Return a term of a joint's friction, and how friction goes with it."""
        friction = self.stages.friction
        joint = friction.joints.get(name) if friction else None
        return None if joint is None else change_of(joint, term)

    def drive_columns(self, motion: Motion) -> DriveColumns:
        """Return what delay and asymmetry of each joint's drive add to its torque."""
        assert motion.tau is not None
        by_friction = self._friction_of(motion, self._delays)
        none: list[FrictionSurface | None] = [None, None]
        sizes = [
            none if surface is None else even_surfaces(surface)
            for surface in self.surfaces
        ]
        dry, viscous = (
            motion.filtered(
                sampled_friction([parts[k] for parts in sizes], motion), times=2
            )
            for k in range(2)
        )
        change = np.gradient(motion.tau, axis=0) * motion.rate_hz
        return DriveColumns(
            delay=by_friction - change,
            friction_per_second=by_friction,
            dry_size=dry,
            viscous_size=viscous,
            per_kelvin=self._per_kelvin(motion),
        )

    def _friction_of(
        self, motion: Motion, terms: Sequence[FrictionChange | None]
    ) -> Array:
        """Return what one unit of each joint's term changes of its friction (N, n) N m."""
        changes = [None if term is None else term.per_unit for term in terms]
        return motion.filtered(sampled_friction(changes, motion), times=2)

    def _per_kelvin(self, motion: Motion) -> Array:
        """Return the torque (N, n) N m of one unit of friction's change per kelvin."""
        if motion.celsius is None:
            return np.zeros_like(motion.q)
        warm = self._friction_of(motion, self._thermal)
        kelvin = np.zeros_like(motion.q)
        for j, surface in enumerate(self.surfaces):
            if surface is not None:
                kelvin[:, j] = surface.kelvin(motion.celsius[:, j])
        friction = motion.filtered(sampled_friction(self.surfaces, motion), times=2)
        return np.asarray(warm + kelvin * friction)

    def _reference(self, drive: DriveColumns) -> Array:
        """Return what friction has of the delay that it was identified with (N, n) N m."""
        values = [0.0 if delay is None else delay.value for delay in self._delays]
        return np.asarray(drive.friction_per_second * np.array(values))

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
        """Torque (N, n) that known rotors add if they are coupled to the links that carry them."""
        if not self.rotors.any():
            return np.zeros_like(motion.q)
        state = (
            self.robot.chain,
            motion.q,
            motion.dq,
            motion.ddq,
            gear_ratios(self.robot),
        )
        coupled = rotor_regressor(*state, "gyroscopic") - rotor_regressor(
            *state, "diagonal"
        )
        return motion.filtered(coupled @ self.rotors)

    def add_chunk(
        self,
        rows: InertiaRows,
        motion: Motion,
        H: Array,
        y: Array,
        usable: Mask,
        block_s: float,
    ) -> None:
        """Add H (N, n, p), y (N, n) of consecutive samples, where usable, to some rows."""
        share = equations.independent_share(motion)
        rows.counts += motion.samples * np.array([share, 1.0])
        every = max(
            1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz))
        )
        parts = list(equations.blocks(motion.samples, motion.rate_hz, block_s=block_s))
        for j, surface in enumerate(self.surfaces):
            own = usable[:, j] & (surface is not None)
            for part in parts:
                rows.joints[j].add(H[part, j], y[part, j], own[part])
            if surface is None or not own.any():
                continue
            assert motion.tau is not None
            rows.torque_squares[j] += float(np.sum(motion.tau[own, j] ** 2))
            some = np.flatnonzero(own)[::every]
            # What is alike both ways of friction's error is in the nuisance terms.
            F = every * surface.error_columns(motion.q[some, j], motion.dq[some, j])
            if self._scaled[j]:
                F = np.column_stack(
                    [F, every * self.reflected[j] * motion.ddq[some, j]]
                )
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
        """Add rows by which bands are calibrated, of the samples that predictions are judged by."""
        known = np.array([surface is not None for surface in self.surfaces])
        chosen = collected.pick(motion, judged & known)
        collected.add(
            motion,
            chosen,
            H=H[chosen],
            y=y[chosen],
            used=(used & known)[chosen],
            judged=(judged & known)[chosen],
        )

    def prior(self) -> Prior:
        """Return what the stages before know of the unknowns, without that of coupling."""
        return later_prior(
            self.stages, self.surfaces, self.basis, self.robot.joint_names
        )

    def solved(
        self, rows: InertiaRows, coupling: float | None, *, rounds: int = 6
    ) -> tuple[Solution, Posterior]:
        """Solve for the base parameters, the share of coupling held, or free where it is None."""
        # The gravity stage enters as a prior with its covariance, friction's errors
        # directly and through gravity. After six rounds the weights have settled to
        # 1e-3 standard errors.
        joints = rows.joints
        prior = self.prior()
        if coupling is None:  # of which the prior knows nothing
            prior = replace(prior, A=np.pad(prior.A, ((0, 0), (0, 1))))
        else:
            joints = [joint.with_fixed(joint.size - 1, coupling) for joint in joints]
        share = rows.independent
        solution = solve(
            joints,
            prior=prior,
            iterations=rounds,
            independent=share,
            nuisances=self.nuisances.all,
        )
        size = len(solution.theta)
        crossed = {
            j: -share * solution.bread @ sums[:size] / solution.sigma[j] ** 2
            for j, sums in rows.cross.items()
        }
        known = {j: S[:, -1] for j, S in crossed.items() if self._scaled[j]}
        direct = {j: S[:, :-1] if j in known else S for j, S in crossed.items()}
        about = self.surfaces, self.robot.torque_constant_errors
        return solution, Posterior.of(solution, *about, direct, known, prior)


def tolerance_moves(
    equations: InertiaEquations, rows: InertiaRows, solution: Solution
) -> dict[str, Array]:
    """Return how the unknowns (p,) move with one standard deviation of what no log shows."""
    robot, basis = equations.robot, equations.basis
    names = [deviation.name for deviation in deviations(robot)]
    if not names or not rows.states:
        return {}
    q, dq, ddq, used = (
        np.concatenate([getattr(states, name) for states in rows.states])
        for name in ("q", "dq", "ddq", "used")
    )
    links = (basis.representative @ solution.theta[: basis.size])[: 10 * robot.n]
    standard = links.reshape(-1, 10) if robot.nominal is None else robot.nominal
    H = base_regressor(robot, basis, q, dq, ddq)
    torques = deviation_torques(robot, standard, q, dq, ddq)

    # Some states stand for all rows of a joint, of which a share counts as independent.
    share = rows.independent
    prior = equations.prior()
    size = len(solution.theta)
    moves = {}
    for name in names:
        right = np.zeros(size)
        for j, joint in enumerate(rows.joints):
            mask = used[:, j]
            weight = (
                share * joint.samples / max(int(mask.sum()), 1) / solution.sigma[j] ** 2
            )
            right[: basis.size] += weight * (H[mask, j].T @ torques[name][mask, j])
        if name in prior.tolerances:
            right += prior.A[:, :size].T @ prior.tolerances[name]
        moves[name] = solution.bread @ right
    return moves


def slowest_speeds(surfaces: list[FrictionSurface | None]) -> Array:
    """Speed (n,) below which the sign of the friction is not certain."""
    return np.array([0.0 if s is None else SLIDES * s.sign_width for s in surfaces])
