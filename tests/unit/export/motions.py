"""Two-joint arms with effects: what `predict` says of them, and what exported code
says.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np
from msgspec.structs import replace as replace_struct

from seqid_cli.effects.apply import added_torque
from seqid_cli.effects.effect import Effect
from seqid_cli.effects.fitted import (
    Fitted,
    FittedEffect,
    as_stage,
    fitted_effects,
)
from seqid_cli.effects.measurement import OfModelledTorque
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.export.formats import export
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.schema import SpeedLevel, Stages
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.made import made_recording
from tests.plants.robots.stages import random_bodies, stages_of
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.effects.scenes import motion_of, wander
from tests.unit.export.compiled import run_c

CC = shutil.which("cc")
RATE_HZ = 1000.0
CUTOFF_HZ = 10.0
START_S = 40.0  # on the session's clock
END_S = 0.5  # where `predict` differentiates what it has mirrored at the log's end
SETTLED_S = 1.5  # from which states have forgotten how they began


@dataclass(frozen=True)
class Case:
    """An effect at a joint (None: of the whole arm, or of all joints alike)."""

    joint: int | None
    coefficients: Sequence[float]
    settings: Mapping[str, float]


def case(joint: int | None, *coefficients: float, **settings: float) -> Case:
    """Return a case of the catalogue."""
    return Case(joint, coefficients, settings)


def arm() -> tuple[Robot, Stages]:
    """Return the arm without effects, its friction different at every place and
    speed.
    """
    robot = two_joint_robot()
    stages = stages_of(robot, random_bodies(np.random.default_rng(3), robot.n))
    level = SpeedLevel(speed=0.1, forward=9, backward=9, rmse=0.01)
    for joint in stages.friction.joints.values():
        joint.speeds = [level]
    return robot, stages


def fitted(effect: Effect, one: Case) -> FittedEffect:
    """Return an effect with the numbers of a case."""
    c = np.array(one.coefficients, dtype=float)
    return FittedEffect(
        effect=effect,
        joint=one.joint,
        settings=dict(one.settings),
        coefficients=c,
        covariance=1e-12 * np.eye(len(c)),
    )


def with_effects(stages: Stages, robot: Robot, items: Sequence[Fitted]) -> Stages:
    """Return the stages with effects."""
    entries = [
        (
            as_stage(item, robot)
            if isinstance(item, FittedEffect)
            else item.to_stage(robot)
        )
        for item in items
    ]
    return Stages(friction=stages.friction, inertia=stages.inertia, effects=entries)


def without_friction(stages: Stages) -> Stages:
    """Return the stages with friction of no size, as late as it was."""
    joints = {
        name: replace_struct(
            joint,
            positive=np.zeros_like(joint.positive).tolist(),
            negative=np.zeros_like(joint.negative).tolist(),
        )
        for name, joint in stages.friction.joints.items()
    }
    return replace_struct(
        stages, friction=replace_struct(stages.friction, joints=joints)
    )


def moving_scene(robot: Robot, stages: Stages, *, seconds: float = 5.0) -> Scene:
    """Return a scene of an arm that warms up on a shared clock."""
    parts = [
        wander(seconds, seed=seed, rate_hz=RATE_HZ, rests=((3.0, 3.4),))
        for seed in range(5, 5 + (robot.n + 1) // 2)
    ]
    q = np.hstack(parts)[:, : robot.n]
    motion = motion_of(q, rate_hz=RATE_HZ, cutoff_hz=CUTOFF_HZ)
    warm = 40.0 - 15.0 * np.exp(-motion.t / 4.0)
    celsius = np.stack([warm - k * (0.5 * warm - 12.0) for k in range(robot.n)], axis=1)
    model = TorqueModel.from_stages(stages, robot)
    return Scene(
        robot=robot,
        motion=replace(motion, celsius=celsius),
        model=model,
        sign_width=np.array(
            [surface.sign_width for surface in model.surfaces if surface]
        ),
        start=START_S,
        shared_clock=True,
        temperature=celsius,
    )


def predicted(scene: Scene, stages: Stages) -> Array:
    """Return what `predict` adds for the effects of a file, (N, n) N m, low-passed."""
    robot = scene.robot
    log = made_recording(scene.motion.q, rate_hz=RATE_HZ)
    effects = fitted_effects(stages, robot, unexplained=True)
    return added_torque(scene, log, effects, np.zeros(robot.n)).value


def rows_of(scene: Scene) -> Array:
    """Return positions, velocities, accelerations, temperatures and the time of each
    sample.
    """
    motion = scene.motion
    series = [motion.q, motion.dq, motion.ddq, scene.temperature, scene.time[:, None]]
    return np.hstack(series)


def module_of(robot: Robot, stages: Stages) -> ModuleType:
    """Return the exported numpy module."""
    text = export(robot, stages, kind="numpy module").text
    module = ModuleType("arm")
    exec(compile(text, "arm.py", "exec"), module.__dict__)
    return module


def stepped(
    module: ModuleType, rows: Array, *, as_logged: bool = True, rate_hz: float = RATE_HZ
) -> Array:
    """Return the torque (N, n) of a module's model over rows."""
    n = module.N
    model = module.Model(rows[0, :n], as_logged=as_logged)
    found = [
        model.step(
            row[:n],
            row[n : 2 * n],
            row[2 * n : 3 * n],
            1.0 / rate_hz,
            row[4 * n],
            row[3 * n : 4 * n],
        )
        for row in rows
    ]
    return np.array(found)


