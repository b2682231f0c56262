"""Rows of the gravity stage (Eq. 19): slices of steady trials, of the moving joint.

A row is the mean over `GROUP_SIZE` slices of a trial. With H the gravity regressor of
the moving joint (Eq. 4), f its friction surface and y the torque that f leaves,

    y = H pi + E o + t_f e + F c + S s + D d + a b + noise,

    pi   gravity's base parameters, what is asked,
    o    changes of the drive's offset and asymmetries (`identify.nuisances`), unknown,
    e    change of friction per kelvin [1/K], unknown,
    c    errors of the friction surface's coefficients, with the surface's covariance,
    s    where the other joints stand within a count of their encoders,
    d    tolerances that no log shows: of geometry, gravity's direction and zeros
         (`identify.tolerances`),
    b    error of the inertia whose torque was taken off [kg m^2].

The rows are whitened joint by joint; pi, o, e are solved for, and the others widen the
standard errors.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seqid_cli.identify.friction_surface import corrections
from seqid_cli.identify.friction_surface.corrections import HeldJoints, SteadyGroup
from seqid_cli.identify.friction_surface.gravity_separation import configurations
from seqid_cli.identify.friction_surface.trials import Trial, speed_levels
from seqid_cli.identify.nuisances import (
    EVEN_TERMS,
    FrictionChange,
    change_of,
    even_columns,
    thermal_column,
)
from seqid_cli.identify.regression.least_squares import Accumulator, Prior, Solution
from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from seqid_cli.identify.rigid.nuisance_priors import even_prior
from seqid_cli.identify.rigid.posterior import Sensitivity
from seqid_cli.identify.settings import GravityFitSettings, GravitySettings
from seqid_cli.identify.tolerances import deviation_torques, deviations
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage
from seqid_cli.typing import Array, Index, Mask

# Unknowns of each joint's drive: what is alike both ways, and thermal change.
DRIVE_TERMS = EVEN_TERMS + 1
# Slices in a row. Neighbours share most of their noise, so that fewer rows lose nothing
# and the covariance of a joint's rows stays small.
GROUP_SIZE = 8


@dataclass(frozen=True, kw_only=True)
class TrialRows:
    """Rows of one joint's trials, with N the number of rows.

    `gravity` (N, p), `even` (N, 3) and `thermal` (N,) are the columns of the unknowns;
    `friction_error` (N, c), `standing` (N, n), `deviation` (N, d) and `acceleration`
    (N,) rad/s^2 those of what is not known better. `torque` (N,) N m is what friction
    leaves, `friction` (N,) the surface's torque and `friction_std` (N,) its stated
    error. `t` (N,) s is the time within the log. A row averages over `samples` and
    `seconds` (N,); `trial`, `log` and `group` (N,) say where it is from, `motion` (N,)
    which trials are of one speed, direction and posture.
    """

    gravity: Array
    even: Array
    thermal: Array
    friction_error: Array
    standing: Array
    deviation: Array
    acceleration: Array
    torque: Array
    friction: Array
    friction_std: Array
    t: Array
    samples: Array
    seconds: Array
    trial: Index
    log: Index
    group: Index
    motion: Index

    @classmethod
    def joined(cls, parts: Sequence["TrialRows"]) -> "TrialRows":
        """Return the rows of all parts, one after the other."""
        names = cls.__dataclass_fields__
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in names
        }
        return cls(**columns)

    @cached_property
    def unknowns(self) -> Array:
        """Columns (N, p + 4) of gravity's parameters and of the joint's drive."""
        return np.column_stack([self.gravity, self.even, self.thermal])

    def whitened(self) -> "WhiteRows":
        """Return what is needed of the rows, its noise white, see `slow_noise`."""
        noise = Rows(
            H=self.unknowns,
            y=self.torque,
            t=self.t,
            weight=self.samples,
            seconds=self.seconds,
            trial=self.trial,
            log=self.log,
        )
        whiten = whitener_of(noise)
        return WhiteRows(
            unknowns=whiten(self.unknowns),
            friction_error=whiten(self.friction_error),
            standing=whiten(self.standing),
            deviation=whiten(self.deviation),
            acceleration=whiten(self.acceleration[:, None])[:, 0],
            torque=whiten(self.torque[:, None])[:, 0],
        )


@dataclass(frozen=True, kw_only=True)
class WhiteRows:
    """Columns of `TrialRows`, of the same shapes, with white noise of equal size."""

    unknowns: Array
    friction_error: Array
    standing: Array
    deviation: Array
    acceleration: Array
    torque: Array


@dataclass(frozen=True, kw_only=True)
class JointRows:
    """Rows of one joint's trials as they were measured, among all unknowns.

    `H` (N, q): columns of all joints' unknowns.
    """

    H: Array
    rows: TrialRows

    def residual(self, theta: Array) -> Array:
        """Return the torque (N,) N m that parameters and drive terms (q,) leave."""
        return self.rows.torque - self.H @ theta

    def rms(self, torque: Array) -> float:
        """Return the RMS of a torque (N,) N m over the samples."""
        return float(np.sqrt(np.average(torque**2, weights=self.rows.samples)))


class GravityRows:
    """Rows of all joints' trials, reduced, and how other errors would enter them."""

    def __init__(
        self,
        held: HeldJoints,
        surfaces: list[FrictionSurface | None],
        friction: FrictionStage,
        settings: GravitySettings = GravitySettings(),
    ) -> None:
        self.robot = held.robot
        self.held = held
        self.surfaces = surfaces
        self.settings = settings
        self.size = len(held.theta)
        # Behind the parameters: changes of all joints' offsets, then of their
        # asymmetries, then of the viscous ones, then of friction per kelvin.
        self.columns = self.size + DRIVE_TERMS * self.robot.n
        self.thermal = [
            _thermal_change(friction, name) for name in self.robot.joint_names
        ]
        self.trials_used = 0
        self.skipped_joints: list[str] = []
        self.joints: dict[int, JointRows] = {}
        # H^T F of each joint, and H^T of what no log shows
        self.cross: dict[int, Array] = {}
        self.deviations = [deviation.name for deviation in deviations(self.robot)]
        self.tolerances: dict[str, dict[int, Array]] = {
            name: {} for name in self.deviations
        }
        # H^T of one standard error of an acceleration's torque, or of where a joint
        # stands
        self.unseen: list[tuple[int, Array]] = []
        # Where the geometry is another, the whole of the bodies counts, not their base
        # parameters.
        standard = held.basis.representative[:, : self.size] @ held.theta
        links = standard[: 10 * self.robot.n].reshape(-1, 10)
        self.standard = links if self.robot.nominal is None else self.robot.nominal

    def add_joint(self, trials: list[Trial], joints: list[Accumulator]) -> None:
        """Add the trials of one joint, without the torque of residual acceleration."""
        if not trials:
            return
        j = trials[0].joint
        surface = self.surfaces[j]
        if surface is None:
            self.skipped_joints += [self.robot.joint_names[j]]
            return
        postures = configurations(trials, self.settings.trials)
        groups = corrections.without_acceleration(self.robot, postures, surface)
        rows = self._rows(groups, surface)
        if rows is None:
            return

        white = rows.whitened()
        H = self._among_all(white.unknowns, j)
        self.trials_used += len(np.unique(rows.trial))
        # A block is a motion: what a trial has for itself, the next one of the same
        # motion has as well (`regression.repeats`).
        for number in np.unique(rows.motion):
            for k, joint in enumerate(joints):
                joint.add(H, white.torque, (rows.motion == number) & (k == j))
        self.joints[j] = JointRows(H=self._among_all(rows.unknowns, j), rows=rows)

        self.cross[j] = H.T @ white.friction_error
        for name, torque in zip(self.deviations, white.deviation.T, strict=True):
            self.tolerances[name][j] = H.T @ torque
        for k, group in enumerate(groups):
            in_group = rows.group == k
            accelerated = group.std_error * white.acceleration * in_group
            self.unseen.append((j, H.T @ accelerated))
            # A joint that stands has the same reading all along a log.
            for number in np.unique(rows.log[in_group]):
                in_log = in_group & (rows.log == number)
                self.unseen += [(j, H.T @ (x * in_log)) for x in white.standing.T]

    def _among_all(self, unknowns: Array, joint: int) -> Array:
        """Return columns (N, q) of all unknowns from those (N, p + 4) of one joint."""
        H = np.zeros((len(unknowns), self.columns))
        H[:, : self.size] = unknowns[:, : self.size]
        H[:, self.size + joint :: self.robot.n] = unknowns[:, self.size :]
        return H

    def _rows(
        self, groups: list[SteadyGroup], surface: FrictionSurface
    ) -> TrialRows | None:
        """Return the rows of a joint's trials; None where no trial is long enough."""
        settled: list[Trial] = []
        group_numbers: list[int] = []
        for number, group in enumerate(groups):
            for trial in group.trials:
                part = trial.part(_settled(trial, surface, self.settings.fit))
                if len(part.q) >= GROUP_SIZE:
                    settled.append(part)
                    group_numbers.append(number)
        if not settled:
            return None

        gravity = self.held.means(settled)
        standing = self.held.unseen(settled)
        motions = _motions(settled, group_numbers)
        parts = [
            self._rows_of_trial(
                trial, surface, H, stood, number=n, group=group, motion=motion
            )
            for n, (trial, H, stood, group, motion) in enumerate(
                zip(settled, gravity, standing, group_numbers, motions, strict=True)
            )
        ]
        return TrialRows.joined(parts)

    def _rows_of_trial(
        self,
        trial: Trial,
        surface: FrictionSurface,
        H: Array,
        standing: Array,
        *,
        number: int,
        group: int,
        motion: int,
    ) -> TrialRows:
        """Return a trial's rows from its slices: H (K, p), standing (K, n) N m."""
        count = len(trial.q) // GROUP_SIZE
        slices_per_row = len(trial.q) / count

        def means(values: Array) -> Array:
            parts = np.array_split(values, count)
            return np.stack([part.mean(axis=0) for part in parts])

        def same(value: float) -> Array:
            return np.full(count, value)

        v = np.full(len(trial.q), trial.velocity)
        warmth = surface.warmed(np.full(len(v), trial.celsius))
        friction = warmth * surface.torque(trial.q, v)
        still = np.zeros_like(trial.places)
        deviation = deviation_torques(
            self.robot, self.standard, trial.places, still, still
        )
        deviation_columns = [torque[:, trial.joint] for torque in deviation.values()]
        no_columns = np.zeros((len(v), 0))
        return TrialRows(
            gravity=means(H),
            # What the surfaces have alike both ways is an unknown here, of which they
            # hold a first estimate; its error is not friction's.
            even=means(even_columns(surface, trial.q, v)),
            thermal=means(self._thermal_column(trial, surface, v)),
            friction_error=means(surface.error_columns(trial.q, v)),
            standing=means(standing),
            deviation=means(np.column_stack([no_columns, *deviation_columns])),
            acceleration=means(trial.ddq),
            torque=means(trial.tau - friction),
            friction=means(friction),
            friction_std=means(surface.stated_error(trial.q, v)),
            t=means(trial.t),
            samples=same(slices_per_row * trial.weight),
            seconds=same(slices_per_row * trial.seconds),
            trial=np.full(count, number, dtype=np.intp),
            log=np.full(count, trial.log, dtype=np.intp),
            group=np.full(count, group, dtype=np.intp),
            motion=np.full(count, motion, dtype=np.intp),
        )

    def _thermal_column(
        self, trial: Trial, surface: FrictionSurface, v: Array
    ) -> Array:
        """Return torque (K,) N m K per change of friction per kelvin.

        It is 0 without a sensor.
        """
        change = self.thermal[trial.joint]
        if change is None:
            return np.zeros(len(v))
        kelvin = surface.kelvin(np.full(len(v), trial.celsius))
        return thermal_column(surface, change, kelvin, trial.q, v)

    def prior(self, friction: FrictionStage) -> Prior:
        """Return the friction trials' prior of the drives' terms.

        Its rows have unit variance.
        """
        n = self.robot.n
        even = even_prior(self.surfaces, friction, self.robot.joint_names)
        thermal_weights = [
            1.0 if change is None else 1.0 / change.std_error for change in self.thermal
        ]
        A = np.zeros((DRIVE_TERMS * n, self.columns))
        A[: len(even.b), self.size : self.size + len(even.b)] = even.A
        A[len(even.b) :, self.size + len(even.b) :] = np.diag(thermal_weights)
        return Prior(A=A, b=np.concatenate([even.b, np.zeros(n)]))

    def tolerance_moves(self, solution: Solution) -> dict[str, Array]:
        """Return moves of the unknowns (q,) per standard deviation of tolerances.

        No log shows these tolerances.
        """
        moves = {}
        for name, crossed in self.tolerances.items():
            parts = [cross / solution.sigma[j] ** 2 for j, cross in crossed.items()]
            moves[name] = solution.bread @ np.sum(parts, axis=0)
        return moves

    def sensitivity(self, solution: Solution) -> Sensitivity:
        """Return moves of the unknowns (q,) with joints' friction coefficients (c,)."""
        return {
            j: -solution.bread @ (crossed / solution.sigma[j] ** 2)
            for j, crossed in self.cross.items()
        }


def _motions(trials: Sequence[Trial], groups: Sequence[int]) -> list[int]:
    """Number the motions of trials: their speeds, directions and postures."""
    levels = speed_levels(list(trials))
    level_of = {id(trial): k for k, level in enumerate(levels) for trial in level}
    numbers: dict[Hashable, int] = {}
    return [
        numbers.setdefault(
            (level_of[id(trial)], trial.velocity > 0.0, group), len(numbers)
        )
        for trial, group in zip(trials, groups, strict=True)
    ]


def _thermal_change(friction: FrictionStage, name: str) -> FrictionChange | None:
    if name not in friction.joints:
        return None
    return change_of(friction.joints[name], "thermal")


def _settled(
    trial: Trial, surface: FrictionSurface, settings: GravityFitSettings
) -> Mask:
    """Return a trial's slices (K,) at constant speed where friction is known."""
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
