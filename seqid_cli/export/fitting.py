"""Links and friction of a form, fitted to the torque of motions.

With the sums A_j, b_j of `equations` and the error sigma_j of each joint,

    minimise over pi, c_j, d_j, o_j
        sum_j |tau_j - H_j pi - c_j s_j - d_j dq_j - o_j|^2 / sigma_j^2
        + w |pi - pi_file|^2_C + w (the surface's own friction),

c_j and d_j not negative, o_j only where the form has a place for it. The prior's small
weight w decides only where the motion does not tell. The bodies that can exist are then
those nearest to pi in units of what the motion tells of it, and friction is fitted once
more beside these bodies.

sigma_j holds what the file errs and what the form loses at that joint: with the first
alone, a joint that loses much would pull the links of all others along.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import msgspec
import numpy as np
from scipy.optimize import lsq_linear

from seqid_cli.export.equations import (
    FRICTION_TERMS,
    CoulombViscous,
    JointSums,
    Numbers,
)
from seqid_cli.export.model import ExportModel, SurfaceGrid, surface_grid
from seqid_cli.model.bodies.nearest import (
    Identified,
    identified,
    nearest_bodies,
    whitening,
)
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.export import ExportedFriction, ExportedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index

# Weight of the file's parameters against what the motion tells: a thousandth moves
# nothing that the motion determines, and is far above rounding.
PRIOR_WEIGHT = 1e-3
# Fits, each with joints weighed by what the one before loses: the second changes
# little.
_PASSES = 2
_SURFACE_POSITIONS = 21
_SURFACE_SPEEDS = 30
_LEAST_SIGMA = 1e-9  # N m; files of made models state no error at all
_ROUNDING = 1e-12  # of a scaled diagonal, added so that a factor stays real


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """What a fit takes besides the sums of motions.

    Attributes
    ----------
    model : ExportModel
        With the file's own numbers, which are the prior.
    stages : Stages
        Those of the file.
    added : (11 n,) array
        Standard parameters of the bodies that are no part of the torque.
    """

    model: ExportModel
    stages: Stages
    added: Array

    @cached_property
    def identified(self) -> Identified:
        """The file's base parameters."""
        return identified(self.stages, self.model.robot)

    def numbers(self, model: ExportModel) -> Numbers:
        """Return the numbers of a model that has the held effects."""
        return Numbers.of(model, self.identified, self.added, held=1.0)

    def joint_errors(self, model: ExportModel, sums: JointSums) -> Array:
        """Return the error (n,) N m of each joint, with what a model's numbers lose."""
        squares = sums.squared_errors(self.numbers(model), of_model=True)
        lost = np.sqrt(squares / np.maximum(sums.counts, np.finfo(float).tiny))
        return np.hypot(_errors_of_file(self.stages, self.model.robot), lost)

    def fitted(self, sums: JointSums) -> ExportModel:
        """Return the model with the numbers that lose least."""
        model = self.model
        for _ in range(_PASSES):
            model = self.fitted_beside(sums, self.joint_errors(model, sums))
        return model

    def fitted_beside(self, sums: JointSums, errors: Array) -> ExportModel:
        """Return the model fitted with given errors.

        Parameters
        ----------
        sums : JointSums
            What the motion tells.
        errors : (n,) array
            Of the joints' torque, N m (N where prismatic).
        """
        model = self.model
        of_file = self.identified
        n_base = len(of_file.rows)
        quadratic = self._weighted(sums, errors, of_file)
        values = _solved(quadratic, sums.n_joints, writes_offset=model.writes_offset)

        # What the bodies' own effects add is known, and was not part of the torque.
        with_added = identified(self.stages, model.robot, added_by_effects=self.added)
        expression = of_file.basis.expression[list(of_file.rows)]
        by_motion = replace(
            with_added,
            values=values[:n_base] + expression @ self.added,
            covariance=_covariance(quadratic, n_base),
        )
        nearest = nearest_bodies(model.robot, by_motion, model.locked_links)
        bodies = nearest.links + model.locked_links
        standard = np.concatenate([bodies.ravel(), nearest.rotor])

        laws = _friction_beside(
            quadratic,
            expression @ (standard - self.added),
            writes_offset=model.writes_offset,
        )
        friction: list[ExportedFriction | None] = []
        for law, fit, surface, count in zip(
            laws, model.friction, model.surfaces, sums.counts, strict=True
        ):
            # Without rows and without a surface nothing is known of a joint's friction.
            is_known = fit is not None or count
            friction.append(described(law, fit, surface) if is_known else None)
        return replace(
            model,
            nearest=nearest,
            friction=tuple(friction),
            deviations=deviations(with_added, by_motion.values, standard),
            refitted=True,
        )

    def _weighted(
        self, sums: JointSums, errors: Array, of_file: Identified
    ) -> "_Quadratic":
        """Return the sums of all joints by their `errors` (n,) N m, and the prior."""
        rows = np.array(of_file.rows, dtype=np.intp)
        base = self.numbers(self.model).base
        undetermined = np.setdiff1d(np.arange(len(base)), rows)
        n_unknowns = len(rows) + FRICTION_TERMS * sums.n_joints
        quadratic = _Quadratic(
            matrix=np.zeros((n_unknowns, n_unknowns)), right=np.zeros(n_unknowns)
        )

        columns = np.concatenate([rows, sums.n_base + np.arange(FRICTION_TERMS)])
        for j, error in enumerate(errors):
            unknowns = np.concatenate(
                [np.arange(len(rows)), _friction_rows(len(rows), j)]
            )
            # Base parameters that the logs did not determine are the bodies' own.
            right = sums.right[j][columns]
            of_bodies = sums.matrix[j][np.ix_(columns, undetermined)]
            right = right - of_bodies @ base[undetermined]
            matrix = sums.matrix[j][np.ix_(columns, columns)]
            quadratic.matrix[np.ix_(unknowns, unknowns)] += matrix / error**2
            quadratic.right[unknowns] += right / error**2

        _add_base_prior(quadratic, of_file)
        for j, surface in enumerate(self.model.surfaces):
            weight = PRIOR_WEIGHT * max(sums.counts[j], 1.0) / errors[j] ** 2
            _add_friction_prior(
                quadratic, _friction_rows(len(rows), j), surface, weight
            )
        return quadratic


