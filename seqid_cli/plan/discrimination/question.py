"""Two effects between which a motion is to decide: their columns beside those of the model.

Columns of a data set: the rigid base parameters, friction of the joints that either
effect touches (that of others tells nothing), then those of both effects at every
setting.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.scene import Joint, Scene, Scenes
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.stages.goal import Goal
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.typing import Array


@dataclass(frozen=True)
class Slot:
    """An effect at one setting: where its columns stand behind the base, bounds of coefficients."""

    effect: Effect
    setting: dict[str, float]
    at: slice
    low: Array  # (k,)
    high: Array

    def fits(self, c: Array) -> Array:
        """Whether coefficients (..., k) are within them."""
        return np.asarray(((c >= self.low) & (c <= self.high)).all(axis=-1))


@dataclass(frozen=True)
class Question:
    """Two effects at a joint (None: of the whole arm), each with the settings that are tried.

    The first of each effect's `slots` are true in turn, `true` many; a rival may have
    any. `base` columns stand before them, those of `friction` by joint, the rigid ones
    first. `prior` (K, K) is what is known of them beforehand, part by part.
    """

    joint: int | None
    slots: tuple[list[Slot], list[Slot]]
    true: tuple[int, int]
    friction: list[slice]
    base: int
    prior: Array

    @classmethod
    def of(
        cls,
        belief: Belief,
        effects: tuple[Effect, Effect],
        joint: Joint,
        scenes: Scenes,
    ) -> Self:
        """Take settings from the grids over some data sets, and what is reached of them."""
        slots: tuple[list[Slot], list[Slot]] = ([], [])
        many, start = [], 0
        for effect, own in zip(effects, slots, strict=True):
            true, reached = _settings(effect, joint, scenes)
            many.append(len(true))
            for setting in (*true, *reached):
                specs = effect.coefficients(setting)
                bounds = (
                    np.array([x.low for x in specs]),
                    np.array([x.high for x in specs]),
                )
                own.append(
                    Slot(effect, setting, slice(start, start + len(specs)), *bounds)
                )
                start += len(specs)
        first, every = scenes[0], (*slots[0], *slots[1])
        touched = {j for x in every for j in x.effect.columns(first, joint, x.setting)}
        known = [
            _friction(belief, first, j)[1] if j in touched else np.zeros((0, 0))
            for j in range(belief.robot.n)
        ]
        ends = belief.basis.size + np.cumsum([0, *map(len, known)])
        rigid = _known(belief.root @ belief.root.T, Goal.of(belief, 0).scale ** 2)
        parts = [rigid, *(x for x in known if len(x)), np.zeros((start, start))]
        friction = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        return cls(
            joint,
            slots,
            (many[0], many[1]),
            friction,
            int(ends[-1]),
            block_diag(*parts),
        )


def _settings(
    effect: Effect, joint: Joint, scenes: Scenes, *, true: int = 6, rival: int = 32
) -> list[list[dict[str, float]]]:
    """Plausible settings, of the grid and what is reached of it; shapes are sought in white noise.

    Where an effect is plausible at none, as only coefficients that agree with the
    settings would be, all are taken.
    """
    rng = np.random.default_rng(0)
    white = [rng.normal(size=scene.motion.q.shape) for scene in scenes]
    grid = list(effect.grid(scenes, joint, white))
    found = []
    for some, most in (
        (grid, true),
        ([x for one in grid for x in effect.reached(one)], rival),
    ):
        ones = [np.ones(len(effect.coefficients(x))) for x in some]
        fit = [
            x
            for x, c in zip(some, ones, strict=True)
            if effect.plausible(scenes, joint, x, c)
        ]
        fit, last = fit or some, len(fit or some) - 1
        found.append(
            [fit[k] for k in np.unique(np.linspace(0, last, most).round().astype(int))]
        )
    return found


def gram_of(
    belief: Belief, question: Question, scene: Scene
) -> tuple[Array, Array, Array]:
    """Sum up squares of columns (K, K) and products with the residual (K,), weighted by the noise.

    Joints count where they slide. Unweighted squares (k, k) of the effects' columns at
    the joint in question come last.
    """
    K, b, motion, tau = (
        len(question.prior),
        question.base,
        scene.motion,
        scene.motion.tau,
    )
    gram, moment, squares = np.zeros((K, K)), np.zeros(K), np.zeros((K, K))
    left = np.zeros(scene.sign.shape) if tau is None else tau - scene.modelled_filtered
    H = base_regressor(belief.robot, belief.basis, motion.q, motion.dq, motion.ddq)
    slots = [*question.slots[0], *question.slots[1]]
    made = [x.effect.columns(scene, question.joint, x.setting) for x in slots]
    for j, part in enumerate(question.friction):
        # The joint's columns (N, k), and where they stand.
        places, columns = [np.arange(belief.basis.size)], [H[:, j]]
        if part.stop > part.start:
            places.append(np.arange(part.start, part.stop))
            columns.append(_friction(belief, scene, j)[0])
        for slot, own in zip(slots, made, strict=True):
            if j in own:
                places.append(b + np.arange(slot.at.start, slot.at.stop))
                columns.append(motion.filtered(own[j]))
        index, X = np.concatenate(places), np.hstack(columns)
        if question.joint in (None, j):
            squares[np.ix_(index, index)] += X.T @ X
        weight = np.sqrt(belief.density[j] * scene.slides[:, j] / motion.rate_hz)
        X *= weight[:, None]
        gram[np.ix_(index, index)] += X.T @ X
        moment[index] += X.T @ (weight * left[:, j])
    return gram, moment, squares[b:, b:]


def _friction(belief: Belief, scene: Scene, j: int) -> tuple[Array, Array]:
    """Columns (N, k) of a joint's friction, and what is known of their coefficients (k, k)."""
    motion, surface = scene.motion, belief.surfaces[j]
    if surface is None:
        return np.stack([scene.sign[:, j], motion.dq[:, j]], axis=1), np.zeros((2, 2))
    columns = surface.columns(motion.q[:, j], motion.dq[:, j])
    return columns, _known(surface.covariance, np.mean(columns**2, axis=0))


def _known(covariance: Array, square: Array) -> Array:
    """Inverse of a covariance; a column of mean square 1 has a doubt of 1e-3 at least."""
    floor = 1e-6 / np.maximum(square, 1e-12 * square.max(initial=1e-300))
    return np.asarray(np.linalg.inv(covariance + np.diag(floor)))
