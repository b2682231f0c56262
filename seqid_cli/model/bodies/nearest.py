"""The bodies nearest to an identified model, in units of its errors.

The identified base parameters of a file are a demand on the links. The torque leaves
many combinations of inertial parameters open; there the links stay as near as possible
to the expected ones: the CAD's, or a guess from the arm's geometry.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.matrices import block_diagonal
from seqid_cli.model.bodies.consistent import consistent_links
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia, standard_of
from seqid_cli.model.torque import known_rotors, standard_parameters
from seqid_cli.params.results.export import ExportedParameter
from seqid_cli.params.schema import Parameter, Stages
from seqid_cli.robot.base_parameters import Basis, free_basis, gear_ratios
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Chain, Robot
from seqid_cli.typing import Array, Mask

# Of a parameter's scale; data without noise give no errors to weigh by.
_LEAST_ERROR = 1e-9


@dataclass(frozen=True, kw_only=True)
class Identified:
    """What the rigid-body stages of a file say.

    Attributes
    ----------
    basis : Basis
        All base parameters of the robot.
    rows : tuple of int
        Those of the basis that the logs determined; b in number.
    values, errors : Array
        (b,), the determined base parameters and their standard errors.
    covariance : Array
        (b, b) of them.
    moves : Array
        (n, b), the part of these errors that each joint's torque constant has.
    given_rotors : Array
        (n,) kg m^2, rotor inertias of the robot file.
    free : tuple of int
        Joints whose rotor inertia was identified.
    whole_values : Array
        Values of the whole basis, as the file's torque has them.
    """

    basis: Basis
    rows: tuple[int, ...]
    values: Array
    errors: Array
    covariance: Array
    moves: Array
    given_rotors: Array
    free: tuple[int, ...]
    whole_values: Array

    @property
    def held_covariance(self) -> Array:
        """Covariance (b, b) for torque constants as they are.

        It holds for torque by the same drives.
        """
        return np.asarray(self.covariance - self.moves.T @ self.moves)

    @property
    def open(self) -> tuple[str, ...]:
        """Expressions of the base parameters that the logs did not determine."""
        return tuple(
            self.basis.expression_text(k)
            for k in range(self.basis.size)
            if k not in self.rows
        )

    def deviations(self, phi: Array, rotor: Array) -> tuple[ExportedParameter, ...]:
        """Compare with links (n, 10) and rotors (n,), the identified ones in `free`."""
        parameters = np.concatenate([phi.ravel(), rotor])
        exported = self.basis.expression[list(self.rows)] @ parameters
        compared = []
        for k, old, new, error in zip(
            self.rows, self.values, exported, self.errors, strict=True
        ):
            compared.append(
                ExportedParameter(
                    name=self.basis.names[k],
                    unit=self.basis.unit(k),
                    identified=float(old),
                    exported=float(new),
                    std_error=float(error),
                    std_errors=float((new - old) / error) if error > 0.0 else None,
                )
            )
        return tuple(compared)


def identified(
    stages: Stages,
    robot: Robot,
    *,
    added_by_effects: Array | None = None,
    largest: float = 1e9,
) -> Identified:
    """Collect the base parameters of a file.

    Parameters
    ----------
    stages : Stages
        With gravity, with inertia, with both, or with neither.
    robot : Robot
    added_by_effects : Array, optional
        (11 n,), standard parameters, rotors last, that effects add to the identified
        ones.
    largest : float
        Size from which a standard parameter is of no arm.

    Raises
    ------
    ConfigError
        The parameters are not those of this robot file, or of no arm.
    """
    basis = free_basis(robot)
    phi = np.zeros(basis.expression.shape[1])
    rigid = stages.inertia or stages.gravity
    if rigid is not None:
        links, rotors = standard_parameters(rigid, robot.n)
        phi = np.concatenate([links.ravel(), rotors.ravel()])
    if added_by_effects is not None:
        phi = phi + added_by_effects

    determined = _determined(stages, basis, robot)
    if not (np.abs(phi) < largest).all():
        message = (
            f"a standard parameter of the file is {np.abs(phi).max():.3g}, above"
            f" {largest:g}"
        )
        hint = "The file was edited or damaged: run the stage again that wrote it."
        raise ConfigError(message, where=str(robot.source), hint=hint)

    rows = [basis.names.index(parameter.name) for parameter in determined.parameters]
    values = basis.expression @ phi
    first_rotor = PER_LINK * robot.n
    is_given = np.array([joint.rotor_inertia is not None for joint in robot.joints])
    shows = basis.expression[rows][:, first_rotor:].any(axis=0)
    given_rotors = known_rotors(robot)
    if stages.inertia:
        given_rotors = np.where(is_given, phi[first_rotor:], 0.0)
    return Identified(
        basis=basis,
        rows=tuple(rows),
        values=values[rows],
        errors=np.array([parameter.uncertainty for parameter in determined.parameters]),
        covariance=determined.covariance,
        moves=determined.moves,
        given_rotors=given_rotors,
        free=tuple(int(j) for j in np.flatnonzero(shows & ~is_given)),
        whole_values=np.asarray(values),
    )


class _Determined(NamedTuple):
    """Base parameters that the logs determined; covariance (b, b), moves (n, b)."""

    parameters: list[Parameter]
    covariance: Array
    moves: Array


def _determined(stages: Stages, basis: Basis, robot: Robot) -> _Determined:
    """Collect the determined parameters; inertia's count where both stages have one."""
    parameters: list[Parameter] = []
    covariances = [np.zeros((0, 0))]
    moves = [np.zeros((robot.n, 0))]
    for name, stage in (("inertia", stages.inertia), ("gravity", stages.gravity)):
        if stage is None:
            continue
        for parameter in stage.parameters:
            if parameter.name not in basis.names:
                raise _of_other_robot(name, parameter, robot)

        earlier = {parameter.name for parameter in parameters}
        new = [
            k
            for k, parameter in enumerate(stage.parameters)
            if parameter.name not in earlier
        ]
        parameters += [stage.parameters[k] for k in new]

        errors = np.array([parameter.uncertainty for parameter in stage.parameters])
        covariance = np.diag(errors**2)
        if stage.covariance:
            covariance = np.array(stage.covariance)
        covariances.append(covariance[np.ix_(new, new)])

        no_moves = [0.0] * len(errors)
        by_joint = [
            stage.torque_constant_moves.get(joint, no_moves)
            for joint in robot.joint_names
        ]
        moves.append(np.array(by_joint)[:, new])

    # A torque constant is one error per joint: it is common to both stages.
    of_torque_constants = np.hstack(moves)
    common = of_torque_constants.T @ of_torque_constants
    return _Determined(
        parameters=parameters,
        covariance=block_diagonal(*covariances) + common,
        moves=of_torque_constants,
    )


