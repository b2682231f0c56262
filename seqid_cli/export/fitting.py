"""Bodies that can exist and friction, fitted to the torque of motions together.

With the sums A_j, b_j of `equations` and the error sigma_j of each joint,

    minimise over x   x' A x - 2 b' x,   A = sum_j A_j / sigma_j^2 + prior,

x holding the base parameters of bodies that can exist, and the friction of all joints.
The minimum without conditions, x0 = A^-1 b, and W with W'W = A turn that into |W (x -
x0)|^2: the conic problem of `model.bodies.consistent`, in which friction stands beside
the rotors as a number that is not negative.

sigma_j is what the form leaves at joint j, so it follows from x: a few passes find both.
This is the maximum of the likelihood over x and sigma.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from seqid_cli.export.equations import FRICTION_TERMS, CoulombViscous, JointSums
from seqid_cli.export.model import ExportModel
from seqid_cli.model.bodies.consistent import consistent_links
from seqid_cli.model.bodies.nearest import (
    Identified,
    NearestBodies,
    expected_links,
    whitening,
)
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.typing import Array, Index

# Weight of the file's parameters against what the motion tells: a thousandth moves
# nothing that the motion determines, and is far above rounding.
PRIOR_WEIGHT = 1e-3
# Share of a joint's torque below which no form is known: without it, a joint that is
# met exactly would outweigh all others.
LEAST_ERROR = 1e-3
# Passes without the conditions of bodies, which are cheap, and with them.
_FREE_PASSES = 4
_BODY_PASSES = 6
# Errors that change by less than this share end the passes.
_SETTLED = 0.01
_SURFACE_POSITIONS = 21
_SURFACE_SPEEDS = 30
_ROUNDING = 1e-12  # of a scaled diagonal, added so that a factor stays real


@dataclass(frozen=True, kw_only=True)
class BodiesAndFriction:
    """What a form is given.

    `values` (b,) are the base parameters that the torque asks for without regard to
    bodies, `nearest` the bodies, `friction` the law of each joint, `errors` (n,) N m
    what they leave of the torque.
    """

    values: Array
    nearest: NearestBodies
    friction: tuple[CoulombViscous, ...]
    errors: Array


@dataclass(frozen=True, kw_only=True)
class _Quadratic:
    """x' `matrix` x - 2 `right`' x of all unknowns (b + 3 n,)."""

    matrix: Array
    right: Array


def fitted_bodies(
    sums: JointSums,
    model: ExportModel,
    of_file: Identified,
    added: Array,
    *,
    writes_offset: bool,
) -> BodiesAndFriction:
    """Find the bodies and the friction with which a form comes nearest to the torque.

    Parameters
    ----------
    sums : JointSums
        The torque to be met.
    model : ExportModel
        With the file's surfaces, and the parts of its bodies that stay.
    of_file : Identified
        The file's base parameters: the prior.
    added : (11 n,) array
        Standard parameters that the bodies have besides those of the torque.
    writes_offset : bool
        Whether the form has a place for a constant torque.
    """
    errors = np.maximum(sums.torque_rms(), np.finfo(float).tiny)
    least = LEAST_ERROR * errors
    values = np.zeros(sums.n_base + FRICTION_TERMS * sums.n_joints)
    for _ in range(_FREE_PASSES):
        quadratic = _weighted(sums, errors, model, of_file)
        values = _solved(quadratic, sums, writes_offset)
        errors = np.maximum(sums.residual_rms(values), least)

    rows = of_file.basis.expression[list(of_file.rows)]
    for _ in range(_BODY_PASSES):
        before = errors
        quadratic = _weighted(sums, errors, model, of_file)
        nearest = _nearest(quadratic, sums, model, of_file, added, writes_offset)
        standard = np.concatenate([(nearest.links + model.kept).ravel(), nearest.rotor])
        base = rows @ (standard - added)
        # The bodies may differ from the nearest by a standard error: friction follows.
        with_friction = _friction_beside(quadratic, sums, base, writes_offset)
        errors = np.maximum(sums.residual_rms(with_friction), least)
        if np.all(np.abs(errors - before) < _SETTLED * before):
            break

    values = _solved(quadratic, sums, writes_offset)
    friction = [
        CoulombViscous(*with_friction[sums.friction_rows(j)].tolist())
        for j in range(sums.n_joints)
    ]
    return BodiesAndFriction(
        values=values[: sums.n_base],
        nearest=nearest,
        friction=tuple(friction),
        errors=errors,
    )


def _weighted(
    sums: JointSums, errors: Array, model: ExportModel, of_file: Identified
) -> _Quadratic:
    """Return the sums of all joints by their `errors` (n,) N m, and the prior."""
    size = sums.n_base + FRICTION_TERMS * sums.n_joints
    matrix = np.zeros((size, size))
    right = np.zeros(size)
    for j in range(sums.n_joints):
        unknowns = sums.unknowns(j)
        matrix[np.ix_(unknowns, unknowns)] += sums.matrix[j] / errors[j] ** 2
        right[unknowns] += sums.right[j] / errors[j] ** 2
    quadratic = _Quadratic(matrix=matrix, right=right)
    _add_base_prior(quadratic, sums.n_base, of_file)
    for j, surface in enumerate(model.surfaces):
        weight = PRIOR_WEIGHT * max(sums.counts[j], 1.0) / errors[j] ** 2
        _add_friction_prior(quadratic, sums.friction_rows(j), surface, weight)
    return quadratic


def _add_base_prior(quadratic: _Quadratic, n_base: int, of_file: Identified) -> None:
    """Add the file's base parameters, with a small weight."""
    if not n_base:
        return
    precision = _precision(of_file)
    by_motion = np.diag(quadratic.matrix)[:n_base]
    by_file = np.diag(precision)
    both_tell = (by_motion > 0.0) & (by_file > 0.0)
    # Relative to what the motion tells, whatever the errors that the file states.
    scale = 1.0
    if both_tell.any():
        ratio = by_motion[both_tell] / by_file[both_tell]
        scale = PRIOR_WEIGHT * float(np.median(ratio))
    quadratic.matrix[:n_base, :n_base] += scale * precision
    quadratic.right[:n_base] += scale * (precision @ of_file.values)


