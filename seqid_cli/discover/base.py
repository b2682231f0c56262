"""The base model as columns: what may take up the residual before effects do.

Per joint the rows are

    tau - modelled = H dpi + F_j df_j + X_j dc,

deviations of the rigid base parameters (shared by all joints) and of the joint's own
friction from their values in the parameter file, and of the nuisance terms from what is
known of them (see `nuisances`). Left out, these make clean logs show effects. So does
what reversals leave of friction, which the rows are whitened for (see `reversals`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from seqid_cli.discover.nuisances import (
    THERMAL,
    Nuisance,
    nuisances_of,
    shown_warmth,
)
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.identify.nuisances import with_term
from seqid_cli.identify.regression.least_squares import whitened
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage, RigidStage, Stages
from seqid_cli.robot.base_parameters import (
    Basis,
    base_regressor,
    free_basis,
    loaded_columns,
)
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Mask

LIKELY = 2.0  # of a column's torque beforehand, over what the file leaves
# of a surface's largest standard error, by which entries that are tied may part
TIED = 1e-3
# of a joint's largest bound, at least: friction that no sample shows is not free
UNSHOWN = 1e-3


@dataclass(frozen=True, kw_only=True)
class Base:
    """Base columns of every joint's rows.

    Attributes
    ----------
    basis : Basis
        Of the rigid body, with b parameters.
    rigid : tuple of (M_j, b) arrays
        Columns of the rigid parameters, which all joints share.
    friction : tuple of (M_j, k_j) arrays
        Columns of each joint's friction.
    friction_rms : tuple of (k_j,) arrays
        RMS of each of these columns over all samples at which it has any torque.
    nuisances : tuple of NuisanceRows
        Columns of the nuisance terms.
    y : tuple of (M_j,) arrays
        Residual of the file's model [N m; N where prismatic].
    prior : tuple of (m, .) arrays
        Rows of unit variance by which the file knows deviations to be zero: of the
        rigid body (m, b), then of the friction of each joint (m_j, k_j).
    scene_bases : tuple of SceneBase
        The base at all samples, by data set.
    start : (n,) array
        RMS of `y`.
    """

    basis: Basis
    rigid: tuple[Array, ...]
    friction: tuple[Array, ...]
    friction_rms: tuple[Array, ...]
    nuisances: tuple[NuisanceRows, ...]
    y: tuple[Array, ...]
    prior: tuple[Array, ...]
    scene_bases: tuple[SceneBase, ...]
    start: Array

    @cached_property
    def bounds(self) -> list[Array]:
        """Inverse standard deviations: rigid (b,), then friction (k_j,) by joint.

        No column's torque is likely to be more than some times what the file leaves.
        That keeps directions harmless which the logs, or some of the folds, leave open.

        Of friction that is where a column has any torque, also at samples that are no
        rows. A drag beyond the speeds of the trials is nothing at all other samples:
        over the rows, of which one or two just touch it, it would be free to be
        anything, and what the base adds elsewhere would be as well.
        """
        bounds = [self._likely(dict(enumerate(self.rigid)))]
        for size, left_by_file in zip(self.friction_rms, self.start, strict=True):
            likely = np.zeros_like(size)
            if left_by_file > 0.0:
                likely = size / (LIKELY * left_by_file)
            bounds.append(np.maximum(likely, UNSHOWN * np.max(likely, initial=0.0)))
        return bounds

    def nuisance_precision(self, nuisance: NuisanceRows) -> Array:
        """Return the precision (1, 1) beforehand of a nuisance term's deviation."""
        likely = self._likely(nuisance.columns)
        return np.diag(likely**2 + nuisance.term.std**-2)

    def _likely(self, columns: Mapping[int, Array]) -> Array:
        """Return inverse standard deviations (k,) of coefficients.

        Their columns are (M_j, k) by joint.
        """
        n_coefficients = next(iter(columns.values())).shape[1]
        squares = np.zeros(n_coefficients)
        for joint, X in columns.items():
            if self.start[joint] > 0.0:
                squares += np.sum(X**2, axis=0) / (LIKELY * self.start[joint]) ** 2
        n_rows = sum(len(X) for X in columns.values())
        return np.asarray(np.sqrt(squares / max(n_rows, 1)))

    def deviation(
        self, rigid: Array, friction: Sequence[Array], nuisances: Sequence[float] = ()
    ) -> list[Array]:
        """Compute the torque of deviations from the file at every sample.

        Parameters
        ----------
        rigid : (b,) array
            Of the rigid base parameters.
        friction : sequence of (k_j,) arrays
            Of each joint's friction.
        nuisances : sequence of float, optional
            Of the nuisance terms; none by default.

        Returns
        -------
        list of (N, n) arrays
            N m (N where prismatic), one per data set.
        """
        sized_terms = [
            (size, of_term.term)
            for size, of_term in zip(nuisances, self.nuisances, strict=False)
        ]
        deviations = []
        for number, of_scene in enumerate(self.scene_bases):
            of_friction = of_scene.friction_torque(friction)
            low = of_scene.scene.motion.filtered(of_friction, times=2)
            low += nuisance_torque(sized_terms, number, low.shape)
            deviations.append(of_scene.rigid_torque(rigid) + low)
        return deviations


