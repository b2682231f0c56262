"""Mass, centre of mass and inertia of the body nearest to an estimate.

The estimate need not belong to a body: noise makes an inertia negative, and what the
logs do not excite is whatever the least squares left. The body that is given is the one
with a positive semidefinite pseudo-inertia J nearest to the estimate in its own errors,

    min over J >= 0 of  (phi(J) - phi)' C^-1 (phi(J) - phi),

a conic problem (Wensing, Kim, Slotine, "Linear matrix inequalities for physically
consistent inertial parameter identification", RA-L 2018). Where the estimate is a body,
the two are the same.

phi (10,) are standard parameters in Pinocchio's order, the inertia about the origin of
the frame, and C (10, 10) is their covariance. The mass m, first moment h = m c and
second moment about the origin stand in J (4, 4); S is the second moment about the
centre of mass c.
"""

import numpy as np

from seqid_cli.model.bodies.consistent import nearest_body
from seqid_cli.model.bodies.nearest import whitening
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.typing import Array


def carried(
    phi: Array, covariance: Array, *, whole: bool = True
) -> tuple[Array, Array, float]:
    """Return the body nearest to an estimate, with its errors and its distance.

    Parameters
    ----------
    phi : (10,) array
        Standard parameters of positive mass, inertia about the frame's origin.
    covariance : (10, 10) array
        Covariance of these.
    whole : bool
        Whether the inertia is determined as well. Only then the estimate can be
        compared with bodies.

    Returns
    -------
    values : (13,) array
        Mass [kg], centre of mass (3) [m], and inertia about it (9) [kg m^2], row by
        row.
    std_errors : (13,) array
        Standard errors of these.
    distance : float
        Distance of the estimate from the body in standard errors (chi); zero where the
        estimate is a body.
    """
    distance = 0.0
    if whole and np.linalg.eigvalsh(pseudo_inertia(phi))[0] < 0.0:
        least_error = 1e-9 * float(np.abs(phi).max())
        phi, distance = nearest_body(phi, whitening(covariance, least_error))

    # Errors to first order, by central differences: centre and inertia are quotients
    # with the mass.
    size = np.abs(phi)
    step = 1e-6 * np.maximum(size, 1e-3 * size.max())
    difference = _moments(phi + np.diag(step)) - _moments(phi - np.diag(step))
    slopes = difference.T / (2.0 * step)
    variances = np.einsum("ik,kl,il->i", slopes, covariance, slopes)
    std_errors = np.sqrt(np.maximum(variances, 0.0))
    return _moments(phi), std_errors, distance


def _moments(phi: Array) -> Array:
    """Return mass, centre and inertia about it (..., 13) of parameters (..., 10)."""
    J = pseudo_inertia(phi)
    mass = J[..., 3:, 3]
    h = J[..., :3, 3]
    S = J[..., :3, :3] - h[..., :, None] * h[..., None, :] / mass[..., None]

    trace = np.trace(S, axis1=-2, axis2=-1)
    inertia = trace[..., None, None] * np.eye(3) - S
    rows = inertia.reshape(*mass.shape[:-1], 9)
    return np.concatenate([mass, h / mass, rows], axis=-1)