def _of_other_robot(stage: str, parameter: Parameter, robot: Robot) -> ConfigError:
    """Make the error of a parameter that the robot's basis does not have."""
    message = f"$.stages.{stage}: {parameter.name!r} is no base parameter of this robot"
    hint = (
        "The robot file has changed since: geometry, gravity or known rotor inertias."
        " Give the one that the parameters were identified with, or identify again."
    )
    return ConfigError(message, where=str(robot.source), hint=hint)


def whitening(covariance: Array, least: float, *, min_variance: float = 1e-10) -> Array:
    """Return W (b, b) with W'W the inverse of a covariance (b, b).

    Parameters
    ----------
    covariance : Array
    least : float
        Least standard error of a parameter.
    min_variance : float
        Least variance along an axis of the correlation, against rounding.
    """
    if not len(covariance):
        return np.zeros((0, 0))
    errors = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), least)
    correlation = covariance / np.outer(errors, errors)
    np.fill_diagonal(correlation, 1.0)
    variances, axes = np.linalg.eigh(0.5 * (correlation + correlation.T))
    return np.asarray((axes / np.sqrt(np.maximum(variances, min_variance))).T / errors)


def expected_links(
    robot: Robot,
    held_bodies: Array,
    E: Array,
    values: Array,
    G: Array,
    *,
    min_mass: float = 1e-6,
) -> tuple[Array, tuple[bool, ...]]:
    """Return the expected links: CAD's where it has them, or guessed.

    Parameters
    ----------
    robot : Robot
    held_bodies : Array
        (n, 10), parts of the bodies that stay as they are, not of the links.
    E, G : Array
        (b, 10 n) and (b, k), identified combinations of links and rotors.
    values : Array
        (b,) of these combinations; they scale the guess.
    min_mass : float
        Mass of a link of CAD [kg], below which it is guessed.

    Returns
    -------
    tuple
        Pseudo-inertias (n, 4, 4), positive definite, and which of them are CAD's.
    """
    guess = _guessed_links(robot.chain)
    cad = np.zeros((robot.n, 10))
    if robot.nominal is not None:
        cad = robot.nominal - held_bodies
    has_cad = cad[:, 0] > min_mass

    beside_cad = values - E @ np.where(has_cad[:, None], cad, 0.0).ravel()
    has_rotor = np.asarray(G.any(axis=1))
    masses = _masses(guess.shapes, E, beside_cad, has_cad, has_rotor)

    J = masses[:, None, None] * guess.shapes
    for i in np.flatnonzero(has_cad):
        J[i] = _solid(pseudo_inertia(cad[i]), guess.lengths[i])
    return J, tuple(has_cad.tolist())


