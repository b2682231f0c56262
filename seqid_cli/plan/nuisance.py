"""Nuisance terms of every drive, marginalised as the stages will marginalise them.

A stage fits its parameters beside nuisance terms with priors of zero mean. With rows H
of the parameters and X of these terms, W the information of the rows and P that of the
priors, the information that remains on the parameters is

    H'W H - H'W X (X'W X + P)^-1 X'W H.

Slow sweeps (gravity) have two terms for each joint: a constant torque, and a share of
friction's size |f| that does not turn with the direction. Fast moves (inertia, payload)
have a constant torque for each joint and d tau / dt, the torque of a delay: one for all
joints, one for each. Columns of X are scaled to priors of standard deviation 1, so that
P is the identity.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.robust import rms
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class NuisancePriors:
    """Standard deviations of the terms before any log; the stages have the same.

    Parameters
    ----------
    sweep_offset : float
        Constant torque of slow sweeps, over the RMS of the joint's friction.
    sweep_asymmetry : float
        Share of friction that does not turn with the direction.
    move_offset : float
        Constant torque of fast moves, over the RMS of the joint's friction.
    common_delay_s : float
        Delay of the torque against the positions that all joints have [s].
    joint_delay_s : float
        What one joint's delay differs by [s].
    """

    sweep_offset: float = 0.1
    sweep_asymmetry: float = 0.1
    move_offset: float = 0.05
    common_delay_s: float = 3e-3
    joint_delay_s: float = 6e-4


@dataclass(frozen=True, kw_only=True)
class JointRows:
    """Rows of one joint's equation of motion, in time order where they are of a move.

    Parameters
    ----------
    joint : int
    H : (N, b) float
        Columns of the unknowns.
    weight : (N,) float
        Information of each row, per (N m)^2.
    friction : (N,) float
        Size |f| of the joint's friction [N m].
    torque_rate : (N,) float, optional
        d tau / dt [N m/s]; None where no torque is known.
    """

    joint: int
    H: Array
    weight: Array
    friction: Array
    torque_rate: Array | None = None


class Terms(Protocol):
    """Columns of nuisance terms: each scaled to a prior of standard deviation 1."""

    def __call__(self, rows: JointRows, joints: int) -> Array:
        """Return columns (N, k) of the terms of all joints."""


def sweep_terms(
    rows: JointRows, joints: int, priors: NuisancePriors = NuisancePriors()
) -> Array:
    """Return the columns of slow sweeps.

    Parameters
    ----------
    rows : JointRows
        N rows of one joint.
    joints : int
        Number n of all joints.
    priors : NuisancePriors

    Returns
    -------
    (N, 2 n) array
        Offset and asymmetry of each joint, in this order; zero for other joints.
    """
    columns = np.zeros((len(rows.weight), 2 * joints))
    columns[:, 2 * rows.joint] = priors.sweep_offset * rms(rows.friction)
    columns[:, 2 * rows.joint + 1] = priors.sweep_asymmetry * rows.friction
    return columns


def move_terms(
    rows: JointRows, joints: int, priors: NuisancePriors = NuisancePriors()
) -> Array:
    """Return the columns of fast moves.

    Parameters
    ----------
    rows : JointRows
        N rows of one joint.
    joints : int
        Number n of all joints.
    priors : NuisancePriors

    Returns
    -------
    (N, 2 n + 1) array
        The common delay, then offset and delay of each joint; zero for other joints.
    """
    columns = np.zeros((len(rows.weight), 2 * joints + 1))
    columns[:, 2 * rows.joint + 1] = priors.move_offset * rms(rows.friction)
    if rows.torque_rate is not None:
        columns[:, 0] = priors.common_delay_s * rows.torque_rate
        columns[:, 2 * rows.joint + 2] = priors.joint_delay_s * rows.torque_rate
    return columns


class NuisanceInformation:
    """Sums over rows of X'W H and X'W X, for k nuisance terms and b unknowns."""

    def __init__(self, joints: int, unknowns: int, terms: Terms) -> None:
        self.joints = joints
        self.terms = terms

        # The number of terms is that of the columns that they give, if of no rows.
        no_values = np.zeros(0)
        no_rows = JointRows(
            joint=0, H=np.zeros((0, unknowns)), weight=no_values, friction=no_values
        )
        n_terms = terms(no_rows, joints).shape[1]
        self.H_X = np.zeros((unknowns, n_terms))
        self.X_X = np.zeros((n_terms, n_terms))

    def add(self, rows: JointRows) -> None:
        """Add rows of one joint."""
        X = self.terms(rows, self.joints)
        weighted_X = rows.weight[:, None] * X
        self.H_X += rows.H.T @ weighted_X
        self.X_X += X.T @ weighted_X

    @property
    def lost(self) -> Array:
        """Information (b, b) on the unknowns that the terms take away."""
        with_prior = self.X_X + np.eye(len(self.X_X))
        return np.asarray(self.H_X @ np.linalg.solve(with_prior, self.H_X.T))


def friction_size(
    surface: FrictionSurface | None,
    assumed: float,
    q: Array,
    dq: Array,
    *,
    slowest: float,
) -> Array:
    """Return the size |f| of a joint's friction, held below the `slowest` speed.

    Parameters
    ----------
    surface : FrictionSurface, optional
    assumed : float
        Friction where there is no surface [N m].
    q, dq : (N,) float
        Positions and speeds of the joint [rad, rad/s].
    slowest : float
        Speed below which the sign of friction is not certain [rad/s]: such samples
        count little, and a step of friction would look like a rate of the torque.

    Returns
    -------
    (N,) array
        Friction torque without its sign [N m].
    """
    if surface is None:
        return np.full(len(q), assumed)
    direction = np.where(dq < 0.0, -1.0, 1.0)
    speed = direction * np.maximum(np.abs(dq), slowest)
    return np.abs(surface.torque(q, speed))
