"""What a file has absorbed of an effect that was there when it was identified.

Friction trials move one joint at constant speeds, both ways. What an effect has at
these speeds and places against the motion is taken for friction, and what it has both
ways for gravity, as far as their terms can follow. With X(q, v) the torque of an effect
in the trials, F the columns of a joint's friction surface and G those of gravity, a
unit of its coefficient is in the file as

    P = argmin over trials |(X(q, v) - X(q, -v)) / 2 - F(q, v) P|^2,
    p = argmin over trials |(X(q, v) + X(q, -v)) / 2 - G(q) p|^2,

and the deviations of friction and gravity from the file are held to -P and -p times the
coefficient (see `ColumnGroup.absorbed_by_file`), where those of a file without the
effect are held to zero.

In shapes, N is the number of samples of a joint's trials, first ahead and then back, b
that of the rigid base parameters, and k that of the effect's coefficients.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import product

import numpy as np

from seqid_cli.discover.base import Base, has_trials, surface_columns
from seqid_cli.effects.effect import Columns
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.identify.nuisances import PRIORS, even_columns, friction_rms
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gravity_base_regressor
from seqid_cli.typing import Array

PLACES = 33  # over the positions of a trial
OPEN = 1e-6  # of the largest singular value: what gravity's trials leave open


@dataclass(frozen=True)
class _AsymmetryFit:
    """What a surface of two directions takes of torque that is alike both ways.

    Attributes
    ----------
    columns : (N, m) array
        Its offset and asymmetries.
    per_torque : (m, N) array
        Their coefficients per torque in the trials.
    """

    columns: Array
    per_torque: Array


class FileTrials:
    """The steady motion from which a file's friction and gravity were identified.

    Parameters
    ----------
    scene : Scene
        Any data set: its robot and model count.
    base : Base
        The base columns of the rows.
    stages : Stages
        Those of the file.
    """

    def __init__(self, scene: Scene, base: Base, stages: Stages) -> None:
        self.scene = scene
        self.base = base
        self.stages = stages
        # of a joint, all ahead, then the way back
        self._trials = cache(partial(_steady, scene))
        self._fits: dict[int, Array] = {}
        self._asymmetries: dict[int, _AsymmetryFit] = {}

    def absorbed(
        self, joint: Joint, steady_columns: Callable[[Scene], Columns]
    ) -> dict[int, Array]:
        """Return what the file has absorbed per unit of a term.

        Parameters
        ----------
        joint : int or None
            Where it is; None for the whole arm.
        steady_columns : callable
            Its torque (N, k) by joint per unit coefficient, of a scene of motions at
            constant speeds.

        Returns
        -------
        dict of int to (., k) array
            Coefficients of the rigid body (0), and of the friction of joints (from 1).
        """
        first = joint or 0
        at_first = steady_columns(self._trials(first))
        absorbed: dict[int, Array] = {}
        in_gravity: dict[int, Array] = {}
        for touched in at_first:
            if not has_trials(self.scene, touched):
                continue
            if touched == first:
                columns = at_first[touched]
            else:
                columns = steady_columns(self._trials(touched))[touched]

            # Trials go back the way they came: reversed, they are the other direction.
            odd = 0.5 * (columns - columns[::-1])
            even = 0.5 * (columns + columns[::-1])
            even_in_friction = self._even_part_of_friction(touched, even)
            absorbed[1 + touched] = self._friction(touched) @ (odd + even_in_friction)
            ahead, _ = np.split(even - even_in_friction, 2)
            in_gravity[touched] = ahead

        of_joints = [
            self._gravity[touched] @ ahead
            for touched, ahead in in_gravity.items()
            if touched in self._gravity
        ]
        if of_joints:
            return {0: np.sum(of_joints, axis=0), **absorbed}
        return absorbed

    def beside(
        self, columns: Array, joint: int, absorbed: Mapping[int, Array]
    ) -> Array:
        """Return columns of an effect on a joint's rows less the file's part.

        Parameters
        ----------
        columns : (M_j, k) array
            N m (N where prismatic) per unit coefficient.
        joint : int
            Index of the joint.
        absorbed : dict of int to (., k) array
            Coefficients as the method of that name returns them.

        Returns
        -------
        (M_j, k) array
            In the same unit.
        """
        friction = absorbed.get(1 + joint)
        if friction is not None:
            columns = columns - self.base.friction[joint][:, : len(friction)] @ friction
        gravity = absorbed.get(0)
        if gravity is not None:
            columns = columns - self.base.rigid[joint] @ gravity
        return columns

    def _friction(self, joint: int) -> Array:
        """Return coefficients (entries, N) of a surface per torque in its trials."""
        if joint not in self._fits:
            F = surface_columns(self._trials(joint), joint)
            self._fits[joint] = np.asarray(np.linalg.pinv(F), dtype=np.float64)
        return self._fits[joint]

    def _even_part_of_friction(self, joint: int, even: Array) -> Array:
        """Return what friction takes of torque (N, k) that is alike both ways.

        A surface of two directions has an offset and asymmetries for it beside gravity,
        with priors (`identify.nuisances`): what fits them as well as gravity is shared
        as these say.
        """
        surface = self.scene.model.surfaces[joint]
        assert surface is not None
        if not surface.directional:
            return np.zeros_like(even)
        if joint not in self._asymmetries:
            self._asymmetries[joint] = self._asymmetry_fit(joint, surface)
        fit = self._asymmetries[joint]
        return np.asarray(fit.columns @ (fit.per_torque @ even))

    def _asymmetry_fit(self, joint: int, surface: FrictionSurface) -> _AsymmetryFit:
        """Return how a joint's asymmetries share torque with gravity.

        It is the least squares for both together, with the prior of the asymmetries as
        rows below.
        """
        assert self.stages.friction is not None
        name = self.scene.robot.joint_names[joint]
        std_error = max(self.stages.friction.joints[name].rmse, 1e-12)
        motion = self._trials(joint).motion
        asymmetries = even_columns(surface, motion.q[:, joint], motion.dq[:, joint])
        columns = np.column_stack([asymmetries, self._at_rest(joint)]) / std_error
        prior_std = np.maximum(PRIORS.even_std(friction_rms(surface)), 1e-12)
        prior = np.eye(len(prior_std), columns.shape[1]) / prior_std[:, None]
        inverse = np.linalg.pinv(np.vstack([columns, prior]), rcond=OPEN)
        n_asymmetries = asymmetries.shape[1]
        per_torque = inverse[:n_asymmetries, : len(columns)] / std_error
        return _AsymmetryFit(columns=asymmetries, per_torque=per_torque)

    @cached_property
    def _gravity(self) -> dict[int, Array]:
        """Rigid parameters (b, N) per torque that is alike both ways in trials."""
        gravity = self.stages.gravity
        basis = self.base.basis
        joints = [j for j in range(self.scene.robot.n) if has_trials(self.scene, j)]
        names = [parameter.name for parameter in gravity.parameters] if gravity else []
        of_gravity = [basis.names.index(name) for name in names if name in basis.names]
        if not joints or not of_gravity:
            return {}

        # All places of one joint count by the error of its friction.
        assert self.stages.friction is not None
        weights = []
        weighted_columns = []
        for joint in joints:
            name = self.scene.robot.joint_names[joint]
            std_error = max(self.stages.friction.joints[name].rmse, 1e-12)
            weight = 1.0 / (std_error * np.sqrt(self._trials(joint).samples))
            ahead, _ = np.split(self._at_rest(joint), 2)
            weights.append(weight)
            weighted_columns.append(weight * ahead[:, of_gravity])

        n_places = sum(len(columns) for columns in weighted_columns)
        per_torque = np.zeros((basis.size, n_places))
        per_torque[of_gravity] = np.linalg.pinv(np.vstack(weighted_columns), rcond=OPEN)
        ends = np.cumsum([len(columns) for columns in weighted_columns])
        by_joint = np.split(per_torque, ends[:-1], axis=1)
        return {
            joint: weight * of_joint
            for joint, weight, of_joint in zip(joints, weights, by_joint, strict=True)
        }

    def _at_rest(self, joint: int) -> Array:
        """Return columns (N, g) of gravity at a joint, where its trials lead."""
        q = self._trials(joint).motion.q
        return gravity_base_regressor(self.scene.robot, self.base.basis, q)[:, joint]


def _steady(scene: Scene, joint: int) -> Scene:
    """Return a joint's trials as a data set: all ahead, then back the same way."""
    surface = scene.model.surfaces[joint]
    assert surface is not None
    places = surface.scaling.over_position.at(np.linspace(0.0, 1.0, PLACES))
    trials = list(product(surface.postures, surface.speeds, places))
    q_ahead = np.array([posture for posture, _, _ in trials])
    q_ahead[:, joint] = [place for _, _, place in trials]
    dq_ahead = np.zeros_like(q_ahead)
    dq_ahead[:, joint] = [speed for _, speed, _ in trials]
    q = np.vstack([q_ahead, q_ahead[::-1]])
    dq = np.vstack([dq_ahead, -dq_ahead[::-1]])

    # Steady motion passes a low-pass as it is: no sample is filtered. Its friction is
    # that at the temperature of the file's trials.
    unfiltered = np.zeros(len(q), dtype=bool)
    motion = replace(
        scene.motion,
        t=np.arange(len(q)) / scene.motion.rate_hz,
        q=q,
        dq=dq,
        ddq=np.zeros_like(q),
        tau=None,
        celsius=None,
        moving=dq != 0.0,
        usable=unfiltered,
        valid=unfiltered,
    )
    return Scene(
        robot=scene.robot, motion=motion, model=scene.model, sign_width=scene.sign_width
    )
