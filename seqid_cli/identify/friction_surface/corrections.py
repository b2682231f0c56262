"""Corrections of friction trials: residual acceleration, and joints that give way.

A controller never holds a speed exactly. With one joint moving, the torque of its
acceleration is d_kk ddq (Eq. 25), d_kk being one number per configuration of the other
joints. The ramps up to the speed and back down determine it: over windows of them and
over the slices of the trial itself,

    tau - f(q, dq) = a(q)' p_xi + d_kk ddq,

with friction f as far as it is known and gravity as in Eq. 12. Friction that is not
quite right adds to d_kk in one ramp what it takes off in the other. Where nothing
determines d_kk it is taken as zero, and as uncertain by what the other configurations
show. Where they show nothing either, its error (`inertia_error`) is so large that all
torque of the trials may be acceleration's.

A controller holds a joint as well as its stiffness and friction let it. What it gives
way by turns with the direction of the joint that moves, and gravity with it, so that
Eq. 15 would take it for friction. Readings show it to a count: where a joint stands
within that has the standard deviation of a count over the root of 12. Both become
torque by the base parameters of gravity, of which a first estimate is enough:

    tau = H_g(q) pi_g + tau_f                                                  (17-19)
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.friction_surface.gravity_separation import Clustered
from seqid_cli.identify.friction_surface.trials import Trial
from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.robot.base_parameters import (
    Basis,
    base_parameters,
    gravity_base_regressor,
)
from seqid_cli.robot.kinematics import gravity_columns
from seqid_cli.robot.types import Robot
from seqid_cli.robust import PER_MEDIAN
from seqid_cli.typing import Array

# Windows of ramps that a configuration needs, for its inertia to be determined.
MIN_WINDOWS = 6
# Slices are left out that are pushed by more than so many times noise and usual push.
MAX_PUSH_RATIO = 2.0


@dataclass(frozen=True, kw_only=True)
class SteadyGroup:
    """Trials in one configuration with the torque of acceleration taken off.

    `inertia` is d_kk as it was used, kg m^2 (kg where prismatic).
    """

    trials: list[Trial]
    inertia: float
    std_error: float


@dataclass(frozen=True, kw_only=True)
class RampInertia:
    """The inertia d_kk of one configuration, by its ramps.

    `white_variance` is its variance for white noise, `robust_variance` that robust
    within trials, of which there are `trials`.
    """

    value: float
    white_variance: float
    robust_variance: float
    trials: int


def without_acceleration(
    robot: Robot, groups: Sequence[list[Trial]], surface: FrictionSurface
) -> list[SteadyGroup]:
    """Take the torque of residual acceleration (Eq. 25) off a joint's `configurations`.

    So is what friction, by a first estimate, differs by as the speed is not quite
    constant.
    """
    by_group = [_inertia_of(robot, group, surface) for group in groups]
    determined = [inertia for inertia in by_group if inertia is not None]
    usual = 0.0
    if determined:
        usual = float(np.sqrt(np.mean([inertia.value**2 for inertia in determined])))
    inflation = _inflation(determined)

    result = []
    for group, ramp_inertia in zip(groups, by_group, strict=True):
        inertia = 0.0
        std_error = usual
        if ramp_inertia is not None:
            inertia = max(ramp_inertia.value, 0.0)
            white = ramp_inertia.white_variance * inflation
            std_error = float(np.sqrt(max(ramp_inertia.robust_variance, white)))
        largest_error = std_error
        if not determined:  # all torque of the trials could be acceleration's
            torque = max(float(np.median(np.abs(trial.tau))) for trial in group)
            accelerated = max(float(np.sqrt(np.mean(trial.ddq**2))) for trial in group)
            largest_error = torque / accelerated if accelerated > 0.0 else 0.0
        trials = [
            replace(_steady(trial, inertia, surface), inertia_error=largest_error)
            for trial in group
        ]
        result.append(SteadyGroup(trials=trials, inertia=inertia, std_error=std_error))
    return result


def _inflation(inertias: Sequence[RampInertia]) -> float:
    """Return how many times the variance is that of white noise, by all configurations.

    Few trials by themselves do not show what they share.
    """
    trials = np.array([inertia.trials for inertia in inertias], dtype=np.float64)
    white = np.array([inertia.white_variance for inertia in inertias])
    robust = np.array([inertia.robust_variance for inertia in inertias])
    if not (white > 0).any():
        return 1.0
    return max(float(trials @ robust / (trials @ white)), 1.0)


def _steady(trial: Trial, inertia: float, surface: FrictionSurface) -> Trial:
    """Return the trial at its mean velocity, without strongly accelerated slices."""
    # At its ends a trial settles faster than its path: what is taken off is as wrong as
    # large.
    mean_velocity = np.full(len(trial.q), trial.velocity)
    push = inertia * trial.ddq
    friction_change = surface.torque(trial.q, trial.dq) - surface.torque(
        trial.q, mean_velocity
    )
    tau = trial.tau - (push + friction_change)
    noise = PER_MEDIAN * float(np.median(np.abs(np.diff(tau, 2)))) / np.sqrt(6.0)
    usual_push = float(np.median(np.abs(push)))
    is_steady = np.abs(push) <= MAX_PUSH_RATIO * np.hypot(noise, usual_push)
    return replace(trial, tau=tau).part(is_steady)


def _inertia_of(
    robot: Robot, group: list[Trial], surface: FrictionSurface
) -> RampInertia | None:
    """Return d_kk of one configuration; None where its ramps do not determine it."""
    low, high = surface.scaling.speed
    all_rows: list[Array] = []  # [ddq, a | torque], by the root of the weight
    trial_numbers: list[int] = []
    n_windows = 0
    for number, trial in enumerate(group):
        # Windows at speeds at which friction was seen; the others hold a reversal or a
        # rest.
        speed = np.abs(trial.ramps.dq)
        is_known = (speed >= low) & (speed <= high)
        n_windows += int(is_known.sum())
        for part, chosen in ((trial, slice(None)), (trial.ramps, is_known)):
            q = part.q[chosen]
            a = gravity_columns(robot, trial.joint, group[0].configuration, q)
            y = part.tau[chosen] - surface.torque(q, part.dq[chosen])
            rows = np.column_stack([part.ddq[chosen], a, y]) * np.sqrt(part.weight)
            all_rows.append(rows)
            trial_numbers += [number] * len(q)
    if n_windows < MIN_WINDOWS:
        return None

    table = np.vstack(all_rows)
    fit = Clustered.of(table[:, :-1], table[:, -1], np.array(trial_numbers, np.intp))
    n_trials = len(fit.moves)
    n_spare = len(fit.residual) - len(fit.theta)
    residual_variance = float(fit.residual @ fit.residual) / max(n_spare, 1)
    squared_moves = float(np.sum(fit.moves[:, 0] ** 2))
    return RampInertia(
        value=float(fit.theta[0]),
        white_variance=residual_variance * float(fit.bread[0, 0]),
        robust_variance=n_trials / max(n_trials - 1, 1) * squared_moves,
        trials=n_trials,
    )


@dataclass(frozen=True)
class HeldJoints:
    """A first estimate `theta` (p,) of gravity's base parameters.

    It is empty where gravity loads no joint.
    """

    robot: Robot
    basis: Basis
    theta: Array

    @classmethod
    def of(
        cls,
        robot: Robot,
        trials: Iterable[Trial],
        surfaces: Sequence[FrictionSurface | None],
    ) -> "HeldJoints":
        """Estimate gravity by the trials of joints with known friction.

        `surfaces` has None for a joint whose friction is not known yet.
        """
        basis = base_parameters(robot, rotor=())
        size = int(basis.gravity.sum())
        unloaded = cls(robot, basis, np.zeros(size))
        if not size:
            return unloaded
        all_trials = list(trials)
        joints = [Accumulator(size) for _ in range(robot.n)]
        for j, surface in enumerate(surfaces):
            joint_trials = [trial for trial in all_trials if trial.joint == j]
            if surface is None or not joint_trials:
                continue
            columns = unloaded.columns_of(j, [trial.places for trial in joint_trials])
            for trial, H in zip(joint_trials, columns, strict=True):
                joints[j].add(H, trial.tau - surface.torque(trial.q, trial.dq))
        return replace(unloaded, theta=solve(joints).theta)

    def means(self, group: Sequence[Trial]) -> list[Array]:
        """Return H_g (K, p) of one joint's trials, means over their slices."""
        # Gauss's two points: a slice is wide enough to take 1e-4 off gravity at its
        # middle.
        joint = group[0].joint
        direction = np.eye(1, self.robot.n, joint)
        points: list[Array] = []
        for trial in group:
            offset = direction * trial.velocity * trial.seconds / np.sqrt(12.0)
            points += [trial.places - offset, trial.places + offset]
        columns = self.columns_of(joint, points)
        pairs = zip(columns[::2], columns[1::2], strict=True)
        return [(first + second) / 2.0 for first, second in pairs]

    def columns_of(self, joint: int, places: Sequence[Array]) -> list[Array]:
        """Return H_g (K, p) of a joint at each of several sets of positions (K, n)."""
        # All at once: a call costs as much as a thousand positions.
        H = gravity_base_regressor(self.robot, self.basis, np.concatenate(places))
        ends = np.cumsum([len(q) for q in places])
        return np.split(H[:, joint], ends[:-1])

    def standing(self, group: Sequence[Trial]) -> list[Trial]:
        """Return a joint's trials as if held joints stood as in the first trial."""
        joint = group[0].joint
        is_moving = np.arange(self.robot.n) == joint
        first = group[0].configuration
        stood = [np.where(is_moving, trial.q[:, None], first) for trial in group]
        logged = self.columns_of(joint, [trial.places for trial in group])
        as_in_first = self.columns_of(joint, stood)
        return [
            replace(trial, tau=trial.tau - (H - H_first) @ self.theta)
            for trial, H, H_first in zip(group, logged, as_in_first, strict=True)
        ]

    def doubt(self, group: Sequence[Trial]) -> list[Array]:
        """Return the torque (K,) N m of one standard error of how far joints gave way.

        It is that of each trial. Readings of both directions have errors of their own,
        of which friction feels half the difference. Those of joints whose readings
        never change are no part of it.
        """
        places = np.concatenate([trial.places for trial in group])
        has_moved = np.ptp(places, axis=0) > 0.0
        doubts = []
        for torque in self.unseen(group):
            of_joints = torque * has_moved / np.sqrt(2.0)
            largest = int(np.argmax(np.sum(of_joints**2, axis=0)))
            size = np.linalg.norm(of_joints, axis=1)
            doubts.append(np.copysign(size, of_joints[:, largest]))
        return doubts

    def unseen(self, group: Sequence[Trial]) -> list[Array]:
        """Return the torque (K, n) N m of one standard deviation of where others stand.

        It is that of each trial, by the counts of the joints' encoders.
        """
        joint = group[0].joint
        n = self.robot.n
        places = []
        for trial in group:
            has_count = (np.arange(n) != joint) & (trial.count > 0.0)
            std = np.where(has_count, trial.count / np.sqrt(12.0), 0.0)
            displaced = trial.places + np.diag(std)[:, None, :]
            all_places = np.concatenate([trial.places[None], displaced])
            places.append(all_places.reshape(-1, n))
        torques = []
        for H in self.columns_of(joint, places):
            torque = (H @ self.theta).reshape(n + 1, -1)
            torques.append((torque[1:] - torque[0]).T)
        return torques
