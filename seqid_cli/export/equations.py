"""The torque of a form as linear equations on motions, summed up joint by joint.

A form that knows links, rotors, Coulomb and viscous friction has at joint j the torque

    tau_j = H_j pi + c_j s_j + d_j dq_j + o_j,

H the regressor of the base parameters pi (Eq. 4), s the sign of the joint's velocity, o
a constant, all low-passed as predictions are. Rows are those at which the joint slides.
Beside these columns stand two of what is no number of the form:

    the torque of effects that the form holds as they are,
    what the whole model leaves of the measured torque.

So one set of sums, A_j = sum x x' and b_j = sum x tau_j, tells the squared error of any
numbers, with and without the held effects, to the measured torque and to the model's.
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
from seqid_cli.typing import Array, Mask

# Coulomb, viscous and constant friction of a joint.
FRICTION_TERMS = 3


@dataclass(frozen=True, kw_only=True)
class CoulombViscous:
    """Coulomb and viscous friction of one joint, with an offset, as a friction law.

    Attributes
    ----------
    coulomb, viscous : float
        N m and N m s/rad (N and N s/m where prismatic).
    offset : float
        A constant torque, N m.
    sign_width : float
        Speed over which the direction of motion changes, rad/s.
    per_kelvin : float
        Share by which friction changes per kelvin.
    """

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
class Numbers:
    """What a form is given.

    Attributes
    ----------
    base : (b,) array
        All base parameters.
    friction : (n, 3) array
        Coulomb, viscous and constant friction.
    held : float
        1 where the form has the effects that it holds as they are, 0 where it has not.
    """

    base: Array
    friction: Array
    held: float = 1.0

    @classmethod
    def of(
        cls, model: ExportModel, identified: Identified, added: Array, *, held: float
    ) -> Self:
        """Return those of a model.

        Parameters
        ----------
        model : ExportModel
        identified : Identified
            Whose base parameters these are.
        added : (11 n,) array
            Standard parameters that are no part of the torque to be met.
        held : float
            1 where the model has the held effects, 0 where not.
        """
        friction = np.zeros((model.robot.n, FRICTION_TERMS))
        for j, fit in enumerate(model.friction):
            if fit is not None:
                offset = fit.offset if model.writes_offset else 0.0
                friction[j] = [fit.coulomb, fit.viscous, offset]
        base = identified.basis.expression @ (model.standard - added)
        return cls(base=base, friction=friction, held=held)

    def row(self, joint: int, *, of_model: bool = False) -> Array:
        """Return by what the columns of a joint's rows are multiplied.

        Parameters
        ----------
        joint : int
            The joint.
        of_model : bool
            Whether the whole model's torque is to be met instead of the measured one.

        Returns
        -------
        (m,) array
            One number for each column of `JointSums`.
        """
        # The torque to be met is without the held effects.
        beside = [self.held - 1.0, 1.0 if of_model else 0.0]
        return np.concatenate([self.base, self.friction[joint], beside])


@dataclass(frozen=True, kw_only=True)
class JointSums:
    """Sums over the sliding rows of each joint, as if each were `share` of a sample.

    There are m = b + 5 columns: base parameters, friction, held effects, and what the
    model leaves of the measured torque.

    Attributes
    ----------
    matrix : (n, m, m) array
        Products of the columns.
    right : (n, m) array
        Products of the columns and the measured torque.
    squares : (n,) array
        Squares of the measured torque, (N m)^2.
    counts : (n,) array
        Numbers of rows.
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
        """Number of all base parameters."""
        return int(self.right.shape[1]) - FRICTION_TERMS - 2

    def minus(self, part: "JointSums") -> "JointSums":
        """Return the sums over the rows that are not in a part."""
        return JointSums(
            matrix=self.matrix - part.matrix,
            right=self.right - part.right,
            squares=self.squares - part.squares,
            counts=self.counts - part.counts,
        )

    def drawn_to(self, numbers: Numbers, weights: Array) -> "JointSums":
        """Return the sums with rows of the torque of given numbers beside each row.

        Errors are not to be asked of the result, which has the squares of the measured
        torque alone.

        Parameters
        ----------
        numbers : Numbers
            Whose torque the sums are drawn to.
        weights : (n,) array
            How often its rows count, by joint.
        """
        torque = np.stack(
            [self.matrix[j] @ numbers.row(j) for j in range(self.n_joints)]
        )
        return JointSums(
            matrix=self.matrix * (1.0 + weights)[:, None, None],
            right=self.right + weights[:, None] * torque,
            squares=self.squares,
            counts=self.counts,
        )

    def squared_errors(self, numbers: Numbers, *, of_model: bool = False) -> Array:
        """Return the sums of the squared errors of numbers.

        Parameters
        ----------
        numbers : Numbers
            Of a form.
        of_model : bool
            Whether the error is against the whole model instead of the measured torque.

        Returns
        -------
        (n,) array
            (N m)^2.
        """
        errors = np.zeros(self.n_joints)
        for j in range(self.n_joints):
            x = numbers.row(j, of_model=of_model)
            explained = 2.0 * self.right[j] @ x - x @ self.matrix[j] @ x
            errors[j] = max(self.squares[j] - explained, 0.0)
        return errors


