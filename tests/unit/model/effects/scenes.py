"""Scenes made by hand: a two-joint arm with gears, smooth random motion with rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Effect, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import FrictionJoint
from seqid_cli.robot.placement import DhRow, chain_from_dh
from seqid_cli.robot.types import Robot
from tests.unit.robot.robots import random_inertia, robot_from_chain

Array = NDArray[np.float64]

RATE_HZ = 240.0
CUTOFF_HZ = 10.0
SIGN_WIDTH = 0.006  # rad/s
GEAR = (50.0, 30.0)
ROTOR = (1e-4, 5e-5)  # kg m^2, motor side
COULOMB, VISCOUS = (4.0, 1.5), (2.0, 0.8)  # N m, N m s/rad


def two_joint_robot(*, prismatic: bool = False, drives: bool = True) -> Robot:
    """Return a vertical arm, its second joint skew; a slide instead of the second on request.

    Without `drives` the robot file says nothing of gears, motors, encoders and limits.
    """
    rows = [DhRow(0.0, 0.0, 0.0, 0.0), DhRow(0.4, 0.3, 0.1, 0.0)]
    chain = chain_from_dh(rows)
    chain = replace(chain, prismatic=np.array([False, prismatic]))
    robot = robot_from_chain(chain, gravity=np.array([0.0, -9.81, 0.0]))
    if not drives:
        return robot
    joints = tuple(
        replace(
            joint,
            torque_constant=0.1,
            gear_ratio=gear,
            rotor_inertia=rotor,
            encoder_resolution=1e-5,
            position_limits=(-3.0, 3.0),
            velocity_limit=3.0,
        )
        for joint, gear, rotor in zip(robot.joints, GEAR, ROTOR, strict=True)
    )
    return replace(robot, joints=joints)


def friction_surface(
    coulomb: float, viscous: float, top: float = 4.0, *, order: int = 1, variance: float = 1.0
) -> FrictionSurface:
    """Coulomb [N m] and viscous [N m s/rad] friction up to `top` rad/s, of some order in speed."""
    half = 0.5 * viscous * top
    entries = [coulomb + half, half, *np.zeros(order - 1)]
    entry = FrictionJoint(
        position_order=0,
        velocity_order=order,
        max_error=0.0,
        rmse=0.0,
        position_range=[-3.0, 3.0],
        speed_range=[0.0, top],
        sign_width=SIGN_WIDTH,
        directional=False,
        positive=[entries],
        negative=[entries],
        covariance=(variance * np.eye(len(entries))).tolist(),
    )
    return FrictionSurface.from_stage(entry)


def torque_model(robot: Robot, seed: int = 5) -> TorqueModel:
    """Return rigid body with physical links, rotors, Coulomb and viscous friction."""
    rng = np.random.default_rng(seed)
    phi = np.array([random_inertia(rng).toDynamicParameters() for _ in range(robot.n)])
    surfaces: list[FrictionSurface | None] = [
        friction_surface(c, v) for c, v in zip(COULOMB, VISCOUS, strict=True)
    ]
    return TorqueModel(robot, surfaces, phi, np.array(ROTOR), "diagonal")


def wander(
    seconds: float,
    *,
    seed: int = 0,
    rate_hz: float = RATE_HZ,
    n: int = 2,
    amplitude: float = 1.0,
    top_hz: float = 0.8,
    rests: Sequence[tuple[float, float]] = ((5.0, 7.0),),
    still: Sequence[int] = (),
) -> Array:
    """Return smooth random positions (N, n) rad.

    All joints stand still together during `rests` (from, to) s, and those in `still` always; the
    motion sets in and dies away within half a second.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    pace = np.ones_like(t)
    for begin, end in rests:
        pace *= 1.0 - 0.25 * (1 + np.tanh((t - begin) / 0.1)) * (1 - np.tanh((t - end) / 0.1))
    pace[pace < 1e-6] = 0.0
    phase = np.cumsum(pace) / rate_hz
    omega = 2 * np.pi * rng.uniform(0.08, top_hz, size=(6, n))
    weight = rng.normal(size=(6, n)) / omega
    weight /= np.sqrt(np.sum(weight**2, axis=0))
    angle = rng.uniform(0, 2 * np.pi, size=(6, n))
    q: Array = amplitude * np.sum(weight * np.sin(omega * phase[:, None, None] + angle), axis=1)
    q[:, list(still)] = q[:1, list(still)]
    return q


def motion_of(
    q: Array,
    *,
    rate_hz: float = RATE_HZ,
    cutoff_hz: float = CUTOFF_HZ,
    tau: Array | None = None,
) -> Motion:
    """Wrap positions q (N, n): low-passed once, differentiated; raw torque tau twice low-passed."""
    lowpass = Lowpass(cutoff_hz, rate_hz)
    smooth = lowpass(q)
    dq, ddq = differentiate(smooth, rate_hz)
    usable = np.zeros(len(q), dtype=bool)
    usable[2 * lowpass.settling : -2 * lowpass.settling] = True
    zeros = np.zeros(q.shape[1])
    return Motion(
        t=np.arange(len(q)) / rate_hz,
        q=smooth,
        dq=dq,
        ddq=ddq,
        tau=None if tau is None else lowpass(lowpass(tau)),
        moving=np.abs(dq) > 1e-3,
        usable=usable,
        valid=np.ones(len(q), dtype=bool),
        rate_hz=rate_hz,
        lowpass=lowpass,
        cutoff=Cutoff(cutoff_hz, zeros, 0.0, True, zeros),
    )


def scene_of(
    q: Array,
    *,
    robot: Robot | None = None,
    model: TorqueModel | None = None,
    rate_hz: float = RATE_HZ,
    cutoff_hz: float = CUTOFF_HZ,
    log: int = 0,
    start: float = 0.0,
    shared_clock: bool = False,
    temperature: Array | None = None,
) -> Scene:
    """Return the scene of positions q (N, n), its measured torque being the model's own."""
    robot = robot or two_joint_robot()
    motion = motion_of(q, rate_hz=rate_hz, cutoff_hz=cutoff_hz)
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


def scenes_of_logs(logs: int = 3, seconds: float = 20.0, apart: float = 300.0) -> list[Scene]:
    """Return several logs on a shared clock, `apart` s from start to start, that warm up."""
    scenes = []
    for number in range(logs):
        q = wander(seconds, seed=number)
        t = number * apart + np.arange(len(q)) / RATE_HZ
        warm = 25.0 + 15.0 * (1.0 - np.exp(-t / 400.0))
        scenes.append(
            scene_of(
                q,
                log=number,
                start=number * apart,
                shared_clock=True,
                temperature=np.stack([warm, 0.5 * warm + 12.0], axis=1),
            )
        )
    return scenes


def settings_of(effect: Effect, scenes: Sequence[Scene], joint: int | None) -> list[Settings]:
    """Return the grid of an effect; its residual is what the effect itself need not know, noise."""
    rng = np.random.default_rng(1)
    residual = [s.motion.filtered(rng.normal(size=s.motion.q.shape)) for s in scenes]
    return list(effect.grid(scenes, joint, residual))


def with_torque(scene: Scene, extra: Array) -> Scene:
    """Add torque extra (N, n) N m, unfiltered, to what the scene has measured."""
    motion = scene.motion
    assert motion.tau is not None
    return replace(scene, motion=replace(motion, tau=motion.tau + motion.filtered(extra, times=2)))
