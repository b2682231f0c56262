"""Fit one effect to torque that was made another way."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from seqid_cli.model.effects.effect import Effect, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.motion import decimated
from tests import Array
from tests.plants.robots.two_joint import SIGN_WIDTH
from tests.unit.model.effects.scenes import motion_of, scene_of, wander

# t (N,), q (N, n), dq (N, n) -> torque (N, n)
Law = Callable[[Array, Array, Array], Array]

FINE_HZ, STEP = 2400.0, 10
SHARPENED = 4  # times at most that settings are moved


def direction(dq: Array) -> Array:
    """Direction of the true motion; how wide its change is, the base model knows."""
    return np.asarray(np.tanh(dq / SIGN_WIDTH))


@lru_cache(maxsize=8)  # several tests, and both joints, ask for the same
def trial(
    law: Law,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    top_hz: float = 0.8,
    start: float = 0.0,
    noise: float = 0.05,
) -> Scene:
    """Add a law to the model's torque, of the true motion; a scene sees it filtered and
    decimated.

    The scene's direction and rest are those of the filtered motion.
    """
    q = wander(seconds, seed=seed, rate_hz=FINE_HZ, top_hz=top_hz)
    t = start + np.arange(len(q)) / FINE_HZ
    torque = law(t, q, np.gradient(q, 1.0 / FINE_HZ, axis=0))
    hiss = noise * np.random.default_rng(100 + seed).normal(size=torque.shape)
    motion = decimated(motion_of(q, rate_hz=FINE_HZ, tau=torque + hiss), 24)
    assert motion.rate_hz == FINE_HZ / STEP
    assert motion.tau is not None
    plain = scene_of(motion.q, log=seed, start=start, shared_clock=True)
    scene = replace(plain, motion=motion)
    return replace(
        scene, motion=replace(motion, tau=scene.modelled_filtered + motion.tau)
    )


def trials(
    law: Law, logs: int = 2, *, noise: float = 0.05, top_hz: float = 0.8
) -> list[Scene]:
    """Return logs of the two-joint arm with a law's torque."""
    return [trial(law, seed=k, noise=noise, top_hz=top_hz) for k in range(logs)]


def moved_by(scene: Scene, truth: TorqueModel) -> Scene:
    """Return the scene with the rigid torque of another model in what it measured."""
    motion = scene.motion
    extra = truth.rigid(motion.q, motion.dq, motion.ddq) - scene.rigid
    return replace(
        scene, motion=replace(motion, tau=motion.tau + motion.filtered(extra))
    )


def left_over(scene: Scene) -> Array:
    return scene.motion.tau - scene.modelled_filtered


def rms_left(scenes: Sequence[Scene], joints: slice | int = slice(None)) -> float:
    """RMS N m of what scenes' models leave at usable samples."""
    left = [left_over(scene)[scene.motion.usable][:, joints] for scene in scenes]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


def fitted(
    effect: Effect,
    scenes: Sequence[Scene],
    joint: int | None,
    settings: Settings,
    free: Sequence[str] = (),
) -> tuple[Array, float]:
    """Coefficients (k,) by least squares, and the RMS of what is left on the touched
    joints.

    Beside the effect the direction, velocity or offset of each joint are `free`.
    """
    X, y = [], []
    for scene in scenes:
        rows, residual = scene.motion.usable, left_over(scene)
        for j, column in effect.columns(scene, joint, settings).items():
            terms = {"direction": scene.sign[:, j], "velocity": scene.motion.dq[:, j]}
            terms["offset"] = np.ones(scene.samples)
            base = [scene.motion.filtered(terms[name][:, None], 2) for name in free]
            X.append(
                np.hstack([scene.motion.filtered(column, effect.passes), *base])[rows]
            )
            y.append(residual[rows, j])
    A, b = np.concatenate(X), np.concatenate(y)
    c = np.linalg.lstsq(A, b, rcond=None)[0]
    return c[: column.shape[1]], float(np.sqrt(np.mean((b - A @ c) ** 2)))


def fit(
    effect: Effect, scenes: Sequence[Scene], joint: int, *, offset: bool = True
) -> tuple[Settings, Array]:
    """Search the grid, then between its points; direction, velocity and offset are
    free.
    """
    free = ("direction", "velocity", "offset")[: 2 + offset]
    silence = [np.zeros_like(scene.motion.q) for scene in scenes]

    def left(settings: Settings) -> float:
        return fitted(effect, scenes, joint, settings, free)[1]

    best = dict(min(effect.grid(scenes, joint, silence), key=left))
    between = effect.between(best)

    def moved(x: Array) -> Settings:
        settings = dict(best)
        for one, shift in zip(between, x - 1.0, strict=True):
            value = (
                best[one.name] * np.exp(shift)
                if one.logarithmic
                else best[one.name] + shift
            )
            settings[one.name] = float(np.clip(value, one.low, one.high))
        return settings

    if between:
        start, within = np.ones(len(between)), {"xatol": 1e-3, "fatol": 1e-6}
        search = minimize(
            lambda x: left(moved(x)), start, method="Nelder-Mead", options=within
        )
        best = dict(moved(search.x))
    return best, fitted(effect, scenes, joint, best, free)[0]


def best_fitted(
    effect: Effect, scenes: list[Scene], joint: int | None
) -> tuple[Mapping[str, float], Array, float]:
    """Return the best plausible settings, their coefficients, and the RMS of the rest.

    Settings are the grid's, and then those to which the effect sharpens them: the first
    time in any case where the grid's columns are of first order, then while that leaves
    less.
    """
    grid = effect.grid(scenes, joint, [left_over(scene) for scene in scenes])
    tried = [(*fitted(effect, scenes, joint, settings), settings) for settings in grid]
    sound = [one for one in tried if effect.plausible(scenes, joint, one[2], one[0])]
    c, rms, settings = min(sound, key=lambda one: one[1])
    for number in range(SHARPENED):
        nearer = effect.sharpened(settings, c)
        if nearer is None:
            break
        again, left = fitted(effect, scenes, joint, nearer)
        stands = number == 0 and effect.first_order
        if not effect.plausible(scenes, joint, nearer, again) or not (
            stands or left < rms
        ):
            break
        c, rms, settings = again, left, nearer
    return settings, c, rms
