"""Columns of a data set: rigid body, friction of the joints that count, both effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from seqid_cli.model.effects.effect import Columns
from seqid_cli.model.effects.scene import Scene
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.discrimination.question import Question, Slot
from seqid_cli.plan.stages.goal import Goal
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.typing import Array, Index


@dataclass(frozen=True)
class Gram:
    """Sums over a data set: of weighted columns (K, K), with the residual (K,), unweighted ones.

    `squares` (k, k) is of the effects' columns at the joint in question.
    """

    gram: Array
    moment: Array
    squares: Array


def gram_of(belief: Belief, question: Question, scene: Scene, layout: Layout) -> Gram:
    """Sum up the samples at which joints slide, weighted by the noise."""
    K, b = len(layout.prior), layout.base
    gram, moment, squares = np.zeros((K, K)), np.zeros(K), np.zeros((K, K))
    tau = scene.motion.tau
    left = np.zeros(scene.sign.shape) if tau is None else tau - scene.modelled_filtered
    for j, (index, X) in enumerate(_rows(belief, question, scene, layout)):
        if question.joint in (None, j):
            squares[np.ix_(index, index)] += X.T @ X
        weight = np.sqrt(belief.density[j] * scene.slides[:, j] / scene.motion.rate_hz)
        X *= weight[:, None]
        gram[np.ix_(index, index)] += X.T @ X
        moment[index] += X.T @ (weight * left[:, j])
    return Gram(gram, moment, squares[b:, b:])


@dataclass(frozen=True)
class Layout:
    """Where columns stand: rigid ones, friction of the joints that count, settings of effects.

    `prior` (K, K) is what is known beforehand: of the base columns, part by part.
    """

    friction: list[slice]
    base: int
    slots: list[Slot]  # from the base on
    prior: Array

    @classmethod
    def of(cls, belief: Belief, question: Question, scene: Scene) -> Layout:
        """Friction of joints that no effect touches tells nothing."""
        touched = {j for made in _columns(question, scene) for j in made}
        friction = [
            _friction(belief, scene, j)[1] if j in touched else np.zeros((0, 0))
            for j in range(belief.robot.n)
        ]
        b = belief.basis.size
        at = _between(b, [len(own) for own in friction])
        specs = [
            effect.coefficients(one)
            for effect, settings in zip(question.effects, question.settings, strict=True)
            for one in settings
        ]
        slots = [
            Slot(part, np.array([x.low for x in own]), np.array([x.high for x in own]))
            for part, own in zip(_between(0, [len(own) for own in specs]), specs, strict=True)
        ]
        rigid = _known(belief.root @ belief.root.T, Goal.of(belief, 0).scale ** 2)
        parts = [rigid, *friction, np.zeros((slots[-1].at.stop,) * 2)]
        return cls(at, at[-1].stop, slots, block_diag(*(x for x in parts if len(x))))


def _between(first: int, widths: Sequence[int]) -> list[slice]:
    return [slice(int(a), int(b)) for a, b in pairwise(first + np.cumsum([0, *widths]))]


def _rows(
    belief: Belief, question: Question, scene: Scene, layout: Layout
) -> Iterator[tuple[Index, Array]]:
    """Columns (N, k) of each joint, and where they stand (k,)."""
    motion, b = scene.motion, belief.basis.size
    H = base_regressor(belief.robot, belief.basis, motion.q, motion.dq, motion.ddq)
    made = _columns(question, scene)
    for j, part in enumerate(layout.friction):
        parts, columns = [slice(0, b)], [H[:, j]]
        if part.stop > part.start:
            parts, columns = [*parts, part], [*columns, _friction(belief, scene, j)[0]]
        for slot, own in zip(layout.slots, made, strict=True):
            if j in own:
                parts.append(slice(layout.base + slot.at.start, layout.base + slot.at.stop))
                columns.append(scene.motion.filtered(own[j]))
        yield np.concatenate([np.arange(p.start, p.stop) for p in parts]), np.hstack(columns)


def _columns(question: Question, scene: Scene) -> list[Columns]:
    """Columns of all settings of the first effect, then of the second, by joint."""
    return [
        effect.columns(scene, question.joint, one)
        for effect, settings in zip(question.effects, question.settings, strict=True)
        for one in settings
    ]


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
