"""What friction trials hold besides friction and gravity: acceleration left, joints that give way.

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

    tau = H_g(q) pi_g + tau_f                                                             (17-19)
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

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


class SteadyGroup(NamedTuple):
    """Trials in one configuration with the torque of acceleration taken off."""

    trials: list[Trial]
    inertia: float  # d_kk as it was used, kg m^2 (kg where prismatic)
    std_error: float


def without_acceleration(
    robot: Robot, groups: Sequence[list[Trial]], surface: FrictionSurface
) -> list[SteadyGroup]:
    """Take the torque of what acceleration is left (Eq. 25) off a joint's `configurations`."""
    # So is what friction, by a first estimate, differs by as the speed is not quite
    # constant.
    found = [_inertia_of(robot, group, surface) for group in groups]
    known = np.array([one for one in found if one is not None]).reshape(-1, 4)
    value, white, robust, count = known.T
    usual = float(np.sqrt(np.mean(value**2))) if len(known) else 0.0
    # How many times the variance is that of white noise, by all configurations: few
    # trials by themselves do not show what they share.
    inflation = (
        max(float(count @ robust / (count @ white)), 1.0) if (white > 0).any() else 1.0
    )
    result = []
    for group, own in zip(groups, found, strict=True):
        inertia, error = 0.0, usual
        if own is not None:
            inertia, error = (
                max(own[0], 0.0),
                float(np.sqrt(max(own[2], own[1] * inflation))),
            )
        largest = error
        if not len(known):  # all torque of the trials could be acceleration's
            torque = max(float(np.median(np.abs(trial.tau))) for trial in group)
            accelerated = max(float(np.sqrt(np.mean(trial.ddq**2))) for trial in group)
            largest = torque / accelerated if accelerated > 0.0 else 0.0
        steady = [
            replace(_steady(t, inertia, surface), inertia_error=largest) for t in group
        ]
        result.append(SteadyGroup(steady, inertia, error))
    return result


def _steady(
    trial: Trial, inertia: float, surface: FrictionSurface, *, max_ratio: float = 2.0
) -> Trial:
    """The trial at its mean velocity, without the slices of more than noise and usual push."""
    # At its ends a trial settles faster than its path: what is taken off is as wrong as
    # large.
    mean, pushed = np.full(len(trial.q), trial.velocity), inertia * trial.ddq
    tau = trial.tau - (
        pushed + surface.torque(trial.q, trial.dq) - surface.torque(trial.q, mean)
    )
    noise = PER_MEDIAN * float(np.median(np.abs(np.diff(tau, 2)))) / np.sqrt(6.0)
    kept = np.abs(pushed) <= max_ratio * np.hypot(
        noise, float(np.median(np.abs(pushed)))
    )
    return replace(trial, tau=tau).part(kept)


def _inertia_of(
    robot: Robot, group: list[Trial], surface: FrictionSurface, *, min_windows: int = 6
) -> tuple[float, float, float, int] | None:
    """d_kk of one configuration, None where its ramps do not determine it."""
    # Its variance for white noise follows, that robust within trials, and the number of
    # these.
    low, high = surface.scaling.speed
    # columns: ddq, a, torque, each by the root of the weight; trial
    rows, windows = [], 0
    for number, trial in enumerate(group):
        # Windows at speeds at which friction was seen; the others hold a reversal or a
        # rest.
        speed = np.abs(trial.ramps.dq)
        kept = (speed >= low) & (speed <= high)
        windows += int(kept.sum())
        for part, own in ((trial, slice(None)), (trial.ramps, kept)):
            q = part.q[own]
            a = gravity_columns(robot, trial.joint, group[0].configuration, q)
            y = part.tau[own] - surface.torque(q, part.dq[own])
            weighted = np.column_stack([part.ddq[own], a, y]) * np.sqrt(part.weight)
            rows.append(np.column_stack([weighted, np.full(len(q), number)]))
    if windows < min_windows:
        return None
    table = np.vstack(rows)
    found = Clustered.of(table[:, :-2], table[:, -2], table[:, -1].astype(np.intp))
    count, spare = len(found.moves), len(found.left) - len(found.theta)
    robust = count / max(count - 1, 1) * float(np.sum(found.moves[:, 0] ** 2))
    white = float(found.left @ found.left) / max(spare, 1) * float(found.bread[0, 0])
    return float(found.theta[0]), white, robust, count


