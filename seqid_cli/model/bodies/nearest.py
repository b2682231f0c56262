"""The bodies nearest to an identified model, in units of its errors.

The expected inertials of the links: the CAD's, or a guess from the arm's geometry.

The torque leaves many combinations of inertial parameters open. There the exported links stay as
near as possible to these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from seqid_cli.model.bodies.consistent import consistent_links
from seqid_cli.model.bodies.demand import Identified
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia, standard_of
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Array, Chain, Robot


@dataclass(frozen=True)
class Expected:
    """Expected pseudo-inertia `J` (n, 4, 4) of the links, positive definite; whether from CAD."""

    J: Array
    from_cad: tuple[bool, ...]


def expected_links(
    robot: Robot, kept: Array, E: Array, values: Array, G: Array, *, min_mass: float = 1e-6
) -> Expected:
    """Return the expected inertials of each link.

    `robot`: with `nominal` where its URDF has inertials. `kept` (n, 10): parts of the bodies that
    stay as they are; not part of the links. `E` (b, 10 n): identified combinations of link
    parameters; they scale the guess. `values` (b,): their values. `G` (b, k): the same of rotors.
    """
    lengths, shapes = _shapes(robot.chain)
    cad = np.zeros((robot.n, 10)) if robot.nominal is None else robot.nominal - kept
    given = cad[:, 0] > min_mass
    left = values - E @ np.where(given[:, None], cad, 0.0).ravel()
    masses = _masses(shapes, E, left, given, np.asarray(G.any(axis=1)))
    J = np.stack(
        [
            _solid(pseudo_inertia(cad[i]), lengths[i]) if given[i] else masses[i] * shapes[i]
            for i in range(robot.n)
        ]
    )
    return Expected(J, tuple(bool(x) for x in given))


def _shapes(
    chain: Chain, *, slimness: float = 0.25, usual: float = 0.3, shortest: float = 0.05
) -> tuple[Array, Array]:
    """Lengths (n,) m, and pseudo-inertias (n, 4, 4) of guessed links of 1 kg.

    A link reaches from its own joint to the next; one of no length, as the last is, is as large as
    the others and centred on its joint.
    """
    reach = np.vstack([chain.position[1:], np.zeros((1, 3))])
    lengths = np.linalg.norm(reach, axis=1)
    seen = lengths[lengths > 0.0]
    lengths = np.where(lengths > 0.0, lengths, seen.mean() if len(seen) else usual)
    lengths = np.maximum(lengths, shortest)
    shapes = np.zeros((chain.n, 4, 4))
    for J, along, length in zip(shapes, reach, lengths, strict=True):
        across = (slimness * length) ** 2
        J[:3, :3] = across * np.eye(3) + np.outer(along, along) / 3.0  # a rod, thickened
        J[:3, 3] = J[3, :3] = 0.5 * along
        J[3, 3] = 1.0
    return lengths, shapes


def _masses(
    shapes: Array,
    E: Array,
    values: Array,
    given: NDArray[np.bool_],
    turned: NDArray[np.bool_],
    *,
    lightest: float = 0.05,
) -> Array:
    """Masses (n,) kg of guessed links that come nearest to the identified values.

    `turned` (b,): values that hold a rotor of unknown inertia. A link that shows in such ones alone
    (the first of an arm on the floor) has the mean mass of the others: the rotor may be all of it.
    """
    n = len(shapes)
    columns = np.stack(
        [E[:, 10 * i : 10 * i + 10] @ standard_of(J) for i, J in enumerate(shapes)], axis=1
    )
    columns[:, given] = 0.0
    hidden = np.asarray(columns.any(axis=0) & ~columns[~turned].any(axis=0))
    if hidden.any() and not (hidden | given).all():
        columns[columns[:, hidden].any(axis=1)] = 0.0
    else:
        hidden[:] = False
    size = np.where(columns.any(axis=1), np.abs(values) + np.abs(columns).max(axis=1), 0.0)
    rows = size > 0.0
    if not rows.any():
        return np.ones(n)
    masses, _ = nnls(columns[rows] / size[rows, None], values[rows] / size[rows])
    masses[hidden] = masses[~given & ~hidden].mean()
    mean = float(masses[~given].mean()) if (~given).any() else 1.0
    return np.maximum(masses, lightest * mean if mean > 0.0 else 1.0)


def _solid(J: Array, length: float, *, thinnest: float = 0.02) -> Array:
    """Return J with radii of gyration of no less than a small share of the link's length."""
    mass, h = J[3, 3], J[:3, 3]
    S = J[:3, :3] - np.outer(h, h) / mass
    radii, axes = np.linalg.eigh(S)
    S = (axes * np.maximum(radii, mass * (thinnest * length) ** 2)) @ axes.T
    solid = J.copy()
    solid[:3, :3] = S + np.outer(h, h) / mass
    return solid


@dataclass(frozen=True)
class NearestBodies:
    """Links (n, 10) and rotors (n,) that can exist, whether they meet the identified model.

    `expected` is what stood in where the torque says nothing.
    """

    links: Array
    rotor: Array
    exact: bool
    expected: Expected


def nearest_bodies(robot: Robot, found: Identified, kept: Array | None = None) -> NearestBodies:
    """Find bodies with the identified torque, or the nearest to it.

    `kept` (n, 10): parts of the links that stay as they are; the rest must be able to exist by
    itself. Returns: its links are without `kept`. Raises QualityError if no physically consistent
    parameters are found.
    """
    demand = found.demand
    kept = np.zeros((robot.n, 10)) if kept is None else kept
    own = replace(demand, values=demand.values - demand.E @ kept.ravel())
    expected = expected_links(robot, kept, own.E, own.values, own.G)
    ratio = gear_ratios(robot)
    turning = expected.J[:, :3, :3].trace(axis1=1, axis2=2)  # sizes of the links' inertias, kg m^2
    sizes = np.array([turning[j] / ratio[j] ** 2 for j in found.free])
    bodies = consistent_links(expected.J, sizes, own)
    rotor = found.known.copy()
    rotor[list(found.free)] = bodies.rotors
    return NearestBodies(bodies.phi, rotor, bodies.exact, expected)
