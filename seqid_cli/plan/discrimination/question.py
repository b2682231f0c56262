"""Two effects between which a motion is to decide: settings that count, and what may be true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.discover.select.naming import TEMPER
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
        fit, last = fit or some, len(fit or some) - 1
        found.append([fit[k] for k in np.unique(np.linspace(0, last, most).round().astype(int))])
    return found


@dataclass(frozen=True)
class Slot:
    """Where the columns of an effect at one setting stand, and the bounds of coefficients (k,)."""

    at: slice
    low: Array
    high: Array

    def fits(self, c: Array) -> Array:
        """Whether coefficients (..., k) are within them."""
        return np.asarray(((c >= self.low) & (c <= self.high)).all(axis=-1))


Reading = list[tuple[Slot, Array]]  # settings with coefficients (D, k) that may be true


def without_base(G: Array, moment: Array, base: int) -> Array:
    """What the base leaves of the effects' products with the residual (k,)."""
    return np.asarray(
        moment[base:] - G[base:, :base] @ np.linalg.solve(G[:base, :base], moment[:base])
    )


def seen(slots: Sequence[Slot], E: Array, moment: Array, *, draws: int = 64) -> Reading:
    """Settings as likely as logs make them, with coefficients (D, k) of their errors.

    `E` (k, k) are the products of the effects' columns, base eliminated, `moment` (k,) those with
    the residual. Likelihoods are tempered as those of names are, as the law is not exactly right.
    """
    rng = np.random.default_rng(0)
    fits = [_fit(E[one.at, one.at], moment[one.at]) for one in slots]
    gains = np.array(
        [gain if one.fits(c) else 0.0 for one, (c, _, gain) in zip(slots, fits, strict=True)]
    )
    scale = max(TEMPER * float(gains.max()), 1.0)
    chance = np.exp((gains - gains.max()) / scale)
    counts = rng.multinomial(draws, chance / chance.sum())
    found = []
    for one, (c, root, _), count in zip(slots, fits, counts, strict=True):
        if count:
            drawn = c + np.sqrt(scale) * rng.normal(size=(count, len(c))) @ root.T
            found.append((one, np.clip(drawn, one.low, one.high)))
    return found


def _fit(S: Array, moment: Array) -> tuple[Array, Array, float]:
    """Coefficients (k,), a root (k, k) of their covariance, and the gain."""
    values, vectors = np.linalg.eigh(S + 1e-9 * np.trace(S) * np.eye(len(S)) + 1e-12)
    root = vectors / np.sqrt(np.maximum(values, 1e-300))
    white = root.T @ moment
    return root @ white, root, float(white @ white / 2.0)


def size_of(true: Reading, squares: Array) -> float:
    """Root mean square torque N m, median over what may be true."""
    every = [square_of(squares[one.at, one.at], c) for one, c in true]
    return float(np.sqrt(np.median(np.concatenate(every))))


def drawn_of(slot: Slot, square: Array, size: float, *, draws: int = 24) -> Array:
    """Coefficients (D, k) of this root mean square torque, every one of as much beforehand."""
    k = len(square)
    drawn = np.random.default_rng(0).normal(size=(draws, k)) if k > 1 else np.array([[1.0], [-1.0]])
    c = np.unique(np.where(slot.low >= 0.0, np.abs(drawn), drawn), axis=0)
    c /= np.sqrt(np.maximum(np.diag(square), 1e-300))
    return np.asarray(size * c / np.sqrt(np.maximum(square_of(square, c), 1e-300))[:, None])


def square_of(S: Array, c: Array) -> Array:
    """C' S c (..., D) of coefficients c (D, k)."""
    return np.asarray(np.sum((S @ c.T) * c.T, axis=-2))
