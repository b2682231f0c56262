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

Places = slice | list[int]

DAMPING = 0.8  # of the position loop


@dataclass
class State:
    """An arm at a moment: t (s, of the session) and (n,) per joint.

    `memory` belongs to effects. The arrays may be the simulator's own: what an effect
    puts into its memory is a copy.
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
    settled: bool = False
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


def _motors(arm: Arm, model: mujoco.MjModel) -> tuple[Places, Places]:
    """Degrees of freedom of the motors and of the links that they move."""
    kinds, dof = mujoco.mjtObj.mjOBJ_JOINT, model.jnt_dofadr
    links = [mujoco.mj_name2id(model, kinds, name) for name in arm.names]
    motors = [mujoco.mj_name2id(model, kinds, f"{name}_motor") for name in arm.names]
    moved = [m if m >= 0 else j for m, j in zip(motors, links, strict=True)]
    return _places(dof[moved].tolist()), _places(dof[links].tolist())


def _places(dofs: list[int]) -> Places:
    """Give degrees of freedom that lie side by side as a slice: no copy per step."""
    first = dofs[0]
    if dofs == list(range(first, first + len(dofs))):
        return slice(first, first + len(dofs))
    return dofs


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
    qpos, qvel, qacc = data.qpos, data.qvel, data.qacc
    moments = zip(reference, rate, np.gradient(rate, STEP_S, axis=0), strict=True)
    for k, (qpos[:], qvel[:], qacc[:]) in enumerate(moments):
        # Sensors say nothing about the torque.
        mujoco.mj_inverseSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, 1)
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
    stands = reference[0].copy()
    for e in effects:
        if e.settled and e.angle:
            stands[e.joint] -= e.angle(e.scale, stands[e.joint])
    for dofs in (motor, link):
        data.qpos[dofs] = stands
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

    # A step takes some 10 us: only what some effect asks for is worked out.
    encoders = [e for e in effects if e.angle]
    rubbing = [e for e in effects if e.dry]
    drives = [e for e in effects if e.drive or e.push]
    pushing = [e for e in effects if e.flange]
    asks_for_load = bool(rubbing or drives)
    # Views of what the simulator works on.
    qpos, qvel, qacc = data.qpos, data.qvel, data.qacc
    applied, constraint = data.qfrc_applied, data.qfrc_constraint
    passive, frictionloss = data.qfrc_passive, model.dof_frictionloss
    armature, sensordata = model.dof_armature[motor].copy(), data.sensordata
    rows = zip(reference, rate, forward, warmth, times, strict=True)
    for k, (goal, pace, ahead, warm, now) in enumerate(rows):
        state.t, state.warmth = now, warm
        state.q, state.dq = qpos[motor], qvel[motor]
        dry, said = coulomb * (1.0 + waviness * np.sin(state.q + phase)), state.q.copy()
        for e in encoders:
            said[e.joint] += e.angle(e.scale, said[e.joint])
        for e in rubbing:
            base = dry[e.joint]
            dry[e.joint] = max(base + e.dry(e.scale, base, state), 0.0)
        torque = kp * (goal - said) + kd * (pace - state.dq) + ahead
        acting = torque.copy()
        for e in drives:
            acting = e.drive(e.scale, acting, state) if e.drive else acting
            if e.push:
                acting[e.joint] += e.push(e.scale, state)
        q[k], tau[k] = said, torque
        frictionloss[motor] = dry
        applied[motor] = acting
        if pushing:
            forces = [e.flange(e.scale, now - start) for e in pushing]
            data.xfrc_applied[-1, :3] = np.sum(forces, axis=0)
        mujoco.mj_step(model, data)
        sensed[k] = sensordata
        if asks_for_load:
            passed = applied[motor] + constraint[motor] + passive[motor]
            # what the gears pass on
            state.load = passed - armature * qacc[motor]
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
