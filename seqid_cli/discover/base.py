"""The base model as columns: what is free to take up the residual before any effect is blamed.

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

from seqid_cli.discover.nuisances import Nuisance, nuisances_of
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.identify.regression.least_squares import whitened
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.params.schema import FrictionStage, RigidStage, Stages
from seqid_cli.robot.base_parameters import (
    Basis,
    base_regressor,
    free_basis,
    loaded_columns,
)
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array

LIKELY = 2.0  # of a column's torque beforehand, over what the file leaves
# of a surface's largest standard error, by which entries that are tied may part
TIED = 1e-3
# of a joint's largest bound, at least: friction that no row shows is not free
UNSHOWN = 1e-3


@dataclass(frozen=True)
class Base:
    """Base columns of every joint's rows."""

    basis: Basis
    rigid: tuple[Array, ...]  # (M_j, b), of parameters that all joints share
    friction: tuple[Array, ...]  # (M_j, k_j)
    nuisances: tuple[NuisanceRows, ...]
    y: tuple[Array, ...]  # (M_j,) N m, residual of the file's model
    # rows of unit variance by which the file knows deviations to be zero:
    prior: tuple[Array, ...]
    # rigid body (m, b), then friction by joint (m_j, k_j)
    scene_bases: tuple[SceneBase, ...]
    start: Array  # (n,) N m, RMS of `y`

    @cached_property
    def bounds(self) -> list[Array]:
        """Inverse standard deviations: rigid (b,), then friction (k_j,) by joint.

        No column's torque is likely to be more than some times what the file leaves.
        That keeps directions harmless which the logs, or some of the folds, leave open.
        """
        rigid = self._likely(dict(enumerate(self.rigid)))
        friction = []
        for joint, columns in enumerate(self.friction):
            likely = self._likely({joint: columns})
            friction.append(np.maximum(likely, UNSHOWN * np.max(likely, initial=0.0)))
        return [rigid, *friction]

    def nuisance_precision(self, nuisance: NuisanceRows) -> Array:
        """Precision (1, 1) beforehand of a nuisance term's deviation."""
        likely = self._likely(nuisance.columns)
        return np.diag(likely**2 + nuisance.term.std**-2)

    def _likely(self, columns: Mapping[int, Array]) -> Array:
        """Inverse standard deviation (k,) of coefficients whose columns are (M_j, k) by joint."""
        squares = np.zeros(next(iter(columns.values())).shape[1])
        for joint, own in columns.items():
            if self.start[joint] > 0.0:
                squares += np.sum(own**2, axis=0) / (LIKELY * self.start[joint]) ** 2
        samples = sum(len(own) for own in columns.values())
        return np.asarray(np.sqrt(squares / max(samples, 1)))

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
        found = []
        for number, whole in enumerate(self.scene_bases):
            moved, torque = (
                whole.H @ rigid.astype(np.float32),
                np.empty_like(whole.residual),
            )
            for j, own in enumerate(friction):
                for part in tiles(len(torque)):
                    torque[part, j] = (
                        friction_columns(whole.scene, whole.stage, j, part) @ own
                    )
            low = whole.scene.motion.filtered(torque, times=2)
            own_terms = zip(
                nuisances, (rows.term for rows in self.nuisances), strict=False
            )
            low += nuisance_torque(own_terms, number, low.shape)
            found.append(moved.astype(np.float64) + low)
        return found


@dataclass(frozen=True, kw_only=True)
class NuisanceRows:
    """A nuisance term and its columns (M_j, 1) on the rows of the joints that it touches."""

    term: Nuisance
    columns: Mapping[int, Array]

    @classmethod
    def of(cls, term: Nuisance, rows: Rows) -> NuisanceRows:
        """Take a term's columns on rows."""
        columns = {
            joint: rows.torque(joint, [column[:, None] for column in per_scene])
            for joint, per_scene in term.columns.items()
        }
        return cls(term=term, columns=columns)


def nuisance_torque(
    sizes: Iterable[tuple[float, Nuisance]], number: int, shape: tuple[int, ...]
) -> Array:
    """Compute the torque (N, n) of nuisance terms in data set `number`, each with its size."""
    torque = np.zeros(shape)
    for size, term in sizes:
        for joint, per_scene in term.columns.items():
            torque[:, joint] += size * per_scene[number]
    return torque


@dataclass(frozen=True)
class SceneBase:
    """Base of one data set at all of its samples; columns of friction are made as they are used."""

    H: NDArray[np.float32]  # (N, n, b)
    scene: Scene
    stage: FrictionStage | None
    residual: Array  # (N, n) N m, of the file's model


