"""Fit one effect to torque that was made another way: least squares inside a settings search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from seqid_cli.model.effects.effect import Effect, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.motion import decimated
from tests.plants.robots.two_joint import SIGN_WIDTH
from tests.unit.model.effects.scenes import motion_of, scene_of, wander

Array = NDArray[np.float64]
Law = Callable[[Array, Array, Array], Array]  # t (N,), q (N, n), dq (N, n) -> torque (N, n)

FINE_HZ, STEP = 2400.0, 10


@dataclass(frozen=True)
class Trial:
    """A scene and the torque (N, n) N m that an effect adds to it, low-passed as measured."""

    scene: Scene
    torque: Array


@dataclass(frozen=True)
class Fit:
    """What came out: settings, coefficients, and the share of the torque that is left over."""

    settings: Settings
    c: Array
    left: float


def direction(dq: Array) -> Array:
    """Direction of the true motion; how wide its change is, the base model knows."""
    return np.asarray(np.tanh(dq / SIGN_WIDTH))


@lru_cache(maxsize=8)  # several tests, and both joints, ask for the same
def trial(
    law: Law,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    amplitude: float = 1.0,
    top_hz: float = 0.8,
    log: int = 0,
    start: float = 0.0,
    noise: float = 0.0,
) -> Trial:
    """Apply a law to the true, finely sampled motion; a scene sees it filtered and decimated.

    The scene's direction and rest are those of the filtered motion.
    """
    q = wander(seconds, seed=seed, rate_hz=FINE_HZ, amplitude=amplitude, top_hz=top_hz)
    t = start + np.arange(len(q)) / FINE_HZ
    torque = law(t, q, np.gradient(q, 1.0 / FINE_HZ, axis=0))
    hiss = noise * np.random.default_rng(100 + seed).normal(size=torque.shape)
    motion = decimated(motion_of(q, rate_hz=FINE_HZ, tau=torque + hiss), 24)
    assert motion.rate_hz == FINE_HZ / STEP
    assert motion.tau is not None
    plain = scene_of(motion.q, log=log, start=start, shared_clock=True)
    return Trial(replace(plain, motion=motion), motion.tau)


def fit(effect: Effect, trials: Sequence[Trial], joint: int, *, offset: bool = True) -> Fit:
    """Search the grid, then between its points; direction, velocity and offset are free."""
    scenes = [each.scene for each in trials]
    rows = [scene.motion.usable for scene in scenes]
    y = np.concatenate([each.torque[k, joint] for each, k in zip(trials, rows, strict=True)])
    free = np.concatenate([base(s, joint, offset)[k] for s, k in zip(scenes, rows, strict=True)])
    left = y - free @ np.linalg.lstsq(free, y)[0]

    def solve(settings: Settings) -> tuple[float, Array]:
        parts = [
            scene.motion.filtered(effect.columns(scene, joint, settings)[joint], effect.passes)[k]
            for scene, k in zip(scenes, rows, strict=True)
        ]
        X = np.concatenate(parts)
        c = np.linalg.lstsq(np.hstack([X, free]), y)[0]
        rest = y - np.hstack([X, free]) @ c
        return float(rest @ rest), c[: X.shape[1]]

    residual = [scene.motion.filtered(np.zeros((scene.samples, 2))) for scene in scenes]
    best = min(effect.grid(scenes, joint, residual), key=lambda point: solve(point)[0])
    best = _refined(effect, best, lambda point: solve(point)[0])
    loss, c = solve(best)
    return Fit(best, c, loss / float(left @ left))


def base(scene: Scene, joint: int, offset: bool) -> Array:
    """Direction, velocity and, on request, an offset (N, 2 or 3), low-passed."""
    terms = [scene.sign[:, joint], scene.motion.dq[:, joint]]
    terms += [np.ones(scene.samples)] if offset else []
    return scene.motion.filtered(np.stack(terms, axis=1), 2)


def _refined(
    effect: Effect, point: dict[str, float], loss: Callable[[Settings], float]
) -> dict[str, float]:
    names = effect.between(point)
    if not names:
        return point

    def settings(x: Array) -> dict[str, float]:
        moved = dict(point)
        for setting, shift in zip(names, x - 1.0, strict=True):
            value = point[setting.name]
            value = value * np.exp(shift) if setting.logarithmic else value + shift
            moved[setting.name] = float(np.clip(value, setting.low, setting.high))
        return moved

    def objective(x: Array) -> float:
        return loss(settings(x))

    found = minimize(objective, np.ones(len(names)), method="Nelder-Mead", tol=1e-3)
    return settings(found.x)
