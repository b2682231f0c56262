"""A vertical slide with a pendulum on it goes through friction, gravity and inertia."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Chain, Robot
from tests import Array
from tests.plants.motions.trajectories import (
    Reference,
    hold,
    join,
    sweeps,
    together,
    zigzag,
)
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import robot_from_chain
from tests.plants.sensors import quantise

pytestmark = pytest.mark.slow

RATE = 250.0
G = 9.81
SLIDE, ARM = 8.0, 3.0  # masses, kg
# pendulum: first moments kg m, inertia about its axis kg m^2
MX, MZ, INERTIA = 0.6, 0.25, 0.21
DRY, VISCOUS = np.array([30.0, 0.8]), np.array([60.0, 0.3])
NOISE = np.array([2.0, 0.05])  # N, N m
STEPS = np.array([5e-6, 2 * np.pi / 2**16])  # m, rad
LIMITS = np.array([[0.05, 0.75], [-2.2, 2.2]])
TOP, ACCELERATION = np.array([0.5, 3.0]), np.array([4.0, 20.0])


def slider() -> Robot:
    """Joint 1 slides up; joint 2 turns about -y,
    so that x of its link rises with q_2.
    """
    chain = Chain(
        rotation=np.tile(np.eye(3), (2, 1, 1)),
        position=np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]]),
        axis=np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        prismatic=np.array([True, False]),
    )
    robot = robot_from_chain(chain, gravity=np.array([0.0, 0.0, -G]))
    return replace(
        robot, joints=tuple(replace(j, rotor_inertia=0.0) for j in robot.joints)
    )


def load(reference: Reference) -> Array:
    """Lagrange's equations and friction; the pendulum's centre is (mx sin q + mz cos q)
    / m up.
    """
    q, dq, ddq = reference.q[:, 1], reference.dq, reference.ddq
    s, c = np.sin(q), np.cos(q)
    lever = MX * c - MZ * s  # derivative of the height's moment
    bend = -MX * s - MZ * c
    force = (SLIDE + ARM) * (ddq[:, 0] + G) + lever * ddq[:, 1] + bend * dq[:, 1] ** 2
    torque = INERTIA * ddq[:, 1] + lever * (ddq[:, 0] + G)
    friction = DRY * np.sign(dq) + VISCOUS * dq
    return np.column_stack([force, torque]) + friction


def record(reference: Reference, seed: int) -> Recording:
    noise = NOISE * np.random.default_rng(seed).standard_normal(reference.q.shape)
    return made_recording(
        quantise(reference.q, STEPS), load(reference) + noise, rate_hz=RATE
    )


def identified() -> Stages:
    """From moves of one joint at a time, the slide with the pendulum in two postures,
    and both.
    """
    drills = []
    for j, angle in ((0, -1.2), (0, 0.9), (1, 0.3)):
        pace = (np.geomspace(0.1, 1.0, 6) * TOP[j]).tolist()
        home, accel = np.array([0.4, angle]), float(ACCELERATION[j])
        motion = sweeps(home, j, tuple(LIMITS[j]), pace, accel, rate_hz=RATE)
        drills.append(record(motion, len(drills)))
    rng = np.random.default_rng(1)
    moving = {
        j: zigzag(
            rng, tuple(LIMITS[j]), float(TOP[j]), float(ACCELERATION[j]), 20.0, RATE
        )
        for j in (0, 1)
    }
    motion = together(LIMITS.mean(axis=1), moving, RATE)
    both = record(join([hold(motion.q[0], 0.5, RATE), motion]), 2)
    found, robot = Stages(), slider()
    found.friction = identify_friction(drills, robot, options=FrictionOptions())
    by_gravity = identify_gravity(drills, robot, found)
    found.gravity, found.friction = by_gravity.gravity, by_gravity.friction
    by_inertia = identify_inertia([both], robot, found, options=InertiaOptions())
    found.inertia, found.friction = by_inertia.inertia, by_inertia.friction
    return found


TRUE = {"m_1": SLIDE, "m_2": ARM, "mx_2": MX, "my_2": 0.0, "mz_2": MZ, "Iyy_2": INERTIA}


def test_all_stages_find_the_truth() -> None:
    """Equations of the plant and of the package are not of one source: Lagrange,
    Newton-Euler.
    """
    stages = identified()
    joints = stages.friction.joints.values()
    assert [joint.unit for joint in joints] == ["N", "N m"]
    for j, joint in enumerate(joints):
        assert joint.asymmetry < 0.02
        surface = FrictionSurface.from_stage(joint)
        speed = np.linspace(*surface.scaling.speed, 30)
        middle = np.full(30, LIMITS[j].mean())
        true = DRY[j] + VISCOUS[j] * speed
        for sign in (1, -1):
            np.testing.assert_allclose(
                sign * surface.torque(middle, sign * speed), true, rtol=0.02
            )
    gravity, inertia = stages.gravity, stages.inertia
    assert gravity.not_excited == []
    assert {p.unit for p in gravity.parameters} == {"kg", "kg m"}
    assert inertia.rank == inertia.structural_rank == 4
    assert [p.name for p in inertia.parameters] == ["Iyy_2"]
    for p in (*gravity.parameters, *inertia.parameters):
        true_value = sum(factor * TRUE[name] for name, factor in p.terms.items())
        assert abs(p.value - true_value) < 4 * p.std_error, p.name
        assert p.value == pytest.approx(true_value, rel=0.01), p.name
