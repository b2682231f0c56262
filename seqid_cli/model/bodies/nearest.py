"""The bodies nearest to an identified model, in units of its errors.

The identified base parameters of a file are a demand on the links. The torque leaves
many combinations of inertial parameters open; there the links stay as near as possible
to the expected ones: the CAD's, or a guess from the arm's geometry.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls

from seqid_cli.errors import ConfigError
from seqid_cli.model.bodies.consistent import consistent_links
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia, standard_of
from seqid_cli.model.torque import known_rotors, standard_parameters
from seqid_cli.params.results.export import ExportedParameter
from seqid_cli.params.schema import Parameter, Stages
from seqid_cli.robot.base_parameters import Basis, free_basis, gear_ratios
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Chain, Robot
from seqid_cli.typing import Array, Mask

# of a parameter's scale; data without noise give no errors to weigh by
_LEAST_ERROR = 1e-9


@dataclass(frozen=True)
class Identified:
    """What the rigid-body stages of a file say.

    `values`, `errors` (b,) and `covariance` (b, b) are of the base parameters `rows` of
    `basis`, the ones that the logs determined; `moves` (n, b) is the part of these
    errors that each joint's torque constant has. `whole_values` are those of the whole
    basis, as the file's torque has them. `known` (n,) kg m^2 are rotor inertias of the
    robot file and `free` lists joints whose rotor inertia was identified.
    """

    basis: Basis
    rows: tuple[int, ...]
    values: Array
    errors: Array
    covariance: Array
    moves: Array
    known: Array
    free: tuple[int, ...]
    whole_values: Array

    @property
    def held_covariance(self) -> Array:
        """Covariance (b, b) for torque constants as they are: of torque by the same drives."""
        return np.asarray(self.covariance - self.moves.T @ self.moves)

    @property
    def open(self) -> tuple[str, ...]:
        """Expressions of the base parameters that the logs did not determine."""
        every = range(self.basis.size)
        return tuple(self.basis.expression_text(k) for k in every if k not in self.rows)

    def deviations(self, phi: Array, rotor: Array) -> tuple[ExportedParameter, ...]:
        """Compare with links (n, 10) and rotors (n,), the identified ones in `free`."""
        exported = self.basis.expression[list(self.rows)] @ np.concatenate(
            [phi.ravel(), rotor]
        )
        found = []
        for k, old, new, error in zip(
            self.rows, self.values, exported, self.errors, strict=True
        ):
            off = float((new - old) / error) if error > 0.0 else None
            numbers = {
                "identified": float(old),
                "exported": float(new),
                "std_error": float(error),
            }
            name, unit = self.basis.names[k], self.basis.unit(k)
            found.append(
                ExportedParameter(name=name, unit=unit, **numbers, std_errors=off)
            )
        return tuple(found)


def identified(
    stages: Stages, robot: Robot, *, more: Array | None = None, largest: float = 1e9
) -> Identified:
    """Collect the base parameters of a file.

    `stages`: with gravity, with inertia, with both, or with neither. `more` (11 n,):
    standard parameters, rotors last, that effects add to the identified ones. Raises
    ConfigError if the parameters are not those of this robot file, or of no arm.
    """
    basis = free_basis(robot)
    rigid = stages.inertia or stages.gravity
    phi = np.zeros(basis.expression.shape[1])
    if rigid is not None:
        phi = np.concatenate([x.ravel() for x in standard_parameters(rigid, robot.n)])
    if more is not None:
        phi = phi + more
    found, covariance, moves = _determined(stages, basis, robot)
    rows = tuple(basis.names.index(parameter.name) for parameter in found)
    known = np.array([joint.rotor_inertia is not None for joint in robot.joints])
    first = PER_LINK * robot.n
    if not (np.abs(phi) < largest).all():
        message = (
            f"a standard parameter of the file is {np.abs(phi).max():.3g}, above"
            f" {largest:g}"
        )
        hint = "The file was edited or damaged: run the stage again that wrote it."
        raise ConfigError(message, where=str(robot.source), hint=hint)
    values = basis.expression @ phi
    seen = basis.expression[list(rows)][:, first:].any(axis=0) & ~known
    return Identified(
        basis=basis,
        rows=rows,
        values=values[list(rows)],
        errors=np.array([parameter.std_error for parameter in found]),
        covariance=covariance,
        moves=moves,
        known=(
            np.where(known, phi[first:], 0.0) if stages.inertia else known_rotors(robot)
        ),
        free=tuple(int(j) for j in np.flatnonzero(seen)),
        whole_values=np.asarray(values),
    )


def _determined(
    stages: Stages, basis: Basis, robot: Robot
) -> tuple[list[Parameter], Array, Array]:
    """Parameters that the logs determined, inertia's word before gravity's, covariance, moves."""
    found: list[Parameter] = []
    blocks, moves = [np.zeros((0, 0))], [np.zeros((robot.n, 0))]
    for name, stage in (("inertia", stages.inertia), ("gravity", stages.gravity)):
        if stage is None:
            continue
        alien = next(
            (p.name for p in stage.parameters if p.name not in basis.names), None
        )
        if alien is not None:
            message = f"$.stages.{name}: {alien!r} is no base parameter of this robot"
            hint = (
                "The robot file has changed since: geometry, gravity or known rotor"
                " inertias."
            )
            hint += (
                " Give the one that the parameters were identified with, or identify"
                " again."
            )
            raise ConfigError(message, where=str(robot.source), hint=hint)
        taken = {parameter.name for parameter in found}
        own = [
            k
            for k, parameter in enumerate(stage.parameters)
            if parameter.name not in taken
        ]
        errors = np.array([parameter.std_error for parameter in stage.parameters])
        full = np.array(stage.covariance) if stage.covariance else np.diag(errors**2)
        found += [stage.parameters[k] for k in own]
        blocks.append(full[np.ix_(own, own)])
        told, none = stage.torque_constant_moves, [0.0] * len(errors)
        moves.append(
            np.array([told.get(joint, none) for joint in robot.joint_names])[:, own]
        )
    common = np.hstack(moves)  # one error per joint
    return found, block_diag(*blocks) + common.T @ common, common


def whitening(covariance: Array, least: float, *, min_variance: float = 1e-10) -> Array:
    """Return W (b, b) with W'W the inverse of a covariance (b, b), errors at least `least`."""
    if not len(covariance):
        return np.zeros((0, 0))
    errors = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), least)
    correlation = covariance / np.outer(errors, errors)
    np.fill_diagonal(correlation, 1.0)
    variances, axes = np.linalg.eigh(0.5 * (correlation + correlation.T))
    return np.asarray((axes / np.sqrt(np.maximum(variances, min_variance))).T / errors)


