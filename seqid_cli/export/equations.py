"""Equations of a form's torque on motions, joint by joint.

A form that knows links, rotors, Coulomb and viscous friction has the torque

    tau_j = H_j pi + c_j s_j + d_j dq_j + o_j

at joint j: H the regressor of the base parameters pi (Eq. 4), s the sign of the joint's
velocity, o a constant, all low-passed as predictions are. The sums of one joint,

    A_j = sum x x',   b_j = sum x tau_j,   x = (H_j, s_j, dq_j, 1),

are kept apart from those of the others, so that joints can be weighed after the motions
have been gone through once. Rows are those at which the joint slides.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from seqid_cli.export.model import ExportModel
from seqid_cli.export.motions import TorqueSamples
from seqid_cli.identify.regression.equations import independent_share
from seqid_cli.model.bodies.nearest import Identified
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.base_parameters import base_regressor, gear_ratios
from seqid_cli.typing import Array

# Coulomb, viscous and constant friction of a joint.
FRICTION_TERMS = 3


@dataclass(frozen=True)
class CoulombViscous:
    """Coulomb and viscous friction of one joint, with an offset, as a law of friction."""

    coulomb: float
    viscous: float
    offset: float = 0.0
    sign_width: float = 0.0
    per_kelvin: float = 0.0

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque (N,) N m at positions and velocities (N,)."""
        return self.coulomb * np.sign(v) + self.viscous * v + self.offset

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) of temperatures: none is held."""
        return np.ones(len(celsius))


@dataclass(frozen=True, kw_only=True)
class JointSums:
    """Sums over the sliding rows of each joint, by independent samples.

    With k = b + 3 unknowns (the base parameters, then the joint's friction): `matrix`
    (n, k, k), `right` (n, k), `squares` (n,) (N m)^2 of the torque, `counts` (n,).
    """

    matrix: Array
    right: Array
    squares: Array
    counts: Array

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.counts)

    @property
    def n_base(self) -> int:
        """Number of base parameters."""
        return int(self.right.shape[1]) - FRICTION_TERMS

    def unknowns(self, joint: int) -> list[int]:
        """Return where a joint's unknowns stand among those of the whole arm."""
        return [*range(self.n_base), *self.friction_rows(joint)]

    def friction_rows(self, joint: int) -> list[int]:
        """Return where a joint's Coulomb, viscous and constant friction stand."""
        first = self.n_base + FRICTION_TERMS * joint
        return list(range(first, first + FRICTION_TERMS))

    def torque_rms(self) -> Array:
        """Return the RMS (n,) N m of each joint's torque, 0 where it never slides."""
        return np.sqrt(self.squares / np.maximum(self.counts, 1e-12))

    def residual_rms(self, values: Array) -> Array:
        """Return the RMS (n,) N m that values (b + 3 n,) of the unknowns leave."""
        squares = np.zeros(self.n_joints)
        for j in range(self.n_joints):
            x = values[self.unknowns(j)]
            explained = 2.0 * self.right[j] @ x - x @ self.matrix[j] @ x
            squares[j] = max(self.squares[j] - explained, 0.0)
        return np.sqrt(squares / np.maximum(self.counts, 1e-12))

    def scaled(self, factor: float) -> "JointSums":
        """Return the sums as if each sample counted `factor` times."""
        return JointSums(
            matrix=factor * self.matrix,
            right=factor * self.right,
            squares=factor * self.squares,
            counts=factor * self.counts,
        )

    def plus(self, more: "JointSums") -> "JointSums":
        """Return the sums over both sets of rows."""
        return JointSums(
            matrix=self.matrix + more.matrix,
            right=self.right + more.right,
            squares=self.squares + more.squares,
            counts=self.counts + more.counts,
        )

    @classmethod
    def of(
        cls,
        model: ExportModel,
        demand: Identified,
        samples: Sequence[TorqueSamples],
        added: Array,
    ) -> Self:
        """Go through motions once.

        Parameters
        ----------
        model : ExportModel
            Its bodies say the base parameters that the file's logs did not determine.
        demand : Identified
            The file's base parameters.
        samples : sequence of TorqueSamples
            The motions, and the torque to be met.
        added : (11 n,) array
            Standard parameters that are no part of that torque.
        """
        robot = model.robot
        rows = list(demand.rows)
        n_joints = robot.n
        width = len(rows) + FRICTION_TERMS
        matrix = np.zeros((n_joints, width, width))
        right = np.zeros((n_joints, width))
        squares = np.zeros(n_joints)
        counts = np.zeros(n_joints)

        fixed = _undetermined_values(demand, model, added)
        reflected_rotors = gear_ratios(robot) ** 2 * demand.known
        for part in samples:
            motion = part.motion
            H = base_regressor(robot, demand.basis, motion.q, motion.dq, motion.ddq)
            H = motion.filtered(np.ascontiguousarray(H))
            rotor_torque = motion.filtered(reflected_rotors * motion.ddq)
            torque = part.measured - rotor_torque - H @ fixed
            friction = friction_columns(motion)
            share = independent_share(motion)
            for j in range(n_joints):
                slides = part.sliding[:, j]
                X = np.hstack([H[slides, j][:, rows], friction[slides, j]])
                y = torque[slides, j]
                matrix[j] += share * (X.T @ X)
                right[j] += share * (X.T @ y)
                squares[j] += share * (y @ y)
                counts[j] += share * slides.sum()
        return cls(matrix=matrix, right=right, squares=squares, counts=counts)


def _undetermined_values(demand: Identified, model: ExportModel, added: Array) -> Array:
    """Return all base parameters (size,), zero where the logs determined them."""
    standard = np.concatenate([model.bodies.ravel(), model.nearest.rotor])
    values = demand.basis.expression @ (standard - added)
    values[list(demand.rows)] = 0.0
    return np.asarray(values)


def friction_columns(motion: Motion) -> Array:
    """Return columns (N, n, 3) of Coulomb, viscous and constant friction, low-passed."""
    n_joints = motion.q.shape[1]
    sign = sampled_friction([CoulombViscous(1.0, 0.0)] * n_joints, motion)
    columns = np.stack([sign, motion.dq, np.ones_like(sign)], axis=2)
    return motion.filtered(columns, times=2)
