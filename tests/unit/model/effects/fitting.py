"""Fit one effect to torque that was made another way: by a law, or as instruments falsify it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from seqid_cli.model.effects.effect import Effect, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import decimated
from tests import Array
from tests.plants.robots.two_joint import SIGN_WIDTH, torque_model, two_joint_robot
from tests.unit.model.effects.scenes import RATE_HZ, motion_of, scene_of, wander

Law = Callable[[Array, Array, Array], Array]  # t (N,), q (N, n), dq (N, n) -> torque (N, n)

FINE_HZ, STEP = 2400.0, 10


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
) -> Scene:
    """Add a law to the model's torque, of the true motion; a scene sees it filtered and decimated.

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
    scene = replace(plain, motion=motion)
    return replace(scene, motion=replace(motion, tau=scene.modelled_filtered + motion.tau))


def fit(effect: Effect, scenes: Sequence[Scene], joint: int, *, offset: bool = True) -> Fit:
    """Search the grid, then between its points; direction, velocity and offset are free."""
    rows = [scene.motion.usable for scene in scenes]
    y = np.concatenate([left_over(s)[k, joint] for s, k in zip(scenes, rows, strict=True)])
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


def scenes_with(
    law: Law, *, logs: int = 2, noise: float = 0.05, top_hz: float = 0.8
) -> list[Scene]:
    """Return logs of the two-joint arm with a law's torque."""
    return [trial(law, seed=k, noise=noise, top_hz=top_hz, log=k) for k in range(logs)]


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
    return (ends / (FINE + 1))[::FINE]


def noise_like(scene: Scene, seed: int, size: float) -> Array:
    """White noise (N, n) N m of a scene's shape."""
    return np.random.default_rng(seed).normal(scale=size, size=scene.motion.q.shape)


def left_over(scene: Scene) -> Array:
    """Measured minus modelled torque (N, n), low-passed alike."""
    return scene.motion.tau - scene.modelled_filtered


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


def rms_left(scenes: Sequence[Scene], joints: slice | int = slice(None)) -> float:
    """RMS N m of what scenes' models leave at usable samples."""
    left = [left_over(scene)[scene.motion.usable][:, joints] for scene in scenes]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


def moved_by(scene: Scene, truth: TorqueModel) -> Scene:
    """Return the scene with the rigid torque of another model in what it measured."""
    motion = scene.motion
    extra = truth.rigid(motion.q, motion.dq, motion.ddq) - scene.rigid
    return replace(scene, motion=replace(motion, tau=motion.tau + motion.filtered(extra)))
