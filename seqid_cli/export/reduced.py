"""The best model that a form can hold, and what it loses of the file's.

URDF, MJCF and parameter files know links, an armature, Coulomb and viscous friction.
With H the regressor of the base parameters pi (Eq. 4), s the sign of a joint's velocity
and tau the torque that the file's logs have measured (that of the whole file on motions
without logs),

    min over pi, c_j, d_j of   sum_j |tau_j - H_j pi - c_j s_j - d_j dq_j - o_j|^2 / sigma_j^2
                             + w |pi - pi_file|^2_C + w (the surface's own friction),

c_j and d_j not negative, sigma_j the error of the joint's torque and of the form
together, o_j only where the form has a place for it. The prior's small weight w decides
only where the motion does not tell. The bodies that can exist are then those nearest to
pi in units of what the motion tells of it, and friction is fitted once more beside
these bodies.

What is lost is the RMS of the difference to the file's torque, while a joint slides. It
is stated for the logs that the numbers are fitted to, and for those that are replayed,
whose motion may stress it more or less.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.optimize import lsq_linear

from seqid_cli.export.model import LEFT_OUT, ExportModel, Loss
from seqid_cli.export.motions import FullModel, Motions, TorqueSamples
from seqid_cli.identify.regression.equations import independent_share
from seqid_cli.model.bodies.nearest import (
    Identified,
    identified,
    nearest_bodies,
    whitening,
)
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.export import ExportedFriction, ExportedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import base_regressor, gear_ratios
from seqid_cli.robot.regressor import PER_LINK, inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Weight of the file's parameters against what the motion tells: a thousandth moves
# nothing that the motion determines, and is far above rounding.
PRIOR_WEIGHT = 1e-3
# Coulomb and viscous friction hold a surface well up to this share of it.
WELL_HELD = 0.2
# Fits, each with joints weighed by what the one before loses: the second changes
# little.
_PASSES = 2
_FITTED = (
    "has no place in this form, whose links and friction are fitted to the torque"
    " with it"
)
_SURFACE_POSITIONS, _SURFACE_SPEEDS = 21, 30
_LEAST_SIGMA = 1e-9  # N m; files of made models state no error at all


@dataclass(frozen=True, kw_only=True)
class Form:
    """What a form has a place for, beside links, armature, Coulomb and viscous friction."""

    offset: bool = False
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class CoulombViscous:
    """Coulomb and viscous friction of one joint, with an offset, as a law of friction."""

    coulomb: float
    viscous: float
    offset: float = 0.0
    sign_width: float = 0.0
    per_kelvin: float = 0.0

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque (N,) N m at positions and velocities (N,)."""
        return self.coulomb * np.sign(v) + self.viscous * v + self.offset

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) of temperatures: none is held."""
        return np.ones(len(celsius))


def needs_refit(model: ExportModel, left_over: Sequence[Fitted]) -> bool:
    """Return whether the file holds torque that the form's usual numbers leave out.

    `left_over` are effects that the form has no place for. Without any, and where
    Coulomb and viscous friction hold the surfaces well, the file's own parameters are
    the best.
    """
    fits = [fit for fit in model.friction if fit is not None]
    poor = any(fit.rms_misfit > WELL_HELD * fit.rms for fit in fits)
    return bool(left_over) or poor


def reduced(
    model: ExportModel, stages: Stages, motions: Motions, form: Form
) -> ExportModel:
    """Return the model with the numbers that lose least of the file's torque.

    Parameters
    ----------
    model : ExportModel
        With the file's own parameters, and friction fitted to its surfaces.
    stages : Stages
        Those of the file.
    motions : Motions
        On which torque counts.
    form : Form
        What the form has a place for.
    """
    model = replace(model, writes_offset=form.offset)
    full = FullModel.of(model.robot, stages)
    in_bodies = [item for item in full.effects if _is_of_bodies(item, model)]
    held = [item for item in full.effects if _name(item) in form.effects]
    unseen = [item for item in held if _name(item) == "backlash"]
    exact = [item for item in [*in_bodies, *held] if not any(item is x for x in unseen)]
    taken = [*exact, *unseen]
    left_over = [item for item in full.effects if not any(item is x for x in taken)]
    samples = list(motions.samples(full, held=exact, unseen=unseen))

    added = _added_parameters(in_bodies, model)
    if needs_refit(model, left_over):
        for _ in range(_PASSES):
            model = _refitted(model, stages, samples, form, added)
    others = list(motions.samples(full, held=exact, unseen=unseen, held_out=True))
    loss = Loss(
        rms=lost_torque(model, samples, added),
        replayed_rms=lost_torque(model, others, added),
        logs=len(samples),
        made=motions.made,
    )
    said = [text.replace(LEFT_OUT, _FITTED) for text in model.notes]
    return replace(model, loss=loss, notes=(*said, *motions.notes))


def _name(item: Fitted) -> str:
    return item.effect.name if isinstance(item, FittedEffect) else ""


def _is_of_bodies(item: Fitted, model: ExportModel) -> bool:
    """Return whether an effect is part of the links' and rotors' own parameters."""
    if _name(item) == "payload":
        return True
    alone = isinstance(item, FittedEffect) and not item.settings.get("coupling")
    return _name(item) == "rotor_inertia" and model.coupling == "diagonal" and alone


def _added_parameters(effects: Sequence[Fitted], model: ExportModel) -> Array:
    """Return what effects add to the standard parameters (11 n,), rotors last."""
    n = model.robot.n
    added = np.zeros((PER_LINK + 1) * n)
    for item in effects:
        assert isinstance(item, FittedEffect)
        if _name(item) == "payload":
            added[PER_LINK * (n - 1) : PER_LINK * n] += item.coefficients
        else:
            added[PER_LINK * n + (item.joint or 0)] += float(item.coefficients[0])
    return added


@dataclass
class _Equations:
    """Normal equations of base parameters (b,) and friction (n, 3), and of their prior."""

    matrix: Array
    right: Array
    unit_weights: Array  # (n,) 1 / sigma^2 of each joint
    counts: Array  # (n,) independent sliding samples

    @property
    def bases(self) -> int:
        """Number of base parameters."""
        return len(self.matrix) - 3 * len(self.counts)

    def friction_rows(self, joint: int) -> list[int]:
        """Return the unknowns of a joint's friction: Coulomb, viscous, offset."""
        first = self.bases + 3 * joint
        return [first, first + 1, first + 2]


