"""What is known of the drives' terms before a stage, as rows of its least squares.

The terms themselves, and their sizes before any log was seen, are those of
`identify.nuisances`. Here they become columns beside a stage's parameters, and rows of
unit variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.nuisances import (
    DRIVE_NAMES,
    EVEN_NAMES,
    EVEN_TERMS,
    PRIORS,
    EvenPart,
    friction_rms,
    term_of,
)
from seqid_cli.identify.regression.least_squares import Prior, whitened
from seqid_cli.identify.rigid.posterior import gravity_prior
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage, Stages
from seqid_cli.robot.base_parameters import Basis


@dataclass(frozen=True)
class NuisanceColumns:
    """Places of the nuisance terms of n joints behind so many parameters."""

    parameters: int
    joints: int

    @property
    def count(self) -> int:
        """Number of nuisance terms."""
        return len(DRIVE_NAMES) * self.joints

    @property
    def size(self) -> int:
        """Number of parameters and terms."""
        return self.parameters + self.count

    @property
    def all(self) -> slice:
        """Places of all terms."""
        return slice(self.parameters, self.size)

    @property
    def delays(self) -> slice:
        """Places of the delays."""
        return slice(self.parameters, self.parameters + self.joints)

    def of(self, name: str, joint: int) -> int:
        """Return the place of a term of a joint."""
        return self.parameters + DRIVE_NAMES.index(name) * self.joints + joint

    def of_joint(self, joint: int) -> slice:
        """Return the places of the terms of a joint, in the order of `DRIVE_NAMES`."""
        return slice(self.parameters + joint, self.size, self.joints)


def even_prior(
    surfaces: Sequence[FrictionSurface | None],
    friction: FrictionStage,
    names: Sequence[str],
) -> Prior:
    """Return the prior of offsets and asymmetries as rows of unit variance.

    The unknowns are changes against what the surfaces hold: first the offsets of all
    joints [N m], then their asymmetries, then their viscous ones: (3 n,).
    """
    joints = len(surfaces)
    weights = np.zeros(EVEN_TERMS * joints)
    values = np.zeros(EVEN_TERMS * joints)
    for j, surface in enumerate(surfaces):
        places = np.arange(EVEN_TERMS) * joints + j
        if surface is None:
            weights[places] = 1.0
            continue
        rms = friction_rms(surface)
        stated = EvenPart.of_joint(friction.joints[names[j]], rms)
        prior_std = np.maximum(PRIORS.even_std(rms), 1e-12)
        weights[places] = 1.0 / prior_std
        values[places] = -stated.values
    return Prior(A=np.diag(weights), b=weights * values)


def later_prior(
    stages: Stages,
    surfaces: Sequence[FrictionSurface | None],
    basis: Basis,
    names: Sequence[str],
) -> Prior:
    """Return a prior of friction and gravity stages, as rows of unit variance.

    Parameters
    ----------
    stages : Stages
        With friction; with gravity where it loads a joint.
    surfaces : sequence of FrictionSurface or None
        Of the n joints `names`.
    basis : Basis
        The base parameters of the later stage.

    Returns
    -------
    Prior
        Rows over [parameters (b,), delays (n,) s, changes of offsets (n,) N m, of
        asymmetries (n,), of viscous asymmetries (n,), of thermal terms (n,) 1/K]: the
        order of `NuisanceColumns`.
    """
    columns = NuisanceColumns(basis.size, len(names))
    gravity = stages.gravity if stages.gravity and stages.gravity.parameters else None
    of_gravity = gravity_prior(gravity, basis, names)
    friction = of_gravity.friction
    constants = of_gravity.constants
    tolerances = of_gravity.tolerances
    blocks = [np.pad(of_gravity.A, ((0, 0), (0, columns.count)))]
    values = [of_gravity.b]

    stated: list[tuple[str, str]] = []
    if gravity is not None and gravity.nuisance_covariance:
        stated = [(term.name, term.joint) for term in gravity.nuisances]
        size = len(gravity.parameters)
        covariance = np.array(gravity.nuisance_covariance)
        places = [basis.names.index(parameter.name) for parameter in gravity.parameters]
        for k, (name, joint) in enumerate(stated):
            j = names.index(joint)
            rms = friction_rms(_known(surfaces[j]))
            drift = PRIORS.session_std(rms)[EVEN_NAMES.index(name)]
            covariance[size + k, size + k] += drift**2
            places.append(columns.of(name, j))
        rows = whitened(covariance)
        wide = np.zeros((len(rows), columns.size))
        wide[:, places] = rows
        # Changes are against what the surfaces hold, which gravity's trials have put
        # there.
        inverse = np.linalg.pinv(of_gravity.A[:, places[:size]])
        to_rows = rows[:, :size] @ inverse
        blocks = [wide]
        values = [to_rows @ of_gravity.b]
        friction = {j: to_rows @ T for j, T in of_gravity.friction.items()}
        constants = {j: to_rows @ T for j, T in of_gravity.constants.items()}
        tolerances = {k: to_rows @ T for k, T in of_gravity.tolerances.items()}

    for j, (name, surface) in enumerate(zip(names, surfaces, strict=True)):
        if ("offset", name) in stated:
            continue
        rms = friction_rms(surface) if surface is not None else 1.0
        covariance = np.diag(PRIORS.even_std(max(rms, 1e-12)) ** 2)
        if surface is not None and stages.friction is not None:
            covariance = EvenPart.of_joint(stages.friction.joints[name], rms).covariance
        drift_std = PRIORS.session_std(max(rms, 1e-12))
        rows = whitened(covariance + np.diag(drift_std**2))
        wide = np.zeros((len(rows), columns.size))
        wide[:, [columns.of(term, j) for term in EVEN_NAMES]] = rows
        blocks.append(wide)
        values.append(np.zeros(len(rows)))

    for j, name in enumerate(names):
        identified = stages.friction.joints.get(name) if stages.friction else None
        thermal = term_of(identified, "thermal") if identified else None
        wide = np.zeros((1, columns.size))
        wide[0, columns.of("thermal", j)] = 1.0 / (
            thermal.std_error if thermal else 1.0
        )
        blocks.append(wide)
        values.append(np.zeros(1))

    rows = whitened(PRIORS.delay_covariance(len(names)))
    wide = np.zeros((len(rows), columns.size))
    wide[:, columns.delays] = rows
    blocks.append(wide)
    values.append(np.zeros(len(rows)))

    count = sum(map(len, values))
    first = len(values[0])
    padding = ((0, count - first), (0, 0))
    return Prior(
        A=np.vstack(blocks),
        b=np.concatenate(values),
        friction={j: np.pad(T, padding) for j, T in friction.items()},
        constants={
            j: np.pad(move, (0, count - first)) for j, move in constants.items()
        },
        tolerances={
            k: np.pad(move, (0, count - first)) for k, move in tolerances.items()
        },
    )


def _known(surface: FrictionSurface | None) -> FrictionSurface:
    assert surface is not None
    return surface