@dataclass(frozen=True, kw_only=True)
class NuisanceRows:
    """A nuisance term and its columns (M_j, 1) on the rows of the joints it touches."""

    term: Nuisance
    columns: Mapping[int, Array]

    @classmethod
    def of(cls, term: Nuisance, rows: Rows) -> NuisanceRows:
        """Take a term's columns on rows."""
        columns = {}
        for joint, per_scene in term.columns.items():
            as_columns = [values[:, None] for values in per_scene]
            columns[joint] = rows.torque(joint, as_columns)
        return cls(term=term, columns=columns)


def nuisance_torque(
    sizes: Iterable[tuple[float, Nuisance]], number: int, shape: tuple[int, ...]
) -> Array:
    """Compute the torque of nuisance terms.

    Parameters
    ----------
    sizes : iterable of (float, Nuisance)
        The terms, each with its coefficient.
    number : int
        Of the data set.
    shape : tuple of int
        (N, n) of the data set.

    Returns
    -------
    (N, n) array
        N m (N where prismatic).
    """
    torque = np.zeros(shape)
    for size, term in sizes:
        for joint, per_scene in term.columns.items():
            torque[:, joint] += size * per_scene[number]
    return torque


@dataclass(frozen=True)
class SceneBase:
    """Base of one data set at all of its samples.

    Columns of friction are made as they are used: they would take most of the memory.

    Attributes
    ----------
    H : (N, L) array
        Low-passed columns of the rigid parameters that load a joint, joint by joint.
    loaded : (n, b) mask
        Which of the b parameters load each joint: a joint feels nothing of the links
        before it.
    scene : Scene
        The data set.
    stage : FrictionStage, optional
        The file's friction.
    residual : (N, n) array
        What the file's model leaves [N m; N where prismatic].
    """

    H: NDArray[np.float32]
    loaded: Mask
    scene: Scene
    stage: FrictionStage | None
    residual: Array

    def rigid_torque(self, coefficients: Array) -> Array:
        """Return the torque (N, n) N m of rigid parameters (b,), low-passed."""
        torque = np.empty_like(self.residual)
        single_precision = coefficients.astype(np.float32)
        for joint, loaded in enumerate(self.loaded):
            of_joint = self.H[:, _of_joint(self.loaded, joint)]
            torque[:, joint] = of_joint @ single_precision[loaded]
        return torque

    def friction_torque(self, coefficients: Sequence[Array]) -> Array:
        """Return the torque (N, n) N m of friction (k_j,) by joint, not low-passed."""
        torque = np.empty_like(self.residual)
        for joint, of_joint in enumerate(coefficients):
            for tile in tiles(len(torque)):
                columns = friction_columns(self.scene, self.stage, joint, tile)
                torque[tile, joint] = columns @ of_joint
        return torque