def _refitted(
    model: ExportModel,
    stages: Stages,
    samples: Sequence[TorqueSamples],
    form: Form,
    added: Array,
) -> ExportModel:
    robot = model.robot
    of_file = identified(stages, robot)
    # A joint's rows err by what the file errs, and by what the form loses there: with
    # the file's error alone, a joint that loses much would pull the links of all others
    # along.
    sigmas = np.hypot(
        _file_errors(stages, robot), np.nan_to_num(lost_torque(model, samples, added))
    )
    equations = _equations(model, of_file, samples, sigmas, added)
    _add_prior(equations, model, of_file)
    values = _solved(equations, form)[: equations.bases]

    # What the bodies' own effects add is known, and was not part of the torque.
    with_added = identified(stages, robot, more=added)
    rows = of_file.basis.expression[list(of_file.rows)]
    demand = replace(
        with_added,
        values=values + rows @ added,
        covariance=_covariance(equations),
    )
    nearest = nearest_bodies(robot, demand, model.kept)
    standard = np.concatenate([(nearest.links + model.kept).ravel(), nearest.rotor])
    friction = _friction_beside(equations, model, rows @ (standard - added), form)
    return replace(
        model,
        nearest=nearest,
        friction=friction,
        deviations=_deviations(with_added, demand, standard),
        refitted=True,
    )


def _file_errors(stages: Stages, robot: Robot) -> Array:
    """Return the error (n,) N m of each joint's torque that the file states."""
    rigid = stages.inertia or stages.gravity
    errors = rigid.rmse if rigid is not None else {}
    found = np.array([errors.get(name) or np.nan for name in robot.joint_names])
    # A joint whose error is not known counts as the others do.
    usual = np.nanmean(found) if np.isfinite(found).any() else 1.0
    return np.maximum(np.where(np.isfinite(found), found, usual), _LEAST_SIGMA)


def _equations(
    model: ExportModel,
    demand: Identified,
    samples: Sequence[TorqueSamples],
    sigmas: Array,
    added: Array,
) -> _Equations:
    """Add up the weighted normal equations of the form's torque on all motions."""
    robot, rows = model.robot, list(demand.rows)
    n, b = robot.n, len(rows)
    equations = _Equations(
        matrix=np.zeros((b + 3 * n, b + 3 * n)),
        right=np.zeros(b + 3 * n),
        unit_weights=1.0 / sigmas**2,
        counts=np.zeros(n),
    )
    fixed = _fixed_values(demand, model, added)
    reflected = gear_ratios(robot) ** 2 * demand.known
    for part in samples:
        motion = part.motion
        H = base_regressor(robot, demand.basis, motion.q, motion.dq, motion.ddq)
        H = motion.filtered(np.ascontiguousarray(H))
        rotors = motion.filtered(reflected * motion.ddq)
        target = part.measured - rotors - H @ fixed
        friction = _friction_columns(part)
        share = independent_share(motion)
        for j in range(n):
            counts = part.sliding[:, j]
            X = np.hstack([H[counts, j][:, rows], friction[counts, j]])
            unknowns = [*range(b), *equations.friction_rows(j)]
            weight = share * equations.unit_weights[j]
            equations.matrix[np.ix_(unknowns, unknowns)] += weight * (X.T @ X)
            equations.right[unknowns] += weight * (X.T @ target[counts, j])
            equations.counts[j] += share * counts.sum()
    return equations


