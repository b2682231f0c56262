"""What every drive adds to its torque unasked, marginalised as the stages will marginalise it.

A stage fits its parameters beside nuisance terms with priors of zero mean. With rows H
of the parameters and X of these terms, W the information of the rows and P that of the
priors, what is left of the information on the parameters is

    H'W H - H'W X (X'W X + P)^-1 X'W H.

Slow sweeps (gravity) have two terms for each joint: a constant torque, and a share of
friction's size |f| that does not turn with the direction. Fast moves (inertia, payload)
have a constant torque for each joint and d tau / dt, the torque of a delay: one for all
joints, one for each.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from seqid_cli.model.friction import FrictionSurface
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
    """Return the columns (N, 2 n) of slow sweeps: offset and asymmetry of each joint."""
    columns = np.zeros((len(rows.weight), 2 * joints))
    columns[:, 2 * rows.joint] = priors.sweep_offset * _rms(rows.friction)
    columns[:, 2 * rows.joint + 1] = priors.sweep_asymmetry * rows.friction
    return columns


def move_terms(
    rows: JointRows, joints: int, priors: NuisancePriors = NuisancePriors()
) -> Array:
    """Return the columns (N, 2 n + 1) of fast moves: common delay, delay and offset of each."""
    columns = np.zeros((len(rows.weight), 2 * joints + 1))
    columns[:, 2 * rows.joint + 1] = priors.move_offset * _rms(rows.friction)
    if rows.torque_rate is not None:
        columns[:, 0] = priors.common_delay_s * rows.torque_rate
        columns[:, 2 * rows.joint + 2] = priors.joint_delay_s * rows.torque_rate
    return columns


class NuisanceInformation:
    """Sums over rows of what nuisance terms (k) share with the unknowns (b)."""

    def __init__(self, joints: int, unknowns: int, terms: Terms) -> None:
        self.joints, self.terms = joints, terms
        count = terms(_no_rows(unknowns), joints).shape[1]
        self.cross = np.zeros((unknowns, count))
        self.own = np.zeros((count, count))

    def add(self, rows: JointRows) -> None:
        """Add rows of one joint."""
        X = self.terms(rows, self.joints)
        weighted = rows.weight[:, None] * X
        self.cross += rows.H.T @ weighted
        self.own += X.T @ weighted

    @property
    def lost(self) -> Array:
        """Information (b, b) on the unknowns that the terms take away."""
        inner = self.own + np.eye(len(self.own))
        return np.asarray(self.cross @ np.linalg.solve(inner, self.cross.T))


def _no_rows(unknowns: int) -> JointRows:
    nothing = np.zeros(0)
    return JointRows(
        joint=0, H=np.zeros((0, unknowns)), weight=nothing, friction=nothing
    )


def friction_size(
    surface: FrictionSurface | None,
    assumed: float,
    q: Array,
    dq: Array,
    *,
    slowest: float,
) -> Array:
    """Return the size |f| (N,) N m of a joint's friction, held below the `slowest` speed.

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
    """
    if surface is None:
        return np.full(len(q), assumed)
    speed = np.where(dq < 0.0, -1.0, 1.0) * np.maximum(np.abs(dq), slowest)
    return np.abs(surface.torque(q, speed))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
