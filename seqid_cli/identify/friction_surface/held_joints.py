"""Joints that stand while one moves: what they move, and what their counts hide, as gravity torque.

A controller holds a joint as well as its stiffness and friction let it. What it gives way by turns
with the direction of the joint that moves, and gravity with it, so that Eq. 15 would take it for
friction. Readings show it to a count: where a joint stands within that has the standard deviation
of a count over the root of 12.

Both become torque by the base parameters of gravity, of which a first estimate is enough:

    tau = H_g(q) pi_g + tau_f                                                             (17-19)
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.friction_surface.trials import Trial
from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.robot.base_parameters import Basis, base_parameters, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True)
class HeldJoints:
    """A first estimate `theta` (p,) of gravity's base parameters; none where it loads no joint."""

    robot: Robot
    basis: Basis
    theta: Array

    @classmethod
    def of(
        cls, robot: Robot, trials: Iterable[Trial], surfaces: Sequence[FrictionSurface | None]
    ) -> "HeldJoints":
        """Estimate gravity by the trials of joints whose friction is known, None of the others."""
        basis = base_parameters(robot, rotor=())
        none = cls(robot, basis, np.zeros(int(basis.gravity.sum())))
        joints = [Accumulator(len(none.theta)) for _ in range(robot.n)]
        for trial in trials:
            surface = surfaces[trial.joint]
            if surface is not None:
                y = trial.tau - surface.torque(trial.q, trial.dq)
                joints[trial.joint].add(none.columns(trial.joint, trial.places), y)
        return replace(none, theta=solve(joints).theta) if len(none.theta) else none

    def means(self, trial: Trial, q: Array) -> Array:
        """H_g (K, p) of a trial's joint, means over slices about positions q (K, n)."""
        # Gauss's two points: a slice is wide enough to take 1e-4 off gravity at its middle.
        ahead = np.zeros_like(q)
        ahead[:, trial.joint] = trial.velocity * trial.seconds / np.sqrt(12.0)
        return (self.columns(trial.joint, q - ahead) + self.columns(trial.joint, q + ahead)) / 2.0

    def columns(self, joint: int, q: Array) -> Array:
        """H_g (K, p) of a joint at positions q (K, n)."""
        zero = np.zeros_like(q)
        H = base_regressor(self.robot, self.basis, q, zero, zero)
        return np.asarray(H[:, joint, : len(self.theta)])

    def standing(self, group: Sequence[Trial], configuration: Array) -> list[Trial]:
        """The trials of one joint as if the others had stood at a configuration (n,)."""
        result = []
        for trial in group:
            stood = np.tile(configuration, (len(trial.q), 1))
            stood[:, trial.joint] = trial.q
            change = self.columns(trial.joint, trial.places) - self.columns(trial.joint, stood)
            result.append(replace(trial, tau=trial.tau - change @ self.theta))
        return result

    def doubt(self, group: Sequence[Trial]) -> list[Array]:
        """Torque (K,) N m of one standard error of how far joints gave way, trial by trial.

        The readings of both directions have errors of their own, of which friction feels half the
        difference. Those of joints whose readings never change are no part of it.
        """
        moved = np.ptp(np.concatenate([trial.places for trial in group]), axis=0) > 0.0
        found = []
        for trial in group:
            each = self.unseen(trial, trial.places) * moved / np.sqrt(2.0)
            most = int(np.argmax(np.sum(each**2, axis=0)))
            found.append(np.copysign(np.linalg.norm(each, axis=1), each[:, most]))
        return found

    def unseen(self, trial: Trial, q: Array) -> Array:
        """Torque (K, n) N m of one standard deviation of where each other joint stands.

        `q` (K, n): positions at which it is asked for.
        """
        aside = np.zeros((self.robot.n, 1, self.robot.n))
        for k in np.flatnonzero(trial.count > 0.0):
            aside[k, 0, k] = trial.count[k] / np.sqrt(12.0) if k != trial.joint else 0.0
        places = np.concatenate([q[None], q + aside]).reshape(-1, self.robot.n)
        torque = (self.columns(trial.joint, places) @ self.theta).reshape(-1, len(q))
        return np.asarray((torque[1:] - torque[0]).T)