def base_of(rows: Rows, stages: Stages) -> Base:
    """Compute the base columns of all rows.

    Parameters
    ----------
    rows : Rows
        The rows of all data sets.
    stages : Stages
        Those of the parameter file.
    """
    scenes = rows.scenes
    robot = scenes[0].robot
    basis = free_basis(robot)
    loaded = loaded_columns(robot, basis)

    # Rows keep every digit. At all samples, of which there are many more, single
    # precision is enough for what the base adds to the file's torque.
    H_by_scene: list[NDArray[np.float32]] = []
    kept_by_scene: list[Array] = []
    for scene, samples in zip(scenes, rows.samples, strict=True):
        H = _rigid_columns(scene, basis, loaded)
        H_by_scene.append(H.astype(np.float32))
        kept_by_scene.append(H[samples])

    # What the file says of a nuisance is not in its model's torque.
    nuisances = nuisances_of(scenes, stages)
    residual_by_scene = []
    for number, scene in enumerate(scenes):
        residual = residual_of(scene)
        sizes_of_file = ((term.mean, term) for term in nuisances)
        known_torque = nuisance_torque(sizes_of_file, number, residual.shape)
        residual_by_scene.append(residual - known_torque)

    stage = stages.friction
    rigid = []
    friction = []
    friction_rms = []
    y = []
    for joint in range(robot.n):
        of_joint = _of_joint(loaded, joint)
        columns = rows.of_kept(joint, [kept[:, of_joint] for kept in kept_by_scene])
        of_rows = np.zeros((len(columns), basis.size))
        of_rows[:, loaded[joint]] = rows.whitened(joint, columns)
        rigid.append(of_rows)
        size = _ColumnRms(joint)
        per_scene = (
            {
                joint: size.counted(
                    scene, friction_columns(scene, stages.friction, joint)
                )
            }
            for scene in scenes
        )
        friction.append(rows.columns(per_scene, 2)[joint])
        friction_rms.append(size.rms)
        y.append(rows.torque(joint, [x[:, joint] for x in residual_by_scene]))

    friction_priors = [
        _friction_prior(stage, name, columns.shape[1])
        for name, columns in zip(robot.joint_names, friction, strict=True)
    ]
    return Base(
        basis=basis,
        rigid=tuple(rigid),
        friction=tuple(friction),
        friction_rms=tuple(friction_rms),
        nuisances=tuple(NuisanceRows.of(term, rows) for term in nuisances),
        y=tuple(y),
        prior=(
            _rigid_prior(basis, [stages.gravity, stages.inertia]),
            *friction_priors,
        ),
        scene_bases=tuple(
            SceneBase(
                H=H,
                loaded=loaded,
                scene=scene,
                stage=stage,
                residual=residual,
            )
            for H, scene, residual in zip(
                H_by_scene, scenes, residual_by_scene, strict=True
            )
        ),
        start=np.array(
            [np.sqrt(np.mean(of_joint**2)) if len(of_joint) else 0.0 for of_joint in y]
        ),
    )


class _ColumnRms:
    """The RMS of columns where they have any torque, as the data sets pass by.

    Parameters
    ----------
    joint : int
        The joint, of which samples count at which it slides.
    """

    def __init__(self, joint: int) -> None:
        self.joint = joint
        self._squares: Array = np.zeros(1)
        self._counts: Array = np.zeros(1)

    def counted(self, scene: Scene, columns: Array) -> Array:
        """Count the columns (N, k) of one more data set, and return them."""
        sliding = columns[scene.slides[:, self.joint]]
        self._squares = self._squares + np.sum(sliding**2, axis=0)
        self._counts = self._counts + np.count_nonzero(sliding, axis=0)
        return columns

    @property
    def rms(self) -> Array:
        """The RMS (k,), zero of a column without any torque."""
        return np.asarray(np.sqrt(self._squares / np.maximum(self._counts, 1)))


def _rigid_columns(scene: Scene, basis: Basis, loaded: Mask) -> Array:
    """Return low-passed columns (N, L) of the rigid parameters that load a joint."""
    motion = scene.motion
    unfiltered = base_regressor(scene.robot, basis, motion.q, motion.dq, motion.ddq)
    return motion.filtered(unfiltered[:, loaded])


def _of_joint(loaded: Mask, joint: int) -> slice:
    """Return which of the L columns that load any joint are those of one joint."""
    edges = np.cumsum([0, *loaded.sum(axis=1)])
    return slice(int(edges[joint]), int(edges[joint + 1]))


def residual_of(scene: Scene) -> Array:
    """Return the torque (N, n) N m that the file's model and its delays leave."""
    assert scene.motion.tau is not None
    logged = scene.model.late(scene.modelled_filtered, scene.motion)
    return np.asarray(scene.motion.tau - logged)


def has_trials(scene: Scene, joint: Joint) -> bool:
    """Return whether the file tells where friction was identified.

    That is at which speeds and in which postures; of all joints for `joint` None.
    """
    surfaces = scene.model.surfaces
    if joint is not None:
        surfaces = [surfaces[joint]]
    return all(
        surface is not None and len(surface.speeds) > 0 and surface.postures
        for surface in surfaces
    )