def _precision(of_file: Identified) -> Array:
    """Return the inverse (b, b) of the file's covariance, errors no smaller than rounding."""
    errors = np.sqrt(np.maximum(np.diag(of_file.covariance), 0.0))
    scale = np.abs(of_file.values).max(initial=0.0) + errors.max(initial=0.0)
    W = whitening(of_file.covariance, 1e-9 * max(scale, 1e-12))
    return np.asarray(W.T @ W)


def _add_friction_prior(
    quadratic: _Quadratic,
    unknowns: list[int],
    surface: FrictionSurface | None,
    weight: float,
) -> None:
    """Add a joint's friction as the file has it, or none where it is not known."""
    if surface is None:
        quadratic.matrix[unknowns, unknowns] += weight
        return
    q, v = surface_grid(surface)
    X = np.column_stack([np.sign(v), v, np.ones_like(v)])
    share = weight / len(q)
    quadratic.matrix[np.ix_(unknowns, unknowns)] += share * (X.T @ X)
    quadratic.right[unknowns] += share * (X.T @ surface.torque(q, v))


def surface_grid(surface: FrictionSurface) -> tuple[Array, Array]:
    """Return positions and velocities (M,) all over a surface, in both directions."""
    slowest, fastest = surface.scaling.speed
    slowest = min(max(slowest, SLIDES * surface.sign_width), fastest)
    speeds = np.linspace(slowest, fastest, _SURFACE_SPEEDS)
    positions = np.linspace(*surface.scaling.position, _SURFACE_POSITIONS)
    q, v = np.meshgrid(positions, np.concatenate([-speeds, speeds]))
    return q.ravel(), v.ravel()


# ---- with and without the conditions of bodies


def _solved(quadratic: _Quadratic, sums: JointSums, writes_offset: bool) -> Array:
    """Return the unknowns (b + 3 n,) without regard to bodies, unheld offsets zero."""
    size = len(quadratic.right)
    held = np.ones(size, dtype=bool)
    lowest = np.full(size, -np.inf)
    for j in range(sums.n_joints):
        coulomb, viscous, offset = sums.friction_rows(j)
        lowest[[coulomb, viscous]] = 0.0
        held[offset] = writes_offset
    values = np.zeros(size)
    part = _part_of(quadratic, np.flatnonzero(held))
    values[held] = _bounded(part, lowest[held])
    return values


def _part_of(quadratic: _Quadratic, unknowns: Index) -> _Quadratic:
    """Return the function of some unknowns, the others being zero."""
    return _Quadratic(
        matrix=quadratic.matrix[np.ix_(unknowns, unknowns)],
        right=quadratic.right[unknowns],
    )


@dataclass(frozen=True, kw_only=True)
class _Factor:
    """W (k, k) with W'W the matrix of a quadratic, and W x0 (k,) of its minimum x0."""

    whitening: Array
    whitened_minimum: Array


def _factor(quadratic: _Quadratic) -> _Factor:
    diagonal = np.maximum(np.diag(quadratic.matrix), np.finfo(float).tiny)
    sizes = np.sqrt(diagonal)
    scaled = quadratic.matrix / np.outer(sizes, sizes)
    lower = np.linalg.cholesky(scaled + _ROUNDING * np.eye(len(scaled)))
    return _Factor(
        whitening=lower.T * sizes,
        whitened_minimum=np.asarray(np.linalg.solve(lower, quadratic.right / sizes)),
    )


