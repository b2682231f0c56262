"""Fit one effect to torque that was made another way."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from seqid_cli.effects.effect import Effect, Settings
from seqid_cli.effects.scene import Scene
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.motion import decimated
from tests import Array
from tests.plants.robots.two_joint import SIGN_WIDTH
from tests.unit.effects.scenes import motion_of, scene_of, wander

# t (N,), q (N, n), dq (N, n) -> torque (N, n)
Law = Callable[[Array, Array, Array], Array]

FINE_HZ = 2400.0
STEP = 10
SHARPENED = 4  # times at most that settings are moved


def direction(dq: Array) -> Array:
    """Return the direction of the true motion, as wide as the base model has it."""
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
    """Return what the model leaves of the measured torque, (N, n) N m."""
    return scene.motion.tau - scene.modelled_filtered


def rms_left(scenes: Sequence[Scene], joints: slice | int = slice(None)) -> float:
    """Return the RMS N m of what scenes' models leave at usable samples."""
    residuals = [left_over(scene)[scene.motion.usable][:, joints] for scene in scenes]
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))


def fitted(
    effect: Effect,
    scenes: Sequence[Scene],
    joint: int | None,
    settings: Settings,
    free: Sequence[str] = (),
) -> tuple[Array, float]:
    """Fit an effect by least squares, on the joints that it touches.

    Beside the effect the direction, velocity or offset of each joint are `free`.
    Returns the effect's coefficients (k,), and the RMS of what is left.
    """
    X = []
    y = []
    for scene in scenes:
        motion = scene.motion
        usable = motion.usable
        residual = left_over(scene)
        for j, column in effect.columns_in_log(scene, joint, settings).items():
            terms = {
                "direction": scene.sign[:, j],
                "velocity": motion.dq[:, j],
                "offset": np.ones(scene.samples),
            }
            base = [motion.filtered(terms[name][:, None], 2) for name in free]
            columns = [motion.filtered(column, effect.passes), *base]
            X.append(np.hstack(columns)[usable])
            y.append(residual[usable, j])

    A = np.concatenate(X)
    b = np.concatenate(y)
    c = np.linalg.lstsq(A, b, rcond=None)[0]
    rms = float(np.sqrt(np.mean((b - A @ c) ** 2)))
    count = len(effect.coefficients(settings))
    return c[:count], rms


def fit(
    effect: Effect, scenes: Sequence[Scene], joint: int, *, offset: bool = True
) -> tuple[Settings, Array]:
    """Search the grid, then between its points.

    Direction, velocity and, if asked for, offset of the joint are free. Returns the
    best settings and their coefficients.
    """
    free = ("direction", "velocity", "offset")[: 2 + offset]
    silence = [np.zeros_like(scene.motion.q) for scene in scenes]

    def left(settings: Settings) -> float:
        return fitted(effect, scenes, joint, settings, free)[1]

    best = dict(min(effect.grid(scenes, joint, silence), key=left))
    between = effect.between(best)

    def moved(x: Array) -> Settings:
        """Return the best settings moved by x - 1, or by ratio if searched so."""
        settings = dict(best)
        for setting, shift in zip(between, x - 1.0, strict=True):
            value = best[setting.name] + shift
            if setting.logarithmic:
                value = best[setting.name] * np.exp(shift)
            settings[setting.name] = float(np.clip(value, setting.low, setting.high))
        return settings

    if between:
        search = minimize(
            lambda x: left(moved(x)),
            np.ones(len(between)),
            method="Nelder-Mead",
            options={"xatol": 1e-3, "fatol": 1e-6},
        )
        best = dict(moved(search.x))
    return best, fitted(effect, scenes, joint, best, free)[0]


class BestFit(NamedTuple):
    """Settings, their coefficients, and the RMS of what they leave."""

    settings: Mapping[str, float]
    c: Array
    rms: float


def best_fitted(effect: Effect, scenes: list[Scene], joint: int | None) -> BestFit:
    """Return the best plausible fit.

    Settings are the grid's, and then those to which the effect sharpens them: the first
    time in any case where the grid's columns are of first order, then while that leaves
    less.
    """

    def fit_of(settings: Mapping[str, float]) -> BestFit:
        c, rms = fitted(effect, scenes, joint, settings)
        return BestFit(settings, c, rms)

    residuals = [left_over(scene) for scene in scenes]
    fits = [fit_of(settings) for settings in effect.grid(scenes, joint, residuals)]
    plausible = [
        fit for fit in fits if effect.plausible(scenes, joint, fit.settings, fit.c)
    ]
    best = min(plausible, key=lambda fit: fit.rms)
    for number in range(SHARPENED):
        nearer = effect.sharpened(best.settings, best.c)
        if nearer is None:
            break
        sharpened = fit_of(nearer)
        counts_anyway = number == 0 and effect.first_order
        is_better = counts_anyway or sharpened.rms < best.rms
        if not (is_better and effect.plausible(scenes, joint, nearer, sharpened.c)):
            break
        best = sharpened
    return best
