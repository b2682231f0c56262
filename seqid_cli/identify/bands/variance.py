"""Variance of a predicted torque by the errors of the model's parameters.

The torque of joint j at a sample has the error

    e_j = h_j d theta + x_j d c_j.

h_j is the regressor of the base parameters theta, x_j the columns of the joint's
friction surface, and c_j its coefficients. C and C_j are the covariances of theta and
c_j in the parameter file, and T_j = d theta / d c_j. Then

    var(e_j) = h_j C h_j' + 2 h_j T_j C_j x_j' + x_j C_j x_j'.

Errors of torque constants are left out: they cancel in the torque of the same drive.
Beyond the range at which friction was identified, x_j has further columns with large
variances (see `model.friction`). The band thus widens where friction is extrapolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import Basis, base_regressor, free_basis
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index


@dataclass(frozen=True, kw_only=True)
class ParameterVariance:
    """Covariances of a model's parameters, from which that of any torque follows.

    `covariance` (b, b) is that of the base parameters, zero where a file states none.
    `sensitivity` holds by joint T_j (b, k_j): the change of the base parameters per
    coefficient of the joint's friction.
    """

    robot: Robot
    basis: Basis
    surfaces: Sequence[FrictionSurface | None]
    covariance: Array
    sensitivity: dict[int, Array]

    @classmethod
    def from_stages(cls, stages: Stages, robot: Robot) -> "ParameterVariance":
        """Collect the covariances in the stages of a parameter file."""
        basis = free_basis(robot)
        surfaces = friction_surfaces(stages, robot)
        covariance = np.zeros((basis.size, basis.size))
        sensitivity: dict[int, Array] = {}

        for stage in (stages.gravity, stages.inertia):
            places = _places(stage, basis)
            if stage is None or not len(places):
                continue
            stage_covariance = np.array(stage.covariance)
            if stage_covariance.shape == (len(places), len(places)):
                covariance[np.ix_(places, places)] = stage_covariance

            for j, name in enumerate(robot.joint_names):
                surface = surfaces[j]
                if surface is None or not stage.friction_sensitivity.get(name):
                    continue
                stored = np.array(stage.friction_sensitivity[name])
                stage_sensitivity = _of_surface(stored, surface)
                if stage_sensitivity is None or len(stage_sensitivity) != len(places):
                    continue
                n_coefficients = stage_sensitivity.shape[1]
                T = sensitivity.setdefault(j, np.zeros((basis.size, n_coefficients)))
                T[places] = stage_sensitivity

        # The same errors of friction are in the gravity and the inertia stage, which
        # makes their parameters covary.
        gravity = _places(stages.gravity, basis)
        inertia = np.setdiff1d(_places(stages.inertia, basis), gravity)
        for j, T in sensitivity.items():
            surface = surfaces[j]
            assert surface is not None
            cross_covariance = T[gravity] @ surface.covariance @ T[inertia].T
            covariance[np.ix_(gravity, inertia)] += cross_covariance
            covariance[np.ix_(inertia, gravity)] += cross_covariance.T

        return cls(
            robot=robot,
            basis=basis,
            surfaces=surfaces,
            covariance=covariance,
            sensitivity=sensitivity,
        )

    def of(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the variance of the predicted torque by errors of the parameters.

        Parameters
        ----------
        q, dq, ddq : array (N, n)
            Joint positions [rad], speeds [rad/s] and accelerations [rad/s^2].

        Returns
        -------
        array (N, n)
            Variance [(N m)^2].
        """
        H = base_regressor(self.robot, self.basis, q, dq, ddq)
        variance = np.zeros(q.shape)
        for j, surface in enumerate(self.surfaces):
            h = H[:, j]
            variance[:, j] = _quadratic(h, self.covariance, h)
            if surface is None:
                continue
            X = surface.columns(q[:, j], dq[:, j])
            variance[:, j] += _quadratic(X, surface.covariance, X)
            if j in self.sensitivity:
                cross_covariance = self.sensitivity[j] @ surface.covariance
                variance[:, j] += 2.0 * _quadratic(h, cross_covariance, X)
        # Rounding may leave less than nothing.
        return np.asarray(np.maximum(variance, 0.0))


def _places(stage: RigidStage | None, basis: Basis) -> Index:
    """Return the places of a stage's parameters among the base parameters.

    There are none where the stage has a parameter of another name.
    """
    if stage is None:
        return np.zeros(0, dtype=np.intp)
    names = {name: k for k, name in enumerate(basis.names)}
    if any(p.name not in names for p in stage.parameters):
        return np.zeros(0, dtype=np.intp)
    return np.array([names[p.name] for p in stage.parameters], dtype=np.intp)


def _of_surface(sensitivity: Array, surface: FrictionSurface) -> Array | None:
    """Return a sensitivity (p, k) for the coefficients of the present surface, or None.

    A stage that finds an offset or an asymmetry makes a surface directional. The stored
    sensitivity is then that to the mean of the two directions' coefficients. None means
    that the sensitivity is of another surface.
    """
    size = len(surface.covariance)
    if sensitivity.ndim != 2 or not size:
        return None
    if sensitivity.shape[1] == size:
        return sensitivity
    if not surface.directional or 2 * sensitivity.shape[1] != size:
        return None
    of_entries, of_extension = np.split(
        sensitivity / 2.0, [surface.entries // 2], axis=1
    )
    return np.hstack([of_entries, of_entries, of_extension, of_extension])


def _quadratic(left: Array, matrix: Array, right: Array) -> Array:
    """Return left_k matrix right_k' for every row k (N,)."""
    return np.asarray(np.sum((left @ matrix) * right, axis=1))
