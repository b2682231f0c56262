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
effect are held to
zero.
"""

from dataclasses import replace
from functools import cache, cached_property, partial
from itertools import product

import numpy as np

from seqid_cli.discover.base import Base, has_trials, surface_columns
from seqid_cli.identify.nuisances import PRIORS, even_columns, friction_rms
from seqid_cli.model.effects.effect import Effect, Settings
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gravity_base_regressor
from seqid_cli.typing import Array

PLACES = 33  # over the positions of a trial
OPEN = 1e-6  # of the largest singular value: what gravity's trials leave open


class FileTrials:
    """The steady motion from which a file's friction and gravity were identified."""

    def __init__(self, scene: Scene, base: Base, stages: Stages) -> None:
        self.scene, self.base, self.stages = scene, base, stages
        # of a joint, all ahead, then the way back
        self._trials = cache(partial(_steady, scene))
        self._fits: dict[int, Array] = {}

    def absorbed(
        self, effect: Effect, joint: Joint, settings: Settings
    ) -> dict[int, Array]:
        """Coefficients (., k) of rigid body (0) and friction (from 1) per unit of an effect."""
        first, found, both = joint or 0, dict[int, Array](), dict[int, Array]()
        touched = effect.steady_columns(self._trials(first), joint, settings)
        for j in (j for j in touched if has_trials(self.scene, j)):
            own = (
                touched
                if j == first
                else effect.steady_columns(self._trials(j), joint, settings)
            )
            odd, even = 0.5 * (own[j] - own[j][::-1]), 0.5 * (own[j] + own[j][::-1])
            apart = self._by_direction(j, even)
            found[1 + j] = self._friction(j) @ (odd + apart)
            both[j] = np.split(even - apart, 2)[0]
        seen = [
            self._gravity[j] @ half for j, half in both.items() if j in self._gravity
        ]
        return {0: np.sum(seen, axis=0), **found} if seen else found

    def beside(self, columns: Array, joint: int, absorbed: dict[int, Array]) -> Array:
        """Columns (M_j, k) of an effect on a joint's rows less what the file has of them."""
        friction, gravity = absorbed.get(1 + joint), absorbed.get(0)
        if friction is not None:
            columns = columns - self.base.friction[joint][:, : len(friction)] @ friction
        return (
            columns if gravity is None else columns - self.base.rigid[joint] @ gravity
        )

    def _friction(self, joint: int) -> Array:
        """Coefficients of a joint's surface (entries, N) per torque in its trials."""
        if joint not in self._fits:
            F = surface_columns(self._trials(joint), joint)
            self._fits[joint] = np.asarray(np.linalg.pinv(F), dtype=np.float64)
        return self._fits[joint]

    def _by_direction(self, joint: int, even: Array) -> Array:
        """Return what a surface of two directions takes of torque (N, k) that is alike both ways.

        Beside gravity the stages have an offset and asymmetries of friction for it,
        with priors (`identify.nuisances`): what fits them as well as gravity is shared
        as these say.
        """
        surface, trials = self.scene.model.surfaces[joint], self._trials(joint)
        assert surface is not None
        assert self.stages.friction is not None
        if not surface.directional:
            return np.zeros_like(even)
        name = self.scene.robot.joint_names[joint]
        std_error = max(self.stages.friction.joints[name].rmse, 1e-12)
        q, v = trials.motion.q[:, joint], trials.motion.dq[:, joint]
        terms = even_columns(surface, q, v)
        A = np.column_stack([terms, self._at_rest(joint)]) / std_error
        prior_std = np.maximum(PRIORS.even_std(friction_rms(surface)), 1e-12)
        prior = np.eye(len(prior_std), A.shape[1]) / prior_std[:, None]
        rows = np.vstack([A, prior])
        right = np.vstack([even / std_error, np.zeros((len(prior), even.shape[1]))])
        shares = np.linalg.lstsq(rows, right, rcond=OPEN)[0]
        return np.asarray(terms @ shares[: terms.shape[1]])

    @cached_property
    def _gravity(self) -> dict[int, Array]:
        """Rigid parameters (b, N) per torque in each joint's trials, the same for both ways."""
        gravity, basis = self.stages.gravity, self.base.basis
        joints = [j for j in range(self.scene.robot.n) if has_trials(self.scene, j)]
        names = [p.name for p in gravity.parameters] if gravity else []
        own = [basis.names.index(name) for name in names if name in basis.names]
        if not joints or not own:
            return {}
        assert self.stages.friction is not None
        # all places of one joint count by the error of its friction
        weight, every = [], []
        for j in joints:
            error = self.stages.friction.joints[self.scene.robot.joint_names[j]].rmse
            weight.append(1.0 / (max(error, 1e-12) * np.sqrt(self._trials(j).samples)))
            every.append(weight[-1] * np.split(self._at_rest(j), 2)[0][:, own])
        told = np.zeros((basis.size, sum(map(len, every))))
        told[own] = np.linalg.pinv(np.vstack(every), rcond=OPEN)
        parts = np.split(told, np.cumsum([len(G) for G in every])[:-1], axis=1)
        return {j: w * part for j, w, part in zip(joints, weight, parts, strict=True)}

    def _at_rest(self, joint: int) -> Array:
        """Columns (N, g) of gravity at a joint, where its trials lead."""
        q = self._trials(joint).motion.q
        return gravity_base_regressor(self.scene.robot, self.base.basis, q)[:, joint]


def _steady(scene: Scene, joint: int) -> Scene:
    surface = scene.model.surfaces[joint]
    assert surface is not None
    places = surface.scaling.over_position.at(np.linspace(0.0, 1.0, PLACES))
    every = list(product(surface.postures, surface.speeds, places))
    q = np.array([posture for posture, _, _ in every])
    q[:, joint] = [place for _, _, place in every]
    dq = np.zeros_like(q)
    dq[:, joint] = [speed for _, speed, _ in every]
    q, dq = np.vstack([q, q[::-1]]), np.vstack([dq, -dq[::-1]])
    # steady motion passes a low-pass as it is
    unfiltered = np.zeros(len(q), dtype=bool)
    motion = replace(
        scene.motion,
        t=np.arange(len(q)) / scene.motion.rate_hz,
        q=q,
        dq=dq,
        ddq=np.zeros_like(q),
        tau=None,
        moving=dq != 0.0,
        usable=unfiltered,
        valid=unfiltered,
    )
    return Scene(
        robot=scene.robot, motion=motion, model=scene.model, sign_width=scene.sign_width
    )
