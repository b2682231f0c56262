"""Torque as instruments falsify it, made at ten times the scene's rate and apart from the effects.

The arm's true torque comes from the unfiltered motion; `scene_measuring` returns the scene that
logged it through a distortion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from tests.plants.robots.two_joint import torque_model, two_joint_robot
from tests.unit.model.effects.scenes import RATE_HZ, motion_of, scene_of, wander

Array = NDArray[np.float64]
Distortion = Callable[[Array, Array], Array]  # t (M,), torque (M, n) at the fine rate -> torque

FINE = 10
SHARPENED = 4  # times at most that settings are moved
EDGE_S = 1.0  # cut off, where derivatives and motion set in


def scene_measuring(
    distortion: Distortion,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    noise: float = 0.0,
    log: int = 0,
    start: float = 0.0,
    shared_clock: bool = False,
) -> Scene:
    """Return a scene whose torque went through a distortion, plus white noise (N m)."""
    rate = FINE * RATE_HZ
    q = wander(seconds + 2 * EDGE_S, seed=seed, rate_hz=rate, rests=())
    model = torque_model(two_joint_robot())
    dq, ddq = differentiate(q, rate)
    inside = slice(round(EDGE_S * rate), -round(EDGE_S * rate))
    true = (model.rigid(q, dq, ddq) + model.friction(q, dq))[inside]
    q = q[inside]
    t = start + np.arange(len(q)) / rate
    rng = np.random.default_rng(100 + seed)
    # Read as a drive reads: the mean over a sample, centred on it.
    sampled = _centred_means(distortion(t, true))
    logged = sampled + noise * rng.normal(size=sampled.shape)
    scene = scene_of(q[::FINE], log=log, start=start, shared_clock=shared_clock)
    return replace(scene, motion=motion_of(q[::FINE], tau=logged))


def _centred_means(values: Array) -> Array:
    half = FINE // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), padded]), axis=0)
    ends = sums[FINE + 1 :] - sums[: -FINE - 1]
    means: Array = (ends / (FINE + 1))[::FINE]
    return means


def noise_like(scene: Scene, seed: int, size: float) -> Array:
    """White noise (N, n) N m of a scene's shape."""
    hiss: Array = np.random.default_rng(seed).normal(scale=size, size=scene.motion.q.shape)
    return hiss


def left_over(scene: Scene) -> Array:
    """Measured minus modelled torque (N, n), low-passed alike."""
    motion = scene.motion
    assert motion.tau is not None
    friction = motion.filtered(scene.friction, times=2)
    return motion.tau - motion.filtered(scene.rigid) - friction


def fitted(
    effect: Effect, scenes: list[Scene], joint: int | None, settings: Mapping[str, float]
) -> tuple[Array, float]:
    """Coefficients (k,) by least squares, and the RMS of what is left on the touched joints."""
    X, y = [], []
    for scene in scenes:
        columns = effect.columns(scene, joint, settings)
        rows, residual = scene.motion.usable, left_over(scene)
        for j, column in columns.items():
            X.append(scene.motion.filtered(column, times=effect.passes)[rows])
            y.append(residual[rows, j])
    A, b = np.concatenate(X), np.concatenate(y)
    c = np.linalg.lstsq(A, b, rcond=None)[0]
    return c, float(np.sqrt(np.mean((b - A @ c) ** 2)))


def best_fitted(
    effect: Effect, scenes: list[Scene], joint: int | None
) -> tuple[dict[str, float], Array, float]:
    """Return the best plausible settings, their coefficients, and the RMS of the rest.

    Settings are the grid's, and then those to which the effect sharpens them: the first time in any
    case where the grid's columns are of first order, then while that leaves less.
    """
    tried = [
        (*fitted(effect, scenes, joint, s), s)
        for s in effect.grid(scenes, joint, [left_over(x) for x in scenes])
    ]
    sound = [item for item in tried if effect.plausible(scenes, joint, item[2], item[0])]
    c, rms, settings = min(sound, key=lambda item: item[1])
    for number in range(SHARPENED):
        nearer = effect.sharpened(settings, c)
        if nearer is None:
            break
        again, left = fitted(effect, scenes, joint, nearer)
        stands = number == 0 and effect.first_order
        if not effect.plausible(scenes, joint, nearer, again) or not (stands or left < rms):
            break
        c, rms, settings = again, left, nearer
    return dict(settings), c, rms
