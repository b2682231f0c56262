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

from dataclasses import dataclass

import numpy as np

from seqid_cli.model.bodies.consistent import nearest_body
from seqid_cli.model.bodies.nearest import whitening
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.params.results.payload import CarriedBodyEntry, Measured
from seqid_cli.payload.fit import PayloadFit
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class Body:
    """A body that can exist, with standard errors.

    `mass` is in kg, `center` (3,) of mass in m, `inertia` (3, 3) about it in kg m^2.
    `distance` says how far the estimate is from the body in standard errors (chi); it
    is zero where the estimate is a body.
    """

    mass: float
    center: Array
    inertia: Array
    mass_std_error: float
    center_std_errors: Array
    inertia_std_errors: Array
    distance: float


def carried_body(fit: PayloadFit, joint: str) -> CarriedBodyEntry:
    """Return the body of a fit; numbers that the logs do not determine are null.

    Parameters
    ----------
    fit : PayloadFit
    joint : str
        The last joint, in whose frame the body is.
    """
    frame = f"of joint {joint}"
    mass_is_determined = bool(fit.determined[0])
    if not mass_is_determined or fit.phi[0] <= 0.0:
        # Without a positive mass the first moments are those of no centre.
        std_error = float(fit.std_errors[0])
        return CarriedBodyEntry(
            frame=frame,
            mass=_measured(float(fit.phi[0]), std_error, "kg", mass_is_determined),
            center_of_mass=[_measured(0.0, 0.0, "m", False)] * 3,
        )

    inertia_is_determined = bool(fit.determined.all())
    body = nearest_to(fit.phi, fit.covariance, inertia=inertia_is_determined)
    inertia = []
    inertia_std_errors = []
    if inertia_is_determined:
        inertia = body.inertia.tolist()
        inertia_std_errors = body.inertia_std_errors.tolist()
    return CarriedBodyEntry(
        frame=frame,
        mass=_measured(body.mass, body.mass_std_error, "kg", True),
        center_of_mass=[
            _measured(
                float(body.center[axis]),
                float(body.center_std_errors[axis]),
                "m",
                bool(fit.determined[1 + axis]),
            )
            for axis in range(3)
        ],
        inertia=inertia,
        inertia_std_errors=inertia_std_errors,
        distance=body.distance,
    )


def _measured(value: float, std_error: float, unit: str, determined: bool) -> Measured:
    """Return a number with its error, both null where it is not determined."""
    if not determined:
        return Measured(value=None, std_error=None, unit=unit)
    return Measured(value=value, std_error=std_error, unit=unit)


def nearest_to(phi: Array, covariance: Array, *, inertia: bool = True) -> Body:
    """Return the body nearest to an estimate.

    Parameters
    ----------
    phi : (10,) array
        Standard parameters of positive mass, inertia about the frame's origin.
    covariance : (10, 10) array
        Covariance of these.
    inertia : bool
        Whether the inertia is determined as well. Only then the estimate can be
        compared with bodies; without it the body is the estimate.
    """
    distance = 0.0
    if inertia and np.linalg.eigvalsh(pseudo_inertia(phi))[0] < 0.0:
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

    moments = _moments(phi)
    return Body(
        mass=float(moments[0]),
        center=moments[1:4],
        inertia=moments[4:].reshape(3, 3),
        mass_std_error=float(std_errors[0]),
        center_std_errors=std_errors[1:4],
        inertia_std_errors=std_errors[4:].reshape(3, 3),
        distance=distance,
    )


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