class _Guess(NamedTuple):
    """Lengths (n,) m, and pseudo-inertias (n, 4, 4) of guessed links of 1 kg."""

    lengths: Array
    shapes: Array


def _guessed_links(
    chain: Chain, *, slimness: float = 0.25, usual: float = 0.3, shortest: float = 0.05
) -> _Guess:
    """Guess links from the arm's geometry.

    A link reaches from its own joint to the next; one of no length, as the last is, is
    as large as the others and centred on its joint.
    """
    reach = np.vstack([chain.position[1:], np.zeros((1, 3))])
    lengths = np.linalg.norm(reach, axis=1)
    nonzero_lengths = lengths[lengths > 0.0]
    usual_length = nonzero_lengths.mean() if len(nonzero_lengths) else usual
    lengths = np.where(lengths > 0.0, lengths, usual_length)
    lengths = np.maximum(lengths, shortest)

    shapes = np.zeros((chain.n, 4, 4))
    for J, along, length in zip(shapes, reach, lengths, strict=True):
        # A rod, thickened.
        across = (slimness * length) ** 2
        J[:3, :3] = across * np.eye(3) + np.outer(along, along) / 3.0
        J[:3, 3] = 0.5 * along
        J[3, :3] = 0.5 * along
        J[3, 3] = 1.0
    return _Guess(lengths, shapes)