@dataclass(frozen=True)
class HeldJoints:
    """A first estimate `theta` (p,) of gravity's base parameters; none where it loads no joint."""

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
        """Estimate gravity by the trials of joints whose friction is known, None of the others."""
        basis = base_parameters(robot, rotor=())
        none = cls(robot, basis, np.zeros(int(basis.gravity.sum())))
        joints = [Accumulator(len(none.theta)) for _ in range(robot.n)]
        for j, surface in enumerate(surfaces if len(none.theta) else ()):
            own = [trial for trial in trials if trial.joint == j]
            if surface is None or not own:
                continue
            each = none.columns_of(j, [trial.places for trial in own])
            for trial, H in zip(own, each, strict=True):
                joints[j].add(H, trial.tau - surface.torque(trial.q, trial.dq))
        return replace(none, theta=solve(joints).theta) if len(none.theta) else none

    def means(self, group: Sequence[Trial]) -> list[Array]:
        """H_g (K, p) of one joint's trials, means over their slices."""
        # Gauss's two points: a slice is wide enough to take 1e-4 off gravity at its
        # middle.
        joint, ends = group[0].joint, []
        for trial in group:
            ahead = (
                np.eye(1, self.robot.n, joint)
                * trial.velocity
                * trial.seconds
                / np.sqrt(12.0)
            )
            ends += [trial.places - ahead, trial.places + ahead]
        every = self.columns_of(joint, ends)
        return [(a + b) / 2.0 for a, b in zip(every[::2], every[1::2], strict=True)]

    def columns_of(self, joint: int, places: Sequence[Array]) -> list[Array]:
        """H_g (K, p) of a joint at each of several sets of positions (K, n)."""
        # All at once: a call costs as much as a thousand positions.
        H = gravity_base_regressor(self.robot, self.basis, np.concatenate(places))[
            :, joint
        ]
        return np.split(H, np.cumsum([len(q) for q in places])[:-1])

    def standing(self, group: Sequence[Trial]) -> list[Trial]:
        """The trials of one joint as if the others had stood where they did in the first."""
        joint, first = group[0].joint, group[0].configuration
        moves = np.arange(self.robot.n) == joint
        stood = [np.where(moves, trial.q[:, None], first) for trial in group]
        was = self.columns_of(joint, [trial.places for trial in group])
        pairs = zip(group, was, self.columns_of(joint, stood), strict=True)
        return [
            replace(trial, tau=trial.tau - (H - G) @ self.theta)
            for trial, H, G in pairs
        ]

    def doubt(self, group: Sequence[Trial]) -> list[Array]:
        """Torque (K,) N m of one standard error of how far joints gave way, trial by trial."""
        # Readings of both directions have errors of their own, of which friction feels
        # half the difference. Those of joints whose readings never change are no part
        # of it.
        moved = np.ptp(np.concatenate([trial.places for trial in group]), axis=0) > 0.0
        each = [own * moved / np.sqrt(2.0) for own in self.unseen(group)]
        signed = zip(
            each, [int(np.argmax(np.sum(own**2, axis=0))) for own in each], strict=True
        )
        return [
            np.copysign(np.linalg.norm(own, axis=1), own[:, k]) for own, k in signed
        ]

    def unseen(self, group: Sequence[Trial]) -> list[Array]:
        """Torque (K, n) N m of one standard deviation of where others stand, trial by trial."""
        joint, n = group[0].joint, self.robot.n
        about = []
        for trial in group:
            others = (np.arange(n) != joint) & (trial.count > 0.0)
            aside = np.diag(np.where(others, trial.count / np.sqrt(12.0), 0.0))[
                :, None, :
            ]
            about.append(
                np.concatenate([trial.places[None], trial.places + aside]).reshape(
                    -1, n
                )
            )
        torques = [
            (H @ self.theta).reshape(n + 1, -1) for H in self.columns_of(joint, about)
        ]
        return [(torque[1:] - torque[0]).T for torque in torques]
