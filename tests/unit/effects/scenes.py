"""Scenes made by hand: a two-joint arm with gears, smooth random motion with rests."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.effects.effect import Effect, Settings
from seqid_cli.effects.scene import Scene
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.made import made_motion
from tests.plants.robots.two_joint import SIGN_WIDTH, torque_model, two_joint_robot

RATE_HZ = 240.0
CUTOFF_HZ = 10.0


def wander(
    seconds: float,
    *,
    seed: int = 0,
    rate_hz: float = RATE_HZ,
    amplitude: float = 1.0,
    top_hz: float = 0.8,
    rests: Sequence[tuple[float, float]] = ((5.0, 7.0),),
    still: Sequence[int] = (),
) -> Array:
    """Return smooth random positions (N, 2) rad.

    All joints stand still together during `rests` (from, to) s, and those in `still`
    always; the motion sets in and dies away within half a second.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    pace = np.ones_like(t)
    for begin, end in rests:
        pace *= 1.0 - 0.25 * (1 + np.tanh((t - begin) / 0.1)) * (
            1 - np.tanh((t - end) / 0.1)
        )
    pace[pace < 1e-6] = 0.0
    phase = np.cumsum(pace) / rate_hz
    omega = 2 * np.pi * rng.uniform(0.08, top_hz, size=(6, 2))
    weight = rng.normal(size=(6, 2)) / omega
    weight /= np.sqrt(np.sum(weight**2, axis=0))
    angle = rng.uniform(0, 2 * np.pi, size=(6, 2))
    q: Array = amplitude * np.sum(
        weight * np.sin(omega * phase[:, None, None] + angle), axis=1
    )
    q[:, list(still)] = q[:1, list(still)]
    return q


def motion_of(
    q: Array,
    *,
    rate_hz: float = RATE_HZ,
    cutoff_hz: float = CUTOFF_HZ,
    tau: Array | None = None,
) -> Motion:
    """Wrap positions q (N, n): low-passed once, differentiated; raw torque tau twice
    low-passed.
    """
    lowpass = Lowpass(cutoff_hz, rate_hz)
    smooth = lowpass(q)
    dq, ddq = differentiate(smooth, rate_hz)
    usable = np.zeros(len(q), dtype=bool)
    usable[2 * lowpass.settling : -2 * lowpass.settling] = True
    torque = None if tau is None else lowpass(lowpass(tau))
    moving = np.abs(dq) > 1e-3
    return made_motion(
        smooth, dq, ddq, lowpass, tau=torque, moving=moving, usable=usable
    )


def scene_of(
    q: Array,
    *,
    robot: Robot | None = None,
    model: TorqueModel | None = None,
    log: int = 0,
    start: float = 0.0,
    shared_clock: bool = False,
    temperature: Array | None = None,
) -> Scene:
    """Return the scene of positions q (N, n), its measured torque being the model's
    own.
    """
    robot = robot or two_joint_robot()
    motion = motion_of(q)
    scene = Scene(
        robot=robot,
        motion=motion,
        model=model or torque_model(robot),
        sign_width=np.full(q.shape[1], SIGN_WIDTH),
        log=log,
        start=start,
        shared_clock=shared_clock,
        temperature=temperature,
    )
    tau = motion.filtered(scene.rigid) + motion.filtered(scene.friction, times=2)
    return replace(scene, motion=replace(motion, tau=tau))


def scenes_of_logs() -> list[Scene]:
    """Return three logs on a shared clock, 300 s from start to start, that warm up."""
    scenes = []
    for number in range(3):
        q = wander(20.0, seed=number)
        start = 300.0 * number
        warm = 40.0 - 15.0 * np.exp(-(start + np.arange(len(q)) / RATE_HZ) / 400.0)
        heat = np.stack([warm, 0.5 * warm + 12.0], axis=1)
        scenes.append(
            scene_of(q, log=number, start=start, shared_clock=True, temperature=heat)
        )
    return scenes


def settings_of(
    effect: Effect, scenes: Sequence[Scene], joint: int | None
) -> list[Settings]:
    """Return the grid of an effect; its residual is what the effect itself need not
    know, noise.
    """
    rng = np.random.default_rng(1)
    residual = [s.motion.filtered(rng.normal(size=s.motion.q.shape)) for s in scenes]
    return list(effect.grid(scenes, joint, residual))