@dataclass(frozen=True, kw_only=True)
class _Quadratic:
    """x' `matrix` x - 2 `right`' x of the unknowns: base parameters, then friction."""

    matrix: Array
    right: Array


def _friction_rows(n_base: int, joint: int) -> Index:
    """Return where a joint's Coulomb, viscous and constant friction stand."""
    return n_base + FRICTION_TERMS * joint + np.arange(FRICTION_TERMS)


def _errors_of_file(stages: Stages, robot: Robot) -> Array:
    """Return the error (n,) N m of each joint's torque that the file states."""
    rigid = stages.inertia or stages.gravity
    errors = rigid.rmse if rigid is not None else {}
    stated = np.array([errors.get(name) or np.nan for name in robot.joint_names])
    is_stated = np.isfinite(stated)
    # A joint whose error is not known counts as the others do.
    usual = np.nanmean(stated) if is_stated.any() else 1.0
    return np.maximum(np.where(is_stated, stated, usual), _LEAST_SIGMA)


def _add_base_prior(quadratic: _Quadratic, of_file: Identified) -> None:
    """Add the file's own base parameters, with a small weight."""
    n_base = len(of_file.rows)
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
    """Return the inverse (b, b) of the file's covariance.

    Errors count as no smaller than rounding.
    """
    errors = np.sqrt(np.maximum(np.diag(of_file.covariance), 0.0))
    scale = np.abs(of_file.values).max(initial=0.0) + errors.max(initial=0.0)
    W = whitening(of_file.covariance, 1e-9 * max(scale, 1e-12))
    return np.asarray(W.T @ W)


def _add_friction_prior(
    quadratic: _Quadratic,
    unknowns: Index,
    surface: FrictionSurface | None,
    weight: float,
) -> None:
    """Add a joint's friction as the file has it."""
    if surface is None:
        # Nothing is known of its friction: none is the best guess.
        quadratic.matrix[unknowns, unknowns] += weight
        return
    grid = coarse_grid(surface)
    X = np.column_stack([np.sign(grid.v), grid.v, np.ones_like(grid.v)])
    share = weight / len(grid.q)
    quadratic.matrix[np.ix_(unknowns, unknowns)] += share * (X.T @ X)
    quadratic.right[unknowns] += share * (X.T @ surface.torque(grid.q, grid.v))


def coarse_grid(surface: FrictionSurface) -> SurfaceGrid:
    """Return places of a surface where friction is fitted and its misfit measured."""
    return surface_grid(surface, positions=_SURFACE_POSITIONS, speeds=_SURFACE_SPEEDS)