def _fixed_values(demand: Identified, model: ExportModel, added: Array) -> Array:
    """Return all base parameters (size,), zero where the logs determined them."""
    standard = np.concatenate([model.bodies.ravel(), model.nearest.rotor])
    values = demand.basis.expression @ (standard - added)
    values[list(demand.rows)] = 0.0
    return np.asarray(values)


def _friction_columns(part: TorqueSamples) -> Array:
    """Return columns (N, n, 3) of Coulomb, viscous and constant friction, low-passed."""
    motion = part.motion
    n = motion.q.shape[1]
    sign = sampled_friction([CoulombViscous(1.0, 0.0)] * n, motion)
    columns = np.stack([sign, motion.dq, np.ones_like(sign)], axis=2)
    return motion.filtered(columns, times=2)


def _add_prior(equations: _Equations, model: ExportModel, demand: Identified) -> None:
    """Add the file's own parameters, with a small weight."""
    b = equations.bases
    if b:
        precision = _precision(demand)
        told = np.diag(equations.matrix)[:b]
        stated = np.diag(precision)
        both = (told > 0.0) & (stated > 0.0)
        # Relative to what the motion tells, whatever the errors that the file states.
        scale = 1.0
        if both.any():
            scale = PRIOR_WEIGHT * float(np.median(told[both] / stated[both]))
        equations.matrix[:b, :b] += scale * precision
        equations.right[:b] += scale * (precision @ demand.values)

    for j, surface in enumerate(model.surfaces):
        unknowns = equations.friction_rows(j)
        weight = (
            PRIOR_WEIGHT * max(equations.counts[j], 1.0) * equations.unit_weights[j]
        )
        if surface is None:
            # Nothing is known of its friction: none is the best guess.
            equations.matrix[unknowns, unknowns] += weight
            continue
        q, v = surface_grid(surface)
        tau = surface.torque(q, v)
        X = np.column_stack([np.sign(v), v, np.ones_like(v)])
        equations.matrix[np.ix_(unknowns, unknowns)] += weight / len(q) * (X.T @ X)
        equations.right[unknowns] += weight / len(q) * (X.T @ tau)


def _precision(demand: Identified) -> Array:
    """Return the inverse (b, b) of the file's covariance, errors no smaller than rounding."""
    errors = np.sqrt(np.maximum(np.diag(demand.covariance), 0.0))
    scale = np.abs(demand.values).max(initial=0.0) + errors.max(initial=0.0)
    W = whitening(demand.covariance, 1e-9 * max(scale, 1e-12))
    return np.asarray(W.T @ W)


def surface_grid(surface: FrictionSurface) -> tuple[Array, Array]:
    """Return positions and velocities (M,) all over a surface, in both directions."""
    low, high = surface.scaling.speed
    low = min(max(low, SLIDES * surface.sign_width), high)
    speeds = np.linspace(low, high, _SURFACE_SPEEDS)
    positions = np.linspace(*surface.scaling.position, _SURFACE_POSITIONS)
    q, v = np.meshgrid(positions, np.concatenate([-speeds, speeds]))
    return q.ravel(), v.ravel()


def _solved(equations: _Equations, form: Form) -> Array:
    """Return all unknowns, Coulomb and viscous friction not negative, unheld offsets zero."""
    count = len(equations.matrix)
    free = np.ones(count, dtype=bool)
    lowest = np.full(count, -np.inf)
    for j in range(len(equations.counts)):
        coulomb, viscous, offset = equations.friction_rows(j)
        lowest[[coulomb, viscous]] = 0.0
        free[offset] = form.offset
    found = np.zeros(count)
    found[free] = _bounded(
        equations.matrix[np.ix_(free, free)], equations.right[free], lowest[free]
    )
    return found


def _bounded(matrix: Array, right: Array, lowest: Array) -> Array:
    """Minimise x' A x / 2 - b' x over x >= `lowest`, A (k, k) positive definite."""
    sizes = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix / np.outer(sizes, sizes)
    # A unit ridge of rounding size keeps the factor real.
    factor = np.linalg.cholesky(scaled + 1e-12 * np.eye(len(scaled)))
    seen = np.linalg.solve(factor, right / sizes)
    solution = lsq_linear(factor.T, seen, bounds=(lowest, np.inf), method="bvls")
    return np.asarray(solution.x / sizes)