def _bounded(quadratic: _Quadratic, lowest: Array) -> Array:
    """Return the minimum (k,) among x >= `lowest`."""
    sizes = np.sqrt(np.maximum(np.diag(quadratic.matrix), np.finfo(float).tiny))
    factor = _factor(quadratic)
    solution = lsq_linear(
        factor.whitening / sizes,
        factor.whitened_minimum,
        bounds=(lowest, np.inf),
        method="bvls",
    )
    return np.asarray(solution.x / sizes)


def _nearest(
    quadratic: _Quadratic,
    sums: JointSums,
    model: ExportModel,
    of_file: Identified,
    added: Array,
    writes_offset: bool,
) -> NearestBodies:
    """Return the bodies of the minimum in which bodies can exist, friction beside them."""
    robot = model.robot
    n_base = sums.n_base
    n_friction_terms = FRICTION_TERMS if writes_offset else FRICTION_TERMS - 1
    friction_rows = np.array(
        [sums.friction_rows(j)[:n_friction_terms] for j in range(sums.n_joints)]
    )
    unknowns = np.concatenate([np.arange(n_base), friction_rows.ravel()])
    part = _part_of(quadratic, unknowns)
    factor = _factor(part)
    minimum = np.linalg.solve(factor.whitening, factor.whitened_minimum)

    # The bodies' own base parameters: with what effects add, without what stays.
    n_links = PER_LINK * robot.n
    free_rotors = list(of_file.free)
    rows = of_file.basis.expression[list(of_file.rows)]
    of_links = rows[:, :n_links]
    of_rotors = rows[:, n_links:][:, free_rotors]
    values = minimum[:n_base] + rows @ added - of_links @ model.kept.ravel()
    expected, from_cad = expected_links(robot, model.kept, of_links, values, of_rotors)
    link_sizes = expected[:, :3, :3].trace(axis1=1, axis2=2)
    rotor_sizes = (link_sizes / gear_ratios(robot) ** 2)[free_rotors]

    friction, friction_sizes = _friction_unknowns(part, sums, n_base, n_friction_terms)
    n_friction = len(part.right) - n_base
    links, beside, exact = consistent_links(
        expected,
        np.concatenate([rotor_sizes, friction_sizes]),
        np.vstack([of_links, np.zeros((n_friction, n_links))]),
        np.hstack(
            [np.vstack([of_rotors, np.zeros((n_friction, len(free_rotors)))]), friction]
        ),
        np.concatenate([values, minimum[n_base:]]),
        factor.whitening,
    )
    rotor = of_file.known.copy()
    rotor[free_rotors] = beside[: len(free_rotors)]
    return NearestBodies(links, rotor, exact, from_cad)


def _friction_unknowns(
    part: _Quadratic, sums: JointSums, n_base: int, n_terms: int
) -> tuple[Array, Array]:
    """Return friction as numbers that are not negative: columns (k, m), and sizes (m,).

    A constant torque has either sign: it is the difference of two such numbers.
    """
    size = len(part.right)
    columns: list[Array] = []
    sizes: list[float] = []
    diagonal = np.maximum(np.diag(part.matrix), np.finfo(float).tiny)
    for k in range(n_base, size):
        joint, term = divmod(k - n_base, n_terms)
        unit = np.eye(size)[k]
        # Of about one error of the joint's torque.
        typical = float(np.sqrt(max(sums.counts[joint], 1.0) / diagonal[k]))
        signed = [unit, -unit] if term == FRICTION_TERMS - 1 else [unit]
        columns += signed
        sizes += [typical] * len(signed)
    return np.array(columns).T, np.array(sizes)


def _friction_beside(
    quadratic: _Quadratic, sums: JointSums, base: Array, writes_offset: bool
) -> Array:
    """Return the unknowns (b + 3 n,) with friction fitted beside base parameters (b,)."""
    n_base = sums.n_base
    values = np.concatenate([base, np.zeros(FRICTION_TERMS * sums.n_joints)])
    lowest = np.array([0.0, 0.0, -np.inf])
    for j in range(sums.n_joints):
        n_terms = FRICTION_TERMS if writes_offset else FRICTION_TERMS - 1
        unknowns = np.array(sums.friction_rows(j)[:n_terms])
        part = _part_of(quadratic, unknowns)
        by_bodies = quadratic.matrix[np.ix_(unknowns, np.arange(n_base))] @ base
        part = replace(part, right=part.right - by_bodies)
        values[unknowns] = _bounded(part, lowest[:n_terms])
    return values