def sum_of(pieces: Sequence[JointSums]) -> JointSums:
    """Return the sums over the rows of all pieces."""
    return JointSums(
        matrix=np.sum([piece.matrix for piece in pieces], axis=0),
        right=np.sum([piece.right for piece in pieces], axis=0),
        squares=np.sum([piece.squares for piece in pieces], axis=0),
        counts=np.sum([piece.counts for piece in pieces], axis=0),
    )


def joint_sums(
    model: ExportModel,
    identified: Identified,
    samples: Sequence[TorqueSamples],
    *,
    pieces: int,
) -> tuple[JointSums, ...]:
    """Go through motions once, each cut into as many `pieces`.

    Parameters
    ----------
    model : ExportModel
        Whose arm it is.
    identified : Identified
        Its base parameters, and the rotors that are known.
    samples : sequence of TorqueSamples
        The motions, and the torque to be met.
    pieces : int
        How many.

    Returns
    -------
    tuple of JointSums
        The first pieces of all motions, the second ones, and so on.
    """
    robot = model.robot
    width = identified.basis.size + FRICTION_TERMS + 2
    matrix = np.zeros((pieces, robot.n, width, width))
    right = np.zeros((pieces, robot.n, width))
    squares = np.zeros((pieces, robot.n))
    counts = np.zeros((pieces, robot.n))

    reflected_rotors = gear_ratios(robot) ** 2 * identified.given_rotors
    for part in samples:
        # The rotors that are known are no unknowns: their torque goes to the right.
        motion = part.motion
        H = base_regressor(robot, identified.basis, motion.q, motion.dq, motion.ddq)
        H = motion.filtered(np.ascontiguousarray(H))
        torque = part.measured - motion.filtered(reflected_rotors * motion.ddq)
        beside = np.stack([part.held, part.measured - part.of_model], axis=2)
        columns = np.concatenate([H, friction_columns(motion), beside], axis=2)

        share = independent_share(motion)
        for piece, rows in enumerate(_pieces(part.sliding, pieces)):
            for j in range(robot.n):
                X = columns[rows[:, j], j]
                tau = torque[rows[:, j], j]
                matrix[piece, j] += share * (X.T @ X)
                right[piece, j] += share * (X.T @ tau)
                squares[piece, j] += share * (tau @ tau)
                counts[piece, j] += share * len(tau)

    return tuple(
        JointSums(
            matrix=matrix[k], right=right[k], squares=squares[k], counts=counts[k]
        )
        for k in range(pieces)
    )


def _pieces(sliding: Mask, pieces: int) -> list[Mask]:
    """Return the sliding rows (N, n) of each of consecutive pieces of a motion."""
    of_pieces = []
    for rows in np.array_split(np.arange(len(sliding)), pieces):
        inside = np.zeros_like(sliding)
        inside[rows] = sliding[rows]
        of_pieces.append(inside)
    return of_pieces


def friction_columns(motion: Motion) -> Array:
    """Return columns (N, n, 3) of Coulomb, viscous, constant friction, low-passed."""
    n_joints = motion.q.shape[1]
    unit = CoulombViscous(coulomb=1.0, viscous=0.0)
    sign = sampled_friction([unit] * n_joints, motion)
    columns = np.stack([sign, motion.dq, np.ones_like(sign)], axis=2)
    return motion.filtered(columns, times=2)
