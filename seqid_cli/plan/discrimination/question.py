"""Two effects between which a motion is to decide: their columns and the model's.

Columns of a data set: the rigid base parameters, friction of the joints that either
effect touches (that of others tells nothing), then those of both effects at every
setting. The first b of the K columns are called the base.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from seqid_cli.effects.effect import Effect
from seqid_cli.effects.scene import Joint, Scene, Scenes
from seqid_cli.matrices import block_diagonal
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.stages.goal import Goal
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class Slot:
    """An effect at one setting, and the bounds of its k coefficients.

    Parameters
    ----------
    effect : Effect
    setting : dict of str to float
    at : slice
        Where its columns stand behind the base.
    low, high : (k,) float
        Bounds of the coefficients.
    """

    effect: Effect
    setting: dict[str, float]
    at: slice
    low: Array
    high: Array

    def is_within_bounds(self, c: Array) -> Array:
        """Return whether coefficients c (..., k) are within their bounds (...)."""
        return np.asarray(((c >= self.low) & (c <= self.high)).all(axis=-1))


@dataclass(frozen=True, kw_only=True)
class Question:
    """Two effects at a joint, each with the settings that are tried.

    Parameters
    ----------
    joint : int, optional
        None for effects of the whole arm.
    slots : tuple of two lists of Slot
        Settings of each effect. Those that it may truly have come first; as a rival it
        may have any.
    n_true : tuple of two int
        Number of settings that each effect may truly have.
    friction : list of slice
        Columns of each joint's friction; empty for joints that no effect touches.
    n_base : int
        Number b of the columns of the base, the rigid ones first.
    prior : (K, K) float
        Information on all columns before any motion, part by part.
    """

    joint: int | None
    slots: tuple[list[Slot], list[Slot]]
    n_true: tuple[int, int]
    friction: list[slice]
    n_base: int
    prior: Array

    @classmethod
    def of(
        cls,
        belief: Belief,
        effects: tuple[Effect, Effect],
        joint: Joint,
        scenes: Scenes,
    ) -> Self:
        """Take settings from the grids of two effects over some data sets.

        Parameters
        ----------
        belief : Belief
        effects : tuple of two Effect
        joint : int, optional
        `scenes` : sequence of `Scene`
            Data sets of moves, over which the grids are laid.

        Returns
        -------
        Question
        """
        slots: tuple[list[Slot], list[Slot]] = ([], [])
        n_true = []
        start = 0
        for effect, effect_slots in zip(effects, slots, strict=True):
            true_settings, rival_settings = _settings(effect, joint, scenes)
            n_true.append(len(true_settings))
            for setting in (*true_settings, *rival_settings):
                coefficients = effect.coefficients(setting)
                stop = start + len(coefficients)
                slot = Slot(
                    effect=effect,
                    setting=setting,
                    at=slice(start, stop),
                    low=np.array([x.low for x in coefficients]),
                    high=np.array([x.high for x in coefficients]),
                )
                effect_slots.append(slot)
                start = stop
        n_effect_columns = start

        # Which joints an effect touches does not depend on the motion.
        first = scenes[0]
        touched: set[int] = set()
        for slot in (*slots[0], *slots[1]):
            touched.update(slot.effect.columns(first, joint, slot.setting))
        on_friction = []
        for j in range(belief.robot.n):
            information = np.zeros((0, 0))
            if j in touched:
                _, information = _friction(belief, first, j)
            on_friction.append(information)

        sizes = [len(information) for information in on_friction]
        ends = belief.basis.size + np.cumsum([0, *sizes])
        scale = Goal.of(belief, 0).scale
        on_rigid = _information(
            belief.covariance_root @ belief.covariance_root.T, scale**2
        )
        on_effects = np.zeros((n_effect_columns, n_effect_columns))
        return cls(
            joint=joint,
            slots=slots,
            n_true=(n_true[0], n_true[1]),
            friction=[slice(int(low), int(high)) for low, high in pairwise(ends)],
            n_base=int(ends[-1]),
            prior=block_diagonal(
                on_rigid, *(x for x in on_friction if len(x)), on_effects
            ),
        )


def _settings(
    effect: Effect,
    joint: Joint,
    scenes: Scenes,
    *,
    most_true: int = 6,
    most_rival: int = 32,
) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Return plausible settings: those of the grid, and what a search reaches from it.

    The first are settings that a true effect may have, the second those of a rival.
    Shapes are sought in white noise, which has no shape of its own.
    """
    rng = np.random.default_rng(0)
    white_noise = [rng.normal(size=scene.motion.q.shape) for scene in scenes]
    grid = list(effect.grid(scenes, joint, white_noise))
    reached: list[dict[str, float]] = []
    for setting in grid:
        reached += effect.reached(setting)
    return (
        _plausible_settings(effect, joint, scenes, grid, most_true),
        _plausible_settings(effect, joint, scenes, reached, most_rival),
    )


