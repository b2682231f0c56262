"""Two effects between which a motion is to decide, and the settings that count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array


@dataclass(frozen=True)
class Question:
    """Two effects at a joint (None: of the whole arm), each with the settings that are tried.

    The first ones of `settings` are true in turn, `true` many; a rival may have any.
    """

    effects: tuple[Effect, Effect]
    joint: int | None
    settings: tuple[Sequence[dict[str, float]], Sequence[dict[str, float]]]
    true: tuple[int, int]

    @classmethod
    def of(
        cls, effects: tuple[Effect, Effect], joint: int | None, scenes: Sequence[Scene]
    ) -> Question:
        """Take settings from the grids over some data sets, and what is reached of them."""
        first, second = (_settings(effect, joint, scenes) for effect in effects)
        settings = [*first[0], *first[1]], [*second[0], *second[1]]
        return cls(effects, joint, settings, (len(first[0]), len(second[0])))


def _settings(
    effect: Effect, joint: int | None, scenes: Sequence[Scene], *, true: int = 6, rival: int = 32
) -> list[list[dict[str, float]]]:
    """Plausible settings, of the grid and what is reached of it; shapes are sought in white noise.

    Where an effect is plausible at none, as only coefficients that agree with the settings would
    be, all are taken.
    """
    rng = np.random.default_rng(0)
    white = [rng.normal(size=scene.motion.q.shape) for scene in scenes]
    grid = list(effect.grid(scenes, joint, white))
    found = []
    for some, most in ((grid, true), ([x for one in grid for x in effect.reached(one)], rival)):
        ones = [np.ones(len(effect.coefficients(x))) for x in some]
        fit = [x for x, c in zip(some, ones, strict=True) if effect.plausible(scenes, joint, x, c)]
        found.append(_evenly(fit or some, most))
    return found


def _evenly(some: Sequence[dict[str, float]], most: int) -> list[dict[str, float]]:
    """At most so many of them, evenly."""
    return [some[k] for k in np.unique(np.linspace(0, len(some) - 1, most).round().astype(int))]


@dataclass(frozen=True)
class Slot:
    """Where the columns of an effect at one setting stand, and the bounds of coefficients (k,)."""

    at: slice
    low: Array
    high: Array

    def fits(self, c: Array) -> Array:
        """Whether coefficients (..., k) are within them."""
        return np.asarray(((c >= self.low) & (c <= self.high)).all(axis=-1))