def base_of(rows: Rows, stages: Stages) -> Base:
    """Compute the base columns of all rows; `stages` are the parameter file's."""
    robot, motions = rows.scenes[0].robot, [scene.motion for scene in rows.scenes]
    basis = free_basis(robot)
    H, loaded = [], loaded_columns(robot, basis)
    for motion in motions:  # a joint's columns of links before it stay zero
        own_H = base_regressor(robot, basis, motion.q, motion.dq, motion.ddq)
        H.append(np.zeros_like(own_H))
        H[-1][:, loaded] = motion.filtered(own_H[:, loaded])
    nuisances = nuisances_of(rows.scenes, stages)
    left = []
    for number, scene in enumerate(rows.scenes):
        residual = residual_of(scene)
        known = ((term.mean, term) for term in nuisances)
        left.append(residual - nuisance_torque(known, number, residual.shape))
    law = stages.friction
    own = [
        rows.columns(
            ({j: friction_columns(scene, law, j)} for scene in rows.scenes), 2
        )[j]
        for j in range(robot.n)
    ]
    y = tuple(rows.torque(j, [r[:, j] for r in left]) for j in range(robot.n))
    return Base(
        basis=basis,
        rigid=tuple(rows.torque(j, [h[:, j] for h in H]) for j in range(robot.n)),
        friction=tuple(own),
        nuisances=tuple(NuisanceRows.of(term, rows) for term in nuisances),
        y=y,
        prior=(
            _rigid_prior(basis, [stages.gravity, stages.inertia]),
            *(
                _friction_prior(law, x.name, X.shape[1])
                for x, X in zip(robot.joints, own, strict=True)
            ),
        ),
        scene_bases=tuple(
            SceneBase(h.astype(np.float32), scene, law, r)
            for h, scene, r in zip(H, rows.scenes, left, strict=True)
        ),
        start=np.array([np.sqrt(np.mean(own**2)) if len(own) else 0.0 for own in y]),
    )


def residual_of(scene: Scene) -> Array:
    """Torque (N, n) N m that the file's model leaves at all samples, its delays included."""
    assert scene.motion.tau is not None
    logged = scene.model.late(scene.modelled_filtered, scene.motion)
    return np.asarray(scene.motion.tau - logged)


def has_trials(scene: Scene, joint: Joint) -> bool:
    """Whether the file tells at which speeds and in which postures friction was identified."""
    surfaces = scene.model.surfaces if joint is None else [scene.model.surfaces[joint]]
    return all(s is not None and len(s.speeds) > 0 and s.postures for s in surfaces)


def friction_columns(
    scene: Scene, stage: FrictionStage | None, joint: int, part: slice = slice(None)
) -> Array:
    """Free friction of one joint, not low-passed: its surface, or Coulomb, viscous (and offset)."""
    surface, v = scene.model.surfaces[joint], scene.motion.dq[part, joint]
    known = (
        stage.joints.get(scene.robot.joint_names[joint]) if stage is not None else None
    )
    if surface is None or known is None or known.parameters:  # these may have an offset
        terms = 2 if surface is None or known is None else len(known.parameters)
        return np.stack([scene.sign[part, joint], v, np.ones_like(v)], axis=1)[
            :, :terms
        ]
    # a drag where friction was not identified
    beyond = surface.scaling.faster(v) * np.sign(v)
    return np.column_stack([surface_columns(scene, joint, part), beyond])


def surface_columns(scene: Scene, joint: int, part: slice = slice(None)) -> Array:
    """Columns (N, entries) of a joint's friction surface, of some samples of a data set."""
    surface, motion = scene.model.surfaces[joint], scene.motion
    assert surface is not None
    return surface.columns(motion.q[part, joint], motion.dq[part, joint])[
        :, : surface.entries
    ]


def _rigid_prior(basis: Basis, parts: Sequence[RigidStage | None]) -> Array:
    """Rows (m, b) of unit variance from the stages' covariances."""
    rows = [np.zeros((0, basis.size))]
    index = {name: k for k, name in enumerate(basis.names)}
    for stage in parts:
        if stage is not None and stage.parameters and stage.covariance:
            known = [index.get(p.name, -1) for p in stage.parameters]
            if min(known) >= 0:
                L = whitened(np.array(stage.covariance))
                rows.append(np.zeros((len(L), basis.size)))
                rows[-1][:, known] = L
    return np.vstack(rows)


def _friction_prior(stage: FrictionStage | None, name: str, size: int) -> Array:
    """Rows (m, size) of unit variance from the covariance of one joint's friction."""
    if stage is None or name not in stage.joints:
        return np.zeros((0, size))
    joint = stage.joints[name]
    if joint.parameters:
        return np.diag([1.0 / max(p.std_error, 1e-12) for p in joint.parameters])

    rows = _held_where_tied(np.array(joint.covariance))
    return np.hstack([rows, np.zeros((len(rows), size - rows.shape[1]))])


def _held_where_tied(covariance: Array) -> Array:
    """Rows (k, k) of unit variance from a covariance whose entries may be tied to one another.

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