def exported(
    folder: Path, robot: Robot, stages: Stages, rows: Array, *, rate_hz: float = RATE_HZ
) -> Array:
    """Return the torque (N, n) of exported code: of C where there is a compiler."""
    if CC is None:
        return stepped(module_of(robot, stages), rows, rate_hz=rate_hz)
    header = export(robot, stages, kind="C header").text
    body = (
        "static ARM_state s; if (row == 0) ARM_start(&s, x); ARM_step(&s, x, x + N, x"
        f" + 2 * N, x + 3 * N, x[4 * N], {1.0 / rate_hz!r}, y);"
    )
    return run_c(folder, robot, header, body, rows)


def low_passed(scene: Scene, whole: Array, smooth: Array, item: Fitted) -> Array:
    """Low-pass exported torque of an effect as `predict` does.

    `whole` is that of the arm, `smooth` of the arm without friction: of effects of the
    modelled torque, what friction adds has steps, and goes through the low-pass once
    more.
    """
    if is_modelled(item):
        return scene.motion.filtered(smooth) + scene.motion.filtered(
            whole - smooth, times=2
        )
    return scene.motion.filtered(whole, times=item.passes)


def is_modelled(item: Fitted) -> bool:
    """Return whether an effect is a function of the modelled torque."""
    return isinstance(item, FittedEffect) and isinstance(item.effect, OfModelledTorque)


def share_missed(scene: Scene, found: Array, expected: Array) -> float:
    """Return the RMS difference over the RMS of what is expected, once settled."""
    t = scene.motion.t
    counts = scene.motion.usable & (t > SETTLED_S) & (t < t[-1] - END_S)
    difference = np.sqrt(np.mean((found - expected)[counts] ** 2))
    return float(difference / np.sqrt(np.mean(expected[counts] ** 2)))