def _plausible_settings(
    effect: Effect,
    joint: Joint,
    scenes: Scenes,
    settings: list[dict[str, float]],
    most: int,
) -> list[dict[str, float]]:
    """Return at most so many settings at which an effect is plausible, evenly."""
    plausible = []
    for setting in settings:
        coefficients = np.ones(len(effect.coefficients(setting)))
        if effect.plausible(scenes, joint, setting, coefficients):
            plausible.append(setting)
    # Where an effect is plausible at none, as only coefficients that agree with the
    # settings would be, all are taken.
    candidates = plausible or settings
    places = np.linspace(0, len(candidates) - 1, most).round().astype(int)
    return [candidates[k] for k in np.unique(places)]


@dataclass(frozen=True)
class Products:
    """Products of the columns of one data set.

    Parameters
    ----------
    gram : (K, K) float
        Of all columns with each other, weighted by the noise.
    moment : (K,) float
        With the residual, weighted by the noise.
    squares : (k, k) float
        Of the effects' columns at the joint in question, unweighted.
    """

    gram: Array
    moment: Array
    squares: Array


def products_of(belief: Belief, question: Question, scene: Scene) -> Products:
    """Sum up the products of the columns of a data set.

    Parameters
    ----------
    belief : Belief
    question : Question
    `scene` : `Scene`
        A planned move or a log. Joints count where they slide.

    Returns
    -------
    Products
    """
    K = len(question.prior)
    b = question.n_base
    gram = np.zeros((K, K))
    moment = np.zeros(K)
    squares = np.zeros((K, K))

    motion = scene.motion
    residual = np.zeros(scene.sign.shape)
    if motion.tau is not None:
        residual = motion.tau - scene.modelled_filtered
    H = base_regressor(belief.robot, belief.basis, motion.q, motion.dq, motion.ddq)
    slots = [*question.slots[0], *question.slots[1]]
    effect_columns = [
        slot.effect.columns(scene, question.joint, slot.setting) for slot in slots
    ]

    for j, friction in enumerate(question.friction):
        # The joint's columns (N, k), and where they stand among all.
        places = [np.arange(belief.basis.size)]
        columns = [H[:, j]]
        if friction.stop > friction.start:
            places.append(np.arange(friction.start, friction.stop))
            columns.append(_friction(belief, scene, j)[0])
        for slot, by_joint in zip(slots, effect_columns, strict=True):
            if j in by_joint:
                places.append(b + np.arange(slot.at.start, slot.at.stop))
                columns.append(motion.filtered(by_joint[j]))
        index = np.concatenate(places)
        X = np.hstack(columns)

        if question.joint in (None, j):
            squares[np.ix_(index, index)] += X.T @ X
        weight = np.sqrt(
            belief.information_rate[j] * scene.slides[:, j] / motion.rate_hz
        )
        weighted_X = weight[:, None] * X
        gram[np.ix_(index, index)] += weighted_X.T @ weighted_X
        moment[index] += weighted_X.T @ (weight * residual[:, j])
    return Products(gram, moment, squares[b:, b:])


def _friction(belief: Belief, scene: Scene, j: int) -> tuple[Array, Array]:
    """Return a joint's friction columns (N, k) and the information (k, k) on them."""
    motion = scene.motion
    surface = belief.surfaces[j]
    if surface is None:
        # Coulomb and viscous friction, of which nothing is known.
        columns = np.stack([scene.sign[:, j], motion.dq[:, j]], axis=1)
        return columns, np.zeros((2, 2))
    columns = surface.columns(motion.q[:, j], motion.dq[:, j])
    mean_squares = np.mean(columns**2, axis=0)
    return columns, _information(surface.covariance, mean_squares)


def _information(covariance: Array, mean_squares: Array) -> Array:
    """Return the inverse of a covariance, whose errors are not taken for zero.

    A coefficient whose column has a mean square of 1 has a standard error of 1e-3 at
    least.
    """
    squares = np.maximum(mean_squares, 1e-12 * mean_squares.max(initial=1e-300))
    return np.asarray(np.linalg.inv(covariance + np.diag(1e-6 / squares)))