def _covariance(equations: _Equations) -> Array:
    """Return the covariance (b, b) of the base parameters by the motion, friction free."""
    b = equations.bases
    A, B, C = (
        equations.matrix[:b, :b],
        equations.matrix[:b, b:],
        equations.matrix[b:, b:],
    )
    told = A - B @ np.linalg.pinv(C) @ B.T
    sizes = np.sqrt(np.maximum(np.diag(told), np.finfo(float).tiny))
    scaled = told / np.outer(sizes, sizes)
    inverse = np.linalg.inv(scaled + 1e-12 * np.eye(b))
    return np.asarray(inverse / np.outer(sizes, sizes))


def _friction_beside(
    equations: _Equations, model: ExportModel, values: Array, form: Form
) -> tuple[ExportedFriction | None, ...]:
    """Fit friction beside base parameters (b,) as the bodies that were found have them."""
    b = equations.bases
    found: list[ExportedFriction | None] = []
    for j, before in enumerate(model.friction):
        unknowns = equations.friction_rows(j)
        if before is None and not equations.counts[j]:
            found.append(None)
            continue
        taken = unknowns if form.offset else unknowns[:2]
        matrix = equations.matrix[np.ix_(taken, taken)]
        right = (
            equations.right[taken] - equations.matrix[np.ix_(taken, range(b))] @ values
        )
        lowest = np.array([0.0, 0.0, -np.inf])[: len(taken)]
        coulomb, viscous, *offset = _bounded(matrix, right, lowest).tolist()
        law = CoulombViscous(coulomb, viscous, offset[0] if offset else 0.0)
        found.append(_described(law, before, model.surfaces[j]))
    return tuple(found)


def _described(
    law: CoulombViscous,
    before: ExportedFriction | None,
    surface: FrictionSurface | None,
) -> ExportedFriction:
    """Return friction as a result, with its misfit to the file's surface."""
    if before is None or surface is None:
        return ExportedFriction(
            coulomb=law.coulomb,
            viscous=law.viscous,
            offset=law.offset,
            rms_misfit=0.0,
            rms=0.0,
            speed_range=[0.0, 0.0],
        )
    q, v = surface_grid(surface)
    misfit = surface.torque(q, v) - law.torque(q, v)
    return msgspec.structs.replace(
        before,
        coulomb=law.coulomb,
        viscous=law.viscous,
        offset=law.offset,
        rms_misfit=float(np.sqrt(np.mean(misfit**2))),
    )


def _deviations(
    of_file: Identified, demand: Identified, standard: Array
) -> tuple[ExportedParameter, ...]:
    """Compare the bodies (11 n,) with what they were to meet, in the file's standard errors."""
    split = PER_LINK * (len(standard) // (PER_LINK + 1))
    bodies, rotor = standard[:split], standard[split:]
    against_fit = replace(of_file, values=demand.values).deviations(bodies, rotor)
    return tuple(
        msgspec.structs.replace(
            entry, identified=float(value), refitted=entry.identified
        )
        for entry, value in zip(against_fit, of_file.values, strict=True)
    )


def written_torque(model: ExportModel, motion: Motion, added: Array) -> Array:
    """Return what a model file's numbers make of a motion (N, n) N m, low-passed.

    `added` (11 n,): standard parameters that are left out.
    """
    robot, n = model.robot, model.robot.n
    phi = model.bodies - added[: PER_LINK * n].reshape(n, PER_LINK)
    armature = model.armature - gear_ratios(robot) ** 2 * added[PER_LINK * n :]
    states = motion.q, motion.dq, motion.ddq
    rigid = (
        inverse_dynamics(robot.chain, robot.gravity, phi, *states)
        + armature * motion.ddq
    )
    laws = [None if fit is None else law_of(fit, model) for fit in model.friction]
    friction = sampled_friction(laws, motion)
    return motion.filtered(rigid) + motion.filtered(friction, times=2)


def law_of(fit: ExportedFriction, model: ExportModel) -> CoulombViscous:
    """Return the friction that a form writes, the offset where it has a place for it."""
    return CoulombViscous(
        fit.coulomb, fit.viscous, fit.offset if model.writes_offset else 0.0
    )


def lost_torque(
    model: ExportModel, samples: Sequence[TorqueSamples], added: Array
) -> Array:
    """Return the RMS (n,) N m of the file's torque minus the form's, while joints slide.

    NaN for a joint that slides in none of the motions.
    """
    squares, counts = np.zeros(model.robot.n), np.zeros(model.robot.n)
    for part in samples:
        lost = part.torque + part.left_out - written_torque(model, part.motion, added)
        squares += np.where(part.sliding, lost**2, 0.0).sum(axis=0)
        counts += part.sliding.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squares / counts)
