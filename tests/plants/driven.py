"""Arms under a drive of known gains, in MuJoCo, stepped at a quarter of a millisecond.

Nothing of the package computes these motions. The friction of the joints is Coulomb's
and viscous, the controller reads the exact state at every step.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from seqid_cli.logs.recording import CommandForm, Health, Recording
from seqid_cli.params.schema import FrictionStage, Stages
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.types import Joint, Robot
from tests import Array
from tests.plants.mechanics.rigid import placement
from tests.plants.robots.made import friction_joint
from tests.plants.robots.stages import inertia_stage

STEP_S = 2.5e-4
GEAR = 50.0
SPEEDS = (0.01, 3.0)  # rad/s, of the friction surfaces
# Friction as hard as the solver makes it. By default it stops a joint over 20 ms, which
# is a viscous friction below some 0.05 rad/s and no Coulomb's.
HARD = 0.999
# By so much messages are late at most, those of a clock of their own [s].
JITTER_S = 5e-4
# Three axes of an arm with links of 0.3 m, and three of a wrist.
DH = (
    (np.pi / 2, 0.0, 0.0, 0.0),
    (0.0, 0.3, 0.0, 0.0),
    (np.pi / 2, 0.3, 0.0, 0.0),
    (-np.pi / 2, 0.0, 0.3, 0.0),
    (np.pi / 2, 0.0, 0.0, 0.0),
    (-np.pi / 2, 0.0, 0.1, 0.0),
)


@dataclass(frozen=True)
class Drive:
    """Gains of n joints, (n,) each; see `drive.equations` for their meaning."""

    proportional: Array
    derivative: Array
    integral: Array
    velocity_feedforward: Array
    gravity_compensation: Array
    command_delay: float  # s, of all joints
    torque_lag: float  # s
    torque_limit: Array  # N m; infinite for none


@dataclass(frozen=True)
class DrivenArm:
    """An arm and its drive."""

    robot: Robot
    phi: Array  # (n, 10)
    armature: Array  # (n,) kg m^2 at the joint
    coulomb: Array  # (n,) N m
    viscous: Array  # (n,) N m s/rad
    drive: Drive

    def stages(self) -> Stages:
        """The true model, as a parameter file holds it."""
        low, high = SPEEDS
        joints = {}
        for j, name in enumerate(self.robot.joint_names):
            middle = self.coulomb[j] + 0.5 * self.viscous[j] * (low + high)
            row = np.array([[middle, 0.5 * self.viscous[j] * (high - low)]])
            joints[name] = friction_joint(
                row,
                row,
                max_error=0.01,
                rmse=0.01,
                position_range=[-3.0, 3.0],
                speed_range=[low, high],
                sign_width=0.005,
                covariance=(1e-8 * np.eye(2)).tolist(),
            )
        rotor = self.armature / GEAR**2
        return Stages(
            friction=FrictionStage(joints=joints),
            inertia=inertia_stage(self.robot, self.phi, rotor),
        )

    def with_drive(self, **changes: Any) -> "DrivenArm":
        return replace(self, drive=replace(self.drive, **changes))


def drawn_arm(seed: int, n: int) -> DrivenArm:
    """Draw an arm of n joints with a drive of a bandwidth of 2 to 5 Hz."""
    rng = np.random.default_rng([seed, n])
    joints = tuple(Joint(f"joint_{k + 1}", gear_ratio=GEAR) for k in range(n))
    robot = Robot(
        "driven",
        joints,
        chain_from_dh(DH[:n]),
        np.array([0.0, 0.0, -9.81]),
        "",
        Path("robot.toml"),
    )
    mass = rng.uniform(0.8, 1.5, n) / np.arange(1, n + 1)
    phi = np.zeros((n, 10))
    for j in range(n):
        com = np.array([rng.uniform(0.1, 0.2), 0.02, 0.01])
        inertia = np.diag(rng.uniform(0.8, 1.2, 3) * 4e-3 * mass[j])
        shift = mass[j] * (com @ com * np.eye(3) - np.outer(com, com))
        about_origin = inertia + shift
        phi[j, 0] = mass[j]
        phi[j, 1:4] = mass[j] * com
        phi[j, 4:] = about_origin[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    armature = rng.uniform(0.05, 0.1, n)
    # What a joint moves of the arm, about.
    carried = np.array([np.sum(mass[j:]) * 0.06 * (n - j) for j in range(n)])
    rate = 2.0 * np.pi * rng.uniform(2.0, 5.0, n)
    kp = (carried + armature) * rate**2
    kd = 2.0 * rng.uniform(0.5, 1.0, n) * (carried + armature) * rate
    has_feedforward = rng.random(n) < 0.5
    drive = Drive(
        proportional=kp,
        derivative=kd,
        integral=kp * rng.uniform(1.0, 3.0, n) * (rng.random(n) < 0.5),
        velocity_feedforward=kd * has_feedforward,
        gravity_compensation=np.where(rng.random(n) < 0.5, 1.0, 0.0),
        command_delay=float(rng.uniform(0.005, 0.04)),
        torque_lag=float(rng.choice([0.0, 0.004, 0.01])),
        torque_limit=np.full(n, np.inf),
    )
    return DrivenArm(
        robot=robot,
        phi=phi,
        armature=armature,
        coulomb=rng.uniform(0.2, 0.6, n),
        viscous=rng.uniform(0.2, 0.8, n),
        drive=drive,
    )


def multisine(
    seed: int, n: int, duration_s: float, *, size: float = 0.5, highest_hz: float = 4.0
) -> Any:
    """Return a commanded position over time: waves that begin and end smoothly."""
    rng = np.random.default_rng(seed)
    f = np.geomspace(0.1, highest_hz, 12)
    amplitude = size * rng.uniform(0.5, 1.0, (12, n)) / np.maximum(f, 0.3)[:, None] / 6
    phase = rng.uniform(0.0, 2.0 * np.pi, (12, n))

    def command(t: Array) -> Array:
        # A step of the speed would be one of the torque, between two rows.
        window = np.sin(0.5 * np.pi * np.clip(t / 1.0, 0.0, 1.0)) ** 2
        waves = np.sin(2.0 * np.pi * f * np.asarray(t)[..., None, None] + phase.T)
        return np.asarray(window[..., None] * np.sum(waves * amplitude.T, axis=-1))

    return command


@dataclass
class _Log:
    t: list[float] = field(default_factory=list)
    q: list[Array] = field(default_factory=list)
    dq: list[Array] = field(default_factory=list)
    tau: list[Array] = field(default_factory=list)


def simulate_drive(
    arm: DrivenArm,
    command: Any,
    duration_s: float,
    *,
    seed: int = 0,
    rate_hz: float = 200.0,
    command_hz: float | None = None,
    own_clock: bool = False,
    noise: float = 1e-5,
    torque_noise: float = 0.02,
    with_torque: bool = True,
    resists: Any = None,
) -> Recording:
    """Run an arm after a command and record it.

    `command_hz`: commands are sent at this rate and held; without it they are as smooth
    as the function, and each row has one. `own_clock`: they are sent at a phase of
    their own and up to `JITTER_S` late, and not together with rows. `resists`: a torque
    (n,) N m against the motion besides, a function of positions, speeds and the torque
    of gravity.
    """
    model = mujoco.MjModel.from_xml_string(mjcf_of(arm))
    data = mujoco.MjData(model)
    drive = arm.drive
    n = arm.robot.n
    steps = round(duration_s / STEP_S)
    t = np.arange(steps) * STEP_S
    sent_t = t - drive.command_delay
    stamps: Array | None = None
    if command_hz is not None:
        stamps = sent_stamps(duration_s, command_hz, seed=seed, own_clock=own_clock)
        sent_t = latest(stamps, sent_t)
    c = command(np.maximum(sent_t, 0.0))
    dc = np.gradient(c, STEP_S, axis=0)
    data.qpos[:] = command(np.zeros(1))[0]
    integral = np.zeros(n)
    error_before = np.zeros(n)
    gravity = np.zeros(n)
    speed_before = np.zeros(n)
    every = round(1.0 / rate_hz / STEP_S)
    applied = np.zeros((steps, n))
    log = _Log()
    has_gravity = drive.gravity_compensation.any()
    rest = mujoco.MjData(model)
    for k in range(steps):
        q = data.qpos.copy()
        # MuJoCo's velocities are those of half a step before its positions.
        dq = 1.5 * data.qvel - 0.5 * speed_before
        speed_before = data.qvel.copy()
        if has_gravity:
            rest.qpos[:] = q
            mujoco.mj_kinematics(model, rest)
            mujoco.mj_comPos(model, rest)
            mujoco.mj_crb(model, rest)
            mujoco.mj_rne(model, rest, 0, gravity)
        error = c[k] - q
        # By trapezoids: the error of a whole step would be half of one more in kp.
        integral += 0.5 * (error + error_before) * STEP_S
        error_before = error
        u = (
            drive.proportional * error
            - drive.derivative * dq
            + drive.velocity_feedforward * dc[k]
            + drive.integral * integral
            + drive.gravity_compensation * gravity
        )
        u = np.clip(u, -drive.torque_limit, drive.torque_limit)
        applied[k] = u
        if k % every == 0:
            log.t.append(k * STEP_S)
            log.q.append(q)
            log.dq.append(dq)
        # Where it belongs in time: MuJoCo's own damping is that of half a step later,
        # which makes a joint seem heavier.
        data.qfrc_applied[:] = u - arm.viscous * dq
        if resists is not None:
            data.qfrc_applied[:] -= resists(q, dq, data.qfrc_bias.copy())
        mujoco.mj_step(model, data)
    return _recording(
        arm,
        log,
        applied,
        command,
        seed=seed,
        stamps=stamps,
        noise=noise,
        torque_noise=torque_noise,
        with_torque=with_torque,
    )


def sent_stamps(
    duration_s: float, command_hz: float, *, seed: int, own_clock: bool
) -> Array:
    """Return when commands are sent (K,) [s], the first one at 0."""
    stamps = np.arange(np.ceil(duration_s * command_hz)) / command_hz
    if own_clock:
        rng = np.random.default_rng([seed, 78])
        late = rng.uniform(0.0, 1.0 / command_hz)
        late = late + rng.uniform(0.0, JITTER_S, len(stamps))
        stamps = np.append(0.0, stamps + late)
    return stamps


def latest(stamps: Array, t: Array) -> Array:
    """Return the latest of some stamps (K,) at each time, the first one before it."""
    number = np.searchsorted(stamps, t + 1e-9, side="right") - 1
    return np.asarray(stamps[np.maximum(number, 0)])


def _recording(
    arm: DrivenArm,
    log: _Log,
    applied: Array,
    command: Any,
    *,
    seed: int,
    stamps: Array | None,
    noise: float,
    torque_noise: float,
    with_torque: bool,
) -> Recording:
    rng = np.random.default_rng([seed, 77])
    t = np.array(log.t)
    q = np.array(log.q) + noise * rng.standard_normal((len(t), arm.robot.n))
    rows = np.rint((t - arm.drive.torque_lag) / STEP_S).astype(int)
    tau = applied[np.maximum(rows, 0)]
    tau = tau + torque_noise * rng.standard_normal(tau.shape)
    sent = t
    age = None
    form: CommandForm = "sampled"
    if stamps is not None:
        sent = latest(stamps, t)
        age = t - sent
        form = "sent"
    return Recording(
        path=Path(f"driven_{seed}.parquet"),
        sha256=f"{seed}",
        format="parquet",
        t=t,
        q=q,
        valid=np.ones(len(t), np.bool_),
        health=Health(rate_hz=1.0 / float(t[1] - t[0]), jitter=0.0),
        tau=tau if with_torque else None,
        command=command(sent),
        command_form=form,
        command_age=age,
    )


def mjcf_of(arm: DrivenArm, *, step_s: float = STEP_S) -> str:
    """Write the arm as MJCF; link frames by the modified DH table."""
    head = (
        f'<mujoco><compiler angle="radian" boundmass="0" balanceinertia="false"/>'
        f'<option timestep="{step_s}" gravity="0 0 -9.81" integrator="implicitfast">'
        '<flag contact="disable"/></option><worldbody>'
    )
    body = ""
    for j in range(arm.robot.n):
        rotation, origin = placement(np.array(DH[j]))
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        mass = arm.phi[j, 0]
        com = arm.phi[j, 1:4] / mass
        xx, xy, yy, xz, yz, zz = arm.phi[j, 4:]
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))
        full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        body += (
            f'<body pos="{_text(origin)}" quat="{_text(quaternion)}">'
            f'<inertial pos="{_text(com)}" mass="{mass}" fullinertia="{_text(full)}"/>'
            f'<joint name="joint_{j + 1}" axis="0 0 1" armature="{arm.armature[j]}"'
            f' frictionloss="{arm.coulomb[j]}"'
            f' solreffriction="{2.0 * step_s} 1" solimpfriction="{HARD} {HARD} 1"/>'
        )
    return head + body + "</body>" * arm.robot.n + "</worldbody></mujoco>"


def _text(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in values)
