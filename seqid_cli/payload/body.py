"""From standard parameters with errors to a body: mass, centre of mass, inertia about it.

The estimate need not belong to a body: noise makes an inertia negative, and what the logs do not
excite is whatever the least squares left. The body that is given is the one with a positive
semidefinite pseudo-inertia J nearest to the estimate in its own errors,

    min over J >= 0 of  (phi(J) - phi)' C^-1 (phi(J) - phi),

a conic problem (Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent
inertial parameter identification", RA-L 2018). Where the estimate is a body, the two are the same.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.model.bodies.consistent import nearest_body
from seqid_cli.model.bodies.nearest import whitening
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.typing import Array


@dataclass(frozen=True)
class CarriedBody:
    """A body with standard errors, in the axes of the last joint's frame.

    `mass` kg, `center` (3,) m, `inertia` (3, 3) kg m^2 about the centre of mass, None where it is
    not known. `distance` are the standard errors (chi) between the estimate and the nearest body;
    zero where it is one.
    """

    mass: float
    mass_error: float
    center: Array
    center_error: Array
    inertia: Array | None
    inertia_error: Array
    distance: float


def body_of(phi: Array, covariance: Array, *, whole: bool = True) -> CarriedBody:
    """The body nearest to an estimate.

    `phi` (10,): standard parameters of positive mass, inertia about the frame's origin.
    `covariance` (10, 10). `whole`: whether the inertia is known as well.
    """
    distance = 0.0
    if whole and np.linalg.eigvalsh(pseudo_inertia(phi))[0] < 0.0:
        phi, distance = nearest_body(phi, whitening(covariance, 1e-9 * float(np.abs(phi).max())))
    values, slopes = _values(phi), _slopes(phi)
    errors = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", slopes, covariance, slopes), 0.0))
    inertia = _symmetric(values[4:]) if whole else None
    moments = (values[1:4], errors[1:4], inertia, _symmetric(errors[4:]))
    return CarriedBody(float(values[0]), float(errors[0]), *moments, distance)


def _symmetric(upper: Array) -> Array:
    """Matrix (3, 3) of its upper triangle (6,), row by row."""
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = upper
    return matrix + np.triu(matrix, 1).T


def _slopes(phi: Array) -> Array:
    """Slopes (10, 10) of mass, centre and inertia (xx, xy, xz, yy, yz, zz) in phi."""
    step = 1e-6 * np.maximum(np.abs(phi), 1e-3 * np.abs(phi).max())
    columns = [
        (_values(phi + d) - _values(phi - d)) / (2.0 * step[k]) for k, d in enumerate(np.diag(step))
    ]
    return np.stack(columns, axis=1)


def _values(phi: Array) -> Array:
    m, h = phi[0], phi[1:4]
    center = h / m
    xx, xy, yy, xz, yz, zz = phi[4:]
    origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    inertia = origin - m * (center @ center * np.eye(3) - np.outer(center, center))
    return np.concatenate([[m], center, inertia[np.triu_indices(3)]])