def _solved(quadratic: _Quadratic, n_joints: int, *, writes_offset: bool) -> Array:
    """Return the unknowns without regard to bodies.

    Coulomb and viscous friction are not negative, an offset without a place is zero.
    """
    size = len(quadratic.right)
    n_base = size - FRICTION_TERMS * n_joints
    held = np.ones(size, dtype=bool)
    lowest = np.full(size, -np.inf)
    for j in range(n_joints):
        coulomb, viscous, offset = _friction_rows(n_base, j)
        lowest[[coulomb, viscous]] = 0.0
        held[offset] = writes_offset
    values = np.zeros(size)
    values[held] = _bounded(
        quadratic.matrix[np.ix_(held, held)], quadratic.right[held], lowest[held]
    )
    return values


def _bounded(matrix: Array, right: Array, lowest: Array) -> Array:
    """Minimise x' A x / 2 - b' x over x >= `lowest`, A (k, k) positive definite."""
    sizes = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix / np.outer(sizes, sizes)
    factor = np.linalg.cholesky(scaled + _ROUNDING * np.eye(len(scaled)))
    # With A = F F' it is the least squares of F' x against F^-1 b.
    target = np.linalg.solve(factor, right / sizes)
    solution = lsq_linear(factor.T, target, bounds=(lowest, np.inf), method="bvls")
    return np.asarray(solution.x / sizes)


def _covariance(quadratic: _Quadratic, n_base: int) -> Array:
    """Return the covariance (b, b) of the base parameters by the motion.

    Friction is free: what could be friction as well tells nothing of the bodies.
    """
    of_base = quadratic.matrix[:n_base, :n_base]
    of_both = quadratic.matrix[:n_base, n_base:]
    of_friction = quadratic.matrix[n_base:, n_base:]
    information = of_base - of_both @ np.linalg.pinv(of_friction) @ of_both.T
    sizes = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    scaled = information / np.outer(sizes, sizes)
    inverse = np.linalg.inv(scaled + _ROUNDING * np.eye(n_base))
    return np.asarray(inverse / np.outer(sizes, sizes))


def _friction_beside(
    quadratic: _Quadratic, base: Array, *, writes_offset: bool
) -> list[CoulombViscous]:
    """Fit friction beside given base parameters (b,): those of the bodies."""
    n_base = len(base)
    n_joints = (len(quadratic.right) - n_base) // FRICTION_TERMS
    n_terms = FRICTION_TERMS if writes_offset else FRICTION_TERMS - 1
    lowest = np.array([0.0, 0.0, -np.inf])[:n_terms]
    laws = []
    for j in range(n_joints):
        unknowns = _friction_rows(n_base, j)[:n_terms]
        matrix = quadratic.matrix[np.ix_(unknowns, unknowns)]
        by_bodies = quadratic.matrix[np.ix_(unknowns, np.arange(n_base))] @ base
        values = _bounded(matrix, quadratic.right[unknowns] - by_bodies, lowest)
        laws.append(
            CoulombViscous(
                coulomb=float(values[0]),
                viscous=float(values[1]),
                offset=float(values[2]) if writes_offset else 0.0,
            )
        )
    return laws


def described(
    law: CoulombViscous,
    fit: ExportedFriction | None,
    surface: FrictionSurface | None,
) -> ExportedFriction:
    """Return friction as a result, with its misfit to the file's surface.

    Parameters
    ----------
    law : CoulombViscous
        The friction that is written.
    fit : ExportedFriction, optional
        The one that was fitted to the surface alone.
    surface : FrictionSurface, optional
        The joint's friction in the file.
    """
    if fit is None or surface is None:
        return ExportedFriction(
            coulomb=law.coulomb,
            viscous=law.viscous,
            offset=law.offset,
            rms_misfit=0.0,
            rms=0.0,
            speed_range=[0.0, 0.0],
        )
    grid = coarse_grid(surface)
    misfit = surface.torque(grid.q, grid.v) - law.torque(grid.q, grid.v)
    return msgspec.structs.replace(
        fit,
        coulomb=law.coulomb,
        viscous=law.viscous,
        offset=law.offset,
        rms_misfit=float(np.sqrt(np.mean(misfit**2))),
    )


def deviations(
    of_file: Identified, fitted_values: Array, standard: Array
) -> tuple[ExportedParameter, ...]:
    """Compare bodies with the base parameters that they were to meet.

    Parameters
    ----------
    of_file : Identified
        What the file says, in whose standard errors differences are.
    fitted_values : (b,) array
        The base parameters that were to be met.
    standard : (11 n,) array
        Standard parameters of the bodies, rotors last.
    """
    split = PER_LINK * (len(standard) // (PER_LINK + 1))
    against_fit = replace(of_file, values=fitted_values).deviations(
        phi=standard[:split], rotor=standard[split:]
    )
    return tuple(
        msgspec.structs.replace(
            entry, identified=float(value), refitted=entry.identified
        )
        for entry, value in zip(against_fit, of_file.values, strict=True)
    )