def _masses(
    shapes: Array,
    E: Array,
    values: Array,
    has_cad: Mask,
    turned: Mask,
    *,
    lightest: float = 0.05,
) -> Array:
    """Return masses (n,) kg of guessed links that come nearest to identified values.

    Parameters
    ----------
    shapes : Array
        (n, 4, 4), pseudo-inertias of 1 kg.
    E, values : Array
        (b, 10 n) and (b,), identified combinations.
    has_cad : Mask
        (n,), links whose mass CAD gives.
    turned : Mask
        (b,), values that hold a rotor of unknown inertia.
    lightest : float
        Least mass of a link, as a share of the mean.
    """
    from scipy.optimize import nnls

    per_kilogram = [
        of_link @ standard_of(J)
        for of_link, J in zip(np.split(E, len(shapes), axis=1), shapes, strict=True)
    ]
    columns = np.stack(per_kilogram, axis=1)
    columns[:, has_cad] = 0.0

    # A link that shows beside unknown rotors alone (the first of an arm on the floor)
    # has the mean mass of the others: the rotor may be all of it.
    hidden = np.asarray(columns.any(axis=0) & ~columns[~turned].any(axis=0))
    if hidden.any() and not (hidden | has_cad).all():
        columns[columns[:, hidden].any(axis=1)] = 0.0
    else:
        hidden[:] = False

    shows = columns.any(axis=1)
    size = np.where(shows, np.abs(values) + np.abs(columns).max(axis=1), 0.0)
    rows = size > 0.0
    if not rows.any():
        return np.ones(len(shapes))

    masses, _ = nnls(columns[rows] / size[rows, None], values[rows] / size[rows])
    masses[hidden] = masses[~has_cad & ~hidden].mean()
    mean = float(masses[~has_cad].mean()) if (~has_cad).any() else 1.0
    return np.maximum(masses, lightest * mean if mean > 0.0 else 1.0)


def _solid(J: Array, length: float, *, thinnest: float = 0.02) -> Array:
    """Return J with radii of gyration of at least a share of the link's length."""
    mass = J[3, 3]
    h = J[:3, 3]
    S = J[:3, :3] - np.outer(h, h) / mass
    moments, axes = np.linalg.eigh(S)
    least_moment = mass * (thinnest * length) ** 2
    S = (axes * np.maximum(moments, least_moment)) @ axes.T
    solid = J.copy()
    solid[:3, :3] = S + np.outer(h, h) / mass
    return solid


@dataclass(frozen=True)
class NearestBodies:
    """Bodies that can exist, the nearest to an identified model.

    Attributes
    ----------
    links, rotor : Array
        (n, 10) standard parameters and (n,) kg m^2.
    exact : bool
        Whether they meet the identified model.
    from_cad : tuple of bool
        (n,), whether what the torque does not show of a link is the URDF's, or guessed.
    """

    links: Array
    rotor: Array
    exact: bool
    from_cad: tuple[bool, ...]


def nearest_bodies(
    robot: Robot, demand: Identified, held_bodies: Array | None = None
) -> NearestBodies:
    """Find bodies with the identified torque, or the nearest to it.

    Parameters
    ----------
    robot : Robot
    demand : Identified
    held_bodies : Array, optional
        (n, 10), parts of the links that stay as they are. The rest must be able to
        exist by itself, and is what is returned.

    Raises
    ------
    QualityError
        No physically consistent parameters are demand.
    """
    if held_bodies is None:
        held_bodies = np.zeros((robot.n, 10))
    first_rotor = PER_LINK * robot.n
    free = list(demand.free)
    expression = demand.basis.expression[list(demand.rows)]
    E = expression[:, :first_rotor]
    G = expression[:, first_rotor:][:, free]

    largest_value = np.abs(demand.values).max(initial=0.0)
    largest_error = np.abs(demand.errors).max(initial=0.0)
    scale = max(largest_value + largest_error, 1e-12)
    W = whitening(demand.covariance, _LEAST_ERROR * scale)
    values = demand.values - E @ held_bodies.ravel()
    J, from_cad = expected_links(robot, held_bodies, E, values, G)

    # Rotors are searched in units of their links' inertias on the motor side, kg m^2.
    link_sizes = J[:, :3, :3].trace(axis1=1, axis2=2)
    rotor_sizes = (link_sizes / gear_ratios(robot) ** 2)[free]
    consistent = consistent_links(J, rotor_sizes, E, G, values, W)
    rotor = demand.given_rotors.copy()
    rotor[free] = consistent.rotors
    return NearestBodies(
        links=consistent.links,
        rotor=rotor,
        exact=consistent.is_exact,
        from_cad=from_cad,
    )