def friction_columns(
    scene: Scene, stage: FrictionStage | None, joint: int, part: slice = slice(None)
) -> Array:
    """Return the columns of one joint's free friction, not low-passed.

    They are those of its surface, of what the file does not know below the slowest
    speed, and of a drag beyond the fastest; or Coulomb and viscous friction, and an
    offset where a simultaneous fit had one.

    Parameters
    ----------
    scene : Scene
        The data set.
    stage : FrictionStage, optional
        The file's friction.
    joint : int
        Index of the joint.
    part : slice
        Samples that are wanted.

    Returns
    -------
    (N, k_j) array
        N m (N where prismatic) per unit coefficient.
    """
    surface = scene.model.surfaces[joint]
    v = scene.motion.dq[part, joint]
    name = scene.robot.joint_names[joint]
    of_file = stage.joints.get(name) if stage is not None else None
    if surface is None or of_file is None:
        n_terms = 2
    elif of_file.parameters:
        n_terms = len(of_file.parameters)
    else:
        sign = np.sign(v)
        columns = [surface_columns(scene, joint, part)]
        if surface.below_slowest:
            columns.append((surface.scaling.slower(v) * sign)[:, None])
        # a drag where friction was not identified
        columns.append((surface.scaling.faster(v) * sign)[:, None])
        return np.hstack(columns)
    terms = np.stack([scene.sign[part, joint], v, np.ones_like(v)], axis=1)
    return terms[:, :n_terms]


def surface_columns(scene: Scene, joint: int, part: slice = slice(None)) -> Array:
    """Return columns (N, entries) of a joint's friction surface at some samples."""
    surface = scene.model.surfaces[joint]
    assert surface is not None
    motion = scene.motion
    columns = surface.columns(motion.q[part, joint], motion.dq[part, joint])
    return columns[:, : surface.entries]


def _rigid_prior(basis: Basis, parts: Sequence[RigidStage | None]) -> Array:
    """Return rows (m, b) of unit variance from the stages' covariances."""
    rows = [np.zeros((0, basis.size))]
    index_of = {name: number for number, name in enumerate(basis.names)}
    for stage in parts:
        if stage is None or not stage.parameters or not stage.covariance:
            continue
        index = [index_of.get(parameter.name, -1) for parameter in stage.parameters]
        if min(index) < 0:
            continue  # of another basis
        L = whitened(np.array(stage.covariance))
        of_stage = np.zeros((len(L), basis.size))
        of_stage[:, index] = L
        rows.append(of_stage)
    return np.vstack(rows)


def _friction_prior(stage: FrictionStage | None, name: str, size: int) -> Array:
    """Return rows (m, size) of unit variance from one joint's covariance."""
    if stage is None or name not in stage.joints:
        return np.zeros((0, size))
    joint = stage.joints[name]
    if joint.parameters:
        std_errors = [max(x.uncertainty, 1e-12) for x in joint.parameters]
        return np.diag([1.0 / std_error for std_error in std_errors])

    # A nuisance of its own stands for what friction changes by warmth.
    warmth = shown_warmth(joint)
    if warmth is not None:
        joint = with_term(joint, THERMAL, warmth.value, 0.0)
    # Below the slowest trial both directions err alike: what is the same torque either
    # way is known apart (`identify.nuisances`).
    covariance = np.array(joint.covariance)
    of_surface = _held_where_tied(covariance)
    surface = FrictionSurface.from_stage(joint)
    if surface.below_slowest:
        variances = np.diag(surface.covariance)[surface.below_slowest]
        least = TIED**2 * float(np.max(np.diag(covariance), initial=0.0))
        variance = max(float(np.mean(variances)), least)
        below = np.array([[1.0 / np.sqrt(variance) if variance > 0.0 else 0.0]])
        of_surface = block_diag(of_surface, below)
    beyond = np.zeros((len(of_surface), size - of_surface.shape[1]))
    return np.hstack([of_surface, beyond])


def _held_where_tied(covariance: Array) -> Array:
    """Return rows (k, k) of unit variance where entries may be tied to one another.

    The surfaces of both directions are one but for an offset and asymmetries. A
    direction in which a surface has no variance is none that its law has: left out of
    the prior, it would be free, and friction that differs by direction at every place
    takes up a spring.
    """
    variance, direction = np.linalg.eigh((covariance + covariance.T) / 2.0)
    largest = float(variance.max(initial=0.0))
    if largest <= 0.0:
        return np.zeros((0, len(covariance)))  # the file gives no covariance
    spread = np.sqrt(np.maximum(variance, TIED**2 * largest))
    return np.asarray((direction / spread).T)
