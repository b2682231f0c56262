"""One log of an arm in MuJoCo: a controller follows a motion, and sensors say what they
see.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from tests import Array
from tests.studies.outside.arms import Arm
from tests.studies.outside.robotfiles import STEP_S, mjcf

DAMPING = 0.8  # of the position loop


@dataclass
class State:
    """An arm at a moment: t (s, of the session) and (n,) per joint; `memory` belongs to
    effects.
    """

    t: float
    q: Array  # rad
    dq: Array  # rad/s
    load: Array  # N m that the gear passes to the link
    warmth: Array  # K above the cold arm
    memory: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect:
    """One thing that the model lacks; every part that is given acts, by the scale that
    comes first.

    `xml` edits the arm in MuJoCo. At every step `dry` gives the joint's dry friction
    beyond what it would be, `push` a torque more at the joint, `flange` a force (3,) at
    the last body, and `drive` makes of the torques that are told (n,) those that act.
    `told` makes of a logged torque (N,) at times (N,) another one, of the joint or else
    of all; `angle` gives what the joint's encoder says beyond its angle. `joint` is
    None for an effect of the whole arm, `partner` is the other joint of a pair: either
    may give the name.
    """

    joint: int | None
    most: float = 20.0
    partner: int | None = None
    xml: Callable[[float, ET.Element], None] | None = None
    dry: Callable[[float, float, State], float] | None = None
    push: Callable[[float, State], float] | None = None
    flange: Callable[[float, float], Array] | None = None
    drive: Callable[[float, Array, State], Array] | None = None
    told: Callable[[float, Array, Array], Array] | None = None
    angle: Callable[[float, float], float] | None = None
    name: str = ""
    scale: float = 1.0  # 1 is a usual size, `most` what the effect can be at the most

    def make(self, scale: float) -> "Effect":
        return replace(self, scale=scale)


@dataclass(frozen=True)
class Log:
    """What was logged, and the truth beside it."""

    t: Array
    q: Array
    torque: Array
    temperature: Array
    accelerometers: dict[str, Array]
    gyros: dict[str, Array]
    true_torque: Array


def built(arm: Arm, effects: Sequence[Effect] = ()) -> mujoco.MjModel:
    root = mjcf(arm)
    for effect in effects:
        if effect.xml:
            effect.xml(effect.scale, root)
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def _motors(arm: Arm, model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Degrees of freedom of the motors and of the links that they move."""
    kinds, dof = mujoco.mjtObj.mjOBJ_JOINT, model.jnt_dofadr
    links = [mujoco.mj_name2id(model, kinds, name) for name in arm.names]
    motors = [mujoco.mj_name2id(model, kinds, f"{name}_motor") for name in arm.names]
    moved = [m if m >= 0 else j for m, j in zip(motors, links, strict=True)]
    return dof[moved].tolist(), dof[links].tolist()


def controller(arm: Arm, reference: Array, rate: Array) -> tuple[Array, Array]:
    """Inertia (n,) that the loops are tuned to, and what is fed forward (N, n)."""
    model = built(arm)
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = [link.middle for link in arm.links[: arm.n]]
    mujoco.mj_forward(model, data)
    full = np.zeros((arm.n, arm.n))
    mujoco.mj_fullM(model, data, full)
    torque = np.empty_like(reference)
    motion = zip(reference, rate, np.gradient(rate, STEP_S, axis=0), strict=True)
    for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(motion):
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return np.diag(full).copy(), arm.forward * torque


def simulate(
    arm: Arm,
    reference: Array,
    seed: int,
    effects: Sequence[Effect] = (),
    start: float = 0.0,
) -> Log:
    """Follow a motion (N, n) at 1 kHz: PD, with most of the rigid arm's torque fed
    forward.
    """
    data = mujoco.MjData(model := built(arm, effects))
    motor, link = _motors(arm, model)
    for dofs in (motor, link):
        data.qpos[dofs] = reference[0]
    mujoco.mj_forward(model, data)
    rate = np.gradient(reference, STEP_S, axis=0)
    felt, forward = controller(arm, reference, rate)
    kp, kd = felt * arm.bandwidth**2, felt * 2.0 * DAMPING * arm.bandwidth
    times = start + np.arange(len(reference)) * STEP_S
    warmth = np.array([d.rise * -np.expm1(-times / d.warm_s) for d in arm.drives]).T
    coulomb, waviness, phase = (arm.of(k) for k in ("coulomb", "waviness", "phase"))
    q, tau = np.empty_like(reference), np.empty_like(reference)
    sensed = np.empty((len(reference), model.nsensordata))
    state = State(
        start, reference[0], np.zeros(arm.n), data.qfrc_bias[link].copy(), warmth[0]
    )
    pushed = next((e for e in effects if e.flange), None)
    for k in range(len(reference)):
        state.t, state.warmth = times[k], warmth[k]
        state.q, state.dq = data.qpos[motor], data.qvel[motor]
        dry, said = coulomb * (1.0 + waviness * np.sin(state.q + phase)), state.q.copy()
        for e in effects:
            if e.angle:
                said[e.joint] += e.angle(e.scale, said[e.joint])
            if e.dry:
                base = dry[e.joint]
                dry[e.joint] = max(base + e.dry(e.scale, base, state), 0.0)
        torque = kp * (reference[k] - said) + kd * (rate[k] - state.dq) + forward[k]
        acting = torque.copy()
        for e in effects:
            acting = e.drive(e.scale, acting, state) if e.drive else acting
            if e.push:
                acting[e.joint] += e.push(e.scale, state)
        q[k], tau[k] = said, torque
        model.dof_frictionloss[motor] = dry
        data.qfrc_applied[motor] = acting
        if pushed:
            data.xfrc_applied[-1, :3] = pushed.flange(pushed.scale, times[k] - start)
        mujoco.mj_step(model, data)
        sensed[k] = data.sensordata
        passed = data.qfrc_applied + data.qfrc_constraint + data.qfrc_passive
        # what the gears pass on
        state.load = (passed - model.dof_armature * data.qacc)[motor]
    return logged(arm, times, (q, tau, warmth, sensed), seed, effects)


def logged(
    arm: Arm, times: Array, truth: Sequence[Array], seed: int, effects: Sequence[Effect]
) -> Log:
    rng, (q, tau, warmth, sensed) = np.random.default_rng([seed, 5]), truth
    told = tau.copy()
    for e in effects:
        for k in range(arm.n) if e.told else ():
            if e.joint in (None, k):
                told[:, k] = e.told(e.scale, told[:, k], times)
    rows = slice(None, None, round(1.0 / (STEP_S * arm.rate_hz)))
    noise = arm.noise * arm.of("coulomb") * rng.normal(size=told[rows].shape)
    counts = arm.of("count")
    accelerometers, gyros, at = {}, {}, 0  # the sensors' numbers come IMU by IMU
    for k, imu in enumerate(arm.imus):
        count = 3 * len(imu.corners)
        clean = sensed[rows, at : at + count] + imu.bias[:count]
        accelerometers[f"imu{k}"] = clean + imu.noise * rng.normal(size=clean.shape)
        at += count
        if imu.gyro:
            clean = sensed[rows, at : at + 3]
            gyros[f"imu{k}"] = clean + 0.002 * rng.normal(size=clean.shape)
            at += 3
    return Log(
        *(times[rows], counts * np.round(q[rows] / counts), told[rows] + noise),
        np.round(2.0 * (25.0 + warmth[rows])) / 2.0,
        *(accelerometers, gyros, tau[rows]),
    )