def expected_links(
    robot: Robot,
    kept: Array,
    E: Array,
    values: Array,
    G: Array,
    *,
    min_mass: float = 1e-6,
) -> tuple[Array, tuple[bool, ...]]:
    """Return the expected pseudo-inertias (n, 4, 4), positive definite; which of them are CAD's.

    `kept` (n, 10) are parts of the bodies that stay as they are, not of the links.
    Identified combinations `E` (b, 10 n) and `G` (b, k) of links and rotors with their
    `values` (b,) scale the guess.
    """
    lengths, shapes = _shapes(robot.chain)
    cad = np.zeros((robot.n, 10)) if robot.nominal is None else robot.nominal - kept
    given = cad[:, 0] > min_mass
    left = values - E @ np.where(given[:, None], cad, 0.0).ravel()
    masses = _masses(shapes, E, left, given, np.asarray(G.any(axis=1)))
    J = masses[:, None, None] * shapes
    for i in np.flatnonzero(given):
        J[i] = _solid(pseudo_inertia(cad[i]), lengths[i])
    return J, tuple(given.tolist())


def _shapes(
    chain: Chain, *, slimness: float = 0.25, usual: float = 0.3, shortest: float = 0.05
) -> tuple[Array, Array]:
    """Lengths (n,) m, and pseudo-inertias (n, 4, 4) of guessed links of 1 kg.

    A link reaches from its own joint to the next; one of no length, as the last is, is
    as large as the others and centred on its joint.
    """
    reach = np.vstack([chain.position[1:], np.zeros((1, 3))])
    lengths = np.linalg.norm(reach, axis=1)
    seen = lengths[lengths > 0.0]
    lengths = np.where(lengths > 0.0, lengths, seen.mean() if len(seen) else usual)
    lengths = np.maximum(lengths, shortest)
    shapes = np.zeros((chain.n, 4, 4))
    for J, along, length in zip(shapes, reach, lengths, strict=True):
        across = (slimness * length) ** 2
        # a rod, thickened
        J[:3, :3] = across * np.eye(3) + np.outer(along, along) / 3.0
        J[:3, 3] = J[3, :3] = 0.5 * along
        J[3, 3] = 1.0
    return lengths, shapes


def _masses(
    shapes: Array,
    E: Array,
    values: Array,
    given: Mask,
    turned: Mask,
    *,
    lightest: float = 0.05,
) -> Array:
    """Masses (n,) kg of guessed links that come nearest to the identified values.

    `turned` (b,): values that hold a rotor of unknown inertia. A link that shows in
    such ones alone (the first of an arm on the floor) has the mean mass of the others:
    the rotor may be all of it.
    """
    links = np.split(E, len(shapes), axis=1)
    columns = np.stack(
        [own @ standard_of(J) for own, J in zip(links, shapes, strict=True)], axis=1
    )
    columns[:, given] = 0.0
    hidden = np.asarray(columns.any(axis=0) & ~columns[~turned].any(axis=0))
    if hidden.any() and not (hidden | given).all():
        columns[columns[:, hidden].any(axis=1)] = 0.0
    else:
        hidden[:] = False
    size = np.where(
        columns.any(axis=1), np.abs(values) + np.abs(columns).max(axis=1), 0.0
    )
    rows = size > 0.0
    if not rows.any():
        return np.ones(len(shapes))
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

    `from_cad` (n,): whether what the torque does not show of a link is the URDF's, or
    guessed.
    """

    links: Array
    rotor: Array
    exact: bool
    from_cad: tuple[bool, ...]


def nearest_bodies(
    robot: Robot, found: Identified, kept: Array | None = None
) -> NearestBodies:
    """Find bodies with the identified torque, or the nearest to it; their links without `kept`.

    `kept` (n, 10): parts of the links that stay as they are; the rest must be able to
    exist by itself. Raises QualityError if no physically consistent parameters are
    found.
    """
    first, free = PER_LINK * robot.n, list(found.free)
    kept = np.zeros((robot.n, 10)) if kept is None else kept
    every = found.basis.expression[list(found.rows)]
    E, G = every[:, :first], every[:, first:][:, free]
    scale = np.abs(found.values).max(initial=0.0) + np.abs(found.errors).max(
        initial=0.0
    )
    W = whitening(found.covariance, _LEAST_ERROR * max(scale, 1e-12))
    values = found.values - E @ kept.ravel()
    J, from_cad = expected_links(robot, kept, E, values, G)
    # sizes of the links' inertias, kg m^2
    turning = J[:, :3, :3].trace(axis1=1, axis2=2)
    sizes = (turning / gear_ratios(robot) ** 2)[free]
    rotor = found.known.copy()
    links, rotor[free], exact = consistent_links(J, sizes, E, G, values, W)
    return NearestBodies(links, rotor, exact, from_cad)