SOFT = {"trial_stiffness": 900.0, "damping_ratio": 0.15}
CASES: Mapping[str, Sequence[Case]] = {
    "stribeck": [case(1, 1.5, stribeck_speed=0.1, exponent=1.0)],
    "load_dependent_friction": [
        case(0, 0.1),
        case(1, 0.1, reflected_rotor_inertia=0.02),
    ],
    "gear_efficiency": [case(1, 0.3, 0.1), case(0, 0.1, 0.3)],
    "asymmetric_friction": [case(0, 0.5, 0.2)],
    "thermal_friction": [
        case(
            0, -0.05, -0.03, warm_up_time=300.0, logged=1.0, reference_temperature=20.0
        ),
        case(1, 0.5, 0.3, warm_up_time=100.0, logged=0.0, reference_temperature=0.0),
    ],
    "quadratic_drag": [case(1, 0.3)],
    "nonlinear_viscous": [case(0, 0.8, exponent=0.6)],
    "presliding_hysteresis": [case(1, 2.0, presliding_distance=0.01)],
    "friction_change": [case(0, 0.4, -0.2)],
    "position_dependent_friction": [
        case(1, 0.3, -0.2, 0.1, 0.2, period=2 * np.pi, waves=2.0),
        case(
            1,
            *(0.3, -0.2, 0.1, 0.2),
            period=2 * np.pi,
            waves=2.0,
            lowest=-0.4,
            highest=0.3,
        ),
    ],
    "torque_constant": [case(0, 0.05)],
    "torque_saturation": [case(0, 1e-4, around=1e-4), case(1, 1e-4, around=0.0)],
    "torque_bias": [case(1, 0.7)],
    "drift": [case(0, 0.5, 0.01, duration=45.0), case(1, 0.1, -0.02, duration=500.0)],
    "time_skew": [
        case(0, 0.004, around=0.004),
        case(1, 0.0123, around=0.0123),
        case(None, 0.0005, around=0.0),
        case(1, 0.09, around=0.09),
        case(0, -0.001, around=-0.001),
    ],
    "torque_filter": [
        case(1, 0.05, around=0.05, lowpass=0.0),
        case(None, 0.03, around=0.03, lowpass=1.0),
    ],
    "joint_zero": [case(0, 0.02, around=0.0), case(1, -0.7, around=-0.7)],
    "actuator_lag": [case(1, 0.006), case(None, 0.002)],
    "periodic_disturbance": [case(1, 0.4, 0.3, frequency=7.3, clocks=0.0, span=90.0)],
    "external_contact": [case(0)],
    "spring": [case(0, 3.0, 0.5, cubic=0.0), case(1, 3.0, 0.5, 0.4, -0.3, cubic=1.0)],
    "hysteresis": [
        case(0, 2.0, hysteresis_distance=0.2, sharpness=sharpness)
        for sharpness in (0.0, 1.0, 2.0)
    ],
    "payload": [
        case(None, 2.0, 0.2, -0.1, 0.1, 0.05, 0.0, 0.06, 0.0, 0.0, 0.07, from_log=0.0)
    ],
    "base_tilt": [
        case(None, 0.05, -0.03, upright=0.0, around_1=0.05, around_2=-0.03),
        case(None, 0.02, 0.01, 1.0, -2.0, upright=1.0, around_1=0.0, around_2=0.0),
    ],
    "rotor_inertia": [case(1, 4e-5, coupling=0.0), case(1, 2e-4, coupling=1.0)],
    "transmission_coupling": [case(1, 0.5, 0.3, 0.02, neighbour=-1.0, ratio=0.7)],
    "encoder_eccentricity": [
        case(0, 1e-3, -5e-4, order=0.04),
        case(1, 1e-4, 5e-5, order=1.0),
    ],
    "torque_ripple": [
        case(0, 0.3, 0.1, order=1.0, law=0.0, lag=0.01),
        case(1, 0.03, 0.02, order=0.5, law=1.0, lag=0.0),
        case(1, 0.3, 0.2, order=0.5, law=2.0, lag=0.0),
        case(0, 0.03, 0.02, order=0.5, law=3.0, lag=0.0),
    ],
    "joint_elasticity": [
        case(0, 1 / 900.0, **SOFT, encoder_side=0.0),
        case(
            0,
            1 / 500.0,
            trial_stiffness=500.0,
            damping_ratio=0.1,
            encoder_side=0.0,
            reflected_rotor_inertia=0.5,
        ),
        case(1, 1 / 300.0, trial_stiffness=300.0, damping_ratio=0.03, encoder_side=0.0),
        case(
            0, 1 / 2000.0, trial_stiffness=2000.0, encoder_side=1.0, damping_ratio=0.15
        ),
    ],
    "backlash": [case(1, 2e-3, trial_gap=2e-3), case(0, 6e-3, trial_gap=5e-3)],
}


def catalogue_cases() -> list[tuple[str, Case]]:
    """Return every case with its effect's name."""
    return [(name, one) for name in CATALOGUE for one in CASES[name]]
